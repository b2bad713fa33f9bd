"""The plant side of a simulation: integrates span by span and keeps what comes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import ceil

import numpy as np

from tenscontrol.dynamics import Model
from tenscontrol.integrate import DOP853, RK4, IntegrationError, Integrator, Span, Work
from tenscontrol.simulation.trajectory import ControlRecord, Trajectory, build_trajectory
from tenscontrol.validation import FloatArray, choice

METHODS = ("auto", "rk4", "dop853")


class SimulationError(ArithmeticError):
    """A simulation that could not go on.

    Attributes
    ----------
    trajectory : Trajectory
        The motion up to the time of the failure.
    """

    def __init__(self, message: str, trajectory: Trajectory) -> None:
        super().__init__(message)
        self.trajectory = trajectory


@dataclass(eq=False)
class Loop:
    """The plant side of a simulation: integrates span by span and keeps what comes."""

    model: Model
    hold: str
    load: FloatArray
    method: str
    tolerance: float
    step: float | None
    output_step: float = 0.0
    time: list[FloatArray] = field(default_factory=list)
    states: list[FloatArray] = field(default_factory=list)
    inputs: list[FloatArray] = field(default_factory=list)
    work: Work = field(default_factory=Work)
    now: float = 0.0

    def __post_init__(self) -> None:
        choice("method", self.method, METHODS)
        if self.method == "auto":
            self.method = "dop853" if self.step is None else "rk4"
        if self.method == "rk4" and self.step is None:
            raise ValueError("method 'rk4' needs a step, s; for example step=1e-3")
        if self.method == "dop853" and self.step is not None:
            raise ValueError(
                "step goes with method 'rk4'; 'dop853' chooses its own steps by tolerance"
            )
        equation = self.model.equation(self.hold, self.load - self.model.constant_force)
        self.integrator: Integrator
        if self.method == "rk4":
            assert self.step is not None  # checked above
            self.integrator = RK4(equation, self.step)
        else:
            self.integrator = DOP853(equation, self.tolerance)

    def run(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        report: Callable[[float], None],
        record: Callable[[], ControlRecord | None] = lambda: None,
    ) -> FloatArray:
        """Integrate one span with the input held and return the state at its end."""
        if not self.time:
            self._keep(np.zeros(1), state[:, None], held)
        outputs = max(1, ceil(duration / self.output_step - 1e-9))
        start = self.now
        try:
            span = self.integrator.advance(
                state, held, duration, outputs, lambda time: report(start + time)
            )
        except IntegrationError as error:
            self._add(error.span, held, duration, outputs)
            raise SimulationError(
                f"the simulation stopped at {start + error.time:.6g} s of motion: {error}. "
                "The motion up to there is in the error's .trajectory",
                self.trajectory(record()),
            ) from error
        self._add(span, held, duration, outputs)
        self.now = start + duration
        return span.states[:, -1]

    def _add(self, span: Span, held: FloatArray, duration: float, outputs: int) -> None:
        reached = span.states.shape[1]
        times = self.now + duration * np.arange(1, reached + 1) / outputs
        self._keep(times, span.states, held)
        self.work += span.work

    def _keep(self, time: FloatArray, states: FloatArray, held: FloatArray) -> None:
        self.time.append(time)
        self.states.append(states)
        self.inputs.append(np.tile(held[:, None], (1, len(time))))

    def trajectory(self, control: ControlRecord | None) -> Trajectory:
        """Return what came so far."""
        return build_trajectory(
            self.model,
            self.load,
            self.hold,
            np.concatenate(self.time),
            np.hstack(self.states),
            np.hstack(self.inputs),
            self.method,
            self.step,
            (self.work.steps, self.work.evaluations),
            control,
        )
