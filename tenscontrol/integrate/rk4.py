"""The classical Runge-Kutta method of order 4 with a fixed step."""

from __future__ import annotations

from math import ceil
from typing import final

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Equation, Evaluator
from tenscontrol.integrate.integrator import IntegrationError, Integrator, Report, Span, Work
from tenscontrol.validation import FloatArray, positive_number

# Output states per call into CasADi: long enough that the call costs nothing,
# short enough that a long run reports its progress.
_CHUNK = 512


@final
class RK4(Integrator):
    """Fixed steps; the loop over steps runs inside CasADi (``mapaccum``).

    Parameters
    ----------
    equation : Equation
    step : float
        Largest step, s. It is shortened so that a whole number fits between outputs.
    """

    name = "rk4"

    def __init__(self, equation: Equation, step: float) -> None:
        super().__init__(equation)
        self.step = positive_number("step", step, "s")
        self._one_step = _step_function(equation.kinked_slope)
        self._chunks: dict[tuple[int, int], Evaluator] = {}

    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        # The small allowance lets 0.02/0.001 be 20 steps, whatever round-off says.
        inner = max(1, ceil(duration / outputs / self.step - 1e-9))
        step = duration / (outputs * inner)
        states = np.empty((len(state), outputs))
        current = state
        done = 0
        while done < outputs:
            count = min(_CHUNK, outputs - done)
            result = self._chunk(inner, count)(current, held, step)[0].reshape(-1, count, order="F")
            states[:, done : done + count] = result
            done += count
            good = int(np.isfinite(states[:, :done]).all(axis=0).sum())
            if good < done:
                # Once not finite, never finite again: the good states come first.
                time = duration * good / outputs
                raise IntegrationError(
                    f"the state is no longer finite between {time:.6g} s and "
                    f"{duration * (good + 1) / outputs:.6g} s; try a step below {step:g} s",
                    time,
                    Span(states[:, :good], Work(steps=good * inner, evaluations=4 * good * inner)),
                )
            current = states[:, done - 1]
            if report is not None:
                report(duration * done / outputs)
        return Span(states, Work(steps=outputs * inner, evaluations=4 * outputs * inner))

    def _chunk(self, inner: int, count: int) -> Evaluator:
        """Return ``(x, u, h) -> [x1 … x_count]`` with ``inner`` steps from one to the next."""
        if (inner, count) not in self._chunks:
            stored = self._one_step.fold(inner) if inner > 1 else self._one_step
            x = ca.MX.sym("x", stored.size1_in(0))
            u, h = ca.MX.sym("u", stored.size1_in(1)), ca.MX.sym("h")
            # Held inputs are repeated: fold and mapaccum want one column a step.
            held = [ca.repmat(u, 1, inner * count), ca.repmat(h, 1, inner * count)]
            states = stored.mapaccum(count)(x, *held) if count > 1 else stored(x, *held)
            self._chunks[inner, count] = Evaluator(ca.Function("chunk", [x, u, h], [states]))
        return self._chunks[inner, count]


def _step_function(equation: ca.Function) -> ca.Function:
    x, u, h = (
        ca.SX.sym("x", equation.size1_in(0)),
        ca.SX.sym("u", equation.size1_in(1)),
        ca.SX.sym("h"),
    )
    k1 = equation(x, u)
    k2 = equation(x + h / 2 * k1, u)
    k3 = equation(x + h / 2 * k2, u)
    k4 = equation(x + h * k3, u)
    return ca.Function("rk4_step", [x, u, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
