"""The controller side of a simulation: samples, commands and their record."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil
from time import perf_counter

import numpy as np

from tenscontrol.actuation import MotorRecord, Winches, WinchMove
from tenscontrol.control import (
    BaseController,
    Command,
    Controller,
    FeedbackLinearizationStatistics,
    MPCStatistics,
    NMPCStatistics,
)
from tenscontrol.estimation import KalmanFilter, Sensors
from tenscontrol.interrupt import check
from tenscontrol.simulation.actuators import Actuators
from tenscontrol.simulation.health import ControlRecord, Given
from tenscontrol.simulation.loop import Loop
from tenscontrol.simulation.observation import Observation
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.validation import (
    LARGEST,
    FloatArray,
    IntArray,
    frozen,
    positive_number,
    refuse_memory,
)

_STATISTICS = MPCStatistics, NMPCStatistics, FeedbackLinearizationStatistics

# A command so close to a bound, relative to the largest, is at it.
_CLOSE = 1e-7


def run_closed_loop(
    loop: Loop,
    state: FloatArray,
    duration: float,
    controller: BaseController,
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
    kept = 1500 + 48 * len(controller.commanded.strings)  # bytes of objects and numbers
    refuse_memory(f"sample_time is {sample:g} s", duration / sample, "samples", kept)
    actuators = Actuators(loop, controller, winches, rest_length, sample, start)
    if start is None:
        controller.reset()
    # A controller that goes on knows its previous input, unless there is none or it did not come.
    knows = start is not None and start.stopped is None and rest_length is None
    if actuators.known and not (knows and controller.status_count):
        N, _ = loop.motion(state)
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
            observation.go_on(earlier, start.held, round(loop.now / sample))
    rows: list[tuple[float, Command, WinchMove, float, float | None, FloatArray]] = []

    def record() -> ControlRecord:
        stood = None
        if loop.input == "rest_length":
            stood = rows[0][2].rest_length if actuators.start is None else actuators.start
        end, _ = loop.motion(state)
        return _control_record(
            rows, stood, sample, observation, actuators.motor_record(), controller, loop.now,
            end[:, :seen],
        )  # fmt: skip

    # Of a subdivision, the nodes of its parent come first.
    seen = controller.structure.nodes.shape[1]
    loop.record = record
    for number, begin, end in samples(sample, duration, loop.now):
        loop.now = begin
        if np.abs(state).max() > LARGEST:
            raise loop.stopped(f"the motion has run away, beyond {LARGEST:g} in m and m/s")
        N, V = loop.motion(state)
        moment = loop.now + 1e-9 * sample  # a fault that begins at the sample is there
        lost = loop.faults.lost(moment)
        if observation is None:
            motion = tuple((np.nan if lost else 1.0) * each[:, :seen] for each in (N, V))
        else:
            estimate = observation.estimate(N, V, lost)
            motion = estimate.nodes, estimate.velocities
        began = perf_counter()
        try:
            command = controller.command(loop.now, *motion)
        except Exception as error:
            said = f"the controller {controller.label} raised {type(error).__name__}: {error}"
            if loop.spans and not isinstance(error, MemoryError):
                raise loop.stopped(said) from error
            error.add_note(f"{said}, at {loop.now:.6g} s")  # there is no motion, or no room for it
            raise
        taken = perf_counter() - began
        check()  # a command that was interrupted is not applied
        move = actuators.begin(command, N, loop.faults.stuck(moment))
        rows.append((loop.now, command, move, taken, controller.prediction_error, N[:, :seen]))
        whole = end - begin
        try:
            for i in range(1, actuators.ticks + 1):
                held = actuators.tick(i, state, loop.now)
                until_tick = (number + i / actuators.ticks) * sample
                span = (end if i == actuators.ticks else min(until_tick, end)) - loop.now
                if span > 1e-9 * whole:  # not round-off
                    state = loop.run(state, held, span)
        finally:
            rows[-1] = (*rows[-1][:2], actuators.end(), *rows[-1][3:])
            controller.applied(actuators.applied_input(N))
            if observation is not None:
                observation.predict(actuators.reached, actuators.held)


def samples(
    sample: float, duration: float, now: float = 0.0
) -> Iterator[tuple[float, float, float]]:
    """Yield number, start and end of each sample, s, of a run that goes on for a duration."""
    # Whole, so that the same numbers are multiplied as in a run of one part.
    first: float = round(now / sample)
    if abs(now / sample - first) > 1e-9:
        first = now / sample
    # The allowance keeps round-off from adding a last sample of no length, and from making one that
    # is whole longer or shorter than it is in a run that goes on.
    for k in range(max(1, ceil(duration / sample - 1e-9))):
        start = (first + k) * sample
        cut = now + duration - start < (1 - 1e-9) * sample
        yield first + k, start, now + duration if cut else start + sample


def _control_record(
    rows: list[tuple[float, Command, WinchMove, float, float | None, FloatArray]],
    rest_length: FloatArray | None,
    sample_time: float,
    observation: Observation | None,
    motors: MotorRecord | None,
    controller: BaseController,
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
        motors=motors,
        prediction_error=frozen(np.array(unforeseen, dtype=float)) if predicts else None,
        tracking_error=_tracking_error(controller, np.r_[time, until], [*shapes, end]),
        at_bound=_at_bound(controller, command),
        controller=repr(controller),
        sample_time=sample_time,
        statistics=_statistics(controller),
        settings=Given(controller.made_with),
        size=float(np.ptp(controller.structure.nodes, axis=1).max()),
        slowest_vibration=(
            controller.plant.slowest_vibration if isinstance(controller, Controller) else None
        ),
    )


def _statistics(controller: BaseController) -> object:
    """Return the statistics of a controller that has them."""
    found = getattr(controller, "statistics", None)
    return found if isinstance(found, _STATISTICS) else None


def _tracking_error(
    controller: BaseController, times: FloatArray, shapes: list[FloatArray]
) -> FloatArray | None:
    """Return the distance of the node that is farthest off the reference at each time, m.

    Where a plant with ground knows its place, that counts; else the shape does, wherever it is.
    """
    wanted = controller.reference_nodes(times)
    if wanted is None or not isinstance(controller, Controller):
        return None
    plant, still = controller.plant, np.zeros_like(shapes[0])
    if plant.model.contacts is None or plant.coordinates.kind == "internal":
        shapes = [plant.coordinates.laid_over(N, still)[0] for N in shapes]
    off = np.stack(shapes, axis=-1) - wanted
    return frozen(np.linalg.norm(off, axis=0).max(axis=0))


def _at_bound(controller: BaseController, command: FloatArray) -> IntArray:
    """Return how many strings of each command, shape (α, K), are at a bound, shape (K,)."""
    low, high = (bound[:, None] for bound in controller.bounds)
    close = _CLOSE * np.abs(command).max()
    at = (command <= low + close) | (command >= high - close)
    if controller.largest_change is not None:
        change = np.abs(np.diff(command, axis=1, prepend=command[:, :1]))
        at |= change >= controller.largest_change[:, None] - close
    return frozen(at.sum(axis=0))


def _sample_time(
    controller: BaseController, sample_time: float | None, step: float | None
) -> float:
    if sample_time is not None:
        sample_time = positive_number("sample_time", sample_time, "s")
    if controller.sample_time is not None:
        if sample_time is not None and sample_time != controller.sample_time:
            raise ValueError(
                f"the controller has a sample time of its own, {controller.sample_time:g} s; "
                "leave sample_time out"
            )
        return controller.sample_time
    if sample_time is not None:
        return sample_time
    if step is None:
        raise ValueError(
            "the controller acts in continuous time: give sample_time, or a step to sample at"
        )
    return step
