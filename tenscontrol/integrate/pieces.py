"""Adaptive integration in smooth pieces: every piece ends where a string goes slack or taut."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Equation, Evaluator
from tenscontrol.integrate.integrator import (
    IntegrationError,
    Integrator,
    Report,
    Span,
    Work,
    checked_tolerance,
)
from tenscontrol.integrate.projection import Projector
from tenscontrol.integrate.scales import largest_frequency, state_scale
from tenscontrol.validation import FloatArray

# How far a string may pass the border of slack before it switches, of the longest rest length.
# A string that rests on the border so keeps its state, and one that has switched must come back
# by twice as much to switch again. Far above round-off, and far below what the motion feels.
_BAND = 1e-11

# So many landings within this part of a span are chatter.
_CHATTER, _CHATTER_TIME = 200, 1e-6

# A landing is sought so many times at most: it is Newton's method with an almost exact start.
_POLISH = 8


@dataclass(frozen=True, eq=False)
class Step:
    """Motion over one step of a method.

    Attributes
    ----------
    times : ndarray, shape (k,)
        Where the strings are looked at, s: equally spaced, from the step's start to its end.
    between : callable
        ``(times) -> states``, shape (states, count), by the method's own interpolation.
    state : ndarray, shape (states,)
        State at the end.
    """

    times: FloatArray
    between: Callable[[FloatArray], FloatArray]
    state: FloatArray


class Piece(Protocol):
    """A motion whose strings stay slack or taut, taken step by step."""

    @property
    def work(self) -> Work:
        """What was done so far, landings included."""

    def step(self) -> Step:
        """Take the next step; raise FloatingPointError where there is none."""

    def land(self, step: Step, time: float) -> FloatArray:
        """Return the state at a time within a step as exactly as at the ends of steps."""


@dataclass(frozen=True, eq=False)
class _Landing:
    time: float
    state: FloatArray
    crossed: FloatArray  # 1 for each string that goes slack or taut here
    located: bool


class PiecewiseIntegrator(Integrator):
    """Adaptive integration that never steps across a switch of a string.

    Where a string passes the border of slack within a step, the step is cut
    there: the passing is found on the method's interpolation, the motion
    integrated again up to it, and the time corrected until the string stands
    on the border. Strings that stand there together switch together. Where no
    string can go slack nothing of this is done.

    Parameters
    ----------
    equation : Equation
    tolerance : float
        Error allowed a step, as part of the size of the structure for
        positions, and of its characteristic speed for velocities.
    project : bool
        Whether to make the bar lengths of the states returned exact.
    """

    def __init__(self, equation: Equation, tolerance: float, project: bool = True) -> None:
        super().__init__(equation)
        self._projected = Projector(equation, project)
        # Set by the first motion: the methods see the state as parts of it.
        self._scale: FloatArray | None = None
        self.tolerance = checked_tolerance(tolerance)
        self._gaps: dict[int, Evaluator] = {}

    @abstractmethod
    def _prepare(self, equation: Equation) -> None:
        """Build what the method needs for an equation of states near 1."""

    @abstractmethod
    def _begin(
        self,
        now: float,
        state: FloatArray,
        held: FloatArray,
        taut: FloatArray,
        times: FloatArray,
        before: Piece | None,
    ) -> Piece:
        """Return the piece that starts now; ``times`` are the outputs, the last ends the span."""

    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        if self._scale is None:
            frequency = largest_frequency(self._equation, state, held)
            self._scale = state_scale(self._equation, state, held, frequency)
            self._equation = _scaled(self._equation, self._scale)
            self._prepare(self._equation)
        state = state / self._scale
        times = duration * np.arange(1, outputs + 1) / outputs
        times[-1] = duration  # whatever round-off says
        states = np.empty((len(state), outputs))
        now, done, work = 0.0, 0, Work()
        piece: Piece | None = None
        landings = deque([-duration], maxlen=_CHATTER)
        try:
            # A state that is not finite is looked for, so NumPy need not warn of it.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                taut = self._taut(state, held)
                while now < duration:
                    following = self._begin(now, state, held, taut, times, piece)
                    work += Work() if piece is None else piece.work
                    piece, landing = following, None
                    while now < duration and landing is None:
                        step = piece.step()
                        landing = self._landing(piece, step, held, taut)
                        end = float(step.times[-1])
                        now, state = end, step.state
                        if landing is not None:
                            now, state = landing.time, landing.state
                        reached = int(np.searchsorted(times, now, side="right"))
                        if reached > done:
                            states[:, done:reached] = step.between(times[done:reached])
                            if times[reached - 1] == now:
                                states[:, reached - 1] = state
                            done = reached
                        if report is not None:
                            report(now)
                    if landing is not None:
                        taut = np.abs(taut - landing.crossed)
                        count = int(landing.crossed.sum())
                        work += Work(switches=count) if landing.located else Work(unlocated=1)
                        _refuse_chatter(landings, now, duration)
        except FloatingPointError as error:
            work += Work() if piece is None else piece.work
            raise IntegrationError(
                f"{self.name} stopped after {now:.6g} s: {error}",
                now,
                Span(self._returned(states[:, :done]), work),
            ) from None
        except KeyboardInterrupt:
            work += Work() if piece is None else piece.work
            so_far = Span(self._returned(states[:, :done]), work)
            raise IntegrationError("interrupted", now, so_far, True) from None
        assert piece is not None  # the span has a length
        return Span(self._returned(states), work + piece.work)

    def _returned(self, states: FloatArray) -> FloatArray:
        """Return states in m and m/s, bar lengths exact if that is wanted."""
        assert self._scale is not None  # set before the first step
        return self._projected(states * self._scale[:, None])

    # ---- where strings go slack or taut ----

    def _gap(self, states: FloatArray, held: FloatArray) -> FloatArray:
        """Return the gap of each string at each of some states, shape (α, count)."""
        count = states.shape[1]
        if count not in self._gaps:
            x = self._equation.symbol("x", self._equation.states)
            u = self._equation.symbol("u", self._equation.inputs)
            gap = ca.Function("gap", [x, u], [self._equation.gap(x, u)[0]])
            self._gaps[count] = Evaluator(gap.map("gaps", "serial", count, [1], []))
        given = states[:, 0] if count == 1 else states
        return self._gaps[count](given, held)[0].reshape(-1, count, order="F").copy()

    def _taut(self, state: FloatArray, held: FloatArray) -> FloatArray:
        if self._equation.switches == 0:
            return np.zeros(0)
        return (self._gap(state[:, None], held)[:, 0] > 0).astype(float)

    def _room(self, states: FloatArray, held: FloatArray, taut: FloatArray) -> FloatArray:
        """Return how far strings are from switching, in bands: 1 on the border, 0 where they do."""
        # Where strings can go slack, u holds their rest lengths.
        band = _BAND * (1.0 if self._equation.structure is None else float(held.max()))
        return np.where(taut > 0, 1.0, -1.0)[:, None] * self._gap(states, held) / band + 1.0

    def _landing(
        self, piece: Piece, step: Step, held: FloatArray, taut: FloatArray
    ) -> _Landing | None:
        """Return the first switch within a step, if there is one."""
        if self._equation.switches == 0:
            return None

        def room(times: FloatArray) -> FloatArray:
            return self._room(step.between(times), held, taut)

        start, end = float(step.times[0]), float(step.times[-1])
        time = _first_crossing(room, step.times)
        if time is None:
            return None
        if time - start <= 4 * np.spacing(end):
            # Past the border already, by less than the interpolation of the last step saw.
            at = room(step.times[:1])[:, 0]
            crossed = at <= max(0.5, float(at.min()))
            state = step.between(step.times[:1])[:, 0]
            return _Landing(start, state, crossed.astype(float), located=False)
        apart = 1e-3 * (end - start)
        for _ in range(_POLISH):
            state = piece.land(step, time)
            left = self._room(state[:, None], held, taut)[:, 0]
            if abs(left.min()) < 0.25:
                break
            around = room(np.array([time - apart, time + apart]))[left.argmin()]
            rate = (around[1] - around[0]) / (2 * apart)
            if not rate < 0:
                break  # it grazes the border: an ordinary end of a step
            time = float(np.clip(time - left.min() / rate, start + 1e-3 * apart, end))
        return _Landing(time, state, (left < 0.5).astype(float), located=True)


def _scaled(equation: Equation, scale: FloatArray) -> Equation:
    """Return the equation of the state as part of its scale."""
    y, u = equation.symbol("y", equation.states), equation.symbol("u", equation.inputs)
    taut, size = equation.symbol("taut", equation.switches), ca.DM(scale)
    slope = equation.slope(y * size, u, taut) / size
    return replace(
        equation,
        slope=ca.Function("slope", [y, u, taut], [slope]),
        gap=ca.Function("gap", [y, u], list(equation.gap(y * size, u))),
    )


def _first_crossing(room: Callable[[FloatArray], FloatArray], times: FloatArray) -> float | None:
    """Return when the least room first falls below zero within a step, or None."""
    from scipy.optimize import brentq

    seen = room(times)
    dips = _dips(times, seen)
    if len(dips):
        times = np.union1d(times, dips)
        seen = room(times)
    below = np.flatnonzero(seen.min(axis=0) < 0)
    if len(below) == 0:
        return None
    first = below[0]
    if first == 0:
        return float(times[0])
    return float(
        brentq(
            lambda time: room(np.array([time])).min(),
            times[first - 1],
            times[first],
            xtol=1e-300,
            rtol=4 * np.finfo(float).eps,
        )
    )


def _dips(times: FloatArray, seen: FloatArray) -> FloatArray:
    """Return times between those looked at where a parabola says that room may fall below zero."""
    left, middle, right = seen[:, :-2], seen[:, 1:-1], seen[:, 2:]
    half, bend = (right - left) / 2, right - 2 * middle + left
    place = -half / np.where(bend > 0, bend, np.inf)
    lowest = middle + half * place / 2
    # A little above zero the parabola may be wrong, and it costs little to look.
    strings, at = np.nonzero((bend > 0) & (np.abs(place) <= 1) & (lowest < 0.2 * middle))
    found: FloatArray = times[at + 1] + place[strings, at] * (times[1] - times[0])
    return found


def _refuse_chatter(landings: deque[float], now: float, duration: float) -> None:
    landings.append(now)
    if len(landings) == _CHATTER and now - landings[0] < _CHATTER_TIME * duration:
        raise FloatingPointError(
            f"strings go slack and taut {_CHATTER} times within {now - landings[0]:.1e} s"
        )
