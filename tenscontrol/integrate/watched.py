"""Integration by the method that gets furthest: what ``method="auto"`` does by tolerance."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import final

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import Equation, InputLayout
from tenscontrol.integrate.integrator import (
    NO_WORK,
    AdvancedSpans,
    IntegrationError,
    IntegrationInterrupt,
    IntegrationPause,
    Integrator,
    MethodChange,
    Report,
    Span,
    SpanInputs,
    StepEnds,
    Work,
)

#: The methods that it chooses from.
WATCHED = ("dop853", "cvodes", "energy_momentum")

# Costs in µs: what a method may spend before others are tried, and what a trial may at least.
_FREE, _LEAST_TRIAL = 5e4, 2e4

# What a trial may spend, as part of all that was spent before.
_TRIAL = 0.125

# What making the other methods costs, µs: in all, and for each state.
_MAKING, _MAKING_A_STATE = 1e5, 8e2

# Another method goes on where it gets so many times as far as the one at work.
_BETTER = 1.5

# What a method may come to: the end of a span, or what ended it before.
_Outcome = Span | IntegrationPause | IntegrationError | IntegrationInterrupt

# Times closer than this part of the time between outputs are the same.
_SAME = 1e-9


def evaluations_within(budget: float, cost: float) -> float:
    """Return how many evaluations a method may take."""
    return max(budget / cost, 1.0)


def free_evaluations(cost: float) -> float:
    """Return how many evaluations the first method may take before others are tried."""
    return evaluations_within(_FREE, cost)


@final
class Watched(Integrator):
    """Begins with one method, and goes on with another one where that gets further.

    The method at work is left alone up to a budget. If the rest of the motion would then cost more
    than what was spent, all methods go on from there by a trial each. The one that gets furthest
    for its cost goes on from where its trial ended, until it has spent as much as everything before
    has; then they are compared again. So trials take little of the whole, and so does the work of
    methods that are left. A method that fails is not tried again, if another one gets past that
    place; else the motion ends there.

    Costs are counts of evaluations times :attr:`Integrator.cost`, not times of a clock: a script
    gives the same numbers each time. :attr:`changes` says which method went on, from when and why.
    Steps of trials that were given up are rejections in :class:`Work`.

    Parameters
    ----------
    equation : Equation
    first : str
        The method to begin with, one of :data:`WATCHED`.
    make : callable
        ``(name) -> Integrator``, called when a method is needed for the first time.
    duration : float
        Length of the whole motion, s. It may be advanced in several spans; what is advanced after
        that is left to the method that was at work at its end.
    start : float
        Time at which the motion begins, s, from which :attr:`changes` counts.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.
    """

    name = "auto"

    def __init__(
        self,
        equation: Equation,
        first: str,
        make: Callable[[str], Integrator],
        duration: float,
        start: float = 0.0,
    ) -> None:
        super().__init__(equation)
        self._make = make
        self._made: dict[str, tuple[Integrator, float]] = {}  # methods with their costs
        self._at_work = validation.choice("first", first, WATCHED)
        self._now = start
        self._end = start + validation.positive_number("duration", duration, "s")
        # What takes no driven bars is no choice for them.
        self._failed = {"energy_momentum"} if equation.layout.lengths else set[str]()
        self._is_shortened = False
        self._is_over = False
        self._spent, self._budget = 0.0, _FREE
        self._reviewed = start, 0.0  # time of the last review, and what was spent by then
        self.back_end = self._method(first)[0].back_end

    def shorten(self) -> None:
        """See :meth:`Integrator.shorten`."""
        self._is_shortened = True
        for method, _ in self._made.values():
            method.shorten()

    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        duration = validation.positive_number("duration", duration, "s")
        outputs = validation.whole_number("outputs", outputs, 1)
        if self._is_over:
            return self._again(state, held, duration, outputs, report)
        self._is_over = True  # if nothing else is said below
        outcome: _Outcome | None = None
        try:
            if self._spent < self._budget:  # as a rule the method at work gets to the end
                within, given = self._budget - self._spent, (state, held, duration, outputs)
                outcome = self._outcome(self._at_work, within, *given, report)
                if isinstance(outcome, Span):
                    self._pass(duration)
                    return outcome
        except KeyboardInterrupt:  # of what is told of the time
            raise IntegrationInterrupt(0.0, _Motion(0.0, state, state).span()) from None
        span = _Given(held, duration, outputs, self._equation.layout, report)
        motion = _Motion(0.0, state, state)
        try:
            while motion.time < duration:
                if outcome is not None or self._spent < self._budget:
                    self._go_on(span, motion, outcome)
                    outcome = None
                else:
                    self._review(span, motion)
        except IntegrationInterrupt:
            raise
        except KeyboardInterrupt:  # of what is told of the time
            raise IntegrationInterrupt(motion.time, motion.span()) from None
        self._pass(duration)
        return motion.span()

    def _pass(self, duration: float, last: float | None = None) -> None:
        """Count a time as gone through, s, of which the last span may be a part."""
        self._now += duration
        self._is_over = self._now >= self._end - _SAME * (duration if last is None else last)

    def _again(
        self, state: FloatArray, held: FloatArray, duration: float, outputs: int,
        report: Report | None,
    ) -> Span:  # fmt: skip
        """Return a part of the motion again, by the method last at work.

        Where that takes more than all of the motion did, it is by another that was tried.
        """
        budget = max(self._spent, _FREE)
        for name in sorted(self._made, key=lambda name: name != self._at_work):
            method, cost = self._made[name]
            method.limit = evaluations_within(budget, cost)
            try:
                span = method.advance(state, held, duration, outputs, report)
            except IntegrationPause as pause:
                most = f"a part of the motion takes more than all of it did, by {name}"
                failure = IntegrationError(most, pause.time, pause.span)
            except IntegrationError as error:
                failure = error
            else:
                self._at_work = name
                return span
        raise failure

    def advance_spans(self, state: FloatArray, given: SpanInputs) -> AdvancedSpans:
        """See :meth:`Integrator.advance_spans`."""
        if self._is_over or self._spent >= self._budget:
            return AdvancedSpans()
        method, cost = self._method(self._at_work)
        method.limit = evaluations_within(self._budget - self._spent, cost)
        spans = method.advance_spans(state, given)
        if spans.whole:
            durations = given.duration[: len(spans.whole)]
            self._spent += cost * spans.work.evaluations
            self._pass(float(durations.sum()), float(durations[-1]))
        return spans

    def _go_on(self, span: _Given, motion: _Motion, outcome: _Outcome | None = None) -> None:
        """Go on by the method at work, up to its budget, from what it has come to, if it has."""
        budget = self._budget - self._spent
        ahead, ended = self._leg(self._at_work, span, motion, budget, span.report, outcome)
        motion.append(ahead)
        if isinstance(ended, IntegrationInterrupt):
            raise IntegrationInterrupt(ended.time, motion.span())
        if ended is not None:
            self._failed.add(self._at_work)
            self._compare(span, motion, ended)

    def _method(self, name: str) -> tuple[Integrator, float]:
        """Return a method and what an evaluation costs."""
        if name not in self._made:
            method = self._make(name)
            if self._is_shortened:
                method.shorten()
            self._made[name] = method, method.cost
        return self._made[name]

    def _outcome(
        self, name: str, budget: float, state: FloatArray, held: FloatArray, duration: float,
        outputs: int, report: Report | None,
    ) -> _Outcome:  # fmt: skip
        """Return what a method comes to within a budget: the end of a span, or what ended it."""
        method, cost = self._method(name)
        method.limit = evaluations_within(budget, cost)
        outcome: _Outcome
        try:
            outcome = method.advance(state, held, duration, outputs, report)
            self._spent += cost * outcome.work.evaluations
        except (IntegrationPause, IntegrationError, IntegrationInterrupt) as ended:
            outcome = ended
            self._spent += cost * ended.span.work.evaluations
        return outcome

    def _leg(
        self, name: str, span: _Given, start: _Motion, budget: float, report: Report | None,
        outcome: _Outcome | None = None,
    ) -> tuple[_Motion, IntegrationError | IntegrationInterrupt | None]:  # fmt: skip
        """Return the motion from a place on, by a method within a budget, and what ended it.

        ``outcome`` is what it has come to from there, if it has begun.
        """
        ahead = _Motion(start.time, start.state, start.begin, start.done)
        before = self._spent
        while ahead.time < span.duration:
            origin = ahead.time
            if outcome is None:
                later_report = report if report is None or not origin else _later(report, origin)
                within = budget - (self._spent - before)
                given = ahead.state, span.inputs(origin), *span.rest(ahead)
                outcome = self._outcome(name, within, *given, later_report)
            if isinstance(outcome, IntegrationPause):
                ahead.take(outcome.span, span)
                ahead.time, ahead.state = origin + outcome.time, outcome.state
                span.settle(ahead)
                return ahead, None
            if not isinstance(outcome, Span):
                ahead.take(outcome.span, span)
                outcome.time += origin
                return ahead, outcome
            ahead.take(outcome, span)
            outcome = None
        return ahead, None

    def _review(self, span: _Given, motion: _Motion) -> None:
        """Compare the methods if the rest of the motion would cost more than what was spent."""
        now = self._now + motion.time
        since, before = self._reviewed
        others = _MAKING + _MAKING_A_STATE * self._equation.states
        rest = (self._end - now) * (self._spent - before)
        if rest > max(self._spent, others) * (now - since):
            self._compare(span, motion)
        self._set_budget(motion)

    def _compare(
        self, span: _Given, motion: _Motion, failure: IntegrationError | None = None
    ) -> None:
        """Go on by the method that gets furthest for its cost.

        After a failure a method has as much as was spent before to get past that place.
        """
        budget = max(_LEAST_TRIAL, self._spent * (_TRIAL if failure is None else 1.0))
        rates: dict[str, float] = {}
        trials: dict[str, _Motion] = {}
        for name in (method for method in WATCHED if method not in self._failed):
            before = self._spent
            ahead, ended = self._leg(name, span, motion, budget, None)
            trials[name] = ahead
            if isinstance(ended, IntegrationInterrupt):
                motion.give_up(trials)
                raise IntegrationInterrupt(motion.time, motion.span())
            if ended is not None:
                self._failed.add(name)
                if name == self._at_work:  # which may be what the others have no budget for
                    motion.give_up(trials)
                    self._compare(span, motion, ended)
                    return
            elif failure is None or ahead.time > failure.time:
                rates[name] = (ahead.time - motion.time) / max(self._spent - before, 1.0)
        if not rates:
            assert failure is not None  # else the method at work has a rate
            motion.give_up(trials)
            tried = ", ".join(trials) or "none"
            raise IntegrationError(
                f"{failure}. Of the other methods ({tried}) none got past that place",
                failure.time,
                motion.span(),
            )
        old, best = self._at_work, max(rates, key=lambda name: rates[name])
        if old in rates and rates[best] <= _BETTER * rates[old]:
            best = old
        if best != old:
            why = str(failure)
            if failure is None:
                ratio = rates[best] / max(rates[old], 1e-6 * rates[best])
                why = f"for the same work it got {ratio:.2g} times as far as {old}"
            self.changes = (*self.changes, MethodChange(self._now + motion.time, best, why))
            self._at_work = best
        motion.append(trials.pop(best))
        motion.give_up(trials)
        self._set_budget(motion)
        if span.report is not None:
            span.report(motion.time)

    def _set_budget(self, motion: _Motion) -> None:
        """Leave the method at work alone until it has spent as much as everything before has."""
        self._budget = 2 * self._spent
        self._reviewed = self._now + motion.time, self._spent


@dataclass(eq=False)
class _Motion:
    """A motion up to a time."""

    time: float  # within the span, s
    state: FloatArray
    begin: FloatArray  # the state at the start of the span
    done: int = 0  # outputs up to then
    spans: list[Span] = field(default_factory=list)  # with the states at the outputs
    ends: list[StepEnds] = field(default_factory=list)  # of steps, from the start of the span
    knows_ends: bool = True  # of all steps
    work: Work = NO_WORK

    def take(self, reached: Span, span: _Given) -> None:
        """Append outputs that follow one another."""
        self.work += reached.work
        if reached.ends is not None:
            self.ends.append(reached.ends._replace(time=self.time + reached.ends.time))
        elif reached.work.steps:
            self.knows_ends = False
        if reached.states.shape[1]:
            from_start = self.time == 0
            self.spans.append(reached if from_start else Span(reached.states, reached.work))
            self.done += reached.states.shape[1]
            self.time, self.state = span.time_of(self.done), reached.states[:, -1]

    def append(self, ahead: _Motion) -> None:
        """Append a motion that goes on from this one."""
        self.time, self.state, self.done = ahead.time, ahead.state, ahead.done
        self.spans += ahead.spans
        self.ends += ahead.ends
        self.knows_ends &= ahead.knows_ends
        self.work += ahead.work

    def give_up(self, trials: Mapping[str, _Motion]) -> None:
        """Count the work of motions that are not gone on with."""
        for trial in trials.values():
            tried = trial.work.steps + trial.work.rejections
            self.work += Work(rejections=tried, evaluations=trial.work.evaluations)

    def span(self) -> Span:
        """Return the outputs so far, of a motion from the start of the span."""
        if len(self.spans) != 1:
            whole, done = np.empty((len(self.begin), self.done + 1)), 1
            whole[:, 0] = self.begin
            while self.spans:  # one by one, so that they give back their memory
                some = self.spans.pop(0).states
                whole[:, done : done + some.shape[1]] = some
                done += some.shape[1]
            self.spans = [Span(whole[:, 1:], self.work, whole)]
        span = self.spans[0]
        ends = StepEnds.joined(self.ends) if self.ends and self.knows_ends else None
        return Span(span.states, self.work, span.whole, ends)


@dataclass(frozen=True, eq=False)
class _Given:
    """A span that a method is to advance over."""

    held: FloatArray
    duration: float
    outputs: int
    layout: InputLayout
    report: Report | None

    def time_of(self, done: int) -> float:
        """Return the time of an output; 0 is the start."""
        return self.duration if done == self.outputs else self.duration * done / self.outputs

    def rest(self, motion: _Motion) -> tuple[float, int]:
        """Return the duration and the outputs up to the end, or to the next output if between."""
        if motion.time == self.time_of(motion.done):
            return self.duration - motion.time, self.outputs - motion.done
        return self.time_of(motion.done + 1) - motion.time, 1

    def inputs(self, time: float) -> FloatArray:
        """Return the input of a span that begins at a time within this one."""
        return self.layout.later(self.held, time)

    def settle(self, motion: _Motion) -> None:
        """Put a motion that ended next to the time of an output there."""
        following = self.time_of(motion.done + 1)
        if following - motion.time <= _SAME * self.duration / self.outputs:
            motion.take(Span(motion.state[:, None], NO_WORK), self)


def _later(report: Report, by: float) -> Report:
    return lambda time: report(by + time)
