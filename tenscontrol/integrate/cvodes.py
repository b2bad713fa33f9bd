"""Backward differentiation with error control, by CVODES through CasADi: for stiff strings."""

from __future__ import annotations

from threading import Lock
from typing import Any, final

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Equation, Evaluator
from tenscontrol.integrate.events import EventIntegrator, SmoothMotion, Step
from tenscontrol.integrate.integrator import Work
from tenscontrol.validation import FloatArray

# States that one call returns. Powers of two, so that outputs fall on them. Where strings can go
# slack they are looked at in each, so that a call should take about as many steps.
_LOOKS, _OUTPUTS = 64, 256

# A call that took more steps between two states may have missed a switch: it is done again.
_COARSE = 4.0

# CVODES gives up after so many steps between two states; the call is then cut short.
_MOST_STEPS = 2_000

# A call as short as this part of the span that still fails has met the end of the motion.
_SHORTEST = 1e-12


@final
class CVODES(EventIntegrator):
    """Implicit multistep method of orders 1 to 5 of SUNDIALS, by ``casadi.integrator``.

    Backward differentiation formulas with Newton's method, exact Jacobians and
    a sparse direct solver. The loop over steps runs in C. It ends where a
    string goes slack or taut, and begins again.

    Parameters
    ----------
    equation : Equation
    tolerance : float
        Error allowed a step, as part of the size of the structure for
        positions, and of its characteristic speed for velocities. Errors of
        the steps add up: the motion may be off by a hundred times as much.
    project : bool
        Whether to make the bar lengths of the states returned exact.

    Notes
    -----
    A Jacobian counts as as many evaluations as it has times the instructions
    of the right-hand side. Every call begins at order 1 with a tiny step.
    """

    name = "cvodes"

    def __init__(self, equation: Equation, tolerance: float, project: bool = True) -> None:
        super().__init__(equation, tolerance, project)
        self._grid = _LOOKS if equation.switches else _OUTPUTS
        built = self._kept(self._build, self.tolerance)
        self._long, self._hop, slopes, self._weight, self._calling = built
        self._slopes = Evaluator(slopes)

    def _build(self) -> tuple[ca.Function, ca.Function, ca.Function, int, Lock]:
        scaled = _scaled(self._equation)
        return (
            _solver(scaled, self._equation, self._grid, self.tolerance),
            _solver(scaled, self._equation, 1, self.tolerance),
            scaled.map("slopes", "serial", self._grid + 1, [1, 2, 3], []),
            jacobian_weight(scaled, state_jacobian(scaled)),
            Lock(),
        )

    def _begin(
        self,
        now: float,
        state: FloatArray,
        held: FloatArray,
        taut: FloatArray,
        times: FloatArray,
        before: SmoothMotion | None,
    ) -> SmoothMotion:
        window = before.window if isinstance(before, _Windows) else np.inf
        return _Windows(self, now, state, held, taut, times, window)


class _Windows:
    """Calls of the solver while no string switches, each over one window of time."""

    def __init__(
        self,
        method: CVODES,
        now: float,
        state: FloatArray,
        held: FloatArray,
        taut: FloatArray,
        times: FloatArray,
        window: float,
    ) -> None:
        self._method, self._now, self._state, self._times = method, now, state, times
        self._given, self.window = (held, taut, method._scale), window
        self._looked = len(taut) > 0
        self._done = Work()

    @property
    def work(self) -> Work:
        """What was done so far, landings included."""
        return self._done

    def step(self) -> Step:
        """Integrate over one window."""
        grid = self._method._grid
        while True:
            end = self._end()
            span = end - self._now
            states, stats = self._call(self._method._long, self._state, span)
            if states is None:
                if span <= _SHORTEST * self._times[-1]:
                    raise FloatingPointError("the step size vanishes")
                self.window = span / 4
                continue
            if not self._looked:
                self.window *= 2  # all that is left, unless a call had to be cut short
                break
            # As many states as steps, about: the last step tells, the first ones are tiny.
            fitting = 1.5 * grid * stats["hlast"] * span
            self.window = float(np.clip(fitting, span / 16, 4 * span))
            if stats["nsteps"] <= _COARSE * grid:
                break
        nodes = np.column_stack([self._state, states])
        times = np.linspace(self._now, end, grid + 1)
        self._now, self._state = end, nodes[:, -1]
        return Step(times, _Hermite(self, times, nodes), self._state)

    def land(self, step: Step, time: float) -> FloatArray:
        """Integrate again from the last state before."""
        before = int(np.searchsorted(step.times[1:-1], time, side="left"))
        start = step.between(step.times[before : before + 1])[:, 0]
        states, _ = self._call(self._method._hop, start, time - step.times[before])
        if states is None:
            raise FloatingPointError("the step size vanishes")
        return states[:, 0]

    def slopes(self, nodes: FloatArray) -> FloatArray:
        """Return ẋ at all states of a window."""
        self._done += Work(evaluations=nodes.shape[1])
        return self._method._slopes(nodes, *self._given)[0].copy()

    def _end(self) -> float:
        """Return where the next window ends: outputs must fall on its states, or end it."""
        times, now, grid = self._times, self._now, self._method._grid
        following = int(np.searchsorted(times, now, side="right"))
        whole = now == 0.0 or times[following - 1] == now
        # times[-1] may be off by a bit, so outputs are counted rather than divided by.
        most = min(self.window / (times[-1] / len(times)), len(times) - following, grid)
        if whole and most >= 1:
            return float(times[following - 1 + 2 ** int(np.log2(most))])
        return float(min(times[following], now + self.window))

    def _call(
        self, solver: ca.Function, state: FloatArray, span: float
    ) -> tuple[FloatArray | None, dict[str, Any]]:
        """Return the states over a span of time, None if the solver failed."""
        parameters = np.concatenate([[span], *self._given])
        with self._method._calling:  # the solver is shared, and keeps the figures of its last call
            try:
                states = np.array(solver(x0=state, p=parameters)["xf"])
            except RuntimeError as error:
                if "CVode returned" not in str(error):
                    raise
                states = None
            stats = solver.stats()
        # After a failure the counts reach up to the last state that was good.
        self._done += Work(
            steps=0 if states is None else stats["nsteps"],
            rejections=stats["netfails"] + stats["nncfails"],
            evaluations=stats["nfevals"] + self._method._weight * stats["nlinsetups"],
        )
        if states is not None and not np.isfinite(states).all():
            states = None
        return states, stats


class _Hermite:
    """Cubic interpolation between the states of a window, exact in the states."""

    def __init__(self, windows: _Windows, times: FloatArray, nodes: FloatArray) -> None:
        self._windows, self._times, self._nodes = windows, times, nodes
        self._slopes: FloatArray | None = None

    def __call__(self, times: FloatArray) -> FloatArray:
        last = len(self._times) - 1
        spacing = (self._times[-1] - self._times[0]) / last
        place = (times - self._times[0]) / spacing
        nearest = np.clip(np.rint(place), 0, last).astype(int)
        if (np.abs(times - self._times[nearest]) <= 4 * np.spacing(self._times[-1])).all():
            return self._nodes[:, nearest]
        if self._slopes is None:
            self._slopes = self._windows.slopes(self._nodes)
        i = np.clip(place.astype(int), 0, last - 1)
        s = place - i
        x0, x1 = self._nodes[:, i], self._nodes[:, i + 1]
        v0, v1 = spacing * self._slopes[:, i], spacing * self._slopes[:, i + 1]
        cubic = 2 * (x0 - x1) + v0 + v1
        states: FloatArray = x0 + s * (v0 + s * (x1 - x0 - v0 - (1 - s) * cubic))
        return states


def _scaled(equation: Equation) -> ca.Function:
    """Return ``(y, u, taut, scale) -> ydot`` for the state as part of its scale."""
    y, u, taut, _ = equation.symbols()
    scale = equation.symbol("scale", equation.states)
    slope = equation.slope(y * scale, u, taut) / scale
    return ca.Function("slope", [y, u, taut, scale], [slope])


def _solver(scaled: ca.Function, equation: Equation, outputs: int, tolerance: float) -> ca.Function:
    """Return the solver over the unit of time; the true span and the scale are parameters."""
    y, u, taut, scale = (equation.symbol(f"p{i}", scaled.size1_in(i)) for i in range(4))
    span = equation.symbol("span")
    problem = {
        "x": y,
        "p": ca.vertcat(span, u, taut, scale),
        "ode": span * scaled(y, u, taut, scale),
    }
    options = {
        "reltol": tolerance,
        "abstol": tolerance,
        "max_num_steps": _MOST_STEPS,
        # Failures are seen in what the call returns; CVODES would also print them.
        "disable_internal_warnings": True,
        "show_eval_warnings": False,
    }
    grid = (np.arange(1, outputs + 1) / outputs).tolist()
    return ca.integrator("solver", "cvodes", problem, 0.0, grid, options)


def state_jacobian(slope: ca.Function) -> ca.Function:
    """Return the derivative of a right-hand side by its first input, sparse; same inputs."""
    inputs = slope.sx_in()
    return ca.Function("jacobian", inputs, [ca.jacobian(slope(*inputs), inputs[0])])


def jacobian_weight(slope: ca.Function, jacobian: ca.Function) -> int:
    """Return how many evaluations of a right-hand side one of its Jacobian is worth."""
    inputs = slope.sx_in()
    written = ca.Function("written", inputs, [slope(*inputs)])  # in whatever form it comes
    return max(1, round(int(jacobian.n_instructions()) / int(written.n_instructions())))
