"""The controller side of a simulation: samples, commands, actuators and their record."""

from __future__ import annotations

from math import ceil
from time import perf_counter

import numpy as np

from tenscontrol.actuation import Winches, WinchMove
from tenscontrol.control import Command, Controller
from tenscontrol.dynamics import unpack_states
from tenscontrol.estimation import KalmanFilter, Sensors
from tenscontrol.interrupt import check
from tenscontrol.limits import refuse_memory
from tenscontrol.simulation.loop import Loop
from tenscontrol.simulation.observation import Observation
from tenscontrol.simulation.trajectory import ControlRecord, Trajectory
from tenscontrol.structure import same_members, to_segments, to_strings
from tenscontrol.validation import (
    LARGEST,
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

_NONE = frozen(np.zeros(0, dtype=np.int64))

# A command so close to a bound, relative to the largest, is at it.
_CLOSE = 1e-7


def run_closed_loop(
    loop: Loop,
    state: FloatArray,
    duration: float,
    controller: Controller,
    rest_length: object,
    winches: Winches | None,
    sample_time: float | None,
    estimation: tuple[KalmanFilter, Sensors | None, int | None] | None,
    start: Trajectory | None,
) -> None:
    """Run the plant under a controller, sample by sample.

    ``estimation`` is the estimator, the sensors and the seed; ``start`` the run to go on from.
    """
    sample = _sample_time(controller, sample_time, loop.step)
    kept = 1500 + 48 * len(controller.plant.commanded.strings)  # bytes of objects and numbers
    refuse_memory(f"sample_time is {sample:g} s", duration / sample, "samples", kept)
    # In samples; whole, so that the same numbers are multiplied as in a run of one part.
    begin = round(loop.now / sample)
    if abs(loop.now / sample - begin) > 1e-9:
        begin = loop.now / sample  # type: ignore[assignment]
    actuators = Actuators(loop, controller, winches, rest_length, sample, start)
    if start is None:
        controller.reset()
    # A controller that goes on knows its previous input, unless there is none or it did not come.
    knows = start is not None and start.stopped is None and rest_length is None
    if actuators.start is not None and not (knows and controller.status_count):
        N = unpack_states(loop.model.structure, state[:, None])[0][:, :, 0]
        controller.applied(actuators.applied_input(N))
    observation = None
    if estimation is not None:
        substeps = 1 if winches is None else winches.substeps
        observation = Observation(
            *estimation, loop.model, loop.input, controller, sample, actuators.start, substeps,
            start is not None,
        )  # fmt: skip
        if start is not None:
            earlier = None if start.control is None else start.control.estimate
            observation.go_on(earlier, start.held, round(begin))
    rows: list[tuple[float, Command, WinchMove, float, float | None, FloatArray]] = []

    def record() -> ControlRecord:
        stood = None
        if loop.input == "rest_length":
            stood = rows[0][2].rest_length if actuators.start is None else actuators.start
        end = unpack_states(loop.model.structure, state[:, None])[0][:, :seen, 0]
        return _control_record(rows, stood, sample, observation, controller, loop.now, end)

    seen = controller.plant.coordinates.nodes.shape[
        1
    ]  # of a subdivision, the nodes of its parent come first
    loop.record = record
    # The allowance keeps round-off from adding a last sample of no length.
    until = loop.now + duration
    for k in range(max(1, ceil(duration / sample - 1e-9))):
        loop.now = (begin + k) * sample
        if np.abs(state).max() > LARGEST:
            raise loop.stopped(f"the motion has run away, beyond {LARGEST:g} in m and m/s")
        N, V = (part[:, :, 0] for part in unpack_states(loop.model.structure, state[:, None]))
        moment = loop.now + 1e-9 * sample  # a fault that begins at the sample is there
        lost = loop.faults.lost(moment)
        if observation is None:
            motion = tuple((np.nan if lost else 1.0) * each[:, :seen] for each in (N, V))
        else:
            estimate = observation.estimate(N, V, lost)
            motion = estimate.nodes, estimate.velocities
        began = perf_counter()
        command = controller.command(loop.now, *motion)
        taken = perf_counter() - began
        check()  # a command that was interrupted is not applied
        move, inputs = actuators.apply(command, N, loop.faults.stuck(moment))
        controller.applied(actuators.applied_input(N))
        if observation is not None:
            observation.predict(move.rest_length, inputs[-1])
        rows.append((loop.now, command, move, taken, controller.prediction_error, N[:, :seen]))
        end = min(loop.now + sample, until)
        whole = end - loop.now
        for i, held in enumerate(inputs):
            span = min(loop.now + sample / len(inputs), end) if i + 1 < len(inputs) else end
            span -= loop.now
            if span > 1e-9 * whole:  # not round-off
                state = loop.run(state, held, span)


def _control_record(
    rows: list[tuple[float, Command, WinchMove, float, float | None, FloatArray]],
    rest_length: FloatArray | None,
    sample_time: float,
    observation: Observation | None,
    controller: Controller,
    until: float,
    end: FloatArray,
) -> ControlRecord:
    """Return the record of samples.

    Of each: start, command, move of the winches, computing time, prediction error and nodes.
    ``rest_length`` are those before the first sample, shape (α,); None where γ is held. The run
    ends at a time with these nodes.
    """
    times, commands, moves, taken, unforeseen, shapes = zip(*rows, strict=True)
    time, applied = frozen(np.array(times)), np.column_stack([move.rest_length for move in moves])
    rate = np.zeros_like(applied)
    if rest_length is not None:
        rate = np.diff(applied, axis=1, prepend=rest_length[:, None]) / sample_time
    command = np.column_stack([command.value for command in commands])
    predicts = any(each is not None for each in unforeseen)
    return ControlRecord(
        time=time,
        command=frozen(command),
        applied=frozen(applied),
        status=tuple(command.status for command in commands),
        fallback=tuple(command.fallback for command in commands),
        detail=tuple(command.detail for command in commands),
        winch_rate=frozen(rate),
        rate_limited=frozen(np.array([len(move.rate_limited) for move in moves])),
        range_limited=frozen(np.array([len(move.range_limited) for move in moves])),
        computing_time=frozen(np.array(taken)),
        estimate=None if observation is None else observation.record(time),
        prediction_error=frozen(np.array(unforeseen, dtype=float)) if predicts else None,
        tracking_error=_tracking_error(controller, np.r_[time, until], [*shapes, end]),
        at_bound=_at_bound(controller, command),
        controller=repr(controller),
        sample_time=sample_time,
        size=float(np.ptp(controller.plant.nodes, axis=1).max()),
        slowest_vibration=controller.plant.slowest_vibration,
    )


def _tracking_error(
    controller: Controller, times: FloatArray, shapes: list[FloatArray]
) -> FloatArray | None:
    """Return the distance of the node that is farthest off the reference at each time, m."""
    wanted = controller.reference_nodes(times)
    if wanted is None:
        return None
    lay, still = controller.plant.coordinates.laid_over, np.zeros_like(shapes[0])
    off = np.stack([lay(N, still)[0] for N in shapes], axis=-1) - wanted
    return frozen(np.linalg.norm(off, axis=0).max(axis=0))


def _at_bound(controller: Controller, command: FloatArray) -> IntArray:
    """Return how many strings of each command, shape (α, K), are at a bound, shape (K,)."""
    low, high = (bound[:, None] for bound in controller.bounds)
    close = _CLOSE * np.abs(command).max()
    at = (command <= low + close) | (command >= high - close)
    if controller.largest_change is not None:
        change = np.abs(np.diff(command, axis=1, prepend=command[:, :1]))
        at |= change >= controller.largest_change[:, None] - close
    return frozen(at.sum(axis=0))


def _sample_time(controller: Controller, sample_time: float | None, step: float | None) -> float:
    if controller.sample_time is not None:
        if sample_time is not None:
            raise ValueError(
                f"the controller has a sample time of its own, {controller.sample_time:g} s; "
                "leave sample_time out"
            )
        return controller.sample_time
    if sample_time is not None:
        return positive_number("sample_time", sample_time, "s")
    if step is None:
        raise ValueError(
            "the controller acts in continuous time: give sample_time, or a step to sample at"
        )
    return step


class Actuators:
    """Apply commands: γ as it is, or rest lengths through the winches.

    A controller commands the strings of the plant, or those of its parent, whose segments then
    move together. ``start`` are the rest lengths at the start, m, shape (α,), if they are known.
    """

    def __init__(
        self,
        loop: Loop,
        controller: Controller,
        winches: Winches | None,
        rest_length: object,
        sample_time: float,
        run: Trajectory | None,
    ) -> None:
        self._structure = loop.model.structure
        self._by_segment = _commands_parent(loop, controller)
        self._count = len(controller.plant.commanded.strings)
        if winches is not None:
            instance("winches", winches, Winches, "make them by Winches(rate=...)")
        self._held = loop.input
        self._convert = loop.input == "rest_length" and controller.input == "force_density"
        if controller.input == "rest_length" and loop.input == "force_density":
            raise ValueError(
                "the controller commands rest lengths; input='force_density' cannot follow it"
            )
        if loop.input == "force_density" and (winches is not None or rest_length is not None):
            raise ValueError("winches and rest_length have no meaning where γ is held")
        self._input = controller.input
        self._law = loop.model.strings
        self._winches = winches
        self._sample_time = sample_time
        self.start: FloatArray | None = None
        self._current: FloatArray | None = None
        if run is not None and rest_length is None:
            kind = "force_density" if run.rest_length is None else "rest_length"
            last = run.held if kind == loop.input else None
            if last is not None and run.control is not None:
                last = run.control.applied[:, -1]
            elif last is not None:
                last = self._to_strings(loop.input, last)
            if loop.input == "rest_length":
                rest_length = last
            else:
                self._current = last
        if rest_length is not None:
            lengths = per_member(
                "rest_length", rest_length, self._count, "string of the controller"
            )
            self.start = positive("rest_length", lengths, "length in m")
            if winches is not None:
                winches.refuse_out_of_range("rest_length", self.start)
        elif winches is not None and (winches.rate is not None or winches.substeps > 1):
            raise ValueError(
                "winches with a rate or substeps need rest_length: where they stand at the start, "
                "m; to_rest_length(model, nodes, force_density) finds it"
            )
        if self.start is not None:
            self._current = self.start
        if self._convert:
            self._refuse_unreachable(controller.bounds[1])

    def applied_input(self, nodes: FloatArray) -> FloatArray:
        """Return what the actuators hold in a shape, in the unit of the commands."""
        assert self._current is not None  # callers have commanded, or know the start
        if not self._convert:
            return self._current
        assert self._law is not None  # a rest length is held
        rest_length = self._to_plant("rest_length", self._current)
        gamma = self._law.force_density(self._structure.string_length(nodes), rest_length)
        return self._to_strings("force_density", gamma)

    def apply(
        self, command: Command, nodes: FloatArray, stuck: IntArray
    ) -> tuple[WinchMove, list[FloatArray]]:
        """Return the move, one entry a winch, and the input of each substep, one entry a string.

        The substeps share the sample evenly.
        """
        desired = self._checked(command.value)
        if self._held == "force_density":
            self._current = self._unless_stuck(desired, stuck)
            gamma = self._to_plant("force_density", self._current)
            return WinchMove(frozen(self._current), _NONE, _NONE), [gamma]
        if self._convert:
            assert self._law is not None  # a rest length is held
            gamma = self._to_plant("force_density", desired)
            desired = self._law.rest_length(self._structure.string_length(nodes), gamma)
            desired = self._to_strings("rest_length", desired)
        desired = self._unless_stuck(desired, stuck)
        start = desired if self._current is None else self._current
        move, substeps = WinchMove(frozen(desired), _NONE, _NONE), 1
        if self._winches is not None:
            move = self._winches.move(start, desired, self._sample_time)
            substeps = self._winches.substeps
        self._current = move.rest_length
        left = np.arange(substeps - 1.0, -1.0, -1.0)[:, None] / substeps
        reached = move.rest_length - left * (move.rest_length - start)
        return move, list(self._to_plant("rest_length", reached))

    def _checked(self, value: object) -> FloatArray:
        """Return a command, or raise: a user's controller may break its promises."""
        desired = shaped("command.value", value, (self._count,), "one per string")
        if self._input == "force_density":
            return non_negative("command.value", desired, "a string can only pull")
        return positive("command.value", desired, "rest length in m")

    def _to_plant(self, what: str, values: FloatArray) -> FloatArray:
        """Return values of the plant's strings from those of the commanded ones."""
        return to_segments(self._structure, what, values) if self._by_segment else values

    def _to_strings(self, what: str, values: FloatArray) -> FloatArray:
        """Return values of the commanded strings from those of the plant's."""
        return to_strings(self._structure, what, values) if self._by_segment else values

    def _unless_stuck(self, desired: FloatArray, stuck: IntArray) -> FloatArray:
        """Return the desired input, but the current one of stuck actuators."""
        if not len(stuck):
            return desired
        if self._current is None:
            how = "give rest_length, or" if self._held == "rest_length" else "give"
            raise ValueError(
                f"faults has winch {stuck[0]} stuck from the start, but it is not known where it "
                f"stands: {how} a time after the first sample"
            )
        moved = desired.copy()
        moved[stuck] = self._current[stuck]
        return moved

    def _refuse_unreachable(self, most: FloatArray) -> None:
        """Refuse a controller that may command a γ, at most ``most``, beyond any rest length."""
        assert self._law is not None  # a rest length is held
        largest, limit = self._to_plant("force_density", most), self._law.largest_force_density
        segments = self._to_plant("force_density", np.ones(self._count))
        over = np.flatnonzero(largest >= limit)
        if len(over):
            i = over[0]
            raise ValueError(
                f"the controller may command γ = {largest[i]:g} N/m on string {i}, but a string of "
                f"stiffness {limit[i]:g} N/m stays below that whatever its rest length. Give the "
                f"controller max_force_density below {limit[i] / segments[i]:g}"
            )


def _commands_parent(loop: Loop, controller: Controller) -> bool:
    """Return whether a controller commands the strings of the plant's parent, or refuse it."""
    structure, designed = loop.model.structure, controller.plant.commanded
    seen, parent = controller.plant.model.structure, structure.parent
    by_segment = not same_members(designed, structure)
    fits = same_members(seen, structure)
    if by_segment:
        fits = parent is not None and same_members(designed, parent) and (fits or seen is designed)
    if not fits:
        raise ValueError(
            f"the controller was designed on {seen!r}, but the model has {structure!r} "
            "with other bars, strings or fixed nodes, and is no direct subdivision of it"
        )
    return by_segment
