"""Robots of a stepper as a vectorized environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from tenscontrol.arrays import FloatArray
from tenscontrol.learning.tasks import Task
from tenscontrol.robustness.distributions import Distribution, draw_rows
from tenscontrol.simulation.stepper import Stepper

# Steps so many times finer tell what a step errs.
_FINER = 8

# A motion whose bars are off by this part of their length has run away.
_OFF = 0.1


class Robots(VectorEnv):
    """What :func:`vector_env` returns."""

    def __init__(
        self,
        stepper: Stepper,
        task: Task,
        duration: float,
        turned: bool,
        drawn: Mapping[str, Distribution],
        autoreset: AutoresetMode,
        render_mode: str | None,
    ) -> None:
        self._stepper, self._task, self.render_mode = stepper, task, render_mode
        self._duration, self._drawn, self._autoreset = duration, drawn, autoreset
        structure = stepper.model.structure
        self._turns = turned and structure.dimension == 3 and not len(structure.fixed_rows)
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": round(1 / stepper.sample_time),
            "autoreset_mode": autoreset,
        }
        self.num_envs = len(stepper.lost)
        inputs = len(stepper.actuation.lead)
        seen = self._seen(np.zeros(self.num_envs), *stepper.reset()).shape[1]
        self.single_action_space = Box(-1.0, 1.0, (inputs,), np.float32)
        self.single_observation_space = Box(-np.inf, np.inf, (seen,), np.float32)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._motion: tuple[FloatArray, FloatArray] = stepper.nodes, stepper.velocities
        self._since = np.zeros(self.num_envs, dtype=int)  # samples of each episode
        self._is_over = np.zeros(self.num_envs, dtype=bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Begin all episodes anew."""
        super().reset(seed=seed)
        self._stepper.reset()  # also its clock, so that a seed gives the same bits
        self._begin(np.ones(self.num_envs, dtype=bool))
        return self._observation(), {}

    def step(
        self, actions: Any
    ) -> tuple[FloatArray, FloatArray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance all robots by a sample; those whose episode was over begin anew instead."""
        stepper, began = self._stepper, self._is_over.copy()
        before, _ = self._motion
        stepper.step(self._command(np.asarray(actions, dtype=float)))
        lost = self._have_run_away() & ~began
        self._begin(began)
        nodes, _ = self._motion = self._kept(before, lost)
        self._since[~began] += 1
        time = self._since * stepper.sample_time
        reward = np.where(began | lost, 0.0, self._task.reward(time, before, nodes))
        terminated = ~began & (lost | self._task.is_reached(nodes))
        truncated = ~began & ~terminated & (time >= self._duration * (1 - 1e-9))
        self._is_over = terminated | truncated
        info: dict[str, Any] = {"lost": lost} if lost.any() else {}
        if self._autoreset is AutoresetMode.SAME_STEP and self._is_over.any():
            info |= {"final_obs": self._observation(), "_final_obs": self._is_over.copy()}
            self._begin(self._is_over.copy())
        return self._observation(), reward, terminated, truncated, info

    def step_error(self) -> float:
        """Return what the step errs in a sample from here, held as it is, as part of the size.

        The largest distance of a node from where a step 8 times finer brings it, of all robots.
        """
        stepper = self._stepper
        finer, state = stepper.with_step(stepper.largest_step / _FINER), stepper.state
        inputs = stepper.actuation.inputs(stepper.held.T).T
        finer.state = state
        ends = [integrator.step(inputs)[0] for integrator in (stepper, finer)]
        stepper.state = state
        size = stepper.model.structure.size
        return float(np.nanmax(np.linalg.norm(ends[0] - ends[1], axis=1))) / size

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture of each robot, shape (height, width, 3)."""
        if self.render_mode is None:
            return None
        from tenscontrol.plot.pictures import picture

        return tuple(picture(self._stepper.model.structure, nodes) for nodes in self._motion[0])

    # ---- within an episode ----

    def _begin(self, which: np.ndarray) -> None:
        """Begin the episodes of some robots."""
        if which.any():
            drawn = draw_rows(self._drawn, self.np_random, int(which.sum()))
            self._stepper.reset(which, parameters=drawn)
            if self._turns:
                angles = self.np_random.uniform(-np.pi, np.pi, self.num_envs)
                self._stepper.turn(which, angles)
        self._since[which], self._is_over[which] = 0, False
        self._motion = self._stepper.nodes, self._stepper.velocities

    def _have_run_away(self) -> np.ndarray:
        """Which robots have bars that the steps no longer keep on their lengths."""
        structure, nodes = self._stepper.model.structure, self._stepper.nodes
        start, end = structure.bars.T
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.linalg.norm(nodes[:, :, end] - nodes[:, :, start], axis=1)
            off = np.abs(length / structure.bar_length - 1).max(axis=1, initial=0.0)
        return np.asarray(~(off < _OFF) | self._stepper.lost)

    def _kept(self, before: FloatArray, lost: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Return the motion, of robots that are lost as it was before, at rest."""
        nodes, velocities = self._stepper.nodes, self._stepper.velocities
        nodes[lost], velocities[lost] = before[lost], 0.0
        return nodes, velocities

    def _command(self, actions: FloatArray) -> FloatArray:
        """Return the inputs that actions lead to."""
        stepper = self._stepper
        assert stepper.limits is not None  # it has winches
        low, high, reach = stepper.limits
        now = stepper.actuation.inputs(stepper.held.T).T
        return np.clip(now + np.clip(actions, -1.0, 1.0) * reach, low, high)

    def _observation(self) -> FloatArray:
        return self._seen(self._since * self._stepper.sample_time, *self._motion)

    def _seen(self, time: FloatArray, nodes: FloatArray, velocities: FloatArray) -> FloatArray:
        count = len(nodes)
        beside = nodes - nodes.mean(axis=2, keepdims=True)
        inputs = self._stepper.actuation.inputs(self._stepper.held.T).T
        parts = [beside.reshape(count, -1), velocities.reshape(count, -1), inputs]
        return np.hstack([*parts, self._task.seen(time, nodes)]).astype(np.float32)
