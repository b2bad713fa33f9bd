"""Models of robots with parameters of their own, advanced over samples by fixed steps."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import Equation, free_accelerations
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.model_parameters import (
    MASSES,
    constant_forces,
    least_value,
    parameters_of,
    with_parameters,
)
from tenscontrol.integrate.core_lanes import FixedStepLanes, have_tables, tables_of_runs
from tenscontrol.integrate.core_sample import CoreSample
from tenscontrol.integrate.core_scene import CoreScene, core_scene
from tenscontrol.integrate.integrator import IntegrationError, Integrator
from tenscontrol.integrate.methods import Method


class SteppedModels:
    """Robots of one structure: their models, and what advances them.

    Parameters
    ----------
    model : Model
        Whose parameters robots have that are given no others.
    input : {"rest_length", "force_density"}
    degree : int
        1 where the input ramps over a sample, else 0.
    method : Method
        "rk4" or "rk4_plain".
    step : float
        Largest step, s.
    count : int
        Number of robots.
    """

    def __init__(
        self, model: Model, input: str, degree: int, method: Method, step: float, count: int
    ) -> None:
        self.model, self.count, self.parameters = model, count, dict[str, FloatArray]()
        self._input, self._degree, self._method, self._step = input, degree, method, step
        self._alone: dict[int, CoreSample | Integrator] = {}
        self._equations: dict[int, Equation] = {}
        self._kinds: dict[str, bool] | None = None
        self._core: CoreScene | None = None
        self._arrange()

    def set(self, robots: np.ndarray, given: Mapping[str, object]) -> None:
        """Give some robots other parameters, each one number, one a member, or one row a robot.

        Raises
        ------
        TypeError, ValueError
            If they do not fit; then all is as before.
        """
        validation.instance("parameters", given, Mapping, "a dict of numbers, by name")
        usual, changed = parameters_of(self.model), dict(self.parameters)
        for name, value in given.items():
            validation.choice("parameters", name, usual)
            rows = self._rows(f"parameters[{name!r}]", value, usual[name].shape, len(robots))
            before = changed.get(name, np.tile(usual[name], (self.count, 1)))
            changed[name] = before.copy()
            changed[name][robots] = rows
        doubtful = np.zeros(len(robots), dtype=bool)
        for name, rows in changed.items():
            doubtful |= (rows[robots] < least_value(name)).any(axis=1)
        for robot in robots[doubtful].tolist():  # refuses what is none
            with_parameters(self.model, {name: rows[robot] for name, rows in changed.items()})
        was_alike, self.parameters = not self.parameters, changed
        for robot in range(self.count) if was_alike else robots.tolist():
            self._alone.pop(robot, None)
            self._equations.pop(robot, None)
        self._arrange()

    def _rows(self, label: str, value: object, shape: tuple[int, ...], robots: int) -> FloatArray:
        array = validation.float_array(label, value)
        if label == "parameters['gravity']" and array.shape[-1:] != shape:
            raise ValueError(f"{label} has shape {array.shape}, expected {shape} or a row a robot")
        if array.shape == shape == (robots,) and robots > 1:
            raise ValueError(
                f"{label} has shape {shape}, which is one a member and one a robot: give "
                f"{(robots, 1)} for one a robot, or {(robots, *shape)}"
            )
        if array.shape not in {(), shape, (robots,), (robots, 1), (robots, *shape)}:
            raise ValueError(
                f"{label} has shape {array.shape}, expected a number, {shape}, ({robots},) or "
                f"{(robots, *shape)}: for all robots, one a member, one a robot, or both"
            )
        is_by_robot = array.shape == (robots,) and array.shape != shape
        return np.broadcast_to(array[:, None] if is_by_robot else array, (robots, *shape))

    def model_of(self, robot: int) -> Model:
        """Return the model of a robot."""
        if not self.parameters:
            return self.model
        own = {name: rows[robot] for name, rows in self.parameters.items()}
        return with_parameters(self.model, own)

    # ---- how they are advanced ----

    def _arrange(self) -> None:
        """Choose what advances the robots: side by side where the core has them all."""
        self._lanes: FixedStepLanes | None = None
        self._loads: FloatArray | None = None
        given = self.parameters
        if self.count == 1 or not have_tables(self.model, given):
            return
        is_loaded = bool({"gravity", *MASSES} & set(given))
        core = self._core_of_all(is_loaded)
        if core is None:
            return
        tables = tables_of_runs(self.model, given)
        how = self._method
        self._lanes = FixedStepLanes(core, how.projects, tables, self._step, how.name)
        if is_loaded:
            self._loads = constant_forces(self.model, given).transpose(0, 2, 1)
            self._loads = self._loads.reshape(len(self._loads), -1)

    def _core_of_all(self, is_loaded: bool) -> CoreScene | None:
        """Return the tables of a robot, which stay while all have the same kinds of parameters."""
        switched = {name: bool((rows[0] > 0).any()) for name, rows in self.parameters.items()}
        if self._kinds != switched:
            equation = self.model_of(0).equation(
                self._input, None, "auto", degree=self._degree, load_input=is_loaded
            )
            self._kinds, self._core = switched, core_scene(equation)
        return self._core

    def _equation_of(self, robot: int) -> Equation:
        key = robot if self.parameters else 0  # models that are alike share it
        equation = self._equations.get(key)
        if equation is None:
            model = self.model_of(robot)
            equation = model.equation(self._input, None, "auto", degree=self._degree)
            self._equations[key] = equation
        return equation

    def advance(
        self, robots: np.ndarray, states: FloatArray, inputs: FloatArray, duration: float
    ) -> FloatArray:
        """Return the states of some robots after a sample, NaN where there is none.

        Parameters
        ----------
        robots : ndarray of int
        states : ndarray, shape (robots, states)
        inputs : ndarray, shape (robots, inputs)
            Of strings, then their rates and a time where they ramp.
        duration : float
            s.
        """
        if self._lanes is None or (len(robots) == 1 and not self.parameters):
            rows = enumerate(robots.tolist())
            return np.array([self._one(k, states[i], inputs[i], duration) for i, k in rows])
        if self._loads is not None:
            loads, (strings, rates) = self._loads[robots], self._split(inputs)
            parts = [strings, loads, rates, np.zeros((len(robots), loads.shape[1] + 1))]
            inputs = np.hstack(parts if self._degree else parts[:2])
        spans = self._lanes.advance(robots, states, inputs, duration, 1, ctypes.c_int(0))
        return spans.states[:, 0]

    def _split(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        strings = len(self.model.structure.strings)
        return inputs[:, :strings], inputs[:, strings : 2 * strings]

    def _one(self, robot: int, state: FloatArray, u: FloatArray, duration: float) -> FloatArray:
        """Return the state of a robot at the end of a sample; NaN where there is none."""
        key = robot if self.parameters else 0  # models that are alike share it
        alone = self._alone.get(key)
        if alone is None:
            equation = self._equation_of(robot)
            core = core_scene(equation)
            alone = (
                self._method.integrator(equation, self._step)
                if core is None
                else CoreSample(core, self._method, self._step, len(u))
            )
            self._alone[key] = alone
        if isinstance(alone, CoreSample):
            end = alone.advance(state, u, duration)
            return np.full(len(state), np.nan) if end is None else end
        try:
            return np.asarray(alone.advance(state, u, duration, 1).states[:, 0])
        except IntegrationError:
            return np.full(len(state), np.nan)

    def accelerations(self, robots: np.ndarray, states: FloatArray, held: FloatArray) -> FloatArray:
        """Return the accelerations of nodes under held inputs, m/s², shape (robots, n d)."""
        if self._degree:
            held = np.hstack([held, np.zeros((len(held), held.shape[1] + 1))])
        if not self.parameters:
            return free_accelerations(self._equation_of(0), states.T, held.T).T
        moved = [
            free_accelerations(self._equation_of(robot), states[k, :, None], held[k, :, None])
            for k, robot in enumerate(robots.tolist())
        ]
        return np.hstack(moved).T
