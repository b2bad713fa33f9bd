"""Nonlinear model predictive control by real-time iterations."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from time import perf_counter
from typing import final

import casadi as ca
import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.analysis import LinearPlant
from tenscontrol.control.controller import OK, Controller
from tenscontrol.control.lqr import state_units
from tenscontrol.control.mpc_design import Wishes, design
from tenscontrol.control.path import Path, acceleration_response, checked_reference
from tenscontrol.control.quadratic_program import Status
from tenscontrol.control.reduced_dynamics import sampled_dynamics
from tenscontrol.control.trajectory_program import TrajectoryProgram
from tenscontrol.dynamics import Evaluator
from tenscontrol.validation import (
    FloatArray,
    frozen,
    instance,
    positive_number,
    whole_number,
)

# Sequential quadratic programming has converged when no input changes by more, in its unit.
_CONVERGED = 1e-5


@dataclass(frozen=True, eq=False)
class NMPCStatistics:
    """What became of the samples since the last reset.

    Attributes
    ----------
    status_count : dict of str to int
        How often each status came; ``"ok"`` is a solved program.
    programs : ndarray of int, shape (K,)
        Quadratic programs solved in each sample.
    iterations : ndarray of int, shape (K,)
        OSQP iterations in each sample.
    last_change : ndarray, shape (K,)
        Largest change of an input by the last program of each sample, in units of an input: how
        far the plan is from converged.
    preparation_time, feedback_time : ndarray, shape (K,)
        Before the measurement is needed, and after it is there, s.
    """

    status_count: dict[str, int]
    programs: np.ndarray
    iterations: np.ndarray
    last_change: FloatArray
    preparation_time: FloatArray
    feedback_time: FloatArray


@final
class NMPC(Controller):
    """Nonlinear MPC: the plant is linearized along the motion that was predicted.

    At each sample the last plan, moved on by a sample, is linearized exactly
    (preparation, before the measurement); with the measured state one
    quadratic program of fixed sparsity is solved (feedback). That is one step of
    sequential quadratic programming with the Gauss-Newton Hessian a sample; more
    on request. Motion is measured anew in reduced coordinates at each sample,
    in which bars keep their lengths and need no states.

    If a program is not solved, or the measurement is not one that the structure can
    have, the plan is followed for another sample; after its end γ of the operating
    point is commanded, or the rest lengths that stand. The status says so. Changes
    are limited from what the actuators hold (:meth:`applied`). A plan that was followed
    to its end is forgotten, and the next measurement starts a new one.

    Parameters
    ----------
    plant : LinearPlant
        In internal coordinates, at an equilibrium. It says which input, and
        gives the terminal cost, that of its discrete LQR.
    horizon : int
        Number N of samples predicted, at least 1.
    step : float
        Sample time, s.
    max_force_density : float or array_like, shape (α,)
        Largest γ, N/m; leave it out where the input is the rest length. The
        least is 0; strings of held rest length go slack by their law.
    Q : float or array_like, shape (2r,) or (2r, 2r), optional
        As for :class:`MPC`.
    R : float or array_like, shape (α,) or (α, α), optional
        As for :class:`MPC`.
    max_change : float or array_like, shape (α,), optional
        Largest change of the input from sample to sample, N/m or m.
    winches : Winches, optional
        Speed and range that bound rest lengths.
    reference : Reference or array_like, shape (3, n), optional
        Shapes to follow, seen ahead. The operating point if not given.
    iterations : int
        Programs solved in a sample at most; fewer if the plan has converged.
    tolerance : float
        OSQP's absolute and relative tolerance, in units of an input.
    max_iterations : int
        OSQP's limit.
    time_limit : float, optional
        Time for a command, s, from its call; preparation counts where it was not
        done before. A program that is not solved by then is given up at the end
        of an OSQP iteration, and no other is begun.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or the plant has a pole that no string reaches.

    Notes
    -----
    Diehl, Bock & Schlöder (2005), doi:10.1137/S0363012902400713.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> from tenscontrol.control import NMPC
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> nmpc = NMPC(plant, horizon=10, step=0.02, max_force_density=60.0)
    >>> command = nmpc.command(0.0, plant.to_nodes(np.full(9, 0.01)), np.zeros((3, 6)))
    >>> command.status, bool((command.value >= 0).all())
    ('ok', True)
    >>> nmpc.prepare()  # while the plant moves; the next command is then quicker
    """

    def __init__(
        self,
        plant: LinearPlant,
        horizon: int,
        step: float,
        max_force_density: object = None,
        *,
        Q: object = None,
        R: object = None,
        max_change: object = None,
        winches: Winches | None = None,
        reference: object = None,
        iterations: int = 1,
        tolerance: float = 1e-4,
        max_iterations: int = 4000,
        time_limit: float | None = None,
    ) -> None:
        instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        if winches is not None:
            instance("winches", winches, Winches, "make them by Winches(rate=...)")
        if plant.input == "rest_length" and max_force_density is not None:
            raise ValueError(
                "max_force_density limits plants with input='force_density'; give winches, "
                "which limit rest lengths"
            )
        step = positive_number("step", step, "s")
        length = whole_number("horizon", horizon, least=1)
        self._rounds = whole_number("iterations", iterations, least=1)
        wishes = Wishes(max_force_density, 0.0, None, max_change, winches, (), 1.0)
        made = design(plant, length, step, Q, R, wishes)
        super().__init__(plant, step, made.low, made.high, made.problem.change)
        self._time_limit = np.inf
        if time_limit is not None:
            self._time_limit = positive_number("time_limit", time_limit, "s")
        self._problem = made.problem
        self._program = TrajectoryProgram(
            made.problem,
            self.bounds,
            state_units(plant)[0],
            positive_number("tolerance", tolerance, "units of an input"),
            whole_number("max_iterations", max_iterations, least=1),
        )
        self._sample, linearized = sampled_dynamics(plant, step)
        self._advance = Evaluator(self._sample)
        self._linearize = Evaluator(linearized.map(length))
        self._push = acceleration_response(plant, step)
        self._ahead: FloatArray = step * np.arange(length + 1.0)
        self.follow(reference)
        self.reset()

    @property
    def horizon(self) -> int:
        """Number N of samples predicted."""
        return self._problem.length

    @property
    def sampled(self) -> ca.Function:
        """The prediction model ``(z, u) -> z`` a sample later."""
        return self._sample

    @property
    def weights(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Q, R and the terminal P."""
        problem = self._problem
        return problem.state_weight, problem.input_weight, problem.terminal_weight

    @property
    def plan(self) -> FloatArray:
        """Planned inputs, shape (α, N)."""
        return frozen(self._inputs.T) if self._inputs is not None else np.zeros((len(self._low), 0))

    @property
    def statistics(self) -> NMPCStatistics:
        """What became of the samples since the last reset."""
        records = np.array(self._records).reshape(-1, 5)
        return NMPCStatistics(
            status_count=dict(Counter(self._statuses)),
            programs=frozen(records[:, 0].astype(np.int64)),
            iterations=frozen(records[:, 1].astype(np.int64)),
            last_change=frozen(records[:, 2]),
            preparation_time=frozen(records[:, 3]),
            feedback_time=frozen(records[:, 4]),
        )

    def follow(self, reference: object) -> None:
        """Follow another reference from now on.

        Parameters
        ----------
        reference : Reference or array_like, shape (3, n), or None
            As in the constructor.

        Raises
        ------
        TypeError, ValueError
            If it does not fit the structure.
        """
        assert self.step is not None  # given to the constructor
        checked = checked_reference(self.plant, reference)
        self._path = Path(self.plant, checked, self.step, self._push, self._problem.drift)

    def targets(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return what the cost measures from: r_1 … r_N, shape (N, s), and s_0 … , shape (N, α).

        Parameters
        ----------
        time : float
            Of the sample that starts now, s.
        """
        times = time + self._ahead
        return self._path.wanted(times[1:]), self._path.at(times[:-1]).input

    def reset(self) -> None:
        """Forget the plan, what stands and the statistics."""
        self._followed = 0
        self._states: FloatArray | None = None
        self._inputs: FloatArray | None = None
        super().reset()
        self._prepared = False
        self._shifted = True
        self._program.forget()
        self._statuses: list[str] = []
        self._records: list[tuple[float, ...]] = []
        self._preparing = 0.0

    def prepare(self) -> None:
        """Linearize along the plan, moved on by a sample: all that needs no measurement.

        A command prepares itself where this was not called before it. Before the
        first command there is no plan, and nothing to do.
        """
        if self._prepared or self._states is None or self._inputs is None:
            return
        began = perf_counter()
        self._shift()
        self._relinearize()
        self._preparing = perf_counter() - began

    def _shift(self) -> None:
        """Move the plan on by a sample, once."""
        if self._shifted:
            return
        assert self._states is not None  # callers see to it
        assert self._inputs is not None  # callers see to it
        last = np.clip(self._inputs[-1], self._low, self._high)
        end = self._advance(self._states[-1], last)[0]
        self._states = np.vstack([self._states[1:], end])
        self._inputs = np.vstack([self._inputs[1:], last])
        self._program.shift()
        self._shifted = True

    def _relinearize(self) -> None:
        assert self._states is not None  # callers see to it
        assert self._inputs is not None  # callers see to it
        z, u = self._states[:-1], self._inputs
        N = len(z)
        ends, by_state, by_input = self._linearize(z.T, u.T)
        A, B = _blocks(by_state, N), _blocks(by_input, N)
        offset = ends.reshape(-1, N, order="F").T - np.einsum("kij,kj->ki", A, z)
        offset = offset - np.einsum("kij,kj->ki", B, u)
        # A plan may lead where the dynamics have no value: there is nothing to prepare then.
        self._prepared = all(np.isfinite(part).all() for part in (A, B, offset))
        if self._prepared:
            self._program.linearize(A, B, offset)

    def _decide(self, time: float, state: FloatArray) -> tuple[FloatArray, str]:
        deadline = self._called + self._time_limit
        reference, origin = self.targets(time)
        if self._standing is None:
            self._standing = frozen(origin[0])
        if self._states is None:
            self._begin(state, reference, origin)
        self.prepare()
        if not self._prepared:  # the plan led where the dynamics have no value
            self._begin(state, reference, origin)
        preparing, began = self._preparing, perf_counter()
        work, change = 0, np.inf
        for rounds in range(1, self._rounds + 1):
            if not self._prepared:
                self._relinearize()
            if not self._prepared:
                self._states = self._inputs = None
                self._record(rounds - 1, work, change, preparing, began)
                return self._fall_back(Status.BAD_DATA.value)
            answer, states, inputs = self._program.solve(
                state, reference, origin, self._reachable, deadline
            )
            self._prepared = False
            work += answer.iterations
            if answer.x is None:
                self._record(rounds, work, change, preparing, began)
                return self._fall_back(answer.status.value)
            assert self._inputs is not None  # begun above
            change = float(np.abs(inputs - self._inputs).max()) / self._problem.level
            self._states, self._inputs = np.vstack([state, states]), inputs
            self._followed = 0
            if change < _CONVERGED or perf_counter() >= deadline:
                break
        self._shifted = False
        self._statuses.append(OK)
        assert self._inputs is not None  # solved
        self._record(rounds, work, change, preparing, began)
        return self._inputs[0], OK

    def _begin(self, state: FloatArray, reference: FloatArray, origin: FloatArray) -> None:
        """Plan with the law of the linear plant, kept within bounds, on the nonlinear one."""
        states, inputs = [state], []
        aims = np.vstack([reference[:1], reference[:-1]])
        for aim, held in zip(aims, origin, strict=True):
            wish = held - self._problem.feedback @ (states[-1] - aim)
            inputs.append(np.clip(wish, self._low, self._high))
            states.append(self._advance(states[-1], inputs[-1])[0].copy())
        self._states, self._inputs = np.array(states), np.array(inputs)
        self._shifted, self._prepared = True, False

    def _record(
        self, rounds: int, work: int, change: float, preparing: float, began: float
    ) -> None:
        self._records.append((rounds, work, change, preparing, perf_counter() - began))

    def _fall_back(self, reason: str) -> tuple[FloatArray, str]:
        """Follow the plan for another sample; after its end hold what is safe."""
        self._followed += 1
        if self._followed >= self.horizon:
            self._states = self._inputs = None
        if self._inputs is not None:
            self._shift()
            wish, what = self._inputs[0], "plan continued"
        elif self.input == "rest_length" and self._standing is not None:
            wish, what = self._standing, "last command held"
        else:
            wish, what = self.plant.equilibrium_input, "equilibrium held"
        self._prepared, self._shifted = False, False
        self._program.forget()
        status = f"{reason}: {what}"
        self._statuses.append(status)
        return wish, status

    def __repr__(self) -> str:
        return f"NMPC({self.plant!r}, horizon {self.horizon}, step {self.step:g} s)"


def _blocks(side_by_side: FloatArray, count: int) -> FloatArray:
    """Return matrices that stand side by side as a stack, shape (count, rows, columns)."""
    rows = side_by_side.shape[0]
    return np.asarray(side_by_side.reshape(rows, count, -1).swapaxes(0, 1))
