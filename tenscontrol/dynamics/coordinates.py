"""Coordinates for control: nodes, minimal, internal.

All three are linear in the node positions around a reference shape. In the
reduced ones the mass matrix is the identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.model import Model
from tenscontrol.structure import (
    Block,
    Structure,
    bar_rows,
    block_mass,
    left_by_supports,
    refuse_wrong_bar_lengths,
    rigid_basis,
    rigid_motions,
)
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    choice,
    float_array,
    frozen,
    instance,
    shaped,
)

# Directions whose singular value is below this fraction of the largest do not exist.
_RANK_TOLERANCE = 1e-9

# Newton's steps at most; those in an expression, which reach about 70° from the reference; and how
# far, relative to its square, a length may be off in the end.
_MOST, _STEPS, _EXACT = 30, 6, 1e-10

# A shape is laid over the reference when the next step is below this part of its size.
_LAID = 1e-15

KINDS = ("nodes", "minimal", "internal")


@dataclass(frozen=True, eq=False)
class Coordinates:
    """A basis of node displacements around a reference shape, and the maps both ways.

    Made by :func:`coordinates`.

    Attributes
    ----------
    structure : Structure
    kind : str
        ``"nodes"``, ``"minimal"`` or ``"internal"``.
    nodes : ndarray, shape (d, n)
        Reference shape, m.
    basis : ndarray, shape (d n, r)
        T: a displacement is ``vec(δN) = T q``. In reduced coordinates
        ``Tᵀ M T = I``, so that q has the unit m √kg. Rows that supports hold are zero.
    """

    structure: Structure
    kind: str
    nodes: FloatArray
    basis: FloatArray
    _projection: FloatArray  # (r, d n): q = projection @ vec(δN)
    _mass: FloatArray  # (n, n): M_s

    @property
    def count(self) -> int:
        """Number r of coordinates."""
        return int(self.basis.shape[1])

    def project(self, displacements: object) -> FloatArray:
        """Return the coordinates of node displacements, ``q = Tᵀ M vec(δN)``.

        Parameters
        ----------
        displacements : array_like, shape (d n,) or (d n, k)
            Node by node, m; one displacement a column.

        Returns
        -------
        ndarray, shape (r,) or (r, k)

        Raises
        ------
        TypeError, ValueError
            If an entry is not a finite number, or the shape does not fit.
        """
        fields = float_array("displacements", displacements)
        rows = self._projection.shape[1]
        if fields.ndim not in (1, 2) or fields.shape[0] != rows:
            raise ValueError(
                f"displacements has shape {fields.shape}, expected ({rows},) or ({rows}, k): "
                f"{', '.join('xyz'[: self.structure.dimension])} node by node"
            )
        return np.asarray(self._projection @ fields)

    def measure(self, nodes: object, velocities: object) -> FloatArray:
        """Return the reduced state ``z = [q; q̇]`` of a motion.

        In internal coordinates it is first :meth:`laid_over` the reference, so that a structure
        that has travelled or turned is measured as one that has not.

        Parameters
        ----------
        nodes : array_like, shape (d, n)
            Node positions, m.
        velocities : array_like, shape (d, n)
            Node velocities, m/s.

        Returns
        -------
        ndarray, shape (2r,)

        Raises
        ------
        ValueError
            If an argument does not fit or is not finite.
        """
        N = self.structure.checked_nodes("nodes", nodes)
        V = self.structure.checked_nodes("velocities", velocities)
        return self.state_of(N, V)

    def state_of(self, nodes: FloatArray, velocities: FloatArray) -> FloatArray:
        """See :meth:`measure`: of finite arrays of the right shape, which are not checked."""
        if self.kind == "internal":
            nodes, velocities = self.laid_over(nodes, velocities)
        motion = np.stack([(nodes - self.nodes).T, velocities.T]).reshape(2, -1)
        return np.asarray((motion @ self._projection.T).ravel())

    def laid_over(self, nodes: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :meth:`measure`: nodes, m, and velocities, m/s, laid over the reference."""
        if len(self.structure.fixed) < 2 and not self.structure.rollers:
            turn, centre = self._alignment(nodes)
            return turn @ (nodes - centre) + self._reference[0], turn @ velocities
        return self._along_supports(nodes, velocities) if self.is_loose else (nodes, velocities)

    def to_nodes(self, q: object) -> FloatArray:
        """Return node positions with exact bar lengths whose coordinates are q.

        The displacement that the basis says is added, and one that q does not see, along the
        forces of the bars in the reference shape, until all lengths are exact: so
        ``measure(to_nodes(q), ...)`` gives q again. Across a bar on its own, its vector then moves
        as the basis says; bars that share nodes are solved for together by Newton's method. In
        ``"nodes"`` coordinates the displacement is added as it is.

        Parameters
        ----------
        q : array_like, shape (r,)

        Returns
        -------
        ndarray, shape (d, n)
            m.

        Raises
        ------
        ValueError
            If q does not fit, or turns a bar by a right angle or more, or bars that share nodes
            cannot keep their lengths.
        """
        q = shaped("q", q, (self.count,), f"one per {self.kind} coordinate")
        nodes = self.nodes + self._columns(self.basis @ q)
        if self.kind == "nodes":
            return nodes
        alone, axes = self._alone
        length = self.structure.bar_length[alone]
        vectors = self.structure.bar_vectors(nodes)[:, alone]
        along = (vectors * axes).sum(axis=0)
        across = vectors - along * axes
        room = length**2 - (across**2).sum(axis=0)
        if room.size and room.min() <= 0:
            raise ValueError(
                f"q turns bar {alone[int(room.argmin())]} by a right angle or more from the "
                "reference shape; these coordinates do not reach so far"
            )
        self._stretch(nodes, (np.sqrt(room) - along) * axes)
        for block, normal in self._normals:
            nodes = self._with_lengths(nodes, block, normal)
        return nodes

    def to_velocities(self, q: object, rates: object) -> FloatArray:
        """Return node velocities with rates q̇ that keep the bar lengths in the shape of q.

        Parameters
        ----------
        q, rates : array_like, shape (r,)

        Returns
        -------
        ndarray, shape (d, n)
            m/s.

        Raises
        ------
        ValueError
            As :meth:`to_nodes`.
        """
        shape = self.to_nodes(q)
        rates = shaped("rates", rates, (self.count,), f"one per {self.kind} coordinate")
        velocities = self._columns(self.basis @ rates)
        if self.kind == "nodes":
            return velocities
        alone, axes = self._alone
        vectors = self.structure.bar_vectors(shape)[:, alone]
        change = self.structure.bar_vectors(velocities)[:, alone]
        along = (vectors * axes).sum(axis=0)
        self._stretch(velocities, -(vectors * change).sum(axis=0) / along * axes)
        for block, normal in self._normals:
            flat = velocities.ravel(order="F")
            J = bar_rows(self.structure, block.independent, shape).toarray()[:, block.rows]
            flat[block.rows] -= normal @ np.linalg.solve(J @ normal, J @ flat[block.rows])
            velocities = self._columns(flat)
        return velocities

    def expressions(self, z: Any, near: Any = None) -> tuple[Any, Any]:
        """Return expressions of node positions and velocities, shape (d, n), of ``[q; q̇]``, SX.

        As :meth:`to_nodes` and :meth:`to_velocities`; no numbers where those raise.

        Parameters
        ----------
        z : casadi.SX, shape (2r, 1)
        near : casadi.SX, optional
            Symbol for :meth:`hidden`, to be put in later: expressions and their first derivatives
            are then exact, and much shorter where bars share nodes.
        """
        structure, r = self.structure, self.count
        shape = structure.nodes.shape
        T = ca.sparsify(ca.DM(np.where(np.abs(self.basis) > 1e-14, self.basis, 0.0)))
        N = ca.SX(ca.DM(self.nodes) + ca.reshape(ca.mtimes(T, z[:r]), *shape))
        V = ca.SX(ca.reshape(ca.mtimes(T, z[r:]), *shape))
        share = structure.end_share
        for bar, column in zip(*self._alone[:1], self._alone[1].T, strict=True):
            start, end = structure.bars[bar].tolist()
            axis = ca.DM(column)
            vector, change = N[:, end] - N[:, start], V[:, end] - V[:, start]
            along = ca.dot(vector, axis)
            across = vector - along * axis
            reach = ca.sqrt(structure.bar_length[bar] ** 2 - ca.dot(across, across))
            whole = across + reach * axis
            stretch, rate = reach - along, -ca.dot(whole, change) / reach
            for node, part in ((start, -share[bar, 0]), (end, share[bar, 1])):
                N[:, node] += part * stretch * axis
                V[:, node] += part * rate * axis
        if not self._normals:
            return N, V
        parts = ca.vertsplit(self.hidden(z) if near is None else near, self._hidden_parts)
        for i, (block, _) in enumerate(self._normals):
            rows = block.rows.tolist()
            places, speeds = ca.vec(N), ca.vec(V)
            there, displaced, faster = parts[3 * i : 3 * i + 3]
            places[rows] += displaced
            speeds[rows] += faster
            if near is not None:
                # Nothing is left of lengths to correct, but of their derivatives.
                step = self._normal_step(block)
                _, excess, _ = self._lengths(ca.reshape(places, *shape), block)
                places[rows] -= step(there, excess)
                J, _, _ = self._lengths(ca.reshape(places, *shape), block)
                speeds[rows] -= step(there, ca.mtimes(J, speeds[rows]))
            N, V = ca.reshape(places, *shape), ca.reshape(speeds, *shape)
        return N, V

    def hidden(self, z: Any) -> Any:
        """Return what keeps the lengths of bars that share nodes, SX: empty where none do.

        For each block its places, and the displacements and velocities in its normal space, m and
        m/s, of ``[q; q̇]``. By a fixed number of Newton's steps; no numbers where these do not lead
        to the bar lengths.

        Parameters
        ----------
        z : casadi.SX, shape (2r, 1)
        """
        r, shape, found = self.count, self.structure.nodes.shape, [ca.SX(0, 1)]
        T = ca.sparsify(ca.DM(np.where(np.abs(self.basis) > 1e-14, self.basis, 0.0)))
        moved = ca.DM(self.nodes.ravel(order="F")) + ca.mtimes(T, z[:r])
        rates = ca.mtimes(T, z[r:])
        for block, _ in self._normals:
            places, rows, step = ca.SX(moved), block.rows.tolist(), self._normal_step(block)
            for _ in range(_STEPS):
                _, excess, _ = self._lengths(ca.reshape(places, *shape), block)
                places[rows] -= step(places[rows], excess)
            J, _, worst = self._lengths(ca.reshape(places, *shape), block)
            speeds = -step(places[rows], ca.mtimes(J, rates[rows]))
            there = ca.if_else(worst <= _EXACT, places[rows], np.nan)
            found += [there, there - moved[rows], speeds]
        return ca.vertcat(*found)

    @cached_property
    def _hidden_parts(self) -> list[int]:
        """Where the parts of :meth:`hidden` begin, and its size."""
        sizes = [len(block.rows) for block, _ in self._normals for _ in range(3)]
        return [sum(sizes[:i]) for i in range(len(sizes) + 1)]

    @property
    def hidden_size(self) -> int:
        """Number of entries of :meth:`hidden`."""
        return self._hidden_parts[-1]

    def _lengths(self, N: Any, block: Block) -> tuple[Any, Any, Any]:
        """Return J and half the excess of squared lengths of a block, and the worst part, SX."""
        structure, bars = self.structure, block.independent
        square = ca.DM(structure.bar_length[bars] ** 2)
        B = kernel.differences(N, structure.bars[bars])
        excess = (kernel.dots(B, B).T - square) / 2
        J = kernel.block_rows(structure, bars, block.rows, N)
        return J, excess, ca.norm_inf(excess / square)

    def _normal_step(self, block: Block) -> ca.Function:
        """Return ``(places, change) -> δ`` in the normal space of a block with ``J δ = change``.

        ``M δ = J₀ᵀ μ``, with J at the places of the block's rows and J₀ of the reference: sparse,
        and without pivoting in the order of the block.
        """
        bars, rows, shape = block.independent, block.rows, self.structure.nodes.shape
        places, change = ca.SX.sym("places", len(rows)), ca.SX.sym("change", len(bars))
        reference = ca.SX(ca.DM(self.nodes))
        at = ca.vec(reference)
        at[rows.tolist()] = places
        J, J_0 = (
            kernel.block_rows(self.structure, bars, rows, N)
            for N in (ca.reshape(at, *shape), reference)
        )
        mass = ca.SX(ca.sparsify(ca.DM(block_mass(self.structure, block).toarray())))
        matrix = ca.blockcat([[mass, -J_0.T], [J, ca.SX(len(bars), len(bars))]])
        right = ca.vertcat(ca.SX.zeros(len(rows)), change)
        order, back = block.order.tolist(), np.argsort(block.order).tolist()
        found = kernel.eliminated(matrix[order, order], right[order])[back]
        return ca.Function("normal_step", [places, change], [found[: len(rows)]])

    def _with_lengths(self, nodes: FloatArray, block: Block, normal: FloatArray) -> FloatArray:
        """Return nodes displaced along the normal space until the bars of a block are exact."""
        structure, bars, rows = self.structure, block.independent, block.rows
        square = structure.bar_length[bars] ** 2
        start, flat = nodes.ravel(order="F")[rows], nodes.ravel(order="F")
        total, best = np.zeros(len(bars)), np.inf
        for _ in range(_MOST):
            flat[rows] = start + normal @ total
            nodes = self._columns(flat)
            excess = ((structure.bar_vectors(nodes)[:, bars] ** 2).sum(axis=0) - square) / 2
            off = float(np.abs(excess / square).max())
            slope = bar_rows(structure, bars, nodes).toarray()[:, rows] @ normal
            if off < _EXACT and off >= best:
                if np.linalg.det(slope) > 0:
                    return nodes
                break
            best = min(best, off)
            if not off < 1 / _EXACT or np.linalg.cond(slope) > 1 / _EXACT:
                break
            total -= np.linalg.solve(slope, excess)
        raise ValueError(
            f"q is a shape in which bars {sorted(block.bars.tolist())}, which are joined to one "
            "another, cannot keep their lengths, or would have to turn over; these coordinates do "
            "not reach so far from the reference shape"
        )

    def _columns(self, flat: FloatArray) -> FloatArray:
        """Return vec(N) as columns of nodes, shape (d, n)."""
        return flat.reshape(self.structure.nodes.shape, order="F")

    def _stretch(self, columns: FloatArray, change: FloatArray) -> None:
        """Add a change to each bar on its own: half at each end, or all at the only free one."""
        bars = self._alone[0]
        share, ends = self.structure.end_share[bars], self.structure.bars[bars]
        columns[:, ends[:, 0]] -= share[:, 0] * change
        columns[:, ends[:, 1]] += share[:, 1] * change

    @cached_property
    def _alone(self) -> tuple[IntArray, FloatArray]:
        """Bars that move on their own, ascending, and their axes in the reference, (d, ·)."""
        bars = np.union1d(self.structure.free_bars, self.structure.swinging_bars)
        vectors = self.structure.bar_vectors(self.nodes)[:, bars]
        return bars, vectors / np.linalg.norm(vectors, axis=0)

    @cached_property
    def _normals(self) -> list[tuple[Block, FloatArray]]:
        """Each block, with displacements along the forces of its bars in the reference shape."""
        blocks = () if self.kind == "nodes" else self.structure.blocks
        return [(block, normal_basis(self.structure, block, self.nodes)) for block in blocks]

    @cached_property
    def is_loose(self) -> bool:
        """Whether the supports leave a motion as one body."""
        return bool(rigid_basis(self.structure).shape[1])

    def _centre(self, nodes: FloatArray) -> FloatArray:
        if len(self.structure.fixed):
            return nodes[:, self.structure.fixed[:1]]
        weights = self._mass.sum(axis=1)
        return np.asarray(nodes @ weights / weights.sum())[:, None]

    @cached_property
    def _reference(self) -> tuple[FloatArray, FloatArray]:
        """Centre of the reference shape, (d, 1), and its moments about it, (d, n)."""
        centre = self._centre(self.nodes)
        return centre, (self.nodes - centre) @ self._mass

    def _alignment(self, nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what lays the shape over the reference, nearest in the metric of kinetic energy.

        Kabsch 1976, doi:10.1107/S0567739476001873: then nothing is left of a rigid motion.
        """
        centre = self._centre(nodes)
        U, _, Vt = np.linalg.svd(self._reference[1] @ (nodes - centre).T)
        U[:, -1] *= np.linalg.det(U @ Vt)
        return U @ Vt, centre

    def _along_supports(
        self, nodes: FloatArray, velocities: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return shape and velocities laid over the reference by what the supports leave.

        By Gauss-Newton steps along motions that keep nodes where supports hold them: first to the
        nearest shape, from however far; then until the displacement has no part along such motions
        of the reference, which is the same unless they change their direction, as on two slides.
        """
        held, turn = self.structure.fixed_rows, np.eye(len(nodes))
        own = _momenta(self._mass, left_by_supports(self.structure, rigid_motions(self.nodes))).T
        for nearest in (True, False):
            for _ in range(_MOST):
                fields, off = rigid_motions(nodes), (nodes - self.nodes).ravel(order="F")
                back = np.linalg.lstsq(fields[held], -off[held], _RANK_TOLERANCE)[0]
                left = _kept(fields, held)
                moves = fields @ left
                momenta = _momenta(self._mass, moves).T if nearest else own
                wanted = -momenta @ (off + fields @ back)
                move = back + left @ np.linalg.lstsq(momenta @ moves, wanted, _RANK_TOLERANCE)[0]
                nodes, step = _moved_as_one(nodes, move)
                turn = step @ turn
                if np.abs(fields @ move).max() <= _LAID * np.abs(nodes).max():
                    break
        return nodes, turn @ velocities


def coordinates(model: Model, nodes: object = None, kind: str = "internal") -> Coordinates:
    """Return coordinates of a structure around a reference shape.

    Parameters
    ----------
    model : Model
    nodes : array_like, shape (d, n), optional
        Reference shape, m; that of the structure if not given.
    kind : {"internal", "minimal", "nodes"}
        ``"nodes"``: the node positions themselves, as far as supports leave them free.
        ``"minimal"``: without bar-length changes; in space 5 a bar and 3 a string node, in the
        plane 3 and 2, and fewer where bars share nodes: those of the nodes less the rank of the
        bar constraints. ``"internal"``: minimal less motion as one body that the supports leave.

    Raises
    ------
    ValueError
        If ``nodes`` does not fit, ``kind`` is another word, or bars that share nodes are in a
        dead centre.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> model = tc.Model(tc.prism())
    >>> kinds = ("nodes", "minimal", "internal")
    >>> [tc.dynamics.coordinates(model, kind=kind).count for kind in kinds]
    [18, 15, 9]
    """
    instance("model", model, Model, "make one by Model(structure)")
    structure = model.structure
    N = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    choice("kind", kind, KINDS)
    refuse_wrong_bar_lengths("nodes", structure, N)
    mass = model.mass_matrix()
    if kind == "nodes":
        basis = np.eye(N.size)[:, structure.free_rows]
        projection = basis.T
    else:
        basis = bar_basis(structure, N)
        projection = _momenta(mass, basis).T
        if kind == "internal":
            rigid = projection @ left_by_supports(structure, rigid_motions(N))
            inside = _complement(rigid)
            basis, projection = basis @ inside, inside.T @ projection
    return Coordinates(
        structure, kind, frozen(N), frozen(basis), frozen(projection), frozen(mass.toarray())
    )


def bar_basis(structure: Structure, nodes: FloatArray) -> FloatArray:
    """Return the mass-orthonormal basis of motions that keep bar lengths, shape (d n, r).

    In closed form for bars on their own, in space three translations ``e/√m`` and two rotations in
    which the ends move by ``∓ t √(3/m)`` across the bar; for a bar that swings about a fixed end
    the rotations ``t √(3/m)`` of the other; translations ``e/√m_s`` for a string node. For each
    block the null space of its constraints in the metric of its mass.
    """
    d = structure.dimension
    parts: list[tuple[IntArray, FloatArray]] = []
    for i in structure.free_bars:
        ends = structure.bars[i]
        mass = structure.bar_mass[i]
        across = _across(nodes[:, ends[1]] - nodes[:, ends[0]]) * np.sqrt(3 / mass)
        shift = np.eye(d) / np.sqrt(mass)
        both = np.vstack([np.hstack([shift, part]) for part in (-across, across)])
        parts.append((_rows(ends, d), both))
    for i, (hinge, tip) in zip(
        structure.swinging_bars, structure.hinged_pairs.tolist(), strict=True
    ):
        across = _across(nodes[:, tip] - nodes[:, hinge]) * np.sqrt(3 / structure.bar_mass[i])
        parts.append((_rows(np.array([tip]), d), across))
    for point, mass in zip(structure.string_nodes, structure.string_node_mass, strict=True):
        rows = np.intersect1d(_rows(np.array([point]), d), structure.free_rows)
        parts.append((rows, np.eye(len(rows)) / np.sqrt(mass)))
    for block in structure.blocks:
        # y = Lᵀ δ has the identity for a mass, where M = L Lᵀ.
        L = np.linalg.cholesky(block_mass(structure, block).toarray())
        constraints = _scaled_rows(structure, block, nodes, L)
        whole = np.linalg.qr(constraints.T, mode="complete")[0]
        parts.append((block.rows, np.linalg.solve(L.T, whole[:, len(constraints) :])))
    basis = np.zeros((nodes.size, sum(part.shape[1] for _, part in parts)))
    column = 0
    for rows, part in parts:
        basis[rows, column : column + part.shape[1]] = part
        column += part.shape[1]
    return basis


def _kept(fields: FloatArray, held: IntArray) -> FloatArray:
    """Return the combinations of motions as one body, shape (k, ·), that move no held row."""
    from scipy.linalg import null_space

    size = np.maximum(np.linalg.norm(fields, axis=0), np.finfo(float).tiny)
    return np.asarray(null_space(fields[held] / size, _RANK_TOLERANCE) / size[:, None])


def _moved_as_one(nodes: FloatArray, move: Any) -> tuple[FloatArray, FloatArray]:
    """Return nodes after a screw, of the rates of :func:`rigid_motions`, and its turn."""
    from scipy.linalg import expm

    d = len(nodes)
    spin = np.concatenate([np.zeros(3), move[d:]])[-3:]  # in the plane about z alone
    screw = np.zeros((d + 1, d + 1))
    screw[:d, :d], screw[:d, d] = np.cross(spin, np.eye(3)).T[:d, :d], move[:d]
    whole, centre = expm(screw), nodes.mean(axis=1, keepdims=True)
    return whole[:d, :d] @ (nodes - centre) + whole[:d, d:] + centre, whole[:d, :d]


def normal_basis(structure: Structure, block: Block, nodes: FloatArray) -> FloatArray:
    """Return displacements of a block's rows along its bars' forces, shape (r, c), 1/m.

    ``Z = M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹``: J Z = I, and Z is orthogonal in M to what keeps the lengths.
    """
    L = np.linalg.cholesky(block_mass(structure, block).toarray())
    constraints = _scaled_rows(structure, block, nodes, L)
    scale = np.linalg.norm(bar_rows(structure, block.independent, nodes).toarray(), axis=1)
    return np.asarray(np.linalg.solve(L.T, np.linalg.pinv(constraints)) / scale)


def _scaled_rows(structure: Structure, block: Block, nodes: FloatArray, L: Any) -> FloatArray:
    """Return ``J L⁻ᵀ``, rows of J of length one, of a block, or refuse a dead centre."""
    J = bar_rows(structure, block.independent, nodes).toarray()
    J = J[:, block.rows] / np.linalg.norm(J, axis=1, keepdims=True)
    rows = np.linalg.solve(L, J.T).T
    sizes = np.linalg.svd(rows, compute_uv=False)
    if sizes.size and sizes.min() <= _RANK_TOLERANCE * sizes.max():
        raise ValueError(
            f"in nodes, bars {sorted(block.bars.tolist())}, which are joined to one another, are "
            "in a dead centre: their lengths do not determine their motion. Change the nodes a "
            "little"
        )
    return np.asarray(rows)


def _rows(nodes: IntArray, dimension: int) -> IntArray:
    """Return the rows of vec(N) of some nodes."""
    return np.asarray((dimension * nodes[:, None] + np.arange(dimension)).ravel())


def _across(vector: FloatArray) -> FloatArray:
    """Return orthonormal directions across a vector, shape (d, d − 1)."""
    return np.asarray(np.linalg.svd(vector[None, :])[2][1:].T)


def _momenta(mass: object, basis: FloatArray) -> FloatArray:
    """Return M T: the mass matrix acts alike on x, y and z."""
    n = mass.shape[0]  # type: ignore[attr-defined]
    return np.asarray(mass @ basis.reshape(n, -1)).reshape(basis.shape)  # type: ignore[operator]


def _complement(vectors: FloatArray) -> FloatArray:
    """Return an orthonormal basis of what is orthogonal to the columns."""
    U, sizes, _ = np.linalg.svd(vectors)
    rank = int(np.count_nonzero(sizes > _RANK_TOLERANCE * sizes.max(initial=0.0)))
    return np.asarray(U[:, rank:])
