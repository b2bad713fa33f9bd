"""The controller side of a simulation: samples, commands, actuators and their record."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from time import perf_counter

import numpy as np

from tenscontrol.actuation import Winches, WinchMove
from tenscontrol.control.controller import Command, Controller
from tenscontrol.dynamics import Model, StringLaw
from tenscontrol.simulation.loop import Loop
from tenscontrol.simulation.trajectory import ControlRecord, Trajectory
from tenscontrol.validation import (
    FloatArray,
    frozen,
    instance,
    non_negative,
    per_member,
    positive,
    positive_number,
    shaped,
)


def run_closed_loop(
    loop: Loop,
    state: FloatArray,
    duration: float,
    controller: Controller,
    rest_length: object,
    winches: Winches | None,
    sample_time: float | None,
    report: Callable[[float], None],
) -> Trajectory:
    """Run a controller against the plant, sample by sample, and return what came of it."""
    sample = _sample_time(controller, sample_time, loop.step)
    actuators = _Actuators(loop, controller, winches, rest_length, sample)
    controller.reset()
    log = _Log(loop.hold)
    n = loop.model.structure.nodes.shape[1]
    # The allowance keeps round-off from adding a last sample of no length.
    for k in range(ceil(duration / sample - 1e-9)):
        loop.now = k * sample
        N, V = (part.reshape(3, n, order="F") for part in np.split(state.copy(), 2))
        began = perf_counter()
        command = controller.command(loop.now, N, V)
        taken = perf_counter() - began
        move = actuators.apply(command, N)
        log.add(loop.now, command, move, taken)
        span = min(sample, duration - loop.now)
        state = loop.run(state, move.rest_length, span, report, lambda: log.record(sample))
    return loop.trajectory(log.record(sample))


class _Actuators:
    """Turn commands into what is held: γ as it is, or rest lengths through the winches."""

    def __init__(
        self,
        loop: Loop,
        controller: Controller,
        winches: Winches | None,
        rest_length: object,
        sample: float,
    ) -> None:
        structure = loop.model.structure
        if len(controller.plant.model.structure.strings) != len(structure.strings):
            raise ValueError(
                f"the controller commands {len(controller.plant.model.structure.strings)} strings, "
                f"but the model has {len(structure.strings)}"
            )
        if winches is not None:
            instance("winches", winches, Winches, "make them by Winches(rate=...)")
        self._convert = loop.hold == "rest_length" and controller.input == "force_density"
        if controller.input == "rest_length" and loop.hold == "force_density":
            raise ValueError(
                "the controller commands rest lengths; hold='force_density' cannot follow it"
            )
        if loop.hold == "force_density" and (winches is not None or rest_length is not None):
            raise ValueError("winches and rest_length have no meaning where γ is held")
        self._structure = structure
        self._input = controller.input
        self._law = loop.model.strings
        self._winches = winches
        self._sample = sample
        self._current: FloatArray | None = None
        if rest_length is not None:
            self._current = checked_rest_length(loop.model, rest_length)
        elif winches is not None and winches.rate is not None:
            raise ValueError(
                "winches with a rate need rest_length: where they stand at the start, m; "
                "to_rest_length(model, nodes, force_density) finds it"
            )
        if self._convert:
            _refuse_unreachable(controller, loop.model)

    def _checked(self, value: object) -> FloatArray:
        """Return a command, or raise: a controller from elsewhere may promise what it does not."""
        count = len(self._structure.strings)
        wanted = shaped("command.value", value, (count,), "one per string")
        if self._input == "force_density":
            return non_negative("command.value", wanted, "a string can only pull")
        return positive("command.value", wanted, "rest length in m")

    def apply(self, command: Command, nodes: FloatArray) -> WinchMove:
        wanted = self._checked(command.value)
        if self._convert:
            length = np.linalg.norm(self._structure.string_vectors(nodes), axis=0)
            assert isinstance(self._law, StringLaw)  # a rest length is held
            wanted = self._law.rest_length(length, wanted)
        if self._winches is None:
            none = np.zeros(0, dtype=np.int64)
            move = WinchMove(frozen(wanted), none, none)
        else:
            start = wanted if self._current is None else self._current
            move = self._winches.move(start, wanted, self._sample)
        self._current = move.rest_length
        return move


class _Log:
    """Collects what becomes the control record."""

    def __init__(self, hold: str) -> None:
        self._hold = hold
        self._rows: list[tuple[float, Command, WinchMove, float]] = []

    def add(self, time: float, command: Command, move: WinchMove, taken: float) -> None:
        self._rows.append((time, command, move, taken))

    def record(self, sample: float) -> ControlRecord:
        times, commands, moves, taken = zip(*self._rows, strict=True)
        applied = np.column_stack([move.rest_length for move in moves])
        rate = np.zeros_like(applied)
        if self._hold == "rest_length":
            rate[:, 1:] = np.diff(applied, axis=1) / sample
        return ControlRecord(
            time=frozen(np.array(times)),
            command=frozen(np.column_stack([command.value for command in commands])),
            applied=frozen(applied),
            status=tuple(command.status for command in commands),
            winch_rate=frozen(rate),
            rate_limited=frozen(np.array([len(move.rate_limited) for move in moves])),
            range_limited=frozen(np.array([len(move.range_limited) for move in moves])),
            computing_time=frozen(np.array(taken)),
        )


def checked_rest_length(model: Model, rest_length: object) -> FloatArray:
    """Return rest lengths given by the user, one a string, or raise naming the argument."""
    values = per_member("rest_length", rest_length, len(model.structure.strings), "string")
    return positive("rest_length", values, "length in m")


def _sample_time(controller: Controller, sample_time: float | None, step: float | None) -> float:
    if controller.step is not None:
        if sample_time is not None:
            raise ValueError(
                f"the controller has a sample time of its own, {controller.step:g} s; "
                "leave sample_time out"
            )
        return controller.step
    if sample_time is not None:
        return positive_number("sample_time", sample_time, "s")
    if step is None:
        raise ValueError(
            "the controller acts in continuous time: give sample_time, or a step to sample at"
        )
    return step


def _refuse_unreachable(controller: Controller, model: Model) -> None:
    """Refuse a controller that may command a γ which no rest length gives."""
    law = model.strings
    assert law is not None  # a rest length is held
    largest, limit = controller.bounds[1], law.largest_force_density
    over = np.flatnonzero(largest >= limit)
    if len(over):
        i = over[0]
        raise ValueError(
            f"the controller may command γ = {largest[i]:g} N/m on string {i}, but a string of "
            f"stiffness {limit[i]:g} N/m stays below that whatever its rest length. Give the "
            f"controller max_force_density below {limit[i]:g}"
        )
