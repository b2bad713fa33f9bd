"""Programs of MPC as least-distance programs along their stages, solved by the compiled core.

A Riccati recursion over the stages, in the preparation, makes the cost the square of a length; what
is measured moves the bounds alone. In linear MPC all stages are alike, and prepared once. Rows of
the matrix of limits are reached through the stages, and only those that may be active.
``core/stages.h`` has the equations.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from time import perf_counter
from typing import Any, final

import numpy as np

from tenscontrol.arrays import FloatArray
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
)
from tenscontrol.control.mpc.qp_solver import MOST_ITERATIONS
from tenscontrol.core.library import library
from tenscontrol.plant.linear_plant import tall_qr
from tenscontrol.status import Status

# Of a limit, in its unit: what round-off may leave of it.
STAGES_TOLERANCE = 1e-10

# Of c of thin factors: rows are sums of parts that are larger by one over it, and cancel.
_LEAST_SHRINK = 5e-3

# Changes of the active set for each limit, where no number is asked for: random programs from far
# out took 8 at most.
_MOST_CHANGES = 10

_SIZES = (
    "stages", "states", "inputs", "limited", "ramp", "changes", "soft", "limit", "ahead", "alike",
    "thin", "crossed",
)  # fmt: skip
_DATA = (
    "Q", "R", "P", "cross", "scale", "change", "low", "high", "least", "most", "price",
    "curvature", "unit", "V", "T", "shrink", "G_start", "G_which",
)  # fmt: skip

_STATUS = tuple(Status)

_Stop = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
_NEVER = _Stop()


class _Sizes(ctypes.Structure):
    _fields_ = [(name, ctypes.c_int) for name in _SIZES]


class _Data(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in _DATA]


@cache
def _library() -> ctypes.CDLL:
    """Return the core with the types of its functions."""
    core = library()
    assert core is not None  # callers look for it
    core.stages_program_size.restype = ctypes.c_size_t
    pointer = ctypes.c_void_p
    core.stages_program_prepare.argtypes = [*[pointer] * 3, ctypes.c_double, *[pointer] * 8]
    core.stages_program_aim.argtypes = [pointer] * 5
    core.stages_program_solve.argtypes = [*[pointer] * 4, _Stop]
    return core


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
    """Return Q, R and the terminal P of the state with which ramps begin, scaled.

    A diagonal R may have the shape (α,).
    """
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


def _thin_factors(problem: MPCProblem) -> tuple[FloatArray, ...] | None:
    """Return D, V, T and c of ``S = D (I − V (I − diag c) Vᵀ)`` with ``D Bᵀ = V T``.

    V is orthonormal, and ``Sᵀ (R + Bᵀ P B) S = I``. None if R is no diagonal, states and inputs
    share a weight, inputs are few, or some cost so little that c is nearly zero.
    """
    _, R, P = _weights(problem)
    n, a = problem.input_matrix.shape
    if a <= 2 * n or R.ndim == 2 or problem.cross_weight is not None:
        return None
    unit, (squares, axes) = 1 / np.sqrt(R), np.linalg.eigh(P)
    half = axes * np.sqrt(np.maximum(squares, 0.0))
    V, T = tall_qr(unit[:, None] * problem.input_matrix.T)
    turn, size, _ = np.linalg.svd(T @ half)
    shrink = 1 / np.sqrt(1 + size**2)
    return None if shrink.min() < _LEAST_SHRINK else (unit, V @ turn, turn.T @ T, shrink)


def stages_data(
    problem: MPCProblem,
    row_bounds: Pair,
    max_iterations: int | None,
    bounds: Pair,
    alike: bool = False,
) -> tuple[dict[str, int], dict[str, np.ndarray]]:
    """Return the records ``StagesSizes`` and ``StagesData`` of ``stages.h``, by field."""
    N, (m, a) = problem.length, problem.input_matrix.shape
    ramp = len(problem.terminal_weight) > m
    rows, change, price = problem.rows, problem.change, _prices(problem)
    none, no_pattern = np.zeros(0), (np.zeros(1), np.zeros(0))
    cross = none if problem.cross_weight is None else problem.cost_scale * problem.cross_weight
    thin = _thin_factors(problem) if alike else None
    scale = none if rows is None else rows.scale
    Q, R, P = _weights(problem)
    if thin is not None:
        R = none
    elif R.ndim == 1:
        R = np.diag(R)
    arrays = (
        Q, R, P, cross, scale, none if change is None else change, *bounds, *row_bounds, price,
        price, *(thin or (none,) * 4),
    )  # fmt: skip
    pattern = no_pattern if rows is None else (rows.by_input.indptr, rows.by_input.indices)
    sizes = {
        "stages": N,
        "states": m + a if ramp else m,
        "inputs": a,
        "limited": len(scale),
        "ramp": int(ramp),
        "changes": int(change is not None),
        "soft": int(np.isfinite(price).sum()),
        "limit": max_iterations or max(MOST_ITERATIONS, _MOST_CHANGES * price.size),
        "ahead": 0 if rows is None else int(rows.by_next_state.any()),
        "alike": int(alike),
        "thin": int(thin is not None),
        "crossed": int(problem.cross_weight is not None),
    }
    data = [np.ascontiguousarray(array, dtype=float) for array in arrays]
    data += [np.ascontiguousarray(array, dtype=np.intc) for array in pattern]
    return sizes, dict(zip(_DATA, data, strict=True))


def values_from(row_bounds: Pair, data: StageData) -> FloatArray:
    """Return the limited values, (N, p), whose whole bounds these are, where rows have data's."""
    values = np.zeros_like(data.row_low)
    for whole, moved in zip(row_bounds, (data.row_low, data.row_high), strict=True):
        bounded = np.isfinite(whole)
        values[:, bounded] = whole[bounded] - moved[:, bounded]
    return values


class _CoreProgram:
    """A ``StagesProgram`` of the core with its memory; z, u and y are views of it."""

    def __init__(
        self,
        problem: MPCProblem,
        row_bounds: Pair,
        max_iterations: int | None,
        bounds: Pair,
        alike: bool,
    ) -> None:
        core, N, (m, a) = _library(), problem.length, problem.input_matrix.shape
        sizes, data = stages_data(problem, row_bounds, max_iterations, bounds, alike)
        n, p, rows = sizes["states"], sizes["limited"], data["price"].size
        self._data, self.scale = data, data["scale"]
        self.program = ctypes.create_string_buffer(core.stages_program_size())
        counts, views = (ctypes.c_size_t * 3)(), (ctypes.c_void_p * 7)()
        given = (
            self.program, ctypes.byref(_Sizes(**sizes)), ctypes.c_double(problem.level),
            ctypes.c_double(STAGES_TOLERANCE), _multiply(),
            ctypes.byref(_Data(**{name: _address(array) for name, array in data.items()})),
        )  # fmt: skip
        core.stages_program_place(*given, None, None, None, counts, views)
        numbers = np.zeros(counts[0])
        self._memory = numbers, np.zeros(counts[1], np.intc), np.zeros(counts[2], np.intp)
        places = (ctypes.c_void_p(_address(array)) for array in self._memory)
        core.stages_program_place(*given, *places, counts, views)
        shapes = [(N + 1, m), (N + 1, a), (rows,), (N + 1, n), (N, a), (N, n), (N, p)]
        (
            self.states, self.inputs, self.multipliers, moves, self.input_moves, self.gap,
            self.values,
        ) = (
            numbers[(address - _address(numbers)) // 8 :][: math.prod(shape)].reshape(shape)
            for address, shape in zip(views, shapes, strict=True)
        )  # fmt: skip
        self.moves = moves[:, :m]
        self.shift, self._prepare, self._aim, self._solve, self.plan, self.iterations = (
            getattr(core, f"stages_program_{name}")
            for name in ("shift", "prepare", "aim", "solve", "plan", "iterations")
        )

    def prepare(
        self, motion: StageJacobians, rows: StageJacobians | None, tolerance: float = 0.0
    ) -> bool:
        """Prepare along the plan in z and u; return whether data are finite."""
        arrays = [motion.values, *motion.slopes, *[None] * (3 - len(motion.slopes))]
        arrays += [None] * 4 if rows is None else [rows.values, *rows.slopes]
        contiguous = [
            None if array is None else np.ascontiguousarray(array, float) for array in arrays
        ]
        self._limited = contiguous[4:]  # which the program reads until it is solved
        which = [
            array if array is None else array.astype(np.intc)
            for array in (motion.slots, motion.fresh)
        ]
        slots, fresh, *addresses = (
            array if array is None else _address(array) for array in which + contiguous
        )
        return bool(self._prepare(self.program, slots, fresh, tolerance, *addresses))

    def aim_at(self, data: StageData, inputs: FloatArray) -> None:
        """Put in the targets; inputs are s_k, shape (N, α)."""
        given = data.reference, inputs, data.first_reference, data.drift
        contiguous = [
            None if array is None else np.ascontiguousarray(array, float) for array in given
        ]
        self._aim(
            self.program,
            *(array if array is None else _address(array) for array in contiguous),
        )

    def solve(self, measured: Iterable[int], deadline: float) -> Status:
        """Solve for state, acting and previous input at these addresses, until the deadline."""
        stop = _NEVER
        if deadline < np.inf:
            if perf_counter() >= deadline:
                return Status.OUT_OF_TIME
            stop = _Stop(lambda _: perf_counter() >= deadline)
        number: int = self._solve(self.program, *measured, stop)
        return _STATUS[number]


@final
class StagesSubproblem(Subproblem):
    """The program of nonlinear MPC in the compiled core."""

    solver_name = "stages"

    def __init__(
        self, problem: MPCProblem, row_bounds: Pair, max_iterations: int | None, bounds: Pair,
        tolerance: float = 0.0,
    ) -> None:  # fmt: skip
        self._made_of = problem, row_bounds, max_iterations, bounds, tolerance
        self._tolerance = tolerance
        self._core = _CoreProgram(problem, row_bounds, max_iterations, bounds, alike=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what it is made of, and which limits are active; it is not prepared then."""
        return StagesSubproblem, self._made_of, self._core.multipliers.copy()

    def __setstate__(self, multipliers: FloatArray) -> None:
        """Take the active limits of another one."""
        self._core.multipliers[:] = multipliers

    def forget(self) -> None:
        """See :meth:`Subproblem.forget`."""
        self._core.multipliers[:] = 0.0

    def shift(self) -> None:
        """See :meth:`Subproblem.shift`."""
        self._core.shift(self._core.program)

    def linearize(
        self, states: FloatArray, inputs: FloatArray, motion: StageJacobians,
        rows: StageJacobians | None,
    ) -> bool:  # fmt: skip
        """See :meth:`Subproblem.linearize`: the Riccati recursion, and the rows last active."""
        self._core.states[:], self._core.inputs[:] = states, inputs
        return self._core.prepare(motion, rows, self._tolerance)

    def solve(
        self, state: FloatArray, data: StageData, previous: FloatArray, acting: FloatArray,
        deadline: float,
    ) -> SubproblemSolution:  # fmt: skip
        """See :meth:`Subproblem.solve`."""
        core = self._core
        core.aim_at(data, data.input_reference)
        given = [np.ascontiguousarray(array, float) for array in (state, acting, previous)]
        status = core.solve(map(_address, given), deadline)
        if status is Status.OUT_OF_TIME:
            return SubproblemSolution(status, 0, None)
        plan = None
        if status is Status.OK:
            inputs = np.concatenate([acting[None], core.inputs[1:] + core.input_moves])
            plan = core.states + core.moves, inputs
        return SubproblemSolution(status, core.iterations(core.program), plan)


@final
class StagesProgram(LinearProgram):
    """The program of linear MPC in the compiled core.

    Stages are alike, and prepared once, but where the terminal cost is not that of the LQR: then
    samples prepare anew, from steps of the recursion that are known. Its plan is at rest where
    inputs and limited values are measured from, so that their bounds are those of whole inputs and
    values, which nothing moves.
    """

    solver_name = "stages"

    def __init__(
        self, problem: MPCProblem, row_bounds: Pair, max_iterations: int | None, bounds: Pair
    ) -> None:
        self._made_of = problem, row_bounds, max_iterations, bounds
        self._alike = alike = problem.steady
        core = self._core = _CoreProgram(*self._made_of, alike=alike)
        self._row_bounds = row_bounds
        N, (s, a) = problem.length, problem.input_matrix.shape
        limited, rows = None, problem.rows
        if rows is not None:
            by_input = rows.by_input.data[:, None] if alike else rows.by_input.toarray().T
            by_all = rows.by_state.T, by_input, rows.by_next_state.T
            values, count = np.zeros((N, len(rows.scale))), 1 if alike else N
            limited = StageJacobians(values, tuple(np.tile(x, (count, 1, 1)) for x in by_all))
        slopes = tuple(matrix.T[None] for matrix in (problem.transition, problem.input_matrix))
        slots = None if alike else np.zeros(N, int)
        fresh = None if alike else np.arange(N) == 0
        motion = StageJacobians(np.zeros((N, s)), slopes, slots, fresh)
        core.prepare(motion, limited)
        self._limited = limited
        self._motion = replace(motion, fresh=None if alike else np.zeros(N, bool))
        # What is measured, where the core reads it.
        self._state, self._previous = np.zeros(s), np.zeros(a)
        self._given = _address(self._state), _address(core.inputs), _address(self._previous)
        self._data: StageData | None = None
        self._origin: FloatArray | None = None  # of the last solution
        self._plan: FloatArray | None = np.zeros((0, a))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what it is made of, which limits are active, and the plan."""
        return StagesProgram, self._made_of, (self._core.multipliers.copy(), self.plan)

    def __setstate__(self, state: Pair) -> None:
        """Take the active limits and the plan of another one."""
        self._core.multipliers[:], self._plan = state

    def forget(self) -> None:
        """See :meth:`LinearProgram.forget`."""
        self._core.multipliers[:] = 0.0

    def reset(self) -> None:
        """See :meth:`LinearProgram.reset`."""
        self.forget()
        self._plan = np.zeros((0, len(self._previous)))

    @property
    def plan(self) -> FloatArray:
        """See :attr:`LinearProgram.plan`."""
        if self._plan is None:
            self._core.plan(self._core.program)
            assert self._origin is not None  # solved
            self._plan = self._origin + self._core.input_moves
        return self._plan

    def _aim(self, data: StageData) -> None:
        """Take other data than those of the last sample."""
        core = self._core
        core.inputs[0], core.inputs[1:] = data.previous_origin, data.origin
        core.values[:], core.gap[:] = values_from(self._row_bounds, data) / core.scale, 0.0
        if not self._alike:
            limited = self._limited
            if limited is not None:
                limited = replace(limited, values=core.values * core.scale)
            core.prepare(self._motion, limited)
        core.aim_at(data, data.origin + data.input_reference)
        self._data = data

    def solve(
        self, state: FloatArray, data: StageData, previous: FloatArray, deadline: float
    ) -> LinearSolution:
        """See :meth:`LinearProgram.solve`: from the active set of the last solution."""
        core = self._core
        if self._data is not data or not self._alike:
            self._aim(data)
        self._state[:], self._previous[:] = state, previous
        status = core.solve(self._given, deadline)
        work = 0 if status is Status.OUT_OF_TIME else core.iterations(core.program)
        if status is not Status.OK:
            self.forget()
            return LinearSolution(status, work, None)
        first = data.origin[0] + core.input_moves[0]
        self._plan, self._origin = None, data.origin
        if not self._alike:
            self._plan = data.origin + core.input_moves
        core.shift(core.program)
        return LinearSolution(status, work, first)
