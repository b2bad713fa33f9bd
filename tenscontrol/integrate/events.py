"""Event location: steps end where a string goes slack or taut, or a contact opens or closes.

A step across such a switching surface loses the order of every method. So a step is taken with
the strings that pull and those that are slack as they are at its start, and so with contacts. If
one of them changes within, the step is cut there, and the rest follows with it changed. What is
said of strings below holds for contacts.

Methods whose step is a CasADi expression locate switches inside CasADi: :func:`located`,
:func:`crossing`, :func:`landing`. CVODES cannot: its call takes many steps of its own, starts
again at order 1, and serves equations without accelerations, which the quintic interpolant of a
single step needs; so it searches the states of a call by :func:`first_crossing`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.integrate.integrator import where_needed

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

# Chords on the interpolant to the place of a switch.
_CHORDS = 6

# How late steps of a method without error control end at a switch, as part of the length of the
# string: the force is wrong by the square of it. And at most, as part of the step.
LATE, _MOST_LATE = 1e-9, 1e-3

# With ground: a node that dips in by δ at the acceleration a stays √(8δ/a), a small part of a long
# step. Each zoom finds dips of a ninth of the depth.
_ZOOMS_ON_GROUND = 7

# Substeps that one step may be cut into; the rest is then taken whole, and its switches counted.
SUBSTEPS = 8

# Instructions of the room up to which it is written out for each sample.
_MOST_WRITTEN = 1000

# What is left of a step below this part of it is round-off.
REST = 1e-13

# Steps to a crossing, which is next to zero where a string starts on the border of slack.
_MOST_HALVINGS = 5000

# So many landings of CVODES within this part of a span are chatter.
CHATTER, _CHATTER_TIME = 200, 1e-6

#: What a located step counts: tries of a step, each with the evaluations of one; landings on a
#: switch, with two evaluations beside their tries; switches there, and in rests taken whole.
COUNTS = ("tries", "landings", "switches", "missed")


def located(step: ca.Function, equation: Equation) -> ca.Function:
    """Return ``(x, taut, u, h) -> (x1, taut1, counts)``: a step of a method, cut at switches.

    The step ``(x, u, taut, h) -> x1`` is for fixed ``taut``; counts are those of :data:`COUNTS`.
    """
    x, taut, u, h, x1 = _symbols(equation)
    attempt, land = _attempt(step, equation), _landing_of(step, equation)
    uncut = Function("uncut", [x, taut, u, h, x1], [x1, taut, _count(tries=1)])
    x2, taut2, taken, switched, tries = land(x, taut, u, h, x1)
    counts = _count(tries=1 + tries, landings=1, switches=switched)
    finish = _finish(step, _substep(attempt, land, equation), equation)
    state = finish(ca.vertcat(x2, taut2, h - taken, counts), ca.vertcat(u, h))
    end, end_taut, _, counts = _split(state, equation)
    cut = Function("cut", [x, taut, u, h, x1], [end, end_taut, counts])
    either = ca.Function.if_else("either", cut, uncut)
    end, crossed = attempt(x, taut, u, h)
    return Function("located", [x, taut, u, h], list(either(crossed, x, taut, u, h, end)))


def taut_strings(equation: Equation, x: Any, u: Any) -> Any:
    """Return the expression of which strings pull in a state, 1 or 0 each."""
    return equation.gap(x, u)[0] > 0


def crossing(equation: Equation) -> ca.Function:
    """Return ``(x, x1, u, taut, h) -> crossed``: whether a string may switch within a step."""
    x, u, taut, h = equation.symbols()
    x1 = equation.symbol("x1", equation.states)
    crossed, _ = _crossed(equation, x, x1, u, taut, h)
    # A state that is not finite is not searched.
    found = ca.if_else(ca.sumsqr(x1) < ca.inf, ca.mmax(crossed), 0)
    return Function("crossing", [x, x1, u, taut, h], [found])


def missed(equation: Equation) -> ca.Function:
    """Return ``(x, x1, u, taut, h) -> count`` of switches in a step that is not cut at them.

    A string that is out at the end has switched once, at least; one that comes back in, twice.
    """
    x, u, taut, h = equation.symbols()
    x1 = equation.symbol("x1", equation.states)
    crossed, out = _crossed(equation, x, x1, u, taut, h)
    return Function("missed", [x, x1, u, taut, h], [ca.sum1(2 * crossed - crossed * out)])


def _crossed(equation: Equation, x: Any, x1: Any, u: Any, taut: Any, h: Any) -> tuple[Any, Any]:
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


def landing(step: ca.Function, equation: Equation, least: float = 0.0) -> ca.Function:
    """Return ``(y, taut, u, h, y1, xd, xd1, allowed) -> (y2, taut2, taken, switched, tries)``.

    It leads up to the first switch of a step ``(y, u, taut, h) -> y1``, whose y and y1 begin with
    the states at its ends, of slopes xd and xd1, and may carry more. The switch is sought on the
    quintic interpolant of positions, velocities and accelerations at both ends, then approached by
    true steps; as a rule by one. Where there is none after all, y2 is y1.

    A step that ends past the border by δ, where the gap shrinks at r, leaves an impulse of δ²/2r
    times the stiffness, as a force that does not depend on velocities is continuous there. So it
    ends past the border by at most ``√(allowed r)``, or the part ``least`` of the length of the
    string if that is more, and never before it: the next step would be wrong. Other forces jump:
    at most a fifth of :data:`BAND` then.
    """
    n = equation.states
    _, taut, u, h, _ = _symbols(equation)
    sizes = {"y": step.size1_in(0), "y1": step.size1_out(0), "xd": n, "xd1": n, "allowed": 1}
    y, y1, xd, xd1, allowed = (ca.MX.sym(name, size) for name, size in sizes.items())
    found = search(equation, least)(y[:n], taut, u, h, y1[:n], xd, xd1, allowed)
    outputs = approached(step, equation)(y, taut, u, h, y1, *found)
    return Function("landing", [y, taut, u, h, y1, xd, xd1, allowed], list(outputs))


def approached(step: ca.Function, equation: Equation) -> ca.Function:
    """Return ``(y, taut, u, h, y1, …) -> (y2, taut2, taken, switched, tries)`` of :func:`landing`.

    After y1 comes what :func:`search` returns.
    """
    n = equation.states
    _, taut, u, h, _ = _symbols(equation)
    y, y1 = ca.MX.sym("y", step.size1_in(0)), ca.MX.sym("y1", step.size1_out(0))
    found, part, speed, aim = switch = [ca.MX.sym(name) for name in ("found", "p", "v", "aim")]
    chosen, leaving = (ca.MX.sym(name, equation.switches) for name in ("chosen", "leaving"))
    # Where there is none, no step is taken.
    begin = ca.vertcat(part, 0, ca.if_else(found, 0, aim), speed, ca.logic_not(found), y1)
    given = (y, taut, u, h, chosen, aim)
    reached = _approach(step, equation).fold(POLISHES)(
        begin, *(ca.repmat(each, 1, POLISHES) for each in given)
    )
    taken, steps, end = reached[1], reached[4], reached[5:]
    taut2, switched = switching(equation)(end[:n], equation.ahead(u, taken * h), taut, leaving)
    outputs = [
        end,
        ca.if_else(found, taut2, taut),
        ca.if_else(found, taken * h, h),
        ca.if_else(found, switched, 0),
        ca.if_else(found, steps, 0),
    ]
    return Function("approached", [y, taut, u, h, y1, *switch, chosen, leaving], outputs)


def search(equation: Equation, least: float = 0.0) -> ca.Function:
    """Return what finds the first switch of a step on its interpolant; see :func:`landing`.

    ``(x, taut, u, h, x1, xd, xd1, allowed) -> (found, part, speed, aim, chosen, leaving)``: whether
    there is one; at which part of the step; the slope of the gap along the step; the gap to end at;
    the strings whose mean gap that is, and those on their way out, 1 or 0 each.
    """
    n = equation.states
    x, taut, u, h, x1 = _symbols(equation)
    xd, xd1, allowed = (ca.MX.sym(name, size) for name, size in (("xd", n), ("e", n), ("a", 1)))
    zoom, first_out = zoom_in(equation), switch_on_interpolant(equation, least)
    within = [interpolant(equation)(x, xd, x1, xd1, h), u, taut, h]
    low, high, found = ca.MX(0), ca.MX(1), ca.MX(0)
    for _ in range(zooms(equation)):
        low, high, found = zoom(*within, low, high)
    names = [x, taut, u, h, x1, xd, xd1, allowed]
    outputs = [found, *first_out(*within, low, high, found, allowed)]
    return Function("search", names, [ca.densify(each) for each in outputs])


def zooms(equation: Equation) -> int:
    """Return how often :func:`search` zooms in."""
    return _ZOOMS if equation.contacts is None else _ZOOMS_ON_GROUND


def switch_on_interpolant(equation: Equation, least: float = LATE) -> ca.Function:
    """Return ``(coefficients, u, taut, h, low, high, found, allowed) -> (part, …)`` of `search`."""
    _, taut, u, h, _ = _symbols(equation)
    coefficients = ca.MX.sym("coefficients", equation.states // 2, 6)
    low, high, found, allowed = (ca.MX.sym(name) for name in ("low", "high", "found", "allowed"))
    room, within = room_inside(equation), [coefficients, u, taut, h]
    inside, outside = room(*within, low), room(*within, high)
    # The string that is out first, by the secants; several, where they go out together.
    scale = equation.gap_scale(u)
    near, size = ca.mmin(0.5 * BAND * scale), ca.mmin(scale)
    start = ca.fmax(inside, 0)
    first = ca.mmin(ca.if_else(outside < 0, start / ca.if_else(outside < 0, start - outside, 1), 1))
    out = ca.logic_and(outside < 0, inside + first * (outside - inside) <= near)
    chosen = ca.if_else(found, out, outside <= ca.mmin(outside) + near)
    # Their mean gap, and where it is to end.
    edge = BAND * size
    before, after = (ca.dot(chosen, value) / ca.sum1(chosen) - edge for value in (inside, outside))
    speed = (after - before) / (high - low)
    late = ca.fmin(ca.sqrt(allowed * ca.fabs(speed) / h), _MOST_LATE * ca.fabs(speed))
    late = ca.fmax(late, least * size) if not equation.velocity_dependent else 0
    aim = ca.fmax(-ca.fmax(late, 0.2 * BAND * size), after) / 2
    # The Illinois method on the interpolant: the chord of a string that starts at rest on the
    # border is far from its slope there, and others that start next to it are not to be passed.
    left, right, over, under = low, high, before - aim, after - aim
    for _ in range(_CHORDS):
        part = ca.fmin(ca.fmax(left + over * (right - left) / (over - under), left), right)
        there = ca.dot(chosen, room(*within, part)) / ca.sum1(chosen) - edge - aim
        is_left = there > 0
        over, under = (
            ca.if_else(is_left, there, over / 2), ca.if_else(is_left, under / 2, there)
        )  # fmt: skip
        left, right = ca.if_else(is_left, part, left), ca.if_else(is_left, right, part)
    outputs = [part, speed, aim, chosen, outside < inside]
    names = [*within, low, high, found, allowed]
    return Function("first_out", names, [ca.densify(each) for each in outputs])


def distance(equation: Equation) -> ca.Function:
    """Return ``(x, u, taut, chosen) -> gap``: the mean gap of strings, positive before a switch."""
    x, u, taut, _ = equation.symbols()
    chosen = equation.symbol("chosen", equation.switches)
    gap = (2 * taut - 1) * equation.gap(x, u)[0]
    return Function("distance", [x, u, taut, chosen], [ca.dot(chosen, gap) / ca.sum1(chosen)])


def switching(equation: Equation) -> ca.Function:
    """Return ``(x, u, taut, leaving) -> (taut2, switched)``: what has reached the border."""
    x, u, taut, _ = equation.symbols()
    leaving = equation.symbol("leaving", equation.switches)
    gap, band = (2 * taut - 1) * equation.gap(x, u)[0], 0.5 * BAND * equation.gap_scale(u)
    switch = ca.logic_and(gap <= band, leaving)
    outputs = [ca.densify(ca.fabs(taut - switch)), ca.densify(ca.sum1(switch))]
    return Function("switching", [x, u, taut, leaving], outputs)


def _landing_of(step: ca.Function, equation: Equation) -> ca.Function:
    """Return ``(x, taut, u, h, x1) -> (x2, …)``: :func:`landing` for a step of x alone."""
    x, taut, u, h, x1 = _symbols(equation)
    ends = equation.slope(x, u, taut), equation.slope(x1, equation.ahead(u, h), taut)
    land = landing(step, equation, LATE)
    return Function("landing_of", [x, taut, u, h, x1], list(land(x, taut, u, h, x1, *ends, 0)))


def _attempt(step: ca.Function, equation: Equation) -> ca.Function:
    """Return ``(x, taut, u, h) -> (x1, crossed)``."""
    x, taut, u, h, _ = _symbols(equation)
    end = step(x, u, taut, h)
    return Function("attempt", [x, taut, u, h], [end, crossing(equation)(x, end, u, taut, h)])


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


def zoom_in(equation: Equation) -> ca.Function:
    """Return ``(coefficients, u, taut, h, low, high) -> (low, high, found)``.

    The least room is sampled at equal parts of the bracket, and the bracket closes in on the
    samples next to the first that is negative; where none is, on the lowest.
    """
    room = room_inside(equation)
    written = equation.form == "flat" and room.n_instructions() <= _MOST_WRITTEN
    symbols: Any = ca.SX if written else ca.MX  # a call, not written out six times for compilers
    within = [symbols.sym(room.name_in(i), room.sparsity_in(i)) for i in range(4)]
    low, high = symbols.sym("low"), symbols.sym("high")
    width = (high - low) / SAMPLES
    rooms = [ca.mmin(room(*within, low + (j + 1) * width)) for j in range(SAMPLES)]
    first, last, least = symbols(0), symbols(1), symbols(ca.inf)
    for j, lowest in enumerate(rooms):
        lower = lowest < least
        first = ca.if_else(lower, j, first)
        last = ca.if_else(lower, min(j + 2, SAMPLES), last)
        least = ca.fmin(lowest, least)
    for j in reversed(range(SAMPLES)):
        first = ca.if_else(rooms[j] < 0, j, first)
        last = ca.if_else(rooms[j] < 0, j + 1, last)
    ends = [low + first * width, low + last * width]
    return Function("zoom", [*within, low, high], [*ends, least < 0])


def _approach(step: ca.Function, equation: Equation) -> ca.Function:
    """Return one true step towards the switch by the secant method, for ``fold``.

    The state is the part of the step to take next, the part last taken, the
    gap there, its slope along the step, how many steps were taken, and where
    the last one led. Once that is past the border, by twice the aim at most, nothing more is done.
    """
    n = equation.states
    _, taut, u, h, _ = _symbols(equation)
    y = ca.MX.sym("y", step.size1_in(0))
    state = ca.MX.sym("state", 5 + step.size1_out(0))
    chosen, aim = ca.MX.sym("chosen", equation.switches), ca.MX.sym("aim")
    wanted, before, gap_before, speed, taken = (state[i] for i in range(5))
    part = part_to_try(wanted, speed)
    end = step(y, u, taut, part * h)
    gap = distance(equation)(end[:n], equation.ahead(u, part * h), taut, chosen)
    wanted, speed = corrected(part, gap, before, gap_before, speed, taken, aim)
    inputs = [state, y, taut, u, h, chosen, aim]
    again = ca.vertcat(wanted, part, gap, speed, taken + 1, end)
    choose = where_needed(Function("again", inputs, [again]))
    far = ca.logic_or(taken == 0, ca.fabs(gap_before - aim) > ca.fabs(aim))
    return Function("approach", inputs, [choose(far, *inputs)])


def part_to_try(wanted: Any, speed: Any) -> Any:
    """Return the part of a step to take; without a slope, as of a string that grazes, none."""
    return ca.fmin(ca.fmax(ca.if_else(speed < 0, wanted, 0), 0), 1)


def corrected(
    part: Any, gap: Any, before: Any, gap_before: Any, speed: Any, taken: Any, aim: Any
) -> tuple[Any, Any]:
    """Return the part wanted next and the slope, by the secant method, from the last two gaps.

    The gap of a damped string has a kink next to the border: the tension falls fast up to it, and
    beyond it is the stretch that counts. Where it is flat between two places beyond, the next is
    twice as far back.
    """
    # Closer than this, the difference is round-off.
    apart = ca.logic_and(taken > 0, ca.fabs(part - before) > 1e-6)
    secant = (gap - gap_before) / ca.if_else(apart, part - before, 1)
    flat = ca.logic_and(apart, ca.logic_and(ca.fmax(gap, gap_before) < 0, secant > FLAT * speed))
    steeper = ca.logic_and(ca.logic_and(apart, secant < 0), ca.logic_not(flat))
    speed = ca.if_else(steeper, secant, speed)
    back = -2 * ca.fabs(part - before)
    return part + ca.if_else(flat, back, (aim - gap) / speed), speed


def _substep(attempt: ca.Function, land: ca.Function, equation: Equation) -> ca.Function:
    """Return ``(state, [u; h]) -> state``: the next substep, for ``fold``.

    The state is x, taut, the time left, and the counts; nothing happens once no time is left.
    """
    x, taut, u, _, x1 = _symbols(equation)
    left, counts = ca.MX.sym("left"), ca.MX.sym("counts", len(COUNTS))
    inputs = [x, taut, left, counts, u]
    over = Function("over", [*inputs, x1], [ca.vertcat(x1, taut, 0, counts + _count(tries=1))])
    x2, taut2, taken, switched, tries = land(x, taut, u, left, x1)
    more = _count(tries=1 + tries, landings=1, switches=switched)
    again = Function("again", [*inputs, x1], [ca.vertcat(x2, taut2, left - taken, counts + more)])
    end, crossed = attempt(x, taut, u, left)
    either = ca.Function.if_else("either_substep", again, over)
    going = Function("going", inputs, [either(crossed, *inputs, end)])
    done = Function("done", inputs, [ca.vertcat(*inputs[:-1])])
    state, held = ca.MX.sym("state", going.size1_out(0)), ca.MX.sym("held", equation.inputs + 1)
    parts = _split(state, equation)
    choose = ca.Function.if_else("choose", going, done)
    some = parts[2] > REST * held[-1]
    x, taut, left, counts = parts
    now = equation.ahead(held[:-1], held[-1] - left)
    return Function("substep", [state, held], [choose(some, x, taut, left, counts, now)])


def _finish(step: ca.Function, substep: ca.Function, equation: Equation) -> ca.Function:
    """Return ``(state, [u; h]) -> state``: all that follows the first switch of a step.

    As a rule that is one substep; it may be several, and what is then left is taken whole.
    """
    state, held = (ca.MX.sym(substep.name_in(i), substep.size1_in(i)) for i in range(2))
    u, h = held[:-1], held[-1]
    x, taut, left, counts = _split(state, equation)
    end = step(x, equation.ahead(u, h - left), taut, left)
    passed = missed(equation)(x, end, equation.ahead(u, h - left), taut, left)
    more = counts + _count(tries=1, missed=passed)
    pulling = taut_strings(equation, end, equation.ahead(u, h))
    whole = Function("whole", [state, held], [ca.vertcat(end, pulling, 0, more)])
    rest = SUBSTEPS - 1
    cut_up = substep.fold(rest)(state, ca.repmat(held, 1, rest))

    def followed(by: ca.Function, after: Any) -> Any:
        """Return what follows a state of substeps where time is left."""
        return where_needed(by)(_split(after, equation)[2] > REST * h, after, held)

    several = Function("several", [state, held], [followed(whole, cut_up)])
    return Function("finish", [state, held], [followed(several, substep(state, held))])


def _symbols(equation: Equation) -> tuple[Any, Any, Any, Any, Any]:
    """Return fresh symbols for x, taut, u, h and the x after a step."""
    x, u, taut, h = equation.symbols(ca.MX)
    return x, taut, u, h, ca.MX.sym("x1", equation.states)


def _split(state: Any, equation: Equation) -> list[Any]:
    sizes = (equation.states, equation.switches, 1, len(COUNTS))
    ends = [sum(sizes[:i]) for i in range(len(sizes) + 1)]
    return list(ca.vertsplit(state, ends))


def _count(**counted: Any) -> Any:
    return ca.vertcat(*(counted.get(name, 0) for name in COUNTS))


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
    place = -half / np.where(bend > 0, bend, np.inf)
    lowest = middle + half * place / 2
    # A little above zero the parabola may be wrong, and it costs little to look.
    strings, at = np.nonzero((bend > 0) & (np.abs(place) <= 1) & (lowest < 0.2 * middle))
    found: FloatArray = times[at + 1] + place[strings, at] * (times[1] - times[0])
    return found


def refuse_chatter(landings: deque[float], now: float, duration: float) -> None:
    """Add a landing; raise FloatingPointError if too many lie within a small part of the span."""
    landings.append(now)
    if len(landings) == CHATTER and now - landings[0] < _CHATTER_TIME * duration:
        raise FloatingPointError(
            f"strings go slack and taut, or contacts open and close, {CHATTER} times within "
            f"{now - landings[0]:.1e} s"
        )
