"""The controller side of a simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import BAR_INPUTS, Actuation, inputs_of
from tenscontrol.actuation.motor_record import MotorRecord
from tenscontrol.actuation.winches import Winches, WinchMove
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.control.command import Command
from tenscontrol.control.controller import BaseController, Controller
from tenscontrol.control.feedback_linearization import FeedbackLinearizationStatistics
from tenscontrol.control.mpc.linear import MPCStatistics
from tenscontrol.control.mpc.nonlinear import NMPCStatistics
from tenscontrol.estimation.kalman_filter import KalmanFilter
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.integrate.integrator import steps_between
from tenscontrol.interrupt import check
from tenscontrol.simulation.actuators import Actuators
from tenscontrol.simulation.arguments import Arguments
from tenscontrol.simulation.control_record import ControlRecord
from tenscontrol.simulation.observation import Observation
from tenscontrol.simulation.plant_run import PlantRun, StoppedError
from tenscontrol.simulation.strut_drives import StrutDrives
from tenscontrol.simulation.trajectory import Trajectory

_STATISTICS = MPCStatistics, NMPCStatistics, FeedbackLinearizationStatistics

# A command so close to a bound, relative to the largest, is at it.
_CLOSE = 1e-7


class ClosedLoop:
    """A controller with its actuators and sensors, in a loop with a plant run.

    ``rest_length`` are those at the start; ``estimation`` is the estimator, the sensors and the
    seed; ``start`` is the run to go on from.
    """

    def __init__(
        self,
        run: PlantRun,
        controller: BaseController,
        sample_time: float | None,
        rest_length: FloatArray | None,
        winches: Winches | None,
        estimation: tuple[KalmanFilter, Sensors | None, int | None] | None,
        start: Trajectory | None,
    ) -> None:
        self._run, self._controller, self._start = run, controller, start
        self._rest_length, self._winches = rest_length, winches
        self._sample = sample = _sample_time(controller, sample_time, run.integration.step)
        size = 1500 + 48 * len(controller.commanded.strings)  # bytes of objects and numbers
        validation.refuse_memory(
            f"sample_time is {sample:g} s", run.duration / sample, "samples", size
        )
        self.actuators: Actuators | StrutDrives  # what applies the commands
        if controller.input in BAR_INPUTS:
            assert rest_length is not None  # what strings hold, or their γ
            self.actuators = StrutDrives(run, controller, winches, rest_length, sample)
        else:
            self.actuators = Actuators(run, controller, winches, rest_length, sample, start)
        self._estimation = estimation
        self._substeps = 1 if winches is None else winches.substeps
        self._observation: Observation | None = None
        self._samples: list[_Sample] = []
        # Of a subdivision, the nodes of its parent come first.
        self._seen = controller.structure.nodes.shape[1]

    def again(self) -> Callable[[PlantRun], ClosedLoop] | None:
        """Return what closes the loop of another run, with copies of controller and estimator.

        None where there are none that begin alike. A function may be one of time alone, or remember
        what it was asked; and a run that goes on began with what both remembered then.
        """
        if self._start is not None or not isinstance(self._controller, Controller):
            return None
        try:
            twin = self._controller.twin()
        except TypeError:  # parts of a controller of the user, as locks and files
            return None
        estimation = self._estimation
        if estimation is not None:
            estimation = copy(estimation[0]), *estimation[1:]
        given = self._sample, self._rest_length, self._winches, estimation, None
        return lambda run: ClosedLoop(run, twin, *given)

    def _begin(self, state: FloatArray) -> None:
        """Let controller and estimator begin, or go on."""
        run, controller, start = self._run, self._controller, self._start
        actuators = self.actuators
        if start is None:
            controller.begin(run.model, run.motion(state)[0][:, : self._seen])
        # A controller that goes on knows its previous input, unless there is none or it was lost.
        knows = start is not None and start.stopped is None and self._rest_length is None
        if actuators.known and not (knows and controller.status_count):
            N, _ = run.motion(state)
            controller.applied(actuators.applied_input(N))
        if self._estimation is None:
            return
        self._observation = Observation(
            *self._estimation, run.model, run.input, controller, self._sample, actuators.start,
            self._substeps, start is not None,
        )  # fmt: skip
        if start is not None:
            earlier = None if start.control is None else start.control.estimate
            samples_before = round(run.now / self._sample)
            self._observation.go_on(earlier, start.held, samples_before)

    def run(self, state: FloatArray) -> None:
        """Run the plant under the controller, sample by sample."""
        self._begin(state)
        run, controller, actuators = self._run, self._controller, self.actuators
        self._state = state
        for number, begin, end in samples(self._sample, run.duration, run.now):
            run.go_to(begin)
            if np.abs(self._state).max() > validation.LARGEST:
                raise StoppedError(
                    f"the motion has run away, beyond {validation.LARGEST:g} in m and m/s"
                )
            N, V = run.motion(self._state)
            command, taken = self._command(N, V)
            moment = run.now + 1e-9 * self._sample
            move = actuators.begin(command, N, run.faults.stuck(moment))
            sample = _Sample(
                run.now, command, move, taken, controller.prediction_error, N[:, : self._seen]
            )
            self._samples.append(sample)
            try:
                self._follow(number, end)
            finally:
                self._samples[-1] = replace(sample, move=actuators.end())
                controller.applied(actuators.applied_input(N))
                if self._observation is not None:
                    self._observation.predict(actuators.reached, actuators.held)

    def _command(self, N: FloatArray, V: FloatArray) -> tuple[Command, float]:
        """Return the command of the controller in a motion, and the time that it took, s."""
        run, controller = self._run, self._controller
        lost = run.faults.lost(run.now + 1e-9 * self._sample)  # also one that begins at the sample
        if self._observation is None:
            motion = tuple(
                (np.nan if lost else 1.0) * columns[:, : self._seen] for columns in (N, V)
            )
        else:
            felt = partial(run.acceleration, self._state)
            estimate = self._observation.estimate(N, V, felt, lost)
            motion = estimate.nodes, estimate.velocities
        began = perf_counter()
        try:
            command = controller.command(run.now, *motion)
        except Exception as error:
            reason = f"the controller {controller.label} raised {type(error).__name__}: {error}"
            if run.spans and not isinstance(error, MemoryError):
                raise StoppedError(reason) from error
            # There is no motion, or no room for it.
            error.add_note(f"{reason}, at {run.now:.6g} s")
            raise
        taken = perf_counter() - began
        check()  # a command that was interrupted is not applied
        return command, taken

    def _follow(self, number: float, end: float) -> None:
        """Integrate to the end of a sample, tick by tick."""
        run, ticks = self._run, self.actuators.ticks
        whole = end - run.now
        for i in range(1, ticks + 1):
            u = self.actuators.tick(i, self._state, run.now)
            until_tick = (number + i / ticks) * self._sample
            span = (end if i == ticks else min(until_tick, end)) - run.now
            if span > 1e-9 * whole:  # not round-off
                self._state = run.run(self._state, u, span, self.actuators.lengths)

    def record(self) -> ControlRecord:
        """Return the record of the samples so far."""
        rest_length = None
        if self._run.input == "rest_length" or self._controller.input in BAR_INPUTS:
            rest_length = self.actuators.start
            if rest_length is None:
                rest_length = self._samples[0].move.rest_length
        end, _ = self._run.motion(self._state)
        return _control_record(
            self._samples, rest_length, self._sample, self._observation,
            self.actuators.motor_record(), self._controller, self._run.now, end[:, : self._seen],
            self.actuators.actuation,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Sample:
    """A sample of a closed loop: when it began, s, and what came of it."""

    time: float
    command: Command
    move: WinchMove
    computing_time: float
    prediction_error: float | None
    nodes: FloatArray


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
    for k in range(steps_between(duration, sample)):
        start = (first + k) * sample
        cut = now + duration - start < (1 - 1e-9) * sample
        yield first + k, start, now + duration if cut else start + sample


def _control_record(
    rows: list[_Sample],
    rest_length: FloatArray | None,
    sample_time: float,
    observation: Observation | None,
    motors: MotorRecord | None,
    controller: BaseController,
    until: float,
    end: FloatArray,
    actuation: Actuation,
) -> ControlRecord:
    """Return the record of samples.

    ``rest_length`` are those before the first sample, shape (α,); None where γ is held. The run
    ends at a time with these nodes.
    """
    commands, moves = [row.command for row in rows], [row.move for row in rows]
    shapes, unforeseen = [row.nodes for row in rows], [row.prediction_error for row in rows]
    time = frozen(np.array([row.time for row in rows]))
    applied = np.column_stack([move.rest_length for move in moves])
    rate = np.zeros_like(applied)
    if rest_length is not None:
        rate = np.diff(applied, axis=1, prepend=rest_length[:, None]) / sample_time
    command = np.column_stack([command.value for command in commands])
    predicts = any(action is not None for action in unforeseen)
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
        computing_time=frozen(np.array([row.computing_time for row in rows])),
        estimate=None if observation is None else observation.record(time),
        motors=motors,
        prediction_error=frozen(np.array(unforeseen, dtype=float)) if predicts else None,
        tracking_error=_tracking_error(controller, np.r_[time, until], [*shapes, end]),
        at_bound=_at_bound(controller, command),
        controller=repr(controller),
        sample_time=sample_time,
        statistics=_statistics(controller),
        settings=Arguments(controller.made_with),
        size=controller.structure.size,
        slowest_vibration=(
            controller.plant.slowest_vibration if isinstance(controller, Controller) else None
        ),
        actuation=actuation,
    )


def _statistics(controller: BaseController) -> object:
    """Return the statistics of a controller that has them."""
    statistics = getattr(controller, "statistics", None)
    return statistics if isinstance(statistics, _STATISTICS) else None


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
    """Return how many inputs of each command, shape (α, K), are at a bound, shape (K,)."""
    low, high = (bound[:, None] for bound in controller.bounds)
    command = inputs_of(controller.actuation, command)
    close = _CLOSE * np.abs(command).max()
    bounded = (command <= low + close) | (command >= high - close)
    if controller.largest_change is not None:
        change = np.abs(np.diff(command, axis=1, prepend=command[:, :1]))
        bounded |= change >= controller.largest_change[:, None] - close
    return frozen(bounded.sum(axis=0))


def _sample_time(
    controller: BaseController, sample_time: float | None, step: float | None
) -> float:
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
