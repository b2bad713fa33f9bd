"""Data of a controller for C code: LQR, linear MPC, nonlinear MPC.

The vectors of the program of linear MPC are affine in the state, the previous input, the same
within bounds, and the estimated load; so are the planned inputs. Their matrices are
read from the controller, by one evaluation a column. Their values at zero depend on time alone and
become a table with a row a sample. In nonlinear MPC the motion over a sample, the limited rows and
their derivatives are CasADi functions; the program along the stages is that of Python.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import ceil, floor

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.control.lqr import LQR
from tenscontrol.control.mpc.linear import MPC, Condensed, MPCLaw
from tenscontrol.control.mpc.nonlinear import CONVERGED, NMPC
from tenscontrol.control.mpc.problem import MPCProblem, StageData
from tenscontrol.control.mpc.real_time_iteration import NEWTON_STEPS
from tenscontrol.control.mpc.shooting import RK4
from tenscontrol.control.mpc.solvers.c_source import active_set_source, stages_source
from tenscontrol.control.mpc.stages import STAGES_TOLERANCE, stages_data

# Maps read from a controller must agree with it at any other point, to this fraction.
_AGREEMENT = 1e-9

# Violations that the C code takes for round-off, in units of a row.
_TOLERANCE = 1e-11

# Unknown inputs that a condensed program may have.
_MOST_UNKNOWNS = 5000

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
    headers: dict[str, str] = field(default_factory=dict)  # texts of C that it includes


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


class _LeastDistance:
    """The condensed program of a law, its rows stage by stage, violations as prices of rows.

    ``low`` and ``high`` are the rows with the two bounds of each; a soft row that is bounded on
    both sides stands in the program twice.
    """

    def __init__(self, problem: MPCProblem) -> None:
        N, a, rows = problem.length, problem.input_matrix.shape[1], problem.rows
        self.unknowns = count = problem.input_count
        if count > _MOST_UNKNOWNS:
            raise ValueError(
                f"controller plans {count} inputs, and its program is condensed, so dense, in C "
                f"code; expected at most {_MOST_UNKNOWNS}. Take a shorter horizon"
            )
        self.form = Condensed(problem)
        soft = 0 if rows is None else len(rows.soft)
        widths = [a] * (1 if problem.change is None else 2)
        widths.append(0 if rows is None else len(rows.scale) - soft)
        # The last rows are the bounds of violations.
        limits = np.arange(self.form.A.shape[0] - N * soft)
        sign = self.form.A[:, count:].sum(axis=1)[limits]
        above, below = limits[sign < 0], limits[sign > 0]
        parts = np.split(limits[sign == 0], N * np.cumsum(widths)[:-1])
        self.low, self.high = (
            np.hstack([*(part.reshape(N, -1) for part in parts), soft_rows.reshape(N, -1)])
            for soft_rows in (below if len(below) else above, above if len(above) else below)
        )
        self.width = sum(widths) + soft  # rows of a stage
        self.price = np.full((N, self.width), np.inf)
        self.price[:, self.width - soft :] = self.form.P.diagonal()[count:].reshape(N, -1)

    def response(self) -> FloatArray:
        """Return what inputs, the first of all last, do to the rows of a stage; it is the same."""
        by_row = self.form.A[:, : self.unknowns].tocsr()
        N, width = len(self.low), self.width
        found: FloatArray = by_row[self.low[-1]].toarray()
        for k, rows in enumerate(self.low):
            moved = np.zeros((width, self.unknowns))
            moved[:, : (k + 1) * self.unknowns // N] = found[:, (N - 1 - k) * self.unknowns // N :]
            error = float(np.abs(by_row[rows].toarray() - moved).max())
            if not error <= _AGREEMENT * max(1.0, float(np.abs(found).max())):
                raise ValueError(
                    f"controller has a program whose stage {k} is not like the last (off by "
                    f"{error:.1e}), so it cannot be written as C code"
                )
        return found


class _Reader:
    """Reads the maps of a law, at any time and for any load."""

    def __init__(self, law: MPCLaw, program: _LeastDistance) -> None:
        self._law, self._program = replace(law, form=program.form), program
        s, a = law.plant.B.shape
        self.loads = 0 if law.load is None else law.plant.degrees_of_freedom
        # Of state, previous input, the same within bounds, and load.
        self.sizes = s, a, a, self.loads

    def vectors(self, time: float, given: FloatArray) -> FloatArray:
        """Return q and both bounds, end to end, for what is given."""
        z, previous, bounded, load = self._split(given, *self.sizes)
        q, low, high = self._law.vectors(self._stage_data(time, load), z, previous, bounded)
        program = self._program
        return np.concatenate([
            q[: program.unknowns], low[program.low.ravel()], high[program.high.ravel()]
        ])  # fmt: skip

    def inputs(self, time: float, given: FloatArray) -> FloatArray:
        """Return the planned inputs for what is given, where the solution is zero."""
        z, previous, _, load = self._split(given, *self.sizes)
        nothing = np.zeros(self._program.form.A.shape[1])
        return self._law.inputs(nothing, self._stage_data(time, load), z, previous).ravel()

    def free_response(self, time: float, given: FloatArray) -> FloatArray:
        """Return the state a sample later without the input to come, for what is given."""
        z, previous, _, load = self._split(given, *self.sizes)
        return self._law.free_response(self._stage_data(time, load), z, previous)

    def row(self, time: float) -> FloatArray:
        """Return all that depends on time alone."""
        point = np.zeros(sum(self.sizes))
        parts = [
            self.vectors(time, point),
            self.inputs(time, point),
            self._stage_data(time, np.zeros(self.loads)).previous_origin,
        ]
        if self.loads:
            parts.append(self.free_response(time, point))
        return np.concatenate(parts)

    def _stage_data(self, time: float, load: FloatArray) -> StageData:
        return self._law.stage_data(self._law.preview(time), load if self.loads else None)

    @staticmethod
    def _split(given: FloatArray, *sizes: int) -> list[FloatArray]:
        return np.split(given, np.cumsum(sizes)[:-1])


def mpc_code(controller: MPC) -> LawCode:
    """Return the code of a linear MPC, whose program is condensed whatever its form in Python."""
    law = controller.law
    _refuse_time_limit(law.settings.longest_time)
    problem, sampled = law.design.problem, law.design.sampled
    program = _LeastDistance(problem)
    reader = _Reader(law, program)
    unknowns, rows = program.unknowns, program.low.size
    first, table = _time_table(law.path.span, law.settings.sample_time, problem.length, reader.row)
    times = first * law.settings.sample_time, (first + len(table) - 1) * law.settings.sample_time
    given = sum(reader.sizes)
    offset, slope = _read(reader.vectors, given, times)
    # Upper and lower bounds move alike, where they are not infinite.
    low, high = slope[unknowns : unknowns + rows], slope[unknowns + rows :]
    moved = np.where(np.isfinite(offset[unknowns : unknowns + rows])[:, None], low, high)
    matrices = {
        "vectors": np.vstack([slope[:unknowns], moved]),
        "inputs": _read(reader.inputs, given, times)[1],
    }
    if law.load is not None:
        matrices["free_response"] = _read(reader.free_response, given, times)[1]
        matrices["by_input"] = sampled.by_input
        matrices["load_gain"] = law.load.gain
    constants: dict[str, int | float] = {
        "UNKNOWNS": unknowns,
        "ROWS": rows,
        "SOFT": int(np.isfinite(program.price).sum()),
        "STAGE_ROWS": program.width,
        "STAGE_INPUTS": unknowns // problem.length,
        "PLANNED": unknowns,
        "LOADS": reader.loads,
        "LEVEL": float(problem.level),
        "ITERATIONS": law.settings.max_iterations,
        "TOLERANCE": _TOLERANCE,
    }
    arrays = {"price": program.price.ravel(), "response": program.response()}
    templates = "least_distance.c", "time_table.c", "mpc.c"
    headers = {"active_set": active_set_source()}
    return LawCode(templates, constants, arrays, matrices, (first, table), headers=headers)


def _read(
    function: Callable[[float, FloatArray], FloatArray], size: int, times: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return value at zero and slope of an affine map, whose slope is the same at all times."""
    offset = function(times[0], np.zeros(size))
    finite = np.isfinite(offset)
    slope = np.zeros((len(offset), size))
    for i, unit in enumerate(np.eye(size)):
        slope[finite, i] = function(times[0], unit)[finite] - offset[finite]
    point = np.cos(np.arange(1.0, size + 1))
    for time in times:
        value = function(time, point)[finite]
        rest = value - function(time, np.zeros(size))[finite] - slope[finite] @ point
        error = float(np.abs(rest).max(initial=0.0))
        if not error <= _AGREEMENT * max(1.0, float(np.abs(value).max(initial=0.0))):
            raise ValueError(
                f"controller is not affine in what it measures (off by {error:.1e} at {time:g} s), "
                "so it cannot be written as C code"
            )
    return offset, slope


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
    N, _, _, p, _, changes, soft, most, ahead = sizes

    def row(time: float) -> FloatArray:
        return np.concatenate([part.ravel() for part in law.targets(time)])

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
    names = (
        "state_weight", "input_weight", "terminal_weight", "limit_scale", "largest_change",
        "", "", "limit_low", "limit_high", "price",
    )  # fmt: skip
    return LawCode(
        templates=("time_table.c", "nmpc.c"),
        constants={
            "HORIZON": N,
            "PLANNED": problem.input_count,
            "LIMITED": p,
            "CHANGES": changes,
            "SOFT": soft,
            "AHEAD": ahead,
            "LOADS": loads,
            "NEWTON_STEPS": NEWTON_STEPS,
            "LEVEL": float(problem.level),
            "ROUNDS": law.rounds,
            "CONVERGED": CONVERGED,
            "ITERATIONS": most,
            "TOLERANCE": STAGES_TOLERANCE,
        },
        arrays={name: part.ravel() for name, part in zip(names, data, strict=False) if name},
        matrices=matrices,
        table=_time_table(law.path.span, law.settings.sample_time, N, row),
        functions=functions,
        headers={"active_set": active_set_source(), "stages": stages_source()},
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
