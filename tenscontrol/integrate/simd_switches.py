"""Location of switches as graphs of CasADi, from which lanes are written."""

from __future__ import annotations

from typing import Any

import casadi as ca

from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.integrate.events import (
    BAND,
    CHORDS,
    FLAT,
    LATE,
    MOST_LATE,
    SAMPLES,
    crossed_within,
    room_inside,
)


def taut_strings(equation: Equation, x: Any, u: Any) -> Any:
    """Return the expression of which strings pull in a state, 1 or 0 each."""
    return equation.gap(x, u)[0] > 0


def crossing(equation: Equation) -> ca.Function:
    """Return ``(x, x1, u, taut, h) -> crossed``: whether a string may switch within a step."""
    x, u, taut, h = equation.symbols()
    x1 = equation.symbol("x1", equation.states)
    crossed, _ = crossed_within(equation, x, x1, u, taut, h)
    # A state that is not finite is not searched.
    found = ca.if_else(ca.sumsqr(x1) < ca.inf, ca.mmax(crossed), 0)
    return Function("crossing", [x, x1, u, taut, h], [found])


def missed(equation: Equation) -> ca.Function:
    """Return ``(x, x1, u, taut, h) -> count`` of switches in a step that is not cut at them.

    A string that is out at the end has switched once, at least; one that comes back in, twice.
    """
    x, u, taut, h = equation.symbols()
    x1 = equation.symbol("x1", equation.states)
    crossed, out = crossed_within(equation, x, x1, u, taut, h)
    return Function("missed", [x, x1, u, taut, h], [ca.sum1(2 * crossed - crossed * out)])


def switch_on_interpolant(equation: Equation, least: float = LATE) -> ca.Function:
    """Return ``(coefficients, u, taut, h, low, high, found, allowed) -> (part, …)`` of `search`."""
    _, u, taut, h = equation.symbols(ca.MX)
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
    late = ca.fmin(ca.sqrt(allowed * ca.fabs(speed) / h), MOST_LATE * ca.fabs(speed))
    late = ca.fmax(late, least * size) if not equation.velocity_dependent else 0
    aim = ca.fmax(-ca.fmax(late, 0.2 * BAND * size), after) / 2
    # The Illinois method on the interpolant: the chord of a string that starts at rest on the
    # border is far from its slope there, and others that start next to it are not to be passed.
    left, right, over, under = low, high, before - aim, after - aim
    for _ in range(CHORDS):
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


def zoom_in(equation: Equation) -> ca.Function:
    """Return ``(coefficients, u, taut, h, low, high) -> (low, high, found)``.

    The least room is sampled at equal parts of the bracket, and the bracket closes in on the
    samples next to the first that is negative; where none is, on the lowest.
    """
    room = room_inside(equation)
    symbols: Any = ca.SX
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
