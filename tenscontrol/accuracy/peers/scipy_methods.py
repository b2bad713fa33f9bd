"""SciPy's ``solve_ivp`` on our right-hand side, as a user would call it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np

from tenscontrol.accuracy.case import Case
from tenscontrol.accuracy.peer import Peer, Solution
from tenscontrol.dynamics import Evaluator, unpack_states
from tenscontrol.integrate import jacobian_weight, state_jacobian
from tenscontrol.validation import FloatArray, choice

_METHODS = ("DOP853", "RK45", "Radau", "LSODA")
_IMPLICIT = ("Radau", "LSODA")


@final
class SciPy(Peer):
    """A method of ``scipy.integrate.solve_ivp``.

    The right-hand side is our CasADi function, called through its buffer; the
    implicit methods get its exact Jacobian, which counts as as many evaluations
    as it has times the instructions. Slack/taut switches are stepped across.

    Parameters
    ----------
    method : {"DOP853", "RK45", "Radau", "LSODA"}
    settings : sequence of float, optional
        Tolerances, relative, and absolute in m and m/s.

    Raises
    ------
    ValueError
        If it is another method.
    """

    def __init__(
        self, method: str, settings: Sequence[float] = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)
    ) -> None:
        self.method = choice("method", method, _METHODS)
        self.name = f"scipy {method.lower()}"
        self.settings = tuple(settings)

    def refuse(self, case: Case) -> str | None:
        """See :meth:`Peer.refuse`."""
        return None

    def prepare(self, case: Case, setting: float, times: FloatArray) -> Callable[[], Solution]:
        """See :meth:`Peer.prepare`."""
        from scipy.integrate import solve_ivp

        kinked, held, state = case.equation().kinked_slope, case.value, case.state
        evaluate = Evaluator(kinked)
        options: dict[str, Any] = {}
        weight = 0
        if self.method in _IMPLICIT:
            jacobian = _dense(kinked)
            options["jac"] = lambda time, x: jacobian(x, held)[0].copy()
            weight = jacobian_weight(kinked, state_jacobian(kinked))

        def slope(time: float, x: FloatArray) -> FloatArray:
            rate = evaluate(x, held)[0].copy()
            if not np.isfinite(rate).all():
                raise FloatingPointError(f"the forces are no longer finite at {time:.6g} s")
            return rate

        def run() -> Solution:
            before = evaluate.calls
            # What goes wrong is told by the result; LSODA warns of it beside.
            quiet = warnings.catch_warnings(action="ignore", category=UserWarning)
            with quiet, np.errstate(over="ignore", invalid="ignore"):
                found = solve_ivp(
                    slope, (0.0, times[-1]), state, method=self.method, t_eval=times,
                    rtol=setting, atol=setting, **options,
                )  # fmt: skip
            if not found.success:
                raise ArithmeticError(found.message)
            nodes, velocities = unpack_states(case.structure, found.y)
            # SciPy's own count may leave out calls for Jacobians by differences.
            calls = evaluate.calls - before + weight * found.njev
            return Solution(nodes, velocities, evaluations=calls)

        return run


def _dense(kinked: Any) -> Evaluator:
    import casadi as ca

    jacobian = state_jacobian(kinked)
    inputs = jacobian.sx_in()
    return Evaluator(ca.Function("jacobian", inputs, [ca.densify(jacobian(*inputs))]))
