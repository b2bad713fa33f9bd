"""An implicit method for stiff strings and ground: keeps energy, momenta and bar lengths."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from time import perf_counter
from typing import Any, NamedTuple, final

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import Evaluator, Function
from tenscontrol.dynamics.forces import Forces
from tenscontrol.integrate.integrator import (
    IntegrationError,
    IntegrationInterrupt,
    IntegrationPause,
    Integrator,
    Report,
    Span,
    Trace,
    Work,
    checked_tolerance,
    next_size,
    where_needed,
)
from tenscontrol.integrate.multipliers import Coupled, cross
from tenscontrol.integrate.projection import Bodies
from tenscontrol.interrupt import check
from tenscontrol.structure.structure import Structure

# Tried steps per call into CasADi: those not needed cost next to nothing.
_CHUNKS = (1, 8, 64)

# A step that fails is tried again with half its length, down to this part of the largest,
# or of the duration.
_SMALLEST, _SMALLEST_BY_TOLERANCE = 2.0**-12, 1e-13

# The error of a step cannot be told from round-off below.
_LEAST_TOLERANCE = 1e-14

# Bounds on the change of the step from one to the next, and the safety in it.
_SHRINK, _GROW, _SAFETY = 0.2, 2.0, 0.9

_PROGRESS = ("left", "step", "failed", "steps", "rejections", "evaluations")


@final
class EnergyMomentum(Integrator):
    """Steps far beyond the period of stiff strings, by an energy-momentum method of order 2.

    Each step solves for the motion with which the forces, averaged over the lengths that the
    strings pass, do exactly the work that the strings store. Whatever the step, then,

    - the energy, kinetic, stored in the strings and the ground, and that of constant loads,
      stays what it is, through slack and taut, and through impacts; damping and friction only take
      from it;
    - linear and angular momentum stay what they are where nothing is held and
      no load acts;
    - bars keep their lengths, and their ends do not move apart.

    The first two hold to round-off, as far as Newton's iteration converges;
    the third by construction, of bars that share nodes to round-off too. A step never ends at a
    switch: there is no need.

    Give ``step`` or ``tolerance``. By tolerance each step is done as two halves and as a whole,
    and the difference of the positions, which is three times the error, chooses the step.

    Parameters
    ----------
    equation : Equation
        Of a structure.
    step : float, optional
        Largest step, s. It is shortened so that a whole number fits between
        outputs, and where Newton's iteration does not converge.
    tolerance : float, optional
        Error of the positions allowed a step, as part of the size of the structure.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, if both or none of ``step`` and
        ``tolerance`` are given, or if the equation is not of a structure.

    Notes
    -----
    ``Work.evaluations`` counts the evaluations of the forces and those of
    their Jacobian: two for each of Newton's iterations. Each iteration solves
    a sparse linear system besides.

    Sideways vibrations of light strings that are faster than the steps are not damped. With long
    steps (in a prism of 3 kg with beads of 10 mg: 2 ms) they can grow, at the cost of the energy
    of the rest: use shorter steps, or the tolerance. Energy is exact for laws in which the tension
    of a taut string is linear in its length, as those of the package are, and for contact laws
    whose force is a polynomial of the root of the depth between their kinks.

    References
    ----------
    R. A. LaBudde, D. Greenspan, *Energy and momentum conserving methods of
    arbitrary order for the numerical integration of equations of motion*,
    Numer. Math. 25 (1976), 323-346: the force of a string. J. C. Simo,
    K. K. Wong, *Unconditionally stable algorithms for rigid body dynamics that
    exactly preserve energy and momentum*, Int. J. Numer. Meth. Engng. 31
    (1991), 19-52: the turning of a bar. O. Gonzalez, *Time integration and
    discrete Hamiltonian systems*, J. Nonlinear Sci. 6 (1996), 449-467: the
    discrete gradient, of which the force of a string is one.

    Examples
    --------
    A prism whose strings vibrate at 40 kHz turns over in steps of 5 ms:

    >>> import numpy as np, tenscontrol as tc
    >>> from tenscontrol.dynamics.equation import pack_state
    >>> from tenscontrol.integrate import EnergyMomentum
    >>> rest = tc.prestress(tc.prism(), force_density=10.0)
    >>> model = tc.Model(rest.structure, strings=tc.LinearStrings(stiffness=1e10))
    >>> lengths = tc.to_rest_length(model, rest.structure.nodes, rest.force_density).rest_length
    >>> spin = np.cross([1.0, 0.0, 0.0], rest.structure.nodes.T).T
    >>> state = pack_state(rest.structure, rest.structure.nodes, spin)
    >>> method = EnergyMomentum(model.equation("rest_length"), step=5e-3)
    >>> span = method.advance(state, lengths, duration=1.0, outputs=10)
    >>> span.work.steps
    200
    >>> bars = rest.structure.bar_vectors(span.states[:18, -1].reshape(6, 3).T)
    >>> bool(np.allclose(np.linalg.norm(bars, axis=0), rest.structure.bar_length, atol=1e-15))
    True
    """

    name = "energy_momentum"

    def __init__(
        self, equation: Equation, step: float | None = None, tolerance: float | None = None
    ) -> None:
        super().__init__(equation)
        if (step is None) == (tolerance is None):
            given = "neither" if step is None else "both"
            raise ValueError(f"expected step or tolerance, found {given}; give one of the two")
        if equation.structure is None:
            raise ValueError(
                "the equation is not of a structure, whose bars and strings this method needs; "
                "make one by Model(structure).equation(...)"
            )
        if equation.layout.lengths:
            raise ValueError(
                "method 'energy_momentum' takes bars of constant length, but bar_length drives "
                "some; use method='dop853', or method='cvodes' where strings are stiff"
            )
        self.step = None if step is None else validation.positive_number("step", step, "s")
        self.tolerance = (
            None if tolerance is None else checked_tolerance(tolerance, _LEAST_TOLERANCE)
        )
        self._size = equation.structure.size
        self._slope = Evaluator(equation.kinked_slope)
        chunks = self._kept(self._build, step is None)
        self._chunks = {count: Evaluator(chunk) for count, chunk in chunks.items()}
        self._most = _CHUNKS[0]  # steps tried in the next call, at most

    @property
    def cost(self) -> float:
        """See :attr:`Integrator.cost`: instructions, and the factors of the linear system."""
        system = _prepared(self._equation).system
        V, R, *_ = system.sparsity_out(1).qr_sparse()
        return float(4.0 + 1.3e-3 * system.n_instructions() + 6e-3 * (V.nnz() + R.nnz()))

    def _build(self) -> dict[int, ca.Function]:
        """Return ``(work, u, limits) -> work`` that tries so many steps."""
        attempt = _attempt(self._equation, self._size, adaptive=self.step is None)
        return {count: _chunk(attempt, count) for count in _CHUNKS}

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
        interval = duration / outputs
        largest = duration if self.step is None else self.step
        tolerance = 0.0 if self.tolerance is None else self.tolerance
        least = _SMALLEST_BY_TOLERANCE if self.step is None else _SMALLEST
        progress = np.zeros(len(_PROGRESS))
        progress[1] = largest if self.step is not None else self._first_step(state, held, interval)
        evaluations = 0 if self.step is not None else 1
        limits = np.array([largest, largest * least, tolerance, self.limit - evaluations])
        states = np.empty((len(state), outputs))
        work = np.concatenate([state, progress])
        left, step, failed = (len(state) + i for i in range(3))
        tried = len(work) - 1
        output = 0
        inputs = held.copy()
        clock = self._equation.layout.degree > 0
        trace = Trace(self.traces)
        try:
            for output in range(outputs):
                work[left] = interval
                if clock:  # steps know what is left of the interval
                    inputs[-1] = held[-1] + interval * (output + 1)
                while work[left] > 0:
                    check()
                    began = perf_counter()
                    expected = ceil(min(work[left] / work[step], self._most, _CHUNKS[-1]))
                    chunk = next(count for count in _CHUNKS if count >= expected)
                    if trace.wanted:
                        chunk, taken = 1, work[left + 3]
                    work = self._chunks[chunk](work, inputs, limits)[0].copy()
                    self._most = next_size(self._most, chunk, perf_counter() - began)
                    if trace.wanted and work[left + 3] > taken:
                        time = interval * (output + 1) - float(work[left])
                        trace.append(time, work[: len(state)], np.zeros(self._equation.switches))
                    if work[failed]:
                        time = interval * (output + 1) - float(work[left])
                        raise IntegrationError(
                            f"Newton's iteration or the error test of energy_momentum failed at "
                            f"{time:.6g} s down to a step of {work[step]:.3g} s; the motion may "
                            "have run away, or strings are too stiff for double precision. If the "
                            "motion up to there is sound, try method='dop853', or method='cvodes' "
                            "where stiff strings are damped",
                            time,
                            Span(states[:, :output], _work(work[-3:], evaluations)),
                        )
                    if work[left] > 0:
                        time = interval * (output + 1) - float(work[left])
                        if report is not None:
                            report(time)
                        if work[tried] >= limits[3]:
                            reached = Span(states[:, :output], _work(work[-3:], evaluations))
                            raise IntegrationPause(time, work[: len(state)], reached)
                states[:, output] = work[: len(state)]
                if report is not None:
                    report(interval * (output + 1))
        except KeyboardInterrupt:
            span = Span(states[:, :output], _work(work[-3:], evaluations))
            raise IntegrationInterrupt(interval * output, span) from None
        return Span(states, _work(work[-3:], evaluations), ends=trace.ends)

    def _first_step(self, state: FloatArray, held: FloatArray, interval: float) -> float:
        """Return a step in which the motion goes a small part of the size of the structure."""
        assert self.tolerance is not None  # asked for only by tolerance
        speeds, accelerations = np.abs(np.split(self._slope(state, held)[0], 2)).max(axis=1)
        small = 0.1 * min(self.tolerance, 1.0) ** (1 / 3)
        times = [interval]
        if speeds > 0:
            times.append(small * self._size / speeds)
        if accelerations > 0:
            times.append(small * (self._size / accelerations) ** 0.5)
        return float(min(times))


def _chunk(attempt: ca.Function, count: int) -> ca.Function:
    inputs = [ca.MX.sym(f"a{i}", attempt.size1_in(i)) for i in range(3)]
    # Held inputs are repeated: fold wants one column a step.
    held = [ca.repmat(value, 1, count) for value in inputs[1:]]
    tried = attempt.fold(count) if count > 1 else attempt
    return Function("chunk", inputs, [tried(inputs[0], *held)])


def _work(counts: FloatArray, evaluations: int) -> Work:
    steps, rejections, counted = (int(count) for count in counts)
    return Work(steps=steps, rejections=rejections, evaluations=counted + evaluations)


def _attempt(equation: Equation, size: float, adaptive: bool) -> ca.Function:
    """Return ``(work, u, limits) -> work`` that tries a step, or nothing where none is left."""
    try_step = _tried_step(equation, size, adaptive)
    inputs = [ca.MX.sym(f"a{i}", try_step.size1_in(i)) for i in range(3)]
    left, failed, evaluations = (
        inputs[0][equation.states + _PROGRESS.index(name)]
        for name in ("left", "failed", "evaluations")
    )
    going = ca.logic_and(ca.logic_and(left > 0, failed == 0), evaluations < inputs[2][3])
    return Function("attempt", inputs, [where_needed(try_step)(going, *inputs)])


def _prepared(equation: Equation) -> StepEquations:
    """Return :func:`step_equations`, kept with the equation."""
    return equation.prepared.get("step equations", lambda: step_equations(equation))


def _tried_step(equation: Equation, size: float, adaptive: bool) -> ca.Function:
    work = ca.MX.sym("work", equation.states + len(_PROGRESS))
    u, limits = ca.MX.sym("u", equation.inputs), ca.MX.sym("limits", 4)
    x = work[: equation.states]
    left, wish, _, steps, rejections, evaluations = ca.vertsplit(work[equation.states :])
    largest, smallest, tolerance, _ = ca.vertsplit(limits)
    # The small allowance lets 0.02/0.001 be 20 steps, whatever round-off says.
    count = ca.fmax(1, ca.ceil(left / wish - 1e-9))
    h = left / count
    now = equation.ahead(u, -left)
    step = _prepared(equation)
    solve = newton_solver(step, size)
    if adaptive:
        first, good_1, iterations_1 = solve(step.guess(x), x, now, h / 2)
        middle = step.end(first, x, h / 2)
        second, good_2, iterations_2 = solve(
            step.guess(middle), middle, equation.ahead(now, h / 2), h / 2
        )
        new = step.end(second, middle, h / 2)
        whole, good_3, iterations_3 = solve((first + second) / 2, x, now, h)
        difference = (new - step.end(whole, x, h))[: equation.states // 2] / 3
        error = ca.mmax(ca.fabs(difference)) / size
        converged = ca.logic_and(ca.logic_and(good_1, good_2), good_3)
        iterations = iterations_1 + iterations_2 + iterations_3
        # Of a NaN fmax and fmin take the other argument; `accepted` does not.
        ratio = _SAFETY * (tolerance / ca.fmax(error, 1e-3 * tolerance)) ** (1 / 3)
        accepted = ca.logic_and(converged, error <= tolerance)
        shorter = ca.if_else(converged, h * ca.fmax(_SHRINK, ratio), h / 2)
        longer = ca.fmax(wish, h * ca.fmin(_GROW, ratio))
    else:
        y, accepted, iterations = solve(step.guess(x), x, now, h)
        new = step.end(y, x, h)
        shorter, longer = h / 2, 2 * wish
    wish = ca.if_else(accepted, ca.fmin(longer, largest), shorter)
    progress = [
        # Exactly zero after the last step, whatever round-off says.
        ca.if_else(accepted, ca.if_else(count == 1, 0, left - h), left),
        wish,
        ca.logic_and(ca.logic_not(accepted), wish < smallest),
        steps + accepted,
        rejections + ca.logic_not(accepted),
        evaluations + 2 * iterations,
    ]
    new = ca.if_else(accepted, new, x)
    return Function("try_step", [work, u, limits], [ca.vertcat(new, *progress)])


@dataclass(frozen=True, eq=False)
class StepEquations:
    """The equations of a step of length h from x, in unknowns y, all m/s.

    y holds the mean velocities over the step of the centres of free bars, the mean angular
    velocities of free bars and of bars that swing, times the bar length, and the mean velocities of
    string nodes. Where bars share nodes, there follow of their blocks the displacement by h, the
    mean velocities, and two multipliers for each bar, by which its length and its rate are held.
    """

    system: ca.Function  # (y, x, u, h) -> (residual, jacobian), kg m/s and kg; jacobian sparse
    guess: ca.Function  # (x) -> y of a motion without forces
    end: ca.Function  # (y, x, h) -> x at the end of the step
    moving: int  # how many of y, the first ones, move something: not the multipliers
    residual: ca.Function | None = None  # that of the system alone, where there is ground


class StepExpressions(NamedTuple):
    """The equations of a step as expressions of its unknowns y, x, u and h."""

    symbols: tuple[Any, Any, Any, Any]
    residual: Any
    guess: Any
    end: Any
    moving: int


def step_equations(equation: Equation) -> StepEquations:
    """Return the equations of a step."""
    assert equation.forces is not None  # checked by the integrator
    step = step_expressions(equation, equation.forces)
    y, x, u, h = step.symbols
    return StepEquations(
        system=Function("system", [y, x, u, h], [step.residual, ca.jacobian(step.residual, y)]),
        guess=Function("guess", [x], [step.guess]),
        end=Function("end", [y, x, h], [step.end]),
        moving=step.moving,
        residual=None
        if equation.contacts is None
        else Function("residual", [y, x, u, h], [step.residual]),
    )


def step_expressions(
    equation: Equation, forces: Forces, masses: kernel.Masses | None = None, load: Any = None
) -> StepExpressions:
    """Return the expressions of a step.

    Bars on their own turn by the Cayley map of the mean angular velocity, which keeps the length
    whatever that velocity is. Bars that share nodes are held by multipliers, see
    :class:`LengthConstraints`.

    Parameters
    ----------
    equation : Equation
    forces : Forces
        Those of the equation, or the same with symbols for parameters.
    masses : Masses, optional
        In place of those of the structure.
    load : casadi.SX, shape (d, n), optional
        Beside that of the equation, N.
    """
    structure = forces.structure
    bodies = Bodies(structure, masses)
    blocks = LengthConstraints(structure, masses) if structure.blocks else None
    bars, turning = len(structure.free_bars), bodies.length.numel()
    d, normal = structure.dimension, 3 if structure.dimension == 3 else 1
    points = bodies.point_mass.numel()
    count = d * points + normal * turning
    others = 0 if blocks is None else blocks.count
    x, u, h = ca.SX.sym("x", equation.states), ca.SX.sym("u", equation.inputs), ca.SX.sym("h")
    y = ca.SX.sym("y", count + others)
    scale = kernel.scale_columns

    def split(y: Any) -> tuple[Any, Any]:
        """Return velocities of points, and angular velocities times bar length."""
        ends = [0, d * bars, d * bars + normal * turning, count]
        centres, turn, nodes = ca.vertsplit(y, ends)
        centres, nodes = (
            ca.reshape(entries, d, entries.shape[0] // d) for entries in (centres, nodes)
        )
        return ca.horzcat(centres, nodes), ca.reshape(turn, normal, turning)

    def join(points: Any, turn: Any) -> Any:
        return ca.vertcat(ca.vec(points[:, :bars]), ca.vec(turn), ca.vec(points[:, bars:]))

    # The start is put on the constraint as the end will be: no jump between the two.
    q, v = ca.vertsplit(x, equation.states // 2)
    points0, B0 = bodies.split(bodies.columns(q[bodies.alone], bodies.held), bodies.hinges)
    B0 = _of_length(B0, bodies.length)
    velocity0, Bd0 = bodies.split(bodies.columns(v[bodies.alone]))
    turn0 = scale(cross(B0, Bd0), 1 / bodies.length)
    start = join(velocity0, turn0)

    # The end, and the bar vectors halfway.
    velocity, turn = split(y[:count])
    a = scale(turn, h / 2 / bodies.length)
    swept = cross(a, B0)
    swept += cross(a, swept)
    half = scale(swept, 1 / (1 + kernel.dots(a, a)))
    B1 = _of_length(B0 + 2 * half, bodies.length)
    end = bodies.join(points0 + h * velocity, B1, bodies.hinges)
    velocity1, turn1 = split(2 * y[:count] - start)
    Bd1 = cross(scale(turn1, 1 / bodies.length), bodies.split(end, bodies.hinges)[1])
    q0 = bodies.entries(bodies.join(points0, B0, bodies.hinges))
    q1, v1 = bodies.entries(end), bodies.entries(bodies.join(velocity1, Bd1))
    guess = start
    if blocks is not None:
        c, rates = q[bodies.coupled], v[bodies.coupled]
        c1, rates1 = blocks.end(y[count:], c, rates, h)
        q0, q1, v1 = bodies.merge(q0, c), bodies.merge(q1, c1), bodies.merge(v1, rates1)
        guess = ca.vertcat(start, blocks.guess(rates))

    # Change of momentum less impulse of the forces: m l²/12 turns about the centre of a free bar,
    # m l²/3 about the fixed end of one that swings.
    N0, N1 = (kernel.placed(structure, nodes, structure.nodes) for nodes in (q0, q1))
    mean = _mean_forces(equation, forces, N0, N1, u, h)
    mean = mean if load is None else mean + load
    mean = kernel.free_entries(structure, mean[:, structure.free.tolist()])
    on_points, on_vectors = bodies.resultants(bodies.columns(mean[bodies.alone]))
    share = ca.DM([0.5] * bars + [1.0] * (turning - bars)).T
    torque = scale(cross(B0 + half, scale(on_vectors, share)), h / bodies.length)
    residual = join(
        scale(velocity - velocity0, 2 * bodies.point_mass) - h * on_points,
        scale(turn - turn0, 2 * share * bodies.vector_mass) - torque,
    )
    if blocks is not None:
        of_blocks = blocks.residual(y[count:], c, rates, mean[bodies.coupled], h)
        residual = ca.vertcat(residual, of_blocks)
    return StepExpressions(
        (y, x, u, h), ca.densify(residual), ca.densify(guess), ca.densify(ca.vertcat(q1, v1)),
        count + (0 if blocks is None else blocks.moving),
    )  # fmt: skip


class LengthConstraints:
    """Bars that share nodes in a step: the lengths and their rates are held by two multipliers.

    With mean positions c̄ and rates v̄, and multipliers λ and σ::

        M (c₁ − c₀)/h = M v̄ + J(c̄)ᵀ σ
        M (v₁ − v₀)/h = f̄ + J(c̄)ᵀ λ − J(v̄)ᵀ σ
        ½ |b₁|² = ½ l²,   b₁ᵀ ḃ₁ = 0

    ``½ |b|²`` and ``bᵀ ḃ`` are quadratic, so that their derivatives at the means are exact discrete
    gradients: energy and momenta stay (Gonzalez, *Mechanical systems subject to holonomic
    constraints*, Physica D 132 (1999), 165-174, with the rates held as by Gear, Gupta &
    Leimkuhler, J. Comp. Appl. Math. 12 (1985), 77-90).
    """

    def __init__(self, structure: Structure, masses: kernel.Masses | None = None) -> None:
        self._coupled, self._masses = Coupled(structure), masses
        coupled = self._coupled
        self._rows, self._bars = len(coupled.rows), len(coupled.bars)
        self._length = ca.DM(structure.bar_length[coupled.bars])
        self._mass = ca.DM(structure.bar_mass[coupled.bars])
        self.moving = 2 * self._rows
        self.count = self.moving + 2 * self._bars

    def _split(self, y: Any) -> list[Any]:
        """Return displacements by h, mean rates, and the multipliers, all m/s."""
        rows, bars = self._rows, self._bars
        return list(ca.vertsplit(y, [0, rows, 2 * rows, 2 * rows + bars, self.count]))

    def guess(self, rates: Any) -> Any:
        """Return y of a motion without forces."""
        return ca.vertcat(rates, rates, ca.SX.zeros(2 * self._bars))

    def end(self, y: Any, c: Any, rates: Any, h: Any) -> tuple[Any, Any]:
        """Return coordinates and rates at the end of the step."""
        moved, mean, *_ = self._split(y)
        return c + h * moved, 2 * mean - rates

    def residual(self, y: Any, c: Any, rates: Any, forces: Any, h: Any) -> Any:
        """Return the residual, kg m/s: momenta, then lengths and their rates."""
        coupled, masses = self._coupled, self._masses
        moved, mean, lengths, stretch = self._split(y)
        c1, rates1 = self.end(y, c, rates, h)
        middle = c + h / 2 * moved
        # A multiplier is an impulse along the bar, or so much of its displacement, by its length.
        by_length = self._mass / self._length
        halfway = coupled.nodes(middle)
        on_rates = coupled.pull(halfway, by_length * stretch)
        on_lengths = coupled.pull(halfway, by_length * lengths)
        turned = coupled.pull(coupled.rates(mean), by_length * stretch)
        return ca.vertcat(
            coupled.momenta(moved - mean, masses) - on_rates,
            2 * coupled.momenta(mean - rates, masses) - h * forces - on_lengths + h * turned,
            # What it is at the end, by the identity |b₁|² = |b₀|² + 2 h b̄ᵀ v: the round-off of the
            # difference of two squares would be magnified where J is near to losing rank.
            by_length * (coupled.stretching(middle, moved) + coupled.excess(c) / h),
            by_length * coupled.stretching(c1, rates1),
        )


def _mean_forces(equation: Equation, forces: Forces, N0: Any, N1: Any, u: Any, h: Any) -> Any:
    """Return the forces, shape (d, n), N, that do the work that is stored: ``Force.mean_force``.

    That is, of rest lengths, or force densities, and loads as they are in the middle of the step.
    """
    layout = equation.layout
    shape = forces.structure.nodes.shape
    load = ca.SX(*shape) if equation.load is None else ca.sparsify(ca.DM(equation.load))
    # Inputs that change are those in the middle of the step.
    middle = layout.values(equation.ahead(u, h / 2))
    if layout.load:
        places = slice(layout.strings, layout.strings + layout.load)
        load = ca.reshape(middle[places], *shape)
    if layout.offset:
        at_end = layout.values(equation.ahead(u, h))
        N0, N1 = (
            N + ca.reshape(values[layout.count - layout.offset :], *shape)
            for N, values in ((N0, layout.values(u)), (N1, at_end))
        )
    u = middle[: layout.strings] if layout.count > layout.strings else middle
    for force in (*forces.terms, forces.strings):
        load = load + force.mean_force(N0, N1, u, h)
    return load


def _of_length(B: Any, length: Any) -> Any:
    return kernel.scale_columns(B, length / ca.sqrt(kernel.dots(B, B)))


# Steps of Newton's iteration before it counts as failed.
_MOST = 12

# Converged when the last change moves nothing by more than this part of the size, or of the
# distance from the origin, whose round-off the lengths of strings have.
_SMALL = 1e-11

# Diverged when a change would move something by this many sizes.
_LARGE = 1e3


# With ground, whose forces have corners: steps at most, and how often one of them is halved until
# it leaves less than before.
_MOST_ON_GROUND, _HALVINGS = 40, 8


def newton_solver(step: StepEquations, size: float) -> ca.Function:
    """Return ``(y, x, u, h) -> (y, converged, iterations)``: the root from a first guess.

    Convergence is quadratic: where the last change was small, what is left is far smaller. On
    ground changes are halved until the residual falls.
    """
    system, on_ground = step.system, step.residual is not None
    iterate = _searching(step, size) if on_ground else _iteration(step)
    given = [ca.MX.sym(f"a{i}", system.size1_in(i)) for i in range(1, 4)]
    choose = where_needed(iterate)
    guess = ca.MX.sym("guess", system.size1_in(0))
    scale = size + ca.mmax(ca.fabs(given[0][: system.size1_in(1) // 2]))
    # Change made last, m, and number of iterations follow the unknowns.
    state = ca.vertcat(guess, scale, 0)
    for _ in range(_MOST_ON_GROUND if on_ground else _MOST):
        change = state[-2]
        # A change that is not a number is neither: the iteration ends, not converged.
        going_on = ca.logic_and(change > _SMALL * scale, change < _LARGE * scale)
        state = choose(going_on, state, *given)
    converged = state[-2] <= _SMALL * scale
    return Function("newton", [guess, *given], [state[:-2], converged, state[-1]])


def _iteration(step: StepEquations) -> ca.Function:
    """Return ``(z, x, u, h) -> z``, one iteration on z = [y; change; iterations]."""
    system = step.system
    z = ca.MX.sym("z", system.size1_in(0) + 2)
    x, u, h = (ca.MX.sym(f"a{i}", system.size1_in(i)) for i in range(1, 4))
    change, _ = _change(system, z, x, u, h)
    new = ca.vertcat(z[:-2] - change, h * _moved(step, change), z[-1] + 1)
    return Function("iteration", [z, x, u, h], [new])


def _change(system: ca.Function, z: Any, *given: Any) -> tuple[Any, Any]:
    """Return Newton's change of the unknowns, and the residual that it is from."""
    residual, jacobian = system(z[:-2], *given)
    # No pivot is too small for light nodes: what is singular gives no finite change.
    return ca.solve(jacobian, residual, "qr", {"eps": 0}), residual


def _moved(step: StepEquations, change: Any) -> Any:
    """Return by how much a change of the unknowns changes the mean velocities, m/s.

    Multipliers are left out: where bars are near to depend on each other, they are only known to
    round-off that is magnified twice as much as that of positions. Yet what is not a number shows.
    The norm, not the largest entry: CasADi's largest of numbers passes over what is none.
    """
    return ca.norm_2(change[: step.moving]) + 0 * ca.norm_2(change[step.moving :])


def _searching(step: StepEquations, around: float) -> ca.Function:
    """Return :func:`_iteration` with changes halved until the residual falls.

    A residual counts as half an iteration.
    """
    system, residual = step.system, step.residual
    assert residual is not None  # there is ground
    size = system.size1_in(0)
    z, change, search = ca.MX.sym("z", size + 2), ca.MX.sym("change", size), ca.MX.sym("part", 3)
    given = [ca.MX.sym(f"a{i}", system.size1_in(i)) for i in range(1, 4)]
    before = ca.MX.sym("before")
    # The part of the change, whether it will do, and how many were tried.
    left = ca.norm_2(residual(z[:-2] - search[0] * change, *given))
    falls = left < before
    tried = ca.vertcat(ca.if_else(falls, search[0], search[0] / 2), falls, search[2] + 1)
    inputs = [search, z, change, before, *given]
    attempt = where_needed(Function("attempt", inputs, [tried]))
    newton_step, at_start = _change(system, z, *given)
    far, norm = given[2] * _moved(step, newton_step), ca.norm_2(at_start)
    searched = far > 1e3 * _SMALL * around  # below, nothing is left to fall but round-off
    search = ca.vertcat(1, 0, 0)
    for _ in range(_HALVINGS):
        search = attempt(
            ca.logic_and(searched, search[1] == 0), search, z, newton_step, norm, *given
        )
    new = ca.vertcat(z[:-2] - search[0] * newton_step, far, z[-1] + 1 + search[2] / 2)
    return Function("iteration", [z, *given], [new])
