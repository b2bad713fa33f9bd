"""What the methods with a fixed step share: the loop over the steps."""

from __future__ import annotations

from abc import abstractmethod
from math import ceil

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Equation, Evaluator
from tenscontrol.integrate.integrator import IntegrationError, Integrator, Report, Span, Work
from tenscontrol.integrate.projection import projected
from tenscontrol.integrate.switching import COUNTS, located, taut_strings
from tenscontrol.validation import FloatArray, positive_number

# Steps per call into CasADi: long enough that the call costs nothing, short enough that a long
# run reports its progress; what is left over is made up of shorter calls.
_CHUNKS = (512, 32, 1)


class FixedStep(Integrator):
    """A method with a fixed step; the loop over the steps runs inside CasADi (``mapaccum``).

    Where a string can go slack, every step ends at each switch and goes on from there.

    Parameters
    ----------
    equation : Equation
    step : float
        Largest step, s. It is shortened so that a whole number fits between outputs.
    project : bool
        Whether to make the bar lengths exact after each step.
    """

    #: Evaluations of the right-hand side, or of the forces, in one step.
    evaluations_per_step: int

    def __init__(self, equation: Equation, step: float, project: bool = False) -> None:
        super().__init__(equation)
        self.step = positive_number("step", step, "s")
        one = self.step_function(equation)
        self._one_step = _carried(projected(one, equation) if project else one, equation)
        self._chunks: dict[int, Evaluator] = {}
        x, u = ca.SX.sym("x", equation.states), ca.SX.sym("u", equation.inputs)
        self._taut = Evaluator(ca.Function("taut", [x, u], [taut_strings(equation, x, u)]))

    @abstractmethod
    def step_function(self, equation: Equation) -> ca.Function:
        """Return ``(x, u, taut, h) -> x1``: one step for fixed ``taut``."""

    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        # The small allowance lets 0.02/0.001 be 20 steps, whatever round-off says.
        inner = max(1, ceil(duration / outputs / self.step - 1e-9))
        total = outputs * inner
        step = duration / total
        n, switches = self._equation.states, self._equation.switches
        states = np.empty((n, outputs))
        taut = self._taut(state, held)[0] if switches else np.zeros(0)
        carried = np.concatenate([state, taut, np.zeros(len(COUNTS))])[: self._size]
        done = 0
        while done < total:
            size = next(size for size in _CHUNKS if size <= total - done)
            try:
                result = self._chunk(size)(carried, held, step)[0].reshape(-1, size, order="F")
            except KeyboardInterrupt:
                reached = Span(states[:, : done // inner], self._work(done, carried))
                raise IntegrationError("interrupted", step * done, reached, True) from None
            first = -(-(done + 1) // inner)  # the next output
            kept = result[:n, first * inner - done - 1 :: inner]
            states[:, first - 1 : first - 1 + kept.shape[1]] = kept
            carried = result[:, -1].copy()
            if not np.isfinite(carried).all():
                # Once not finite, never finite again: the good states come first.
                fine = int(np.isfinite(result).all(axis=0).sum())
                good = done + fine
                work = self._work(good, result[:, fine - 1] if fine else np.zeros(len(COUNTS)))
                raise IntegrationError(
                    f"the state is no longer finite between {step * good:.6g} s and "
                    f"{step * (good + 1):.6g} s; try a step below {step:g} s",
                    step * good,
                    Span(states[:, : good // inner], work),
                )
            done += size
            if report is not None:
                report(step * done)
        return Span(states, self._work(total, carried))

    @property
    def _size(self) -> int:
        return int(self._one_step.size1_in(0))

    def _work(self, steps: int, carried: FloatArray) -> Work:
        if not self._equation.switches:
            return Work(steps=steps, evaluations=self.evaluations_per_step * steps)
        tries, landings, switches, unlocated = (round(c) for c in carried[-len(COUNTS) :])
        return Work(
            steps=steps + landings,
            evaluations=self.evaluations_per_step * tries + 2 * landings,
            switches=switches,
            unlocated=unlocated,
        )

    def _chunk(self, size: int) -> Evaluator:
        """Return ``(z, u, h) -> [z1 … z_size]``, one column a step."""
        if size not in self._chunks:
            z = ca.MX.sym("z", self._size)
            u, h = ca.MX.sym("u", self._equation.inputs), ca.MX.sym("h")
            # Held inputs are repeated: mapaccum wants one column a step.
            held = [ca.repmat(u, 1, size), ca.repmat(h, 1, size)]
            many = self._one_step.mapaccum(size) if size > 1 else self._one_step
            self._chunks[size] = Evaluator(ca.Function("chunk", [z, u, h], [many(z, *held)]))
        return self._chunks[size]


def _carried(step: ca.Function, equation: Equation) -> ca.Function:
    """Return ``(z, u, h) -> z``: a step that carries which strings pull, and counts.

    Without strings that can go slack, z is the state alone.
    """
    u, h = ca.MX.sym("u", equation.inputs), ca.MX.sym("h")
    if not equation.switches:
        x = ca.MX.sym("x", equation.states)
        return ca.Function("step", [x, u, h], [step(x, u, ca.MX(0, 1), h)])
    sizes = (equation.states, equation.switches, len(COUNTS))
    z = ca.MX.sym("z", sum(sizes))
    x, taut, counts = ca.vertsplit(z, [0, sizes[0], sizes[0] + sizes[1], sum(sizes)])
    x1, taut1, more = located(step, equation)(x, taut, u, h)
    return ca.Function("step", [z, u, h], [ca.vertcat(x1, taut1, counts + more)])
