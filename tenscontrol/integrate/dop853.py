"""The Dormand-Prince method of order 8 with error control."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from itertools import accumulate, cycle, islice
from math import factorial
from operator import mul
from typing import Any, NamedTuple, final

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.core.records import Progress, Settings, Spans
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import Evaluator, Function
from tenscontrol.integrate import dop853_coefficients as dormand_prince
from tenscontrol.integrate.core_run import (
    advance_in_core,
    reached,
    room_for,
    settings_of,
    spans_in_core,
)
from tenscontrol.integrate.core_scene import CoreMotion, core_scene
from tenscontrol.integrate.events import Landing, Step, Switches, crossings, path
from tenscontrol.integrate.integrator import (
    AdvancedSpans,
    FloatOrArray,
    IntegrationError,
    IntegrationInterrupt,
    IntegrationPause,
    Integrator,
    Report,
    Span,
    SpanInputs,
    Trace,
    Work,
    checked_tolerance,
    largest_frequency,
    length_and_mass,
    state_scale,
)
from tenscontrol.integrate.projection import NOT_RIGID, Projector, projection, put_on_lengths
from tenscontrol.interrupt import check

# Evaluations of a step whose first slope is known, of its interpolant, and of a step of order 5.
_STAGES, _MORE_STAGES, _SHORT_STAGES = 12, 3, 6

# Coefficients of the interpolant.
_POWERS = 7

# Steps tried from one report of the time, and look at the limit of evaluations, to the next.
_TRIES = 32

# How a step follows an error that is too large: by a factor 0.75 error^(-1/8) within these bounds.
_SAFETY, _LEAST, _MOST, _ORDER = 0.75, 0.2, 10.0, 8

# After a step that is taken: by 0.832 (last / error³)^0.04, PI control by its error and that of the
# step before, which counts as the last of these at least. It aims at the same error.
_DAMPED, _FEEDBACK, _SMALLEST = 0.832, 0.04, 1e-4

# Steps longer than 1/ω err by the phase of the fastest vibration. Once one was thrown away, they
# grow by this factor at most, lest every third is.
_GROWTH = 1.2

# A step shorter than this part of the span is lost in round-off.
_SHORTEST = 10 * float(np.finfo(float).eps)

# The longest step times the largest frequency at the start: round-off grows from 5.9 on. Where the
# frequency is higher later, the error of a step keeps what grows below what it may be.
_STABLE = 5.0

# Where it limits the steps, this is what a tenth of the tolerance makes of them: its eighth root.
_SHORTER = 0.75


class StepRules(NamedTuple):
    """The longest step over 1/ω and over the span, and the first over the usual.

    And ``smooth``: steps end at a switch on their interpolant where that errs less than this part
    of what they may err; ``loose``: the tolerance above which the core goes across switches;
    ``path``: as ``smooth``, of outputs on the path from the ends of a step.
    """

    stable: float
    whole: float
    first: float
    smooth: float
    loose: float
    path: float

    @property
    def within(self) -> tuple[float, float, float]:
        """What is allowed within a step: the last three."""
        return self.smooth, self.loose, self.path


#: By whether steps are shortened. What ends on an interpolant errs by chance: where stability
#: limits the steps, a tenth of the tolerance alone makes no tenth of it. Nor does it of outputs on
#: a path, so there are none then; else they may err what steps aim at. Switches are passed as by
#: the run of ten times the tolerance.
STEP_RULES = (
    StepRules(_STABLE, 1.0, 1.0, 0.3, 3e-5, 0.1),
    StepRules(_SHORTER * _STABLE, 0.5, _SHORTER, 0.03, 3e-6, 0.0),
)

# Where steps are traced, the longest one times the largest frequency, over the eighth root of the
# tolerance. Small changes move along all vibrations, and the fastest sets their error, though the
# motion itself may not move along it.
_TRACED = 14.0

# What a path from the ends of a step errs of positions, and times the step of velocities, at most
# along it: so many times what the embedded order 5 errs of positions, at the leading order, h⁶.
_PATH_OF_POSITIONS, _PATH_OF_VELOCITIES = 1.61, 5.52

# What ending late at a switch may change of velocities, as part of what a step may err.
_LATE = 0.003

# The frequency is found again where an input has changed by more than this part of it.
_CHANGED = 0.2

# Switches in a row without any time between them, at most.
_MOST_STALLS = 50


@final
class DOP853(Integrator):
    """Adaptive steps of order 8.

    Where a string can go slack, every step ends at each switch. In the
    compiled core a step with many of them carries them, and the next is of
    order 5; under a loose tolerance steps of order 5 go across them.

    Parameters
    ----------
    equation : Equation
    tolerance : float
        Error allowed a step, as part of the size of the structure for
        positions, and of its characteristic speed for velocities.
    project : bool
        Whether to make the bar lengths exact after each step.

    Notes
    -----
    E. Hairer, S. P. Nørsett & G. Wanner, *Solving Ordinary Differential Equations I*, 2nd ed.,
    II.5 (coefficients, error estimate) and II.6 (interpolant).
    """

    name = "dop853"

    def __init__(self, equation: Equation, tolerance: float, project: bool = True) -> None:
        super().__init__(equation, project)
        self._project = project
        self.tolerance = checked_tolerance(tolerance)
        self._frequency = 0.0  # largest, rad/s
        self._is_shortened = False
        self._held: FloatArray | None = None  # input for which it was found
        self._core = core_scene(equation)
        if self._core is not None:
            self.back_end = "core"
            return
        built = self._kept(lambda: self._build(project), project)
        self._tried, self._interpolant, self._inside = map(Evaluator, built)
        self._slope, self._switches = Evaluator(equation.slope), Switches(equation)
        self._projected = Projector(equation, project)
        self._path: Evaluator | None = None
        if equation.structure is not None:  # states are positions and velocities
            self._path = Evaluator(self._kept(partial(path, equation), "path"))

    @property
    def cost(self) -> float:
        """See :attr:`Integrator.cost`."""
        states = self._equation.states
        if self.back_end == "core":
            return cost_in_core(states)
        return 5.0 + 0.025 * states if self._equation.form == "loops" else 0.3 + 0.1 * states

    def _build(self, project: bool) -> tuple[ca.Function, ...]:
        """Return the step, its interpolant, and what that gives inside the step."""
        method = _DormandPrince(self._equation, project)
        return method.tried(), method.interpolant(), method.inside()

    def shorten(self) -> None:
        """See :meth:`Integrator.shorten`."""
        self._is_shortened = True

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
        of_strings = held[: self._equation.layout.strings]
        if self._held is None or have_changed(of_strings[None], self._held)[0]:
            self._frequency = largest_frequency(self._equation, state, held)
            self._held = of_strings.copy()
        if self._core is not None:
            own = self._own
            settings = self._settings(duration, outputs, own)
            motion = CoreMotion(self._core, state, held, settings, self._rules(own))
            span = advance_in_core(motion, work_of, _core_failure, report)
            if not (validation.is_bounded(motion.whole) or np.isfinite(span.states).all()):
                good = np.isfinite(span.states).all(axis=0)
                raise _not_rigid(
                    duration / outputs, span.states[:, : int(good.argmin())], span.work
                )
            return span
        scale = state_scale(self._equation, state, held, self._frequency)
        taut = self._switches.taut(state, held)
        slope = self._slope(state, held, taut)[0].copy()
        steps = steps_of(slope, scale, self._frequency, duration, self._own)
        step, longest = map(float, steps)
        allowed = self.tolerance * scale
        states = np.empty((outputs, self._equation.states))
        given = _Given(
            held, duration, duration / outputs, longest, allowed, states, Trace(self.traces)
        )
        return self._advance(given, _Motion(state, slope, taut, step), report)

    def advance_spans(self, state: FloatArray, given: SpanInputs) -> AdvancedSpans:
        """See :meth:`Integrator.advance_spans`."""
        if self._core is None or self._held is None:
            return AdvancedSpans()
        of_strings = given.held[:, : self._equation.layout.strings]
        count = int(np.append(have_changed(of_strings, self._held), True).argmax())
        if not count:
            return AdvancedSpans()
        own = self._own
        settings, rules = self._settings(0.0, 0, own), self._rules(own)
        return spans_in_core(self._core, state, given.first(count), settings, work_of, rules)

    def _settings(self, duration: float, outputs: int, own: StepRules) -> Settings:
        """Return the settings of a span in the core."""
        room = room_for(self._equation.states) if self.keeps_steps or self.traces else 0
        return settings_of(
            "dop853", duration, outputs, self._project, limit=self.limit, room=room,
            traces=self.traces, within=own.within,
        )  # fmt: skip

    def _rules(self, own: StepRules) -> Spans:
        """Return by what the core finds steps, and what they may err."""
        length, mass = length_and_mass(self._equation)
        return Spans(
            tolerance=self.tolerance, length=length, mass=mass, frequency=self._frequency,
            first=own.first, whole=own.whole, stable=own.stable,
        )  # fmt: skip

    def _advance(self, span: _Given, now: _Motion, report: Report | None) -> Span:
        """Return the states at the outputs of a span."""
        try:
            # A state that is not finite is looked for, so NumPy need not warn of it.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                self._go_on(span, now, report)
            times = span.spacing * np.arange(1, len(span.states))
            exact = self._projected(span.states[:-1].T, span.held, times)
            if exact.shape[1] < len(span.states) - 1:
                raise _not_rigid(span.spacing, exact, now.work)
            span.states[:-1], span.states[-1] = exact.T, now.x
            return Span(span.states.T, now.work, ends=span.trace.ends)
        except KeyboardInterrupt:
            raise IntegrationInterrupt(now.time, self._reached(span, now)) from None

    def _go_on(self, span: _Given, now: _Motion, report: Report | None) -> None:
        """Try steps up to the end of the span."""
        while now.time < span.duration:
            check()
            self._try_step(span, now)
            is_over = now.time >= span.duration
            if now.is_stuck:
                raise _stuck(now.time, now.step, self._reached(span, now))
            if is_over or now.tries % _TRIES == 0:
                if report is not None:
                    report(now.time)
                if not is_over and now.work.evaluations >= self.limit:
                    raise IntegrationPause(now.time, now.x, self._reached(span, now))

    def _reached(self, span: _Given, now: _Motion) -> Span:
        """Return the outputs so far."""
        times = span.spacing * np.arange(1, now.done + 1)
        states = self._projected(span.states[: now.done].T, span.held, times)
        return Span(states, now.work, ends=span.trace.ends)

    def _try_step(self, span: _Given, now: _Motion) -> None:
        """Try a step: it is accepted, cut at a switch, or thrown away."""
        layout, h = self._equation.layout, min(now.step, span.longest, span.duration - now.time)
        x, f, taut, u = now.x, now.slope, now.taut, layout.later(span.held, now.time)
        x1, f1, numbers, K, crossed = self._tried(x, f, u, taut, h, span.allowed)
        error, switches = numbers.tolist()
        now.tries += 1
        if not error < 1:
            shorter = max(float(_SAFETY * error ** (-1 / _ORDER)), _LEAST)
            now.step = h * (min(shorter, 1.0) if error < np.inf else _LEAST / 2)
            now.rejections += 1
            now.is_stuck = now.step < _SHORTEST * span.duration
            return
        end, interpolant = Landing(x1, taut), None
        if switches > 0:
            step = Step(x, f, x1, f1, u, taut, h, crossed)
            end, interpolant = self._landed(step, K, error, span, now)
        taken = end.part * h
        is_last = taken >= span.duration - now.time
        after = span.duration if is_last else now.time + taken
        # A step may reach a time but for round-off, as one to a switch may.
        done = min(int(after * (1 + 2e-14) / span.spacing), len(span.states) - 1)
        if done > now.done:
            times = span.spacing * np.arange(now.done + 1.0, done + 1.0) - now.time
            quintic = self._path if self._own.path else None
            if interpolant is not None:
                states = _on_interpolant(x, interpolant, times / h)
            elif quintic is not None and self._path_error(K, span, taken) < self._own.path:
                states = _on_path(quintic(x, f, end.x, f1, taken)[0], times / taken, taken)
            else:
                interpolant = self._interpolant(x, end.x, f, f1, K, u, taut, taken)[0]
                now.interpolants += 1
                states = _on_interpolant(x, interpolant, times / taken)
            span.states[now.done : done] = states
        now.x, now.taut, now.time, now.done = end.x.copy(), end.taut, after, done
        span.trace.append(after, now.x, taut)
        factor = _factor(error, now.last)
        if now.rejections:
            factor = min(factor, max(span.longest / (_STABLE * h), _GROWTH))
        if switches > 0:
            now.landings += 1
            now.stalls = now.stalls + 1 if taken < _SHORTEST * span.duration else 0
            now.is_stuck = now.stalls > _MOST_STALLS
            # The slope jumps with the strings.
            now.slope = self._slope(now.x, layout.later(u, taken), now.taut)[0].copy()
            factor = min(factor, 1.0)
        else:
            now.slope = f1.copy()
        now.step, now.last = h * factor, error

    def _path_error(self, K: FloatArray, span: _Given, taken: float) -> float:
        """Return what the path from the ends of a step errs, as part of what a step may err."""
        half = len(span.allowed) // 2
        off = (K @ dormand_prince.E5)[:half]
        of_positions = _PATH_OF_POSITIONS * taken * off / span.allowed[:half]
        of_velocities = _PATH_OF_VELOCITIES * off / span.allowed[half:]
        return float(np.sqrt(np.mean(of_positions**2 + of_velocities**2) / 2))

    @property
    def _own(self) -> StepRules:
        rules = STEP_RULES[self._is_shortened]
        if not self.traces:
            return rules
        return rules._replace(stable=min(rules.stable, _TRACED * self.tolerance ** (1 / _ORDER)))

    def _landed(
        self, step: Step, K: FloatArray, error: float, span: _Given, now: _Motion
    ) -> tuple[Landing, FloatArray | None]:
        """Return the end of a step at its first switch, and the interpolant of the whole if made.

        It is on the interpolant where that is good enough, else found by true steps, whose slopes
        are then what the evaluator of steps holds. K are those of the stages.
        """
        # What ending late may change of velocities, as part of what a step may err.
        exact = span.trace.wanted
        allowed = 0.0 if exact else 2 * _LATE * span.allowed[-1] * (span.longest / _STABLE) ** 2
        cut = self._switches.first(step, allowed, 0.0)
        if cut is None:
            return Landing(step.x1, step.taut), None
        interpolant: FloatArray | None = None
        off = error * abs(np.polynomial.polynomial.polyval(cut.part, _interpolant_error()))
        if off < self._own.smooth and not exact:
            ends = step.x, step.x1, step.slope, step.slope1
            interpolant = self._interpolant(*ends, K, step.u, step.taut, step.h)[0]
            now.interpolants += 1
        landing = self._switches.approach(
            step, cut, partial(self._state_at, step, interpolant, span.allowed)
        )
        now.approaches += landing.places if interpolant is None else 0
        now.switches += landing.switches
        return landing, interpolant

    def _state_at(
        self, step: Step, interpolant: FloatArray | None, allowed: FloatArray, part: float
    ) -> FloatArray:
        """Return the state after a part of a step, by its interpolant or by a step."""
        if interpolant is not None:
            return self._inside(step.x, interpolant, step.u, step.h, part)[0]
        return self._tried(step.x, step.slope, step.u, step.taut, part * step.h, allowed)[0]


@dataclass(frozen=True, eq=False)
class _Given:
    """A span that is advanced over."""

    held: FloatArray
    duration: float
    spacing: float  # of the outputs, s
    longest: float  # step, s
    allowed: FloatArray  # error of a step
    states: FloatArray  # at the outputs, one a row
    trace: Trace


@dataclass(eq=False)
class _Motion:
    """A motion up to a time within the span, and its counts."""

    x: FloatArray
    slope: FloatArray
    taut: FloatArray
    step: float  # to try next, s
    last: float = 0.0  # error of the step before
    time: float = 0.0
    is_stuck: bool = False
    stalls: int = 0  # switches in a row without any time between them
    done: int = 0  # outputs
    tries: int = 0
    rejections: int = 0
    landings: int = 0
    approaches: int = 0  # steps to a switch
    switches: int = 0
    interpolants: int = 0

    @property
    def work(self) -> Work:
        """What the motion cost."""
        return work_of(self)


def cost_in_core(states: int) -> float:
    """Return :attr:`Integrator.cost` in the core."""
    return 0.02 + 0.005 * states


def steps_of(
    slope: FloatArray, scale: FloatArray, frequency: FloatOrArray, duration: float,
    rules: StepRules,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Return the first and the longest step, s, of one run or several, slopes (…, states).

    The first moves the state by a hundredth of its scale.
    """
    speed = np.max(np.abs(slope) / scale, axis=-1, initial=0.0)
    return (
        rules.first * np.minimum(0.01 / np.fmax(speed, 1e-300), duration),
        np.minimum(rules.stable / np.maximum(frequency, 1e-300), rules.whole * duration),
    )


def _not_rigid(spacing: float, states: FloatArray, work: Work) -> IntegrationError:
    """Return the error of outputs whose bars cannot be put on their lengths after these states."""
    time = spacing * states.shape[1]
    stopped = f"dop853 stopped after {time:.6g} s: {NOT_RIGID}"
    return IntegrationError(stopped, time, Span(states, work))


def have_changed(of_strings: FloatArray, before: FloatArray) -> np.ndarray:
    """Return which inputs of strings, (K, strings), ask for another frequency than those before."""
    return np.asarray((np.abs(of_strings - before) > _CHANGED * np.abs(before)).any(axis=1))


def work_of(counts: _Motion | Progress, spans: int = 1) -> Work:
    """Return the work of a motion over so many spans by the counts of either loop."""
    tries, rejections, more, carried = counts.tries, counts.rejections, 0, 0
    if isinstance(counts, Progress):  # switches are carried in the core alone
        more = (_SHORT_STAGES - _STAGES) * counts.short_tries + counts.carries
        carried = counts.carried
    # Each span begins with an evaluation, and a landing takes a new start.
    evaluations = spans + counts.landings + _STAGES * (tries + counts.approaches)
    evaluations += _MORE_STAGES * counts.interpolants + more
    return Work(tries - rejections, rejections, evaluations, counts.switches, carried=carried)


def _stuck(time: float, step: float, reached: Span) -> IntegrationError:
    return IntegrationError(
        f"dop853 stopped after {time:.6g} s: its step fell to {step:.1e} s, as the forces are no "
        "longer finite or change without end; where bars that share nodes come to a dead centre, "
        "longer steps may cross it: try a larger tolerance",
        time,
        reached,
    )


def _core_failure(motion: CoreMotion) -> IntegrationError:
    progress = motion.progress
    return _stuck(progress.time, progress.step, reached(motion, work_of(progress)))


def _factor(error: float, last: float) -> float:
    """Return by how much the step grows after an error, and that of the step before."""
    error, last = max(error, 1e-16), max(last, _SMALLEST)
    wanted = float(_DAMPED * (last / (error * error * error)) ** _FEEDBACK)
    return min(max(wanted, _LEAST), _MOST)


def _factors(part: Any) -> list[Any]:
    """Return what the coefficients of the interpolant count by at a part of the step, or several.

    Coefficient k counts by k factors: the part, what is left of the step, and so on in turns.
    """
    return list(accumulate(islice(cycle([part, 1 - part]), _POWERS), mul))


def _on_interpolant(x: FloatArray, interpolant: FloatArray, parts: FloatArray) -> FloatArray:
    """Return the states, one a row, at parts of the step of an interpolant."""
    return x + np.array(_factors(parts)).T @ interpolant.T


def _on_path(coefficients: FloatArray, parts: FloatArray, h: float) -> FloatArray:
    """Return the states, one a row, at parts of a step on a path: column k counts by power k."""
    powers = np.arange(coefficients.shape[1])
    positions = coefficients @ parts ** powers[:, None]
    velocities = coefficients[:, 1:] * powers[1:] @ parts ** powers[:-1, None] / h
    return np.vstack([positions, velocities]).T


@cache
def _interpolant_error() -> tuple[float, ...]:
    """Return what the interpolant errs at a part of a step, as part of the error estimate.

    Of an equation that is linear, at the leading order: both are then multiples of the same term in
    h⁸. Coefficients of the polynomial in the part, from the lowest on.
    """
    count = _STAGES + 1 + _MORE_STAGES
    # In numbers of Python: sums in BLAS differ from machine to machine.
    A = np.zeros((count, count), dtype=object)
    A[:_STAGES, :_STAGES], A[_STAGES, :_STAGES] = dormand_prince.A, dormand_prince.B
    A[_STAGES + 1 :] = dormand_prince.A_EXTRA
    B, D, E3, E5 = (
        array.astype(object)
        for array in (dormand_prince.B, dormand_prince.D, dormand_prince.E3, dormand_prince.E5)
    )
    slopes = [np.ones(count).astype(object)]  # of the stages at each order of h, from 0 to 7
    for _ in range(1, _ORDER):
        slopes.append(A @ slopes[-1])
    last, s = slopes[-1], np.polynomial.Polynomial([0.0, 1.0])
    step = B @ last[:_STAGES]
    polynomial = np.polynomial.Polynomial([0.0])
    coefficients = [step, last[0] - step, 2 * step - last[0] - last[_STAGES], *(D @ last)]
    for k in reversed(range(_POWERS)):
        polynomial = (polynomial + coefficients[k]) * (1 - s if k % 2 else s)
    third, fifth = (e @ slopes[k][: _STAGES + 1] for e, k in ((E3, 3), (E5, 5)))
    true = s**_ORDER / factorial(_ORDER)
    # The estimate is the fifth by the root of its square and of a hundredth of that of the third.
    return tuple(((true - polynomial) * 0.1 * abs(third) / fifth**2).coef.tolist())


class _DormandPrince:
    """One step of the method for fixed ``taut``, as CasADi functions."""

    def __init__(self, equation: Equation, project: bool = False) -> None:
        self._equation = equation
        self._project = projection(equation) if project else None
        x, *rest = equation.symbols(ca.MX)
        self._inputs = [x, ca.MX.sym("f", x.shape), *rest]

    def _stages(self) -> tuple[Any, list[Any]]:
        """Return x after the step, and the slopes of its stages."""
        x, f, _, taut, h = self._inputs
        slopes = [f]
        for a, c in zip(dormand_prince.A[1:], dormand_prince.C[1:], strict=True):
            slopes.append(self._equation.slope(x + h * _combined(slopes, a), self._at(c), taut))
        x1 = x + h * _combined(slopes, dormand_prince.B)
        if self._project is not None:
            x1 = put_on_lengths(self._project, x1, self._at(1.0))
        return x1, slopes

    def _at(self, fraction: float) -> Any:
        """Return the input that begins after a part of the step."""
        _, _, u, _, h = self._inputs
        return self._equation.ahead(u, fraction * h)

    def tried(self) -> ca.Function:
        """Return ``(x, f, u, taut, h, scale) -> (x1, f1, (error, switches), K, crossed)``.

        The error is the root mean square over the state, as part of ``scale``; see
        :func:`crossings` for what is crossed.
        """
        x, _, u, taut, h = self._inputs
        scale = ca.MX.sym("scale", x.shape)
        x1, slopes = self._stages()
        f1 = self._equation.slope(x1, self._at(1.0), taut)
        slopes.append(f1)
        fifth, third = (
            ca.sumsqr(_combined(slopes, e) / scale) for e in (dormand_prince.E5, dormand_prince.E3)
        )
        # Nothing moves: no error. Slopes whose squares overflow: a step far too long, no quotient.
        below = ca.sqrt((fifth + 0.01 * third) * x.shape[0])
        usual = ca.logic_and(below > 0, below < ca.inf)
        error = ca.if_else(usual, h * fifth / below, below)
        count, crossed = crossings(self._equation)(x, x1, u, taut, h)
        outputs = [x1, f1, ca.vertcat(error, count), ca.horzcat(*slopes), crossed]
        return Function("tried", [*self._inputs, scale], outputs)

    def interpolant(self) -> ca.Function:
        """Return ``(x, x1, f, f1, K, u, taut, h) -> coefficients``, one column each."""
        x, f, u, taut, h = self._inputs
        x1, f1 = ca.MX.sym("x1", x.shape), ca.MX.sym("f1", x.shape)
        K = ca.MX.sym("K", x.shape[0], _STAGES + 1)
        slopes = ca.horzsplit(K)
        for a, c in zip(dormand_prince.A_EXTRA, dormand_prince.C_EXTRA, strict=True):
            slopes.append(self._equation.slope(x + h * _combined(slopes, a), self._at(c), taut))
        step = x1 - x
        first = [step, h * f - step, 2 * step - h * (f1 + f)]
        rest = [h * _combined(slopes, d) for d in dormand_prince.D]
        inputs = [x, x1, f, f1, K, u, taut, h]
        return Function("interpolant", inputs, [ca.horzcat(*first, *rest)])

    def inside(self) -> ca.Function:
        """Return ``(x, coefficients, u, h, share) -> x`` after a share of the step."""
        x, _, u, _, h = self._inputs
        coefficients, share = ca.MX.sym("coefficients", x.shape[0], _POWERS), ca.MX.sym("share")
        end = x + ca.mtimes(coefficients, ca.vertcat(*_factors(share)))
        if self._project is not None:
            end = put_on_lengths(self._project, end, self._at(share))
        return Function("inside", [x, coefficients, u, h, share], [end])


def _combined(slopes: list[Any], weights: Any) -> Any:
    """Return the sum of slopes with weights; many weights are zero."""
    used = [i for i in range(len(slopes)) if weights[i] != 0]
    return ca.mtimes(ca.horzcat(*(slopes[i] for i in used)), ca.DM(weights[used]))
