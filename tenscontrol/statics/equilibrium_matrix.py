"""The equilibrium matrix: nodal forces as a linear function of the force densities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.properties import cached_property
from tenscontrol.statics.inertia import Factors, held_factors, nearly_null
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import is_movable, left_by_supports, rigid_motions

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_array

# Singular values below this fraction of the largest count as zero: far above round-off, far below
# what a real member contributes.
_RANK_TOLERANCE = 1e-9

# Pivots up to this part of their diagonal entry are zero where no other is doubtful, and random
# motions that are looked at to be sure.
_CLEAR, _PROBES = 1e-12, 8

# A matrix of no more entries is decomposed whole, by singular values, faster than by its zeros.
_FEW = 100_000

# Added where dependent members would make a least-squares problem singular, and singular values of
# motions that are fitted once more, without squares.
_REGULAR, _NEAR = 1e-13, 1e-5

# The same for the least of many solutions, and its iterations.
_GIVE, _REFINEMENTS = 1e-6, 100

# Power iterations for the largest singular value.
_POWERS = 20

# Extents of a shape that differ by less than this factor are alike, and an axis with less than this
# part along x, y or z is across it.
_ALIKE, _ALONG = 2.0, 1e-12

# A segment shorter than this part of its string has no direction to pull in.
_NO_LENGTH = 1e-12


def equilibrium_matrix(structure: Structure, nodes: object = None) -> FloatArray:
    """Return the equilibrium matrix E: ``vec(N K_s) = E [γ; λ]`` is the load in equilibrium.

    Parameters
    ----------
    structure : Structure
    nodes : array_like, shape (d, n), optional
        Node positions, m; the reference shape if not given.

    Returns
    -------
    ndarray, shape (d n, α + β)
        Columns are the strings (γ, tension positive), then the bars (λ,
        compression positive), m. Rows are node by node: x1 y1 z1 x2 …. The
        members are at rest under a load W when ``E [γ; λ] = vec(W)``. The column of a clustered
        string is the sum of those of its segments, each by L/l: γ is T/L.

    Raises
    ------
    ValueError
        If ``nodes`` does not fit.

    Notes
    -----
    Goyal & Skelton, eq. (7) with N̈ = 0 and K_s from eq. (9).

    Examples
    --------
    A prism has 12 members and 18 coordinates. Rank 11 leaves one state of
    self-stress, and 18 − 6 − 11 = 1 mechanism:

    >>> import numpy as np, tenscontrol as tc
    >>> E = tc.statics.equilibrium_matrix(tc.prism())
    >>> E.shape, int(np.linalg.matrix_rank(E))
    ((18, 12), 11)
    """
    validation.instance(
        "structure", structure, Structure, "make one by Structure(...) or prism(...)"
    )
    N = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    count = len(structure.strings) + len(structure.bars)
    size = f"structure has {N.shape[1]} nodes and {count} members"
    validation.refuse_memory(size, N.size * count, "numbers in its equilibrium matrix", 8)
    return np.asarray(sparse_equilibrium_matrix(structure, N).toarray())


def sparse_equilibrium_matrix(structure: Structure, nodes: FloatArray) -> csc_array:
    """Return the equilibrium matrix, sparse."""
    from scipy.sparse import csc_array

    alpha, beta = len(structure.strings), len(structure.bars)
    d, n = nodes.shape
    # A string pulls its ends together, a bar pushes them apart.
    pulls = -structure.string_vectors(nodes) * segment_share(structure, nodes)
    vectors = np.hstack([pulls, structure.bar_vectors(nodes)]).T
    rows = d * np.vstack([structure.segments, structure.bars])[:, :, None] + np.arange(d)
    values = np.stack([vectors, -vectors], axis=1)
    members = np.concatenate([structure.segment_string, alpha + np.arange(beta)])
    columns = np.broadcast_to(members[:, None, None], rows.shape)
    # A clustered string may have several segments at a node: they are added.
    return csc_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=(d * n, alpha + beta))


def segment_share(structure: Structure, nodes: FloatArray) -> FloatArray:
    """Return γ of each segment per γ = T/L of its string, shape (s,): L/l, 1 if not clustered."""
    if not structure.has_clusters:
        return np.ones(len(structure.strings))
    length = np.linalg.norm(structure.string_vectors(nodes), axis=0)
    total = structure.string_length(nodes)[structure.segment_string]
    # A segment without length pulls nowhere.
    return np.asarray(total / np.maximum(length, _NO_LENGTH * total))


def null_space(matrix: FloatArray, rank: int | None = None) -> FloatArray:
    """Return an orthonormal basis of the null space, shape (columns, nullity)."""
    _, sizes, Vt = np.linalg.svd(matrix, full_matrices=len(matrix) < matrix.shape[1])
    return np.asarray(Vt[matrix_rank(sizes) if rank is None else rank :].T)


def orthogonal_part(basis: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the part of vectors that is orthogonal to a basis, which is orthonormal."""
    return np.asarray(vectors - basis @ (basis.T @ vectors))


def matrix_rank(sizes: FloatArray) -> int:
    """Return the number of singular values above round-off."""
    return int(np.count_nonzero(sizes > _RANK_TOLERANCE * sizes.max(initial=0.0)))


def principal_axes(structure: Structure, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Return directions in which the structure extends, shape (d, e), and how far, m, (e,)."""
    centred = structure.nodes - structure.nodes.mean(axis=1, keepdims=True)
    axes, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    extends = sizes > tolerance * sizes[0]
    return axes[:, extends], sizes[extends]


def picture_axes(structure: Structure) -> tuple[FloatArray, FloatArray]:
    """Return the axes of the affine picture, one a row, and how far the shape extends, m, (d,)."""
    centred = structure.nodes - structure.nodes.mean(axis=1, keepdims=True)
    axes = np.eye(structure.dimension)
    if not structure.rollers:
        axes = np.linalg.svd(np.linalg.qr(centred.T, mode="r"))[2]
        axes = _along_coordinates(axes, np.linalg.norm(axes @ centred, axis=1))
    sizes = np.linalg.norm(axes @ centred, axis=1)
    return axes, np.where(sizes > _RANK_TOLERANCE * sizes.max(), sizes, sizes.max() or 1.0)


def _along_coordinates(axes: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return axes of which those with like extents, descending, are turned towards x, y and z.

    Any do where the shape is as long. Along the strings of a net they leave an equation for each
    direction, with few entries, where round-off would choose them across.
    """
    from scipy.linalg import qr

    ends = np.flatnonzero(sizes[1:] < sizes[:-1] / _ALIKE) + 1
    alike = np.split(axes, ends)
    turned = np.vstack([qr(own.T @ own, pivoting=True)[0][:, : len(own)].T for own in alike])
    return np.where(np.abs(turned) > _ALONG, turned, 0.0)


def affine_picture(structure: Structure) -> csr_array:
    """Return P, shape (f, f): ``P E`` is E of an affine picture as long in all directions.

    A flat or slender shape loses no digits in it. Forces F are pictured as ``P F``, and motions of
    the picture are those of the shape by ``Pᵀ``. With rollers, the directions are x, y and z.
    """
    from scipy.sparse import csr_array

    axes, sizes = picture_axes(structure)
    d, rows = structure.dimension, structure.free_rows
    index = np.full(structure.nodes.size, -1)
    index[rows] = np.arange(len(rows))
    columns = index[(rows - rows % d)[:, None] + np.arange(d)]
    kept = columns >= 0
    values = (axes / sizes[:, None])[rows % d]
    ends = np.concatenate([[0], np.cumsum(kept.sum(axis=1))])
    return csr_array((values[kept], columns[kept], ends), shape=(len(rows), len(rows)))


def rigid_picture(structure: Structure, picture: csr_array) -> FloatArray:
    """Return an orthonormal basis, shape (f, ·), of the rigid-body motions in the picture."""
    # A motion v of the shape is (P Pᵀ)⁻¹ P v in the picture, where motions are well apart.
    axes = picture_axes(structure)[0]
    body = rigid_motions(axes @ structure.nodes)
    body = np.einsum("ij,nik->njk", axes, body.reshape(-1, len(axes), body.shape[1]))
    body = left_by_supports(structure, body.reshape(structure.nodes.size, -1))
    pictured = (picture @ body[structure.free_rows]) / picture.multiply(picture).sum(axis=1)[
        :, None
    ]
    pictured /= np.maximum(np.linalg.norm(pictured, axis=0), np.finfo(float).tiny)
    pictured, extents, _ = np.linalg.svd(pictured, full_matrices=False)
    return np.asarray(pictured[:, extents > _RANK_TOLERANCE * extents.max(initial=0.0)])


def pictured_members(picture: csr_array, E: csc_array) -> tuple[csc_array, FloatArray]:
    """Return ``P E`` with columns of length 1, or 0, and the lengths that they had, or 1."""
    from scipy.sparse import csc_array, diags_array

    pictured = csc_array(picture @ E)
    length = np.sqrt(pictured.multiply(pictured).sum(axis=0))
    length = np.where(length > 0, length, 1.0)
    return csc_array(pictured @ diags_array(1 / length)), length


def is_small(E: csc_array) -> bool:
    """Return whether a matrix is decomposed whole."""
    return bool(E.shape[0] * E.shape[1] <= _FEW)


@dataclass(frozen=True, eq=False)
class KeptLengths:
    """Motions of the affine picture that keep the lengths of members, to first order.

    The rank of the equilibrium matrix is the same in every affine picture of the shape, so it is
    counted in one that is as long in all directions, with members of length 1.
    """

    motions: FloatArray  # (f, ·), orthonormal; those as one body are among them
    least: float  # the least singular value that counts, part of the largest
    lost: float  # the largest that does not

    @property
    def rank(self) -> int:
        """Rank of the equilibrium matrix of the members."""
        return int(self.motions.shape[0] - self.motions.shape[1])


def kept_lengths(structure: Structure, picture: csr_array, E: csc_array) -> KeptLengths:
    """Return the motions that keep lengths, of E with the rows of the free coordinates.

    A large matrix is not decomposed: the pivots of ``E Eᵀ`` show where motions may be, inverse
    iteration finds them, and how much they change lengths decides.
    """
    pictured, _ = pictured_members(picture, E)
    if is_small(E):
        U, sizes, _ = np.linalg.svd(pictured.toarray())
        rank = matrix_rank(sizes)
        relative = sizes / sizes.max(initial=np.finfo(float).tiny)
        least = float(relative[:rank].min(initial=1.0))
        return KeptLengths(U[:, rank:], least, float(relative[rank:].max(initial=0.0)))
    body = rigid_picture(structure, picture)
    motions = nearly_null(possible_mechanisms(structure, picture, E))
    motions, relative = _by_lengths(pictured, body, motions)
    near = relative < _NEAR
    if near.any():
        again, exact = _by_lengths(pictured, body, _fitted(pictured, motions[:, near]))
        motions, relative = again, np.concatenate([exact, relative[~near]])
    count = np.count_nonzero(relative <= _RANK_TOLERANCE)
    relative.sort()
    return KeptLengths(
        np.hstack([body, motions[:, :count]]),
        float(relative[count:].min(initial=1.0)),
        float(relative[:count].max(initial=0.0)),
    )


def clear_motions(structure: Structure, picture: csr_array, E: csc_array) -> int | None:
    """Return how many motions keep lengths where pivots of ``E Eᵀ`` are clear, or None.

    They are clear where each is zero, or far from it; and random motions out of those behind the
    zeros keep lengths, which they would not if one of them did not. No basis is made.
    """
    factors = possible_mechanisms(structure, picture, E)
    doubtful, pivots = factors.doubtful, np.abs(factors.pivots)
    if pivots[doubtful].max(initial=0.0) > _CLEAR:
        return None
    start = np.zeros((len(pivots), _PROBES))
    start[doubtful] = np.random.default_rng(0).normal(size=(len(doubtful), _PROBES))
    motions = factors.scale[:, None] * factors.lu.solve(start)
    rates = pictured_members(picture, E)[0].T @ motions
    changes = np.linalg.norm(rates, axis=0) * np.sqrt(len(doubtful))
    if (changes > _RANK_TOLERANCE * np.linalg.norm(motions, axis=0)).any():
        return None
    return len(doubtful) + int(rigid_picture(structure, picture).shape[1])


def possible_mechanisms(structure: Structure, picture: csr_array, E: csc_array) -> Factors:
    """Return the factors of ``E Eᵀ`` in the picture: mechanisms are behind doubtful pivots."""
    pictured, _ = pictured_members(picture, E)
    squares = (pictured @ pictured.T).tocsc()
    body = rigid_picture(structure, picture)
    return held_factors(squares, body, _RANK_TOLERANCE**2 * squares.diagonal().max())


def _by_lengths(
    pictured: csc_array, body: FloatArray, motions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return orthonormal motions without those as one body, and how much each changes lengths.

    Ascending, as parts of the largest singular value.
    """
    for _ in range(2):
        motions = np.linalg.qr(orthogonal_part(body, motions))[0]
    rates = pictured.T @ motions
    _, singular, Vt = np.linalg.svd(rates, full_matrices=len(rates) < rates.shape[1])
    sizes = np.zeros(len(Vt))
    sizes[: len(singular)] = singular
    vector = np.cos(np.arange(1.0, len(motions) + 1) ** 2)  # any
    for _ in range(_POWERS):
        vector = pictured @ (pictured.T @ (vector / np.linalg.norm(vector)))
    return motions @ Vt[::-1].T, sizes[::-1] / np.sqrt(np.linalg.norm(vector))


def _fitted(pictured: csc_array, motions: FloatArray) -> FloatArray:
    """Return what is left of motions when a least-squares fit by columns is taken away."""
    from scipy.sparse import block_array, eye_array
    from scipy.sparse.linalg import splu

    count, k = pictured.shape
    saddle = [[eye_array(count), pictured], [pictured.T, -_REGULAR * eye_array(k)]]
    right = np.vstack([motions, np.zeros((k, motions.shape[1]))])
    return np.asarray(splu(block_array(saddle, format="csc")).solve(right)[:count])


def movable_members(structure: Structure) -> np.ndarray:
    """Return which strings, then bars, have a free end, shape (α + β,)."""
    pieces = is_movable(structure, structure.segments)
    strings = np.bincount(structure.segment_string, pieces, minlength=len(structure.strings)) > 0
    return np.concatenate([strings, is_movable(structure, structure.bars)])


@dataclass(frozen=True, eq=False)
class MemberForces:
    """Force densities of the k movable members, strings first: ``particular + states @ x``.

    Members between two fixed nodes are part of the support, and fixed nodes take any force.
    """

    structure: Structure
    live: np.ndarray  # (α + β,), which members are movable
    matrix: csc_array  # (f, k), E of these members and the free coordinates
    load: FloatArray  # (f,)

    @cached_property
    def _whole(self) -> tuple[FloatArray, FloatArray, float]:
        """States, particular and the least singular value, by the decomposition of all of E."""
        rows, count = self.matrix.shape
        size = f"structure has {rows} free coordinates and {count} members"
        validation.refuse_memory(
            size, (rows + count) ** 2, "numbers in E and its singular vectors", 8
        )
        picture = affine_picture(self.structure)
        pictured, length = pictured_members(picture, self.matrix)
        U, sizes, Vt = np.linalg.svd(pictured.toarray())
        rank = matrix_rank(sizes)
        states = np.linalg.qr(Vt[rank:].T / length[:, None])[0]
        balance = (U[:, :rank].T @ (picture @ self.load)) / sizes[:rank]
        particular = Vt[:rank].T @ balance / length
        particular -= states @ (states.T @ particular)
        return states, particular, float(sizes[-1] / sizes[0]) if len(sizes) else 1.0

    @property
    def states(self) -> FloatArray:
        """Orthonormal states of self-stress, shape (k, ·), not sparse."""
        return self._whole[0]

    @property
    def particular(self) -> FloatArray:
        """The least γ and λ that balance the load best, shape (k,)."""
        if is_small(self.matrix):
            return self._whole[1]
        return least_norm(self.matrix, self.load, _REGULAR)

    @cached_property
    def kept(self) -> KeptLengths:
        """The motions that keep all lengths."""
        return kept_lengths(self.structure, affine_picture(self.structure), self.matrix)

    @cached_property
    def rank(self) -> int:
        """Rank of the matrix."""
        if is_small(self.matrix):
            return int(self.matrix.shape[1] - self.states.shape[1])
        count = clear_motions(self.structure, affine_picture(self.structure), self.matrix)
        return self.kept.rank if count is None else self.matrix.shape[0] - count

    @property
    def least(self) -> float:
        """Least singular value that counts, part of the largest."""
        return self._whole[2] if is_small(self.matrix) else self.kept.least


def least_norm(matrix: csc_array, right: FloatArray, give: float = _GIVE) -> FloatArray:
    """Return the least x that solves ``A x = b`` best, A sparse, by iterated regularization.

    Singular values below the square root of ``give`` take many iterations; with less of it, x is
    less exact where columns are dependent.
    """
    from scipy.sparse import block_array, eye_array
    from scipy.sparse.linalg import splu

    rows, columns = matrix.shape
    size = np.sqrt(matrix.multiply(matrix).sum(axis=0).max(initial=0.0)) or 1.0
    A, x, before = matrix / size, np.zeros(columns), np.inf
    saddle = [[eye_array(rows), A], [A.T, -give * eye_array(columns)]]
    factors = splu(block_array(saddle, format="csc"))
    for _ in range(_REFINEMENTS):
        left = np.concatenate([right - A @ x, np.zeros(columns)])
        change = factors.solve(left)[rows:]
        most = float(np.abs(change).max(initial=0.0))
        if most >= before:
            break
        x, before = x + change, most
    return np.asarray(x / size)


def member_forces(structure: Structure, load: FloatArray) -> MemberForces:
    """Return the force densities that balance a load on the free coordinates, shape (f,)."""
    live = movable_members(structure)
    E = sparse_equilibrium_matrix(structure, structure.nodes).tocsr()[structure.free_rows]
    return MemberForces(structure, live, E.tocsc()[:, live], load)
