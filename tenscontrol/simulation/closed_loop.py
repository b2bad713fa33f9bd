"""The controller side of a simulation: samples, commands, actuators and their record."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from time import perf_counter

import numpy as np

from tenscontrol.actuation import Winches, WinchMove
from tenscontrol.control.controller import Command, Controller
from tenscontrol.dynamics import Model, StringLaw, unpack_states
from tenscontrol.simulation.loop import Loop
from tenscontrol.simulation.observation import Observation
from tenscontrol.simulation.trajectory import ControlRecord, Trajectory
from tenscontrol.structure import (
    same_members,
    spread_force_density,
    spread_rest_length,
)
from tenscontrol.validation import (
    FloatArray,
    IntArray,
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
    estimation: tuple[object, object, object] | None = None,
) -> Trajectory:
    """Run a controller against the plant, sample by sample, and return what came of it."""
    sample = _sample_time(controller, sample_time, loop.step)
    actuators = _Actuators(loop, controller, winches, rest_length, sample)
    controller.reset()
    if actuators.start is not None:
        N = unpack_states(loop.model.structure, state[:, None])[0][:, :, 0]
        controller.applied(actuators.acting(N))
    eyes = None
    if estimation is not None:
        pieces = 1 if winches is None else winches.pieces
        eyes = Observation(
            *estimation, loop.model, loop.hold, controller, sample, actuators.start, pieces
        )
    log = _Log(loop.hold, actuators.start, eyes)
    seen = controller.plant.nodes.shape[1]  # of a subdivision, the nodes of its parent come first
    # The allowance keeps round-off from adding a last sample of no length.
    for k in range(max(1, ceil(duration / sample - 1e-9))):
        loop.now = k * sample
        N, V = (part[:, :, 0] for part in unpack_states(loop.model.structure, state[:, None]))
        moment = loop.now + 1e-9 * sample  # a fault that begins at the sample is there
        lost = loop.faults.lost(moment)
        if eyes is None:
            told = tuple((np.nan if lost else 1.0) * each[:, :seen] for each in (N, V))
        else:
            estimate = eyes.look(N, V, lost)
            told = estimate.nodes, estimate.velocities
        began = perf_counter()
        command = controller.command(loop.now, *told)
        taken = perf_counter() - began
        move, parts = actuators.apply(command, N, loop.faults.stuck(moment))
        controller.applied(actuators.acting(N))
        if eyes is not None:
            eyes.hold(move.rest_length, parts[-1])
        log.add(loop.now, command, move, taken)
        end = min(loop.now + sample, duration)
        whole = end - loop.now
        for i, held in enumerate(parts):
            span = min(loop.now + sample / len(parts), end) if i + 1 < len(parts) else end
            span -= loop.now
            if span > 1e-9 * whole:  # not round-off
                state = loop.run(state, held, span, report, lambda: log.record(sample))
    return loop.trajectory(log.record(sample))


_NONE = frozen(np.zeros(0, dtype=np.int64))


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
        self._wiring = _Wiring(controller, loop.model)
        if winches is not None:
            instance("winches", winches, Winches, "make them by Winches(rate=...)")
        self._hold = loop.hold
        self._convert = loop.hold == "rest_length" and controller.input == "force_density"
        if controller.input == "rest_length" and loop.hold == "force_density":
            raise ValueError(
                "the controller commands rest lengths; hold='force_density' cannot follow it"
            )
        if loop.hold == "force_density" and (winches is not None or rest_length is not None):
            raise ValueError("winches and rest_length have no meaning where γ is held")
        self._input = controller.input
        self._law = loop.model.strings
        self._winches = winches
        self._sample = sample
        self.start: FloatArray | None = None
        if rest_length is not None:
            self.start = self._wiring.checked_rest_length(rest_length)
            if winches is not None:
                winches.refuse_out_of_range("rest_length", self.start)
        elif winches is not None and (winches.rate is not None or winches.pieces > 1):
            raise ValueError(
                "winches with a rate or pieces need rest_length: where they stand at the start, m; "
                "to_rest_length(model, nodes, force_density) finds it"
            )
        self._current = self.start
        if self._convert:
            _refuse_unreachable(controller, loop.model, self._wiring)

    def _checked(self, value: object) -> FloatArray:
        """Return a command, or raise: a controller from elsewhere may promise what it does not."""
        wanted = shaped("command.value", value, (self._wiring.count,), "one per string")
        if self._input == "force_density":
            return non_negative("command.value", wanted, "a string can only pull")
        return positive("command.value", wanted, "rest length in m")

    def acting(self, nodes: FloatArray) -> FloatArray:
        """Return what the actuators hold, in the unit of the commands, in a shape."""
        assert self._current is not None  # callers have commanded, or know the start
        if not self._convert:
            return self._current
        assert isinstance(self._law, StringLaw)  # a rest length is held
        return self._wiring.gather_force_density(
            self._law.force_density(
                self._wiring.structure.string_length(nodes),
                self._wiring.spread_rest_length(self._current),
            )
        )

    def apply(
        self, command: Command, nodes: FloatArray, stuck: IntArray
    ) -> tuple[WinchMove, list[FloatArray]]:
        """Return what the actuators did, one entry a winch, and what is held, one a string.

        What is held comes part by part: they share the sample evenly.
        """
        wanted = self._checked(command.value)
        if self._hold == "force_density":
            wanted = self._moved(wanted, stuck)
            self._current = wanted
            gamma = self._wiring.spread_force_density(wanted)
            return WinchMove(frozen(wanted), _NONE, _NONE), [gamma]
        if self._convert:
            assert isinstance(self._law, StringLaw)  # a rest length is held
            gamma = self._wiring.spread_force_density(wanted)
            wanted = self._wiring.gather(
                self._law.rest_length(self._wiring.structure.string_length(nodes), gamma)
            )
        wanted = self._moved(wanted, stuck)
        start = wanted if self._current is None else self._current
        move, pieces = WinchMove(frozen(wanted), _NONE, _NONE), 1
        if self._winches is not None:
            move = self._winches.move(start, wanted, self._sample)
            pieces = self._winches.pieces
        self._current = move.rest_length
        left = np.arange(pieces - 1.0, -1.0, -1.0)[:, None] / pieces
        reached = move.rest_length - left * (move.rest_length - start)
        return move, [self._wiring.spread_rest_length(each) for each in reached]

    def _moved(self, wanted: FloatArray, stuck: IntArray) -> FloatArray:
        """Return what is wanted, but what stands where an actuator is stuck."""
        if not len(stuck):
            return wanted
        if self._current is None:
            how = "give rest_length, or" if self._hold == "rest_length" else "give"
            raise ValueError(
                f"faults has winch {stuck[0]} stuck from the start, but it is not known where it "
                f"stands: {how} a time after the first sample"
            )
        moved = wanted.copy()
        moved[stuck] = self._current[stuck]
        return moved


class _Wiring:
    """Which strings of the plant a controller commands: its own, or the segments of each."""

    def __init__(self, controller: Controller, model: Model) -> None:
        structure, designed = model.structure, controller.plant.commanded
        seen = controller.plant.model.structure
        self.structure = structure
        self.count = len(designed.strings)
        self._cut = not same_members(designed, structure)
        parent = structure.parent
        fits = same_members(seen, structure)
        if self._cut:
            whole = parent is not None and structure.string_parent is not None
            fits = whole and same_members(designed, parent) and (fits or seen is designed)
        if not fits:
            raise ValueError(
                f"the controller was designed on {seen!r}, but the model has {structure!r} "
                "with other bars, strings or fixed nodes, and is no direct subdivision of it"
            )

    def checked_rest_length(self, rest_length: object) -> FloatArray:
        """Return where the winches stand, one a string of the controller."""
        values = per_member("rest_length", rest_length, self.count, "string of the controller")
        return positive("rest_length", values, "length in m")

    def gather(self, values: FloatArray) -> FloatArray:
        """Return the sum over the segments of each commanded string."""
        if not self._cut:
            return values
        total = np.zeros(self.count)
        assert self.structure.string_parent is not None  # a subdivision
        np.add.at(total, self.structure.string_parent, values)
        return total

    def gather_force_density(self, gamma: FloatArray) -> FloatArray:
        """Return γ of each commanded string, the mean over its segments."""
        if not self._cut:
            return gamma
        segments = self.gather(np.ones_like(gamma))
        return self.gather(gamma) / segments**2

    def spread_force_density(self, gamma: FloatArray) -> FloatArray:
        """Return γ of each string of the plant."""
        return spread_force_density(self.structure, gamma) if self._cut else gamma

    def spread_rest_length(self, rest_length: FloatArray) -> FloatArray:
        """Return the rest length of each string of the plant."""
        return spread_rest_length(self.structure, rest_length) if self._cut else rest_length


class _Log:
    """Collects what becomes the control record."""

    def __init__(self, hold: str, start: FloatArray | None, eyes: Observation | None) -> None:
        self._hold = hold
        self._eyes = eyes
        self._start = start
        self._rows: list[tuple[float, Command, WinchMove, float]] = []

    def add(self, time: float, command: Command, move: WinchMove, taken: float) -> None:
        self._rows.append((time, command, move, taken))

    def record(self, sample: float) -> ControlRecord:
        times, commands, moves, taken = zip(*self._rows, strict=True)
        applied = np.column_stack([move.rest_length for move in moves])
        rate = np.zeros_like(applied)
        if self._hold == "rest_length":
            before = applied[:, :1] if self._start is None else self._start[:, None]
            rate = np.diff(applied, axis=1, prepend=before) / sample
        return ControlRecord(
            time=frozen(np.array(times)),
            command=frozen(np.column_stack([command.value for command in commands])),
            applied=frozen(applied),
            status=tuple(command.status for command in commands),
            winch_rate=frozen(rate),
            rate_limited=frozen(np.array([len(move.rate_limited) for move in moves])),
            range_limited=frozen(np.array([len(move.range_limited) for move in moves])),
            computing_time=frozen(np.array(taken)),
            estimate=None if self._eyes is None else self._eyes.record(np.array(times)),
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


def _refuse_unreachable(controller: Controller, model: Model, wiring: _Wiring) -> None:
    """Refuse a controller that may command a γ which no rest length gives."""
    law = model.strings
    assert law is not None  # a rest length is held
    largest, limit = wiring.spread_force_density(controller.bounds[1]), law.largest_force_density
    segments = wiring.spread_force_density(np.ones(wiring.count))
    over = np.flatnonzero(largest >= limit)
    if len(over):
        i = over[0]
        raise ValueError(
            f"the controller may command γ = {largest[i]:g} N/m on string {i}, but a string of "
            f"stiffness {limit[i]:g} N/m stays below that whatever its rest length. Give the "
            f"controller max_force_density below {limit[i] / segments[i]:g}"
        )
