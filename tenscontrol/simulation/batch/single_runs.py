"""The runs of a batch that are not done together: each by :func:`simulate`, one after another."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.integrate.methods import Choice
from tenscontrol.interrupt import check
from tenscontrol.simulation.batch.batch_inputs import BatchInputs
from tenscontrol.simulation.health import HealthLimits
from tenscontrol.simulation.health_check import SimulationError
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.status import Status
from tenscontrol.structure.bar_clearance import BarMotion


@dataclass(frozen=True, eq=False)
class _Motion:
    """What is kept of a run."""

    nodes: FloatArray  # (d, k, K)
    velocities: FloatArray
    command: FloatArray | None
    not_ok: int


class SingleRuns:
    """Runs a scene run by run, and keeps what is asked for: used as a :class:`Runner` is."""

    def __init__(self, scene: BatchInputs, kept: IntArray) -> None:
        self.scene, self.kept, self.done = scene, kept, 0
        count, how = scene.count, scene.base.integration
        self._ends_alone = how.output_step is None
        self.completed, self.end_time = np.zeros(count, dtype=bool), np.zeros(count)
        self.messages = dict[int, str]()
        self.switches, self.missed = (np.zeros(count, dtype=int) for _ in range(2))
        self.choice = Choice("auto", "tolerance", how.tolerance, "no run can begin", "none")
        self.time = np.array([0.0, scene.duration])
        self._motions: dict[int, _Motion] = {}

    def run(self, threads: int, report: Callable[[float], None]) -> None:
        """Do all runs, in this thread: controllers of Python serve one run at a time."""
        try:
            for run in range(self.scene.count):
                check()
                try:
                    self._keep(run, self._simulated(run, "none"))
                except (TypeError, ValueError) as error:
                    self.messages[run] = str(error)
                self.done += 1
                report(self.done)
        finally:
            self._put_together()

    def _keep(self, run: int, trajectory: Trajectory) -> None:
        """Take what is kept of a run."""
        control, good = trajectory.control, trajectory.stopped is None
        if good and not self.completed.any():
            self.choice, self.time = trajectory.choice, self._at_kept_times(trajectory.time)
        self.completed[run], self.end_time[run] = good, trajectory.time[-1]
        if not good:
            self.messages[run] = str(trajectory.stopped)
        self.switches[run], self.missed[run] = trajectory.work.switches, trajectory.work.missed
        columns = slice(None) if good or not self._ends_alone else slice(1)
        nodes, velocities = (
            self._at_kept_times(values[:, self.kept])[..., columns]
            for values in (trajectory.nodes, trajectory.velocities)
        )
        self._motions[run] = _Motion(
            nodes,
            velocities,
            None if control is None else control.command,
            0 if control is None else len(control.status) - control.status_count[Status.OK],
        )

    def _put_together(self) -> None:
        """Have one array of each kind, with NaN where there is nothing."""
        motions = self._motions
        self.nodes, self.velocities = (
            self._stacked({run: getattr(motion, name) for run, motion in motions.items()},
                          (self.scene.model.structure.dimension, len(self.kept), len(self.time)))
            for name in ("nodes", "velocities")
        )  # fmt: skip
        self.command: FloatArray | None = None
        self.commands_not_ok: IntArray | None = None
        commands = {
            run: motion.command for run, motion in motions.items() if motion.command is not None
        }
        if commands:
            inputs, samples = np.max([command.shape for command in commands.values()], axis=0)
            self.command = self._stacked(commands, (inputs, samples))
            self.commands_not_ok = np.zeros(self.scene.count, dtype=int)
            for run, motion in motions.items():
                self.commands_not_ok[run] = motion.not_ok

    def _stacked(self, values: dict[int, FloatArray], shape: tuple[int, ...]) -> FloatArray:
        """Return arrays by run as one, filled up with NaN."""
        whole = np.full((self.scene.count, *shape), np.nan)
        for run, array in values.items():
            count = min(array.shape[-1], shape[-1])
            whole[run, ..., :count] = array[..., :count]
        return whole

    def estimate_errors(
        self, runs: IntArray, threads: int, report: Callable[[float], None]
    ) -> FloatArray:
        """Return the error of some runs, which are done again, shape (runs, K); NaN of others."""
        errors = np.full((self.scene.count, len(self.time)), np.nan)
        for looked_at, run in enumerate(runs.tolist(), 1):
            check()
            error = self._simulated(run, "estimate").error
            assert error is not None  # it was asked for
            errors[run] = self._at_kept_times(error)
            report(looked_at)
        return errors

    def lack(self) -> str | None:
        """Return why a run cannot be had as a trajectory: any can."""
        return None

    def trajectory(self, run: int) -> Trajectory:
        """Return a run that was completed, done again."""
        return self._simulated(run, self.scene.base.integration.error)

    def bars(self, run: int) -> BarMotion:
        """Return the bars over a run, done again, up to where it is good."""
        motion = self._simulated(run, "none")
        states = motion.time, motion.nodes, motion.velocities
        return BarMotion(motion.structure, *states, steps=motion.work.steps)

    def _simulated(self, run: int, error: str) -> Trajectory:
        """Return a run, up to where it stopped; raise where it cannot begin."""
        scene = self.scene.scene_of(run)
        how = replace(scene.integration, error=error, limits=HealthLimits())
        # What a single run would warn of: of many, messages and errors tell.
        with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
            try:
                return replace(scene, integration=how).simulate()
            except SimulationError as stop:
                return stop.trajectory

    def _at_kept_times(self, values: FloatArray) -> FloatArray:
        """Return values at the times kept, of those at all outputs, on the last axis."""
        return values[..., [0, -1]] if self._ends_alone else values
