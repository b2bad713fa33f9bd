"""The controller side of a simulation: samples, commands and their record."""

from __future__ import annotations

from math import ceil
from time import perf_counter

import numpy as np

from tenscontrol.actuation import Winches, WinchMove
from tenscontrol.control import Command, Controller
from tenscontrol.dynamics import unpack_states
from tenscontrol.simulation.actuators import Actuators
from tenscontrol.simulation.loop import Loop
from tenscontrol.simulation.observation import Observation
from tenscontrol.simulation.trajectory import ControlRecord, Trajectory
from tenscontrol.validation import FloatArray, frozen, positive_number


def run_closed_loop(
    loop: Loop,
    state: FloatArray,
    duration: float,
    controller: Controller,
    rest_length: object,
    winches: Winches | None,
    sample_time: float | None,
    estimation: tuple[object, object, object] | None = None,
) -> Trajectory:
    """Return the motion of the plant under a controller, run sample by sample.

    ``estimation`` is the estimator, the sensors and the seed.
    """
    sample = _sample_time(controller, sample_time, loop.step)
    actuators = Actuators(loop, controller, winches, rest_length, sample)
    controller.reset()
    if actuators.start is not None:
        N = unpack_states(loop.model.structure, state[:, None])[0][:, :, 0]
        controller.applied(actuators.applied_input(N))
    observation = None
    if estimation is not None:
        substeps = 1 if winches is None else winches.substeps
        observation = Observation(
            *estimation, loop.model, loop.input, controller, sample, actuators.start, substeps
        )
    rows: list[tuple[float, Command, WinchMove, float]] = []

    def record() -> ControlRecord:
        start = None
        if loop.input == "rest_length":
            start = rows[0][2].rest_length if actuators.start is None else actuators.start
        return _control_record(rows, start, sample, observation)

    seen = controller.plant.coordinates.nodes.shape[
        1
    ]  # of a subdivision, the nodes of its parent come first
    loop.record = record
    # The allowance keeps round-off from adding a last sample of no length.
    for k in range(max(1, ceil(duration / sample - 1e-9))):
        loop.now = k * sample
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
        move, inputs = actuators.apply(command, N, loop.faults.stuck(moment))
        controller.applied(actuators.applied_input(N))
        if observation is not None:
            observation.predict(move.rest_length, inputs[-1])
        rows.append((loop.now, command, move, taken))
        end = min(loop.now + sample, duration)
        whole = end - loop.now
        for i, held in enumerate(inputs):
            span = min(loop.now + sample / len(inputs), end) if i + 1 < len(inputs) else end
            span -= loop.now
            if span > 1e-9 * whole:  # not round-off
                state = loop.run(state, held, span)
    return loop.trajectory()


def _control_record(
    rows: list[tuple[float, Command, WinchMove, float]],
    rest_length: FloatArray | None,
    sample_time: float,
    observation: Observation | None,
) -> ControlRecord:
    """Return the record of samples: start, command, move of the winches, computing time.

    ``rest_length`` are those before the first sample, shape (α,); None where γ is held.
    """
    times, commands, moves, taken = zip(*rows, strict=True)
    time, applied = frozen(np.array(times)), np.column_stack([move.rest_length for move in moves])
    rate = np.zeros_like(applied)
    if rest_length is not None:
        rate = np.diff(applied, axis=1, prepend=rest_length[:, None]) / sample_time
    return ControlRecord(
        time=time,
        command=frozen(np.column_stack([command.value for command in commands])),
        applied=frozen(applied),
        status=tuple(command.status for command in commands),
        fallback=tuple(command.fallback for command in commands),
        detail=tuple(command.detail for command in commands),
        winch_rate=frozen(rate),
        rate_limited=frozen(np.array([len(move.rate_limited) for move in moves])),
        range_limited=frozen(np.array([len(move.range_limited) for move in moves])),
        computing_time=frozen(np.array(taken)),
        estimate=None if observation is None else observation.record(time),
    )


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
