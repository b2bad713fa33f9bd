"""The program of NMPC as a least-distance program along its stages, solved by an active set.

A Riccati recursion over the stages, in the preparation, makes the cost the square of a length; what
is measured moves the bounds alone. The rows of its matrix are reached through the stages, in C.
"""

from __future__ import annotations

import ctypes
import math
from functools import cache
from time import perf_counter
from typing import Any, final

import numpy as np

from tenscontrol.control.mpc.problem import (
    MPCProblem,
    Pair,
    StageData,
    StageJacobians,
    Subproblem,
    SubproblemSolution,
)
from tenscontrol.control.mpc.solvers.c_source import active_set_source, stages_source
from tenscontrol.control.status import Status
from tenscontrol.dynamics import compiled_library
from tenscontrol.validation import FloatArray

# Of a limit, in its unit: what round-off may leave of it.
_TOLERANCE = 1e-10

# What the active-set method says.
_STATUS = (
    Status.OK, Status.INFEASIBLE, Status.OUT_OF_ITERATIONS, Status.OUT_OF_TIME, Status.BAD_DATA,
    Status.INACCURATE,
)  # fmt: skip

_Stop = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
_NEVER = _Stop()


@cache
def _library() -> ctypes.CDLL:
    """Return the compiled program."""
    text = "#define STAGES_API\n" + active_set_source() + stages_source()
    library = ctypes.CDLL(str(compiled_library(text)))
    library.stages_program_size.restype = ctypes.c_size_t
    return library


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


@final
class LeastDistance(Subproblem):
    """The program of a plan in compiled C, with memory of its own."""

    solver_name = "active set"

    def __init__(
        self, problem: MPCProblem, row_bounds: Pair, max_iterations: int, bounds: Pair
    ) -> None:
        self._made_of = problem, row_bounds, max_iterations, bounds
        library, N, (m, a) = _library(), problem.length, problem.input_matrix.shape
        ramp = len(problem.terminal_weight) > m
        n = m + a if ramp else m
        rows, changes = problem.rows, problem.change is not None
        p = 0 if rows is None else len(rows.scale)
        scale = problem.cost_scale
        state_weight = np.zeros((n, n))
        state_weight[:m, :m] = scale * problem.state_weight
        price = np.full((N, a * (2 if changes else 1) + p), np.inf)
        if rows is not None:
            price[:, price.shape[1] - p :] = scale * rows.penalty * rows.scale
        none = np.zeros(0)
        data = [
            state_weight, scale * problem.input_weight, scale * problem.terminal_weight,
            none if rows is None else rows.scale,
            none if problem.change is None else problem.change,
            *bounds, *row_bounds, price, price,
        ]  # fmt: skip
        self._data = [np.ascontiguousarray(part, dtype=float) for part in data]
        addresses = (ctypes.c_void_p * len(data))(*(_address(part) for part in self._data))
        sizes = (ctypes.c_int * 8)(
            N, n, a, p, ramp, changes, int(np.isfinite(price).sum()), max_iterations
        )  # fmt: skip
        self._program = ctypes.create_string_buffer(library.stages_program_size())
        counts, views = (ctypes.c_size_t * 3)(), (ctypes.c_void_p * 6)()
        given = (
            self._program, sizes, ctypes.c_double(problem.level), ctypes.c_double(_TOLERANCE),
            _multiply(), addresses,
        )  # fmt: skip
        library.stages_program_place(*given, None, None, None, counts, views)
        numbers = np.zeros(counts[0])
        self._memory = numbers, np.zeros(counts[1], np.intc), np.zeros(counts[2], np.intp)
        places = (ctypes.c_void_p(_address(part)) for part in self._memory)
        library.stages_program_place(*given, *places, counts, views)
        shapes = [(N + 1, m), (N + 1, a), (price.size,), (N + 1, n), (N, a)]
        self._states, self._inputs, self._multipliers, moves, self._input_moves = (
            numbers[(place - _address(numbers)) // 8 :][: math.prod(shape)].reshape(shape)
            for place, shape in zip(views, shapes, strict=False)
        )
        self._moves = moves[:, :m]
        self._shift, self._prepare, self._solve, self._count = (
            getattr(library, f"stages_program_{name}")
            for name in ("shift", "prepare", "solve", "iterations")
        )
        pointer = ctypes.c_void_p
        self._prepare.argtypes = [pointer] * 9
        self._solve.argtypes = [pointer] * 7 + [_Stop]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what it is made of, and which limits are active; it is not prepared then."""
        return LeastDistance, self._made_of, self._multipliers.copy()

    def __setstate__(self, multipliers: FloatArray) -> None:
        """Take the active limits of another one."""
        self._multipliers[:] = multipliers

    def reset(self) -> None:
        """See :meth:`Subproblem.reset`."""
        self.forget()

    def forget(self) -> None:
        """See :meth:`Subproblem.forget`."""
        self._multipliers[:] = 0.0

    def shift(self) -> None:
        """See :meth:`Subproblem.shift`."""
        self._shift(self._program)

    def linearize(
        self, states: FloatArray, inputs: FloatArray, motion: StageJacobians,
        rows: StageJacobians | None,
    ) -> bool:  # fmt: skip
        """See :meth:`Subproblem.linearize`: the Riccati recursion, and the rows last active."""
        self._states[:], self._inputs[:] = states, inputs
        parts = [motion.offset, *motion.slopes, *[None] * (3 - len(motion.slopes))]
        parts += [None] * 4 if rows is None else [rows.offset, *rows.slopes]
        kept = [None if part is None else np.ascontiguousarray(part) for part in parts]
        addresses = [None if part is None else _address(part) for part in kept]
        return bool(self._prepare(self._program, *addresses))

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
        kept = [np.ascontiguousarray(part) for part in given]
        status = self._solve(self._program, *map(_address, kept), stop)
        plan = None
        if status == 0:
            inputs = np.concatenate([acting[None], self._inputs[1:] + self._input_moves])
            plan = self._states + self._moves, inputs
        return SubproblemSolution(_STATUS[status], self._count(self._program), plan)
