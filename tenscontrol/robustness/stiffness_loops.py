"""Four loops with strings of one stiffness: designed, then run."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscontrol.actuation import Winches, to_rest_length
from tenscontrol.control import (
    LQR,
    MPC,
    Controller,
    HeldLoop,
    Status,
    energy_weights,
    held_loop,
    lqr,
)
from tenscontrol.dynamics import LinearStrings, Model
from tenscontrol.plant import INPUTS, LinearPlant, Reference, linearize
from tenscontrol.robustness.distance import farthest_node
from tenscontrol.robustness.stiffness_report import StiffnessRun
from tenscontrol.simulation import HealthLimits, SimulationError, Trajectory, simulate
from tenscontrol.statics import Prestress
from tenscontrol.validation import FloatArray

# The part of a run, at its end, in which the structure is to be at its place.
LATE = 0.25

# R in units of energy_weights, as MPC has it.
_INPUT_WEIGHT = {"force_density": 0.1, "rest_length": 1.0}

# Steps of RK4: rad of the fastest vibration, and how many a sample at least.
_RADIANS, _STEPS = 0.3, 10


@dataclass(frozen=True, eq=False)
class Design:
    """All that is made for a stiffness before anything runs."""

    stiffness: float
    damping: float
    held: HeldLoop
    radius: float
    controllers: tuple[Controller, ...]
    integration_step: float


@dataclass(frozen=True, eq=False)
class Task:
    """What is the same for every stiffness; see :func:`stiffness_report`."""

    at: Prestress
    sample_time: float
    reference: Reference | None
    push: float
    duration: float
    weights: Callable[[LinearPlant], tuple[Any, Any]]
    horizon: int
    reach: object
    winches: Winches | None
    integration_step: float | None

    def design(self, stiffness: float, damping: float) -> Design:
        """Return LQR and MPC with either input, and their linear loops."""
        load = self.at.external_force
        model = Model(
            self.at.structure,
            strings=LinearStrings(stiffness, damping=damping),
            external_force=load if load.any() else False,
        )
        laws: dict[str, LQR] = {}
        controllers: list[Controller] = []
        for name in INPUTS:
            plant = linearize(model, self.at, input=name)
            Q, R = _checked_weights(self.weights(plant))
            largest, winches = self.reach, None
            if name == "rest_length":
                largest, winches = None, self.winches
            laws[name] = lqr(
                plant,
                Q,
                R,
                sample_time=self.sample_time,
                max_force_density=largest,
                winches=winches,
            )
            # That a law in γ will not hold is a figure of the report.
            with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
                mpc = MPC(
                    plant, horizon=self.horizon, sample_time=self.sample_time,
                    max_force_density=largest, Q=Q, R=R, reference=self.reference, winches=winches,
                )  # fmt: skip
            controllers += [laws[name], mpc]
        by_length = laws["rest_length"]
        fastest = float(np.abs(np.linalg.eigvals(by_length.plant.A)).max())
        return Design(
            stiffness,
            damping,
            held_loop(
                laws["force_density"].plant,
                laws["force_density"].gain,
                sample_time=self.sample_time,
            ),
            float(np.abs(by_length.poles).max()),
            tuple(controllers),
            min(self.sample_time / _STEPS, self.integration_step or _RADIANS / fastest),
        )

    def run(self, controller: Controller, integration_step: float) -> StiffnessRun:
        """Return what becomes of a loop on the nonlinear structure."""
        model = controller.plant.model
        nodes, velocities, gamma = self._start(controller)
        standing = None
        if self.winches is not None:
            standing = to_rest_length(model, nodes, gamma).rest_length
        failure = None
        try:
            run = simulate(
                model,
                self.duration,
                nodes,
                velocities,
                controller=controller,
                winches=self.winches,
                rest_length=standing,
                step=integration_step,
                output_step=self.sample_time / _STEPS,
                limits=HealthLimits(action="raise"),
            )
        except SimulationError as error:
            run = error.trajectory
            failure = run.stopped or str(error)
        if run.stopped is not None and failure is None:
            raise KeyboardInterrupt(run.stopped)
        return self._judged(controller, run, failure)

    def _start(self, controller: Controller) -> tuple[FloatArray, FloatArray | None, FloatArray]:
        """Return nodes, velocities and γ at the start."""
        plant, reference = controller.plant, self.reference
        if reference is not None and isinstance(controller, MPC):
            gamma = plant.force_density
            if reference.force_density is not None:
                gamma = reference.force_density[:, 0]
            return reference.nodes[:, :, 0], None, gamma
        r = plant.degrees_of_freedom
        # Any velocities, made such as bars can have.
        any_velocities = np.random.default_rng(0).normal(size=plant.nodes.shape)
        rates = plant.measure(plant.nodes, any_velocities)[r:]
        velocities = plant.to_velocities(np.zeros(r), rates)
        velocities *= self.push / np.linalg.norm(velocities, axis=0).max()
        return plant.nodes, velocities, plant.force_density

    def _judged(self, controller: Controller, run: Trajectory, failure: str | None) -> StiffnessRun:
        record = run.control
        assert record is not None  # a controller was given
        error = None
        if failure is None:
            late = run.nodes[:, :, run.time >= (1 - LATE) * run.time[-1]]
            error = farthest_node(controller.plant, late, controller.plant.nodes)
        least = float(run.force_density.min())
        return StiffnessRun(
            type(controller).__name__,
            controller.input,
            error,
            failure,
            least,
            # What comes and goes between states that are kept shows as switches.
            least <= 0 or run.work.switches > 0,
            sum(status is not Status.OK for status in record.status),
        )


def natural_weights(plant: LinearPlant) -> tuple[FloatArray, FloatArray]:
    """Return Q and R as MPC takes them."""
    Q, R = energy_weights(plant, by_mode=plant.input == "rest_length")
    return Q, _INPUT_WEIGHT[plant.input] * R


def _checked_weights(pair: object) -> tuple[object, object]:
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise TypeError(f"weights returned a {type(pair).__name__}, expected a pair Q, R")
    return pair
