"""The problem of MPC with its states: a large, sparse quadratic program of fixed pattern.

    minimize    Σ (z_k − r_k)ᵀ Q (z_k − r_k) + Σ (u_k − s_k)ᵀ R (u_k − s_k) + (z_N − r_N)ᵀ P (…)
                + Σ 2 (z_k − r_k)ᵀ N (u_k − s_k) + Σ 2 πᵀ (e_k + ½ e_k²)
    subject to  z_{k+1} = A_k z_k + B_k u_k + C_k u_{k−1} + c_k,
                low ≤ u_k ≤ high,   |u_k − u_{k−1}| ≤ change,
                low − e_k ≤ E_k z_k + F_k z_{k+1} + G_k u_k + d_k ≤ high + e_k,   e_k ≥ 0

For a linear plant the stage Jacobians A_k … G_k are constant. Along the trajectory of a nonlinear
one their values change from sample to sample, their places do not. C_k is there only where inputs
are ramps and the state is not augmented by the previous input. Then P weighs ``[z_N; u_{N−1}]``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, final

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.control.mpc.osqp_solver import OSQPSolver
from tenscontrol.control.mpc.problem import (
    LinearProgram,
    LinearSolution,
    MPCProblem,
    Pair,
    StageData,
    StageJacobians,
    Subproblem,
    SubproblemSolution,
    Triple,
    applied,
)
from tenscontrol.control.mpc.qp_solver import QPSolver
from tenscontrol.short_repr import short_repr

if TYPE_CHECKING:
    from scipy.sparse import csc_array


def solver_name(solver: QPSolver) -> str:
    """Return the name by which a solver is chosen, or that of its class."""
    return "osqp" if isinstance(solver, OSQPSolver) else type(solver).__name__


@dataclass(frozen=True, eq=False)
class SparsityIndices:
    """Where slopes go in a matrix: ``data[index] = factor * slope.ravel()[source]``."""

    index: IntArray
    source: IntArray
    factor: FloatArray

    def fill(self, data: FloatArray, slope: FloatArray) -> None:
        """Put slopes, stored by columns, into the entries of a matrix."""
        data[self.index] = self.factor * slope.reshape(-1)[self.source]


class LimitRows:
    """Limits as matrices on inputs, states and violations.

    Rows come in blocks of N times some width: inputs, changes, hard rows, soft rows from
    above, soft rows from below, violations. Each is in units of its level or scale.

    ``on_inputs``, ``on_states``, ``on_first`` and ``on_violations`` multiply v_0 …, z_1 …, z_0 and
    the violations; ``price`` is the linear cost of those, in units of the scaled cost.
    """

    def __init__(self, problem: MPCProblem) -> None:
        from scipy.sparse import csc_array, eye, identity, kron, vstack

        self._problem, self.level = problem, problem.level
        N, count = problem.length, len(problem.low)
        now, earlier = identity(N), eye(N, k=-1)
        first = csc_array(([1.0], ([0], [0])), shape=(N, 1))
        soft = np.zeros(0, dtype=int) if problem.rows is None else problem.rows.soft
        # One block a row: what multiplies v, z_1 …, z_0 and the violations.
        blocks: list[tuple[csc_array, csc_array, csc_array, csc_array | None]]
        blocks = [self._block(kron(now, identity(count)) / problem.level)]
        if problem.change is not None:
            differences = kron(now - earlier, identity(count)) / problem.level
            blocks.append(self._block(differences))
        self._parts: list[tuple[IntArray, bool, bool]] = []
        if problem.rows is not None:
            rows = problem.rows
            hard = np.setdiff1d(np.arange(len(rows.scale)), soft)
            above, below = rows.bounded
            for taken, sign, low, high in (
                (hard, 0, True, True),
                (soft, -1, False, True),
                (soft, 1, True, False),
            ):
                if not len(taken) or (sign < 0 and not above) or (sign > 0 and not below):
                    continue
                E, F, G = (
                    csc_array(matrix[taken] / rows.scale[taken, None])
                    for matrix in (rows.by_state, rows.by_next_state, rows.by_input)
                )
                blocks.append((
                    kron(now, G),
                    kron(earlier, E) + kron(now, F),
                    kron(first, E),
                    sign * identity(N * len(soft)) if sign else None,
                ))  # fmt: skip
                self._parts.append((taken, low, high))
        self._slacks = N * len(soft)
        if len(soft):
            empty = self._block(csc_array((self._slacks, N * count)))
            blocks.append((*empty[:3], identity(self._slacks)))
        columns = list(zip(*blocks, strict=True))
        self.on_inputs, self.on_states, self.on_first = (
            csc_array(vstack(column)) for column in columns[:3]
        )
        for matrix in (self.on_inputs, self.on_states):
            matrix.eliminate_zeros()  # kron fills blocks up
        self.on_violations = csc_array(vstack([
            csc_array((block[0].shape[0], self._slacks)) if block[3] is None else block[3]
            for block in blocks
        ]))  # fmt: skip
        self.price = np.zeros(0)
        if problem.rows is not None:
            price = problem.rows.penalty[soft] * problem.rows.scale[soft]
            self.price = np.tile(problem.cost_scale * price, N)
        self.widths = [block[0].shape[0] // N for block in blocks]

    @property
    def parts(self) -> list[tuple[IntArray, int]]:
        """Indices of the limited rows in each block of them, and the first row of the block."""
        before = len(self.widths) - len(self._parts) - (1 if len(self.price) else 0)
        starts = self._problem.length * np.cumsum([0, *self.widths])[before:]
        return [(block[0], int(start)) for block, start in zip(self._parts, starts, strict=False)]

    def _block(self, on_inputs: csc_array) -> tuple[csc_array, csc_array, csc_array, None]:
        """Return a block of rows that sees inputs alone."""
        from scipy.sparse import csc_array

        rows, states = on_inputs.shape[0], len(self._problem.drift)
        none = csc_array((rows, self._problem.length * states))
        return on_inputs, none, csc_array((rows, states)), None

    def bounds(self, previous: FloatArray, data: StageData) -> Pair:
        """Return bounds of all rows, without the part of known states; previous is v_{−1}."""
        problem = self._problem
        low, high = [data.low.ravel() / problem.level], [data.high.ravel() / problem.level]
        if problem.change is not None:
            middle = -data.shift / problem.level
            middle[0] += previous / problem.level
            reach = problem.change / problem.level
            low.append((middle - reach).ravel())
            high.append((middle + reach).ravel())
        for taken, below, above in self._parts:
            assert problem.rows is not None  # there are parts
            scale = problem.rows.scale[taken]
            least, most = data.row_low[:, taken] / scale, data.row_high[:, taken] / scale
            low.append((least if below else np.full_like(least, -np.inf)).ravel())
            high.append((most if above else np.full_like(most, np.inf)).ravel())
        low.append(np.zeros(self._slacks))
        high.append(np.full(self._slacks, np.inf))
        return np.concatenate(low), np.concatenate(high)


def shifted(vector: FloatArray, length: int, widths: list[int], repeat: bool) -> FloatArray:
    """Drop the first step of each block of (length, width), and repeat the last or append zeros."""
    pieces, first = [], 0
    for width in widths:
        block = vector[first : first + length * width].reshape(length, width)
        pieces += [block[1:].ravel(), block[-1] if repeat else np.zeros(width)]
        first += length * width
    return np.concatenate(pieces)


@final
class Sparse:
    """States, inputs and violations are unknown, the dynamics are constraints.

    Unknowns are z_1 … z_N, u_0 … u_{N−1} and the violations, in units of the state, of one
    input and of the rows. States and inputs are measured from zero, or from a plan.

    Stage Jacobians are those of the problem, or ``varying`` and put in by :meth:`linearize`; where
    a matrix of the rows is zero, it stays so. With a terminal weight of ``[z_N; u_{N−1}]`` there
    are C_k too. ``motion_indices`` are of A_k, B_k and C_k; A_0 and C_0 meet only what is known.
    ``row_indices`` are of E_k, G_k and F_k, for each part of the limited rows.
    """

    def __init__(
        self, problem: MPCProblem, units: FloatArray | None = None, varying: bool = False
    ) -> None:
        from scipy.sparse import block_diag, csc_array, diags_array

        N, (s, a) = problem.length, problem.input_matrix.shape
        self._problem, self._states, self._count = problem, N * s, N * a
        self.units = units = np.ones(s) if units is None else units
        self._ramp = len(problem.terminal_weight) > s
        self.limits = LimitRows(problem)
        scale, level = problem.cost_scale, problem.level
        weights = [problem.state_weight] * (N - 1) + [problem.terminal_weight[:s, :s]]
        tracking = [scale * units[:, None] * weight * units for weight in weights]
        R = problem.input_weight
        effort = [scale * level**2 * (diags_array(R) if R.ndim == 1 else R)] * N
        # Zeros inside the blocks are left out: the pattern is fixed all the same.
        self._weights = csc_array(block_diag([csc_array(block) for block in tracking + effort]))
        if self._ramp:
            self._weights += self._by_last_input()
        self._cross = problem.cross_weight
        if self._cross is not None:
            self._cross = scale * level * self._cross  # in units of an input
            self._weights += self._by_both(units[:, None] * self._cross)
        self.P = csc_array(block_diag([self._weights, diags_array(self.limits.price)]))
        by_state, by_input = problem.transition, problem.input_matrix
        if varying:
            by_state, by_input = np.ones((s, s)), np.ones((s, a))
        self.A = self._pattern(by_state, by_input)
        every, factor = np.arange(s), -1 / units
        self.motion_indices = [
            self._indices(by_state, every, factor, 0, late=1),
            self._indices(by_input, every, factor, 0, inputs=True),
        ]
        if self._ramp:
            self.motion_indices.append(
                self._indices(by_input, every, factor, 0, late=1, inputs=True)
            )
        self.row_indices, rows = [], problem.rows
        for taken, start in self.limits.parts if varying else ():
            assert rows is not None  # there are parts
            factor, first = 1 / rows.scale[taken], self._states + start
            self.row_indices.append((
                self._indices(rows.by_state, taken, factor, first, late=1),
                self._indices(rows.by_input.toarray(), taken, factor, first, inputs=True),
                self._indices(rows.by_next_state, taken, factor, first),
            ))  # fmt: skip
        p = 0 if rows is None else len(rows.scale)
        self._row_offset, self._rows_first = np.zeros((N, p)), np.zeros((s, p))
        self._about: Pair | None = None
        if not varying:
            slopes = (np.tile(matrix.T, (N, 1, 1)) for matrix in (by_state, by_input))
            self.linearize(StageJacobians(np.zeros((N, s)), tuple(slopes)))
            if rows is not None:
                self._rows_first = rows.by_state.T

    def _by_last_input(self) -> csc_array:
        """Return what the terminal weight adds where it weighs u_{N−1} besides z_N."""
        from scipy.sparse import csc_array

        problem = self._problem
        N, (s, a) = problem.length, problem.input_matrix.shape
        units = np.r_[self.units, np.full(a, problem.level)]
        block = problem.cost_scale * units[:, None] * problem.terminal_weight * units
        block[:s, :s] = 0.0
        last = np.r_[(N - 1) * s + np.arange(s), N * s + (N - 1) * a + np.arange(a)]
        row, column = np.meshgrid(last, last, indexing="ij")
        return csc_array((block.ravel(), (row.ravel(), column.ravel())), self._weights.shape)

    def _by_both(self, block: FloatArray) -> csc_array:
        """Return what the cross weight adds: of z_k and u_k but for z_0, which is known."""
        from scipy.sparse import block_array, csc_array, eye, kron

        N = self._problem.length
        by_both = kron(eye(N, k=1), csc_array(block))
        return csc_array(block_array([[None, by_both], [by_both.T, None]]))

    def _pattern(self, by_state: FloatArray, by_input: FloatArray) -> csc_array:
        """Return A with ones where slopes of the motion go, so that no zero loses its place."""
        from scipy.sparse import csc_array, eye, hstack, identity, kron, vstack

        limits, N, (s, _) = self.limits, self._problem.length, by_input.shape
        earlier = eye(N, k=-1)
        ones = [csc_array((slope != 0).astype(float)) for slope in (by_state, by_input)]
        dynamics = hstack([
            identity(N * s) + csc_array(kron(earlier, ones[0])),
            kron(identity(N) + earlier if self._ramp else identity(N), ones[1]),
            csc_array((N * s, len(limits.price))),
        ])  # fmt: skip
        level = self._problem.level
        rows = hstack([limits.on_states, level * limits.on_inputs, limits.on_violations])
        pattern = csc_array(vstack([dynamics, rows]))
        pattern.sort_indices()
        return pattern

    def _indices(
        self, pattern: FloatArray, taken: IntArray, factor: FloatArray, start: int, late: int = 0,
        inputs: bool = False,
    ) -> SparsityIndices:  # fmt: skip
        """Return the indices of slopes of the N samples, by z_{k+1−late} or by u_{k−late}.

        Of m values, those taken have rows from ``start`` on, sample after sample, in units of
        ``factor``. The pattern, shape (m, columns), is zero where a slope has no place.
        """
        problem, (size, columns) = self._problem, pattern.shape
        units = np.full(columns, problem.level) if inputs else self.units
        first = self._states if inputs else 0
        j, i = np.nonzero(pattern[taken].T)
        k = np.arange(late, problem.length)[:, None]
        index = self._found(start + k * len(taken) + i, first + (k - late) * columns + j)
        source = (k * columns + j) * size + taken[i]
        scaled = np.tile(units[j] * factor[i], len(k))
        return SparsityIndices(index.ravel(), source.ravel(), scaled)

    def _found(self, row: IntArray, column: IntArray) -> IntArray:
        """Return the indices of entries of A in the order of columns."""
        rows, columns = self.A.shape
        keys = np.repeat(np.arange(columns), np.diff(self.A.indptr)) * rows + self.A.indices
        return np.asarray(np.searchsorted(keys, column * rows + row))

    def linearize(
        self, motion: StageJacobians, rows: StageJacobians | None = None, about: Pair | None = None
    ) -> None:
        """Put stage Jacobians from zero into A: of the motion, and of rows if they are limited.

        Unknowns are measured from a plan z_1 …, u_0 … if one is given. The solver stops at an
        error relative to the unknowns: of rest lengths of stiff strings, themselves thousands of
        stretches, that is too much.
        """
        values = self.A.data
        for indices, slope in zip(self.motion_indices, motion.slopes, strict=True):
            indices.fill(values, slope)
        if rows is not None:
            for block in self.row_indices:
                for indices, slope in zip(block, rows.slopes, strict=True):
                    indices.fill(values, slope)
            known = rows.values
            if about is not None:
                known = known + applied(rows.slopes[2], about[0])
                known = known + applied(rows.slopes[1], about[1])
                known[1:] += applied(rows.slopes[0][1:], about[0][:-1])
            self._row_offset, self._rows_first = known, rows.slopes[0][0].copy()
        self._first, self._offset = motion.slopes[0][0].copy(), motion.values
        if self._ramp:
            self._first_input = motion.slopes[2][0].copy()
        self._about = about
        if about is not None:
            states, inputs = about
            offset = motion.values - states + applied(motion.slopes[1], inputs)
            offset[1:] += applied(motion.slopes[0][1:], states[:-1])
            if self._ramp:
                offset[1:] += applied(motion.slopes[2][1:], inputs[:-1])
            self._offset = offset

    def vectors(
        self,
        state: FloatArray,
        data: StageData,
        previous: FloatArray,
        previous_input: FloatArray | None = None,
    ) -> Triple:
        """Return q, l and u from z_0 and v_{−1}, which matters only where the change is limited.

        With C_k the previous input of the motion is needed too.
        """
        level = self._problem.level
        if self._about is not None:
            states, planned = self._about
            data = replace(
                data,
                reference=data.reference - states,
                input_reference=data.input_reference - planned,
                low=data.low - planned,
                high=data.high - planned,
                shift=np.diff(planned, axis=0, prepend=planned[:1]),
            )
            previous = previous - planned[0]
        wanted = [data.reference / self.units, data.input_reference / level]
        motion = self._offset + data.drift
        motion[0] += state @ self._first
        if self._ramp and previous_input is not None:
            motion[0] += previous_input @ self._first_input
        motion /= self.units
        if self._rows_first.size:
            known = state @ self._rows_first
            row_low, row_high = (
                bound - self._row_offset for bound in (data.row_low, data.row_high)
            )
            row_low[0] -= known
            row_high[0] -= known
            data = replace(data, row_low=row_low, row_high=row_high)
        low, high = self.limits.bounds(previous, data)
        equal = motion.ravel()
        linear = -(self._weights @ np.concatenate([array.ravel() for array in wanted]))
        if self._cross is not None:
            off = state if data.first_reference is None else state - data.first_reference
            linear[self._states :][: self._cross.shape[1]] += off @ self._cross
        return (
            np.concatenate([linear, self.limits.price]),
            np.concatenate([equal, low]),
            np.concatenate([equal, high]),
        )  # fmt: skip

    def program(self, state: FloatArray, data: StageData, previous: FloatArray) -> QuadraticProgram:
        """Return the program of linear MPC; changes count from ``previous``, a whole input."""
        q, low, high = self.vectors(state, data, previous - data.origin[0])
        origin = frozen(data.origin.T)
        P, A = self.P.copy(), self.A.copy()
        return QuadraticProgram(P, q, A, low, high, self._states, self._problem.level, origin)

    def trajectory(self, x: FloatArray) -> Pair:
        """Return z_1 … z_N (N, s) and u_0 … u_{N−1} (N, α) of a solution."""
        N, count = self._problem.length, self._count
        scaled, rest = np.split(x, [self._states])
        states, planned = scaled.reshape(N, -1) * self.units, rest[:count].reshape(N, -1)
        planned = planned * self._problem.level
        if self._about is None:
            return states, planned
        return states + self._about[0], planned + self._about[1]

    def at_plan(self, guess: Pair) -> Pair:
        """Return a guess at a plan that unknowns are measured from, as it is without one."""
        if self._about is None:
            return guess
        x = guess[0].copy()
        x[: self._states + self._count] = 0.0
        return x, guess[1]

    def shifted(self, x: FloatArray, y: FloatArray) -> Pair:
        """Return a primal and dual solution moved on by one sample, to start the next from."""
        N, (s, a) = self._problem.length, self._problem.input_matrix.shape
        return (
            shifted(x, N, [s, a, len(self.limits.price) // N], repeat=True),
            shifted(y, N, [s, *self.limits.widths], repeat=False),
        )


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """A program ``min ½ xᵀ P x + qᵀ x  subject to  l ≤ A x ≤ u``. Made by :meth:`MPC.program`.

    The unknowns are z_1 … z_N, departures of the inputs u_0 … u_{N−1} in their unit, and violations
    of soft limits.

    Attributes
    ----------
    P : sparse array, shape (k, k)
        Symmetric; all of it.
    q : ndarray, shape (k,)
    A : sparse array, shape (m, k)
    l, u : ndarray, shape (m,)
        May be infinite, or equal.
    first : int
        Which unknown is the first departure of an input; they follow sample by sample.
    unit : float
        Unit of departures, N/m or m.
    origin : ndarray, shape (α, N)
        Inputs that departures are measured from, N/m or m.
    """

    P: csc_array
    q: FloatArray
    A: csc_array
    l: FloatArray  # noqa: E741 - the letters of the problem
    u: FloatArray
    first: int
    unit: float
    origin: FloatArray

    __repr__ = short_repr

    def inputs(self, x: object) -> FloatArray:
        """Return the inputs that a solution plans, shape (α, N), N/m or m: the command first.

        Parameters
        ----------
        x : array_like, shape (k,)

        Raises
        ------
        TypeError, ValueError
            If it is not finite or has the wrong shape.
        """
        solution = validation.shaped("x", x, self.q.shape, "one number per unknown")
        planned = solution[self.first : self.first + self.origin.size]
        return self.origin + self.unit * planned.reshape(self.origin.shape[::-1]).T


@final
class SparseProgram(LinearProgram):
    """The program of linear MPC with its states, and a solver of quadratic programs."""

    def __init__(self, form: Sparse, solver: QPSolver) -> None:
        self.form, self.solver, self.solver_name = form, solver, solver_name(solver)
        self._plan = np.zeros((0, 0))
        self._guess: Pair | None = None

    def reset(self) -> None:
        """See :meth:`LinearProgram.reset`."""
        self._plan = np.zeros((0, 0))
        self.forget()
        self.solver.reset()

    def forget(self) -> None:
        """See :meth:`LinearProgram.forget`."""
        self._guess = None

    @property
    def plan(self) -> FloatArray:
        """See :attr:`LinearProgram.plan`."""
        return self._plan

    def solve(
        self, state: FloatArray, data: StageData, previous: FloatArray, deadline: float
    ) -> LinearSolution:
        """See :meth:`LinearProgram.solve`."""
        vectors = self.form.vectors(state, data, previous - data.origin[0])
        answer = self.solver.solve(*vectors, start=self._guess, deadline=deadline)
        self._guess = None
        if answer.x is None or answer.y is None:
            return LinearSolution(answer.status, answer.iterations, None)
        self._guess = self.form.shifted(answer.x, answer.y)
        self._plan = data.origin + self.form.trajectory(answer.x)[1]
        return LinearSolution(answer.status, answer.iterations, self._plan[0])


@final
class SparseSubproblem(Subproblem):
    """The program with its states, and a solver of quadratic programs.

    Unknowns are measured from the plan where that ``relative`` is set.
    """

    def __init__(self, form: Sparse, solver: QPSolver, relative: bool) -> None:
        self.form, self.solver, self._relative = form, solver, relative
        self.solver_name = solver_name(solver)
        self._guess: Pair | None = None

    def reset(self) -> None:
        """See :meth:`Subproblem.reset`."""
        super().reset()
        self.solver.reset()

    def forget(self) -> None:
        """See :meth:`Subproblem.forget`."""
        self._guess = None

    def shift(self) -> None:
        """See :meth:`Subproblem.shift`."""
        if self._guess is not None:
            self._guess = self.form.shifted(*self._guess)

    def linearize(
        self, states: FloatArray, inputs: FloatArray, motion: StageJacobians,
        rows: StageJacobians | None,
    ) -> bool:  # fmt: skip
        """See :meth:`Subproblem.linearize`."""
        arguments = states[:-1], inputs[1:], inputs[:-1]
        motion = motion.from_zero(*arguments[: len(motion.slopes)])
        if rows is not None:
            rows = rows.from_zero(states[:-1], inputs[1:], states[1:])
        arrays = [
            array
            for jacobians in (motion, rows)
            if jacobians
            for array in (jacobians.values, *jacobians.slopes)
        ]
        if not all(np.isfinite(array).all() for array in arrays):
            return False
        self.form.linearize(motion, rows, (states[1:], inputs[1:]) if self._relative else None)
        self.solver.update(self.form.A.data)
        if self._guess is not None:
            self._guess = self.form.at_plan(self._guess)
        return True

    def solve(
        self, state: FloatArray, data: StageData, previous: FloatArray, acting: FloatArray,
        deadline: float,
    ) -> SubproblemSolution:  # fmt: skip
        """See :meth:`Subproblem.solve`."""
        vectors = self.form.vectors(state, data, previous, acting)
        answer = self.solver.solve(*vectors, start=self._guess, deadline=deadline)
        self._guess = None
        if answer.x is None or answer.y is None:
            return SubproblemSolution(answer.status, answer.iterations, None)
        self._guess = answer.x, answer.y
        later, inputs = self.form.trajectory(answer.x)
        plan = np.vstack([state, later]), np.vstack([acting, inputs])
        return SubproblemSolution(answer.status, answer.iterations, plan)
