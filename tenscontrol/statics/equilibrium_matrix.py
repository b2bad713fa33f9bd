"""The equilibrium matrix: nodal forces as a linear function of the force densities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.structure import Structure, is_movable
from tenscontrol.validation import FloatArray, instance, refuse_memory

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Singular values below this fraction of the largest count as zero: far above round-off, far below
# what a real member contributes.
_RANK_TOLERANCE = 1e-9

# A segment shorter than this part of its string has no direction to pull in.
_NO_LENGTH = 1e-12


def equilibrium_matrix(structure: Structure, nodes: object = None) -> FloatArray:
    """Return E with ``vec(N K_s) = E [γ; λ]``: what the members need as load to be at rest.

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
    instance("structure", structure, Structure, "make one by Structure(...) or prism(...)")
    N = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    alpha, beta = len(structure.strings), len(structure.bars)
    d, n = N.shape
    size = f"structure has {n} nodes and {alpha + beta} members"
    refuse_memory(size, N.size * (alpha + beta), "numbers in its equilibrium matrix", 8)
    E = np.zeros((n, d, alpha + beta))
    # A string pulls its ends together, a bar pushes them apart.
    pulls = -structure.string_vectors(N) * segment_share(structure, N)
    vectors = np.hstack([pulls, structure.bar_vectors(N)]).T
    start, end = np.vstack([structure.segments, structure.bars]).T
    members = np.concatenate([structure.segment_string, alpha + np.arange(beta)])
    if structure.has_clusters:  # a string may have several segments at a node
        axes = np.arange(d)
        np.add.at(E, (start[:, None], axes, members[:, None]), vectors)
        np.add.at(E, (end[:, None], axes, members[:, None]), -vectors)
    else:
        E[start, :, members] += vectors
        E[end, :, members] -= vectors
    return E.reshape(-1, alpha + beta)


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
    _, sizes, Vt = np.linalg.svd(matrix)
    return np.asarray(Vt[matrix_rank(sizes) if rank is None else rank :].T)


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
    d = structure.dimension
    centred = structure.nodes - structure.nodes.mean(axis=1, keepdims=True)
    axes = np.eye(d)
    if not structure.rollers:
        axes = np.linalg.svd(np.linalg.qr(centred.T, mode="r"))[2]
    sizes = np.linalg.norm(axes @ centred, axis=1)
    return axes, np.where(sizes > _RANK_TOLERANCE * sizes.max(), sizes, sizes.max() or 1.0)


def affine_picture(structure: Structure) -> csr_array:
    """Return P, shape (f, f): ``P E`` is E of an affine picture as long in all directions.

    A flat or slender shape loses no digits in it. Forces F are pictured as ``P F``, and motions of
    the picture are those of the shape by ``Pᵀ``. With rollers, the directions are x, y and z.
    """
    from scipy.sparse import csr_array

    axes, sizes = picture_axes(structure)
    d, rows = structure.dimension, structure.free_rows
    place = np.full(structure.nodes.size, -1)
    place[rows] = np.arange(len(rows))
    columns = place[(rows - rows % d)[:, None] + np.arange(d)]
    kept = columns >= 0
    values = (axes / sizes[:, None])[rows % d]
    ends = np.concatenate([[0], np.cumsum(kept.sum(axis=1))])
    return csr_array((values[kept], columns[kept], ends), shape=(len(rows), len(rows)))


def member_basis(
    picture: csr_array, E: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return U, sizes and Vᵀ of columns of the equilibrium matrix, and the lengths of columns.

    E has the rows of the free coordinates. The rank is the same in every affine picture of the
    shape, so it is counted in one that is as long in all directions, with members of length 1.
    """
    pictured = picture @ E
    length = np.linalg.norm(pictured, axis=0)
    length = np.where(length > 0, length, 1.0)
    U, sizes, Vt = np.linalg.svd(pictured / length)
    return U, sizes, Vt, length


@dataclass(frozen=True, eq=False)
class MemberForces:
    """Force densities of the k movable members, strings first: ``particular + states @ x``.

    Members between two fixed nodes are part of the support, and fixed nodes take any force.
    """

    live: np.ndarray  # (α + β,), which members are movable
    matrix: FloatArray  # (f, k), E of these members and the free coordinates
    sizes: FloatArray  # its singular values, in the picture
    states: FloatArray  # (k, ·), orthonormal states of self-stress
    particular: FloatArray  # (k,), the least γ and λ that balance the load best

    @property
    def rank(self) -> int:
        """Rank of the matrix."""
        return int(self.matrix.shape[1] - self.states.shape[1])


def movable_members(structure: Structure) -> np.ndarray:
    """Return which strings, then bars, have a free end, shape (α + β,)."""
    pieces = is_movable(structure, structure.segments)
    strings = np.bincount(structure.segment_string, pieces, minlength=len(structure.strings)) > 0
    return np.concatenate([strings, is_movable(structure, structure.bars)])


def member_forces(structure: Structure, load: FloatArray) -> MemberForces:
    """Return the force densities that balance a load on the free coordinates, shape (f,)."""
    live = movable_members(structure)
    rows, count = len(structure.free_rows), int(live.sum())
    size = f"structure has {rows} free coordinates and {count} members"
    refuse_memory(size, (rows + count) ** 2, "numbers in E and its singular vectors", 8)
    E = equilibrium_matrix(structure)[structure.free_rows][:, live]
    picture = affine_picture(structure)
    U, sizes, Vt, length = member_basis(picture, E)
    rank = matrix_rank(sizes)
    states = np.linalg.qr(Vt[rank:].T / length[:, None])[0]
    particular = Vt[:rank].T @ ((U[:, :rank].T @ (picture @ load)) / sizes[:rank]) / length
    particular -= states @ (states.T @ particular)
    return MemberForces(live, E, sizes, states, particular)
