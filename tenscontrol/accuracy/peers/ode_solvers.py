"""SciPy's and CasADi's own integrators on our right-hand side, as a user would call them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, final

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.accuracy.peers.peer import Peer, Solution, checked_run, peer_settings, spaced
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import Equation, unpack_states
from tenscontrol.dynamics.evaluator import Evaluator, Function, builds
from tenscontrol.integrate.cvodes import is_expandable, jacobian_weight, state_jacobian
from tenscontrol.simulation.scene import Scene

_METHODS = ("DOP853", "RK45", "Radau", "LSODA")
_IMPLICIT = ("Radau", "LSODA")

_TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)


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

    def __init__(self, method: str, settings: Sequence[float] = _TOLERANCES) -> None:
        self.method = validation.choice("method", method, _METHODS)
        self.name = f"scipy {method.lower()}"
        self.settings = peer_settings(settings)

    @builds
    def prepare(self, case: Scene, setting: float, times: FloatArray) -> Callable[[], Solution]:
        """See :meth:`Peer.prepare`."""
        setting, times = checked_run(case, setting, times)
        from scipy.integrate import solve_ivp

        equation = case.equation(derivatives=self.method in _IMPLICIT)
        kinked, held, state = equation.kinked_slope, case.input_value, case.state
        evaluate = Evaluator(kinked)
        options: dict[str, Any] = {}
        weight = 0
        if self.method in _IMPLICIT:
            expand = is_expandable(equation)
            jacobian = state_jacobian(kinked, expand)
            weight = jacobian_weight(kinked, jacobian)
            inputs = jacobian.sx_in() if expand else jacobian.mx_in()
            dense = Evaluator(Function("dense", inputs, [ca.densify(jacobian(*inputs))]))
            options["jac"] = lambda time, x: dense(x, held)[0].copy()

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
                solution = solve_ivp(
                    slope, (0.0, times[-1]), state, method=self.method, t_eval=times,
                    rtol=setting, atol=setting, **options,
                )  # fmt: skip
            if not solution.success:
                raise ArithmeticError(solution.message)
            nodes, velocities = unpack_states(case.structure, solution.y)
            # SciPy's own count may leave out calls for Jacobians by differences.
            calls = evaluate.calls - before + weight * solution.njev
            return Solution(nodes, velocities, evaluations=calls)

        return run


@final
class CasADiCVODES(Peer):
    """``casadi.integrator`` with CVODES, outputs on its grid.

    Backward differentiation formulas with exact Jacobians, each counted as as many evaluations as
    it has times the instructions. Slack/taut switches are stepped across.

    Parameters
    ----------
    settings : sequence of float, optional
        Tolerances, relative, and absolute in m and m/s.
    """

    name = "casadi cvodes"

    def __init__(self, settings: Sequence[float] = _TOLERANCES) -> None:
        self.settings = peer_settings(settings)

    def prepare(self, case: Scene, setting: float, times: FloatArray) -> Callable[[], Solution]:
        """See :meth:`Peer.prepare`."""
        setting, times = checked_run(case, setting, times)
        equation = case.equation(derivatives=True)
        kinked = equation.kinked_slope
        weight = jacobian_weight(kinked, state_jacobian(kinked, is_expandable(equation)))
        tolerances = {"reltol": setting, "abstol": setting}
        options = {**tolerances, "max_num_steps": 1_000_000, "disable_internal_warnings": True}
        solver = _solver("cvodes", equation, times, options)

        def run() -> Solution:
            states = _run(solver, case)
            stats = solver.stats()
            calls = stats["nfevals"] + weight * stats["n_call_jacF"]
            return Solution(*unpack_states(case.structure, states), evaluations=calls)

        return run


@final
class CasADiRK(Peer):
    """``casadi.integrator`` with its Runge-Kutta method of order 4, outputs on its grid.

    Slack/taut switches are stepped across.

    Parameters
    ----------
    settings : sequence of float, optional
        Steps, s. Each is shortened so that a whole number fits between outputs.
    """

    name = "casadi rk"

    def __init__(self, settings: Sequence[float] = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5)) -> None:
        self.settings = peer_settings(settings)

    def prepare(self, case: Scene, setting: float, times: FloatArray) -> Callable[[], Solution]:
        """See :meth:`Peer.prepare`."""
        setting, times = checked_run(case, setting, times)
        spacing, inner = spaced(times, setting)
        # One grid interval repeated: on a grid of decimals CasADi may round to a step more.
        solver = _solver(
            "rk",
            case.equation(),
            np.arange(1.0, len(times) + 1),
            {"number_of_finite_elements": inner * len(times)},
            spacing,
        )

        def run() -> Solution:
            states = _run(solver, case)
            if not np.isfinite(states).all():
                raise ArithmeticError("the state is no longer finite")
            return Solution(
                *unpack_states(case.structure, states), evaluations=4 * inner * len(times)
            )

        return run


@builds
def _solver(
    plugin: str, equation: Equation, times: FloatArray, options: dict[str, Any], unit: float = 1.0
) -> ca.Function:
    """Return the integrator on a grid of times in some unit, s."""
    kinked = equation.kinked_slope
    x, u = kinked.sx_in() if is_expandable(equation) else kinked.mx_in()
    problem = {"x": x, "p": u, "ode": unit * kinked(x, u)}
    # What goes wrong is told by an exception; it would be printed beside.
    options = {**options, "show_eval_warnings": False}
    return ca.integrator("solver", plugin, problem, 0.0, times.tolist(), options)


def _run(solver: ca.Function, case: Scene) -> FloatArray:
    """Return the states on the grid, shape (states, T)."""
    try:
        return np.array(solver(x0=case.state, p=case.input_value)["xf"])
    except RuntimeError as error:
        if "CVode returned" not in str(error):
            raise
        reason = str(error).split("CVode returned")[1].split(".")[0]
        raise ArithmeticError(f"CVODES stopped with {reason.strip()}") from None
