"""RATTLE for rigid bars: explicit, symplectic, exact bar lengths, one division a bar.

A step alternates between two motions:

- *flight*: no forces. Points move on straight lines, bar vectors turn about
  their centres, or hinges, at constant speed: solved exactly. Bars that share nodes fly by the
  RATTLE of order 2, solved by Newton's iteration, block by block.
- *kick*: nodes stand still. Forces change the velocities, and what would
  change the bar lengths is removed.

Both keep bar lengths, momenta and the symplectic form, so that every
alternation of them does. Only blocks of bars that share nodes are factorized.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from math import factorial
from typing import Any, NamedTuple, TypeVar, final

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Equation, kernel
from tenscontrol.integrate.fixed_step import FixedStep
from tenscontrol.integrate.multipliers import Coupled
from tenscontrol.integrate.projection import Bodies
from tenscontrol.properties import cached_property

# What a kick changes: velocities, or a state with them.
_At = TypeVar("_At")

# Largest turn of a bar in one flight, rad². From a right angle on, the quadratic that places the
# bar has no real root or the wrong one; one radian leaves room for velocities along the bar.
_LARGEST_TURN = 1.0

# Instructions, about, up to which a step that is to be compiled is written out.
_MOST_COMPILED = 12_000

# Terms of sin(φ)/φ: the first one left out is below 3e-15 for the largest turn.
_SINE_TERMS = 8


@dataclass(frozen=True)
class Splitting:
    """Lengths of flights and kicks, as fractions of the step: flight, kick, flight, …, flight."""

    flights: tuple[float, ...]  # one more than kicks
    kicks: tuple[float, ...]

    @property
    def parts(self) -> list[tuple[float, float | None, float]]:
        """Each flight, the kick after it, None after the last, and the flights until then."""
        passed = np.cumsum(self.flights).tolist()
        return list(zip_longest(self.flights, self.kicks, passed))


def splitting(order: int, coupled: bool = False, velocity_dependent: bool = False) -> Splitting:
    """Return the alternation of flights and kicks of order 2, 4 or 6.

    2: Störmer and Verlet, in the form with one kick. 4: Omelyan, Mryglod & Folk, "PEFRL", eq.
    (22), doi:10.1016/S0010-4655(02)00451-4. 6: Blanes & Moan, doi:10.1016/S0377-0427(01)00492-7,
    Table 3, SRKN 14 a; it takes the kicks to depend on positions only.

    Chosen by measurement on prisms, with held force densities and with elastic strings, among
    other methods of the two papers, forms that begin with a kick, and the compositions of Suzuki,
    Yoshida, and Kahan & Li (Hairer, Lubich & Wanner, *Geometric Numerical Integration*, eqs.
    (II.4.5), (V.3.11), (V.3.12)). With as many evaluations, the best composition had 5 to 50 times
    the error at order 4 and 1000 times and more at order 6.

    Where bars share nodes (``coupled``), flights are not exact, and the composition is of whole
    symmetric steps kick, flight, kick of order 2. 4: Suzuki (eq. II.4.5 there). 6: Kahan & Li
    (eq. V.3.12).

    Where forces are ``velocity_dependent``, kicks do not commute with each other, as the methods
    above take them to. 4 and 6: Blanes & Moan, Table 2, S6 and S10.
    """
    if order not in (2, 4, 6):
        raise ValueError(f"order is {order!r}, expected 2, 4 or 6")
    if coupled:
        stages = _stages(order)
        kicks = tuple((a + b) / 2 for a, b in pairwise((0.0, *stages, 0.0)))
        return Splitting((0.0, *stages, 0.0), kicks)
    if order == 2:
        return Splitting((0.5, 0.5), (1.0,))
    if velocity_dependent:
        flights, kicks = _GENERAL[order]
        return Splitting(
            _palindrome(flights, 1 - 2 * sum(flights)), _palindrome((*kicks, 0.5 - sum(kicks)))
        )
    if order == 4:
        first, second, inner = 0.1786178958448091, -0.06626458266981849, -0.2123418310626054
        return Splitting(
            _palindrome((first, second), 1 - 2 * (first + second)),
            _palindrome((0.5 - inner, inner)),
        )
    flights = (
        0.0378593198406116,
        0.102635633102435,
        -0.0258678882665587,
        0.314241403071447,
        -0.130144459517415,
        0.106417700369543,
        -0.00879424312851058,
    )
    kicks = (
        0.09171915262446165,
        0.183983170005006,
        -0.05653436583288827,
        0.004914688774712854,
        0.143761127168358,
        0.328567693746804,
    )
    return Splitting(
        _palindrome(flights, 1 - 2 * sum(flights)), _palindrome((*kicks, 0.5 - sum(kicks)))
    )


# First halves of the flights and kicks of S6 and S10, but for the last of each.
_GENERAL = {
    4: (
        (0.0792036964311957, 0.353172906049774, -0.0420650803577195),
        (0.209515106613362, -0.143851773179818),
    ),
    6: (
        (
            0.0502627644003922,
            0.413514300428344,
            0.0450798897943977,
            -0.188054853819569,
            0.541960678450780,
        ),
        (0.148816447901042, -0.132385865767784, 0.067307604692185, 0.432666402578175),
    ),
}


@dataclass(frozen=True)
class _Tableau:
    """An explicit Runge-Kutta method: how a kick is made of forces at velocities within it."""

    stages: tuple[tuple[float, ...], ...]  # weights of the forces before, but for the first stage
    weights: tuple[float, ...]


# Of forces that depend on positions only, one is all. Else: the midpoint rule, the classical method
# of Kutta, and Butcher's of order 6 (*On Runge-Kutta processes of high order*, J. Aust. Math. Soc.
# 4 (1964), 179-194).
_ONE = _Tableau((), (1.0,))
_KICKS = {
    2: _Tableau(((1 / 2,),), (0.0, 1.0)),
    4: _Tableau(((1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
    6: _Tableau(
        (
            (1 / 3,),
            (0.0, 2 / 3),
            (1 / 12, 1 / 3, -1 / 12),
            (-1 / 16, 9 / 8, -3 / 16, -3 / 8),
            (0.0, 9 / 8, -3 / 8, -3 / 4, 1 / 2),
            (9 / 44, -9 / 11, 63 / 44, 18 / 11, 0.0, -16 / 11),
        ),
        (11 / 120, 0.0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120),
    ),
}


def _stages(order: int) -> tuple[float, ...]:
    """Return the lengths of the symmetric steps of order 2 that make one of a higher order."""
    if order == 2:
        return (1.0,)
    if order == 4:
        stage = 1 / (4 - 4 ** (1 / 3))
        return _palindrome((stage, stage), 1 - 4 * stage)
    stages = (
        0.39216144400731413928,
        0.33259913678935943860,
        -0.70624617255763935981,
        0.08221359629355080023,
    )
    return _palindrome(stages, 1 - 2 * sum(stages))


def rattle_evaluations(equation: Equation, order: int) -> int:
    """Return how often a step of :func:`rattle_step` evaluates the forces."""
    kicks = _splitting(equation, order).kicks
    return len(kicks) * len(_tableau(equation, order).weights)


def _splitting(equation: Equation, order: int) -> Splitting:
    coupled = equation.structure is not None and bool(equation.structure.blocks)
    return splitting(order, coupled, equation.velocity_dependent)


def _tableau(equation: Equation, order: int) -> _Tableau:
    return _KICKS[order] if equation.velocity_dependent else _ONE


def rattle_step(
    equation: Equation, order: int, symbols: Any = ca.SX, called: bool = False
) -> ca.Function:
    """Return a step ``(x, u, taut, h) -> x1`` of RATTLE.

    Every step is of full order by itself, whatever its length, and takes no
    force over from the last one. Where the step is so long that a bar turns
    by more than one radian in a flight, or that Newton's iteration does not find the lengths of
    bars that share nodes, entries of x1 are NaN.

    Notes
    -----
    RATTLE (Andersen 1983, doi:10.1016/0021-9991(83)90014-1; symplectic:
    Leimkuhler & Skeel 1994, doi:10.1006/jcph.1994.1085) places a bar vector at
    ``b + h ḃ + μ b`` with ``‖b + h ḃ + μ b‖ = l``: one quadratic in μ. A free
    bar is turned by asin(hω) so, and by hω, as it should, if ``g = h
    sin(hω)/hω`` takes the place of h. That makes the flight exact (a geodesic
    integrator: Leimkuhler & Patrick 1996, doi:10.1007/BF02433475), and
    splitting methods of high order can be used, which are better than
    compositions of RATTLE. The true l is in each quadratic, so that bar
    lengths have the error of one rounding, however many steps there were.

    Forces that depend on velocities, of damped strings or of ground that damps or rubs, change in a
    kick, in which nodes stand still: the velocities follow an equation of their own there, solved
    by a Runge-Kutta method of the same order. Orders above 2 take kicks back in time, in which
    damping drives: steps must be short beside the time in which it acts.
    """
    force = equation.force
    if force is None or equation.structure is None:
        raise ValueError(
            "the equation has no structure, whose bars RATTLE would hold; "
            "make it by Model(structure).equation(...), or use rk4 or dop853"
        )
    steps, tableau = _splitting(equation, order), _tableau(equation, order)
    if equation.structure.blocks:
        return _coupled(equation, steps, tableau)
    x, u, taut, h = equation.symbols(symbols)
    bodies = Bodies(equation.structure, equation.masses(u))
    motion = _Motion(bodies, force, taut, tableau)
    if called:
        return _called(equation, motion, steps, x, u, h)
    state = motion.start(x)
    for flight, kick, passed in steps.parts:
        state = motion.flight(state, flight * h)
        if kick is not None:
            state = motion.kick(state, kick * h, equation.ahead(u, passed * h))
    return ca.Function("rattle_step", [x, u, taut, h], [_once(motion.end(state), tableau)])


def _once(result: Any, tableau: _Tableau) -> Any:
    """Return an expression with what several stages of a kick have in common computed once."""
    several = len(tableau.weights) > 2 and isinstance(result, ca.SX)
    return ca.cse(result) if several else result


def _called(
    equation: Equation, motion: _Motion, steps: Splitting, x: Any, u: Any, h: Any
) -> ca.Function:
    """Return the step as calls of its flights and kicks."""
    kind, taut = type(x), motion.taut
    begun = motion.start(x)
    start = ca.Function("start", [x], list(begun))
    parts = [kind.sym(f"part{i}", part.shape) for i, part in enumerate(begun)]
    state = _State(*parts)
    flight = ca.Function("flight", [*parts, h], list(motion.flight(state, h)))
    kick = ca.Function("kick", [*parts, u, taut, h], list(motion.kick(state, h, u)))
    end = ca.Function("end", parts, [motion.end(state)])
    x, u, taut, h = (ca.MX.sym("of_step", each.shape) for each in (x, u, taut, h))
    now = start(x)
    for flown, kicked, passed in steps.parts:
        now = flight(*now, flown * h)
        if kicked is not None:
            now = kick(*now, equation.ahead(u, passed * h), taut, kicked * h)
    return ca.Function("rattle_step", [x, u, taut, h], [end(*now)])


def _coupled(equation: Equation, steps: Splitting, tableau: _Tableau) -> ca.Function:
    """Return the step where bars share nodes: calls of its flights and kicks."""
    structure = equation.structure
    assert structure is not None  # as in rattle_step
    bodies, blocks = Bodies(structure), Coupled(structure)
    flight = _coupled_flight(bodies, blocks)
    kick = _coupled_kick(equation, bodies, blocks, tableau)
    x, u, taut, h = equation.symbols(ca.MX)
    q, v = ca.vertsplit(x, equation.states // 2)
    factors = blocks.factorized(q[bodies.coupled])
    for flown, kicked, passed in steps.parts:
        if flown:  # steps begin and end with a kick
            q, v, factors = flight(q, v, factors, flown * h)
        if kicked is not None:
            v = kick(q, v, factors, equation.ahead(u, passed * h), taut, kicked * h)
    return ca.Function("rattle_step", [x, u, taut, h], [ca.vertcat(q, v)])


def _coupled_flight(bodies: Bodies, blocks: Coupled) -> ca.Function:
    """Return ``(q, v, factors, time) -> (q, v, factors)``: no forces; rates not yet across bars."""
    motion = _Motion(bodies)
    own = [ca.SX.sym(name, len(bodies.alone)) for name in "qv"]
    time = ca.SX.sym("time")
    ends = motion.coordinates(motion.flight(motion.start(ca.vertcat(*own)), time))
    alone = ca.Function("flight_alone", [*own, time], list(ends))
    free = len(bodies.alone) + len(bodies.coupled)
    q, v, time = (ca.MX.sym(name, size) for name, size in (("q", free), ("v", free), ("time", 1)))
    factors = ca.MX.sym("factors", blocks.factorized.size1_out(0))
    c, rates = q[bodies.coupled], v[bodies.coupled]
    flown = c + time * rates
    change = blocks.placed(flown, c, factors)
    # In no time nothing changes, but by round-off.
    rates = rates + change / ca.if_else(time == 0, 1, time)
    ends = alone(q[bodies.alone], v[bodies.alone], time)
    c = flown + change
    outputs = [*map(bodies.merge, ends, (c, rates)), blocks.factorized(c)]
    return ca.Function("flight", [q, v, factors, time], outputs)


def _coupled_kick(
    equation: Equation, bodies: Bodies, blocks: Coupled, tableau: _Tableau
) -> ca.Function:
    """Return ``(q, v, factors, u, taut, time) -> v``: forces alone, none along bars after it."""
    motion, force = _Motion(bodies), equation.force
    assert force is not None  # as in rattle_step
    own = [ca.SX.sym(name, len(bodies.alone)) for name in ("q", "v", "impulse")]
    start = motion.start(ca.vertcat(*own[:2]))
    alone = ca.Function("kick_alone", own, [motion.coordinates(motion.pushed(start, own[2], 1))[1]])
    _, u, taut, time = equation.symbols(ca.MX)
    q, v = (ca.MX.sym(name, equation.states // 2) for name in "qv")
    factors = ca.MX.sym("factors", blocks.factorized.size1_out(0))

    def pushed(forces: Any) -> Any:
        """Return the rates after forces have acted for the time."""
        impulse = time * forces
        parts = (each[bodies.alone] for each in (q, v, impulse))
        c, rates, pushes = (each[bodies.coupled] for each in (q, v, impulse))
        return bodies.merge(alone(*parts), blocks.pushed(c, rates, pushes, factors))

    # What a flight leaves along bars changes forces by O(h): beyond order 2 it is removed first.
    start = pushed(0 * v) if len(tableau.weights) > 2 else v
    v1 = _kicked(tableau, start, lambda at: force(q, at, u, taut), pushed)
    return ca.Function("kick", [q, v, factors, u, taut, time], [v1])


def _kicked(
    tableau: _Tableau, start: _At, force: Callable[[_At], Any], pushed: Callable[[Any], _At]
) -> _At:
    """Return what a kick makes of a state, by a Runge-Kutta method in its velocities.

    ``force`` takes a state to forces, and ``pushed`` constant forces to the state after the kick.
    """
    forces = [force(start)]
    for weights in tableau.stages:
        forces.append(force(pushed(_weighted(weights, forces))))
    return pushed(_weighted(tableau.weights, forces))


def _weighted(weights: tuple[float, ...], values: list[Any]) -> Any:
    """Return a sum; what has no weight is left out, and 1 is no factor."""
    parts = [w * each if w != 1 else each for w, each in zip(weights, values, strict=True) if w]
    return sum(parts[1:], parts[0])


class _Rattle(FixedStep):
    """What the orders share; refused without a structure."""

    order: int

    def __init__(
        self, equation: Equation, step: float, project: bool = False, machine_code: bool = False
    ) -> None:
        self._machine_code = machine_code
        super().__init__(equation, step, project, machine_code)

    @property
    def evaluations_per_step(self) -> int:  # type: ignore[override]  # depends on the equation
        """Evaluations of the forces in one step."""
        return rattle_evaluations(self._equation, self.order)

    def step_function(self, equation: Equation) -> ca.Function:
        """See :meth:`FixedStep.step_function`."""
        if equation.form != "flat":
            return rattle_step(equation, self.order, ca.MX)
        # One flat list of instructions is the fastest, but takes compilers long.
        written = equation.slope.n_instructions() * self.evaluations_per_step
        called = self._machine_code and written > _MOST_COMPILED
        return rattle_step(equation, self.order, called=called)


@final
class Rattle(_Rattle):
    """RATTLE of order 2; see :func:`rattle_step`."""

    name = "rattle"
    order = 2


@final
class Rattle4(_Rattle):
    """RATTLE of order 4; see :func:`rattle_step`."""

    name = "rattle4"
    order = 4


@final
class Rattle6(_Rattle):
    """RATTLE of order 6; see :func:`rattle_step`."""

    name = "rattle6"
    order = 6


class _State(NamedTuple):
    """Points and vectors of :class:`Bodies`, and their rates."""

    points: kernel.Symbolic
    vectors: kernel.Symbolic
    point_rates: kernel.Symbolic
    vector_rates: kernel.Symbolic


@dataclass(frozen=True)
class _Motion:
    """The two motions of bodies, with taut held."""

    bodies: Bodies
    force: ca.Function | None = None
    taut: kernel.Symbolic = None
    tableau: _Tableau = _ONE

    @cached_property
    def _square(self) -> ca.DM:
        return self.bodies.length**2

    def start(self, x: kernel.Symbolic) -> _State:
        """Return the state of x, its bar rates without what would stretch the bars."""
        half, bodies = x.shape[0] // 2, self.bodies
        nodes, velocities = bodies.columns(x[:half], bodies.held), bodies.columns(x[half:])
        points, vectors = bodies.split(nodes, bodies.hinges)
        point_rates, vector_rates = bodies.split(velocities)
        return _State(points, vectors, point_rates, self._across(vectors, vector_rates))

    def end(self, state: _State) -> kernel.Symbolic:
        """Return x."""
        return ca.vertcat(*self.coordinates(state))

    def flight(self, state: _State, time: kernel.Symbolic) -> _State:
        """Return the state after a time without forces."""
        B, Bd = state.vectors, state.vector_rates
        # (φ/t)², φ the angle turned by; the rates are across the bars.
        speed = kernel.dots(Bd, Bd) / self._square
        turn = speed * time**2
        g = ca.if_else(turn <= _LARGEST_TURN, time * _sine_ratio(turn), ca.DM.nan())
        # ‖(1 + μ) b + g ḃ‖² = l², of the two roots μ the one near zero, without cancellation.
        excess = kernel.dots(B, B) / self._square - 1 + speed * g**2
        shrink = 1 - excess / (1 + ca.sqrt(1 - excess))
        return _State(
            state.points + time * state.point_rates,
            kernel.scale_columns(B, shrink) + kernel.scale_columns(Bd, g),
            state.point_rates,
            kernel.scale_columns(Bd, shrink) - kernel.scale_columns(B, speed * g),
        )

    def kick(self, state: _State, time: kernel.Symbolic, u: kernel.Symbolic) -> _State:
        """Return the state after forces alone, with the input u, have acted for a time."""
        function, taut = self.force, self.taut
        assert function is not None  # given where kicks are asked for

        def force(at: _State) -> kernel.Symbolic:
            return function(*self.coordinates(at), u, taut)

        def pushed(forces: kernel.Symbolic) -> _State:
            return self.pushed(state, forces, time)

        return _kicked(self.tableau, state, force, pushed)

    def pushed(self, state: _State, forces: kernel.Symbolic, time: kernel.Symbolic) -> _State:
        """Return the state after forces, N, have acted for a time."""
        points, vectors = self.bodies.accelerations(self.bodies.columns(forces))
        rates = state.vector_rates + time * vectors
        return _State(
            state.points,
            state.vectors,
            state.point_rates + time * points,
            self._across(state.vectors, rates),
        )

    def _across(self, vectors: kernel.Symbolic, rates: kernel.Symbolic) -> kernel.Symbolic:
        """Return the rates without their parts along the vectors."""
        return rates - kernel.scale_columns(vectors, kernel.dots(vectors, rates) / self._square)

    def coordinates(self, state: _State) -> tuple[kernel.Symbolic, kernel.Symbolic]:
        """Return the free coordinates and their rates."""
        bodies = self.bodies
        nodes = bodies.join(state.points, state.vectors, bodies.hinges)
        rates = bodies.join(state.point_rates, state.vector_rates)
        return bodies.entries(nodes), bodies.entries(rates)


def _sine_ratio(square: kernel.Symbolic) -> kernel.Symbolic:
    """Return sin(φ)/φ of φ² ≤ 1, by its series: no square root, and no quotient at zero."""
    value: kernel.Symbolic = 0
    for k in reversed(range(_SINE_TERMS)):
        value = value * square + (-1) ** k / factorial(2 * k + 1)
    return value


def _palindrome(half: tuple[float, ...], middle: float | None = None) -> tuple[float, ...]:
    return (*half, *(() if middle is None else (middle,)), *half[::-1])
