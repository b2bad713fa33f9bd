"""Methods with a fixed step, such as the Runge-Kutta method of order 4."""

from __future__ import annotations

from abc import abstractmethod
from functools import partial
from typing import Any, final

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.core.records import Progress
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import Evaluator, Function
from tenscontrol.integrate.core_run import (
    advance_in_core,
    reached,
    room_for,
    settings_of,
    spans_in_core,
)
from tenscontrol.integrate.core_scene import CoreMotion, core_scene
from tenscontrol.integrate.events import LATE, Landing, Step, Switches, crossings
from tenscontrol.integrate.integrator import (
    AdvancedSpans,
    IntegrationError,
    IntegrationInterrupt,
    Integrator,
    Report,
    Span,
    SpanInputs,
    Trace,
    Work,
    steps_between,
)
from tenscontrol.integrate.projection import projected
from tenscontrol.interrupt import check

# Steps from one report of the time to the next.
_BETWEEN_REPORTS = 32

# Substeps that a step may be cut into; the rest is then taken whole, and its switches counted.
SUBSTEPS = 9

# What is left of a step below this part of it is round-off.
REST = 1e-13

#: What is counted beside the steps: what is tried in those that are cut, each with the evaluations
#: of a step; landings on a switch, with two more; switches there, and in rests taken whole.
COUNTS = ("tries", "landings", "switches", "missed")
_TRIES, _MISSED = COUNTS.index("tries"), COUNTS.index("missed")


class FixedStep(Integrator):
    """A method with a fixed step: a subclass says what a step is.

    Where a string can go slack, every step ends at each switch and goes on from there, unless
    switches are not located.
    """

    #: Evaluations of the right-hand side, or of the forces, in one step.
    evaluations_per_step: int

    #: Whether the compiled core has the method.
    runs_in_core = False

    #: Whether steps end at switches. Else a step is a function of the state alone, not of ``taut``.
    locates = True

    def __init__(self, equation: Equation, step: float, project: bool = False) -> None:
        super().__init__(equation, project)
        self._project = project
        self.step = validation.positive_number("step", step, "s")
        self._core = core_scene(equation) if self.runs_in_core else None
        if self._core is not None:
            self.back_end = "core"
            return
        attempt = self._kept(lambda: self._attempt_of(self.smooth_step(project)), project)
        self._attempt, self._slope = Evaluator(attempt), Evaluator(equation.slope)
        self._switches = Switches(equation)

    def smooth_step(self, project: bool) -> ca.Function:
        """Return :meth:`step_function` of the method's own equation.

        Parameters
        ----------
        project : bool
            Whether a projection onto the bar lengths follows.
        """
        one = self.step_function(self._equation)
        return projected(one, self._equation) if project else one

    def _attempt_of(self, step: ca.Function) -> ca.Function:
        """Return ``(x, u, taut, h) -> (x1, count, crossed)``: a step, and what switches in it."""
        equation = self._equation
        written = step.is_a("SXFunction") and equation.form == "flat"
        x, u, taut, h = equation.symbols(ca.SX if written else ca.MX)
        x1 = step(x, u, taut, h)
        switching = [x1.zeros(1, 1), x1.zeros(0, 1)]
        if self.locates:
            switching = crossings(equation)(x, x1, u, taut, h)
        return Function("attempt", [x, u, taut, h], [ca.densify(x1), *map(ca.densify, switching)])

    @abstractmethod
    def step_function(self, equation: Equation) -> ca.Function:
        """Return ``(x, u, taut, h) -> x1``: one step for fixed ``taut``; u begins with it.

        Parameters
        ----------
        equation : Equation
        """

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
        layout, inner = self._equation.layout, self.steps_between(duration, outputs)
        total = outputs * inner
        step = duration / total
        states = np.empty((len(state), outputs))
        counts, done = np.zeros(len(COUNTS)), 0
        x, taut, trace = state, self._switches.taut(state, held), Trace(self.traces)
        try:
            # A state that is not finite is looked for, so NumPy need not warn of it.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                while done < total:
                    check()
                    u = layout.later(held, step * done)
                    tried = self._attempt(x, u, taut, step)
                    if tried[1][0]:
                        before = counts.copy()
                        x, taut = self._cut(x, tried, taut, u, step, counts, trace, step * done)
                        if not np.isfinite(x).all():
                            reached = Span(states[:, : done // inner], self.work_of(done, before))
                            raise IntegrationError(not_finite(done, step), step * done, reached)
                    else:
                        x = tried[0].copy()
                        trace.append(step * (done + 1), x, taut)
                    if (done + 1) % inner == 0:
                        states[:, done // inner] = x
                    done += 1
                    if report is not None and (done % _BETWEEN_REPORTS == 0 or done == total):
                        report(step * done)
        except KeyboardInterrupt:
            reached = Span(states[:, : done // inner], self.work_of(done, counts))
            raise IntegrationInterrupt(step * done, reached) from None
        return Span(states, self.work_of(total, counts), ends=trace.ends)

    def _cut(
        self, x: FloatArray, tried: list[FloatArray], taut: FloatArray, u: FloatArray, h: float,
        counts: FloatArray, trace: Trace, time: float,
    ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        """Return the state and ``taut`` after a step that was tried, cut at its switches.

        They are counted, and ends of its parts are kept.
        """
        left, later = h, self._equation.layout.later
        for _ in range(SUBSTEPS):
            begin = later(u, h - left)
            x1, (count,), crossed = (output.copy() for output in tried)
            if not count > 0:
                trace.append(time + h, x1, taut)
                return x1, taut
            slope = self._slope(x, begin, taut)[0].copy()
            slope1 = self._slope(x1, later(begin, left), taut)[0]
            step = Step(x, slope, x1, slope1, begin, taut, left, crossed)
            cut = self._switches.first(step, 0.0, 0.0 if self.traces else LATE)
            end = Landing(x1, taut)
            if cut is not None:
                end = self._switches.approach(step, cut, partial(self._end_of, step))
            counts += end.places, 1, end.switches, 0
            left -= end.part * left
            trace.append(time + h - left, end.x, taut)
            x, taut = end.x, end.taut
            if left <= REST * h:
                return x, taut
            tried = self._attempt(x, later(u, h - left), taut, left)
            counts[_TRIES] += 1
        x1, (count,), _ = tried
        counts[_MISSED] += max(count, 0)
        trace.append(time + h, x1, taut)
        return x1.copy(), self._switches.taut(x1, later(u, h))

    def _end_of(self, step: Step, part: float) -> FloatArray:
        """Return the state after a part of a step."""
        return self._attempt(step.x, step.u, step.taut, part * step.h)[0]

    def steps_between(self, duration: float, outputs: int) -> int:
        """Return the number of steps from one state that is kept to the next.

        Parameters
        ----------
        duration : float
            s.
        outputs : int
            States kept within it.
        """
        return steps_between(duration / outputs, self.step)

    def work_of(self, steps: int, counts: FloatArray) -> Work:
        """Return the work of some steps.

        Parameters
        ----------
        steps : int
        counts : ndarray, shape (4,)
            Those of :data:`COUNTS`.
        """
        tries, landings, switches, missed = (round(count) for count in counts)
        return Work(
            steps=steps + landings,
            evaluations=self.evaluations_per_step * (steps + tries) + 2 * landings,
            switches=switches,
            missed=missed,
        )


class RK4(FixedStep):
    """The classical Runge-Kutta method of order 4; see :class:`FixedStep`."""

    name = "rk4"
    evaluations_per_step = 4
    runs_in_core = True

    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        scene = self._core
        if scene is None:
            return super().advance(state, held, duration, outputs, report)
        state, held, duration, outputs = self._checked(state, held, duration, outputs, report)
        inner = self.steps_between(duration, outputs)
        step = duration / (inner * outputs)
        settings = settings_of(self.name, duration, outputs, self._project, step=self.step)
        if self.traces or (self.keeps_steps and inner > 1):
            settings.room, settings.traces = room_for(len(state)), self.traces
        motion = CoreMotion(scene, state, held, settings)

        def work(progress: Progress) -> Work:
            return work_in_core(progress, round(progress.time / step))

        def failure(motion: CoreMotion) -> IntegrationError:
            good = round(motion.progress.time / step) - 1
            outputs_so_far = reached(motion, work(motion.progress))
            return IntegrationError(not_finite(good, step), step * good, outputs_so_far)

        return advance_in_core(motion, work, failure, report)

    def advance_spans(self, state: FloatArray, given: SpanInputs) -> AdvancedSpans:
        """See :meth:`Integrator.advance_spans`."""
        if self._core is None:
            return AdvancedSpans()
        pairs = zip(given.duration, given.outputs, strict=True)
        inner = [self.steps_between(float(duration), int(count)) for duration, count in pairs]
        total = np.array(inner) * given.outputs
        settings = settings_of(self.name, 0.0, 0, self._project, step=self.step)
        if self.traces or (self.keeps_steps and max(inner) > 1):
            settings.room, settings.traces = room_for(len(state)), self.traces
            if not self.traces and min(inner) == 1:
                return AdvancedSpans()  # of some the ends of steps are kept, of some not
        return spans_in_core(
            self._core, state, given, settings,
            lambda counts, done: work_in_core(counts, int(total[:done].sum())),
        )  # fmt: skip

    def step_function(self, equation: Equation) -> ca.Function:
        """See :meth:`FixedStep.step_function`."""
        x, u, taut, h = equation.symbols()
        half, end = equation.ahead(u, h / 2), equation.ahead(u, h)

        def slope(x: Any, u: Any) -> Any:
            return equation.slope(x, u, taut if self.locates else equation.gap(x, u)[0] > 0)

        k1 = slope(x, u)
        k2 = slope(x + h / 2 * k1, half)
        k3 = slope(x + h / 2 * k2, half)
        k4 = slope(x + h * k3, end)
        return Function("rk4", [x, u, taut, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])


@final
class PlainRK4(RK4):
    """RK4 as textbooks have it: each evaluation finds what pulls and presses by its own state.

    Steps go through switches. There the error of a step is of order 2, or of order 1 where a damped
    string goes taut, whose force jumps. In return no step is tried again.
    """

    name = "rk4_plain"
    locates = False


def work_in_core(progress: Progress, steps: int) -> Work:
    """Return the work of RK4 in the core, in so many steps and those that switches cut off."""
    return Work(
        steps=steps + progress.landings,
        evaluations=4 * progress.tries + 2 * (progress.landings + progress.carries),
        switches=progress.switches,
        missed=progress.missed,
        carried=progress.carried,
    )


def not_finite(good: int, step: float) -> str:
    """Return what is said of a motion that ended after so many good steps."""
    return (
        f"the state is no longer finite between {step * good:.6g} s and "
        f"{step * (good + 1):.6g} s; try a step below {step:g} s"
    )
