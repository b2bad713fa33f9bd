"""Derivative of :func:`project`, which puts bars on their lengths, at many states."""

from __future__ import annotations

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import evaluate_columns
from tenscontrol.integrate.projection import projection
from tenscontrol.structure.blocks import Block, node_mass
from tenscontrol.structure.structure import Structure

# Less than this part of the largest moment of inertia is none: that of bars on one line about it.
_NO_INERTIA = 1e-9


class ProjectionSlope:
    """The derivative of what puts the bars of states on their lengths.

    In closed form: bars that share nodes are moved by ``M⁻¹ Jᵀ λ``. The change of their nodes tells
    λ, and what determines it is differentiated.

    Parameters
    ----------
    equation : Equation
        Of a structure with bars.
    """

    def __init__(self, equation: Equation) -> None:
        structure = equation.structure
        exact = projection(equation)
        assert structure is not None  # one with bars
        assert exact is not None  # of these
        self._exact, self._layout = exact, equation.layout
        self._structure, self._half = structure, equation.states // 2
        self._blocks = [_CoupledBars(structure, block) for block in structure.blocks]
        #: Of each kind of bars on their own: the bars, their starts if these are free, their ends.
        self._alone: list[tuple[IntArray, IntArray | None, IntArray]] = []
        if len(structure.free_bars):
            starts, ends = (_places(structure, of) for of in structure.bars[structure.free_bars].T)
            self._alone.append((structure.free_bars, starts, ends))
        if len(structure.swinging_bars):
            tips = _places(structure, structure.hinged_pairs[:, 1])
            self._alone.append((structure.swinging_bars, None, tips))
        self._hinges = structure.nodes[:, structure.hinged_pairs[:, 0]].T

    def __call__(self, x: FloatArray, u: FloatArray | None) -> tuple[FloatArray, FloatArray | None]:
        """Return it at states, one a column, by the state, shape (K, states, states).

        And that by lengths and rates of bars, (K, states, 2 β), where these are driven, by the
        inputs u, one a column.
        """
        given, count = [x], x.shape[1]
        bars = len(self._structure.bars)
        lengths, rates = self._structure.bar_length[None], np.zeros((1, bars))
        is_driven = self._layout.lengths > 0
        if is_driven:
            assert u is not None  # then it is told
            given.append(u)
            layout = self._layout
            lengths, rates = (layout.numbers(u, layout.length_rows, k).T for k in range(2))
        before, after = x.T, evaluate_columns(self._exact, *given)[0].T
        is_near = np.asarray(np.isfinite(after).all(axis=1))
        after = np.where(is_near[:, None], after, before)
        by_state = np.tile(np.eye(len(x)), (count, 1, 1))
        by_lengths = np.zeros((count, len(x), 2 * bars))
        for of, start, end in self._alone:
            self._add_alone(
                by_state, by_lengths, before, (of, start, end), lengths[:, of], rates[:, of]
            )
        for block in self._blocks:
            block.add(by_state, by_lengths, before, after, lengths, rates)
        by_state[~is_near] = by_lengths[~is_near] = np.nan  # lengths too far off
        return by_state, by_lengths if is_driven else None

    def _add_alone(
        self, by_state: FloatArray, by_lengths: FloatArray, x: FloatArray,
        bars: tuple[IntArray, IntArray | None, IntArray], length: FloatArray, rate: FloatArray,
    ) -> None:  # fmt: skip
        """Enter bars that share no node: vectors scaled to their length, their rates across."""
        of, start, end = bars
        half, d = self._half, self._structure.dimension
        B, Bd = x[:, end], x[:, half + end]
        if start is None:
            B = B - self._hinges
        else:
            B, Bd = B - x[:, start], Bd - x[:, half + start]
        now = np.sqrt((B * B).sum(axis=2))
        along, length, rate = B / now[..., None], length[..., None], rate[..., None]
        scale = now[..., None] / length
        speed = (along * Bd).sum(axis=2, keepdims=True)
        across = Bd - along * speed
        Q = np.eye(d) - along[..., :, None] * along[..., None, :]
        mixed = across[..., :, None] * along[..., None, :]
        of_vectors = Q / scale[..., None]
        of_turning = (mixed - mixed.swapaxes(2, 3) - speed[..., None] * Q) / length[..., None]
        of_turning = of_turning + Q * (rate / now[..., None])[..., None]
        slopes = (0, 0, of_vectors), (half, 0, of_turning), (half, half, Q * scale[..., None])
        for to, by, slope in slopes:
            if start is None:
                by_state[:, to + end[:, :, None], by + end[:, None, :]] = slope
                continue
            centre = np.eye(d) / 2 if to == by else 0.0
            for sign, row in ((-0.5, start), (0.5, end)):
                for other, column in ((-1.0, start), (1.0, end)):
                    by_state[:, to + row[:, :, None], by + column[:, None, :]] = (
                        centre + sign * other * slope
                    )
        count = by_lengths.shape[2] // 2
        ends = [(1.0, end)] if start is None else [(-0.5, start), (0.5, end)]
        for share, row in ends:
            by_lengths[:, row, of[:, None]] = share * along
            by_lengths[:, half + row, of[:, None]] = -share * across * scale / length
            by_lengths[:, half + row, count + of[:, None]] = share * along


class _CoupledBars:
    """Bars that share nodes; see :class:`Coupled`."""

    def __init__(self, structure: Structure, block: Block) -> None:
        d, rows = structure.dimension, block.rows
        self._structure, self._bars = structure, block.independent
        self._rows = np.searchsorted(structure.free_rows, rows)
        #: Differences of the ends of bars by the rows, (c, d, r).
        ends = d * structure.bars[block.independent][:, :, None] + np.arange(d)
        self._ends = ends
        self._D = (ends[:, 1, :, None] == rows).astype(float) - (ends[:, 0, :, None] == rows)
        mass = node_mass(structure, block).toarray()
        of_rows = (block.nodes == rows[:, None] // d).argmax(axis=1)
        same = rows[:, None] % d == rows % d
        self._inverse = np.linalg.inv(mass[np.ix_(of_rows, of_rows)] * same)
        is_held = len(rows) < d * len(block.nodes)
        is_held |= bool(np.isin(structure.bars[block.bars], structure.fixed).any())
        self._mass = None if is_held else mass

    def add(
        self, by_state: FloatArray, by_lengths: FloatArray, before: FloatArray, after: FloatArray,
        lengths: FloatArray, rates: FloatArray,
    ) -> None:  # fmt: skip
        """Enter the derivative, from states before and after, one a row."""
        half, rows, inverse = before.shape[1] // 2, self._rows, self._inverse
        q, v, q1 = before[:, rows], before[:, half + rows], after[:, rows]
        length, rate = lengths[:, self._bars], rates[:, self._bars]
        J, J1 = (self._jacobian(state[:, :half], True) for state in (before, after))
        W, W1 = (inverse @ jacobian.swapaxes(1, 2) for jacobian in (J, J1))
        eye = np.eye(len(rows))
        # Positions: q₁ = q + W λ, and the lengths of q₁ determine λ.
        impulse = _solved(J @ W, J @ (q1 - q)[..., None])
        moved = eye + inverse @ self._curvature(impulse)
        both = J1 @ W
        by_q = moved - W @ _solved(both, J1 @ moved)
        q_by_length = W @ _solved(both, _diagonal(length))
        # Velocities: v₁ = v + W₁ μ.
        impulse = _solved(J1 @ W1, (length * rate)[..., None] - J1 @ v[..., None])
        v1 = v + (W1 @ impulse)[..., 0]
        turned = inverse @ self._curvature(impulse)
        turning = self._jacobian(self._whole(v1, half), False)
        v_by_q1 = turned - W1 @ _solved(J1 @ W1, J1 @ turned + turning)
        by_v = eye - W1 @ _solved(J1 @ W1, J1)
        v_by_q = v_by_q1 @ by_q
        of_stretch = W1 @ _solved(J1 @ W1, np.concatenate([_diagonal(rate), _diagonal(length)], 2))
        v_by_length, v_by_rate = np.split(of_stretch, 2, axis=2)
        v_by_length = v_by_q1 @ q_by_length + v_by_length
        if self._mass is not None:
            by_before, by_after, by_rates = self._turned(q, v, q1, v1)
            by_v1 = eye + by_rates
            v_by_q = by_before[0] + by_after @ by_q + by_v1 @ v_by_q
            by_v = by_before[1] + by_v1 @ by_v
            v_by_length = by_after @ q_by_length + by_v1 @ v_by_length
            v_by_rate = by_v1 @ v_by_rate
        lower, count = half + rows, by_lengths.shape[2] // 2
        by_state[:, rows[:, None], rows] = by_q
        by_state[:, lower[:, None], rows] = v_by_q
        by_state[:, lower[:, None], lower] = by_v
        by_lengths[:, rows[:, None], self._bars] = q_by_length
        by_lengths[:, lower[:, None], self._bars] = v_by_length
        by_lengths[:, lower[:, None], count + self._bars] = v_by_rate

    def _whole(self, values: FloatArray, half: int) -> FloatArray:
        whole = np.zeros((len(values), half))
        whole[:, self._rows] = values
        return whole

    def _jacobian(self, free: FloatArray, is_placed: bool) -> FloatArray:
        """Return J of nodes, or of velocities, by what is free of them, (K, c, r)."""
        N = self._structure.nodes.ravel(order="F") * is_placed
        N = np.tile(N, (len(free), 1))
        N[:, self._structure.free_rows] = free
        B = N[:, self._ends[:, 1]] - N[:, self._ends[:, 0]]
        J: FloatArray = np.einsum("kci,cir->kcr", B, self._D, optimize=True)
        return J

    def _curvature(self, impulse: FloatArray) -> FloatArray:
        """Return the derivative of ``Jᵀ`` times impulses, (K, r, r)."""
        D = self._D.reshape(-1, self._D.shape[2])
        weights = np.repeat(impulse[..., 0], self._D.shape[1], axis=1)
        curvature: FloatArray = D.T @ (weights[..., None] * D)
        return curvature

    def _turned(
        self, q: FloatArray, v: FloatArray, q1: FloatArray, v1: FloatArray
    ) -> tuple[tuple[FloatArray, FloatArray], FloatArray, FloatArray]:
        """Return derivatives of the turn that gives a body its angular momentum back.

        By positions and velocities before, by positions after, and by velocities after.
        """
        d, M = self._structure.dimension, self._mass
        assert M is not None  # it is a body
        x, w, x1, w1 = (of.reshape(len(q), -1, d) for of in (q, v, q1, v1))
        share = M.sum(axis=0) / M.sum()
        arms = x1 - np.einsum("j,kji->ki", share, x1)[:, None]
        across = _cross(arms)  # (K, nodes, 3 or 1, d)
        inertia = np.einsum("kimd,ij,kjnd->kmn", across, M, across, optimize=True)
        inverse = np.linalg.pinv(inertia, rcond=_NO_INERTIA, hermitian=True)
        lost = (_cross(x) @ (M @ w)[..., None] - _cross(x1) @ (M @ w1)[..., None]).sum(axis=1)
        turn = inverse @ lost  # (K, 3 or 1, 1)
        spin = _spin(turn[..., 0])[:, None]  # (K, 1, d, d)
        added = (across.swapaxes(2, 3) @ turn[:, None])[..., 0]
        by_arms = _cross(M @ arms) @ spin - _cross(M @ added)

        around = across.swapaxes(2, 3).reshape(len(q), -1, len(inverse[0])) @ inverse

        def by_turn(of: FloatArray) -> FloatArray:
            """Return what changes of the momentum do to velocities, (K, r, r)."""
            change: FloatArray = around @ _flat(of)
            return change

        centred = np.kron(np.eye(len(M)) - share, np.eye(d))
        of_after = by_turn(_cross(M @ w1)) - by_turn(by_arms) @ centred
        spun = np.zeros_like(of_after).reshape(len(q), len(M), d, len(M), d)
        at = np.arange(len(M))
        spun[:, at, :, at] = spin.swapaxes(0, 1)
        of_after = of_after + spun.reshape(of_after.shape) @ centred
        before = -by_turn(_cross(M @ w)), by_turn(_cross(M @ x))
        return before, of_after, -by_turn(_cross(M @ x1))


def _places(structure: Structure, nodes: IntArray) -> IntArray:
    """Return the places of the coordinates of nodes among those that are free, (k, d)."""
    rows = structure.dimension * nodes[:, None] + np.arange(structure.dimension)
    places: IntArray = np.searchsorted(structure.free_rows, rows)
    return places


def _solved(matrices: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(matrices, right), dtype=float)


def _diagonal(values: FloatArray) -> FloatArray:
    """Return diagonal matrices, (K, c, c), of values, (K, c)."""
    return values[..., None] * np.eye(values.shape[-1])


def _flat(of_nodes: FloatArray) -> FloatArray:
    """Return matrices of nodes, (K, nodes, m, d), beside one another, (K, m, nodes d)."""
    count, _, m, _ = of_nodes.shape
    return of_nodes.swapaxes(1, 2).reshape(count, m, -1)


def _cross(vectors: FloatArray) -> FloatArray:
    """Return the matrices that take others to their cross products, (..., 3 or 1, d)."""
    if vectors.shape[-1] == 2:
        return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)[..., None, :]
    return np.cross(vectors[..., None, :], np.eye(3)).swapaxes(-1, -2)


def _spin(turn: FloatArray) -> FloatArray:
    """Return the matrices that take arms to their velocities by a turn, (K, d, d)."""
    if turn.shape[1] == 1:
        return np.asarray(turn[..., None] * np.array([[0.0, -1.0], [1.0, 0.0]]))
    return _cross(turn)
