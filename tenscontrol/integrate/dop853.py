"""The Dormand-Prince method of order 8 with error control, from SciPy."""

from __future__ import annotations

from typing import final

import numpy as np

from tenscontrol.dynamics import Equation, Evaluator
from tenscontrol.integrate.integrator import (
    IntegrationError,
    Integrator,
    Report,
    Span,
    Work,
)
from tenscontrol.validation import FloatArray, positive_number

# SciPy warns below a hundred units of round-off and raises the tolerance by itself.
_SMALLEST_TOLERANCE = 100 * np.finfo(float).eps


@final
class DOP853(Integrator):
    """Adaptive steps after Hairer, Nørsett & Wanner, by ``scipy.integrate.DOP853``.

    Parameters
    ----------
    equation : Equation
    tolerance : float
        Error allowed a step, relative to the size of each state entry, and
        absolute (m, m/s) where that is below 1.
    """

    name = "dop853"

    def __init__(self, equation: Equation, tolerance: float) -> None:
        super().__init__(equation)
        self.tolerance = positive_number("tolerance", tolerance, "m and m/s")
        if self.tolerance < _SMALLEST_TOLERANCE:
            raise ValueError(
                f"tolerance is {self.tolerance:g}, expected at least {_SMALLEST_TOLERANCE:.1e}: "
                "double precision goes no further"
            )
        self._evaluator = Evaluator(equation.kinked_slope)

    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        from scipy import integrate

        def slope(time: float, x: FloatArray) -> FloatArray:
            rate = self._evaluator(x, held)[0].copy()
            if not np.isfinite(rate).all():
                # SciPy would shorten its step for ever.
                raise FloatingPointError("the forces are no longer finite")
            return rate

        times = duration * np.arange(1, outputs + 1) / outputs
        states = np.empty((len(state), outputs))
        done = steps = 0
        stepper = None
        try:
            # A state that is not finite is looked for, so NumPy need not warn of it.
            with np.errstate(over="ignore", invalid="ignore"):
                stepper = integrate.DOP853(
                    slope, 0.0, state, duration, rtol=self.tolerance, atol=self.tolerance
                )
                while stepper.status == "running":
                    trouble = stepper.step()
                    steps += 1
                    if stepper.status == "failed" or not np.isfinite(stepper.y).all():
                        raise FloatingPointError(trouble or "the state is no longer finite")
                    reached = outputs
                    if stepper.status == "running":
                        reached = int(np.searchsorted(times, stepper.t, side="right"))
                    if reached > done:
                        # The interpolant costs three evaluations: only where a state is wanted.
                        states[:, done:reached] = stepper.dense_output()(times[done:reached])
                        done = reached
                    if report is not None:
                        report(float(stepper.t))
        except FloatingPointError as error:
            time = 0.0 if stepper is None else float(stepper.t_old or 0.0)
            span = Span(
                states[:, :done],
                Work(steps=steps, evaluations=0 if stepper is None else stepper.nfev),
            )
            raise IntegrationError(
                f"dop853 stopped after {time:.6g} s: {error}", time, span
            ) from None
        states[:, -1] = stepper.y
        return Span(states, Work(steps=steps, evaluations=stepper.nfev))
