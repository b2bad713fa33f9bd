"""The equations of motion, member by member, in CasADi expressions.

Every function takes and returns symbolic matrices, SX or MX, with one column
per node or member. Work and memory grow linearly with the members. Bars that share
nodes are solved for together, block by block; for all others nothing is
factorised. The functions of columns below hold for any number of members, so
also for one: the loops in C (:mod:`tenscontrol.dynamics.forms.loops`) are made of them.

Sign convention::

      ●────────→ s ────────●      string: γ = tension / length,     pulls its ends together
      ●════════→ b ════════●      bar:    λ = compression / length, pushes its ends apart
    start                 end
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.structure.blocks import Block, block_mass, node_mass
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import held_directions

# A string shorter than this part of its rest length has no direction to pull in.
_NO_LENGTH = 1e-12

# CasADi expressions carry no types of their own.
Symbolic = Any


class Masses(NamedTuple):
    """Masses as expressions, kg; an equation takes none of bars that share nodes."""

    bar_mass: Symbolic  # (β, 1)
    point_mass: Symbolic  # (n, 1)

    @classmethod
    def of(cls, structure: Structure, given: dict[str, Symbolic]) -> Masses | None:
        """Return the masses with those that are given; None where that is none."""
        if not given.keys() & set(cls._fields):
            return None
        return cls(
            *(given.get(name, ca.SX(ca.DM(getattr(structure, name)))) for name in cls._fields)
        )


def all_nodes(structure: Structure, free: Symbolic, fixed: FloatArray | None = None) -> Symbolic:
    """Return the columns of all nodes, shape (d, n), from those of the nodes that are not fixed.

    The only place where supports are put into symbols: what is fixed or held by a roller is a
    constant, from columns of ``fixed`` of shape (d, n), or nothing (velocities, loads).
    """
    if len(structure.fixed_rows) == 0:
        return free
    places = np.zeros_like(structure.nodes) if fixed is None else fixed
    if isinstance(free, ca.MX):
        rest = ca.DM(places[:, structure.fixed])
        order = np.argsort(np.concatenate([structure.free, structure.fixed]))
        columns = ca.horzcat(free, rest)[:, order.tolist()]
        if structure.rollers:
            held = held_directions(structure).T.astype(float)
            columns = columns * ca.DM(1 - held) + ca.sparsify(ca.DM(places * held))
        return columns
    columns = type(free)(*structure.nodes.shape)
    if fixed is not None:
        columns[:, structure.fixed.tolist()] = ca.DM(fixed[:, structure.fixed])
    columns[:, structure.free.tolist()] = free
    for node, axis in structure.rollers:
        columns["xyz".index(axis), node] = places["xyz".index(axis), node]
    return columns


def placed(structure: Structure, entries: Symbolic, fixed: FloatArray) -> Symbolic:
    """Return the columns of all nodes, shape (d, n), from the column of what supports leave free.

    The rest is constant, from columns of ``fixed``, shape (d, n). The inverse of `free_entries`.
    """
    if len(structure.fixed_rows):
        held = ca.DM(fixed.ravel(order="F")[structure.fixed_rows])
        order = np.argsort(np.concatenate([structure.free_rows, structure.fixed_rows]))
        entries = ca.vertcat(entries, held)[order.tolist()]
    return ca.reshape(entries, *structure.nodes.shape)


def free_entries(structure: Structure, free: Symbolic) -> Symbolic:
    """Return the column of what supports leave free, in columns of the nodes that are not fixed."""
    if not structure.rollers:
        return ca.vec(free)
    is_free = ~held_directions(structure)[structure.free]
    return ca.vec(free)[np.flatnonzero(is_free).tolist()]


def differences(columns: Symbolic, pairs: IntArray) -> Symbolic:
    """Return end minus start column of each pair: B, S, or their rates."""
    return columns[:, pairs[:, 1].tolist()] - columns[:, pairs[:, 0].tolist()]


def dots(a: Symbolic, b: Symbolic) -> Symbolic:
    """Return the dot products of the columns of two (d, k) matrices, shape (1, k)."""
    return ca.sum1(a * b)


def scale_columns(columns: Symbolic, factors: Symbolic) -> Symbolic:
    """Multiply column i of a (d, k) matrix by entry i of a (1, k) row."""
    return columns * ca.repmat(factors, columns.shape[0], 1)


def segment_forces(structure: Structure, S: Symbolic, gamma: Symbolic) -> Symbolic:
    """Return −N C_sᵀ γ̂ C_s, shape (d, n), N (eq. 2), from S and γ of segments, shape (1, s)."""
    return ca.mtimes(string_pull(S, gamma), _gather(structure.segments, structure.nodes.shape[1]))


def segment_force_density(structure: Structure, S: Symbolic, gamma: Symbolic) -> Symbolic:
    """Return γ of each segment, shape (1, s), from γ = T/L of each string, shape (1, α).

    A clustered string has one tension: its segments have ``T/l = γ L/l``.
    """
    if not structure.has_clusters:
        return gamma
    lengths = string_length(structure, S)
    tension = gamma * string_sums(structure, lengths)
    return tension[:, structure.segment_string.tolist()] / lengths


def string_motion(structure: Structure, N: Symbolic, Nd: Symbolic) -> tuple[Symbolic, Symbolic]:
    """Return length and rate of each string, m and m/s, shape (1, α)."""
    S, Sd = differences(N, structure.segments), differences(Nd, structure.segments)
    lengths = string_length(structure, S)
    rate = length_rate(S, Sd, lengths)
    if not structure.has_clusters:
        return lengths, rate
    return string_sums(structure, lengths), string_sums(structure, rate)


def string_lengths(structure: Structure, N: Symbolic) -> Symbolic:
    """Return the length of each string, m, shape (1, α)."""
    lengths = string_length(structure, differences(N, structure.segments))
    return string_sums(structure, lengths) if structure.has_clusters else lengths


def bar_force_density(
    structure: Structure,
    N: Symbolic,
    Nd: Symbolic,
    F: Symbolic,
    masses: Masses | None = None,
    extension: Symbolic | None = None,
) -> Symbolic:
    """Return λ, shape (1, β), N/m, positive in compression.

    Masses are the structure's if not given, ``extension`` is ``L L̈ + L̇²`` of driven bars, shape
    (1, β). A bar with both ends fixed is part of the support; its
    entry is zero. Of redundant bars, whose forces are not unique, those of least norm.
    """
    lam, given = type(N)(1, len(structure.bars)), (structure, N, Nd, F)
    if len(structure.free_bars):
        *_, lam[:, structure.free_bars.tolist()] = _free_bars(*given, masses, extension)
    if len(structure.swinging_bars):
        _, lam[:, structure.swinging_bars.tolist()] = _swinging_bars(*given, masses, extension)
    if structure.blocks:
        every = coupled_block(structure)
        _, force_density = block_motion(structure, every, N, Nd, F, extension)
        lam[:, every.independent.tolist()] = force_density.T
    for block in structure.blocks:
        if block.is_redundant:
            bars, force_density = _least_norm(
                structure, block, N, lam[:, block.independent.tolist()].T
            )
            lam[:, bars.tolist()] = force_density.T
    return lam


def accelerations(
    structure: Structure,
    N: Symbolic,
    Nd: Symbolic,
    F: Symbolic,
    masses: Masses | None = None,
    extension: Symbolic | None = None,
) -> Symbolic:
    """Return N̈, shape (d, n), m/s², from eq. (7); what supports hold is left empty.

    M_s is inverted in closed form, but for the blocks. Masses are the structure's if not given;
    ``extension`` is ``L L̈ + L̇²`` of driven bars, shape (1, β).
    """
    Ndd, given = type(N)(*structure.nodes.shape), (structure, N, Nd, F)
    if len(structure.free_bars):
        start, end = structure.bars[structure.free_bars].T.tolist()
        Ndd[:, start], Ndd[:, end], _ = _free_bars(*given, masses, extension)
    if len(structure.swinging_bars):
        tip = structure.hinged_pairs[:, 1].tolist()
        Ndd[:, tip], _ = _swinging_bars(*given, masses, extension)
    if len(structure.string_nodes):
        # No string nodes, no block: a scene pays only for what it has.
        points = structure.string_nodes.tolist()
        Ndd[:, points] = point_acceleration(F[:, points], string_node_mass(structure, masses))
    if structure.blocks:
        every = coupled_block(structure)
        Ndd[every.rows.tolist()], _ = block_motion(structure, every, N, Nd, F, extension)
    for node, axis in structure.rollers:
        Ndd["xyz".index(axis), node] = 0
    return Ndd


# ---- bars that hang together ----


def coupled_block(structure: Structure) -> Block:
    """Return all blocks as one: it is solved as fast as they are one after the other."""
    blocks = structure.blocks
    first_row = np.cumsum([0, *(len(block.rows) for block in blocks)])
    first_bar = np.cumsum([first_row[-1], *(len(block.independent) for block in blocks)])
    orders = []
    for block, row, bar in zip(blocks, first_row[:-1], first_bar[:-1], strict=True):
        rows = len(block.rows)
        orders.append(block.order + np.where(block.order < rows, row, bar - rows))
    nodes, all_rows, bars, independent = (
        np.concatenate([getattr(block, name) for block in blocks])
        for name in ("nodes", "rows", "bars", "independent")
    )
    return Block(nodes, all_rows, bars, independent, np.concatenate(orders))


def block_motion(
    structure: Structure,
    block: Block,
    N: Symbolic,
    Nd: Symbolic,
    F: Symbolic,
    extension: Symbolic | None = None,
) -> tuple[Symbolic, Symbolic]:
    """Return the accelerations of a block's rows, shape (r, 1), and λ of its independent bars.

    ``M a − Jᵀ λ = f`` and ``J a = −|ḃ|²``, from ``bᵀ b̈ + |ḃ|² = 0`` (Lagrange's equations of the
    first kind), or ``L L̈ + L̇²`` where lengths are driven. λ has shape (c, 1), N/m.
    """
    J = block_rows(structure, block.independent, block.rows, N)
    Bd = differences(Nd, structure.bars[block.independent])
    force = ca.vec(F)[block.rows.tolist()]
    own = None if extension is None else extension[:, block.independent.tolist()]
    solution = SaddlePoint(structure, block, J).solve(force, -turning(Bd, own).T)
    rows = len(block.rows)
    return solution[:rows, :], -solution[rows:, :]


def block_rows(structure: Structure, bars: IntArray, rows: IntArray, N: Symbolic) -> Symbolic:
    """Return J, shape (b, r), m: half the derivatives of the squared lengths of bars by rows."""
    d, count = structure.nodes.shape
    index = np.full(d * count, -1)
    index[rows] = np.arange(len(rows))
    B = ca.vec(differences(N, structure.bars[bars]))
    ends = structure.bars[bars][:, ::-1].T  # b goes from the start to the end
    columns = index[d * ends[:, :, None] + np.arange(d)].ravel()
    moves = np.flatnonzero(columns >= 0).tolist()
    lines = np.tile(np.repeat(np.arange(len(bars)), d), 2)
    sparsity, order = ca.Sparsity.triplet(
        len(bars), len(rows), lines[moves].tolist(), columns[moves].tolist(), False
    )
    values = ca.vertcat(B, -B)[moves]
    return type(N)(sparsity, values[list(order)])


class SaddlePoint:
    """The system ``[[M, Jᵀ], [J, 0]]`` of a block, with J of shape (c, r), by sparse LDLᵀ factors.

    In SX the factors are written out in the order of the block, in which no pivot vanishes: M is
    positive definite, and a bar comes after both of its ends.

    In MX they are CasADi's, at each evaluation, in an order of its own. So that no order has a
    vanishing pivot, ``T K Tᵀ`` is factorized, with ``T = [[1, 0], [−J D, 1]]`` and D the inverse
    row sums of M: its lower right part, ``−J (2 D − D M D) Jᵀ``, is negative definite (M ≤ D⁻¹).
    """

    def __init__(self, structure: Structure, block: Block, J: Symbolic) -> None:
        M = sparse(block_mass(structure, block))
        self._order, self._back = block.order.tolist(), np.argsort(block.order).tolist()
        if isinstance(J, ca.MX):
            self._J, self._share = J, 1 / ca.sum2(M)
            D = ca.diag(self._share)
            left = ca.mtimes(J, ca.DM.eye(len(block.rows)) - ca.mtimes(D, M))
            lower = ca.mtimes([J, ca.mtimes([D, M, D]) - 2 * D, J.T])
            self._matrix = _symmetric(ca.MX(M), left, lower)
        else:
            matrix = ca.blockcat([[M, J.T], [J, type(J)(J.shape[0], J.shape[0])]])
            self._factors = ca.ldl(matrix[self._order, self._order], False)

    @property
    def values(self) -> Symbolic:
        """The entries of the factors in SX, one column: computed once for several solutions."""
        return ca.vertcat(*(factor.nz[:] for factor in self._factors[:2]))

    def solve(self, upper: Symbolic, lower: Symbolic, values: Symbolic | None = None) -> Symbolic:
        """Return ``[a; −λ]`` of the right-hand sides of the two equations, columns.

        With factors of other entries, if :attr:`values` of them are given, in SX.
        """
        if isinstance(upper, ca.MX):
            right = ca.vertcat(upper, lower - ca.mtimes(self._J, self._share * upper))
            solution = ca.solve(self._matrix, right, "ldl")
            rows = upper.shape[0]
            below = solution[rows:]
            return ca.vertcat(solution[:rows] - self._share * ca.mtimes(self._J.T, below), below)
        D, LT, permutation = self._factors
        if values is not None:
            factors = ca.vertsplit(values, [0, D.nnz(), D.nnz() + LT.nnz()])
            D, LT = (ca.SX(old.sparsity(), new) for old, new in zip((D, LT), factors, strict=True))
        right = ca.vertcat(upper, lower)[self._order, :]
        return ca.ldl_solve(right, D, LT, permutation)[self._back, :]


def _symmetric(upper: Symbolic, left: Symbolic, lower: Symbolic) -> Symbolic:
    """Return ``[[upper, leftᵀ], [left, lower]]`` in MX: its entries are put in place at once."""
    blocks = (upper, left, lower)
    ends = np.cumsum([0, *(block.nnz() for block in blocks)])
    number = [ca.DM(block.sparsity(), np.arange(start, start + block.nnz(), dtype=float))
              for block, start in zip(blocks, ends[:-1], strict=True)]  # fmt: skip
    places = ca.blockcat([[number[0], number[1].T], [number[1], number[2]]])
    entries = ca.vertcat(*(ca.reshape(block.nz[:], block.nnz(), 1) for block in blocks))
    return ca.MX(places.sparsity(), entries[np.array(places.nonzeros(), dtype=int).tolist()])


def _least_norm(
    structure: Structure, block: Block, N: Symbolic, lam: Symbolic
) -> tuple[IntArray, Symbolic]:
    """Return all bars of a block and their λ of least norm, from λ of the independent ones."""
    others = np.setdiff1d(block.bars, block.independent)
    J, dependent = (block_rows(structure, some, block.rows, N)
                    for some in (block.independent, others))  # fmt: skip
    # The others' rows are combinations of J: dependentᵀ = Jᵀ T. So (T, −1) λ' does nothing.
    none = type(N)(len(block.independent), len(others))
    T = SaddlePoint(structure, block, J).solve(dependent.T, none)[len(block.rows) :, :]
    share = ca.solve(type(N).eye(len(others)) + ca.mtimes(T.T, T), ca.mtimes(T.T, lam))
    bars = np.concatenate([block.independent, others])
    return bars, ca.vertcat(lam - ca.mtimes(T, share), share)


def eliminated(matrix: Symbolic, right: Symbolic) -> Symbolic:
    """Return the solution of a sparse system by Gaussian elimination without pivoting, SX."""
    size, side = matrix.shape[0], right.elements()
    rows: list[dict[int, Any]] = [{} for _ in range(size)]
    below: list[set[int]] = [set() for _ in range(size)]
    for i, j, value in zip(*matrix.sparsity().get_triplet(), matrix.nonzeros(), strict=True):
        if not value.is_zero():
            rows[i][j] = value
            below[j].add(i)
    for k, pivot in enumerate(rows):
        for i in sorted(row for row in below[k] if row > k):
            factor = rows[i].pop(k) / pivot[k]
            for j, value in pivot.items():
                if j > k:
                    rows[i][j] = rows[i].get(j, 0) - factor * value
                    below[j].add(i)
            side[i] -= factor * side[k]
    for k in reversed(range(size)):
        for j, value in rows[k].items():
            if j > k:
                side[k] -= value * side[j]
        side[k] /= rows[k][k]
    return ca.vertcat(*side)


# ---- one member, or any number of them ----


def string_pull(S: Symbolic, gamma: Symbolic) -> Symbolic:
    """Return the force on the start node, N, shape (d, k); the end node gets the opposite."""
    return scale_columns(S, gamma)


def length(S: Symbolic) -> Symbolic:
    """Return l, m, shape (1, k)."""
    return ca.sqrt(dots(S, S))


def string_length(structure: Structure, S: Symbolic) -> Symbolic:
    """Return the lengths of segments, m, shape (1, s); those of clusters are never zero."""
    if not structure.has_clusters:
        return length(S)
    size = structure.size
    return ca.sqrt(ca.fmax(dots(S, S), (_NO_LENGTH * size) ** 2))


def length_rate(S: Symbolic, Sd: Symbolic, length: Symbolic) -> Symbolic:
    """Return l̇, m/s, shape (1, k)."""
    return dots(S, Sd) / length


def pulling_length(S: Symbolic, rest_length: Symbolic) -> Symbolic:
    """Return l where a string can pull, m, shape (1, k).

    A slack string may have no length; one that pulls is longer than this.
    """
    # Under the root, so that derivatives are finite too.
    return ca.sqrt(ca.fmax(dots(S, S), (_NO_LENGTH * rest_length) ** 2))


def free_bar(
    B: Symbolic,
    Bd: Symbolic,
    start: Symbolic,
    end: Symbolic,
    mass: Symbolic,
    extension: Symbolic | None = None,
) -> tuple[Symbolic, Symbolic, Symbolic]:
    """Return the accelerations of start and end node and λ of bars with two free ends.

    From the forces on the two nodes, N, shape (d, k). ``b̈ = 6/m f + 12/m λ b``
    (eq. 5) with f the end force less the start force, and ``r̈ = (f_start +
    f_end)/m`` (eq. 4); the ends move with ``r̈ ∓ b̈/2``.

    ``λ = −m ‖ḃ‖²/(12 ‖b‖²) − bᵀ f/(2 ‖b‖²)``. The current ‖b‖² stands where the paper has l²: the
    two are equal on exact trajectories, and with l² an error of the bar length made by an
    integrator would grow exponentially under compression.

    Where the length L is driven, ``bᵀ b̈ + ‖ḃ‖² = L L̈ + L̇²``, the ``extension``, m²/s²: ‖ḃ‖² is
    less by it. The mass stays spread evenly over the length.
    """
    f = end - start
    lam = -(mass / 12 * turning(Bd, extension) + dots(B, f) / 2) / dots(B, B)
    half = scale_columns(f, 3 / mass) + scale_columns(B, 6 / mass * lam)
    centre = scale_columns(start + end, reciprocal(mass))
    return centre - half, centre + half, lam


def turning(Bd: Symbolic, extension: Symbolic | None) -> Symbolic:
    """Return ‖ḃ‖² less the extension of driven bars, m²/s², shape (1, k)."""
    return dots(Bd, Bd) if extension is None else dots(Bd, Bd) - extension


def swinging_bar(
    B: Symbolic, Bd: Symbolic, tip: Symbolic, mass: Symbolic, extension: Symbolic | None = None
) -> tuple[Symbolic, Symbolic]:
    """Return the acceleration of the free end and λ of bars that swing about the other.

    b goes from the fixed to the free end, which has the mass m/3. ``λ = −m
    ‖ḃ‖²/(3 ‖b‖²) − bᵀ f/‖b‖²`` with f the force on the free end. ``extension`` is as of
    :func:`free_bar`.
    """
    lam = -(mass / 3 * turning(Bd, extension) + dots(B, tip)) / dots(B, B)
    return scale_columns(tip + scale_columns(B, lam), 3 / mass), lam


def point_acceleration(force: Symbolic, mass: Symbolic) -> Symbolic:
    """Return the acceleration of point masses, m/s², shape (d, k)."""
    return scale_columns(force, reciprocal(mass))


def reciprocal(mass: Symbolic) -> Symbolic:
    """Return 1/m, to be multiplied by: the same bits whether masses are numbers or an input."""
    # CasADi makes a quotient of a product with 1/m.
    return 0.5 * (2 / mass) if isinstance(mass, ca.SX) and not mass.is_constant() else 1 / mass


def bar_mass(structure: Structure, bars: IntArray, masses: Masses | None = None) -> Symbolic:
    """Return the masses of some bars, kg, a row."""
    return _row(structure.bar_mass[bars]) if masses is None else masses.bar_mass[bars.tolist()].T


def string_node_mass(structure: Structure, masses: Masses | None = None) -> Symbolic:
    """Return the masses of the string nodes, kg, a row."""
    if masses is None:
        return _row(structure.string_node_mass)
    return masses.point_mass[structure.string_nodes.tolist()].T


def _free_bars(
    structure: Structure, N: Symbolic, Nd: Symbolic, F: Symbolic, masses: Masses | None,
    extension: Symbolic | None,
) -> tuple[Symbolic, Symbolic, Symbolic]:  # fmt: skip
    bars = structure.bars[structure.free_bars]
    start, end = (F[:, nodes] for nodes in bars.T.tolist())
    mass = bar_mass(structure, structure.free_bars, masses)
    own = None if extension is None else extension[:, structure.free_bars.tolist()]
    return free_bar(differences(N, bars), differences(Nd, bars), start, end, mass, own)


def _swinging_bars(
    structure: Structure, N: Symbolic, Nd: Symbolic, F: Symbolic, masses: Masses | None,
    extension: Symbolic | None,
) -> tuple[Symbolic, Symbolic]:  # fmt: skip
    bars = structure.hinged_pairs
    tip, mass = F[:, bars[:, 1].tolist()], bar_mass(structure, structure.swinging_bars, masses)
    own = None if extension is None else extension[:, structure.swinging_bars.tolist()]
    return swinging_bar(differences(N, bars), differences(Nd, bars), tip, mass, own)


def mass_product(structure: Structure, V: Symbolic, masses: Masses | None = None) -> Symbolic:
    """Return V M_s, shape (d, n): M_s is m/6 [[2, 1], [1, 2]] a bar and m_s a point mass."""
    if masses is not None:
        return ca.mtimes(V, mass_matrix(structure, masses))
    if structure.blocks or structure.structure_class > 1:  # several masses meet at a node
        return ca.mtimes(V, sparse(node_mass(structure)))
    product = type(V)(*structure.nodes.shape)
    if len(structure.bars):
        sixth = _row(structure.bar_mass / 6)
        start, end = structure.bars[:, 0].tolist(), structure.bars[:, 1].tolist()
        both = V[:, start] + V[:, end]
        product[:, start] = scale_columns(both + V[:, start], sixth)
        product[:, end] = scale_columns(both + V[:, end], sixth)
    if len(structure.string_nodes):
        points = structure.string_nodes.tolist()
        product[:, points] = scale_columns(V[:, points], _row(structure.string_node_mass))
    return product


def mass_matrix(structure: Structure, masses: Masses | None = None) -> Symbolic:
    """Return M_s, shape (n, n), sparse, in the order of the nodes (eq. 8), point masses added."""
    if masses is None:
        return sparse(node_mass(structure))
    M = ca.diag(masses.point_mass)
    if len(structure.bars):
        C_bar = _gather(structure.bars, structure.nodes.shape[1])
        mass, C_r = ca.diag(masses.bar_mass), ca.fabs(C_bar) / 2
        M += ca.mtimes([C_bar.T, mass / 12, C_bar]) + ca.mtimes([C_r.T, mass, C_r])
    return M


def weights(structure: Structure, gravity: FloatArray | Symbolic, masses: Masses) -> Symbolic:
    """Return the weights on the nodes, N, shape (d, n): half of each bar at either end."""
    mass = masses.point_mass
    if len(structure.bars):
        C_bar = _gather(structure.bars, structure.nodes.shape[1])
        mass = mass + ca.mtimes(ca.fabs(C_bar).T, masses.bar_mass) / 2
    fall = ca.DM(gravity) if isinstance(gravity, np.ndarray) else gravity
    return ca.mtimes(fall, mass.T)


def stiffness(structure: Structure, gamma: Symbolic, lam: Symbolic) -> Symbolic:
    """Return K_s, shape (n, n), sparse, in the order of the nodes (eq. 9); γ of segments."""
    n = structure.nodes.shape[1]
    K = ca.SX(n, n)
    if len(structure.strings):
        C_s = _gather(structure.segments, n)
        K += ca.mtimes([C_s.T, ca.diag(gamma), C_s])
    if len(structure.bars):
        C_bar = _gather(structure.bars, n)
        K -= ca.mtimes([C_bar.T, ca.diag(lam.T), C_bar])
    return K


def _row(values: FloatArray) -> ca.DM:
    return ca.DM(values).T


def sparse(matrix: Any) -> ca.DM:
    """Return a SciPy matrix as one of CasADi's."""
    entries = matrix.tocoo()
    entries.sum_duplicates()
    rows, columns = entries.row.tolist(), entries.col.tolist()
    return ca.DM.triplet(rows, columns, ca.DM(entries.data), *entries.shape)


def string_sums(structure: Structure, values: Symbolic) -> Symbolic:
    """Return sums over the segments of each string, shape (1, α)."""
    of = structure.segment_string.tolist()
    ones = ca.DM.triplet(
        list(range(len(of))), of, ca.DM.ones(len(of)), len(of), len(structure.strings)
    )
    return ca.mtimes(values, ones)


def _gather(pairs: IntArray, n: int) -> ca.DM:
    """Return the sparse matrix that adds member forces to nodes: 1 at the start, −1 at the end."""
    rows = np.repeat(np.arange(len(pairs)), 2).tolist()
    values = np.tile([1.0, -1.0], len(pairs))
    return ca.DM.triplet(rows, pairs.ravel().tolist(), ca.DM(values), len(pairs), n)
