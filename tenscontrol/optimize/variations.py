"""Propagation of small changes over the steps of a run, forward or backward."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, reduce
from typing import NamedTuple, Protocol

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.integrate import dop853_coefficients as order8
from tenscontrol.integrate.core_scene import core_scene
from tenscontrol.interrupt import check
from tenscontrol.optimize.bar_changes import BarChanges
from tenscontrol.optimize.core_steps import CoreSteps, Tableau
from tenscontrol.optimize.derivatives import Derivatives, Slopes, Switches, sources
from tenscontrol.optimize.implicit_steps import ImplicitSteps
from tenscontrol.optimize.parameters import Parameter, shares
from tenscontrol.optimize.support_changes import SupportChanges
from tenscontrol.optimize.traced_steps import Push, TracedSteps
from tenscontrol.properties import cached_property

# Numbers of the derivatives that are held at a time.
_MOST_NUMBERS = 8_000_000

#: The method whose steps are implicit.
IMPLICIT = "energy_momentum"

# Rates times the step up to which a method is stable, less a fifth. Steps of the power method that
# finds the rates.
_STABLE = {"rk4": 2.2, "dop853": 4.9}
_POWERS = 16

# By how much states are moved for it, in sizes.
_DIFFERENCE = 1e-6


class Answers(Protocol):
    """What strings are given anew at some steps of a part, in answer to changes.

    An answer, shape (rows, P), has the coefficients of polynomials of the strings first, powers of
    the time since it began; what else it carries on is its own.
    """

    @property
    def degree(self) -> int:
        """Of the polynomials."""

    @property
    def size(self) -> int:
        """Number of rows."""

    def begins(self, step: int) -> bool:
        """Whether an answer begins with a step."""

    def elapsed(self, step: int) -> float:
        """Return how long an answer has lasted when a step begins, s."""

    def answer(self, step: int, X: FloatArray, before: FloatArray | None) -> FloatArray:
        """Return the answer that begins with a step, from that before it."""

    def answer_back(self, step: int, answered: FloatArray, slope: FloatArray) -> FloatArray:
        """Return a cost by the state from that by an answer, (rows,), which is carried back."""


@cache
def tableau(method: str) -> Tableau:
    """Return the coefficients of a method by name, in one piece of memory each."""
    if method == "rk4":
        a = np.zeros((4, 4))
        a[1, 0] = a[2, 1] = 0.5
        a[3, 2] = 1.0
        return Tableau(a, np.array([1, 2, 2, 1]) / 6, np.array([0, 0.5, 0.5, 1]))
    return Tableau(*map(np.ascontiguousarray, (order8.A, order8.B, order8.C)))


def columns_of(parameters: Sequence[Parameter]) -> list[slice]:
    """Return which columns of a derivative are those of each parameter."""
    columns: list[slice] = []
    end = 0
    for parameter in parameters:
        begin, end = end, end + parameter.size
        columns.append(slice(begin, end))
    return columns


class _Leg(NamedTuple):
    """Steps, or a part of one up to a time that is asked for, with their derivatives."""

    step: int  # the first
    steps: int  # so many
    part: float | None  # s; None: whole steps
    output: int  # of a part
    stages: Slopes | None  # at its stages; None where the stepper finds them
    counts: list[FloatArray | None]  # of each parameter, at the stages


def stable(steps: TracedSteps, derivatives: Derivatives) -> TracedSteps:
    """Return steps that are cut where the method is not stable for all small changes.

    The motion itself stays near the border of stability, as errors shorten its steps; what it does
    not move along would grow without end. Parts of a step follow each other from its beginning, and
    the next begins where it did.
    """
    if steps.method == IMPLICIT or not derivatives.equation.velocity_dependent:
        return steps  # without such a border, or short enough for the strings
    method = tableau(steps.method)
    parts = np.ceil(steps.length * _rates(steps, derivatives) / _STABLE[steps.method]).astype(int)
    parts = np.maximum(parts, 1)
    if parts.max() == 1:
        return steps
    first = np.concatenate([[0], np.cumsum(parts)])
    of = np.repeat(np.arange(len(parts)), parts)
    length = (steps.length / parts)[of]
    within = (np.arange(len(of)) - first[of]) * length
    states = np.empty((len(steps.states), len(of) + 1))
    states[:, first[:-1]], states[:, -1] = steps.states[:, :-1], steps.states[:, -1]
    inputs = steps.inputs[:, of]
    if steps.layout.degree:
        inputs[-1] += within
    cut = replace(
        steps, begin=steps.begin[of] + within, length=length, span=steps.span[of], states=states,
        inputs=inputs, taut=steps.taut[:, of],
    )  # fmt: skip
    for k in range(1, int(parts.max())):
        some = first[:-1][parts > k] + k - 1
        slopes = stages(cut, derivatives, method, some, length[some])[0]
        moved = sum(weight * slope for weight, slope in zip(method.b, slopes, strict=True))
        states[:, some + 1] = states[:, some] + length[some] * moved
    return cut


def _rates(steps: TracedSteps, derivatives: Derivatives) -> FloatArray:
    """Return the largest rate of small changes at the beginning of each step, 1/s, about.

    By the power method, from differences of accelerations: two digits are enough.
    """
    half, count = derivatives.half, len(steps.length)
    block = max(1, _MOST_NUMBERS // (4 * half))
    rates = np.empty(count)
    start = np.random.default_rng(0).normal(size=(half, 2, 1))
    for begin in range(0, count, block):
        some = slice(begin, begin + block)
        x, u, taut = steps.states[:, :-1][:, some], steps.inputs[:, some], steps.taut[:, some]
        moved = _DIFFERENCE * derivatives.structure.size
        before = derivatives.slope(x, u, taut)[half:]
        damped, stiff = (
            _largest(derivatives, (x, u, taut, before), start, rows, change)
            for rows, change in (
                (slice(half, None), moved / steps.length[some]), (slice(half), moved)
            )
        )  # fmt: skip
        rates[some] = (damped + np.sqrt(damped**2 + 4 * stiff)) / 2
    return rates


def _largest(
    derivatives: Derivatives, states: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    start: FloatArray, rows: slice, change: FloatArray | float,
) -> FloatArray:  # fmt: skip
    """Return how much the derivative of accelerations by some rows magnifies, at each state.

    ``states`` come with inputs, switches and accelerations; ``start`` are the vectors to begin
    with, (half, 2, 1), and ``change`` what is added of them.
    """
    x, u, taut, before = states
    half, count = derivatives.half, x.shape[1]
    twice = [np.tile(given, 2) for given in (u, taut)]
    vectors = np.tile(start, count)
    for _ in range(_POWERS):
        size = np.linalg.norm(vectors, axis=0)
        vectors = vectors / np.maximum(size, np.finfo(float).tiny)
        near = np.repeat(x[:, None], 2, axis=1)
        near[rows] += change * vectors
        slopes = derivatives.slope(near.reshape(2 * half, -1), *twice)[half:]
        vectors = (slopes.reshape(half, 2, -1) - before[:, None]) / change
    largest: FloatArray = np.linalg.norm(vectors, axis=0).max(axis=0)
    return largest


def stages(
    steps: TracedSteps, derivatives: Derivatives, method: Tableau, of: IntArray, h: FloatArray
) -> tuple[list[FloatArray], list[FloatArray], list[FloatArray]]:
    """Return slopes, states and inputs at the stages of steps that are so long, one a column."""
    x, taut = steps.states[:, of], steps.taut[:, of]
    slopes: list[FloatArray] = []
    states, inputs = [], []
    for weights, fraction in zip(method.a, method.c, strict=True):
        used = [w * slope for w, slope in zip(weights, slopes, strict=False) if w]
        y = x + h * sum(used, np.zeros_like(x))
        u = steps.inputs[:, of]
        if steps.layout.degree:
            u[-1] += fraction * h
        slopes.append(derivatives.slope(y, u, taut))
        states.append(y)
        inputs.append(u)
    return slopes, states, inputs


@dataclass(frozen=True, eq=False)
class Variations:
    """The derivative of a part of a run, step by step, as these were taken, landings included.

    At a switch the motions before and after differ where the slope jumps: ``X + (f⁺ − f⁻)(g_x X +
    g_p)/ġ``, of each string that switches there (I. A. Hiskens & M. A. Pai, *Trajectory
    sensitivity analysis of hybrid systems*, 2000, doi:10.1109/81.828574).

    Parameters
    ----------
    steps : TracedSteps
    derivatives : Derivatives
    parameters : sequence of Parameter
    times : ndarray, shape (T,)
        At which derivatives are asked for in the part, s, ascending.
    answers : Answers, optional
        By which commands, or motors, answer changes.
    supports : SupportChanges, optional
        What the parameter of a motion of supports changes.
    lengths : BarChanges, optional
        What the parameter of lengths of bars changes.
    driven : ndarray of int, optional
        Bars that stretch at the start at any rate; None where bars are rigid.
    """

    steps: TracedSteps
    derivatives: Derivatives
    parameters: Sequence[Parameter]
    times: FloatArray
    answers: Answers | None = None
    supports: SupportChanges | None = None
    lengths: BarChanges | None = None
    driven: IntArray | None = None

    @cached_property
    def switches(self) -> Switches:
        """What switched, and what that changes."""
        steps = self.steps
        of, which = steps.switched
        if not len(of):
            return self.derivatives.no_switches
        ends = self._ends[:, of], self._end_inputs[:, of], steps.taut[:, of]
        return self.derivatives.at_switches(*ends, of, which)

    @cached_property
    def columns(self) -> list[slice]:
        """Which columns of a derivative are those of each parameter."""
        return columns_of(self.parameters)

    def forward(
        self, X: FloatArray, sensitivities: FloatArray, answer: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return the derivative of x after the part from that before it.

        Those at the times are entered in ``sensitivities``, shape (T, states, P). ``answer`` is
        what the command before the part made of the inputs; that at its end is returned, too.
        """
        at, ends, last = self._first_switch, self._places[0], 0
        X, answer = self._begun(0, X, answer)
        is_before = self.times <= self.steps.begin[0]
        if np.count_nonzero(is_before):
            sensitivities[is_before] = X
        for leg in self._legs(is_back=False):
            check()
            if leg.step != last:
                X, answer = self._begun(leg.step, X, answer)
            last = leg.step
            reached = self._forward(X, leg, answer)
            if leg.part is not None:
                sensitivities[leg.output] = reached
                continue
            X, end = reached, leg.step + leg.steps - 1
            X = self._restored(end, X)
            for e in range(at[end], at[end + 1]):
                X = X + self._jumped(e, X, answer)
            sensitivities[ends.get(end, [])] = X
        return X, answer

    def _begun(
        self, step: int, X: FloatArray, answer: FloatArray | None
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return the derivative of the state when a step begins, and the answer in it."""
        if self.answers is not None and self.answers.begins(step):
            answer = self.answers.answer(step, X, answer)
        return self._pushed(step, X), answer

    def _begun_back(
        self, step: int, mu: FloatArray, answered: FloatArray, slope: FloatArray
    ) -> FloatArray:
        """Return a cost by x before a step begins; add those by the answer and by parameters."""
        mu = self._pushed_back(step, mu, slope)
        if self.answers is not None and self.answers.begins(step):
            mu = mu + self.answers.answer_back(step, answered, slope)
        return mu

    def motion(self) -> FloatArray:
        """Return the states at the times, shape (states, T)."""
        steps = self.steps
        ends, parts = self._places
        states = np.repeat(steps.states[:, :1], len(self.times), axis=1)
        for k, which in ends.items():
            states[:, which] = self._ends[:, [k]]
        plan = [(k, length, i) for k, own in parts.items() for length, i in own]
        if isinstance(self._stepper, ImplicitSteps):
            for k, length, i in plan:
                states[:, i] = self._stepper.reached(k, length)
        elif plan:
            of, outputs = (np.array([leg[j] for leg in plan]) for j in (0, 2))
            h = np.array([length for _, length, _ in plan])
            slopes = stages(steps, self.derivatives, self._tableau, of, h)[0]
            states[:, outputs] = steps.states[:, of] + h * sum(
                weight * slope for weight, slope in zip(self._tableau.b, slopes, strict=True)
            )
        return states

    def slopes(self) -> FloatArray:
        """Return ẋ at the times, shape (states, T)."""
        steps, states = self.steps, self.motion()
        of = steps.step_at(self.times)
        inputs = steps.inputs[:, of]
        if steps.layout.degree:
            inputs[-1] += self.times - steps.begin[of]
        return self.derivatives.slope(states, inputs, steps.taut[:, of])

    def backward(
        self, mu: FloatArray, costs: FloatArray, slope: FloatArray, answered: FloatArray
    ) -> FloatArray:
        """Return a cost by x before the part from that after it, and add those by parameters.

        Parameters
        ----------
        mu : ndarray, shape (states,)
        costs : ndarray, shape (T, states)
            By x at the times.
        slope : ndarray, shape (P,)
            Those by parameters are added to it.
        answered : ndarray, shape (rows,)
            By the answer that is under way; changed.
        """
        at, ends = self._first_switch, self._places[0]
        partial = np.zeros_like(mu)
        for leg in self._legs(is_back=True):
            check()
            if leg.part is not None:
                end = costs[leg.output]
            else:
                last = leg.step + leg.steps - 1
                mu = self._begun_back(last + 1, mu + partial, answered, slope)
                mu = mu + costs[ends.get(last, [])].sum(axis=0)
                partial = np.zeros_like(mu)
                for e in range(at[last + 1] - 1, at[last] - 1, -1):
                    mu = self._jumped_back(e, mu, slope, answered)
                end = self._restored_back(last, mu, slope)
            back = self._backward(end, leg, slope, answered)
            if leg.part is not None:
                partial += back
            else:
                mu = back
        if self._stepper is not None:
            self._stepper.take_costs(slope)
        mu = mu + partial + costs[self.times <= self.steps.begin[0]].sum(axis=0)
        return self._begun_back(0, mu, answered, slope)

    # ---- answers ----

    def _given(self, answer: FloatArray, time: float) -> FloatArray:
        """Return what an answer gives the strings, (α, P), so long after it began, s."""
        assert self.answers is not None  # of which it is one
        given, strings = np.zeros(1), self.steps.layout.strings
        for i in reversed(range(self.answers.degree + 1)):
            given = answer[i * strings : (i + 1) * strings] + time * given
        return given

    def _given_back(self, by_input: FloatArray, time: float, answered: FloatArray) -> None:
        """Add what a cost by the input of the strings, (α,), makes of that by an answer."""
        if self.answers is not None:
            powers = time ** np.arange(self.answers.degree + 1)
            answered[: len(powers) * len(by_input)] += np.outer(powers, by_input).ravel()

    def _elapsed(self, step: int, after: float = 0.0) -> float:
        """Return how long an answer has lasted so long after a step began, s."""
        return 0.0 if self.answers is None else self.answers.elapsed(step) + after

    # ---- a step ----

    @cached_property
    def _stepper(self) -> CoreSteps | ImplicitSteps | None:
        """What differentiates a step; None where it is done here."""
        derivatives = self.derivatives
        if self.steps.method == IMPLICIT:
            return ImplicitSteps(self.steps, derivatives, self.parameters, self.columns)
        layout, answers = self.steps.layout, self.answers
        core = core_scene(derivatives.equation)
        is_polynomial = answers is not None and answers.degree
        if core is None or layout.offset or layout.lengths or is_polynomial:
            return None
        return CoreSteps(
            core, derivatives.model, self.steps, self._tableau, self.parameters, self.columns,
            answers is not None, self.switches,
        )  # fmt: skip

    def _forward(self, X: FloatArray, leg: _Leg, answer: FloatArray | None) -> FloatArray:
        """Return the derivative of the state after a leg."""
        length = self._length_of(leg)
        if self._stepper is not None:
            if answer is not None:  # implicit steps take the input in their middle
                answer = self._given(answer, self._elapsed(leg.step, length / 2))
            return self._stepper.forward(leg.step, leg.steps, leg.part, X, answer)
        a, b, half = self._tableau.a, self._tableau.b, self.derivatives.half
        assert leg.stages is not None  # without a stepper
        K = np.empty((len(a), *X.shape))
        flat = K.reshape(len(a), -1)
        for i in range(len(a)):
            Y = X
            if i:
                Y = X + length * (a[i, :i] @ flat[:i]).reshape(X.shape)
            K[i, :half] = Y[half:]
            np.matmul(leg.stages.by_state[i], Y, out=K[i, half:])
            for columns, factors in self._sources(leg.stages, leg.counts, i):
                K[i, half:, columns] += reduce(np.matmul, factors)
            if answer is not None:
                assert leg.stages.by_input is not None  # it was asked for
                given = self._given(answer, self._elapsed(leg.step, self._tableau.c[i] * length))
                K[i, half:] += leg.stages.by_input[i] @ given
        return np.asarray(X + length * (b @ flat).reshape(X.shape))

    def _backward(
        self, end: FloatArray, leg: _Leg, slope: FloatArray, answered: FloatArray
    ) -> FloatArray:
        """Return a cost by the state before a leg; add those by the answer and by parameters."""
        length = self._length_of(leg)
        if self._stepper is not None:
            back, by_input = self._stepper.backward(leg.step, leg.steps, leg.part, end, slope)
            if by_input is not None:
                self._given_back(by_input, self._elapsed(leg.step, length / 2), answered)
            return back
        a, b, half = self._tableau.a, self._tableau.b, self.derivatives.half
        assert leg.stages is not None  # without a stepper
        back, stages = end.copy(), len(b)
        later = np.zeros((stages, len(end)))
        for i in reversed(range(stages)):
            kappa = length * (b[i] * end + a[i + 1 :, i] @ later[i + 1 :])
            later[i] = kappa[half:] @ leg.stages.by_state[i]
            later[i, half:] += kappa[:half]
            back += later[i]
            for columns, factors in self._sources(leg.stages, leg.counts, i):
                slope[columns] += reduce(np.matmul, factors, kappa[half:])
            if self.answers is not None:
                assert leg.stages.by_input is not None  # it was asked for
                time = self._elapsed(leg.step, self._tableau.c[i] * length)
                self._given_back(kappa[half:] @ leg.stages.by_input[i], time, answered)
        return back

    def _length_of(self, leg: _Leg) -> float:
        return float(self.steps.length[leg.step]) if leg.part is None else leg.part

    def _sources(
        self, slopes: Slopes, counts: list[FloatArray | None], stage: int
    ) -> Iterator[tuple[slice, tuple[FloatArray, ...]]]:
        """Yield what the parameters themselves change of the accelerations in a stage."""
        at, now = [None if count is None else count[stage] for count in counts], slopes.of(stage)
        by_motion = {"supports": now.by_supports, "bars": now.by_bars}
        by_own = now.by_input, now.by_parameters, by_motion
        return sources(self.parameters, self.columns, at, *by_own)

    def _counts(self, time: FloatArray, within: FloatArray) -> list[FloatArray | None]:
        """Return by what each parameter counts at times, in the pieces of other times."""
        counts = list[FloatArray | None]()
        for parameter in self.parameters:
            count = shares(parameter, time, within) if parameter.kind == "input" else None
            count = None if count is None else count.T
            if parameter.kind == "supports" and self.supports is not None:
                count = self.supports.inputs(time, within)
            if parameter.kind == "bars" and self.lengths is not None:
                count = self.lengths.at(time, within)
            counts.append(count)
        return counts

    # ---- supports and rates of bars that jump ----

    def _pushed(self, step: int, X: FloatArray) -> FloatArray:
        """Return the derivative of the state after the push with which a step may begin."""
        push = self.steps.push_at(step)
        if push is None:
            return X
        slopes, counts = self._push_slopes(step, push)
        pushed, half = X.copy(), self.derivatives.half
        pushed[half:] += slopes.by_state[0] @ X
        for columns, factors in self._sources(slopes, counts, 0):
            pushed[half:, columns] += reduce(np.matmul, factors)
        return pushed

    def _pushed_back(self, step: int, mu: FloatArray, slope: FloatArray) -> FloatArray:
        """Return a cost by x before the push with which a step may begin; add by parameters."""
        push = self.steps.push_at(step) if step < len(self.steps.length) else None
        if push is None:
            return mu
        slopes, counts = self._push_slopes(step, push)
        of_velocities = mu[self.derivatives.half :]
        for columns, factors in self._sources(slopes, counts, 0):
            slope[columns] += reduce(np.matmul, factors, of_velocities)
        return np.asarray(mu + of_velocities @ slopes.by_state[0])

    def _push_slopes(self, step: int, push: Push) -> tuple[Slopes, list[FloatArray | None]]:
        """Return derivatives of what a push adds to velocities: accelerations are affine in it."""
        taut, x = np.ones((len(self.steps.taut), 1)), push.state[:, None]
        both = []
        moved = push.jump if isinstance(push.jump, float) else push.jump[:, None]
        for u, jump in ((push.held, 0.0), (push.pushed, moved)):
            inputs = u[:, None]
            slope = self.derivatives.slope(x, inputs, taut)
            carried = None
            if self.steps.layout.offset:
                carried = self.steps.support_motion(inputs, 2) + jump
            both.append(self.derivatives.at(x, inputs, taut, slope, carried))
        before, after = both
        by_state, by_bars = after.by_state - before.by_state, None
        if before.by_bars is not None and after.by_bars is not None:
            by_length, _, by_jump = np.split(after.by_bars, 3, axis=2)
            by_length = by_length - before.by_bars[:, :, : by_length.shape[2]]
            by_bars = np.concatenate([by_length, np.zeros_like(by_jump), by_jump], axis=2)
            if push.is_first and self.driven is not None:  # rates jump from those at the start
                _, stretching = self.derivatives.stretching(push.state, self.driven)
                by_state = by_state - by_jump @ stretching
        slopes = Slopes(
            by_state,
            None if before.by_input is None else np.zeros_like(before.by_input),
            after.by_parameters - before.by_parameters,
            before.by_supports,
            by_bars,
        )
        begin, length = float(self.steps.begin[step]), float(self.steps.length[step])
        earlier, later = None if push.is_first else begin - 1e-6 * length, begin + length / 2
        counts = self._counts(np.array([begin]), np.array([later]))
        for i, parameter in enumerate(self.parameters):
            changes = {"supports": self.supports, "bars": self.lengths}.get(parameter.kind)
            if changes is not None:
                counts[i] = changes.impulse(begin, earlier, later)
        return slopes, counts

    # ---- starts and switches ----

    def start(self) -> FloatArray:
        """Return the derivative of the state at the start of the run, shape (states, P)."""
        X = np.zeros((2 * self.derivatives.half, self.columns[-1].stop if self.columns else 0))
        for columns, by in self._starts():
            X[:, columns] = by
        return X

    def start_back(self, mu: FloatArray, slope: FloatArray) -> None:
        """Add what a cost by the state at the start makes of the parameters."""
        for columns, by in self._starts():
            slope[columns] += mu @ by

    def _starts(self) -> Iterator[tuple[slice | IntArray, FloatArray]]:
        """Yield columns of starts and what they change of the state."""
        pairs = zip(self.parameters, self.columns, strict=True)
        starts = [pair for pair in pairs if pair[0].kind in ("nodes", "velocities", "bars")]
        if not starts:
            return
        half, structure = self.derivatives.half, self.derivatives.structure
        push = self.steps.push_at(0)
        first = self.steps.states[:, 0] if push is None else push.state
        inputs, layout = self.steps.inputs[:, 0], self.steps.layout
        if push is not None and self.driven is not None:  # what is driven keeps its rate
            stretching, by_state = self.derivatives.stretching(first, self.driven)
            inputs = np.zeros_like(inputs)
            coefficients = inputs[:-1].reshape(layout.degree + 1, layout.count)
            held = push.held[: layout.count]  # at rest
            coefficients[0, layout.length_rows] = held[layout.length_rows]
            coefficients[1, layout.length_rows] = stretching
        exact = self.derivatives.projected(first[:, None], inputs[:, None])
        whole = np.eye(2 * half) if exact is None else exact[0][0]
        if exact is not None and exact[1] is not None:
            lengths, rates = np.split(exact[1][0], 2, axis=1)
            whole = whole + rates @ by_state
        d, n = structure.nodes.shape
        place = np.arange(d * n).reshape(d, n).ravel(order="F")  # of x's entries in an array (d, n)
        for parameter, columns in starts:
            if parameter.kind == "bars" and self.lengths is not None:
                begin, length = self.steps.begin[:1], self.steps.length[:1]
                yield columns, lengths @ self.lengths.at(begin, begin + length / 2, 1)[0]
                continue
            entries = slice(half) if parameter.kind == "nodes" else slice(half, None)
            yield columns.start + place[structure.free_rows], whole[:, entries]

    def _gap_by(self, e: int) -> Iterator[tuple[slice | IntArray, FloatArray]]:
        """Yield columns of inputs and what they change of the gap of a switch."""
        switches, steps = self.switches, self.steps
        k = switches.step[e]
        begin, length = steps.begin[[k]], steps.length[k]
        for parameter, columns in zip(self.parameters, self.columns, strict=True):
            if parameter.kind == "supports" and self.supports is not None:
                displaced = self.supports.at(begin + length, begin + length / 2)[0]
                yield columns, switches.by_offset[e] @ displaced
            if parameter.kind != "input":
                continue
            share = shares(parameter, begin + length, begin + length / 2)
            by_input = switches.by_input[e]
            yield columns, by_input if share is None else np.outer(by_input, share[:, 0]).ravel()

    def _jumped(self, e: int, X: FloatArray, answer: FloatArray | None) -> FloatArray:
        """Return what a switch adds to the derivative."""
        switches = self.switches
        moved = switches.by_state[e] @ X
        if answer is not None:
            moved = moved + switches.by_input[e] @ self._given(answer, self._at_switch(e))
        for columns, change in self._gap_by(e):
            moved[columns] += change
        return np.outer(switches.jump[e], moved / switches.rate[e])

    def _jumped_back(
        self, e: int, mu: FloatArray, slope: FloatArray, answered: FloatArray
    ) -> FloatArray:
        """Return a cost by x before a switch, from that after it; add those by inputs."""
        switches = self.switches
        weight = float(switches.jump[e] @ mu / switches.rate[e])
        for columns, change in self._gap_by(e):
            slope[columns] += weight * change
        self._given_back(weight * switches.by_input[e], self._at_switch(e), answered)
        return np.asarray(mu + weight * switches.by_state[e])

    def _at_switch(self, e: int) -> float:
        """Return how long an answer has lasted at a switch, s."""
        step = int(self.switches.step[e])
        return self._elapsed(step, float(self.steps.length[step]))

    # ---- what is prepared ----

    @cached_property
    def _ends(self) -> FloatArray:
        """States at the ends of steps, shape (states, K), before a push."""
        ends, steps = self.steps.states[:, 1:], self.steps
        pushes = [(k, steps.push_at(k)) for k in steps.pushed_steps if k]
        if pushes:
            ends = ends.copy()
        for k, push in pushes:
            assert push is not None  # it is one of those
            ends[:, k - 1] = push.state
        return ends

    @cached_property
    def _end_inputs(self) -> FloatArray:
        """Inputs at the ends of steps, shape (inputs, K)."""
        ends, steps = self.steps.inputs, self.steps
        if steps.layout.degree:
            ends = ends.copy()
            ends[-1] += steps.length
        return ends

    @cached_property
    def _tableau(self) -> Tableau:
        return tableau(self.steps.method)

    @cached_property
    def _passed(self) -> IntArray:
        """At the ends of which steps switches are passed here, one a switch, not by the stepper."""
        is_done = isinstance(self._stepper, CoreSteps) and self._stepper.passes
        return np.asarray(self.switches.step[: 0 if is_done else None])

    @cached_property
    def _first_switch(self) -> IntArray:
        """Where those at the end of each step begin, shape (K + 1,)."""
        return self._passed.searchsorted(np.arange(len(self.steps.length) + 1))

    def _restored(self, step: int, X: FloatArray) -> FloatArray:
        """Return the derivative of the state after bars were put on their lengths."""
        exact = self._exact(step)
        if exact is None:
            return X
        X = exact[0] @ X
        for columns, changes in self._restored_by(step):
            X[:, columns] += exact[1] @ changes
        return X

    def _restored_back(self, step: int, mu: FloatArray, slope: FloatArray) -> FloatArray:
        """Return a cost by x before bars were put on their lengths; add those by these."""
        exact = self._exact(step)
        if exact is None:
            return mu
        for columns, changes in self._restored_by(step):
            slope[columns] += (mu @ exact[1]) @ changes
        return np.asarray(exact[0].T @ mu)

    def _restored_by(self, step: int) -> Iterator[tuple[slice, FloatArray]]:
        """Yield columns, and what they change of lengths and rates at the end of a step."""
        begin, length = self.steps.begin[[step]], self.steps.length[step]
        for parameter, columns in zip(self.parameters, self.columns, strict=True):
            if parameter.kind == "bars" and self.lengths is not None:
                yield columns, self.lengths.at(begin + length, begin + length / 2, 2)[0]

    @cached_property
    def _exact_slopes(self) -> dict[int, tuple[FloatArray, FloatArray]]:
        return {}

    def _exact(self, step: int) -> tuple[FloatArray, FloatArray] | None:
        """Return the derivative of what puts bars on their lengths at the end of a step.

        By the state before, and by lengths and rates of bars; none of these where bars are rigid.
        """
        is_done = isinstance(self._stepper, CoreSteps) and self._stepper.projects
        if is_done or not self.steps.projects:
            return None
        known = self._exact_slopes
        if step not in known:
            known.clear()
            block = self._block
            first = step // block * block
            rows = slice(first, first + block)
            some = self.derivatives.projected(self._ends[:, rows], self._end_inputs[:, rows])
            if some is None:
                return None
            by_lengths = some[0][:, :, :0] if some[1] is None else some[1]
            pairs = zip(some[0], by_lengths, strict=True)
            known |= {first + i: derivatives for i, derivatives in enumerate(pairs)}
        return known[step]

    @cached_property
    def _places(self) -> tuple[dict[int, list[int]], dict[int, list[tuple[float, int]]]]:
        """Return of steps which times are their end, and parts of them that reach others."""
        steps = self.steps
        ends: dict[int, list[int]] = {}
        parts: dict[int, list[tuple[float, int]]] = {}
        for i, k in enumerate(steps.step_at(self.times).tolist()):
            past, length = float(self.times[i] - steps.begin[k]), float(steps.length[k])
            if past <= 0:
                continue
            if abs(past - length) <= 1e-9 * length:
                ends.setdefault(k, []).append(i)
            else:
                parts.setdefault(k, []).append((past, i))
        return ends, parts

    @cached_property
    def _block(self) -> int:
        """Number of steps whose derivatives are held at a time."""
        half, stages = self.derivatives.half, len(self._tableau.b)
        width = 2 * half + len(self.derivatives.structure.strings)
        for parameter in self.parameters:
            if parameter.kind == "supports":
                width += 3 * self.steps.layout.offset * parameter.size // max(half, 1)
            elif parameter.kind != "input":
                width += parameter.size
        width += 3 * self.steps.layout.lengths
        numbers = stages * half * width
        validation.refuse_memory(
            "the derivative of a step", 1, "steps", 8 * numbers, ". Use a smaller structure"
        )
        return max(1, _MOST_NUMBERS // numbers)

    def _legs(self, is_back: bool) -> Iterator[_Leg]:
        """Yield the steps in order, or back from the last, each after its parts.

        Steps between which nothing is to be done follow one another in one leg.
        """
        plan = list(self._planned(is_back))
        if self._stepper is not None:
            yield from plan
            return
        for first in range(0, len(plan), self._block):
            yield from self._differentiated(plan[first : first + self._block])

    def _planned(self, is_back: bool) -> Iterator[_Leg]:
        ends, parts = self._places
        count = len(self.steps.length)
        most = 1 if self._stepper is None else self._stepper.most
        stops = {*self._passed.tolist(), *ends, *parts, *(k - 1 for k in parts), count - 1}
        if self.answers is not None:
            stops |= {k - 1 for k in range(count) if self.answers.begins(k)}
        legs: list[list[_Leg]] = []
        first = 0
        for stop in sorted(k for k in stops if k >= 0):
            for k in range(first, stop + 1, most):
                some = min(most, stop + 1 - k)
                own = [
                    _Leg(k, 1, *reached, None, []) for reached in parts.get(stop, []) if k == stop
                ]
                whole = _Leg(k, some, None, -1, None, [])
                legs.append([whole, *own] if is_back else [*own, whole])
            first = stop + 1
        for leg in reversed(legs) if is_back else legs:
            yield from leg

    def _differentiated(self, plan: list[_Leg]) -> Iterator[_Leg]:
        """Yield legs with the derivatives at their stages: found for all of them together."""
        steps, c = self.steps, self._tableau.c
        of = np.array([leg.step for leg in plan])
        h = np.array([self._length_of(leg) for leg in plan])
        slopes, states, inputs = stages(steps, self.derivatives, self._tableau, of, h)
        count, all_inputs = len(plan), np.hstack(inputs)
        derivatives = self.derivatives.at(
            np.hstack(states), all_inputs, np.tile(steps.taut[:, of], len(c)), np.hstack(slopes),
            steps.support_motion(all_inputs, 2) if steps.layout.offset else None,
        )  # fmt: skip
        time = (steps.begin[of] + c[:, None] * h).ravel()
        middle = np.tile(steps.begin[of] + h / 2, len(c))
        counts = self._counts(time, middle)
        for i, leg in enumerate(plan):
            own_counts = [None if every is None else every[i::count] for every in counts]
            yield leg._replace(stages=derivatives.of(slice(i, None, count)), counts=own_counts)
