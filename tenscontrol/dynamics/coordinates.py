"""Coordinates for control: nodes, minimal, internal.

All three are linear in the node positions around a reference shape. In the
reduced ones the mass matrix is the identity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.tangent import (
    Complement,
    bar_basis,
    laid_along_supports,
    refuse_large,
)
from tenscontrol.properties import cached_property
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.bar_geometry import refuse_wrong_bar_lengths
from tenscontrol.structure.blocks import Block, bar_rows, block_mass
from tenscontrol.structure.structure import Structure, member_vectors
from tenscontrol.structure.supports import left_by_supports, rigid_basis, rigid_motions

if TYPE_CHECKING:
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import SuperLU

# Newton's steps at most; those in an expression, which reach about 70° from the reference; and how
# far, relative to its square, a length may be off in the end.
_MOST, _STEPS, _EXACT = 30, 6, 1e-10

# Entries up to which a dense matrix multiplies as fast as a sparse one.
_SMALL = 4_000_000

# Rows up to which LAPACK factorizes a matrix sooner than SuperLU a sparse one.
_FEW = 100

KINDS = ("nodes", "minimal", "internal")


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates: a basis of node displacements about a reference shape, and its maps.

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
        ``Tᵀ M T = I``, so that q has the unit m √kg. Rows that supports hold are zero. Made when
        it is first asked for, and refused where it has more than 64 million entries.
    projection : ndarray, shape (r, d n)
        ``q = projection @ vec(δN)``, √kg; made and refused as the basis is.
    sparse_basis : csr_array, shape (d n, m)
        That of the nodes, or of the minimal coordinates y: ``T = sparse_basis @ H``, ``q = Hᵀ y``.
    """

    structure: Structure
    kind: str
    nodes: FloatArray
    sparse_basis: csr_array
    _momenta: csr_array  # (m, d n): y = momenta @ vec(δN)
    _mass: csr_array  # (n, n): M_s
    _inside: Complement | FloatArray | None = None  # H, (m, r); None for all of y
    # F, G, rows: δN is less by F G δN[rows], what feet move as one body, and on them it is zero.
    _feet: tuple[FloatArray, FloatArray, IntArray] | None = None

    __repr__ = short_repr

    @property
    def count(self) -> int:
        """Number r of coordinates."""
        held = self.sparse_basis if self._inside is None else self._inside
        return int(held.shape[1])

    @cached_property
    def basis(self) -> FloatArray:
        """T, shape (d n, r)."""
        refuse_large("the basis", (self.nodes.size, self.count))
        return frozen(self.from_sparse(self.sparse_basis.T).T)

    @cached_property
    def projection(self) -> FloatArray:
        """Shape (r, d n): ``q = projection @ vec(δN)``."""
        refuse_large("the projection", (self.count, self.nodes.size))
        projection = self.from_sparse(self._momenta)
        if self._feet is not None:
            fields, from_feet, rows = self._feet
            projection[:, rows] = 0.0
            projection[:, rows] -= (projection @ fields) @ from_feet
        return frozen(projection)

    def from_sparse(self, values: Any) -> FloatArray:
        """Return q = Hᵀ y, shape (r,) or (r, k), of coordinates y of the sparse basis.

        Parameters
        ----------
        values : ndarray or csr_array, shape (m,) or (m, k)
        """
        if isinstance(self._inside, np.ndarray):
            return np.asarray((values.T @ self._inside).T)
        dense = values.toarray() if hasattr(values, "toarray") else np.array(values)
        return dense if self._inside is None else self._inside.transposed(dense)

    @property
    def is_complete(self) -> bool:
        """Whether a shape follows from its coordinates, but for its motion as one body."""
        return self._feet is None and not isinstance(self._inside, np.ndarray)

    @property
    def is_sparse(self) -> bool:
        """Whether they are all of the minimal coordinates y but for rigid-body motions."""
        return self.kind != "nodes" and not isinstance(self._inside, np.ndarray)

    def within(self, inside: FloatArray) -> Coordinates:
        """Return fewer coordinates p, ``q = inside @ p``, with orthonormal columns, shape (r, k).

        Parameters
        ----------
        inside : ndarray, shape (r, k)
            Without unit.
        """
        of_minimal = inside if self._inside is None else self._inside @ inside
        return replace(self, _inside=frozen(np.asarray(of_minimal)))

    @cached_property
    def rigid(self) -> FloatArray:
        """Orthonormal basis, in y, of the rigid-body motions that supports leave, shape (m, k)."""
        complement = self._inside
        if not isinstance(complement, Complement):
            left = left_by_supports(self.structure, rigid_motions(self.nodes))
            complement = Complement(self._momenta @ left)
        return frozen(complement.outside)

    def to_sparse(self, q: FloatArray) -> FloatArray:
        """Return y = H q, shape (m,) or (m, k).

        Parameters
        ----------
        q : ndarray, shape (r,) or (r, k)
            m √kg.
        """
        return np.asarray(q if self._inside is None else self._inside @ q)

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
        fields = validation.float_array("displacements", displacements)
        rows = self.nodes.size
        if fields.ndim not in (1, 2) or fields.shape[0] != rows:
            raise ValueError(
                f"displacements has shape {fields.shape}, expected ({rows},) or ({rows}, k): "
                f"{', '.join('xyz'[: self.structure.dimension])} node by node"
            )
        return self._from_nodes(fields)

    def _from_nodes(self, fields: FloatArray) -> FloatArray:
        if self._is_small:
            return np.asarray(self.projection @ fields)
        if self._feet is not None:
            motions, from_feet, held = self._feet
            fields = fields - motions @ (from_feet @ fields[held])
            fields[held] = 0.0
        return self.from_sparse(self._momenta @ fields)

    @cached_property
    def _is_small(self) -> bool:
        """Whether a dense matrix is as fast as the sparse one."""
        return self.nodes.size * self.count <= _SMALL or not self.count

    def displacements(self, q: FloatArray) -> FloatArray:
        """Return ``vec(δN) = T q``, m, shape (d n,) or (d n, k).

        Parameters
        ----------
        q : ndarray, shape (r,) or (r, k)
            m √kg.
        """
        if self._is_small:
            return np.asarray(self.basis @ q)
        return np.asarray(self.sparse_basis @ self.to_sparse(q))

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
        checked = self.structure.checked_nodes
        return self.state_of(checked("nodes", nodes), checked("velocities", velocities))

    def state_of(self, nodes: FloatArray, velocities: FloatArray) -> FloatArray:
        """See :meth:`measure`: of finite arrays of the right shape, which are not checked."""
        if self.kind == "internal":
            nodes, velocities = self.laid_over(nodes, velocities)
        motion = np.concatenate([(nodes - self.nodes).T, velocities.T]).reshape(2, -1)
        return np.asarray(self._from_nodes(motion.T).T.ravel())

    def laid_over(self, nodes: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :meth:`measure`: nodes, m, and velocities, m/s, laid over the reference."""
        if len(self.structure.fixed) < 2 and not self.structure.rollers:
            turn, centre = self._alignment(nodes)
            return turn @ (nodes - centre) + self._reference[0], turn @ velocities
        if not self.is_loose:
            return nodes, velocities
        nodes, turn = laid_along_supports(self.structure, self.nodes, self._mass, nodes)
        return nodes, turn @ velocities

    def to_nodes(self, q: object, bar_length: object = None) -> FloatArray:
        """Return node positions with exact bar lengths whose coordinates are q.

        The displacement that the basis says is added, and one that q does not see, along the
        forces of the bars in the reference shape, until all lengths are exact: so
        ``measure(to_nodes(q), ...)`` gives q again. Across a bar on its own, its vector then moves
        as the basis says; bars that share nodes are solved for together by Newton's method. In
        ``"nodes"`` coordinates the displacement is added as it is.

        Parameters
        ----------
        q : array_like, shape (r,)
            m √kg; in ``"nodes"`` coordinates m.
        bar_length : array_like, shape (β,), optional
            Of bars that are driven, m; those of the structure if not given.

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
        q = validation.shaped("q", q, (self.count,), f"one per {self.kind} coordinate")
        nodes = self.nodes + self._columns(self.displacements(q))
        if self.kind == "nodes":
            return nodes
        (alone, axes), lengths = self.alone, self._lengths_of_bars(bar_length)
        vectors = member_vectors(nodes, self.structure.bars[alone])
        along = (vectors * axes).sum(axis=0)
        across = vectors - along * axes
        room = lengths[alone] ** 2 - (across**2).sum(axis=0)
        if room.size and room.min() <= 0:
            raise ValueError(
                f"q turns bar {alone[int(room.argmin())]} by a right angle or more from the "
                "reference shape, which is too far for these coordinates"
            )
        self._stretch(nodes, (np.sqrt(room) - along) * axes)
        for normal in self._normals:
            nodes = self._with_lengths(nodes, normal, lengths)
        return nodes

    def to_velocities(
        self, q: object, rates: object, bar_length: object = None, bar_length_rate: object = None
    ) -> FloatArray:
        """Return node velocities with rates q̇ that keep the bar lengths in the shape of q.

        Parameters
        ----------
        q, rates : array_like, shape (r,)
            m √kg and m √kg/s; in ``"nodes"`` coordinates m and m/s.
        bar_length, bar_length_rate : array_like, shape (β,), optional
            Of bars that are driven, m and m/s; those of the structure, and 0, if not given.

        Returns
        -------
        ndarray, shape (d, n)
            m/s.

        Raises
        ------
        ValueError
            As :meth:`to_nodes`.
        """
        return self.to_motion(q, rates, bar_length, bar_length_rate)[1]

    def to_motion(
        self, q: object, rates: object, bar_length: object = None, bar_length_rate: object = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities at once.

        Parameters
        ----------
        q, rates : array_like, shape (r,)
            As for :meth:`to_velocities`.
        bar_length, bar_length_rate : array_like, shape (β,), optional
            As for :meth:`to_velocities`.

        Returns
        -------
        nodes, velocities : ndarray, shape (d, n)
            m and m/s, as of :meth:`to_nodes` and :meth:`to_velocities`.

        Raises
        ------
        ValueError
            As :meth:`to_nodes`.
        """
        shape, ends = self.to_nodes(q, bar_length), self.structure.bars
        rates = validation.shaped("rates", rates, (self.count,), f"one per {self.kind} coordinate")
        velocities = self._columns(self.displacements(rates))
        if self.kind == "nodes":
            return shape, velocities
        (alone, axes), growth = self.alone, self._growth(bar_length, bar_length_rate)
        vectors = member_vectors(shape, ends[alone])
        change = (vectors * member_vectors(velocities, ends[alone])).sum(axis=0)
        along = (vectors * axes).sum(axis=0)
        self._stretch(velocities, (growth[alone] - change) / along * axes)
        for normal in self._normals:
            bars, rows, flat = normal.block.independent, normal.block.rows, velocities.ravel("F")
            vectors = member_vectors(shape, ends[bars])
            change = (vectors * member_vectors(velocities, ends[bars])).sum(axis=0)
            flat[rows] -= normal.displacement(normal.factors(vectors), change - growth[bars])
            velocities = self._columns(flat)
        return shape, velocities

    def _lengths_of_bars(self, bar_length: object) -> FloatArray:
        """Return the length of each bar, m."""
        if bar_length is None:
            return self.structure.bar_length
        count = len(self.structure.bars)
        lengths = validation.shaped("bar_length", bar_length, (count,), "one per bar, m")
        return validation.positive("bar_length", lengths, "length in m")

    def _growth(self, bar_length: object, bar_length_rate: object) -> FloatArray:
        """Return L L̇ of each bar, m²/s."""
        count = len(self.structure.bars)
        if bar_length_rate is None:
            return np.zeros(count)
        rate = validation.shaped("bar_length_rate", bar_length_rate, (count,), "one per bar, m/s")
        return self._lengths_of_bars(bar_length) * rate

    def displaced(self, z: Any) -> tuple[Any, Any]:
        """Return expressions of positions and velocities, (d n, 1), as the basis alone says, SX.

        Parameters
        ----------
        z : casadi.SX, shape (2r, 1)
        """
        r = self.count
        T = ca.sparsify(ca.DM(np.where(np.abs(self.basis) > 1e-14, self.basis, 0.0)))
        return ca.DM(self.nodes.ravel(order="F")) + ca.mtimes(T, z[:r]), ca.mtimes(T, z[r:])

    def kept_lengths(
        self, places: Any, rates: Any, near: Any = None, bars: tuple[Any, Any] | None = None
    ) -> tuple[Any, Any]:
        """Return expressions of positions and velocities, shape (d, n), with exact bar lengths.

        As :meth:`to_nodes` and :meth:`to_velocities`; no numbers where those raise.

        Parameters
        ----------
        places, rates : casadi.SX, shape (d n, 1)
            What :meth:`displaced` returns.
        near : casadi.SX, optional
            Symbol for :meth:`hidden`, to be put in later: expressions and their first derivatives
            are then exact, and much shorter where bars share nodes.
        bars : (casadi.SX, casadi.SX), optional
            Lengths of all bars, m, and their rates, m/s, columns, where they are driven.
        """
        structure = self.structure
        length, growth = self._driven(bars)
        shape = structure.nodes.shape
        N, V = (ca.SX(ca.reshape(entries, *shape)) for entries in (places, rates))
        share = structure.end_share
        for bar, column in zip(*self.alone[:1], self.alone[1].T, strict=True):
            start, end = structure.bars[bar].tolist()
            axis = ca.DM(column)
            vector, change = N[:, end] - N[:, start], V[:, end] - V[:, start]
            along = ca.dot(vector, axis)
            across = vector - along * axis
            reach = ca.sqrt(length[bar] ** 2 - ca.dot(across, across))
            whole = across + reach * axis
            stretch, rate = reach - along, (growth[bar] - ca.dot(whole, change)) / reach
            for node, weight in ((start, -share[bar, 0]), (end, share[bar, 1])):
                N[:, node] += weight * stretch * axis
                V[:, node] += weight * rate * axis
        if not self._joined:
            return N, V
        hidden = self.hidden(places, rates, bars) if near is None else near
        for block in self._joined:
            rows, count = block.rows.tolist(), len(block.rows)
            whole, speeds = ca.vec(N), ca.vec(V)
            corrected, displaced, faster = (hidden[k * count : (k + 1) * count] for k in range(3))
            hidden = hidden[3 * count :]
            whole[rows] += displaced
            speeds[rows] += faster
            if near is not None:
                # Nothing is left of lengths to correct, but of their derivatives.
                step = self._normal_step(block)
                _, excess, _ = self._lengths(ca.reshape(whole, *shape), block, length)
                whole[rows] -= step(corrected, excess)
                J, _, _ = self._lengths(ca.reshape(whole, *shape), block, length)
                grown = growth[block.independent.tolist()]
                speeds[rows] -= step(corrected, ca.mtimes(J, speeds[rows]) - grown)
            N, V = ca.reshape(whole, *shape), ca.reshape(speeds, *shape)
        return N, V

    def hidden(self, places: Any, rates: Any, bars: tuple[Any, Any] | None = None) -> Any:
        """Return what keeps the lengths of bars that share nodes, SX: empty where none do.

        For each block its places, and the displacements and velocities in its normal space, m and
        m/s. By a fixed number of Newton's steps; no numbers where these do not lead to the lengths.

        Parameters
        ----------
        places, rates : casadi.SX, shape (d n, 1)
        bars : (casadi.SX, casadi.SX), optional
            As for :meth:`kept_lengths`.
        """
        shape, moved, columns = self.structure.nodes.shape, places, [ca.SX(0, 1)]
        length, growth = self._driven(bars)
        for block in self._joined:
            places, rows, step = ca.SX(moved), block.rows.tolist(), self._normal_step(block)
            for _ in range(_STEPS):
                _, excess, _ = self._lengths(ca.reshape(places, *shape), block, length)
                places[rows] -= step(places[rows], excess)
            J, _, worst = self._lengths(ca.reshape(places, *shape), block, length)
            grown = growth[block.independent.tolist()]
            speeds = -step(places[rows], ca.mtimes(J, rates[rows]) - grown)
            corrected = ca.if_else(worst <= _EXACT, places[rows], np.nan)
            columns += [corrected, corrected - moved[rows], speeds]
        return ca.vertcat(*columns)

    @property
    def hidden_size(self) -> int:
        """Number of entries of :meth:`hidden`."""
        return 3 * sum(len(block.rows) for block in self._joined)

    def _driven(self, bars: tuple[Any, Any] | None) -> tuple[Any, Any]:
        """Return L and L L̇ of all bars, as expressions or numbers."""
        if bars is None:
            length = ca.DM(self.structure.bar_length)
            return length, ca.DM(*length.shape)
        return bars[0], bars[0] * bars[1]

    def _lengths(self, N: Any, block: Block, length: Any) -> tuple[Any, Any, Any]:
        """Return J and half the excess of squared lengths of a block, and the worst part, SX."""
        structure, bars = self.structure, block.independent
        square = length[bars.tolist()] ** 2
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
        entries = ca.vec(reference)
        entries[rows.tolist()] = places
        J, J_0 = (
            kernel.block_rows(self.structure, bars, rows, N)
            for N in (ca.reshape(entries, *shape), reference)
        )
        mass = ca.SX(ca.sparsify(ca.DM(block_mass(self.structure, block).toarray())))
        matrix = ca.blockcat([[mass, -J_0.T], [J, ca.SX(len(bars), len(bars))]])
        right = ca.vertcat(ca.SX.zeros(len(rows)), change)
        order, back = block.order.tolist(), np.argsort(block.order).tolist()
        solution = kernel.eliminated(matrix[order, order], right[order])[back]
        return Function("normal_step", [places, change], [solution[: len(rows)]])

    def _with_lengths(
        self, nodes: FloatArray, normal: NormalEquations, lengths: FloatArray
    ) -> FloatArray:
        """Return nodes displaced along the normal space until the bars of a block are exact."""
        block, bars = normal.block, normal.block.independent
        square, ends = lengths[bars] ** 2, self.structure.bars[bars]
        flat, best = nodes.ravel(order="F"), np.inf
        for _ in range(_MOST):
            vectors = member_vectors(nodes, ends)
            excess = ((vectors**2).sum(axis=0) - square) / 2
            off = float(np.abs(excess / square).max())
            try:
                factors = normal.factors(vectors)
            except RuntimeError:  # exactly singular
                break
            if off < _EXACT and off >= best / 2:  # round-off alone
                if normal.keeps_sides(factors):
                    return nodes
                break
            best = min(best, off)
            if not off < 1 / _EXACT:
                break
            flat[block.rows] -= normal.displacement(factors, excess)
            nodes = self._columns(flat)
        raise ValueError(
            f"q is a shape in which bars {sorted(block.bars.tolist())}, which are joined to one "
            "another, cannot keep their lengths, or would have to turn over; it is too far from "
            "the reference shape for these coordinates"
        )

    def _columns(self, flat: FloatArray) -> FloatArray:
        """Return vec(N) as columns of nodes, shape (d, n)."""
        return flat.reshape(self.structure.nodes.shape, order="F")

    def _stretch(self, columns: FloatArray, change: FloatArray) -> None:
        """Add a change to each bar on its own: half at each end, or all at the only free one."""
        bars = self.alone[0]
        share, ends = self.structure.end_share[bars], self.structure.bars[bars]
        columns[:, ends[:, 0]] -= share[:, 0] * change
        columns[:, ends[:, 1]] += share[:, 1] * change

    @cached_property
    def alone(self) -> tuple[IntArray, FloatArray]:
        """Bars that move on their own, ascending, and their axes in the reference, (d, ·)."""
        bars = np.union1d(self.structure.free_bars, self.structure.swinging_bars)
        vectors = self.structure.bar_vectors(self.nodes)[:, bars]
        return frozen(bars), frozen(vectors / np.linalg.norm(vectors, axis=0))

    @property
    def _joined(self) -> tuple[Block, ...]:
        """Blocks whose lengths are kept."""
        return () if self.kind == "nodes" else self.structure.blocks

    @cached_property
    def _normals(self) -> list[NormalEquations]:
        return [NormalEquations(self.structure, block, self.nodes) for block in self._joined]

    @cached_property
    def is_loose(self) -> bool:
        """Whether the supports leave a rigid-body motion."""
        return bool(rigid_basis(self.structure).shape[1])

    @cached_property
    def _shares(self) -> FloatArray:
        """Shares of the nodes in the centre, shape (n, 1): of mass, or the node that is fixed."""
        mass = np.asarray(self._mass.sum(axis=1)).reshape(-1, 1)
        fixed = np.arange(len(mass))[:, None] == self.structure.fixed[:1]
        return np.asarray(fixed, float) if fixed.size else np.asarray(mass / mass.sum())

    @cached_property
    def _reference(self) -> tuple[FloatArray, FloatArray]:
        """Centre of the reference shape, (d, 1), and its moments about it, (d, n)."""
        centre = self.nodes @ self._shares
        return centre, (self.nodes - centre) @ self._mass

    def _alignment(self, nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return turn and centre nearest to the reference (doi:10.1107/S0567739476001873)."""
        from scipy.linalg.lapack import dgesdd  # NumPy's takes twice as long for 3 by 3

        centre = nodes @ self._shares
        U, _, Vt, _ = dgesdd(self._reference[1] @ (nodes - centre).T)
        turn = U @ Vt
        if _is_reflection(turn):
            U[:, -1] *= -1
            turn = U @ Vt
        return turn, centre


def _is_reflection(turn: FloatArray) -> bool:
    """Return whether an orthogonal matrix is no turn; NumPy's ``det`` takes ten times as long."""
    (a, b, *c), (d, e, *f), *last = turn.tolist()
    if not last:
        return bool(a * e < b * d)
    (c,), (f,), ((g, h, i),) = c, f, last
    return bool(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) < 0)


class NormalEquations:
    """Equations of displacements of a block along its bars' forces in a reference shape.

    ``M δ = J₀ᵀ μ``, ``J δ = change``: J has half the derivatives of the squared lengths by the rows
    of the block, J₀ those of the reference. The matrix is ``[M, −J₀ᵀ; J, 0]``, sparse.
    """

    def __init__(self, structure: Structure, block: Block, reference: FloatArray) -> None:
        from scipy.sparse import block_array

        self.block = block
        J = bar_rows(structure, block.independent, reference)[:, block.rows].tocoo()
        pattern = J.copy()
        pattern.data = 1.0 + np.arange(J.nnz)
        mass = block_mass(structure, block)
        order = block.order  # in which nothing has to be sought while it is factorized
        # Which entries of the matrix are those of J, in their order there.
        numbered, self._matrix = (
            block_array(blocks, format="csc")[order][:, order]
            for blocks in ([[0 * mass, 0 * J.T], [pattern, None]], [[mass, -J.T], [J, None]])
        )
        for matrix in (numbered, self._matrix):
            matrix.sort_indices()
        self._places = np.flatnonzero(numbered.data)
        entry = numbered.data[self._places].astype(int) - 1
        row, d = block.rows[J.col[entry]], structure.dimension
        self._bar, self._axis = J.row[entry], row % d
        end = structure.bars[block.independent[self._bar], 1]
        self._side = np.where(end == row // d, 1.0, -1.0)
        self._upright = _sign(self.factors(structure.bar_vectors(reference)[:, block.independent]))

    def factors(self, vectors: FloatArray) -> SuperLU | _DenseFactors:
        """Return the factors of the matrix with these vectors of the independent bars, (d, c)."""
        from scipy.sparse.linalg import splu

        self._matrix.data[self._places] = self._side * vectors[self._axis, self._bar]
        if self._matrix.shape[0] <= _FEW:
            return _DenseFactors(self._matrix.toarray(order="F"))
        options = {"SymmetricMode": True}
        return splu(self._matrix, "NATURAL", diag_pivot_thresh=0.0, options=options)

    def displacement(self, factors: SuperLU | _DenseFactors, change: FloatArray) -> FloatArray:
        """Return the displacement of the rows of the block."""
        count, order = len(self.block.rows), self.block.order
        answer = np.append(np.zeros(count), change)
        answer[order] = factors.solve(answer[order])
        return answer[:count]

    def keeps_sides(self, factors: SuperLU | _DenseFactors) -> bool:
        """Whether no bar has turned over: the determinant has the sign of the reference."""
        return _sign(factors) == self._upright


class _DenseFactors:
    """Factors of a matrix of few rows, or RuntimeError where it is exactly singular."""

    def __init__(self, matrix: FloatArray) -> None:
        from scipy.linalg.lapack import dgetrf

        self._upper, self._swapped, zero_pivot = dgetrf(matrix, overwrite_a=True)
        if zero_pivot:
            raise RuntimeError("the matrix is exactly singular")

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the solution for a right-hand side."""
        from scipy.linalg.lapack import dgetrs

        return np.asarray(dgetrs(self._upper, self._swapped, right)[0])

    def sign(self) -> float:
        """Return the sign of the determinant."""
        swaps = np.count_nonzero(self._swapped != np.arange(len(self._swapped)))
        return float(np.sign(self._upper.diagonal()).prod() * (-1.0) ** swaps)


def _sign(factors: SuperLU | _DenseFactors) -> float:
    """Return the sign of the determinant of a factorized matrix."""
    if isinstance(factors, _DenseFactors):
        return factors.sign()
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    sign = np.sign(factors.U.diagonal()).prod()
    for order in (factors.perm_r, factors.perm_c):
        count = len(order)
        cycles = csr_array((np.ones(count), order, np.arange(count + 1)), shape=(count, count))
        sign *= (-1.0) ** (count - connected_components(cycles)[0])
    return float(sign)


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
        bar constraints. ``"internal"``: minimal less rigid-body motion that the supports leave.

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
    validation.instance("model", model, Model, "make one by Model(structure)")
    structure = model.structure
    N = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    validation.choice("kind", kind, KINDS)
    refuse_wrong_bar_lengths("nodes", structure, N)
    from scipy.sparse import csr_array, eye_array, kron

    mass, inside = model.mass_matrix(), None
    if kind == "nodes":
        basis = csr_array(eye_array(N.size, format="csc")[:, structure.free_rows])
        to_minimal = csr_array(basis.T)
    else:
        basis = bar_basis(structure, N)
        to_minimal = csr_array(basis.T @ kron(mass, eye_array(structure.dimension), format="csr"))
        if kind == "internal":
            inside = Complement(to_minimal @ left_by_supports(structure, rigid_motions(N)))
    return Coordinates(structure, kind, frozen(N), basis, to_minimal, mass, inside)
