"""Backward differentiation with error control, by CVODES through CasADi: for stiff strings."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import (
    ColumnEvaluator,
    Evaluator,
    Function,
    ProcessLock,
    SharedEvaluator,
    builds,
)
from tenscontrol.integrate.events import BAND, CHATTER, first_crossing, refuse_chatter
from tenscontrol.integrate.integrator import (
    IntegrationError,
    IntegrationInterrupt,
    IntegrationPause,
    Integrator,
    Report,
    Span,
    Work,
    checked_tolerance,
    largest_frequency,
    state_scale,
)
from tenscontrol.integrate.projection import NOT_RIGID, Projector
from tenscontrol.interrupt import at_once, check, interruptible

# States that one call returns. Powers of two, so that outputs fall on them. Where strings can go
# slack they are looked at in each, so that a call should take about as many steps.
_LOOKS, _OUTPUTS = 64, 256

# A call that took more steps between two states may have missed a switch: it is done again.
_COARSE = 4.0

# CVODES gives up after so many steps between two states; the call is then cut short.
_MOST_STEPS = 2_000

# A call as short as this part of the span that still fails has met the end of the motion.
_SHORTEST = 1e-12

# The first window of a motion that may take so many evaluations only, as part of the span.
_FIRST = 1e-3

# A landing is sought so many times at most: it is Newton's method with an almost exact start.
_NEWTON_STEPS = 8


@dataclass(frozen=True, eq=False)
class _Solvers:
    """What is built once for an equation and a tolerance, for ``y = x/scale``."""

    grid: int  # states that a call of ``window`` returns
    window: ca.Function
    hop: ca.Function  # to one time
    slopes: ca.Function  # at the start and all states of a window
    gap: ca.Function | None  # of each string; None where none can go slack
    weight: int  # evaluations that a Jacobian counts as
    calling: ProcessLock  # solvers are shared, and keep the figures of their last call


@final
class CVODES(Integrator):
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
        super().__init__(equation, project)
        self._projected = Projector(equation, project)
        self.tolerance = checked_tolerance(tolerance)
        self._scale: FloatArray | None = None  # set by the first motion
        self._window = 0.0  # s, with which the last motion ended
        self._solvers = self._kept(self._build, self.tolerance)
        self._slopes = Evaluator(self._solvers.slopes)
        gap = self._solvers.gap
        self._gap_of = None if gap is None else ColumnEvaluator(gap)

    @property
    def cost(self) -> float:
        """See :attr:`Integrator.cost`."""
        return 1.0 + 0.2 * self._equation.states

    def _gap_scale(self, held: FloatArray) -> float:
        """Return the largest length that round-off in a gap is a part of, m."""

        def build() -> SharedEvaluator:
            u = self._equation.symbols()[1]
            return SharedEvaluator(Function("scale", [u], [self._equation.gap_scale(u)]))

        return float(self._equation.prepared.get("gap scale", build)(held)[0].max())

    def _build(self) -> _Solvers:
        equation = self._equation
        grid = _LOOKS if equation.switches else _OUTPUTS
        scaled, gap = _scaled(equation), None
        if equation.switches:
            x, u, _, _ = equation.symbols()
            gap = Function("gap", [x, u], [equation.gap(x, u)[0]])
        return _Solvers(
            grid,
            _solver(scaled, equation, grid, self.tolerance),
            _solver(scaled, equation, 1, self.tolerance),
            # Of an input that is held there is one for all.
            scaled.map(
                "slopes", "serial", grid + 1, [2, 3] if equation.layout.degree else [1, 2, 3], []
            ),
            gap,
            jacobian_weight(scaled, state_jacobian(scaled, is_expandable(equation))),
            ProcessLock(),
        )

    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        state, held, duration, outputs = self._checked(state, held, duration, outputs, report)
        equation = self._equation
        if self._scale is None:
            frequency = largest_frequency(equation, state, held)
            self._scale = state_scale(equation, state, held, frequency)
        scale = self._scale
        times = duration * np.arange(1, outputs + 1) / outputs
        times[-1] = duration  # whatever round-off says
        states = np.empty((len(state), outputs))
        band = BAND
        if equation.switches and equation.structure is not None:
            band *= self._gap_scale(held)
        given = held, equation.layout.degree > 0, scale
        motion = _Motion(self._solvers, self._slopes, self._gap_of, band, given, times)
        done = 0
        try:
            # A state that is not finite is looked for, so NumPy need not warn of it.
            with interruptible(), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                motion.begin(state / scale)
                if self.limit < np.inf:  # a call does not end before its window does
                    motion.shorten(self._window or _FIRST * duration)
                while motion.now < duration:
                    check()
                    window = motion.next_window()
                    reached = int(np.searchsorted(times, motion.now, side="right"))
                    if reached > done:
                        states[:, done:reached] = window.between(times[done:reached])
                        if times[reached - 1] == motion.now:
                            states[:, reached - 1] = motion.state
                        done = reached
                    if report is not None:
                        report(motion.now)
                    motion.switch()
                    self._window = motion.window
                    if motion.now < duration and motion.work.evaluations >= self.limit:
                        raise self._pause(motion, states[:, :done], held, times[:done])
            exact = self._projected(states * scale[:, None], held, times)
            if exact.shape[1] < outputs:
                raise FloatingPointError(NOT_RIGID)
            return Span(exact, motion.work)
        except (FloatingPointError, KeyboardInterrupt) as error:
            reached_states = states[:, :done] * scale[:, None]
            so_far = Span(self._projected(reached_states, held, times[:done]), motion.work)
            if isinstance(error, KeyboardInterrupt):
                raise IntegrationInterrupt(motion.now, so_far) from None
            stopped = f"{self.name} stopped after {motion.now:.6g} s: {error}"
            raise IntegrationError(stopped, motion.now, so_far) from None

    def _pause(
        self, motion: _Motion, states: FloatArray, held: FloatArray, times: FloatArray
    ) -> IntegrationPause:
        """Return the pause of a motion that has reached these states, in units of the scale."""
        assert self._scale is not None  # found before the first window
        ends = np.column_stack([states, motion.state])
        ends = self._projected(ends * self._scale[:, None], held, np.append(times, motion.now))
        if ends.shape[1] <= states.shape[1]:
            raise FloatingPointError(NOT_RIGID)
        return IntegrationPause(motion.now, ends[:, -1], Span(ends[:, :-1], motion.work))


class _Motion:
    """Calls of the solver over one span, each over a window of time in which no string switches.

    Where a string passes the border of slack within a window, the window is cut there: the
    crossing is found on the interpolated states, the motion integrated again up to it, and the
    time corrected until the string is on the border. Strings that are there together switch
    together.
    """

    def __init__(
        self,
        solvers: _Solvers,
        slopes: Evaluator,
        gap: ColumnEvaluator | None,
        band: float,
        given: tuple[FloatArray, bool, FloatArray],
        times: FloatArray,
    ) -> None:
        self._solvers, self._slopes, self._gap_of, self._band = solvers, slopes, gap, band
        self._held, self._moves, self._scale = given
        self._times = times
        self.window = np.inf  # longest one, s
        self._taut = np.zeros(0)
        self._crossed: FloatArray | None = None  # 1 for each string that switches now
        self._landings = deque([-float(times[-1])], maxlen=CHATTER)
        self.now, self.work = 0.0, Work()

    def begin(self, state: FloatArray) -> None:
        """Start from a state, with the strings that pull in it."""
        self.state = state
        if self._gap_of is not None:
            gap = self._gap(self._gap_of, state[:, None], np.zeros(1))
            self._taut = (gap[:, 0] > 0).astype(float)

    def shorten(self, window: float) -> None:
        """Begin with a window of a length, s; the following ones grow as the steps do."""
        self.window = window

    def next_window(self) -> _Window:
        """Integrate over one window, up to its end or the first switch within it."""
        window = self._integrated()
        self.now, self.state = float(window.times[-1]), window.nodes[:, -1]
        if self._gap_of is not None:
            self._land(window, self._gap_of)
        return window

    def switch(self) -> None:
        """Let the strings go slack or taut that are on the border now."""
        if self._crossed is not None:
            self._taut = np.abs(self._taut - self._crossed)
            self._crossed = None
            refuse_chatter(self._landings, self.now, float(self._times[-1]))

    def _integrated(self) -> _Window:
        grid = self._solvers.grid
        while True:
            end = self._end()
            span = end - self.now
            if span <= 0:  # windows have become shorter than time is told apart
                raise FloatingPointError("the step size vanishes")
            states, stats = self._call(self._solvers.window, self.state, self.now, span)
            if states is None:
                if span <= _SHORTEST * self._times[-1]:
                    raise FloatingPointError("the step size vanishes")
                self.window = span / 4
                continue
            if self._gap_of is None:
                self.window *= 2  # all that is left, unless a call had to be cut short
                break
            # As many states as steps, about: the last step tells, the first ones are tiny.
            fitting = 1.5 * grid * stats["hlast"] * span
            self.window = float(np.clip(fitting, span / 16, 4 * span))
            if stats["nsteps"] <= _COARSE * grid or span <= _SHORTEST * self._times[-1]:
                break
            # Its last step may be long where the first ones are many.
            self.window = min(self.window, span / 2)
        nodes = np.column_stack([self.state, states])
        return _Window(np.linspace(self.now, end, grid + 1), nodes, self._slopes_at)

    def _inputs(self, times: FloatArray) -> FloatArray:
        """Return the inputs that begin at times, one a column."""
        inputs = np.broadcast_to(self._held[:, None], (len(self._held), len(times)))
        if self._moves:
            inputs = inputs.copy()
            inputs[-1] += times
        return inputs

    def _gap(self, gap_of: ColumnEvaluator, states: FloatArray, times: FloatArray) -> FloatArray:
        return gap_of(states * self._scale[:, None], self._inputs(times))[0]

    def _land(self, window: _Window, gap_of: ColumnEvaluator) -> None:
        """Go back to the first switch within a window, if there is one."""
        sign = np.where(self._taut > 0, 1.0, -1.0)[:, None]

        def room_in(states: FloatArray, times: FloatArray) -> FloatArray:
            """Return the room of each string in bands: 1 on the border, 0 where it switches."""
            return sign * self._gap(gap_of, states, times) / self._band + 1.0

        def room(times: FloatArray) -> FloatArray:
            return room_in(window.between(times), times)

        start, end = float(window.times[0]), float(window.times[-1])
        time = first_crossing(room, window.times)
        if time is None:
            return
        if time - start <= 4 * np.spacing(end):
            # Past the border already, by less than the interpolation of the last window saw.
            room_at_start = room(window.times[:1])[:, 0]
            self._crossed = (room_at_start <= max(0.5, float(room_at_start.min()))).astype(float)
            self.now, self.state = start, window.nodes[:, 0]
            self.work += Work(missed=int(self._crossed.sum()))
            return
        apart = 1e-3 * (end - start)
        for _ in range(_NEWTON_STEPS):
            state = self._state_at(window, time)
            left = room_in(state[:, None], np.array([time]))[:, 0]
            if abs(left.min()) < 0.25:
                break
            around = room(np.array([time - apart, time + apart]))[left.argmin()]
            rate = (around[1] - around[0]) / (2 * apart)
            if not rate < 0:
                break  # it grazes the border: an ordinary end of a window
            time = float(np.clip(time - left.min() / rate, start + 1e-3 * apart, end))
        self._crossed = (left < 0.5).astype(float)
        self.now, self.state = time, state
        self.work += Work(switches=int(self._crossed.sum()))

    def _state_at(self, window: _Window, time: float) -> FloatArray:
        """Integrate again from the last state before."""
        before = int(np.searchsorted(window.times[1:-1], time, side="left"))
        span = time - window.times[before]
        start = float(window.times[before])
        states, _ = self._call(self._solvers.hop, window.nodes[:, before], start, span)
        if states is None:
            raise FloatingPointError("the step size vanishes")
        return states[:, 0]

    def _slopes_at(self, nodes: FloatArray, times: FloatArray) -> FloatArray:
        """Return ẋ at all states of a window."""
        self.work += Work(evaluations=nodes.shape[1])
        inputs = self._inputs(times) if self._moves else self._held
        return self._slopes(nodes, inputs, self._taut, self._scale)[0].copy()

    def _end(self) -> float:
        """Return where the next window ends: outputs must fall on its states, or end it."""
        times, now = self._times, self.now
        following = int(np.searchsorted(times, now, side="right"))
        whole = now == 0.0 or times[following - 1] == now
        # times[-1] may be off by a bit, so outputs are counted rather than divided by.
        fitting = self.window / (times[-1] / len(times))
        most = min(fitting, len(times) - following, self._solvers.grid)
        if whole and most >= 1:
            return float(times[following - 1 + 2 ** int(np.log2(most))])
        return float(min(times[following], now + self.window))

    def _call(
        self, solver: ca.Function, state: FloatArray, start: float, span: float
    ) -> tuple[FloatArray | None, dict[str, Any]]:
        """Return the states over a span of time, None if the solver failed."""
        held = self._inputs(np.array([start]))[:, 0]
        parameters = np.concatenate([[span], held, self._taut, self._scale])
        with self._solvers.calling:
            try:
                with at_once():  # a call may take minutes, and ends at what a handler raises
                    result = solver(x0=state, p=parameters)
                states = np.array(result["xf"])
            except (RuntimeError, SystemError) as error:
                check()  # CVODES takes KeyboardInterrupt for a failure of the right-hand side
                if "CVode returned" not in str(error):
                    raise
                states = None
            stats = solver.stats()
        # After a failure the counts reach up to the last state that was good.
        self.work += Work(
            steps=0 if states is None else stats["nsteps"],
            rejections=stats["netfails"] + stats["nncfails"],
            evaluations=stats["nfevals"] + self._solvers.weight * stats["nlinsetups"],
        )
        if states is not None and not np.isfinite(states).all():
            states = None
        return states, stats


class _Window:
    """The motion over a window: cubic interpolation between its states, exact in the states."""

    def __init__(
        self,
        times: FloatArray,
        nodes: FloatArray,
        slopes_at: Callable[[FloatArray, FloatArray], FloatArray],
    ) -> None:
        self.times, self.nodes = times, nodes  # equally spaced; one state a column
        self._slopes_at = slopes_at
        self._slopes: FloatArray | None = None

    def between(self, times: FloatArray) -> FloatArray:
        """Return the states at some times, one a column."""
        last = len(self.times) - 1
        spacing = (self.times[-1] - self.times[0]) / last
        index = (times - self.times[0]) / spacing
        nearest = np.clip(np.rint(index), 0, last).astype(int)
        if (np.abs(times - self.times[nearest]) <= 4 * np.spacing(self.times[-1])).all():
            return self.nodes[:, nearest]
        if self._slopes is None:
            self._slopes = self._slopes_at(self.nodes, self.times)
        i = np.clip(index.astype(int), 0, last - 1)
        s = index - i
        x0, x1 = self.nodes[:, i], self.nodes[:, i + 1]
        v0, v1 = spacing * self._slopes[:, i], spacing * self._slopes[:, i + 1]
        cubic = 2 * (x0 - x1) + v0 + v1
        states: FloatArray = x0 + s * (v0 + s * (x1 - x0 - v0 - (1 - s) * cubic))
        return states


def _scaled(equation: Equation) -> ca.Function:
    """Return ``(y, u, taut, scale) -> ydot`` for the state as part of its scale."""
    y, u, taut, _ = equation.symbols()
    scale = equation.symbol("scale", equation.states)
    slope = equation.slope(y * scale, u, taut) / scale
    return Function("slope", [y, u, taut, scale], [slope])


def _solver(scaled: ca.Function, equation: Equation, outputs: int, tolerance: float) -> ca.Function:
    """Return the solver over the unit of time; the true span and the scale are parameters."""
    y, u, taut, scale = (equation.symbol(f"p{i}", scaled.size1_in(i)) for i in range(4))
    span, time = equation.symbol("span"), equation.symbol("time")
    problem = {
        "x": y,
        "p": ca.vertcat(span, u, taut, scale),
        "ode": span * scaled(y, equation.ahead(u, span * time), taut, scale),
    }
    if equation.layout.degree:
        problem["t"] = time
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


def is_expandable(equation: Equation) -> bool:
    """Whether its functions can be written out in SX: in MX, bars that share nodes cannot."""
    structure = equation.structure
    return structure is None or not structure.blocks or bool(equation.slope.is_a("SXFunction"))


@builds
def state_jacobian(slope: ca.Function, expand: bool = True) -> ca.Function:
    """Return the derivative of a right-hand side by its first input, sparse; same inputs."""
    inputs = slope.sx_in() if expand else slope.mx_in()
    return Function("jacobian", inputs, [ca.jacobian(slope(*inputs), inputs[0])])


@builds
def jacobian_weight(slope: ca.Function, jacobian: ca.Function) -> int:
    """Return how many evaluations of a right-hand side one of its Jacobian is worth."""
    if not jacobian.is_a("SXFunction"):  # by directions
        return int(jacobian.sparsity_out(0).uni_coloring().size2())
    inputs = slope.sx_in()
    written = Function("written", inputs, [slope(*inputs)])  # in whatever form it comes
    return max(1, round(int(jacobian.n_instructions()) / int(written.n_instructions())))
