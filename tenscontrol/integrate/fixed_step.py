"""Methods with a fixed step: the loop over the steps, and the Runge-Kutta method of order 4."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from math import ceil
from time import perf_counter
from typing import final

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.core.records import Progress
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import Evaluator, Function
from tenscontrol.dynamics.machine_code import compiler
from tenscontrol.integrate.core_run import advance_in_core, settings_of
from tenscontrol.integrate.core_scene import CoreMotion, core_scene
from tenscontrol.integrate.events import COUNTS, located, taut_strings
from tenscontrol.integrate.integrator import (
    IntegrationError,
    IntegrationInterrupt,
    Integrator,
    Report,
    Span,
    Work,
    in_machine_code,
    next_size,
    where_needed,
)
from tenscontrol.integrate.projection import projected
from tenscontrol.interrupt import check

# Steps in a block, and blocks in a call into CasADi: enough that the call costs nothing, few enough
# that a long run reports its progress and a short one does not wait for steps left out.
_BLOCK, _MANY = 32, 16

# Steps in the first call where there are more states than this: they may take long.
_FEW, _LARGE = 4, 600

# Numbers that a call may return: memory is for states that are kept.
_MOST_NUMBERS = 1e6


@dataclass(frozen=True, eq=False)
class _Steps:
    """What a method builds once for an equation."""

    block: ca.Function
    blocks: ca.Function
    taut: ca.Function
    size: int  # of what is carried from step to step
    many: int  # blocks in a call of ``blocks``
    back_end: str


class FixedStep(Integrator):
    """A method with a fixed step; the loop over the steps runs inside CasADi (``mapaccum``).

    Where a string can go slack, every step ends at each switch and goes on from there.
    """

    #: Evaluations of the right-hand side, or of the forces, in one step.
    evaluations_per_step: int

    #: Whether the compiled core has the method.
    runs_in_core = False

    def __init__(
        self, equation: Equation, step: float, project: bool = False, machine_code: bool = False
    ) -> None:
        super().__init__(equation, project, machine_code)
        self._project = project
        self.step = validation.positive_number("step", step, "s")
        self._core = core_scene(equation) if self.runs_in_core else None
        if self._core is not None:
            self.back_end = "core"
            return
        by = compiler() if machine_code else None
        steps = self._kept(lambda: self._build(project, machine_code), project, machine_code, by)
        self._size, self._many, self.back_end = steps.size, steps.many, steps.back_end
        self._blocks = {1: Evaluator(steps.block), steps.many: Evaluator(steps.blocks)}
        self._taut = Evaluator(steps.taut)
        # Steps in the next call, at most.
        self._most = _FEW if equation.states > _LARGE else _BLOCK * _MANY

    def _build(self, project: bool, machine_code: bool) -> _Steps:
        equation = self._equation
        step = _carried(self.smooth_step(project), equation)
        block, back_end = in_machine_code(equation, _block(step), machine_code)
        size = int(step.size1_in(0))
        many = int(np.clip(_MOST_NUMBERS / (_BLOCK * size), 1, _MANY))
        x, u, _, _ = equation.symbols(ca.MX)
        taut = Function("taut", [x, u], [taut_strings(equation, x, u)])
        blocks = block if many == 1 else block.mapaccum(many)
        return _Steps(block, blocks, taut, size, many, back_end)

    def smooth_step(self, project: bool) -> ca.Function:
        """Return :meth:`step_function` of the method's own equation.

        Parameters
        ----------
        project : bool
            Whether a projection onto the bar lengths follows.
        """
        one = self.step_function(self._equation)
        return projected(one, self._equation) if project else one

    @abstractmethod
    def step_function(self, equation: Equation) -> ca.Function:
        """Return ``(x, u, taut, h) -> x1``: one step for fixed ``taut``; u begins with it.

        Parameters
        ----------
        equation : Equation
        """

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
        inner = self.steps_between(duration, outputs)
        total = outputs * inner
        step = duration / total
        n, switches = self._equation.states, self._equation.switches
        states = np.empty((n, outputs))
        taut = self._taut(state, held)[0] if switches else np.zeros(0)
        # The time within the span, where the input is a polynomial in it.
        clock = np.zeros(min(self._equation.layout.degree, 1))
        carried = np.concatenate([state, clock, taut, np.zeros(len(COUNTS))])[: self._size]
        done = 0
        try:
            while done < total:
                check()
                began = perf_counter()
                left = min(total - done, self._most)
                blocks = self._many if left >= self._many * _BLOCK else 1
                size = min(blocks * _BLOCK, left)
                steps: FloatArray = np.zeros(blocks * _BLOCK)
                steps[:size] = step
                inputs = held
                if blocks > 1:
                    steps = steps.reshape(blocks, _BLOCK).T
                    inputs = np.tile(held[:, None], (1, blocks))
                result = self._blocks[blocks](carried, inputs, steps)[0]
                result = result.reshape(self._size, -1, order="F")[:, :size]
                first = -(-(done + 1) // inner)  # the next output
                kept = result[:n, first * inner - done - 1 :: inner]
                states[:, first - 1 : first - 1 + kept.shape[1]] = kept
                carried = result[:, -1].copy()
                if not np.isfinite(carried).all():
                    # Once not finite, never finite again: the good states come first.
                    fine = int(np.isfinite(result).all(axis=0).sum())
                    good = done + fine
                    work = self.work_of(
                        good, result[:, fine - 1] if fine else np.zeros(len(COUNTS))
                    )
                    raise IntegrationError(
                        not_finite(good, step),
                        step * good,
                        Span(states[:, : good // inner], work),
                    )
                done += size
                self._most = next_size(self._most, size, perf_counter() - began)
                if report is not None:
                    report(step * done)
        except KeyboardInterrupt:
            reached = Span(states[:, : done // inner], self.work_of(done, carried))
            raise IntegrationInterrupt(step * done, reached) from None
        return Span(states, self.work_of(total, carried))

    def steps_between(self, duration: float, outputs: int) -> int:
        """Return the number of steps from one state that is kept to the next.

        Parameters
        ----------
        duration : float
            s.
        outputs : int
            States kept within it.
        """
        # The small allowance lets 0.02/0.001 be 20 steps, whatever round-off says.
        return max(1, ceil(duration / outputs / self.step - 1e-9))

    def work_of(self, steps: int, carried: FloatArray) -> Work:
        """Return the work of some steps.

        Parameters
        ----------
        steps : int
        carried : ndarray, shape (k,)
            What the last one left; it ends in the counts.
        """
        if not self._equation.switches:
            return Work(steps=steps, evaluations=self.evaluations_per_step * steps)
        tries, landings, switches, missed = (round(c) for c in carried[-len(COUNTS) :])
        return Work(
            steps=steps + landings,
            evaluations=self.evaluations_per_step * tries + 2 * landings,
            switches=switches,
            missed=missed,
        )


@final
class RK4(FixedStep):
    """The classical Runge-Kutta method of order 4; see :class:`FixedStep`."""

    name = "rk4"
    evaluations_per_step = 4
    runs_in_core = True

    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """See :meth:`Integrator.advance`."""
        scene = self._core
        if scene is None:
            return super().advance(state, held, duration, outputs, report)
        state, held, duration, outputs = self._checked(state, held, duration, outputs, report)
        inner = self.steps_between(duration, outputs)
        step = duration / (inner * outputs)
        settings = settings_of("rk4", duration, outputs, self._project, step=self.step)
        motion = CoreMotion(scene, state, held, settings)

        def work(progress: Progress) -> Work:
            steps = round(progress.time / step)
            return Work(
                steps=steps + progress.landings,
                evaluations=4 * progress.tries + 2 * progress.landings,
                switches=progress.switches,
                missed=progress.missed,
            )

        def failure(motion: CoreMotion) -> IntegrationError:
            good = round(motion.progress.time / step) - 1
            reached = Span(motion.states[: motion.done].T, work(motion.progress))
            return IntegrationError(not_finite(good, step), step * good, reached)

        return advance_in_core(motion, work, failure, report)

    def step_function(self, equation: Equation) -> ca.Function:
        """See :meth:`FixedStep.step_function`."""
        x, u, taut, h = equation.symbols()
        half, end = equation.ahead(u, h / 2), equation.ahead(u, h)
        k1 = equation.slope(x, u, taut)
        k2 = equation.slope(x + h / 2 * k1, half, taut)
        k3 = equation.slope(x + h / 2 * k2, half, taut)
        k4 = equation.slope(x + h * k3, end, taut)
        return Function("rk4", [x, u, taut, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])


def not_finite(good: int, step: float) -> str:
    """Return what is said of a motion that ended after so many good steps."""
    return (
        f"the state is no longer finite between {step * good:.6g} s and "
        f"{step * (good + 1):.6g} s; try a step below {step:g} s"
    )


def _block(step: ca.Function) -> ca.Function:
    """Return ``(z, u, [h1 h2 …]) -> [z1 z2 …]``, one column a step; none is taken where h is 0."""
    z, u, h = (ca.MX.sym(step.name_in(i), step.size1_in(i)) for i in range(3))
    maybe = Function("maybe", [z, u, h], [where_needed(step)(h > 0, z, u, h)])
    steps = ca.MX.sym("h", _BLOCK)
    many = maybe.mapaccum(_BLOCK)(z, ca.repmat(u, 1, _BLOCK), steps.T)
    return Function("block", [z, u, steps], [many])


def _carried(step: ca.Function, equation: Equation) -> ca.Function:
    """Return ``(z, u, h) -> z``: a step that carries the time, which strings pull, and counts.

    Without strings that can go slack, and with an input that is held, z is the state alone.
    """
    u, h = ca.MX.sym("u", equation.inputs), ca.MX.sym("h")
    clocks = min(equation.layout.degree, 1)
    sizes = [equation.states, clocks, equation.switches, len(COUNTS) * (equation.switches > 0)]
    z = ca.MX.sym("z", sum(sizes))
    x, clock, taut, counts = ca.vertsplit(z, np.cumsum([0, *sizes]).tolist())
    now = equation.ahead(u, clock)
    later = [clock + h] * clocks
    if not equation.switches:
        x1 = step(x, now, ca.MX(0, 1), h)
        return Function("step", [z, u, h], [ca.vertcat(x1, *later)])
    x1, taut1, more = located(step, equation)(x, taut, now, h)
    return Function("step", [z, u, h], [ca.vertcat(x1, *later, taut1, counts + more)])
