"""The classical Runge-Kutta method of order 4 with a fixed step."""

from __future__ import annotations

from typing import final

import casadi as ca

from tenscontrol.dynamics import Equation
from tenscontrol.integrate.fixed_step import FixedStep


@final
class RK4(FixedStep):
    """The classical Runge-Kutta method of order 4; see :class:`FixedStep`."""

    name = "rk4"
    evaluations_per_step = 4

    def step_function(self, equation: Equation) -> ca.Function:
        """See :meth:`FixedStep.step_function`."""
        x, u, taut, h = equation.symbols()
        k1 = equation.slope(x, u, taut)
        k2 = equation.slope(x + h / 2 * k1, u, taut)
        k3 = equation.slope(x + h / 2 * k2, u, taut)
        k4 = equation.slope(x + h * k3, u, taut)
        return ca.Function("rk4", [x, u, taut, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
