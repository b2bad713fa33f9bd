"""Blocks of bars joined at free nodes, with their independent length constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from scipy.sparse import csc_array, csr_array

# Added to the constraints of bars, whose rows have length 1, so that dependent ones show: they
# are left with little more than it. Bars left with less than the second number are looked at
# again, by the motion that they stop: one of less than the third is none.
_SHIFT, _DOUBTFUL, _DEPENDENT = 1e-13, 1e-6, 1e-9

# Length of a step along a mechanism, in lengths of the longest bar, and by how much of its length
# a redundant bar may then be off.
_STEP, _OFF = 1e-3, 1e-8

# Newton's steps at most, and squared lengths that may be called restored when they get no better.
_MOST, _EXACT = 30, 1e-12


class Jointed(Protocol):
    """What a block needs to know of the structure that it is a part of."""

    @property
    def dimension(self) -> int: ...  # noqa: D102  # as of Structure
    @property
    def nodes(self) -> FloatArray: ...  # noqa: D102
    @property
    def bars(self) -> IntArray: ...  # noqa: D102
    @property
    def bar_mass(self) -> FloatArray: ...  # noqa: D102
    @property
    def bar_length(self) -> FloatArray: ...  # noqa: D102
    @property
    def point_mass(self) -> FloatArray: ...  # noqa: D102
    @property
    def coupled_bars(self) -> IntArray: ...  # noqa: D102
    @property
    def fixed(self) -> IntArray: ...  # noqa: D102
    @property
    def free(self) -> IntArray: ...  # noqa: D102
    @property
    def free_rows(self) -> IntArray: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class Block:
    """Bars that are joined to one another, to point masses or to rollers.

    Nodes and bars are in an order in which the equations of motion can be solved one after the
    other (see ``order``) with little fill-in and no pivoting.

    Attributes
    ----------
    nodes : ndarray of int, shape (k,)
        The nodes that move.
    rows : ndarray of int, shape (r,)
        Rows of ``vec(N)`` of these nodes that supports leave free, in the order of ``nodes``.
    bars : ndarray of int, shape (b,)
        All bars, ascending.
    independent : ndarray of int, shape (c,)
        Bars whose lengths determine those of the others: all of them, unless the block has
        redundant bars.
    order : ndarray of int, shape (r + c,)
        The rows, 0 to r − 1, and the independent bars, r to r + c − 1, in order of elimination:
        each bar after both of its ends.
    """

    nodes: IntArray
    rows: IntArray
    bars: IntArray
    independent: IntArray
    order: IntArray

    @property
    def is_redundant(self) -> bool:
        """Whether it has more bars than hold its motion: their forces are not unique."""
        return len(self.independent) < len(self.bars)


def find_blocks(structure: Jointed) -> tuple[Block, ...]:
    """Return the blocks of the coupled bars, or raise where they are in a dead centre."""
    if len(structure.coupled_bars) == 0:
        return ()
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    count = structure.nodes.shape[1]
    pairs = structure.bars[structure.coupled_bars]
    inner = pairs[~np.isin(pairs, structure.fixed).any(axis=1)]
    joined = csr_array((np.ones(len(inner)), inner.T), shape=(count, count))
    _, of_node = connected_components(joined, directed=False)
    # A bar belongs to the block of an end that moves.
    moving_end = np.where(np.isin(pairs[:, 0], structure.fixed), pairs[:, 1], pairs[:, 0])
    of_bar = of_node[moving_end]
    free = np.zeros(count, bool)
    free[structure.free] = True
    is_free_row = np.zeros(structure.nodes.size, bool)
    is_free_row[structure.free_rows] = True
    return tuple(
        _block(
            structure,
            structure.coupled_bars[of_bar == k],
            np.flatnonzero((of_node == k) & free),
            is_free_row,
        )
        for k in dict.fromkeys(of_bar.tolist())
    )


def bar_rows(structure: Jointed, bars: IntArray, nodes: FloatArray) -> csr_array:
    """Return J of some bars, shape (b, d n): half the derivatives of their squared lengths, m."""
    from scipy.sparse import csr_array

    d, count = nodes.shape
    ends = structure.bars[bars]
    vectors = (nodes[:, ends[:, 1]] - nodes[:, ends[:, 0]]).T
    # By rows, each in the order of its columns: nothing is left to be sorted.
    sign = np.where(ends[:, :1] < ends[:, 1:], [-1.0, 1.0], [1.0, -1.0])
    columns = d * np.sort(ends, axis=1)[:, :, None] + np.arange(d)
    values = sign[:, :, None] * vectors[:, None, :]
    starts = np.arange(0, values.size + 1, 2 * d)
    return csr_array((values.ravel(), columns.ravel(), starts), shape=(len(bars), d * count))


def node_mass(structure: Jointed, block: Block | None = None) -> csr_array:
    """Return M = C_bᵀ m̂_b C_b/12 + C_rᵀ m̂_b C_r + point masses, kg, of all nodes or a block's."""
    from scipy.sparse import csr_array

    count = structure.nodes.shape[1]
    bars = np.arange(len(structure.bars)) if block is None else block.bars
    nodes = np.arange(count) if block is None else block.nodes
    index = np.full(count, -1)
    index[nodes] = np.arange(len(nodes))
    start, end = index[structure.bars[bars]].T
    rows = np.concatenate([start, end, start, end, index[nodes]])
    columns = np.concatenate([start, end, end, start, index[nodes]])
    m = structure.bar_mass[bars]
    values = np.concatenate([m / 3, m / 3, m / 6, m / 6, structure.point_mass[nodes]])
    kept = (rows >= 0) & (columns >= 0) & (values > 0)
    return csr_array((values[kept], (rows[kept], columns[kept])), shape=(len(nodes), len(nodes)))


def _block(
    structure: Jointed, bars: IntArray, nodes: IntArray, is_free_row: NDArray[np.bool_]
) -> Block:
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    count, d = structure.nodes.shape[1], structure.dimension
    index = np.full(count, -1)
    index[nodes] = np.arange(len(nodes))
    ends = index[structure.bars[bars]]
    inner = ends[(ends >= 0).all(axis=1)]
    graph = csr_array((np.ones(2 * len(inner)), np.vstack([inner, inner[:, ::-1]]).T),
                      shape=(len(nodes), len(nodes)))  # fmt: skip
    nodes = nodes[reverse_cuthill_mckee(graph, symmetric_mode=True)]
    index[nodes] = np.arange(len(nodes))
    rows = (d * nodes[:, None] + np.arange(d)).ravel()
    rows = rows[is_free_row[rows]]
    block = _ordered(structure, index, nodes, rows, bars, bars)
    independent = _independent(structure, block)
    if len(independent) < len(bars):
        block = _ordered(structure, index, nodes, rows, bars, independent)
        _refuse_dead_centre(structure, block)
    return block


def _ordered(
    structure: Jointed, index: IntArray, nodes: IntArray, rows: IntArray, bars: IntArray,
    independent: IntArray,
) -> Block:  # fmt: skip
    later = index[structure.bars[independent]].max(axis=1)
    independent = independent[np.argsort(later, kind="stable")]
    steps = np.concatenate([index[rows // structure.dimension], np.sort(later)])
    order = np.argsort(steps, kind="stable")  # rows come before the bars of the same step
    return Block(*(frozen(array) for array in (nodes, rows, bars, independent, order)))


def _independent(structure: Jointed, block: Block) -> IntArray:
    """Return bars of which none depends on the others, and all others on them."""
    from scipy.linalg import qr
    from scipy.sparse.linalg import splu

    r, rows, bars = len(block.rows), block.rows, block.independent
    J = bar_rows(structure, bars, structure.nodes)[:, rows]
    # Directions alone count, not masses or lengths; a bar that holds nothing that moves has none.
    row = np.repeat(np.arange(len(bars)), np.diff(J.indptr))
    size = np.sqrt(np.bincount(row, J.data**2, minlength=len(bars)))
    least = np.finfo(float).eps * structure.bar_length[bars]
    J.data /= np.maximum(size, least)[row]
    factors = splu(
        _saddle(None, J, _SHIFT, block.order), permc_spec="NATURAL", diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )  # fmt: skip
    pivots = np.empty(len(block.order))
    pivots[block.order] = factors.U.diagonal()
    is_kept = -pivots[r:] > _DOUBTFUL
    doubtful = np.flatnonzero(~is_kept)
    if len(doubtful):
        asked = (
            f"bars has {len(bars):,} that are joined, {len(doubtful):,} of which may be redundant"
        )
        validation.refuse_memory(asked, r * len(doubtful), "numbers", 4 * 8.0)
        left = _admitted(J[is_kept], J[doubtful].toarray().T)
        size = np.abs(left).max(axis=0)
        doubtful, left = doubtful[size > _DEPENDENT], left[:, size > _DEPENDENT]
        _, R, order = qr(left, mode="economic", pivoting=True)
        is_kept[doubtful[order[: np.count_nonzero(np.abs(np.diagonal(R)) > _DEPENDENT)]]] = True
    return np.asarray(bars[is_kept])


def is_independent(J: csc_array) -> bool:
    """Return whether rows are well independent, as far as a few steps of inverse iteration show."""
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.linalg import splu

    rows = csr_array(diags_array(1 / np.sqrt(J.multiply(J).sum(axis=1))) @ J)
    (c, r), size = J.shape, 1.0
    try:
        factors = splu(_saddle(None, rows))
    except RuntimeError:  # exactly singular
        return False
    vector = np.cos(np.arange(1.0, c + 1) ** 2)  # any
    for _ in range(3):
        vector = factors.solve(np.concatenate([np.zeros(r), vector / np.linalg.norm(vector)]))[r:]
        size = float(np.linalg.norm(vector))
    return size < _DOUBTFUL**-2


def _admitted(J: csr_array, motions: FloatArray) -> FloatArray:
    """Return the parts of motions, shape (r, ·), that bars with the rows J admit."""
    from scipy.sparse.linalg import splu

    below = np.zeros((J.shape[0], motions.shape[1]))
    factors = splu(_saddle(None, J))
    return np.asarray(factors.solve(np.vstack([motions, below]))[: len(motions)])


def restore_block(
    structure: Jointed, block: Block, nodes: FloatArray, lengths: FloatArray
) -> FloatArray:
    """Return nodes, shape (d, n), with the bars of a block at these lengths, m, shape (β,).

    By Newton's iteration to round-off, each change the least in the metric of the mass. Raises
    ValueError if it does not converge: the shape is too far off.
    """
    from scipy.sparse.linalg import splu

    rows, bars = block.rows, block.independent
    if len(bars) == 0:
        return nodes
    flat, mass = nodes.ravel(order="F"), block_mass(structure, block)
    length = lengths[bars]
    best = np.inf
    for _ in range(_MOST):
        nodes = flat.reshape(nodes.shape, order="F")
        vectors = nodes[:, structure.bars[bars, 1]] - nodes[:, structure.bars[bars, 0]]
        excess = ((vectors**2).sum(axis=0) - length**2) / 2
        off = float(np.abs(excess / length**2).max())
        if off < _EXACT and off >= best:
            return nodes
        best = min(best, off)
        try:
            factors = splu(_saddle(mass, bar_rows(structure, bars, nodes)[:, rows]))
        except RuntimeError:  # exactly singular
            break
        change = factors.solve(np.concatenate([np.zeros(len(rows)), excess]))[: len(rows)]
        if not np.isfinite(change).all():
            break
        flat = flat.copy()
        flat[rows] -= change
    raise ValueError(
        f"in nodes, bars {sorted(block.bars.tolist())}, which are joined to one another, cannot "
        f"all have their lengths in a shape near this one: Newton's method leaves relative "
        f"errors of the squared lengths of up to {best:.1e}; give a shape nearer to one that "
        "they can have"
    )


def _saddle(
    mass: csr_array | None, J: csr_array, shift: float = 0.0, order: IntArray | None = None
) -> csc_array:
    """Return [M, Jᵀ; J, −shift], M = 1 if there is none, its rows and columns in this order."""
    from scipy.sparse import csc_array

    (c, r), J = J.shape, J.tocoo()
    diagonal = np.arange(r + c)
    row, column, values = diagonal[:r], diagonal[:r], np.ones(r)
    if mass is not None:
        coo = mass.tocoo()
        row, column, values = coo.row, coo.col, coo.data
    row = np.concatenate([row, J.row + r, J.col, diagonal[r:]])
    column = np.concatenate([column, J.col, J.row + r, diagonal[r:]])
    if order is not None:
        index = np.argsort(order)
        row, column = index[row], index[column]
    values = np.concatenate([values, J.data, J.data, np.full(c, -shift)])
    return csc_array((values, (row, column)), shape=(r + c, r + c))


def block_mass(structure: Jointed, block: Block) -> csr_array:
    """Return the mass matrix of the rows of a block, sparse, shape (r, r), kg."""
    from scipy.sparse import eye_array, kron

    d = structure.dimension
    every = (d * block.nodes[:, None] + np.arange(d)).ravel()
    free = np.flatnonzero(np.isin(every, block.rows))
    mass = kron(node_mass(structure, block), eye_array(d), format="csr")
    return mass[free][:, free]


def _is_free_body(structure: Jointed, block: Block) -> bool:
    """Return whether nothing holds the nodes, and bars leave them no motion but as one body."""
    d, count = structure.dimension, len(block.nodes)
    is_held = (
        len(block.rows) < d * count or np.isin(structure.bars[block.bars], structure.fixed).any()
    )
    if is_held or len(block.rows) - len(block.independent) != d * (d + 1) // 2:
        return False
    centred = structure.nodes[:, block.nodes]
    sizes = np.linalg.svd(centred - centred.mean(axis=1, keepdims=True), compute_uv=False)
    return bool(sizes[d - 2] > _DOUBTFUL * sizes[0])  # nodes on a line turn about it unseen


def _refuse_dead_centre(structure: Jointed, block: Block) -> None:
    """Raise if redundant bars are not so in a shape close by."""
    if _is_free_body(structure, block):
        return  # it moves as one body, however far
    rows, nodes = block.rows, structure.nodes
    J = bar_rows(structure, block.independent, nodes)[:, rows]
    motion = _admitted(J, np.cos(np.arange(1.0, len(rows) + 1) ** 2)[:, None])[:, 0]  # any one
    if np.abs(motion).max() < _DEPENDENT:
        return  # nothing moves
    length = structure.bar_length[block.bars]
    flat = nodes.ravel(order="F").copy()
    flat[rows] += _STEP * length.max() / np.abs(motion).max() * motion
    bent = flat.reshape(nodes.shape, order="F")
    moved = restore_block(structure, block, bent, structure.bar_length)
    start, end = structure.bars[block.bars].T
    off = np.abs(np.linalg.norm(moved[:, end] - moved[:, start], axis=0) / length - 1)
    if off.max() > _OFF:
        worst = block.bars[off.argmax()]
        raise ValueError(
            f"bars {sorted(block.bars.tolist())}, with their supports, are rigid in this shape, "
            f"but not in neighbouring shapes, where bar {worst} changes its length: at such a "
            "dead centre their forces are not determined. Change the nodes slightly, remove a "
            "bar, or release a support"
        )
