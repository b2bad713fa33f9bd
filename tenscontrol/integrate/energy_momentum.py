"""An implicit method for stiff strings: conserves energy and momenta, and keeps bar lengths."""

from __future__ import annotations

from math import ceil
from typing import Any, final

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Equation, Evaluator
from tenscontrol.integrate.energy_momentum_step import step_equations
from tenscontrol.integrate.integrator import (
    IntegrationError,
    Integrator,
    Report,
    Span,
    Work,
    checked_tolerance,
)
from tenscontrol.integrate.newton import newton_solver
from tenscontrol.validation import FloatArray, positive_number

# Tried steps per call into CasADi, at most: those not needed cost next to nothing.
_CHUNK = 64

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

    Each step solves for the motion with which the forces, averaged over the
    lengths that the strings pass, do exactly the work that the strings store.
    Whatever the step, then,

    - the energy, kinetic, stored in the strings, and that of constant loads,
      stays what it is, through slack and taut; damping only takes from it;
    - linear and angular momentum stay what they are where nothing is held and
      no load acts;
    - bars keep their lengths, and their ends do not move apart.

    The first two hold to round-off, as far as Newton's iteration converges;
    the third by construction. A step never ends at a switch: there is no need.

    Give ``step`` or ``tolerance``. By tolerance each step is done as two
    halves and as a whole, and the difference of the positions, which is three
    times the error, chooses the step.

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

    Sideways vibrations of light strings that are faster than the steps are not
    damped. With long steps (in a prism of 3 kg with beads of 10 mg: 2 ms) they
    can grow, at the cost of the energy of the rest: use shorter steps, or the
    tolerance. Energy is exact for laws in which the tension of a taut string
    is linear in its length, as those of the package are.

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
    >>> from tenscontrol.dynamics import pack_state
    >>> from tenscontrol.integrate import EnergyMomentum
    >>> rest = tc.prestress(tc.prism(), force_density=17.3205)
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
            found = "neither" if step is None else "both"
            raise ValueError(f"expected step or tolerance, found {found}; give one of the two")
        if equation.structure is None:
            raise ValueError(
                "the equation is not of a structure, whose bars and strings this method needs; "
                "make one by Model(structure).equation(...)"
            )
        self.step = None if step is None else positive_number("step", step, "s")
        self.tolerance = (
            None if tolerance is None else checked_tolerance(tolerance, _LEAST_TOLERANCE)
        )
        self._size = float(np.ptp(equation.structure.nodes, axis=1).max())
        self._slope = Evaluator(equation.kinked_slope)
        self._attempt = _attempt(equation, self._size, adaptive=step is None)
        self._chunks: dict[int, Evaluator] = {}

    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        interval = duration / outputs
        largest = duration if self.step is None else self.step
        tolerance = 0.0 if self.tolerance is None else self.tolerance
        part = _SMALLEST_BY_TOLERANCE if self.step is None else _SMALLEST
        limits = np.array([largest, largest * part, tolerance])
        progress = np.zeros(len(_PROGRESS))
        progress[1] = largest if self.step is not None else self._first_step(state, held, interval)
        evaluations = 0 if self.step is not None else 1
        states = np.empty((len(state), outputs))
        work = np.concatenate([state, progress])
        left, step, failed = (len(state) + i for i in range(3))
        for output in range(outputs):
            work[left] = interval
            while work[left] > 0:
                expected = ceil(min(work[left] / work[step], _CHUNK))
                try:
                    work = self._chunk(expected)(work, held, limits)[0].copy()
                except KeyboardInterrupt:
                    span = Span(states[:, :output], _work(work[-3:], evaluations))
                    raise IntegrationError("interrupted", interval * output, span, True) from None
                if work[failed]:
                    time = interval * (output + 1) - float(work[left])
                    raise IntegrationError(
                        f"Newton's iteration or the error test of energy_momentum failed at "
                        f"{time:.6g} s down to a step of {work[step]:.3g} s; the motion may have "
                        "run away, or strings are too stiff for double precision",
                        time,
                        Span(states[:, :output], _work(work[-3:], evaluations)),
                    )
            states[:, output] = work[: len(state)]
            if report is not None:
                report(interval * (output + 1))
        return Span(states, _work(work[-3:], evaluations))

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

    def _chunk(self, expected: int) -> Evaluator:
        """Return ``(work, u, limits) -> work`` that tries at least this many steps."""
        count = 1 << (expected - 1).bit_length()
        if count not in self._chunks:
            inputs = [ca.MX.sym(f"a{i}", self._attempt.size1_in(i)) for i in range(3)]
            # Held inputs are repeated: fold wants one column a step.
            held = [ca.repmat(value, 1, count) for value in inputs[1:]]
            tried = self._attempt.fold(count) if count > 1 else self._attempt
            self._chunks[count] = Evaluator(ca.Function("chunk", inputs, [tried(inputs[0], *held)]))
        return self._chunks[count]


def _work(counts: FloatArray, evaluations: int) -> Work:
    steps, rejections, counted = (int(count) for count in counts)
    return Work(steps=steps, rejections=rejections, evaluations=counted + evaluations)


def _attempt(equation: Equation, size: float, adaptive: bool) -> ca.Function:
    """Return ``(work, u, limits) -> work`` that tries a step, or nothing where none is left."""
    try_step = _tried_step(equation, size, adaptive)
    inputs = [ca.MX.sym(f"a{i}", try_step.size1_in(i)) for i in range(3)]
    work = inputs[0]
    idle = ca.Function("idle", inputs, [work])
    choose = ca.Function.if_else("choose", try_step, idle)
    left, failed = (work[equation.states + _PROGRESS.index(name)] for name in ("left", "failed"))
    return ca.Function("attempt", inputs, [choose(ca.logic_and(left > 0, failed == 0), *inputs)])


def _tried_step(equation: Equation, size: float, adaptive: bool) -> ca.Function:
    work = ca.MX.sym("work", equation.states + len(_PROGRESS))
    u, limits = ca.MX.sym("u", equation.inputs), ca.MX.sym("limits", 3)
    x = work[: equation.states]
    left, wish, _, steps, rejections, evaluations = ca.vertsplit(work[equation.states :])
    largest, smallest, tolerance = ca.vertsplit(limits)
    # The small allowance lets 0.02/0.001 be 20 steps, whatever round-off says.
    count = ca.fmax(1, ca.ceil(left / wish - 1e-9))
    h = left / count
    take = _doubled_step if adaptive else _single_step
    new, converged, iterations, error = take(equation, size, x, u, h)
    ratio = 1.0
    if adaptive:
        # Of a NaN fmax and fmin take the other argument; `accepted` does not.
        ratio = _SAFETY * (tolerance / ca.fmax(error, 1e-3 * tolerance)) ** (1 / 3)
        accepted = ca.logic_and(converged, error <= tolerance)
        shorter = ca.if_else(converged, h * ca.fmax(_SHRINK, ratio), h / 2)
        longer = ca.fmax(wish, h * ca.fmin(_GROW, ratio))
    else:
        accepted, shorter, longer = converged, h / 2, 2 * wish
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
    return ca.Function("try_step", [work, u, limits], [ca.vertcat(new, *progress)])


def _single_step(equation: Equation, size: float, x: Any, u: Any, h: Any) -> tuple[Any, ...]:
    """Return state at the end, whether Newton converged, iterations, and no error."""
    step = step_equations(equation)
    y, converged, iterations = newton_solver(step.system, size)(step.guess(x), x, u, h)
    return step.end(y, x, h), converged, iterations, None


def _doubled_step(equation: Equation, size: float, x: Any, u: Any, h: Any) -> tuple[Any, ...]:
    """Return the same for two steps of half the length, and the error that they make."""
    step = step_equations(equation)
    solve = newton_solver(step.system, size)
    first, good_1, iterations_1 = solve(step.guess(x), x, u, h / 2)
    middle = step.end(first, x, h / 2)
    second, good_2, iterations_2 = solve(step.guess(middle), middle, u, h / 2)
    end = step.end(second, middle, h / 2)
    whole, good_3, iterations_3 = solve((first + second) / 2, x, u, h)
    positions = slice(0, equation.states // 2)
    difference = (end - step.end(whole, x, h))[positions] / 3
    error = ca.mmax(ca.fabs(difference)) / size
    good = ca.logic_and(ca.logic_and(good_1, good_2), good_3)
    return end, good, iterations_1 + iterations_2 + iterations_3, error
