"""Propagation of small changes over steps by the compiled core, forward or backward."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.core import records
from tenscontrol.dynamics.model import Model
from tenscontrol.integrate.core_scene import CoreScene
from tenscontrol.optimize.derivatives import Switches
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
    switches : Switches
        What switched at the ends of steps.
    """

    def __init__(
        self, scene: CoreScene, model: Model, steps: TracedSteps, method: Tableau,
        parameters: Sequence[Parameter], columns: Sequence[slice], answers: bool,
        switches: Switches,
    ) -> None:  # fmt: skip
        self._core, self._tables = scene, scene.scene
        self._model, self._steps = model, steps
        self._parameters, self._columns = parameters, columns
        self._pulls = [self._pull(parameter) for parameter in parameters]
        if any(name == "damping" for name, _ in self._pulls):
            self._tables = records.Scene.from_buffer_copy(scene.scene)
            self._tables.damped = 1  # also where it is zero
        self._c = method.c
        #: Whether it puts bars on their lengths after steps, too.
        self.projects = steps.projects and not model.structure.blocks
        self._lengths = scene.lengths_at if self.projects else None
        self._works: dict[int, FloatArray] = {}
        self._width = columns[-1].stop if columns else 0
        self._padded = -(-max(self._width, 1) // records.COLUMNS) * records.COLUMNS
        self._answers = answers
        #: Whether it passes what switches: after bars are on their lengths.
        self.passes = self.projects or not steps.projects
        self._switches: records.Switches | None = None
        if self.passes and len(switches.step):
            self._of_switches = (
                np.asarray(switches.step, dtype=np.int32), switches.by_state, switches.by_input,
                switches.rate, switches.jump,
            )  # fmt: skip
            self._switches = records.Switches(
                len(switches.step), *map(records.address, self._of_switches)
            )
        #: The input among the parameters, its columns, and how many values a string has.
        self._profile = next((by for by in parameters if by.kind == "input"), None)
        strings, own = len(model.structure.strings), slice(0, 0)
        if self._profile is not None:
            own = columns[list(parameters).index(self._profile)]
        self._by_values = np.zeros((strings, (own.stop - own.start) // max(strings, 1)))
        self._record_of_profile = records.Profile(own.start, self._by_values.shape[1], 1)
        self._inputs = np.ascontiguousarray(steps.inputs.T)
        self._drive = scene.drive(self._inputs[0])
        self._tableau = records.Tableau(len(self._c), *map(records.address, method))
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
    def _forwards(self) -> tuple[records.Changes, dict[str, FloatArray]]:
        """Changes by all parameters, with their arrays."""
        changes, given = self._record(self._padded)
        if any(name for name, _ in self._pulls):
            for name, value in self._unit_changes().items():
                given[name][..., : self._width] = value
        return changes, given

    @cached_property
    def _backwards(self) -> tuple[records.Changes, dict[str, FloatArray]]:
        """Costs by all parameters, which are added up, with their arrays."""
        costs, derivatives = self._record(1)
        costs.by_values = records.address(self._by_values)
        return costs, derivatives

    def _work(self, columns: int) -> FloatArray:
        """Return work memory for so many columns."""
        if columns not in self._works:
            scene, drive, _, method = self._always
            size = self._core.core.tc_variations_work_size(scene, drive, method, columns)
            self._works[columns] = np.empty(size)
        return self._works[columns]

    @property
    def most(self) -> int:
        """How many steps a call may take at most: one where something has to be done after each."""
        if self._steps.projects and not self.projects:
            return 1
        numbers = len(self._c) * self._by_values.shape[1]
        return max(1, min(_MOST_STEPS, _MOST_NUMBERS // max(numbers, 1)))

    def forward(
        self, first: int, count: int, part: float | None, X: FloatArray, answer: FloatArray | None
    ) -> FloatArray:
        """Return the derivative of the state, (states, P), after steps, or a part of one, s."""
        whole = np.zeros((len(X), self._padded))
        whole[:, : self._width] = X
        changes, given = self._forwards
        if answer is not None:
            given["input"][:, : self._width] = answer
        self._call(self._core.core.tc_tangents, first, count, part, changes, whole)
        return whole[:, : self._width]

    def backward(
        self, first: int, count: int, part: float | None, end: FloatArray, _: FloatArray
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return a cost by the state before steps from that after them, and by answers meanwhile.

        Those by parameters are kept, and added to the slope by :meth:`take_costs`.
        """
        mu, by_input = end.copy(), None
        costs, derivatives = self._backwards
        if self._answers:
            by_input = derivatives["input"]
            by_input[:] = 0.0
        self._call(self._core.core.tc_costs, first, count, part, costs, mu)
        return mu, None if by_input is None else by_input[:, 0]

    def take_costs(self, slope: FloatArray) -> None:
        """Add what steps backward have kept to the slope, and forget it."""
        derivatives = self._backwards[1]
        for parameter, columns, (name, pull) in zip(
            self._parameters, self._columns, self._pulls, strict=True
        ):
            if parameter.kind == "input":
                slope[columns] += self._by_values.ravel()
            elif name:
                slope[columns] += pull(derivatives[name][..., 0])
        for array in (*derivatives.values(), self._by_values):
            array[:] = 0

    # ---- changes ----

    def _record(self, columns: int) -> tuple[records.Changes, dict[str, FloatArray]]:
        """Return a record of changes in so many columns, all zero, and its arrays by name."""
        arrays = {name: np.zeros((*self._counts[name], columns)) for name in self._names}
        record = records.Changes(columns)
        record.gravity[: self._model.structure.dimension] = self._model.gravity.tolist()
        for name, array in arrays.items():
            setattr(record, name, records.address(array))
        if self._profile is not None:
            record.profile = ctypes.addressof(self._record_of_profile)
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
            "input": (scene.strings,), "stiffness": (scene.strings,),
            "damping": (scene.strings,), "load": (scene.entries,), "bar_mass": (scene.bars,),
            "point_mass": (nodes.shape[1],), "ground": (scene.grounds, len(_GROUND)),
        }  # fmt: skip

    def _pull(self, parameter: Parameter) -> tuple[str, Callable[[FloatArray], FloatArray]]:
        kind = parameter.kind
        if kind in ("bar_mass", "point_mass"):
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
        """Return the changes by all parameters but the input, by array."""
        counts = self._counts
        names = {name for name, _ in self._pulls if name}
        units = {name: np.zeros((*counts[name], self._width)) for name in names}
        for parameter, columns, (name, pull) in zip(
            self._parameters, self._columns, self._pulls, strict=True
        ):
            if not name:
                continue
            shape = units[name].shape[:-1]
            size = int(np.prod(shape))
            whole = np.eye(size).reshape(size, *shape)
            by_entry = np.array([pull(entry) for entry in whole]).reshape(*shape, parameter.size)
            units[name][..., columns] += by_entry
        return units

    def _shares(self, first: int, count: int, length: FloatArray) -> FloatArray | None:
        """Return by what values of a profile count in steps, (count, rows, K).

        One row a stage, or one a step in which nothing changes.
        """
        if self._profile is None or self._profile.pieces is None:
            return None
        begin = self._steps.begin[first : first + count]
        c = self._c if self._profile.pieces.degree else self._c[:1]
        time = (begin[:, None] + c * length[:, None]).ravel()
        share = shares(self._profile, time, np.repeat(begin + length / 2, len(c)))
        assert share is not None  # it is a profile
        return np.ascontiguousarray(share.T).reshape(count, len(c), -1)

    def _call(
        self, function: Any, first: int, count: int, part: float | None, record: records.Changes,
        array: FloatArray,
    ) -> None:  # fmt: skip
        at, *others = (begin + first * stride for begin, stride in self._rows)
        length, lengths = self._length[first : first + count], self._lengths
        switches = None if self._switches is None else ctypes.byref(self._switches)
        if part is not None:  # after which bars are left as they are
            length, lengths, switches = np.array([part]), None, None
            at = records.address(length)
        share = self._shares(first, count, length)
        if share is not None:
            self._record_of_profile.rows = share.shape[1]
            self._record_of_profile.share = records.address(share)
        steps = records.Steps(count, at, *others, first)
        scene, drive, _, method = self._always
        function(
            scene, drive, lengths, method, ctypes.byref(steps), switches, ctypes.byref(record),
            *records.pointers(array, self._work(record.columns)),
        )  # fmt: skip
