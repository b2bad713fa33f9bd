"""Event location: steps end where a string goes slack or taut, or a contact opens or closes.

A step across such a switching surface loses the order of every method. So a step is taken with
the strings that pull and those that are slack as they are at its start, and so with contacts. If
one of them changes within, the step is cut there, and the rest follows with it changed. What is
said of strings below holds for contacts.

CVODES takes many steps of its own in a call, starts again at order 1, and serves equations without
accelerations, which the quintic interpolant of a single step needs; so it searches the states of a
call by :func:`first_crossing`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import sqrt
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import Evaluator, Function
from tenscontrol.properties import cached_property

# How far a string may pass the border of slack before it is acted on, as part of its rest
# length, and a contact as part of the size; in CVODES, of the largest of these. It covers
# round-off, so that strings that switch together by symmetry are taken together, and a string that
# was switched does not switch back at once: it must come back by twice as much. The force is wrong
# by the stiffness times this, for as long as the string needs to cross it.
BAND = 1e-11

# The search inside a step: samples, how often it zooms in on the samples next to the first
# crossing, and the most true steps to the place found. The interpolant is off by O(h⁶), its slope
# by O(h⁵), so each true step gains several digits.
SAMPLES = 6
_ZOOMS = 2
POLISHES = 8

# A gap is flat beyond the border where it falls by less than this part of its slope before.
FLAT = 0.1

# Chords on the interpolant to the place of a switch, and how far apart parts of a step have one.
CHORDS, _APART = 6, 1e-6

# How late steps of a method without error control end at a switch, as part of the length of the
# string: the force is wrong by the square of it. And at most, as part of the step.
LATE, MOST_LATE = 1e-9, 1e-3

# With ground: a node that dips in by δ at the acceleration a stays √(8δ/a), a small part of a long
# step. Each zoom finds dips of a ninth of the depth.
_ZOOMS_ON_GROUND = 7

# Steps to a crossing, which is next to zero where a string starts on the border of slack.
_MOST_HALVINGS = 5000

# So many landings of CVODES within this part of a span are chatter.
CHATTER, _CHATTER_TIME = 200, 1e-6


class Step(NamedTuple):
    """A step for fixed ``taut``, whose switches are looked for."""

    x: FloatArray
    slope: FloatArray
    x1: FloatArray  # at its end, as is the slope
    slope1: FloatArray
    u: FloatArray  # the input that begins with the step
    taut: FloatArray
    h: float


class Cut(NamedTuple):
    """Where a step is to end: at its first switch, found on an interpolant."""

    part: float  # of the step
    speed: float  # slope of the gap along the step
    aim: float  # the gap to end at
    chosen: FloatArray  # of each string, its share of the mean gap
    leaving: Any  # whether a string is on its way out


class Switches:
    """Location of the switches of an equation within a step of any method.

    Parameters
    ----------
    equation : Equation
    """

    def __init__(self, equation: Equation) -> None:
        self._equation = equation
        self._gap = Evaluator(equation.gap)
        if equation.switches:
            self._searching = equation.prepared.get("search", lambda: _searching(equation))

    @cached_property
    def _search(self) -> list[Evaluator]:
        return [Evaluator(function) for function in self._searching]

    def taut(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return which strings pull in a state, 1 or 0 each."""
        return (self._gap(x, u)[0] > 0).astype(float)

    def first(self, step: Step, allowed: float, least: float) -> Cut | None:
        """Return the first switch within a step, or None where there is none after all.

        A step that ends past the border by δ, where the gap shrinks at r, leaves an impulse of
        δ²/2r times the stiffness, as a force that does not depend on velocities is continuous
        there. So it ends past the border by at most ``√(allowed r)``, or the part ``least`` of the
        length of the string if that is more, and never before it: the next step would be wrong.
        Other forces jump: at most a fifth of :data:`BAND` then.

        Parameters
        ----------
        step : Step
        allowed : float
            m s; see above.
        least : float
        """
        interpolant, crossed, room, lowest, scale = self._search
        coefficients = interpolant(step.x, step.slope, step.x1, step.slope1, step.h)[0]
        within = coefficients, step.u, step.taut, step.h
        is_crossed = crossed(step.x, step.x1, step.u, step.taut, step.h)[0].copy()
        while True:
            low, high, is_out = 0.0, 1.0, False
            for zoom in range(zooms(self._equation)):
                width = (high - low) / SAMPLES
                samples = lowest(*within, low + width * _PLACES, is_crossed)[0].ravel().tolist()
                first, last, is_out = _bracket(samples)
                low, high = low + first * width, low + last * width
                if is_out and zoom >= _ZOOMS:
                    out = (room(*within, high)[0] < 0) & (is_crossed > 0)
                    if np.count_nonzero(out) == 1:  # nothing else can be first
                        break
            if not is_out:
                return None
            inside = room(*within, low)[0].copy()
            # What is out already there went out before: the ends of the step did not tell of it.
            earlier = (inside < 0) & (is_crossed == 0)
            if low == 0 or not earlier.any():
                break
            is_crossed[earlier] = 1.0
        outside = room(*within, high)[0].copy()
        edge = BAND * float(scale(step.u)[0].min())
        # The string that is out first, by the secants; several, where they go out together.
        start = np.maximum(inside, 0)
        share = np.where(outside < 0, start / np.where(outside < 0, start - outside, 1), 1)
        at_first = inside + share.min() * (outside - inside)
        is_chosen = (outside < 0) & (at_first <= 0.5 * edge)
        chosen = is_chosen / np.count_nonzero(is_chosen)
        # Their mean gap, and where it is to end.
        before, after = float(chosen @ inside) - edge, float(chosen @ outside) - edge
        speed = (after - before) / (high - low)
        late = 0.0
        if not self._equation.velocity_dependent:
            late = min(sqrt(allowed * abs(speed) / step.h), MOST_LATE * abs(speed))
            late = max(late, least * edge / BAND)
        aim = max(-max(late, 0.2 * edge), after) / 2
        # The Illinois method: the chord of a string that starts at rest on the border is far from
        # its slope there, and others that start next to it are not to be passed.
        left, right, over, under = low, high, before - aim, after - aim
        fraction, gap = high, under
        for _ in range(CHORDS):
            place, gap_there = fraction, gap
            chord = over * (right - left) / (over - under) if over != under else 0.0
            fraction = min(max(left + chord, left), right)
            gap = float(chosen @ room(*within, fraction)[0]) - edge - aim
            if abs(fraction - place) > _APART:
                secant = (gap - gap_there) / (fraction - place)
                speed = secant if secant < 0 else speed
            if gap > 0:
                left, over, under = fraction, gap, under / 2
            else:
                right, over, under = fraction, over / 2, gap
        return Cut(fraction, speed, aim, chosen, outside < inside)

    def approach(
        self, step: Step, cut: Cut, state_at: Callable[[float], FloatArray]
    ) -> tuple[FloatArray, float, int]:
        """Go to a switch by the secant method.

        Parameters
        ----------
        step : Step
        cut : Cut
        state_at : callable
            ``(fraction) -> x`` after a fraction of the step.

        Returns
        -------
        x : ndarray, shape (states,)
            As ``state_at`` returned it.
        fraction : float
            Of the step, where x is past the border by twice the aim at most.
        places : int
            Number of places it went to.
        """
        layout, sign = self._equation.layout, (2 * step.taut - 1) * cut.chosen
        fraction, wanted, speed, gap_before = 0.0, cut.part, cut.speed, cut.aim
        x, places = step.x, 0
        while places < POLISHES and (not places or abs(gap_before - cut.aim) > abs(cut.aim)):
            before = fraction
            # Without a slope, as of a string that grazes, it stays where it is.
            fraction = min(max(wanted, 0.0), 1.0) if speed < 0 else 0.0
            x = state_at(fraction)
            gap = float(sign @ self._gap(x, layout.later(step.u, fraction * step.h))[0])
            # The gap of a damped string has a kink next to the border: the tension falls fast up
            # to it, and beyond it is the stretch that counts. Where it is flat between two places
            # beyond, the next is twice as far back. Closer places differ by round-off.
            is_flat = False
            if places and abs(fraction - before) > _APART:
                secant = (gap - gap_before) / (fraction - before)
                is_flat = max(gap, gap_before) < 0 and secant > FLAT * speed
                speed = secant if secant < 0 and not is_flat else speed
            change = (cut.aim - gap) / speed if speed else 0.0
            wanted = fraction - 2 * abs(fraction - before) if is_flat else fraction + change
            gap_before = gap
            places += 1
        return x, fraction, places

    def switched(
        self, x: FloatArray, u: FloatArray, taut: FloatArray, cut: Cut
    ) -> tuple[FloatArray, int]:
        """Return ``taut`` with what has reached its border on the way out changed, and how much."""
        gap = (2 * taut - 1) * self._gap(x, u)[0]
        switch = (gap <= 0.5 * BAND * self._search[-1](u)[0]) & cut.leaving
        return np.where(switch, 1 - taut, taut), int(np.count_nonzero(switch))


_PLACES = np.arange(1.0, SAMPLES + 1)


def zooms(equation: Equation) -> int:
    """Return how often the search zooms in."""
    return _ZOOMS if equation.contacts is None else _ZOOMS_ON_GROUND


def _bracket(rooms: list[float]) -> tuple[int, int, bool]:
    """Return the samples next to the first that is out, else to the lowest; whether one is out."""
    for j, room in enumerate(rooms):
        if room < 0:
            return j, j + 1, True
    j = rooms.index(min(rooms))
    return j, min(j + 2, SAMPLES), False


def _searching(equation: Equation) -> tuple[ca.Function, ...]:
    """Return what finds the first switch of a step that is crossed.

    An interpolant, what may switch, its room at a place, the least room of that at several places,
    and sizes of gaps.
    """
    room, u = room_inside(equation), equation.symbols()[1]
    given = room.sx_in() if room.is_a("SXFunction") else room.mx_in()
    is_crossed = type(given[0]).sym("crossed", equation.switches)
    least = ca.mmin(room(*given) + validation.LARGEST * (1 - is_crossed))
    lowest = Function("lowest", [*given, is_crossed], [least])
    lowest = lowest.map("samples", "serial", SAMPLES, [0, 1, 2, 3, 5], [])
    x, u, taut, h = equation.symbols()
    x1 = equation.symbol("x1", equation.states)
    crossed = crossed_within(equation, x, x1, u, taut, h)[0]
    crossed = Function("crossed", [x, x1, u, taut, h], [ca.densify(crossed)])
    scale = Function("scale", [u], [ca.densify(equation.gap_scale(u))])
    return interpolant(equation), crossed, room, lowest, scale


def crossings(equation: Equation) -> ca.Function:
    """Return ``(x, x1, u, taut, h) -> count`` of switches in a step that is not cut at them.

    A string that is out at the end has switched once, at least; one that comes back in, twice.
    It is one function, as every step is looked at. A state that is not finite, or whose square is
    not, is not searched: -1.
    """
    x, u, taut, h = equation.symbols()
    x1 = equation.symbol("x1", equation.states)
    count: Any = ca.DM(0)
    if equation.switches:
        crossed, out = crossed_within(equation, x, x1, u, taut, h)
        count = ca.sum1(2 * crossed - crossed * out)
    count = ca.if_else(ca.sumsqr(x1) < ca.inf, count, -1)
    return Function("crossings", [x, x1, u, taut, h], [ca.densify(count)])


def crossed_within(
    equation: Equation, x: Any, x1: Any, u: Any, taut: Any, h: Any
) -> tuple[Any, Any]:
    """Return the expressions of which strings may switch within a step, and are out at its end.

    A string that is inside at both ends, but goes out at the start and comes in
    at the end, is taken as a crossing where the tangents at both ends meet
    outside: no less can be said without looking at the inside of the step.
    """
    sign, band = 2 * taut - 1, BAND * equation.gap_scale(u)
    (gap0, rate0), (gap1, rate1) = equation.gap(x, u), equation.gap(x1, equation.ahead(u, h))
    room0, room1 = sign * gap0 + band, sign * gap1 + band
    crossed = ca.logic_or(room1 < 0, _meet_outside(room0, room1, -sign * rate0, sign * rate1, h))
    if equation.velocity_dependent:
        damped = _damped_crossing(equation)(x, x1, u, taut, h, rate0, rate1)
        crossed = ca.logic_or(crossed, damped)
    return crossed, room1 < 0


def _damped_crossing(equation: Equation) -> ca.Function:
    """Return ``(x, x1, u, taut, h, rate, rate1) -> crossed`` where forces depend on velocities.

    The border of a damped string has other tangents than its stretch: the middle of the step is
    looked at. And a slack string pulls as soon as its stretch grows through zero, however soon the
    damping lets it go again: a stretch that is above zero at the end, or tangents that meet there.
    """
    n = equation.states
    x, u, taut, h = equation.symbols()
    x1 = equation.symbol("x1", n)
    rate, rate1 = (equation.symbol(name, equation.switches) for name in ("rate", "rate1"))
    later, sign, band = equation.ahead(u, h), 2 * taut - 1, BAND * equation.gap_scale(u)
    q, v, q1, v1 = x[: n // 2], x[n // 2 :], x1[: n // 2], x1[n // 2 :]
    middle = ca.vertcat((q + q1) / 2 + h / 8 * (v - v1), 1.5 / h * (q1 - q) - (v + v1) / 4)
    inside = sign * equation.gap(middle, equation.ahead(u, h / 2))[0] + band < 0
    # At rest, nothing is damped: the gap is the stretch.
    still = ca.DM.zeros(n // 2)
    room0 = band - equation.gap(ca.vertcat(q, still), u)[0]
    room1 = band - equation.gap(ca.vertcat(q1, still), later)[0]
    dips = _meet_outside(room0, room1, rate, -rate1, h)
    pulls = ca.logic_and(room0 > 0, ca.logic_or(room1 < 0, dips))
    outputs = [ca.logic_or(inside, ca.logic_and(taut == 0, pulls))]
    return Function("damped", [x, x1, u, taut, h, rate, rate1], outputs)


def _meet_outside(room0: Any, room1: Any, out: Any, back: Any, h: Any) -> Any:
    """Return whether the tangents room0 - out t and room1 - back (h - t) meet below zero."""
    below = back * room0 + out * room1 < out * back * h
    return ca.logic_and(ca.logic_and(out > 0, back > 0), below)


def interpolant(equation: Equation) -> ca.Function:
    """Return ``(x, xd, x1, xd1, h) -> coefficients`` of the positions inside a step.

    They belong to the polynomial of degree 5 with the positions, velocities and
    accelerations at both ends; one column a power of the part of the step.
    """
    n = equation.states
    x, xd, x1, xd1 = (equation.symbol(name, n) for name in ("x", "xd", "x1", "xd1"))
    h = equation.symbol("h")
    q0, v0, q1, v1 = x[: n // 2], h * x[n // 2 :], x1[: n // 2], h * x1[n // 2 :]
    a0, a1 = h**2 * xd[n // 2 :], h**2 * xd1[n // 2 :]
    d, e, f = q1 - q0 - v0 - a0 / 2, v1 - v0 - a0, a1 - a0
    higher = (10 * d - 4 * e + f / 2, -15 * d + 7 * e - f, 6 * d - 3 * e + f / 2)
    return Function("interpolant", [x, xd, x1, xd1, h], [ca.horzcat(q0, v0, a0 / 2, *higher)])


def room_inside(equation: Equation) -> ca.Function:
    """Return ``(coefficients, u, taut, h, part) -> room`` of each string inside a step."""
    coefficients = equation.symbol("coefficients", equation.states // 2, 6)
    _, u, taut, h = equation.symbols()
    s = equation.symbol("part")
    q: Any = 0
    v: Any = 0
    for power in range(5, -1, -1):
        q = q * s + coefficients[:, power]
        if power:
            v = v * s + power * coefficients[:, power]
    gap = equation.gap(ca.vertcat(q, v / h), equation.ahead(u, s * h))[0]
    room = (2 * taut - 1) * gap + BAND * equation.gap_scale(u)
    return Function("room", [coefficients, u, taut, h, s], [room])


# ---- a method with a solver of its own ----


def first_crossing(room: Callable[[FloatArray], FloatArray], times: FloatArray) -> float | None:
    """Return when the least room first falls below zero within a window, or None.

    ``room`` takes times to an array (α, count); ``times``, where it is sampled first, are equally
    spaced.
    """
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
            maxiter=_MOST_HALVINGS,
        )
    )


def _dips(times: FloatArray, seen: FloatArray) -> FloatArray:
    """Return times between those looked at where a parabola says that room may fall below zero."""
    left, middle, right = seen[:, :-2], seen[:, 1:-1], seen[:, 2:]
    half, bend = (right - left) / 2, right - 2 * middle + left
    vertex = -half / np.where(bend > 0, bend, np.inf)
    lowest = middle + half * vertex / 2
    # A little above zero the parabola may be wrong, and it costs little to look.
    strings, index = np.nonzero((bend > 0) & (np.abs(vertex) <= 1) & (lowest < 0.2 * middle))
    dips: FloatArray = times[index + 1] + vertex[strings, index] * (times[1] - times[0])
    return dips


def refuse_chatter(landings: deque[float], now: float, duration: float) -> None:
    """Add a landing; raise FloatingPointError if too many lie within a small part of the span."""
    landings.append(now)
    if len(landings) == CHATTER and now - landings[0] < _CHATTER_TIME * duration:
        raise FloatingPointError(
            f"strings go slack and taut, or contacts open and close, {CHATTER} times within "
            f"{now - landings[0]:.1e} s"
        )
