"""Data of a controller for C code: LQR, linear MPC, nonlinear MPC.

Programs along the stages are those of Python, by the same C sources. What of linear MPC depends on
time alone becomes a table with a row a sample, and what a load does is linear. In nonlinear MPC the
motion over a sample, the limited rows and their derivatives are CasADi functions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import ceil, floor

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.control.lqr import LQR
from tenscontrol.control.mpc.linear import MPC
from tenscontrol.control.mpc.nonlinear import CONVERGED, NMPC
from tenscontrol.control.mpc.problem import MPCProblem
from tenscontrol.control.mpc.real_time_iteration import NEWTON_STEPS
from tenscontrol.control.mpc.shooting import RK4
from tenscontrol.control.mpc.stages import STAGES_TOLERANCE, stages_data, values_from

# Sources of the core that solve programs, and go into the folder as they are.
_SOURCES = ("active_set.h", "active_set.c", "stages.h", "stages.c")

# Numbers that a table may have: some hundred megabytes of C text.
_LARGEST = 5_000_000


@dataclass(frozen=True, eq=False)
class LawCode:
    """What one law adds to the code common to all."""

    templates: tuple[str, ...]  # C files of the package with the law
    constants: dict[str, int | float]  # of the preprocessor
    arrays: dict[str, np.ndarray]  # of one or two dimensions
    matrices: dict[str, FloatArray]  # written without their zeros
    # Number of the first sample, and what depends on time alone, shape (K, m), a row a sample.
    table: tuple[int, FloatArray] | None = None
    functions: dict[str, ca.Function] = field(default_factory=dict)  # besides the measurement
    sources: tuple[str, ...] = ()  # of the core
    numbers_read: int = 0  # at a sample, by a filter


def lqr_code(controller: LQR) -> LawCode:
    """Return the code of a regulator; raise ValueError if it acts in continuous time."""
    if controller.sample_time is None:
        raise ValueError(
            "controller is an LQR in continuous time, and code runs in samples: "
            "make it by LQR(plant, Q, R, sample_time=...)"
        )
    matrices = {"feedback": -controller.gain}
    if controller.previous_input_gain is not None:
        matrices["previous_input_feedback"] = -controller.previous_input_gain
    ramp = int(controller.previous_input_gain is not None)
    return LawCode(("lqr.c",), {"RAMP": ramp}, {}, matrices)


# What C calls the parts of a program; the bounds of inputs are those of the controller.
_NAMES = {
    "Q": "state_weight", "R": "input_weight", "P": "terminal_weight",
    "cross": "cross_weight", "scale": "limit_scale",
    "change": "largest_change", "least": "limit_low", "most": "limit_high", "price": "price",
    "unit": "thin_unit", "V": "thin_inputs", "T": "thin_states", "shrink": "thin_shrink",
    "G_start": "limited_start", "G_which": "limited_which",
}  # fmt: skip


def _program(
    sizes: dict[str, int], data: dict[str, FloatArray], problem: MPCProblem
) -> tuple[dict[str, int | float], dict[str, np.ndarray]]:
    """Return the constants and arrays of a program along the stages."""
    constants: dict[str, int | float] = {
        "HORIZON": sizes["stages"],
        "PROGRAM_STATES": sizes["states"],
        "PLANNED": problem.input_count,
        "LIMITED": sizes["limited"],
        "CHANGES": sizes["changes"],
        "SOFT": sizes["soft"],
        "AHEAD": sizes["ahead"],
        "ALIKE": sizes["alike"],
        "THIN": sizes["thin"],
        "CROSSED": sizes["crossed"],
        "LEVEL": float(problem.level),
        "ITERATIONS": sizes["limit"],
        "TOLERANCE": STAGES_TOLERANCE,
    }
    return constants, {name: data[field].ravel() for field, name in _NAMES.items()}


def mpc_code(controller: MPC) -> LawCode:
    """Return the code of a linear MPC, which solves its program along the stages."""
    law = controller.law
    settings, designed = law.settings, law.design
    _refuse_time_limit(settings.longest_time)
    problem, limits = designed.problem, designed.constraints.limits
    sizes, data = stages_data(
        problem, limits, settings.max_iterations, (designed.low, designed.high), problem.steady
    )
    constants, arrays = _program(sizes, data, problem)
    rows, none = problem.rows, np.zeros(0)
    by_all = (none,) * 3
    if rows is not None:
        by_input = rows.by_input.data if problem.steady else rows.by_input.toarray()
        count = 1 if problem.steady else problem.length
        by_all = (
            np.tile(rows.by_state, count),
            np.tile(by_input, count),
            np.tile(rows.by_next_state, count),
        )
    slopes = problem.transition, problem.input_matrix, *by_all
    names = (
        "motion_by_state", "motion_by_input", "limited_by_state", "limited_by_input",
        "limited_by_next_state",
    )  # fmt: skip
    arrays |= {name: slope.T.ravel() for name, slope in zip(names, slopes, strict=True)}
    loads, matrices = 0, {}
    if law.load is not None:
        loads = len(law.load.gain)
        matrices = {
            "transition": problem.transition[: 2 * law.plant.degrees_of_freedom],
            "by_input": designed.sampled.by_input,
            "load_gain": law.load.gain,
            "load_response": law.load.response,
            "load_shift": law.load.shift,
            "load_effort": law.load.effort,
        }

    def row(time: float) -> FloatArray:
        moved = law.stage_data(law.preview(time), np.zeros(loads) if loads else None)
        arrays = [
            moved.reference, moved.previous_origin, moved.origin,
            moved.origin + moved.input_reference, moved.drift,
            values_from(limits, moved) / data["scale"],
        ]  # fmt: skip
        if problem.cross_weight is not None:
            arrays.append(moved.first_reference)
        if loads:
            still = np.zeros(2 * law.plant.degrees_of_freedom)
            arrays.append(law.free_response(moved, still, moved.previous_origin))
        return np.concatenate([array.ravel() for array in arrays])

    return LawCode(
        templates=("time_table.c", "program.c", "mpc.c"),
        constants=constants | {"LOADS": loads},
        arrays=arrays,
        matrices=matrices,
        table=_time_table(law.path.span, settings.sample_time, problem.length, row),
        sources=_SOURCES,
    )


def nmpc_code(controller: NMPC) -> LawCode:
    """Return the code of a nonlinear MPC, which solves its program along the stages."""
    law = controller.law
    _refuse_time_limit(law.settings.longest_time)
    problem, model = law.problem, law.model
    if not isinstance(model.discretization, RK4):
        raise ValueError(
            "controller is an NMPC with implicit steps, for stiff strings or winches with "
            "ramps, which C code does not have: give a shorter step and winches without ramps, "
            "or use MPC, whose prediction is linear"
        )
    sizes, data = stages_data(problem, law.row_bounds, law.settings.max_iterations, law.bounds)
    constants, arrays = _program(sizes, data, problem)

    def row(time: float) -> FloatArray:
        targets = law.targets(time)
        data = law.stage_data(time, *targets)
        start = () if data.first_reference is None else (data.first_reference,)
        return np.concatenate([target.ravel() for target in (*targets, *start)])

    functions = {
        "advance": model.discretization.sampled,
        "linearize": model.discretization.linearized,
    }
    if model.limited is not None:
        functions["limited"] = model.limited
    matrices = {"feedback": -problem.feedback}
    loads = 0
    if law.load is not None:
        loads = len(law.load.gain)
        functions["accelerate"] = model.acceleration
        matrices |= {
            "load_gain": law.load.gain,
            "load_response": law.load.response,
            "load_shift": law.load.shift,
            "load_effort": law.load.effort,
        }
    constants |= {
        "LOADS": loads,
        "NEWTON_STEPS": NEWTON_STEPS,
        "ROUNDS": law.rounds,
        "CONVERGED": CONVERGED,
    }
    return LawCode(
        templates=("time_table.c", "program.c", "nmpc.c"),
        constants=constants,
        arrays=arrays,
        matrices=matrices,
        table=_time_table(law.path.span, law.settings.sample_time, problem.length, row),
        functions=functions,
        sources=_SOURCES,
    )


def _time_table(
    span: tuple[float, float], step: float, horizon: int, row: Callable[[float], FloatArray]
) -> tuple[int, FloatArray]:
    """Return the number of the first sample, and a row of the table for each from there on."""
    begin, end = span
    if begin == end:
        return 0, row(0.0)[None]
    # Before the first and after the last nothing changes any more.
    first, last = floor(begin / step) - horizon - 1, ceil(end / step) + 1
    size = (last - first + 1) * len(row(first * step))
    if size > _LARGEST:
        raise ValueError(
            f"controller follows a reference of {end - begin:g} s, {last - first + 1} samples: a "
            f"table of {size:.1e} numbers, expected at most {_LARGEST:.0e}. Follow a shorter "
            "one, or take a longer step"
        )
    return first, np.array([row(k * step) for k in range(first, last + 1)])


def _refuse_time_limit(limit: float) -> None:
    if np.isfinite(limit):
        raise ValueError(
            f"controller has time_limit={limit:g} s, but C code without an operating system has "
            "no clock: leave it out, and limit the work by max_iterations"
        )
