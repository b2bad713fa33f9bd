"""One robot or many, advanced sample by sample under commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    Actuation,
    actuation_of,
    bounds_of_inputs,
    changes_of_inputs,
    inputs_of,
    moved_by,
    strings_of,
)
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, freeze_arrays
from tenscontrol.dynamics.model import Model
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.integrate.methods import METHODS
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.integration import Integration
from tenscontrol.simulation.scene import Scene
from tenscontrol.simulation.sensor_readings import ReadingsState, SensorReadings
from tenscontrol.simulation.stepped_models import SteppedModels
from tenscontrol.structure.structure import different_members

# Values that differ by this part of the largest are the same.
_ROUND_OFF = 1e-12


@dataclass(frozen=True, eq=False)
class StepperState:
    """Where the robots of a :class:`Stepper` are; it may be kept, pickled and set again.

    Attributes
    ----------
    sample : int
        Samples so far.
    states : ndarray, shape (count, states)
        Positions, then velocities, of the free coordinates, m and m/s.
    held : ndarray, shape (count, α)
        Rest lengths, m, or force densities, N/m, that the strings have.
    lost : ndarray of bool, shape (count,)
        Whether the motion of a robot has ended.
    readings : ReadingsState or None
        What sensors go on from; None without sensors.
    """

    sample: int
    states: FloatArray
    held: FloatArray
    lost: np.ndarray
    readings: ReadingsState | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze_arrays(self)


class Stepper:
    """Robots that advance by one sample per call, as the plant of your own loop.

    A sample has the bits of the same sample of ``simulate`` by this method with this step. It does
    nothing else: there is no record, no estimate of the error and no search for bars that cross.
    ``simulate`` with the same commands has these.

    Parameters
    ----------
    model : Model
        Without moving supports.
    sample_time : float
        s.
    step : float
        Largest step of the integration, s.
    method : {"rk4_plain", "rk4"}
        Whether steps go through switches of strings and contacts, or end at each. The first takes
        about half of the time, and is the faster one to errors of about 0.1 %; the second is where
        errors are to be smaller.
    rest_length, force_density : float or array_like, shape (α,) or (count, α)
        One of the two: what the strings have at the start, m or N/m, and what commands are.
    nodes, velocities : array_like, shape (d, n) or (count, d, n), optional
        The start, m and m/s; at rest in the shape of the structure if not given.
    winches : Winches, optional
        Their range, rate and ramp limit what commands do. Without them a command is reached at
        once. Motors and substeps are left to ``simulate``.
    actuated : sequence of int or str, dict, array_like or Actuation, optional
        The strings that are driven, as in :func:`linearize`: a command then has one value an
        input, and passive strings keep what they have. All strings, one by one, if not given.
    count : int, optional
        Number of robots, whose arrays then have an axis more in front; one robot, without that
        axis, if not given.
    parameters : dict, optional
        What robots have in place of the model's, by the names of :func:`simulate_many`, as
        ``"stiffness"``, ``"bar_mass"`` or ``"ground.friction"``: one number, one a member, shape
        (members,), one a robot, (count,), or (count, members).
    sensors : Sensors, optional
        Whose readings :meth:`step` and :meth:`reset` return, shape (m,) or (count, m), in place of
        the motion.
    seed : int, optional
        Of the noise of sensors, 0 if not given; robot k has that of ``seed + k``.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.

    Examples
    --------
    A prism, whose vertical strings are wound in for half a second:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0, damping=1.0))
    >>> start = tc.to_rest_length(model, prism.nodes, [17.3205] * 6 + [30.0] * 3).rest_length
    >>> robot = tc.Stepper(model, 0.05, step=1e-3, rest_length=start, actuated=["vertical"],
    ...                    winches=tc.Winches(rate=0.2))
    >>> for _ in range(10):
    ...     nodes, velocities = robot.step(0.9 * start[6:])
    >>> round(robot.time, 3), float((robot.held[6] / start[6]).round(3)), nodes.shape
    (0.5, 0.9, (3, 6))
    """

    def __init__(
        self,
        model: Model,
        sample_time: float,
        *,
        step: float,
        method: str = "rk4_plain",
        rest_length: Any = None,
        force_density: Any = None,
        nodes: Any = None,
        velocities: Any = None,
        winches: Winches | None = None,
        actuated: object = None,
        count: int | None = None,
        parameters: Mapping[str, Any] | None = None,
        sensors: Sensors | None = None,
        seed: int | None = None,
    ) -> None:
        self._given = {
            "model": model, "sample_time": sample_time, "step": step, "rest_length": rest_length,
            "force_density": force_density, "nodes": nodes, "velocities": velocities,
            "winches": winches, "actuated": actuated, "count": count, "parameters": parameters,
            "sensors": sensors, "seed": seed, "method": method,
        }  # fmt: skip
        validation.instance("model", model, Model, "make one by Model(structure)")
        self.sample_time = validation.positive_number("sample_time", sample_time, "s")
        self._step = validation.positive_number("step", step, "s")
        validation.choice("method", method, ("rk4_plain", "rk4"))
        self._how = Integration(method, step=self._step, error="none")
        self._shape = () if count is None else (validation.whole_number("count", count, 1),)
        self._count = 1 if count is None else count
        self._model = model
        scenes = self._scenes(nodes, velocities, rest_length, force_density)
        self.input: str = scenes[0].input
        self._begin = self._state_of(scenes)
        self._actuation = actuation_of(model.structure, actuated, self._begin.held[0])
        self._refuse_other_passive(self._begin.held)
        if winches is not None:
            validation.instance("winches", winches, Winches, "make them by Winches(rate=...)")
        self._ramps = winches is not None and winches.ramp
        self._limits = None if winches is None else self._checked_limits(winches)
        self._models = SteppedModels(
            model, self.input, int(self._ramps), METHODS[method], self._step, self._count
        )
        self._every = np.arange(self._count)
        if parameters is not None:
            self._models.set(self._every, parameters)
        seed = 0 if seed is None else validation.whole_number("seed", seed, 0)
        self._readings: SensorReadings | None = None
        if sensors is not None:
            self._readings = SensorReadings(
                self._checked_sensors(sensors), range(seed, seed + self._count), self.input,
                self.sample_time,
            )  # fmt: skip
        self.reset()

    def _checked_sensors(self, sensors: Sensors) -> Sensors:
        validation.instance("sensors", sensors, Sensors, "make them by Sensors(structure, ...)")
        different = different_members(sensors.structure, self._model.structure)
        if different:
            raise ValueError(
                f"sensors are on {sensors.structure!r}, but the model has a structure with "
                f"{different}"
            )
        return sensors

    def _scenes(
        self, nodes: Any, velocities: Any, rest_length: Any, force_density: Any
    ) -> list[Scene]:
        """Return what each robot begins with, checked as ``simulate`` does."""
        given = {
            "nodes": (nodes, 2), "velocities": (velocities, 2), "rest_length": (rest_length, 1),
            "force_density": (force_density, 1),
        }  # fmt: skip
        of_each: list[dict[str, Any]] = [{} for _ in range(self._count)]
        for name, (value, axes) in given.items():
            if value is None:
                continue
            array = validation.float_array(name, value)
            if self._shape and array.ndim == axes + 1:
                if len(array) != self._count:
                    raise ValueError(
                        f"{name} has shape {array.shape}, expected {self._count} robots along the "
                        "first axis, or one start for all"
                    )
                rows = list(array)
            else:
                rows = [array] * self._count
            for settings, row in zip(of_each, rows, strict=True):
                settings[name] = row

        def scene(settings: dict[str, Any]) -> Scene:
            return Scene(self._model, self.sample_time, **settings, integration=self._how)

        first = {name: array.tobytes() for name, array in of_each[0].items()}
        if all({k: v.tobytes() for k, v in settings.items()} == first for settings in of_each[1:]):
            return [scene(of_each[0])] * self._count
        return [scene(settings) for settings in of_each]

    def _state_of(self, scenes: list[Scene]) -> StepperState:
        held = [scene.inputs.at(np.zeros(1))[:, 0] for scene in scenes if scene.inputs is not None]
        return StepperState(
            0, np.stack([scene.state for scene in scenes]), np.stack(held),
            np.zeros(self._count, dtype=bool),
        )  # fmt: skip

    def _refuse_other_passive(self, held: FloatArray) -> None:
        """Raise if robots begin with values that their inputs cannot give."""
        wanted = self._values(self._inputs(held))
        off = np.abs(held - wanted)
        robot, string = np.unravel_index(off.argmax(), off.shape)
        if off[robot, string] > _ROUND_OFF * float(np.abs(held).max()):
            raise ValueError(
                f"robot {robot} begins with {held[robot, string]:g} in string {string}, which "
                f"actuated leaves at {wanted[robot, string]:g}: passive strings begin alike in all "
                "robots, and ganged ones by their ratios"
            )

    def _checked_limits(self, winches: Winches) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return least and largest input, and the largest change in a sample, or raise."""
        validation.instance("winches", winches, Winches, "make them by Winches(rate=...)")
        if self.input == "force_density":
            raise ValueError(
                "winches move rest lengths, but force_density is held: give rest_length, or leave "
                "them out"
            )
        if winches.motor is not None or winches.ticks > 1:
            raise ValueError(
                "winches have a motor or substeps, which a stepper leaves to simulate(...): give "
                "Winches(rate=..., shortest=..., longest=..., ramp=...)"
            )
        count = len(self._model.structure.strings)
        for held in self._begin.held:
            winches.refuse_out_of_range("rest_length", held, self._actuation.driven)
        rate = np.inf if winches.largest_rate is None else winches.largest_rate
        reach = np.broadcast_to(np.asarray(rate * self.sample_time, dtype=float), (count,))
        bounds = bounds_of_inputs(self._actuation, *winches.range(count))
        return *bounds, changes_of_inputs(self._actuation, reach)

    # ---- where it is ----

    @property
    def state(self) -> StepperState:
        """Where the robots are; set it to go on from there."""
        return StepperState(
            self._sample, self._states.copy(), self._held.copy(), self._lost.copy(),
            None if self._readings is None else self._readings.state,
        )  # fmt: skip

    @state.setter
    def state(self, state: StepperState) -> None:
        validation.instance("state", state, StepperState, "that of a stepper of this kind")
        for name, ours in (("states", self._begin.states), ("held", self._begin.held)):
            theirs = getattr(state, name)
            if theirs.shape != ours.shape:
                raise ValueError(
                    f"state.{name} has shape {theirs.shape}, expected {ours.shape}: that of a "
                    "stepper of this model and count"
                )
        self._sample, self._lost = state.sample, state.lost.copy()
        self._is_any_lost = bool(self._lost.any())
        self._states, self._held = state.states.copy(), state.held.copy()
        if self._readings is not None and state.readings is not None:
            self._readings.state = state.readings

    @property
    def time(self) -> float:
        """Time that has passed, s."""
        return self._sample * self.sample_time

    @property
    def nodes(self) -> FloatArray:
        """Positions of all nodes, m, shape (d, n) or (count, d, n); NaN of robots that are lost."""
        return self._motion()[0]

    @property
    def velocities(self) -> FloatArray:
        """Velocities of all nodes, m/s, shape (d, n) or (count, d, n)."""
        return self._motion()[1]

    @property
    def held(self) -> FloatArray:
        """What the strings have, m or N/m, shape (α,) or (count, α)."""
        return self._held.reshape((*self._shape, -1)).copy()

    @property
    def lost(self) -> np.ndarray:
        """Whether the state of a robot is no longer finite, shape () or (count,)."""
        return self._lost.reshape(self._shape).copy()

    @property
    def actuation(self) -> Actuation:
        """The map from the inputs of a command to the strings."""
        return self._actuation

    def _all_rows(self, states: FloatArray) -> FloatArray:
        """Return positions and velocities of all nodes, node by node, shape (2, robots, n d)."""
        structure = self._model.structure
        both = states.reshape(len(states), 2, -1).swapaxes(0, 1)
        if both.shape[2] == structure.nodes.size:
            return both.copy()
        rows = np.zeros((2, len(states), structure.nodes.size))
        rows[0] = structure.nodes.ravel(order="F")
        rows[:, :, structure.free_rows] = both
        return rows

    def _motion(self) -> tuple[FloatArray, FloatArray]:
        d, n = self._model.structure.nodes.shape
        both = self._all_rows(self._states)
        if self._is_any_lost:
            both[:, self._lost] = np.nan
        both = both.reshape(2, *self._shape, n, d).swapaxes(-2, -1)
        return both[0], both[1]

    @property
    def model(self) -> Model:
        """The model that robots have without ``parameters``."""
        return self._model

    @property
    def parameters(self) -> dict[str, FloatArray]:
        """What robots have in place of the model's, by name, shape (count, members)."""
        return {name: rows.copy() for name, rows in self._models.parameters.items()}

    @property
    def largest_step(self) -> float:
        """Largest step of the integration, s."""
        return self._step

    @property
    def limits(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Least and largest input, and the change in a sample, (m,); None without winches."""
        return self._limits

    def with_step(self, step: float) -> Stepper:
        """Return a stepper of the same robots, at the start, with another step.

        Parameters
        ----------
        step : float
            s.
        """
        return Stepper(**self._given | {"step": step, "parameters": self.parameters or None})

    def turn(self, robots: Any, angles: Any) -> None:
        """Turn robots about the vertical through the mean of their nodes.

        Parameters
        ----------
        robots : array_like of int or bool
        angles : array_like, shape (count,)
            rad, of all robots; those of others do not count.
        """
        structure = self._model.structure
        if structure.dimension != 3 or len(structure.fixed_rows):
            raise ValueError("the structure is in the plane or has supports: it cannot be turned")
        angles = validation.shaped("angles", angles, (self._count,), "one a robot, rad")
        which = validation.index_list("robots", robots, self._count, "robots")
        c, s, still = np.cos(angles[which]), np.sin(angles[which]), np.zeros(len(angles[which]))
        turns = np.array([[c, -s, still], [s, c, still], [still, still, still + 1]])
        shape = (-1, 2, structure.nodes.shape[1], 3)
        moving = self._states[which].reshape(shape)
        centre = np.zeros_like(moving[:, :, :1])
        centre[:, 0] = moving[:, 0].mean(axis=1, keepdims=True)
        turned = np.einsum("ijr,rkmj->rkmi", turns, moving - centre) + centre
        self._states[which] = turned.reshape(len(turned), -1)

    # ---- how it moves ----

    def reset(
        self, robots: Any = None, *, nodes: Any = None, velocities: Any = None,
        rest_length: Any = None, force_density: Any = None,
        parameters: Mapping[str, Any] | None = None,
    ) -> Any:  # fmt: skip
        """Put robots back to the start, or to another one; all if none are named.

        Noise begins anew where all robots do, and goes on where some do.

        Parameters
        ----------
        robots : array_like of int or bool, optional
            Those that begin anew, of many. Their time is that of the others.
        nodes, velocities, rest_length, force_density : array_like, optional
            Another start of all robots, m and N/m, as in the constructor.
        parameters : dict, optional
            What these robots have from now on, as of the constructor, with one row each.

        Returns
        -------
        nodes, velocities, or readings : ndarray
            As of :meth:`step`.
        """
        start = self._begin
        if any(value is not None for value in (nodes, velocities, rest_length, force_density)):
            given = self._given
            values = rest_length, force_density
            if all(value is None for value in values):
                values = given["rest_length"], given["force_density"]
            motion = (given["nodes"] if nodes is None else nodes), velocities
            scenes = self._scenes(*motion, *values)
            if scenes[0].input != self.input:
                raise ValueError(f"reset is given another input, expected {self.input}")
            start = self._state_of(scenes)
        which = self._every
        if robots is not None:
            which = validation.index_list("robots", robots, self._count, "robots")
        if which.dtype == bool:
            which = np.flatnonzero(which)
        if parameters is not None:
            self._models.set(which, parameters)
        if robots is None:
            self.state = start
            if self._readings is not None:
                self._readings.begin_all([self._models.model_of(k) for k in range(self._count)])
        else:
            self._states[which], self._held[which] = start.states[which], start.held[which]
            self._lost[which] = False
            self._is_any_lost = bool(self._lost.any())
            if self._readings is not None:
                self._readings.begin(which, [self._models.model_of(k) for k in which.tolist()])
        if self._readings is not None:
            self._read(self._readings, which, None)
        return self._handed_out()

    def _handed_out(self) -> Any:
        """Return the motion, or what has arrived from sensors."""
        if self._readings is None:
            return self._motion()
        arrived = self._readings.arrived
        if self._is_any_lost:
            arrived[self._lost] = np.nan
        return arrived.reshape(*self._shape, -1)

    def _read(self, readings: SensorReadings, robots: np.ndarray, held: FloatArray | None) -> None:
        """Let sensors measure robots; None is held before their first sample."""
        states = self._states[robots]
        nodes, velocities = self._all_rows(states)
        readings.take(
            robots, nodes, velocities, held, partial(self._models.accelerations, robots, states)
        )

    def step(self, command: Any) -> Any:
        """Advance by a sample under a command.

        Parameters
        ----------
        command : array_like, shape (m,) or (count, m)
            Rest lengths wanted, m, or force densities, N/m: one an input, as ``actuated`` says,
            or one a string.

        Returns
        -------
        nodes, velocities : ndarray, shape (d, n) or (count, d, n)
            At the end of the sample, m and m/s; NaN of robots whose motion has ended. With
            ``sensors`` what arrives then instead, shape (m,) or (count, m).

        Raises
        ------
        TypeError, ValueError
            If the command is of another shape, not finite, or no rest length or γ.
        """
        inputs = len(self._actuation.lead)
        wanted = validation.shaped(
            "command", command, (*self._shape, inputs), "one value an input"
        ).reshape(self._count, inputs)
        if self.input == "rest_length":
            validation.positive("command", wanted, "rest length in m")
        else:
            validation.non_negative("command", wanted, "a string can only pull")
        # As a loop over samples has it, to the last bit.
        start = self._sample * self.sample_time
        duration = start + self.sample_time - start
        held, end = self._inputs_in_time(wanted)
        self._advance(held, duration)
        self._held, self._sample = end, self._sample + 1
        if self._readings is not None:
            going = np.flatnonzero(~self._lost) if self._is_any_lost else self._every
            if len(going):
                self._read(self._readings, going, end[going])
        return self._handed_out()

    def _inputs(self, held: FloatArray) -> FloatArray:
        return np.asarray(inputs_of(self._actuation, held.T).T)

    def _values(self, inputs: FloatArray) -> FloatArray:
        return np.asarray(strings_of(self._actuation, inputs.T).T)

    def _inputs_in_time(self, wanted: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the inputs of the equation over a sample, and what strings have at its end."""
        now = self._inputs(self._held)
        if self._limits is not None:
            low, high, reach = self._limits
            wanted = np.clip(np.clip(wanted, low, high), now - reach, now + reach)
        end = self._values(wanted)
        if not self._ramps:
            return end, end
        speed = (wanted - now) / self.sample_time
        if not self._actuation.is_whole:
            speed = moved_by(self._actuation, speed)
        return np.hstack([self._held, speed, np.zeros((self._count, 1))]), end

    def _advance(self, held: FloatArray, duration: float) -> None:
        """Advance the robots that are not lost."""
        if self._is_any_lost:
            going = np.flatnonzero(~self._lost)
            if len(going):
                ends = self._models.advance(going, self._states[going], held[going], duration)
                self._enter(going, ends)
        else:
            self._enter(
                self._every, self._models.advance(self._every, self._states, held, duration)
            )

    def _enter(self, robots: np.ndarray, states: FloatArray) -> None:
        """Take new states, and note robots that have none."""
        if len(robots) == self._count and validation.is_bounded(states):
            self._states = states
            return
        is_good = (np.abs(states) < validation.LARGEST).all(axis=1)  # no NaN is
        self._states[robots[is_good]] = states[is_good]
        self._lost[robots[~is_good]] = True
        self._is_any_lost = bool(self._lost.any())

    def __reduce__(self) -> tuple[Any, ...]:
        return _made_again, (self._given | {"parameters": self.parameters or None}, self.state)

    def __repr__(self) -> str:
        robots = f"{self._count} robots" if self._shape else "one robot"
        return (
            f"Stepper({robots}, {len(self._actuation.lead)} inputs, {self.input}, "
            f"{self.sample_time:g} s a sample)"
        )


def _made_again(given: dict[str, Any], state: StepperState) -> Stepper:
    stepper = Stepper(**given)
    stepper.state = state
    return stepper
