"""The formulas of Dormand and Prince of order 8: step, error and interpolant.

E. Hairer, S. P. Nørsett & G. Wanner, *Solving Ordinary Differential Equations
I*, 2nd ed., II.5 (coefficients, error estimate) and II.6 (interpolant).
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from tenscontrol.dynamics import Equation
from tenscontrol.integrate.projection import projection

#: Evaluations of a step whose first slope is known, and of its interpolant.
STAGES, MORE_STAGES = 12, 3

#: Coefficients of the interpolant.
POWERS = 7


class DormandPrince:
    """One step of the method for fixed ``taut``, as CasADi functions.

    Parameters
    ----------
    equation : Equation
    project : bool
        Whether to make the bar lengths exact after the step.
    """

    def __init__(self, equation: Equation, project: bool = False) -> None:
        from scipy.integrate import DOP853  # holds the coefficients

        self._equation = equation
        self._project = projection(equation) if project else None
        self._method = DOP853
        n = equation.states
        names = {"x": n, "f": n, "u": equation.inputs, "taut": equation.switches, "h": 1}
        self._inputs = [ca.MX.sym(name, size) for name, size in names.items()]

    def _stages(self) -> tuple[Any, list[Any]]:
        """Return x after the step, and the slopes of its stages."""
        x, f, u, taut, h = self._inputs
        slopes = [f]
        for a in self._method.A[1:]:
            slopes.append(self._equation.slope(x + h * _combined(slopes, a), u, taut))
        x1 = x + h * _combined(slopes, self._method.B)
        return x1 if self._project is None else self._project(x1), slopes

    def plain(self) -> ca.Function:
        """Return ``(x, u, taut, h) -> x1``: the step alone."""
        x, _, u, taut, h = self._inputs
        stages = ca.Function("stages", self._inputs, [self._stages()[0]])
        x1 = stages(x, self._equation.slope(x, u, taut), u, taut, h)
        return ca.Function("dop853", [x, u, taut, h], [x1])

    def tried(self) -> ca.Function:
        """Return ``(x, f, u, taut, h, scale) -> (x1, f1, error, K)``.

        The error is the root mean square over the state, as part of ``scale``.
        """
        x, _, u, taut, h = self._inputs
        scale = ca.MX.sym("scale", x.shape)
        x1, slopes = self._stages()
        f1 = self._equation.slope(x1, u, taut)
        slopes.append(f1)
        fifth, third = (
            ca.sumsqr(_combined(slopes, e) / scale) for e in (self._method.E5, self._method.E3)
        )
        # Nothing moves: no error.
        below = ca.sqrt((fifth + 0.01 * third) * x.shape[0])
        error = ca.if_else(below > 0, h * fifth / below, below)
        outputs = [x1, f1, error, ca.horzcat(*slopes)]
        return ca.Function("tried", [*self._inputs, scale], outputs)

    def interpolant(self) -> ca.Function:
        """Return ``(x, x1, f, f1, K, u, taut, h) -> coefficients``, one column each."""
        x, f, u, taut, h = self._inputs
        x1, f1, K = (
            ca.MX.sym("x1", x.shape),
            ca.MX.sym("f1", x.shape),
            ca.MX.sym("K", x.shape[0], STAGES + 1),
        )
        slopes = ca.horzsplit(K)
        for a in self._method.A_EXTRA:
            slopes.append(self._equation.slope(x + h * _combined(slopes, a), u, taut))
        step = x1 - x
        first = [step, h * f - step, 2 * step - h * (f1 + f)]
        rest = [h * _combined(slopes, d) for d in self._method.D]
        inputs = [x, x1, f, f1, K, u, taut, h]
        return ca.Function("interpolant", inputs, [ca.horzcat(*first, *rest)])


def _combined(slopes: list[Any], weights: Any) -> Any:
    """Return the sum of slopes with weights; many weights are zero."""
    used = [i for i in range(len(slopes)) if weights[i] != 0]
    return ca.mtimes(ca.horzcat(*(slopes[i] for i in used)), ca.DM(weights[used]))
