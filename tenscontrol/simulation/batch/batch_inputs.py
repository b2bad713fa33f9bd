"""Inputs of many runs, checked: starts, inputs, loads and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import ceil
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import gravity_forces
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Pieces
from tenscontrol.plant.equilibrium import held_value, refuse_load
from tenscontrol.properties import cached_property
from tenscontrol.simulation.closed_loop import samples
from tenscontrol.simulation.inputs import changes_in_time
from tenscontrol.simulation.scene import Scene
from tenscontrol.simulation.start import initial_state

# A start whose bars are off by less than this, as part of their length and of the largest speed,
# is taken as it is, as in a single run; the others are looked at one by one.
_EXACT, _NO_LENGTH = 1e-8, 1e-11

# Numbers that may be zero, and those that may have any sign; all others are positive.
_FROM_ZERO = {"force_density", "damping", "point_mass"}
_SIGNED = {"nodes", "velocities", "external_force", "load", "gravity"}

# What is no parameter of the model.
_ARRAYS = "nodes", "velocities", "rest_length", "force_density", "external_force", "load"


MASSES = "bar_mass", "point_mass"


def given_by_run(model: Model, vary: object, **values: object) -> dict[str, FloatArray]:
    """Return arrays with a first axis: of one entry, or one a run."""
    count, nodes = len(model.structure.strings), model.structure.nodes
    shapes = dict.fromkeys(("nodes", "velocities", "external_force"), nodes.shape)
    found, runs = dict[str, FloatArray](), dict[str, int]()
    for name, value in values.items():
        if value is None or changes_in_time(value):
            continue
        shape = shapes.get(name, (count,))
        if name == "external_force" and _axes(value) == 0:
            value = validation.node_forces(name, value, shape)
        stacked = _axes(value) > len(shape)
        wanted = (len(value), *shape) if stacked else shape  # type: ignore[arg-type]  # has an axis
        if len(shape) == 1 and _axes(value) == 0:
            value = np.full(shape, validation.measured(name, value, ()))
        array = validation.measured(
            name, value, wanted, f"of a run {shape}, with a first axis for runs"
        )
        found[name] = array if stacked else array[None]
        runs |= {name: len(array)} if stacked else {}
    parameters = _varied_parameters(model, vary, values.get("rest_length") is not None)
    found |= parameters
    runs |= {f"vary[{name!r}]": len(array) for name, array in parameters.items()}
    if not runs:
        raise ValueError(
            "all runs are the same: give one of nodes, velocities, rest_length, "
            "force_density, external_force and vary a first axis with one entry for each run"
        )
    (first, count), *others = runs.items()
    for name, other in others:
        if other != count:
            raise ValueError(f"{name} has {other} runs, but {first} has {count}")
    if not count:
        raise ValueError(f"{first} has 0 runs, expected at least one")
    return found


def _varied_parameters(model: Model, vary: object, is_wound: bool) -> dict[str, FloatArray]:
    """Return parameters of the model, shape (runs, members); of strings if these are wound."""
    if vary is not None and not isinstance(vary, Mapping):
        raise validation.wrong_kind("vary", vary, "a dict of arrays, one entry a run")
    d, n = model.structure.nodes.shape
    found = {}
    sizes = {"bar_mass": len(model.structure.bars), "point_mass": n, "gravity": d}
    if is_wound and model.strings is not None:
        count = len(model.structure.strings)
        sizes |= {each.name: count for each in fields(model.strings)}
    for name, value in (vary or {}).items():
        size = sizes[validation.choice("vary", name, sizes)]
        label = f"vary[{name!r}]"
        axes = _axes(value)
        if axes == 0 or axes > 2:
            expected = f"an array of shape (runs,) or (runs, {size}): one a run, or one a run and"
            raise validation.wrong_kind(label, value, f"{expected} member")
        wanted = (len(value), size) if axes == 2 else (len(value),)
        array = validation.measured(label, value, wanted, "one a run, or one a run and member")
        if array.ndim == 1:
            array = np.outer(array, _down(d) if name == "gravity" else np.ones(size))
        found[name] = array
    return found


def _axes(value: Any) -> int:
    """Return the number of axes; -1 for rows of different lengths, refused where they are read."""
    try:
        axes = np.ndim(value)
    except ValueError:
        return -1
    return axes if isinstance(axes, int) else 0  # what is no array may have any ``ndim``


def _down(dimension: int) -> FloatArray:
    return np.append(np.zeros(dimension - 1), -1.0)


class BatchInputs:
    """What a batch integrates: a scene, and what varies from it run by run.

    ``given`` are arrays with a first axis, see :func:`given_by_run`; what it has is zero, or the
    reference, in the scene ``base``.
    """

    def __init__(self, base: Scene, given: dict[str, FloatArray]) -> None:
        self.base, self.given, self.input = base, given, base.input
        self.model, self.duration = base.model, base.duration
        self.count = max(map(len, given.values()))
        self.varied = [name for name in given if name not in _ARRAYS]
        self.held = None if self.input in given else base.inputs
        # All that acts on the nodes from outside: the same for all, in time, or run by run.
        self.load = base.loads
        external_force = base.external_force
        if "external_force" in given and len(given["external_force"]) == 1:
            external_force = given.pop("external_force")[0]
        if self._loads_differ():
            self._stack_loads(external_force)

    def _loads_differ(self) -> bool:
        heavy = {"gravity", *MASSES} & set(self.varied)
        is_weighted = heavy and ("gravity" in self.given or self.model.gravity.any())
        differ = bool("external_force" in self.given or is_weighted)
        if differ and changes_in_time(self.base.external_force):
            raise ValueError("external_force changes in time, so masses and gravity may not vary")
        return differ

    def _stack_loads(self, external_force: object) -> None:
        """Find all that acts on the nodes of each run."""
        model, given = self.model, self.given
        if "external_force" in given and given["external_force"].any():
            refuse_load(model)
        c = model.built_in_load + gravity_forces(
            model.structure,
            given.get("gravity", model.gravity),
            given.get("bar_mass", model.structure.bar_mass),
            given.get("point_mass", model.structure.point_mass),
        )
        c = c if c.ndim == 3 else c[None]
        # In the order of a single run, for its bits.
        if "external_force" in given or external_force is not None:
            each = given.get("external_force", np.asarray(external_force)[None])
            c = ((each + c) - c) + c
        given["load"] = c.transpose(0, 2, 1).reshape(len(c), -1)
        self.load = np.zeros(model.structure.nodes.shape)

    def entry(self, name: str, run: int) -> FloatArray | None:
        """Return what a run is given; None for nothing."""
        array = self.given.get(name)
        return None if array is None else array[run if len(array) > 1 else 0]

    def model_of(self, run: int) -> Model:
        """Return the model of a run, refusing parameters that are none."""
        if not self.varied:
            return self.model
        model = self.model
        own: dict[str, Any] = {name: self.entry(name, run) for name in self.varied}
        masses = {name: own.pop(name) for name in MASSES if name in own}
        structure = replace(model.structure, **masses) if masses else model.structure
        gravity = own.pop("gravity", model.gravity)
        strings = (
            replace(model.strings, **own) if model.strings is not None and own else model.strings
        )
        return model.replace(structure=structure, strings=strings, gravity=gravity)

    def single(self, run: int) -> FloatArray:
        """Return the state at the start of a run, checked as that of a single run is.

        Raises TypeError or ValueError if it is refused.
        """
        model = self.model_of(run)
        held = None
        if self.held is None:
            own = {self.input: self.entry(self.input, run)}
            held = held_value(model, own.get("rest_length"), own.get("force_density"))
        else:
            held = self.held.at(np.zeros(1))[:, 0]
        if "external_force" in self.given:
            validation.float_array("external_force", self.entry("external_force", run))
        nodes, velocities = self.entry("nodes", run), self.entry("velocities", run)
        state, _ = initial_state(model, nodes, velocities, self.input, held, measured=False)
        return state

    def states(self, first: int, last: int) -> tuple[FloatArray, dict[int, str]]:
        """Return the states at the start of some runs, and why others are refused: by number."""
        structure = self.model.structure
        d, n = structure.nodes.shape
        count = last - first
        N, V = (
            np.broadcast_to(self.some(name, first, last, usual), (count, d, n))
            for name, usual in (("nodes", structure.nodes), ("velocities", np.zeros((d, n))))
        )
        every = [part.transpose(0, 2, 1).reshape(count, -1) for part in (N, V)]
        states = np.hstack([part[:, structure.free_rows] for part in every])
        doubtful = ~self._clear(first, last, N, V, every)
        refused = {}
        for i in np.flatnonzero(doubtful):
            try:
                states[i] = self.single(first + int(i))
            except (TypeError, ValueError) as error:
                refused[first + int(i)] = str(error)
        return states, refused

    def some(self, name: str, first: int, last: int, usual: Any = None) -> FloatArray:
        """Return what some runs are given, with a first axis of one entry, or one a run."""
        array = self.given.get(name)
        if array is None:
            return np.asarray(usual)[None]
        return array[first:last] if len(array) > 1 else array

    def _clear(
        self, first: int, last: int, N: FloatArray, V: FloatArray, every: list[FloatArray]
    ) -> np.ndarray:
        """Return of which runs nothing needs a closer look: bars, supports, and all numbers."""
        structure = self.model.structure
        fine = np.ones(last - first, dtype=bool)
        for name in self.given:
            values = self.some(name, first, last)
            values = values.reshape(len(values), -1) if values.size else np.zeros((1, 0))
            lowest = 0.0 if name in _FROM_ZERO else np.finfo(float).tiny
            if name in _SIGNED:
                lowest = -validation.LARGEST
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
        parts = [(start, self.some(name, first, last)) for start, name in own]
        count = max((len(part) for _, part in parts), default=1)
        u = np.zeros((count, coefficients.shape[1], place))
        u[:, :, : len(coefficients)] = coefficients.T
        for start, part in parts:
            u[:, 0, start : start + part.shape[1]] = part
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
        found = []

        def outputs_of(length: float) -> int:
            return 1 if output_step is None else max(1, ceil(length / output_step - 1e-9))

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
            found.append(InputSpan(now, length, outputs, coefficients, time))
            now = now + length
            left = self.duration if end is None else self.duration - end
        return found


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
