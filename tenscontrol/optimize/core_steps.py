"""Propagation of small changes over steps by the compiled core, forward or backward."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.core import records
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.model import Model
from tenscontrol.integrate.core_scene import CoreScene, core_scene
from tenscontrol.optimize.parameters import Parameter, load_of_gravity, shares, unit_load
from tenscontrol.optimize.traced_steps import TracedSteps
from tenscontrol.properties import cached_property

# Numbers of contact laws in the order of the core.
_GROUND = "stiffness", "damping", "friction", "slip_speed", "height", "width"

# Steps in a call, and the costs by inputs at their stages, at most.
_MOST_STEPS, _MOST_NUMBERS = 512, 2_000_000


class Tableau(NamedTuple):
    """An explicit Runge-Kutta method."""

    a: FloatArray
    b: FloatArray
    c: FloatArray


def core_steps(
    model: Model,
    equation: Equation,
    steps: TracedSteps,
    method: Tableau,
    parameters: Sequence[Parameter],
    columns: Sequence[slice],
    answers: bool,
) -> CoreSteps | None:
    """Return the steps of a run as the core differentiates them; None where there is none."""
    scene = core_scene(equation)
    if scene is None:
        return None
    return CoreSteps(scene, model, steps, method, parameters, columns, answers)


class CoreSteps:
    """The steps of a run, differentiated by the core.

    Parameters
    ----------
    scene : CoreScene
    model : Model
    steps : TracedSteps
    method : Tableau
    parameters : sequence of Parameter
    columns : sequence of slice
        Which columns of a derivative are those of each parameter.
    answers : bool
        Whether the input answers changes by feedback.
    """

    def __init__(
        self, scene: CoreScene, model: Model, steps: TracedSteps, method: Tableau,
        parameters: Sequence[Parameter], columns: Sequence[slice], answers: bool,
    ) -> None:  # fmt: skip
        self._core, self._tables = scene, records.Scene.from_buffer_copy(scene.scene)
        self._model, self._steps = model, steps
        self._parameters, self._columns = parameters, columns
        if any(
            parameter.kind == "strings" and parameter.field == "damping" for parameter in parameters
        ):
            self._tables.damped = 1  # also where it is zero
        self._c = method.c
        #: Whether it puts bars on their lengths after steps, too.
        self.projects = steps.projects and not model.structure.blocks
        self._lengths = ctypes.byref(scene.lengths) if self.projects else None
        self._width = columns[-1].stop if columns else 0
        self._padded = -(-max(self._width, 1) // records.COLUMNS) * records.COLUMNS
        self._pulls = [self._pull(parameter) for parameter in parameters]
        self._profiles = [
            (parameter, own)
            for parameter, own in zip(parameters, columns, strict=True)
            if parameter.pieces is not None
        ]
        self._answers = answers
        self._costs, self._derivatives = self._record(1)
        self._by_input = np.zeros(len(model.structure.strings))
        self._inputs = np.ascontiguousarray(steps.inputs.T)
        self._drive = scene.drive(self._inputs[0])
        self._method = [np.ascontiguousarray(array, dtype=float) for array in method]
        self._tableau = records.Tableau(len(self._c), *map(records.address, self._method))
        self._states = np.ascontiguousarray(steps.states.T)
        self._taut = np.ascontiguousarray(steps.taut.T)
        self._length = np.ascontiguousarray(steps.length)
        scene_and_drive = map(ctypes.byref, (self._tables, self._drive))
        self._always = *scene_and_drive, self._lengths, ctypes.byref(self._tableau)
        self._rows = [
            (records.address(array), array.strides[0])
            for array in (self._length, self._states, self._inputs, self._taut)
        ]

    @cached_property
    def _forwards(self) -> tuple[records.Changes, dict[str, FloatArray], FloatArray | None]:
        """Changes by all parameters, with their arrays, and the inputs of them but for answers."""
        changes, given = self._record(self._padded)
        for name, value in self._unit_changes().items():
            given[name][..., : self._width] = value
        return changes, given, given["input"].copy() if self._answers else None

    @cached_property
    def _works(self) -> dict[int, FloatArray]:
        return {}

    def _work(self, columns: int) -> FloatArray:
        """Return work memory for so many columns."""
        if columns not in self._works:
            scene, drive, _, method = self._always
            size = self._core.core.tc_variations_work_size(scene, drive, method, columns)
            self._works[columns] = np.empty(size)
        return self._works[columns]

    def most(self, is_back: bool) -> int:
        """Return how many steps a call may take at most.

        One where something has to be done after each, or at the stages of each.
        """
        if self._steps.projects and not self.projects:
            return 1
        if not is_back:
            return 1 if self._profiles else _MOST_STEPS
        numbers = len(self._c) * len(self._by_input)
        return max(1, min(_MOST_STEPS, _MOST_NUMBERS // max(numbers, 1)))

    def forward(
        self, first: int, count: int, part: float | None, X: FloatArray, answer: FloatArray | None
    ) -> FloatArray:
        """Return the derivative of the state, (states, P), after steps, or a part of one, s."""
        whole = np.zeros((len(X), self._padded))
        whole[:, : self._width] = X
        changes, given, always_given = self._forwards
        if answer is not None:
            given["input"][:] = always_given
        for parameter, columns in self._profiles:
            share = self._share(parameter, first, 1, part)
            self._enter_inputs(share, given["input"][..., columns])
        if answer is not None:
            given["input"][..., : self._width] += answer
        self._call(self._core.core.tc_tangents, first, count, part, changes, whole)
        return whole[:, : self._width]

    def backward(
        self, first: int, count: int, part: float | None, end: FloatArray, slope: FloatArray
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return a cost by the state before steps from that after them, and by the input meanwhile.

        Those by the values of profiles are added to the slope; those by all else are kept.
        """
        mu, whole = end.copy(), None
        by_input = None
        if "input" in self._derivatives:
            by_input = np.empty((count, len(self._c), len(self._by_input)))
            self._costs.input = records.address(by_input)
        self._call(self._core.core.tc_costs, first, count, part, self._costs, mu)
        if by_input is not None:
            rows = by_input.reshape(-1, by_input.shape[2])
            whole = rows.sum(axis=0)
            self._by_input += whole
            for parameter, columns in self._profiles:
                share = self._share(parameter, first, count, part)
                slope[columns] += (rows.T @ share.T).ravel()
        return mu, whole

    def take_costs(self, slope: FloatArray) -> None:
        """Add what steps backward have kept to the slope, and forget it."""
        for parameter, columns, (name, pull) in zip(
            self._parameters, self._columns, self._pulls, strict=True
        ):
            if parameter.kind == "input" and parameter.pieces is None:
                slope[columns] += self._by_input
            elif name and parameter.kind != "input":
                slope[columns] += pull(self._derivatives[name][..., 0])
        for array in (*self._derivatives.values(), self._by_input):
            array[:] = 0

    # ---- changes ----

    def _record(self, columns: int) -> tuple[records.Changes, dict[str, FloatArray]]:
        """Return a record of changes in so many columns, all zero, and its arrays by name."""
        arrays = {name: np.zeros((*self._counts[name], columns)) for name in self._names}
        record = records.Changes(columns)
        record.gravity[: self._model.structure.dimension] = self._model.gravity.tolist()
        for name, array in arrays.items():
            setattr(record, name, array.ctypes.data)
        return record, arrays

    @property
    def _names(self) -> set[str]:
        """Names of the arrays of a record that are not null."""
        return {name for name, _ in self._pulls if name} | ({"input"} if self._answers else set())

    @cached_property
    def _counts(self) -> dict[str, tuple[int, ...]]:
        """Shapes of all arrays of a record, but for their columns."""
        scene, nodes = self._tables, self._model.structure.nodes
        return {
            "input": (len(self._c), scene.strings), "stiffness": (scene.strings,),
            "damping": (scene.strings,), "load": (scene.entries,), "bar_mass": (scene.bars,),
            "point_mass": (nodes.shape[1],), "ground": (scene.grounds, len(_GROUND)),
        }  # fmt: skip

    def _pull(self, parameter: Parameter) -> tuple[str, Callable[[FloatArray], FloatArray]]:
        kind = parameter.kind
        if kind in ("input", "bar_mass", "point_mass"):
            return kind, np.asarray
        if kind == "strings":
            return "damping" if parameter.field == "damping" else "stiffness", np.asarray
        if kind == "ground":
            place = parameter.law, _GROUND.index(parameter.field)
            return "ground", lambda cost: cost[place]
        if kind in ("gravity", "external_force"):
            of = load_of_gravity if kind == "gravity" else unit_load
            constant = of(self._model)
            return "load", lambda cost: cost @ constant
        return "", np.asarray

    def _unit_changes(self) -> dict[str, FloatArray]:
        """Return the changes by all parameters but inputs in time, by array."""
        counts = self._counts
        units = {name: np.zeros((*counts[name], self._width)) for name in self._names}
        for parameter, columns, (name, pull) in zip(
            self._parameters, self._columns, self._pulls, strict=True
        ):
            if not name or parameter.pieces is not None:
                continue
            shape = units[name].shape[:-1]
            size = int(np.prod(shape))
            whole = np.eye(size).reshape(size, *shape)
            if parameter.kind == "input":  # the same at all stages
                whole = np.repeat(np.eye(shape[1])[:, None], shape[0], axis=1)
                units[name][..., columns] += np.moveaxis(whole, 0, -1)
                continue
            by_entry = np.array([pull(entry) for entry in whole]).reshape(*shape, parameter.size)
            units[name][..., columns] += by_entry
        return units

    @staticmethod
    def _enter_inputs(share: FloatArray, inputs: FloatArray) -> None:
        """Enter what the values of a profile change of the inputs at the stages of a step."""
        stages, strings = inputs.shape[:2]
        values = np.zeros((stages, strings, strings, len(share)))
        every = np.arange(strings)
        values[:, every, every] = share.T[:, None]
        inputs[:] = values.reshape(stages, strings, -1)

    def _share(
        self, parameter: Parameter, first: int, count: int, part: float | None
    ) -> FloatArray:
        """Return by what the values of a profile count at the stages of steps, (K, stages)."""
        some = slice(first, first + count)
        begin, length = self._steps.begin[some], self._steps.length[some]
        if part is not None:
            length = np.array([part])
        time = (begin[:, None] + self._c * length[:, None]).ravel()
        share = shares(parameter, time, np.repeat(begin + length / 2, len(self._c)))
        assert share is not None  # it is a profile
        return share

    def _call(
        self, function: Any, first: int, count: int, part: float | None, record: records.Changes,
        array: FloatArray,
    ) -> None:  # fmt: skip
        length, *others = (begin + first * stride for begin, stride in self._rows)
        lengths = self._lengths
        if part is not None:  # after which bars are left as they are
            own, lengths = np.array([part]), None
            length = records.address(own)
        steps = records.Steps(count, length, *others)
        scene, drive, _, method = self._always
        function(
            scene, drive, lengths, method, ctypes.byref(steps), ctypes.byref(record),
            *records.pointers(array, self._work(record.columns)),
        )  # fmt: skip
