"""The plan of an NMPC: a trajectory, linearized along itself, moved on and improved."""

from __future__ import annotations

import numpy as np

from tenscontrol.control.mpc.osqp_adapter import QPSolution
from tenscontrol.control.mpc.problem import Horizon
from tenscontrol.control.mpc.sparse import TrajectoryProgram
from tenscontrol.control.mpc.trajectory_model import TrajectoryModel
from tenscontrol.control.status import Status
from tenscontrol.validation import FloatArray


class TrajectoryPlan:
    """States z_0 … z_N and inputs u_0 … u_{N−1}, and the program that improves them.

    Accelerations at the stages of implicit steps are part of it, and u_{−1}, which still acts
    where winches wind.

    Parameters
    ----------
    model : TrajectoryModel
    program : TrajectoryProgram
    problem : Horizon
    bounds : tuple of ndarray, shape (α,) each
        Least and largest input.

    Attributes
    ----------
    inputs : ndarray, shape (N, α), or None
        None before there is a plan.
    prepared : bool
        Whether the program is linearized along the plan.
    """

    def __init__(
        self,
        model: TrajectoryModel,
        program: TrajectoryProgram,
        problem: Horizon,
        bounds: tuple[FloatArray, FloatArray],
    ) -> None:
        self._model, self._program, self._problem = model, program, problem
        self._motion = model.motion
        self._low, self._high = bounds
        self.reset()

    def reset(self) -> None:
        """Forget the plan."""
        self._states: FloatArray = np.zeros((0, 0))
        self._stages: FloatArray = np.zeros((0, 0, 0))
        self._before: FloatArray = np.zeros(0)
        self.inputs: FloatArray | None = None
        self.prepared, self._shifted = False, True
        self._program.forget()

    def begin(
        self, state: FloatArray, standing: FloatArray, reference: FloatArray, origin: FloatArray
    ) -> None:
        """Plan with the law of the linear plant, kept within bounds, on the nonlinear one.

        Far from its operating point that law may lead stiff strings to where their steps are not
        solved. Then the plan is the reference itself, whose stages the programs find.
        """
        start, states, inputs, stages = state, [state], [standing], []
        aims, held_before = np.vstack([reference[:1], reference[:-1]]), origin[0]
        for aim, held in zip(aims, origin, strict=True):
            off = states[-1] - aim
            if self._motion.ramp:
                off, held_before = np.concatenate([off, inputs[-1] - held_before]), held
            wish = held - self._problem.feedback @ off
            inputs.append(np.clip(wish, self._low, self._high))
            state, within = self._motion.advance(states[-1], inputs[-2], inputs[-1])
            states.append(state)
            stages.append(within)
        self._states, self.inputs = np.array(states), np.array(inputs[1:])
        self._stages, self._before = np.array(stages), standing
        if self._stages.size and not np.isfinite(self._states).all():
            self._states = np.vstack([start, reference])
            self.inputs = np.clip(origin, self._low, self._high)
            self._stages = np.zeros_like(self._stages)
        self._shifted, self.prepared = True, False

    def prepare(self) -> None:
        """Move the plan on by a sample, where that is due, and linearize along it.

        Where the dynamics have no value, ``prepared`` stays False.
        """
        self.shift()
        self._linearize(self._planned())

    def shift(self) -> None:
        """Move the plan on by a sample, once."""
        if self._shifted:
            return
        inputs = self._planned()
        last = np.clip(inputs[-1], self._low, self._high)
        end, within = self._motion.advance(self._states[-1], inputs[-1], last)
        self._states = np.vstack([self._states[1:], end])
        self._stages = np.concatenate([self._stages[1:], within[None]])
        self._before, self.inputs = inputs[0], np.vstack([inputs[1:], last])
        self._program.shift()
        self._shifted = True

    def improve(
        self, state: FloatArray, reference: FloatArray, origin: FloatArray, previous: FloatArray,
        standing: FloatArray, load: FloatArray | None, deadline: float,
    ) -> tuple[QPSolution, float]:  # fmt: skip
        """Solve the program once; return its answer, and the largest change in units of an input.

        The arguments are those of :meth:`TrajectoryProgram.solve`, but for accelerations by a
        load, shape (r,). Where the program is not solved, the plan stays, unless the dynamics have
        no value along it.
        """
        before = self._planned()
        if not self.prepared:
            self._linearize(before)
        if not self.prepared:
            self.reset()
            return QPSolution(Status.BAD_DATA, None, None, 0), np.inf
        drift = None if load is None else self._motion.pushed(load)
        answer, states, inputs = self._program.solve(
            state, reference, origin, previous, drift,
            standing if self._motion.ramp else None, deadline,
        )  # fmt: skip
        self.prepared = False
        if answer.x is None:
            return answer, np.inf
        acting, states = np.vstack([standing, inputs]), np.vstack([state, states])
        changes = (states - self._states)[:-1], acting - self._acting(before)
        self._stages = self._motion.corrected(self._stages, *changes, load)
        self._states, self.inputs, self._before = states, inputs, standing
        return answer, float(np.abs(inputs - before).max()) / self._problem.level

    def release(self, solved: bool) -> None:
        """Let the next sample move the plan on; from a new start where a program was not solved."""
        self.prepared, self._shifted = False, False
        if not solved:
            self._program.forget()

    def _linearize(self, inputs: FloatArray) -> None:
        motion, rows = self._model.tangents(self._states, self._acting(inputs), self._stages)
        # A plan may lead where the dynamics have no value: there is nothing to prepare then.
        parts = [part for each in (motion, rows) if each for part in (each.offset, *each.slopes)]
        self.prepared = all(np.isfinite(part).all() for part in parts)
        if self.prepared:
            # Stiff strings are sensitive to rest lengths: measured from those of the plan.
            about = (self._states[1:], inputs) if self._stages.size else None
            self._program.linearize(motion, rows, about)

    def _acting(self, inputs: FloatArray) -> FloatArray:
        return np.vstack([self._before, inputs])

    def _planned(self) -> FloatArray:
        assert self.inputs is not None  # callers see to it
        return self.inputs
