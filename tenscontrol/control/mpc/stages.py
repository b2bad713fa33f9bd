"""Programs of MPC as least-distance programs along their stages, solved by an active set.

A Riccati recursion over the stages, in the preparation, makes the cost the square of a length; what
is measured moves the bounds alone. In linear MPC all stages are alike, and prepared once. Rows of
the matrix of limits are reached through the stages, and only those that may be active.
``solvers/stages.c`` has the equations: it is compiled where there is a compiler, and else NumPy and
DAQP find the same numbers.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import replace
from functools import cache
from time import perf_counter
from typing import Any, final

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.control.mpc.problem import (
    MPCProblem,
    Pair,
    StageData,
    StageJacobians,
    Subproblem,
    SubproblemSolution,
    Triple,
)
from tenscontrol.control.mpc.solvers.c_source import active_set_source, stages_source
from tenscontrol.control.mpc.solvers.daqp_adapter import least_distance
from tenscontrol.dynamics.machine_code import compiled_library, compiler, if_compiled
from tenscontrol.status import Status

# Of a limit, in its unit: what round-off may leave of it.
STAGES_TOLERANCE = 1e-10

_Stop = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
_NEVER = _Stop()


@cache
def _library() -> ctypes.CDLL:
    """Return the compiled program."""
    size = "size_t stages_program_size(void) { return sizeof(StagesProgram); }\n"
    text = "#define STAGES_API\n" + active_set_source() + stages_source() + size
    library = ctypes.CDLL(str(compiled_library(text)))
    library.stages_program_size.restype = ctypes.c_size_t
    return library


def has_compiled_program() -> bool:
    """Whether there is a compiler, and it compiles the program."""
    return compiler() is not None and if_compiled(_library) is not None


@cache
def _multiply() -> ctypes.c_void_p:
    """Return the address of the BLAS's matrix product, from SciPy."""
    from scipy.linalg import cython_blas

    capsule = cython_blas.__pyx_capi__["dgemm"]
    name, address = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    name.restype, name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    address.restype, address.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return ctypes.c_void_p(address(capsule, name(capsule)))


def _address(array: np.ndarray) -> int:
    return int(array.__array_interface__["data"][0])


def _weights(problem: MPCProblem) -> Triple:
    """Return Q, R and the terminal P of the state with which ramps begin, scaled."""
    scale, size = problem.cost_scale, len(problem.terminal_weight)
    state_weight, m = np.zeros((size, size)), len(problem.state_weight)
    state_weight[:m, :m] = scale * problem.state_weight
    return state_weight, scale * problem.input_weight, scale * problem.terminal_weight


def _prices(problem: MPCProblem) -> FloatArray:
    """Return the prices of all rows, shape (N, rows of a stage): inputs, changes, limited values.

    They are those of a violation by a unit, linear and quadratic; infinite for hard limits.
    """
    hard = np.full(len(problem.low) * (1 if problem.change is None else 2), np.inf)
    rows = problem.rows
    soft = np.zeros(0) if rows is None else problem.cost_scale * rows.penalty * rows.scale
    return np.tile(np.concatenate([hard, soft]), (problem.length, 1))


def stages_data(
    problem: MPCProblem, row_bounds: Pair, max_iterations: int, bounds: Pair
) -> tuple[list[int], list[FloatArray]]:
    """Return what ``stages_program_place`` in ``stages.c`` calls sizes and data."""
    N, (m, a) = problem.length, problem.input_matrix.shape
    ramp = len(problem.terminal_weight) > m
    rows, changes, price = problem.rows, problem.change is not None, _prices(problem)
    none = np.zeros(0)
    data = [
        *_weights(problem),
        none if rows is None else rows.scale,
        none if problem.change is None else problem.change,
        *bounds, *row_bounds, price, price,
    ]  # fmt: skip
    sizes = [
        N, m + a if ramp else m, a, 0 if rows is None else len(rows.scale), int(ramp),
        int(changes), int(np.isfinite(price).sum()), max_iterations,
        0 if rows is None else int(rows.by_next_state.any()),
    ]  # fmt: skip
    return sizes, [np.ascontiguousarray(part, dtype=float) for part in data]


def _thin_factors(problem: MPCProblem) -> list[FloatArray]:
    """Return D and Y of ``(I − Y Yᵀ) D (R + Bᵀ P B) D (I − Y Yᵀ) = I``; none if not worth it."""
    _, R, P = _weights(problem)
    (n, a), weight = problem.input_matrix.shape, np.diag(R).copy()
    if a <= 2 * n or np.count_nonzero(R - np.diag(weight)):
        return []
    unit, (squares, axes) = 1 / np.sqrt(weight), np.linalg.eigh(P)
    half = axes * np.sqrt(np.maximum(squares, 0.0))
    Y, size, _ = np.linalg.svd(unit[:, None] * (problem.input_matrix.T @ half), full_matrices=False)
    return [unit, np.ascontiguousarray(Y * np.sqrt(1 - 1 / np.sqrt(1 + size**2)))]


@final
class LeastDistance(Subproblem):
    """The program in compiled C, with memory of its own."""

    solver_name = "stages"

    def __init__(
        self, problem: MPCProblem, row_bounds: Pair, max_iterations: int, bounds: Pair,
        alike: bool = False, tolerance: float = 0.0,
    ) -> None:  # fmt: skip
        self._made_of = problem, row_bounds, max_iterations, bounds, alike, tolerance
        self._tolerance = tolerance
        library, N, (m, a) = _library(), problem.length, problem.input_matrix.shape
        numbers_of, data = stages_data(problem, row_bounds, max_iterations, bounds)
        n, rows = numbers_of[1], data[10].size
        thin = _thin_factors(problem) if alike else []
        data += thin
        sizes = (ctypes.c_int * 11)(*numbers_of, alike, len(thin) > 0)
        self._data = data
        addresses = (ctypes.c_void_p * len(data))(*(_address(part) for part in self._data))
        self._program = ctypes.create_string_buffer(library.stages_program_size())
        counts, views = (ctypes.c_size_t * 3)(), (ctypes.c_void_p * 7)()
        given = (
            self._program, sizes, ctypes.c_double(problem.level), ctypes.c_double(STAGES_TOLERANCE),
            _multiply(), addresses,
        )  # fmt: skip
        library.stages_program_place(*given, None, None, None, counts, views)
        numbers = np.zeros(counts[0])
        self._memory = numbers, np.zeros(counts[1], np.intc), np.zeros(counts[2], np.intp)
        places = (ctypes.c_void_p(_address(part)) for part in self._memory)
        library.stages_program_place(*given, *places, counts, views)
        self._unit, p = data[3], numbers_of[3]
        shapes = [(N + 1, m), (N + 1, a), (rows,), (N + 1, n), (N, a), (N, n), (N, p)]
        (
            self._states, self._inputs, self._multipliers, moves, self._input_moves, self._gap,
            self._values,
        ) = (
            numbers[(place - _address(numbers)) // 8 :][: math.prod(shape)].reshape(shape)
            for place, shape in zip(views, shapes, strict=True)
        )  # fmt: skip
        self._moves = moves[:, :m]
        self._shift, self._prepare, self._solve, self._count = (
            getattr(library, f"stages_program_{name}")
            for name in ("shift", "prepare", "solve", "iterations")
        )
        pointer = ctypes.c_void_p
        self._prepare.argtypes = [*[pointer] * 3, ctypes.c_double, *[pointer] * 8]
        self._solve.argtypes = [pointer] * 7 + [_Stop]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what it is made of, and which limits are active; it is not prepared then."""
        return LeastDistance, self._made_of, self._multipliers.copy()

    def __setstate__(self, multipliers: FloatArray) -> None:
        """Take the active limits of another one."""
        self._multipliers[:] = multipliers

    def forget(self) -> None:
        """See :meth:`Subproblem.forget`."""
        self._multipliers[:] = 0.0

    def shift(self) -> None:
        """See :meth:`Subproblem.shift`."""
        self._shift(self._program)

    def measure_from(self, inputs: FloatArray, values: FloatArray) -> None:
        """See :class:`LinearProgram`."""
        self._inputs[:], self._values[:], self._gap[:] = inputs, values / self._unit, 0.0

    def linearize(
        self, states: FloatArray, inputs: FloatArray, motion: StageJacobians,
        rows: StageJacobians | None,
    ) -> bool:  # fmt: skip
        """See :meth:`Subproblem.linearize`: the Riccati recursion, and the rows last active."""
        self._states[:], self._inputs[:] = states, inputs
        parts = [motion.values, *motion.slopes, *[None] * (3 - len(motion.slopes))]
        parts += [None] * 4 if rows is None else [rows.values, *rows.slopes]
        kept = [None if part is None else np.ascontiguousarray(part, float) for part in parts]
        self._limited = kept[4:]  # which the program reads until it is solved
        which = [
            part if part is None else part.astype(np.intc) for part in (motion.slots, motion.fresh)
        ]
        slots, fresh, *addresses = (
            part if part is None else _address(part) for part in which + kept
        )
        return bool(self._prepare(self._program, slots, fresh, self._tolerance, *addresses))

    def solve(
        self, state: FloatArray, data: StageData, previous: FloatArray, acting: FloatArray,
        deadline: float,
    ) -> SubproblemSolution:  # fmt: skip
        """See :meth:`Subproblem.solve`."""
        stop = _NEVER
        if deadline < np.inf:
            if perf_counter() >= deadline:
                return SubproblemSolution(Status.OUT_OF_TIME, 0, None)
            stop = _Stop(lambda _: perf_counter() >= deadline)
        given = state, acting, data.reference, data.input_reference, data.drift, previous
        kept = [np.ascontiguousarray(part, float) for part in given]
        status = tuple(Status)[self._solve(self._program, *map(_address, kept), stop)]
        plan = None
        if status is Status.OK:
            inputs = np.concatenate([acting[None], self._inputs[1:] + self._input_moves])
            plan = self._states + self._moves, inputs
        return SubproblemSolution(status, self._count(self._program), plan)


@final
class LeastDistanceArrays(Subproblem):
    """The program in arrays of NumPy, solved by DAQP on the rows that may be active.

    These are the rows active last, and those that a solution without them violates, until none is.
    Of the stages in closed loop, ``[z_{k+1}; u_k] = T_k [z_k; x_k − f_k] + [d_k; 0]``.
    """

    solver_name = "daqp"

    def __init__(
        self, problem: MPCProblem, row_bounds: Pair, max_iterations: int, bounds: Pair,
        alike: bool = False,
    ) -> None:  # fmt: skip
        self._problem, self._bounds, self._max_iterations = problem, bounds, max_iterations
        self._weights, self._price = _weights(problem), _prices(problem)
        self._plant_states, self._inputs = problem.input_matrix.shape
        self._states = len(problem.terminal_weight)
        p = self._limited = 0 if problem.rows is None else len(problem.rows.scale)
        N, a, n = problem.length, self._inputs, self._states
        self._unit = np.ones(0) if problem.rows is None else problem.rows.scale
        self._row_bounds = tuple(bound / self._unit for bound in row_bounds)
        self._plan: Pair = np.zeros((0, 0)), np.zeros((0, 0))
        self._many = 1 if alike else N  # of each matrix
        self._by_all = tuple(np.zeros((self._many, p, width)) for width in (n, a, n))
        self._E, self._G, self._F = map(self._of_all, self._by_all)
        self.forget()

    def _of_all(self, matrices: FloatArray) -> FloatArray:
        """Return the matrices of all stages."""
        return np.broadcast_to(matrices, (self._problem.length, *matrices.shape[1:]))

    def forget(self) -> None:
        """See :meth:`Subproblem.forget`."""
        self._active = np.zeros(self._price.shape, bool)

    def shift(self) -> None:
        """See :meth:`Subproblem.shift`."""
        self._active = np.vstack([self._active[1:], np.zeros_like(self._active[:1])])

    def measure_from(self, inputs: FloatArray, values: FloatArray) -> None:
        """See :class:`LinearProgram`."""
        self._plan, self._values = (self._plan[0], inputs), values / self._unit
        self._rows = np.flatnonzero(self._active)
        self._matrix = self._matrix_of(self._rows)

    def linearize(
        self, states: FloatArray, inputs: FloatArray, motion: StageJacobians,
        rows: StageJacobians | None,
    ) -> bool:  # fmt: skip
        """See :meth:`Subproblem.linearize`."""
        motion = motion.in_order()
        parts = [part for each in (motion, rows) if each for part in (each.values, *each.slopes)]
        if not all(np.isfinite(part).all() for part in parts):
            return False
        N, a, n, m = self._problem.length, self._inputs, self._states, self._plant_states
        self._plan = states, inputs
        self._gap = np.hstack([motion.values - states[1:], np.zeros((N, n - m))])
        by_all = np.zeros((self._many, n, a + n))  # [B A]
        by_all[:, :m, a : a + m], by_all[:, :m, :a] = (
            slope.swapaxes(1, 2) for slope in motion.slopes[:2]
        )
        if n > m:
            by_all[:, :m, a + m :] = motion.slopes[2].swapaxes(1, 2)
            by_all[:, m:, :a] = np.eye(a)
        if rows is not None:
            self._values = rows.values / self._unit
            for matrix, slope in zip(self._by_all, rows.slopes, strict=True):
                matrix[:, :, : slope.shape[1]] = slope.swapaxes(1, 2) / self._unit[:, None]
        self._recur(by_all)
        self._rows = np.flatnonzero(self._active)
        self._matrix = self._matrix_of(self._rows)
        return True

    def _recur(self, by_all: FloatArray) -> None:
        """Find P_1 … P_N, and the stages in closed loop."""
        N, a, n = self._many, self._inputs, self._states
        Q, R, cost = self._weights
        costs = np.zeros((N, n, n))
        S, W = np.zeros((N, a, a)), np.zeros((N, a, n))
        for k in range(N - 1, -1, -1):
            costs[k] = cost
            square = by_all[k].T @ (cost @ by_all[k])
            S[k] = np.linalg.inv(np.linalg.cholesky(square[:a, :a] + R)).T
            W[k] = S[k].T @ square[:a, a:]
            cost = Q + square[a:, a:] - W[k].T @ W[k]
            cost = 0.5 * (cost + cost.T)
        by_x, by_state = by_all[:, :, :a] @ S, -S @ W
        closed = np.zeros((N, n + a, n + a))  # T
        closed[:, :n, :n] = by_all[:, :, a:] - by_x @ W
        closed[:, :n, n:], closed[:, n:, :n], closed[:, n:, n:] = by_x, by_state, S
        self._closed, self._costs = self._of_all(closed), self._of_all(costs)

    def _matrix_of(self, rows: IntArray) -> FloatArray:
        """Return rows of the matrix of limits, shape (count, N α): one sweep backward for all."""
        N, a, n, p = self._problem.length, self._inputs, self._states, self._limited
        (stage, kind), count = np.divmod(rows, self._price.shape[1]), len(rows)
        by_state, ahead = np.zeros((2, N, n, count))
        by_input, level = np.zeros((N, a, count)), self._problem.level
        which = np.arange(count)
        of_input, of_value = kind < a, kind >= self._price.shape[1] - p
        of_change = ~of_input & ~of_value
        direct = of_input | of_change
        by_input[stage[direct], kind[direct] % a, which[direct]] = 1 / level
        late = of_change & (stage > 0)
        by_input[stage[late] - 1, kind[late] - a, which[late]] = -1 / level
        at, number = stage[of_value], kind[of_value] - (self._price.shape[1] - p)
        by_input[at, :, which[of_value]] = self._G[at, number]
        by_state[at, :, which[of_value]] = self._E[at, number]
        ahead[at, :, which[of_value]] = self._F[at, number]
        matrix, adjoint = np.zeros((count, N, a)), np.zeros((n, count))
        for k in range(int(stage.max(initial=-1)), -1, -1):
            both = self._closed[k].T @ np.vstack([adjoint + ahead[k], by_input[k]])
            adjoint, matrix[:, k] = both[:n] + by_state[k], both[n:].T
        return matrix.reshape(count, N * a)

    def _simulated(self, first: FloatArray, x: FloatArray, gap: FloatArray) -> Pair:
        """Return departures z_0 … z_N, shape (N + 1, n), and u_0 …, (N, α), for x − f (N, α)."""
        n, z, u = self._states, [first], []
        for k, closed in enumerate(self._closed):
            both = closed @ np.concatenate([z[-1], x[k]])
            z.append(both[:n] + gap[k])
            u.append(both[n:])
        return np.array(z), np.array(u)

    def _limits(self, z: FloatArray, u: FloatArray) -> FloatArray:
        """Return the values of all limits at departures from the plan, less those of the plan."""
        level, parts = self._problem.level, [u / self._problem.level]
        if self._problem.change is not None:
            parts.append(np.diff(u, axis=0, prepend=0.0) / level)
        if self._limited:
            by_all = self._E @ z[:-1, :, None] + self._G @ u[:, :, None] + self._F @ z[1:, :, None]
            parts.append(by_all[:, :, 0])
        return np.hstack(parts)

    def solve(
        self, state: FloatArray, data: StageData, previous: FloatArray, acting: FloatArray,
        deadline: float,
    ) -> SubproblemSolution:  # fmt: skip
        """See :meth:`Subproblem.solve`."""
        problem, (states, inputs) = self._problem, self._plan
        N, a, m, level = problem.length, self._inputs, self._plant_states, problem.level
        gap = self._gap.copy()
        gap[:, :m] += data.drift
        first = state - states[0]
        if self._states > m:
            first = np.concatenate([first, acting - inputs[0]])
        feedforward = self._feedforward(data, gap)
        z, u = self._simulated(first, -feedforward, gap)
        middle = self._limits(z, u)
        lower, upper = ([(bound - inputs[1:]) / level] for bound in self._bounds)
        if problem.change is not None:
            change = np.diff(inputs, axis=0)
            change[0] = inputs[1] - previous
            lower.append((-problem.change - change) / level)
            upper.append((problem.change - change) / level)
        if self._limited:
            lower.append(self._row_bounds[0] - self._values)
            upper.append(self._row_bounds[1] - self._values)
        bounds = np.hstack(lower) - middle, np.hstack(upper) - middle
        if not (np.isfinite(middle).all() and np.isfinite(feedforward).all()):
            return SubproblemSolution(Status.BAD_DATA, 0, None)
        x, values, work = np.zeros((N, a)), np.zeros(self._price.shape), 0
        rows, matrix, is_row = self._rows, self._matrix, self._active.copy()
        multipliers = np.zeros(0)
        for _ in range(self._max_iterations):
            if perf_counter() >= deadline:
                return SubproblemSolution(Status.OUT_OF_TIME, work, None)
            if len(rows):
                low, high, price = (part.flat[rows] for part in (*bounds, self._price))
                status, multipliers, iterations = least_distance(
                    matrix, low, high, price, STAGES_TOLERANCE, self._max_iterations, deadline
                )
                work += iterations
                if status is not Status.OK:
                    return SubproblemSolution(status, work, None)
                x = -(multipliers @ matrix).reshape(N, a)
                values = self._limits(*self._simulated(np.zeros_like(first), x, np.zeros_like(gap)))
            over = np.maximum(values - bounds[1], bounds[0] - values)
            new = np.flatnonzero((over > STAGES_TOLERANCE * (1 + np.abs(values))) & ~is_row)
            if not len(new):
                break
            is_row.flat[new] = True
            rows, matrix = np.concatenate([rows, new]), np.vstack([matrix, self._matrix_of(new)])
        else:
            return SubproblemSolution(Status.OUT_OF_ITERATIONS, work, None)
        self._active[:] = False
        self._active.flat[rows[multipliers != 0]] = True
        z, u = self._simulated(first, x - feedforward, gap)
        plan = states + z[:, :m], np.concatenate([acting[None], inputs[1:] + u])
        return SubproblemSolution(Status.OK, work, plan)

    def _feedforward(self, data: StageData, gap: FloatArray) -> FloatArray:
        """Return f, shape (N, α), from the targets."""
        (states, inputs), n, m = self._plan, self._states, self._plant_states
        Q, R, P = self._weights
        off = np.zeros((len(gap), n))
        off[:, :m], effort = states[1:] - data.reference, inputs[1:] - data.input_reference
        off[-1, m:] = effort[-1][: n - m]
        slope = off @ Q
        slope[-1] = P @ off[-1]
        slope += (self._costs @ gap[:, :, None])[:, :, 0]
        effort, tail, found = effort @ R, np.zeros(n), np.zeros_like(effort)
        for k in range(len(gap) - 1, -1, -1):
            both = self._closed[k].T @ np.concatenate([slope[k] + tail, effort[k]])
            tail, found[k] = both[:n], both[n:]
        return found


class LinearProgram:
    """The program of linear MPC: of stages that are alike, prepared once.

    Its plan is at rest where inputs and limited values are measured from, so that their bounds are
    those of whole inputs and values, which nothing moves.
    """

    def __init__(
        self, problem: MPCProblem, row_bounds: Pair, max_iterations: int, bounds: Pair
    ) -> None:
        kind = LeastDistance if has_compiled_program() else LeastDistanceArrays
        self.program = kind(problem, row_bounds, max_iterations, bounds, alike=True)
        self._problem, self._row_bounds = problem, row_bounds
        self._data: StageData | None = None
        self._prepare()

    def _prepare(self) -> None:
        problem, rows = self._problem, self._problem.rows
        N, (s, a) = problem.length, problem.input_matrix.shape
        motion, limited = (problem.transition, problem.input_matrix), None
        if rows is not None:
            by_all = rows.by_state, rows.by_input, rows.by_next_state
            values = np.zeros((N, len(rows.scale)))
            limited = StageJacobians(values, tuple(part.T[None] for part in by_all))
        slopes = tuple(part.T[None] for part in motion)
        nothing = np.zeros((N + 1, s)), np.zeros((N + 1, a))
        self.program.linearize(*nothing, StageJacobians(np.zeros((N, s)), slopes), limited)

    def __setstate__(self, kept: dict[str, Any]) -> None:
        """Prepare a copy anew: compiled memory is not copied."""
        self.__dict__.update(kept)
        self._data = None
        self._prepare()

    def solve(
        self, state: FloatArray, data: StageData, previous: FloatArray, deadline: float
    ) -> SubproblemSolution:
        """Solve for a measured z_0; the plan has whole inputs. Start from the last solution."""
        if self._data is not data:
            self._data, self._values = data, np.zeros_like(data.row_low)
            for whole, moved in zip(self._row_bounds, (data.row_low, data.row_high), strict=True):
                there = np.isfinite(whole)
                self._values[:, there] = whole[there] - moved[:, there]
            self._inputs = np.vstack([data.previous_origin, data.origin])
            self._whole = replace(data, input_reference=data.origin + data.input_reference)
        self.program.measure_from(self._inputs, self._values)
        answer = self.program.solve(state, self._whole, previous, self._inputs[0], deadline)
        if answer.plan is None:
            self.program.forget()
        else:
            self.program.shift()
        return answer
