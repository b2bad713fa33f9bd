"""Linear MPC as parts of C code.

The vectors of the program are affine in what is measured and remembered: the state, what the
actuators hold, the same within bounds, and the estimated load. So are the planned inputs in the
solution besides. What is left, their values at zero, depends on time alone where the reference
moves, and becomes a table with a row a sample. All of it is read off the controller itself, by one
evaluation a column: whatever form, limits, winches and reference it has.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np

from tenscontrol.control import MPC
from tenscontrol.control.problem import Ahead
from tenscontrol.control.quadratic_program import START_RHO, QuadraticProgram
from tenscontrol.deploy.over_time import over_time
from tenscontrol.deploy.parts import Parts, refuse_time_limit
from tenscontrol.validation import FloatArray

# What is read off must give what the controller does at any other point, to this fraction.
_AGREEMENT = 1e-9


class _Reader:
    """Reads the maps of a controller, at any time and for any load.

    Works on a copy that forgets: the controller goes on as it was.
    """

    def __init__(self, controller: MPC) -> None:
        twin = copy(controller)
        twin._observer = copy(controller._observer)
        self._twin, self._problem, self._form = twin, controller._problem, controller._form
        self.states, self.commands = controller.plant.B.shape
        self.loads = 0 if controller._observer is None else controller.plant.degrees_of_freedom
        self.unknowns, self.rows = self._form.A.shape[1], self._form.A.shape[0]

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Of state, what stands, the same within bounds, and load."""
        return self.states, self.commands, self.commands, self.loads

    def vectors(self, time: float, given: FloatArray) -> FloatArray:
        """Return q, l and u, end to end, for what is given."""
        z, standing, reachable, load = self._split(given, *self.sizes)
        ahead = self._ahead(time, load)
        begun = self._twin._begun(z, standing, ahead)
        return np.concatenate(
            self._form.vectors(begun, ahead.reference, reachable - ahead.origin[0], ahead.course)
        )

    def inputs(self, time: float, known: FloatArray) -> FloatArray:
        """Return the planned inputs for solution and what is given."""
        x, z, standing, _, load = self._split(known, self.unknowns, *self.sizes)
        ahead = self._ahead(time, load)
        begun = self._twin._begun(z, standing, ahead)
        return np.asarray((ahead.origin + self._form.inputs(x, begun, ahead.course)).ravel())

    def coasting(self, time: float, given: FloatArray) -> FloatArray:
        """Return the state a sample later without the input to come, for what is given."""
        z, standing, _, load = self._split(given, *self.sizes)
        return self._twin._coasting(z, standing, self._ahead(time, load))

    def row(self, time: float) -> FloatArray:
        """Return all that depends on time alone."""
        point = np.zeros(sum(self.sizes))
        parts = [
            self.vectors(time, point),
            self.inputs(time, np.zeros(self.unknowns + len(point))),
            self._ahead(time, np.zeros(self.loads)).before,
        ]
        if self.loads:
            parts.append(self.coasting(time, point))
        return np.concatenate(parts)

    def _ahead(self, time: float, load: FloatArray) -> Ahead:
        if self._twin._observer is not None:
            self._twin._observer.acceleration = load
        return self._twin._ahead(time)

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
    refuse_time_limit(controller._time_limit)
    assert controller.step is not None  # MPC has one
    reader = _Reader(controller)
    unknowns, rows, loads = reader.unknowns, reader.rows, reader.loads
    first, table = over_time(
        controller._path.span, controller.step, controller._problem.length, reader.row
    )
    times = first * controller.step, (first + len(table) - 1) * controller.step
    given = sum(reader.sizes)
    offset, slope = _read(reader.vectors, given, times)
    # Upper and lower bounds move alike, where they are not infinite.
    low, high = slope[unknowns : unknowns + rows], slope[unknowns + rows :]
    moved = np.where(np.isfinite(offset[unknowns : unknowns + rows])[:, None], low, high)
    matrices = {
        "vectors": np.vstack([slope[:unknowns], moved]),
        "inputs": _read(reader.inputs, unknowns + given, times)[1],
    }
    if loads:
        assert controller._observer is not None  # there are loads
        matrices["coasting"] = _read(reader.coasting, given, times)[1]
        matrices["by_input"] = controller._sampled.by_input
        matrices["load_gain"] = controller._observer.gain
    x, y = controller._form.shifted(np.arange(1.0, unknowns + 1), np.arange(1.0, rows + 1))
    arrays = {
        "source_of_x": x.astype(np.int64) - 1,
        "source_of_y": y.astype(np.int64) - 1,
    }
    constants: dict[str, int | float] = {
        "UNKNOWNS": unknowns,
        "ROWS": rows,
        "PLANNED": controller._problem.input_count,
        "LOADS": loads,
        "FIRST_RHO": START_RHO,
    }
    # Of its own: the solver of the controller may be in the middle of a run.
    program = QuadraticProgram(
        controller._form.P,
        controller._form.A,
        controller._program.tolerance,
        controller._program.max_iterations,
    )
    return Parts(
        ("program.c", "over_time.c", "mpc.c"), constants, arrays, matrices, program, (first, table)
    )


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
