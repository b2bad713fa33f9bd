"""The equilibrium matrix: nodal forces as a linear function of the force densities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.limits import refuse_memory
from tenscontrol.structure import Structure, is_movable
from tenscontrol.validation import FloatArray, instance

# Singular values below this fraction of the largest count as zero: far above round-off, far below
# what a real member contributes.
_RANK_TOLERANCE = 1e-9


def equilibrium_matrix(structure: Structure, nodes: object = None) -> FloatArray:
    """Return E with ``vec(N K_s) = E [γ; λ]``: what the members need as load to be at rest.

    Parameters
    ----------
    structure : Structure
    nodes : array_like, shape (3, n), optional
        Node positions, m; the reference shape if not given.

    Returns
    -------
    ndarray, shape (3n, α + β)
        Columns are the strings (γ, tension positive), then the bars (λ,
        compression positive), m. Rows are node by node: x1 y1 z1 x2 …. The
        members are at rest under a load W when ``E [γ; λ] = vec(W)``.

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
    size = f"structure has {N.shape[1]} nodes and {alpha + beta} members"
    refuse_memory(size, N.size * (alpha + beta), "numbers in its equilibrium matrix", 8)
    E = np.zeros((N.shape[1], 3, alpha + beta))
    # A string pulls its ends together, a bar pushes them apart.
    vectors = np.hstack([-structure.string_vectors(N), structure.bar_vectors(N)]).T
    start, end = np.vstack([structure.strings, structure.bars]).T
    members = np.arange(alpha + beta)
    E[start, :, members] += vectors
    E[end, :, members] -= vectors
    return E.reshape(-1, alpha + beta)


def null_space(matrix: FloatArray, rank: int | None = None) -> FloatArray:
    """Return an orthonormal basis of the null space, shape (columns, nullity)."""
    _, sizes, Vt = np.linalg.svd(matrix)
    return np.asarray(Vt[_rank(sizes) if rank is None else rank :].T)


def _rank(sizes: FloatArray) -> int:
    return int(np.count_nonzero(sizes > _RANK_TOLERANCE * sizes.max(initial=0.0)))


def principal_axes(structure: Structure, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Return directions in which the structure extends, shape (3, d), and how far, m, (d,)."""
    centred = structure.nodes - structure.nodes.mean(axis=1, keepdims=True)
    axes, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    extends = sizes > tolerance * sizes[0]
    return axes[:, extends], sizes[extends]


def member_rank(structure: Structure, E: FloatArray) -> int:
    """Return the rank of columns of the equilibrium matrix, for the free coordinates.

    It is the same in every affine picture of the shape, so it is counted in one that is as long in
    all directions, with members of length 1: a flat or slender shape loses no digits.
    """
    axes, sizes = principal_axes(structure, _RANK_TOLERANCE)
    parts = E.reshape(-1, 3, E.shape[1])
    pictured = np.einsum("ij,njk->nik", axes.T / sizes[:, None], parts).reshape(-1, E.shape[1])
    length = np.linalg.norm(pictured, axis=0)
    pictured /= np.where(length > 0, length, 1.0)
    return _rank(np.linalg.svd(pictured, compute_uv=False))


@dataclass(frozen=True, eq=False)
class MemberForces:
    """Force densities of the k movable members, strings first: ``particular + states @ x``.

    Members between two fixed nodes are part of the support, and fixed nodes take any force.
    """

    live: np.ndarray  # (α + β,), which members are movable
    matrix: FloatArray  # (f, k), E of these members and the free coordinates
    sizes: FloatArray  # its singular values
    states: FloatArray  # (k, ·), orthonormal states of self-stress
    particular: FloatArray  # (k,), the least γ and λ that balance the load best

    @property
    def rank(self) -> int:
        """Rank of the matrix."""
        return int(self.matrix.shape[1] - self.states.shape[1])


def member_forces(structure: Structure, load: FloatArray) -> MemberForces:
    """Return the force densities that balance a load on the free coordinates, shape (f,)."""
    live = is_movable(structure, np.vstack([structure.strings, structure.bars]))
    rows, count = len(structure.free_rows), int(live.sum())
    size = f"structure has {rows} free coordinates and {count} members"
    refuse_memory(size, (rows + count) ** 2, "numbers in E and its singular vectors", 8)
    E = equilibrium_matrix(structure)[structure.free_rows][:, live]
    U, sizes, Vt = np.linalg.svd(E)
    rank = member_rank(structure, E)
    particular = Vt[:rank].T @ ((U[:, :rank].T @ load) / sizes[:rank])
    return MemberForces(live, E, sizes, Vt[rank:].T, particular)
