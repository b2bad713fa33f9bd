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
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import Evaluator, Function
from tenscontrol.integrate.integrator import where_needed
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
_SAMPLES = 6
_ZOOMS = 2
_POLISHES = 8

# A gap is flat beyond the border where it falls by less than this part of its slope before.
_FLAT = 0.1

# Chords on the interpolant to the place of a switch, and how far apart parts of a step have one.
_CHORDS, _APART = 6, 1e-6

# How late steps of a method without error control end at a switch, as part of the length of the
# string: the force is wrong by the square of it. And at most, as part of the step.
LATE, _MOST_LATE = 1e-9, 1e-3

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
    crossed: FloatArray  # of each string, 1 if it may switch: see `crossings`


class Cut(NamedTuple):
    """Where a step is to end: at its first switch, found on an interpolant."""

    part: float  # of the step
    speed: float  # slope of the gap along the step
    aim: float  # the gap to end at
    chosen: FloatArray  # of each string, its share of the mean gap
    leaving: FloatArray  # whether a string is on its way out, 1 or 0


class Landing(NamedTuple):
    """The end of a step, at a switch or, where there is none, as it was tried."""

    x: FloatArray
    taut: FloatArray  # from there on
    part: float = 1.0  # of the step
    places: int = 0  # that were gone to
    switches: int = 0  # there


class Switches:
    """Location of the switches of an equation within a step of any method.

    Parameters
    ----------
    equation : Equation
    """

    def __init__(self, equation: Equation) -> None:
        self._layout = equation.layout
        self._border = Evaluator(equation.prepared.get("border", lambda: _border(equation)))
        if equation.switches:
            self._searching = equation.prepared.get("search", lambda: _search(equation))

    @cached_property
    def _search(self) -> Evaluator:
        return Evaluator(self._searching)

    def taut(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return which strings pull in a state, 1 or 0 each."""
        return (self._border(x, u)[0] > 0).astype(float)

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
        crossed = step.crossed
        while True:
            cut, chosen, leaving, crossed = self._search(*step[:-1], crossed, allowed, least)
            is_out, is_again, fraction, speed, aim = cut.tolist()
            if not is_out:
                return None
            if not is_again:
                return Cut(fraction, speed, aim, chosen, leaving)

    def approach(self, step: Step, cut: Cut, state_at: Callable[[float], FloatArray]) -> Landing:
        """Go to a switch by the secant method, past its border by twice the aim at most.

        What has reached its border on the way out there is changed.

        Parameters
        ----------
        step : Step
        cut : Cut
        state_at : callable
            ``(fraction) -> x`` after a fraction of the step.
        """
        sign, share = 2 * step.taut - 1, cut.chosen
        fraction, wanted, speed, gap_before = 0.0, cut.part, cut.speed, cut.aim
        places = 0
        while True:
            before = fraction
            # Without a slope, as of a string that grazes, it stays where it is.
            fraction = min(max(wanted, 0.0), 1.0) if speed < 0 else 0.0
            x = state_at(fraction)
            places += 1
            gaps, scale = self._border(x, self._layout.later(step.u, fraction * step.h))
            gaps = sign * gaps
            gap = float(share @ gaps)
            if places == _POLISHES or abs(gap - cut.aim) <= abs(cut.aim):
                break
            # The gap of a damped string has a kink next to the border: the tension falls fast up
            # to it, and beyond it is the stretch that counts. Where it is flat between two places
            # beyond, the next is twice as far back. Closer places differ by round-off.
            is_flat = False
            if places > 1 and abs(fraction - before) > _APART:
                secant = (gap - gap_before) / (fraction - before)
                is_flat = max(gap, gap_before) < 0 and secant > _FLAT * speed
                speed = secant if secant < 0 and not is_flat else speed
            change = (cut.aim - gap) / speed if speed else 0.0
            wanted = fraction - 2 * abs(fraction - before) if is_flat else fraction + change
            gap_before = gap
        switch = (gaps <= 0.5 * BAND * scale) * cut.leaving
        taut = np.abs(step.taut - switch)
        return Landing(x.copy(), taut, fraction, places, int(switch.sum()))


def _border(equation: Equation) -> ca.Function:
    """Return ``(x, u) -> (gap, scale)``: how far strings are from slack, and sizes of gaps."""
    x, u, *_ = equation.symbols()
    outputs = equation.gap(x, u)[0], ca.densify(equation.gap_scale(u))
    return Function("border", [x, u], outputs)


def _search(equation: Equation) -> ca.Function:
    """Return what finds the first switch of a step that is crossed, see :meth:`Switches.first`.

    ``(x, xd, x1, xd1, u, taut, h, crossed, allowed, least) -> (cut, chosen, leaving, crossed)``;
    cut holds whether something is out, whether to look again for what the ends did not tell of,
    and the rest of a :class:`Cut`.
    """
    x, u, taut, h = equation.symbols(ca.MX)
    xd, x1, xd1 = (ca.MX.sym(name, equation.states) for name in ("xd", "x1", "xd1"))
    crossed = ca.MX.sym("crossed", equation.switches)
    allowed, least = ca.MX.sym("allowed"), ca.MX.sym("least")
    room = _room(equation)
    zoom, chord = where_needed(_zoom(room)), _chord(room)
    given = path(equation)(x, xd, x1, xd1, h), u, taut, h
    window = ca.DM([0, 1, 0, 0])
    for count in range(_ZOOMS if equation.contacts is None else _ZOOMS_ON_GROUND):
        # Where one string alone is out, nothing else can be first.
        needed = 1 if count <= _ZOOMS else ca.logic_or(window[2] == 0, window[3] != 1)
        window = zoom(needed, window, *given, crossed)
    low, high, is_out, _ = ca.vertsplit(window)
    inside, outside = room(*given, low), room(*given, high)
    # What is out already there went out before: the ends of the step did not tell of it.
    earlier = ca.logic_and(ca.logic_and(inside < 0, crossed == 0), low > 0)
    edge = BAND * ca.mmin(equation.gap_scale(u))
    # The string that is out first, by the secants; several, where they go out together.
    start = ca.fmax(inside, 0)
    first = ca.mmin(ca.if_else(outside < 0, start / (start - outside), 1))
    at_first = inside + first * (outside - inside)
    is_chosen = ca.logic_and(outside < 0, at_first <= 0.5 * edge)
    chosen = is_chosen / ca.sum1(is_chosen)
    # Their mean gap, and where it is to end.
    before, after = ca.dot(chosen, inside) - edge, ca.dot(chosen, outside) - edge
    speed = (after - before) / (high - low)
    late: Any = 0
    if not equation.velocity_dependent:
        late = ca.fmin(ca.sqrt(allowed * ca.fabs(speed) / h), _MOST_LATE * ca.fabs(speed))
        late = ca.fmax(late, least * edge / BAND)
    aim = ca.fmax(-ca.fmax(late, 0.2 * edge), after) / 2
    state = ca.vertcat(low, high, before - aim, after - aim, high, after - aim, speed)
    for _ in range(_CHORDS):
        state = chord(state, *given, chosen, edge + aim)
    cut = ca.vertcat(is_out, ca.mmax(earlier), state[4], state[6], aim)
    return Function(
        "search",
        [x, xd, x1, xd1, u, taut, h, crossed, allowed, least],
        [cut, chosen, outside < inside, ca.fmax(crossed, earlier)],
    )


def _zoom(room: ca.Function) -> ca.Function:
    """Return ``(window, …, crossed) -> window``: next to the first sample that is out, or lowest.

    A window is (low, high, whether one is out there, how many strings are).
    """
    *given, fraction = room.mx_in()
    crossed = ca.MX.sym("crossed", room.size1_out(0))
    seen, window, j = ca.MX.sym("seen", 4), ca.MX.sym("window", 4), ca.MX.sym("j")
    rooms = room(*given, fraction) + validation.LARGEST * (1 - crossed)
    lowest = ca.mmin(rooms)
    is_out = lowest < 0
    at = ca.vertcat(lowest, j, ca.fmin(j + 2 - is_out, _SAMPLES), ca.sum1(rooms < 0))
    inputs = [seen, j, fraction, *given, crossed]
    sample = where_needed(Function("sample", inputs, [ca.if_else(lowest < seen[0], at, seen)]))
    low, high, *_ = ca.vertsplit(window)
    width, best = (high - low) / _SAMPLES, ca.MX(ca.DM([np.inf, 0, 1, 0]))
    for k in range(_SAMPLES):
        best = sample(best[0] >= 0, best, k, low + (k + 1) * width, *given, crossed)
    least, first, last, out = ca.vertsplit(best)
    end = ca.vertcat(low + first * width, low + last * width, least < 0, out)
    return Function("zoom", [window, *given, crossed], [end])


def _chord(room: ca.Function) -> ca.Function:
    """Return ``(state, …, chosen, edge) -> state``: a step of the Illinois method.

    The chord of a string that starts at rest on the border is far from its slope there, and others
    that start next to it are not to be passed. A state is (left, right, over, under, part, gap,
    speed).
    """
    *given, _ = room.mx_in()
    chosen, edge = ca.MX.sym("chosen", room.size1_out(0)), ca.MX.sym("edge")
    state = ca.MX.sym("state", 7)
    left, right, over, under, place, gap_there, speed = ca.vertsplit(state)
    fraction = ca.fmin(ca.fmax(left + over * (right - left) / (over - under), left), right)
    gap = ca.dot(chosen, room(*given, fraction)) - edge
    moved = fraction - place
    secant = (gap - gap_there) / moved
    speed = ca.if_else(ca.logic_and(ca.fabs(moved) > _APART, secant < 0), secant, speed)
    is_in = gap > 0
    end = ca.vertcat(
        ca.if_else(is_in, fraction, left), ca.if_else(is_in, right, fraction),
        ca.if_else(is_in, gap, over / 2), ca.if_else(is_in, under / 2, gap), fraction, gap, speed,
    )  # fmt: skip
    return Function("chord", [state, *given, chosen, edge], [end])


def crossings(equation: Equation) -> ca.Function:
    """Return ``(x, x1, u, taut, h) -> (count, crossed)``: switches of a step not cut at them.

    A string that is inside at both ends, but goes out at the start and comes in at the end, may
    switch within where the tangents at both ends meet outside: no less can be said without looking
    at the inside of the step. One that is out at the end has switched once, at least; one that
    comes back in, twice. What may switch is 1 in crossed, else 0. A state that is not finite, or
    whose square is not, is not searched: its count is -1.
    """
    x, u, taut, h = equation.symbols()
    x1 = equation.symbol("x1", equation.states)
    sign, band = 2 * taut - 1, BAND * equation.gap_scale(u)
    (gap0, rate0), (gap1, rate1) = equation.gap(x, u), equation.gap(x1, equation.ahead(u, h))
    room0, room1 = sign * gap0 + band, sign * gap1 + band
    crossed = ca.logic_or(room1 < 0, _meet_outside(room0, room1, -sign * rate0, sign * rate1, h))
    if equation.velocity_dependent:
        damped = _damped_crossing(equation, x, x1, u, taut, h, rate0, rate1)
        crossed = ca.logic_or(crossed, damped)
    count = ca.sum1(2 * crossed - crossed * (room1 < 0))
    count = ca.if_else(ca.sumsqr(x1) < ca.inf, count, -1)
    outputs = [ca.densify(count), ca.densify(crossed)]
    return Function("crossings", [x, x1, u, taut, h], outputs)


def _damped_crossing(
    equation: Equation, x: Any, x1: Any, u: Any, taut: Any, h: Any, rate: Any, rate1: Any
) -> Any:
    """Return the expression of what may switch besides where forces depend on velocities.

    The border of a damped string has other tangents than its stretch: the middle of the step is
    looked at. And a slack string pulls as soon as its stretch grows through zero, however soon the
    damping lets it go again: a stretch that is above zero at the end, or tangents that meet there.
    """
    n = equation.states
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
    return ca.logic_or(inside, ca.logic_and(taut == 0, pulls))


def _meet_outside(room0: Any, room1: Any, out: Any, back: Any, h: Any) -> Any:
    """Return whether the tangents room0 - out t and room1 - back (h - t) meet below zero."""
    below = back * room0 + out * room1 < out * back * h
    return ca.logic_and(ca.logic_and(out > 0, back > 0), below)


def path(equation: Equation) -> ca.Function:
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
    return Function("path", [x, xd, x1, xd1, h], [ca.horzcat(q0, v0, a0 / 2, *higher)])


def _room(equation: Equation) -> ca.Function:
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
