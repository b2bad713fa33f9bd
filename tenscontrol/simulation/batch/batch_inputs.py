"""Inputs of a batch of runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.motors import motor_numbers, with_motor_numbers
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.control.controller import Controller
from tenscontrol.dynamics.held_inputs import held_value, refuse_load
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.model_parameters import (
    MASSES,
    constant_forces,
    law_parameters,
    least_value,
    parameters_of,
    with_parameters,
)
from tenscontrol.dynamics.profile import Pieces
from tenscontrol.integrate.integrator import steps_between
from tenscontrol.properties import cached_property
from tenscontrol.simulation.batch.compiled_loop import checked_controller
from tenscontrol.simulation.closed_loop import samples
from tenscontrol.simulation.inputs import changes_in_time
from tenscontrol.simulation.scene import Scene
from tenscontrol.simulation.start import initial_state

# A start whose bars are off by less than this, as part of their length and of the largest speed,
# is taken as it is, as in a single run; the others are looked at one by one.
_EXACT, _NO_LENGTH = 1e-8, 1e-11

# What is no parameter of the model.
_ARRAYS = (
    "nodes", "velocities", "rest_length", "force_density", "external_force", "load", "bar_length",
)  # fmt: skip


def single_runs_of(scene: Scene) -> str | None:
    """Return why runs of a scene go one after another by :func:`simulate`; None if together."""
    if scene.drives_bars:
        return "bars are driven"
    for name in ("winches", "estimator", "support_motion", "start"):
        if getattr(scene, name) is not None:
            return f"{name} given"
    return "faults given" if scene.faults else None


def refusal(scene: Scene) -> str | None:
    """Return why runs of a scene cannot be done together; None if they can."""
    why = single_runs_of(scene)
    if why is not None:
        return why
    law = scene.law
    if law is None:
        return None
    try:
        checked_controller(scene.controller, scene.model)
    except (TypeError, ValueError) as error:
        return str(error)
    if scene.input != law.input or scene.rest_length is not None:
        return "the controller is told rest lengths at the start, or has another input"
    return None


def checked_variation(scene: Scene, vary: object) -> dict[str, FloatArray]:
    """Return what differs from run to run, by name, as arrays with a first axis of runs."""
    if not isinstance(vary, Mapping):
        raise validation.wrong_kind("vary", vary, "a dict of arrays, by name, one entry a run")
    shapes = _shapes(scene)
    given = {
        name: _of_runs(f"vary[{name!r}]", value, shapes[validation.choice("vary", name, shapes)])
        for name, value in vary.items()
    }
    if "gravity" in given and np.ndim(vary["gravity"]) == 1:
        down = np.append(np.zeros(scene.structure.dimension - 1), -1.0)
        given["gravity"] = np.outer(vary["gravity"], down)
    if not given:
        raise ValueError(
            "vary is empty, so all runs are the same: give what differs by name, one entry a run"
        )
    (first, count), *others = ((name, len(values)) for name, values in given.items())
    for name, other in others:
        if other != count:
            raise ValueError(f"vary[{name!r}] has {other} runs, but vary[{first!r}] has {count}")
    if not count:
        raise ValueError(f"vary[{first!r}] has 0 runs, expected at least one")
    return given


def _shapes(scene: Scene) -> dict[str, tuple[int, ...]]:
    """Return what can differ from run to run, and the shape that each run has."""
    model, nodes = scene.model, scene.structure.nodes.shape
    shapes: dict[str, tuple[int, ...]] = {"nodes": nodes, "velocities": nodes}
    if scene.controller is None or (scene.winches is not None and scene.input == "rest_length"):
        shapes[scene.input] = (len(scene.structure.strings),)
    if scene.winches is not None and scene.law is not None:
        wound = len(scene.law.commanded.strings)
        shapes |= dict.fromkeys(motor_numbers(scene.winches.motor, wound), (wound,))
    if scene.drives_bars:
        shapes["bar_length"] = (len(scene.structure.bars),)
    shapes["external_force"] = nodes
    without = () if scene.input == "rest_length" else law_parameters(model)
    members = {name: value.shape for name, value in parameters_of(model).items()}
    return shapes | {name: shape for name, shape in members.items() if name not in without}


def _of_runs(label: str, value: object, shape: tuple[int, ...]) -> FloatArray:
    """Return an array of shape (runs, *shape); of members also from one number a run."""
    axes, own = _axes(value), ", ".join(map(str, shape))
    if len(shape) > 1:
        runs: Any = len(value) if axes == 1 + len(shape) else "runs"  # type: ignore[arg-type]
        return validation.measured(label, value, (runs, *shape), "one a run")
    if axes not in (1, 2):
        expected = f"an array of shape (runs,) or (runs, {own}): one a run, or one a run and member"
        raise validation.wrong_kind(label, value, expected)
    wanted = (len(value), *shape)[:axes]  # type: ignore[arg-type]  # has an axis
    array = validation.measured(label, value, wanted, "one a run, or one a run and member")
    return array if axes == 2 else np.outer(array, np.ones(shape))


def _axes(value: Any) -> int:
    """Return the number of axes; -1 for rows of different lengths, refused where they are read."""
    try:
        axes = np.ndim(value)
    except ValueError:
        return -1
    return axes if isinstance(axes, int) else 0  # what is no array may have any ``ndim``


class BatchInputs:
    """What a batch integrates: a scene, and what differs from it run by run.

    ``given`` are arrays with a first axis of runs, see :func:`checked_variation`. The scene has
    some value of each.
    """

    def __init__(self, base: Scene, given: dict[str, FloatArray]) -> None:
        self.base, self.given, self.input = base, given, base.input
        self.model, self.duration = base.model, base.duration
        self.count = max(map(len, given.values()))
        self._of_motors = [name for name in given if name.startswith("motor.")]
        self.varied = [name for name in given if name not in (*_ARRAYS, *self._of_motors)]
        self.held: Pieces | None = None
        if isinstance(base.law, Controller):
            # What runs begin from, and what is chosen for, until there is a command.
            self.held = Pieces.constant(base.law.plant.string_values)
        elif self.input not in given:
            self.held = base.inputs
        # All that acts on the nodes from outside: the same for all, in time, or run by run.
        self.load = base.loads
        if self._loads_differ():
            self._stack_loads()

    @property
    def varies_ground(self) -> bool:
        """Whether contact laws differ from run to run."""
        return any(name.startswith("ground") for name in self.varied)

    def _loads_differ(self) -> bool:
        heavy = {"gravity", *MASSES} & set(self.varied)
        is_weighted = heavy and ("gravity" in self.given or self.model.gravity.any())
        differ = bool("external_force" in self.given or is_weighted)
        if differ and changes_in_time(self.base.external_force):
            raise ValueError("external_force changes in time, so masses and gravity may not vary")
        return differ

    def _stack_loads(self) -> None:
        """Find all that acts on the nodes of each run."""
        model, given = self.model, self.given
        external_force = self.base.external_force
        if "external_force" in given and given["external_force"].any():
            refuse_load(model)
        c = constant_forces(model, given)
        # In the order of a single run, for its bits.
        if "external_force" in given or external_force is not None:
            forces = given.get("external_force", np.asarray(external_force)[None])
            c = ((forces + c) - c) + c
        given["load"] = c.transpose(0, 2, 1).reshape(len(c), -1)
        self.load = np.zeros(model.structure.nodes.shape)

    def entry(self, name: str, run: int) -> FloatArray | None:
        """Return what a run is given beside the scene; None for nothing."""
        array = self.given.get(name)
        return None if array is None else array[run if len(array) > 1 else 0]

    def model_of(self, run: int) -> Model:
        """Return the model of a run, refusing parameters that are none."""
        return with_parameters(self.model, {name: self.given[name][run] for name in self.varied})

    def scene_of(self, run: int) -> Scene:
        """Return the scene of a run alone, refusing numbers that do not fit."""
        names = "nodes", "velocities", "external_force", "bar_length", self.input
        own: dict[str, Any] = {name: self.given[name][run] for name in names if name in self.given}
        winches = self.base.winches
        if self._of_motors and winches is not None and winches.motor is not None:
            numbers = {name: self.given[name][run] for name in self._of_motors}
            motor = with_motor_numbers(winches.motor, numbers)
            own["winches"] = replace(winches, motor=motor)
        return replace(self.base, model=self.model_of(run) if self.varied else self.model, **own)

    def input_value(self, run: int) -> FloatArray:
        """Return what a run holds, m or N/m, shape (α,)."""
        own = self.entry(self.input, run)
        return self.base.input_value if own is None else own

    def single(self, run: int) -> FloatArray:
        """Return the state at the start of a run, checked as that of a single run is.

        Raises TypeError or ValueError if it is refused.
        """
        model = self.model_of(run)
        held = None
        if self.held is None:
            own = {self.input: self.entry(self.input, run)}
            held = held_value(model.structure, own.get("rest_length"), own.get("force_density"))
        else:
            held = self.held.at(np.zeros(1))[:, 0]
        if "external_force" in self.given:
            validation.float_array("external_force", self.entry("external_force", run))
        nodes, velocities = (
            getattr(self.base, name)
            if name not in self.given
            else model.structure.checked_nodes(name, self.given[name][run])
            for name in ("nodes", "velocities")
        )
        motion = nodes, velocities
        return initial_state(model, *motion, self.input, lambda: held, measured=False)[0]

    def states(self, runs: IntArray) -> tuple[FloatArray, dict[int, str]]:
        """Return the states at the start of some runs, and why others are refused: by number."""
        structure, base = self.model.structure, self.base
        N = self.some("nodes", runs, base.nodes)
        V = self.some("velocities", runs, base.velocities)
        every = [array.transpose(0, 2, 1).reshape(len(array), -1) for array in (N, V)]
        rows, half = structure.free_rows, len(structure.free_rows)
        states = np.empty((len(runs), 2 * half))
        states[:, :half], states[:, half:] = (array[:, rows] for array in every)
        doubtful = ~self._clear(runs, N, V, every)
        refused = {}
        for i in np.flatnonzero(doubtful):
            run = int(runs[i])
            try:
                states[i] = self.single(run)
            except (TypeError, ValueError) as error:
                refused[run] = str(error)
        return states, refused

    def some(self, name: str, runs: IntArray, usual: Any = None) -> FloatArray:
        """Return what some runs are given, with a first axis of one entry, or one a run."""
        array = self.given.get(name)
        if array is None:
            return np.asarray(usual)[None]
        return array[runs] if len(array) > 1 else array

    def _clear(
        self, runs: IntArray, N: FloatArray, V: FloatArray, every: list[FloatArray]
    ) -> np.ndarray:
        """Return of which runs nothing needs a closer look: bars, supports, and all numbers."""
        structure = self.model.structure
        fine = np.ones(len(runs), dtype=bool)
        for name in self.given:
            values = self.some(name, runs)
            values = values.reshape(len(values), -1) if values.size else np.zeros((1, 0))
            lowest = least_value(name)
            fine &= ((values >= lowest) & (values <= validation.LARGEST)).all(axis=1)
        rows = structure.fixed_rows
        at = structure.nodes.ravel(order="F")[rows]
        fine &= (every[0][:, rows] == at).all(axis=1) & (every[1][:, rows] == 0).all(axis=1)
        (start, end), length = structure.bars.T, structure.bar_length
        with np.errstate(invalid="ignore", over="ignore"):
            B, Bd = N[:, :, end] - N[:, :, start], V[:, :, end] - V[:, :, start]
            off = np.abs(np.linalg.norm(B, axis=1) / length - 1).max(axis=1, initial=0.0)
            stretching = (np.abs((B * Bd).sum(axis=1)) / length).max(axis=1, initial=0.0)
            fine &= (off <= _EXACT) & (stretching <= _EXACT * np.abs(V).max(axis=(1, 2)))
            start, end = structure.segments.T
            along = np.linalg.norm(N[:, :, end] - N[:, :, start], axis=1)
            longest = along.max(axis=1, initial=0.0, keepdims=True)
            fine &= (along > _NO_LENGTH * longest).all(axis=1)
        return fine

    def held_inputs(self, first: int, last: int, span: InputSpan, parameters: bool) -> FloatArray:
        """Return u of some runs, shape (1 or runs, inputs), from what all have in common.

        ``parameters`` says whether those that vary are among them.
        """
        coefficients, time = span.coefficients, span.time
        own = [] if self.held is not None else [(0, self.input)]
        if "load" in self.given:
            own.append((len(self.model.structure.strings), "load"))
        place = len(coefficients)
        for name in self.parameters if parameters else ():
            own.append((place, name))
            place += self.given[name].shape[1]
        runs = np.arange(first, last)
        parts = [(start, self.some(name, runs)) for start, name in own]
        count = max((len(values) for _, values in parts), default=1)
        u = np.zeros((count, coefficients.shape[1], place))
        u[:, :, : len(coefficients)] = coefficients.T
        for start, values in parts:
            u[:, 0, start : start + values.shape[1]] = values
        held = u.reshape(count, -1) if u.size else np.zeros((count, 0))
        return held if time is None else np.column_stack([held, np.full(count, time)])

    @property
    def parameters(self) -> list[str]:
        """Parameters that are inputs of the equation."""
        return [name for name in self.varied if name != "gravity"]

    @cached_property
    def pieces(self) -> Pieces:
        """What all runs have in common of the inputs: zero for what is each run's own."""
        strings = self.held
        if strings is None:
            strings = Pieces.constant(np.zeros(len(self.model.structure.strings)))
        parts = [strings.within(0.0, self.duration)]
        if isinstance(self.load, Pieces):
            parts.append(self.load.within(0.0, self.duration))
        elif "load" in self.given:
            parts.append(Pieces.constant(np.zeros(self.given["load"].shape[1])))
        return Pieces.stacked(parts)

    def spans(self, output_step: float | None, sample_time: float | None = None) -> list[InputSpan]:
        """Return the parts of the run in which inputs are one polynomial, as a single run has.

        Under a controller these are its samples.
        """
        pieces, now, left = self.pieces, 0.0, self.duration
        close = 1e-9 * self.duration
        spans = []

        def outputs_of(length: float) -> int:
            return 1 if output_step is None else steps_between(length, output_step)

        if sample_time is not None:
            if pieces.degree or pieces.breaks(close, self.duration - close):
                raise ValueError(
                    "external_force changes in time, which many runs under a controller do not "
                    "follow: simulate does"
                )
            held = pieces.piece(close)[1]
            return [
                InputSpan(start, end - start, outputs_of(end - start), held, None)
                for _, start, end in samples(sample_time, self.duration)
            ]
        for end in [*pieces.breaks(close, self.duration - close), None]:
            length = left if end is None else end - now
            origin, coefficients = pieces.piece(now + close)
            outputs = outputs_of(length)
            time = now - origin if pieces.degree else None
            spans.append(InputSpan(now, length, outputs, coefficients, time))
            now = now + length
            left = self.duration if end is None else self.duration - end
        return spans


@dataclass(frozen=True, eq=False)
class InputSpan:
    """A part of the run in which inputs are one polynomial."""

    start: float
    length: float
    outputs: int
    coefficients: FloatArray
    time: float | None  # within the polynomials; None where inputs are held

    @property
    def times(self) -> FloatArray:
        """Times of the states kept, s."""
        return self.start + self.length * np.arange(1, self.outputs + 1) / self.outputs
