"""Linear MPC as parts of C code.

The vectors of the program are affine in what is measured and remembered: the state, what the
actuators hold, the same within bounds, and the estimated load. So are the planned inputs in the
solution besides. What is left, their values at zero, depends on time alone where the reference
moves, and becomes a table with a row a sample. All of it is read off the controller itself, by one
evaluation a column: whatever form, limits, winches and reference it has.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tenscontrol.control import MPC
from tenscontrol.control.mpc.linear import MPCLaw
from tenscontrol.control.mpc.osqp_adapter import START_RHO
from tenscontrol.control.mpc.problem import StageData
from tenscontrol.deploy.over_time import over_time
from tenscontrol.deploy.parts import Parts, osqp_program, refuse_time_limit
from tenscontrol.validation import FloatArray

# What is read off must give what the controller does at any other point, to this fraction.
_AGREEMENT = 1e-9


class _Reader:
    """Reads the maps of a law, at any time and for any load."""

    def __init__(self, law: MPCLaw) -> None:
        self._law = law
        s, a = law.plant.B.shape
        self.loads = 0 if law.load is None else law.plant.degrees_of_freedom
        self.rows, self.unknowns = law.form.A.shape
        # Of state, what stands, the same within bounds, and load.
        self.sizes = s, a, a, self.loads

    def vectors(self, time: float, given: FloatArray) -> FloatArray:
        """Return q, l and u, end to end, for what is given."""
        z, standing, reachable, load = self._split(given, *self.sizes)
        return np.concatenate(
            self._law.vectors(self._stage_data(time, load), z, standing, reachable)
        )

    def inputs(self, time: float, known: FloatArray) -> FloatArray:
        """Return the planned inputs for solution and what is given."""
        x, z, standing, _, load = self._split(known, self.unknowns, *self.sizes)
        return self._law.inputs(x, self._stage_data(time, load), z, standing).ravel()

    def coasting(self, time: float, given: FloatArray) -> FloatArray:
        """Return the state a sample later without the input to come, for what is given."""
        z, standing, _, load = self._split(given, *self.sizes)
        return self._law.free_response(self._stage_data(time, load), z, standing)

    def row(self, time: float) -> FloatArray:
        """Return all that depends on time alone."""
        point = np.zeros(sum(self.sizes))
        parts = [
            self.vectors(time, point),
            self.inputs(time, np.zeros(self.unknowns + len(point))),
            self._stage_data(time, np.zeros(self.loads)).previous_origin,
        ]
        if self.loads:
            parts.append(self.coasting(time, point))
        return np.concatenate(parts)

    def _stage_data(self, time: float, load: FloatArray) -> StageData:
        return self._law.stage_data(time, load if self.loads else None)

    @staticmethod
    def _split(given: FloatArray, *sizes: int) -> list[FloatArray]:
        return np.split(given, np.cumsum(sizes)[:-1])


def mpc_parts(controller: MPC) -> Parts:
    """Return the parts of a linear MPC.

    Raises
    ------
    ValueError
        If it has a time limit, or its reference lasts too long for a table.
    """
    law = controller.law
    refuse_time_limit(law.settings.longest_time)
    reader = _Reader(law)
    unknowns, rows = reader.unknowns, reader.rows
    problem, sampled = law.design.problem, law.design.sampled
    sample_time = law.settings.sample_time
    first, table = over_time(law.path.span, sample_time, problem.length, reader.row)
    times = first * sample_time, (first + len(table) - 1) * sample_time
    given = sum(reader.sizes)
    offset, slope = _read(reader.vectors, given, times)
    # Upper and lower bounds move alike, where they are not infinite.
    low, high = slope[unknowns : unknowns + rows], slope[unknowns + rows :]
    moved = np.where(np.isfinite(offset[unknowns : unknowns + rows])[:, None], low, high)
    matrices = {
        "vectors": np.vstack([slope[:unknowns], moved]),
        "inputs": _read(reader.inputs, unknowns + given, times)[1],
    }
    if law.load is not None:
        matrices["coasting"] = _read(reader.coasting, given, times)[1]
        matrices["by_input"] = sampled.by_input
        matrices["load_gain"] = law.load.gain
    x, y = law.form.shifted(np.arange(1.0, unknowns + 1), np.arange(1.0, rows + 1))
    arrays = {
        "source_of_x": x.astype(np.int64) - 1,
        "source_of_y": y.astype(np.int64) - 1,
    }
    constants: dict[str, int | float] = {
        "UNKNOWNS": unknowns,
        "ROWS": rows,
        "PLANNED": problem.input_count,
        "LOADS": reader.loads,
        "FIRST_RHO": START_RHO,
    }
    templates = "program.c", "over_time.c", "mpc.c"
    # Of its own: the solver of the controller may be in the middle of a run.
    return Parts(templates, constants, arrays, matrices, osqp_program(law.solver()), (first, table))


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
