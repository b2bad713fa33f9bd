"""Coordinates for control: nodes, minimal, internal.

All three are linear in the node positions around a reference shape. In the
reduced ones the mass matrix is the identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tenscontrol.dynamics.model import Model
from tenscontrol.structure import (
    Structure,
    left_by_supports,
    refuse_wrong_bar_lengths,
    rigid_motions,
)
from tenscontrol.validation import FloatArray, choice, float_array, frozen, instance, shaped

# Directions whose singular value is below this fraction of the largest do not exist.
_RANK_TOLERANCE = 1e-9

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
    nodes : ndarray, shape (3, n)
        Reference shape, m.
    basis : ndarray, shape (3n, r)
        T: a displacement is ``vec(δN) = T q``. In reduced coordinates
        ``Tᵀ M T = I``, so that q has the unit m √kg. Rows of fixed nodes are zero.
    """

    structure: Structure
    kind: str
    nodes: FloatArray
    basis: FloatArray
    _projection: FloatArray  # (r, 3n): q = projection @ vec(δN)
    _mass: FloatArray  # (n, n): M_s

    @property
    def count(self) -> int:
        """Number r of coordinates."""
        return int(self.basis.shape[1])

    def project(self, displacements: object) -> FloatArray:
        """Return the coordinates of node displacements, ``q = Tᵀ M vec(δN)``.

        Parameters
        ----------
        displacements : array_like, shape (3n,) or (3n, k)
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
                "x, y, z node by node"
            )
        return np.asarray(self._projection @ fields)

    def measure(self, nodes: object, velocities: object) -> FloatArray:
        """Return the reduced state ``z = [q; q̇]`` of a motion.

        In internal coordinates the shape is first laid over the reference as
        well as a rigid motion can, so that a structure that has travelled or
        turned is measured as one that has not.

        Parameters
        ----------
        nodes : array_like, shape (3, n)
            Node positions, m.
        velocities : array_like, shape (3, n)
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
        if self.kind == "internal" and len(self.structure.fixed) < 2:
            turn, centre = self._alignment(N)
            N = turn @ (N - centre) + self._centre(self.nodes)
            V = turn @ V
        q = self._projection @ (N - self.nodes).ravel(order="F")
        return np.concatenate([q, self._projection @ V.ravel(order="F")])

    def to_nodes(self, q: object) -> FloatArray:
        """Return node positions with exact bar lengths whose coordinates are q.

        Across the bar, a bar vector moves as the basis says; along it, so that
        its length stays. So ``measure(to_nodes(q), ...)`` gives q again. In
        ``"nodes"`` coordinates the displacement is added as it is.

        Parameters
        ----------
        q : array_like, shape (r,)

        Returns
        -------
        ndarray, shape (3, n)
            m.

        Raises
        ------
        ValueError
            If q does not fit, or turns a bar by a right angle or more.
        """
        q = shaped("q", q, (self.count,), f"one per {self.kind} coordinate")
        nodes = self.nodes + (self.basis @ q).reshape(3, -1, order="F")
        if self.kind == "nodes":
            return nodes
        length = self.structure.bar_length
        vectors = self.structure.bar_vectors(nodes)
        along = (vectors * self._axes).sum(axis=0)
        across = vectors - along * self._axes
        room = length**2 - (across**2).sum(axis=0)
        if room.size and room.min() <= 0:
            raise ValueError(
                f"q turns bar {int(room.argmin())} by a right angle or more from the reference "
                "shape; these coordinates do not reach so far"
            )
        self._stretch(nodes, (np.sqrt(room) - along) * self._axes)
        return nodes

    def to_velocities(self, q: object, rates: object) -> FloatArray:
        """Return node velocities with rates q̇ that keep the bar lengths in the shape of q.

        Parameters
        ----------
        q, rates : array_like, shape (r,)

        Returns
        -------
        ndarray, shape (3, n)
            m/s.

        Raises
        ------
        ValueError
            As :meth:`to_nodes`.
        """
        shape = self.to_nodes(q)
        rates = shaped("rates", rates, (self.count,), f"one per {self.kind} coordinate")
        velocities = (self.basis @ rates).reshape(3, -1, order="F")
        if self.kind == "nodes":
            return velocities
        vectors = self.structure.bar_vectors(shape)
        change = self.structure.bar_vectors(velocities)
        along = (vectors * self._axes).sum(axis=0)
        self._stretch(velocities, -(vectors * change).sum(axis=0) / along * self._axes)
        return velocities

    def _stretch(self, columns: FloatArray, change: FloatArray) -> None:
        """Add a change to each bar vector: half at each end, or all of it at the only free one."""
        share = self.structure.end_share
        columns[:, self.structure.bars[:, 0]] -= share[:, 0] * change
        columns[:, self.structure.bars[:, 1]] += share[:, 1] * change

    @cached_property
    def _axes(self) -> FloatArray:
        vectors = self.structure.bar_vectors(self.nodes)
        return np.asarray(vectors / np.linalg.norm(vectors, axis=0))

    def _centre(self, nodes: FloatArray) -> FloatArray:
        if len(self.structure.fixed):
            return nodes[:, self.structure.fixed[:1]]
        weights = self._mass.sum(axis=1)
        return np.asarray(nodes @ weights / weights.sum())[:, None]

    def _alignment(self, nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the turn and the centre of mass that lay the shape over the reference.

        The rotation nearest in the metric of the kinetic energy (Kabsch 1976,
        doi:10.1107/S0567739476001873): at the optimum the displacement has no
        part along a rigid motion.
        """
        centre = self._centre(nodes)
        spread = (self.nodes - self._centre(self.nodes)) @ self._mass @ (nodes - centre).T
        U, _, Vt = np.linalg.svd(spread)
        U[:, 2] *= np.linalg.det(U @ Vt)
        return U @ Vt, centre


def coordinates(model: Model, nodes: object = None, kind: str = "internal") -> Coordinates:
    """Return coordinates of a structure around a reference shape.

    Parameters
    ----------
    model : Model
    nodes : array_like, shape (3, n), optional
        Reference shape, m; that of the structure if not given.
    kind : {"internal", "minimal", "nodes"}
        ``"nodes"``: 3n coordinates, the node positions themselves. ``"minimal"``: 5 a bar and 3 a
        string node, without bar-length changes. ``"internal"``: minimal less rigid-body motion.

    Raises
    ------
    ValueError
        If ``nodes`` does not fit or ``kind`` is another word.

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
    """Return the mass-orthonormal basis of motions that keep bar lengths, shape (3n, r).

    In closed form, bar by bar: three translations ``e/√m`` and two rotations in which the ends
    move by ``∓ t √(3/m)`` across the bar; for a bar that swings about a fixed end two rotations
    ``t √(3/m)`` of the other; three translations ``e/√m_s`` for a string node.
    """
    blocks: list[tuple[list[int], FloatArray]] = []
    for i in structure.free_bars:
        start, end = structure.bars[i].tolist()
        mass = structure.bar_mass[i]
        across = _across(nodes[:, end] - nodes[:, start]) * np.sqrt(3 / mass)
        shift = np.eye(3) / np.sqrt(mass)
        blocks.append(
            ([start, end], np.array([np.hstack([shift, part]) for part in (-across, across)]))
        )
    for i, (hinge, tip) in zip(
        structure.swinging_bars, structure.hinged_pairs.tolist(), strict=True
    ):
        across = _across(nodes[:, tip] - nodes[:, hinge]) * np.sqrt(3 / structure.bar_mass[i])
        blocks.append(([tip], across[None]))
    for point, mass in zip(structure.string_nodes, structure.string_node_mass, strict=True):
        blocks.append(([int(point)], np.eye(3)[None] / np.sqrt(mass)))
    count = sum(block.shape[2] for _, block in blocks)
    basis = np.zeros((nodes.shape[1], 3, count))
    column = 0
    for places, block in blocks:
        basis[places, :, column : column + block.shape[2]] = block
        column += block.shape[2]
    return basis.reshape(3 * nodes.shape[1], -1)


def _across(vector: FloatArray) -> FloatArray:
    """Return two orthonormal directions across a vector, shape (3, 2)."""
    return np.asarray(np.linalg.svd(vector[None, :])[2][1:].T)


def _momenta(mass: object, basis: FloatArray) -> FloatArray:
    """Return M T: the mass matrix acts alike on x, y and z."""
    n = basis.shape[0] // 3
    return np.asarray(mass @ basis.reshape(n, -1)).reshape(basis.shape)  # type: ignore[operator]


def _complement(vectors: FloatArray) -> FloatArray:
    """Return an orthonormal basis of what is orthogonal to the columns."""
    U, sizes, _ = np.linalg.svd(vectors)
    rank = int(np.count_nonzero(sizes > _RANK_TOLERANCE * sizes.max(initial=0.0)))
    return np.asarray(U[:, rank:])
