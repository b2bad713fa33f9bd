"""Nonlinear model predictive control by real-time iterations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import final

import casadi as ca
import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.control.controller import Command, Controller
from tenscontrol.control.disturbance import LoadObserver, load_observer
from tenscontrol.control.mpc.constraints import OutputLimit
from tenscontrol.control.mpc.nmpc_law import NMPCLaw
from tenscontrol.control.mpc.nmpc_statistics import NMPCStatistics, statistics
from tenscontrol.control.mpc.real_time_iteration import TrajectoryPlan
from tenscontrol.control.mpc.settings import Wishes, checked_time_limit, default_penalty, design
from tenscontrol.control.mpc.trajectory_model import TrajectoryModel
from tenscontrol.control.status import Fallback, Status
from tenscontrol.plant import LinearPlant, ReferencePreview, acceleration_response
from tenscontrol.validation import (
    FloatArray,
    frozen,
    instance,
    positive_number,
    truth,
    whole_number,
)

# Sequential quadratic programming has converged when no input changes by more, in its unit.
CONVERGED = 1e-5


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
        Number N of samples predicted, 1 to 10,000.
    sample_time : float
        Sample time, s.
    max_force_density : float or array_like, shape (α,)
        Largest γ, N/m. May be left out where the input is the rest length.
    Q : float or array_like, shape (2r,) or (2r, 2r), optional
        As for :class:`MPC`.
    R : float or array_like, shape (α,) or (α, α), optional
        As for :class:`MPC`.
    max_change : float or array_like, shape (α,), optional
        Largest change of the input from sample to sample, N/m or m.
    winches : Winches, optional
        Speed and range that bound rest lengths. Where they wind through samples, γ is limited at
        the ends of samples.
    reference : Reference or array_like, shape (3, n), optional
        Shapes to follow, seen ahead. The operating point if not given.
    iterations : int
        Programs solved in a sample at most; fewer if the plan has converged.
    tolerance : float
        OSQP's absolute and relative tolerance, in units of an input.
    max_iterations : int
        OSQP's limit.
    min_force_density, max_tension, outputs, string_penalty : optional
        Limits as for :class:`MPC`, on what is predicted, linearized along the plan. Where the
        input is the rest length, limits of γ are soft, and one of 0 keeps strings taut.
    load_gain, tracked : optional
        An unknown load, as for :class:`MPC`; the shape at rest under it is that of the
        nonlinear plant.
    machine_code : bool
        Compile the derivatives, where there is a C compiler: the same numbers, sooner. The
        library is kept for the next run; the first time it takes some ten seconds.
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

    A sample is predicted by RK4; where winches wind, or held strings are so stiff that it takes
    more than 4 steps, by one implicit step. Strings that would be slack push in it, as in linear
    MPC, and a load is not estimated then; ``min_force_density`` keeps plans clear of that.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> from tenscontrol.control import NMPC
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> nmpc = NMPC(plant, horizon=10, sample_time=0.02, max_force_density=60.0)
    >>> command = nmpc.command(0.0, plant.to_nodes(np.full(9, 0.01)), np.zeros((3, 6)))
    >>> str(command), bool((command.value >= 0).all())
    ('ok', True)
    >>> nmpc.prepare()  # while the plant moves; the next command is then quicker
    """

    def __init__(
        self,
        plant: LinearPlant,
        *,
        horizon: int,
        sample_time: float,
        max_force_density: object = None,
        Q: object = None,
        R: object = None,
        max_change: object = None,
        winches: Winches | None = None,
        reference: object = None,
        iterations: int = 1,
        tolerance: float = 1e-4,
        max_iterations: int = 4000,
        min_force_density: object = 0.0,
        max_tension: object = None,
        outputs: Sequence[OutputLimit] = (),
        string_penalty: float | None = None,
        load_gain: float | None = None,
        tracked: object = None,
        machine_code: bool = False,
        time_limit: float | None = None,
    ) -> None:
        instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        if winches is not None:
            instance("winches", winches, Winches, "make them by Winches(rate=...)")
        sample_time = positive_number("sample_time", sample_time, "s")
        truth("machine_code", machine_code, "whether to compile the derivatives")
        rounds = whole_number("iterations", iterations, least=1)
        tolerance = positive_number("tolerance", tolerance, "units of an input")
        max_iterations = whole_number("max_iterations", max_iterations, least=1)
        longest = checked_time_limit(time_limit)
        wishes = Wishes(
            max_force_density, min_force_density, max_tension, max_change, winches, outputs,
            default_penalty(string_penalty),
        )  # fmt: skip
        made = design(plant, horizon, sample_time, Q, R, wishes)
        super().__init__(plant, sample_time, made.low, made.high, made.problem.change)
        push = acceleration_response(plant, sample_time)
        path = ReferencePreview(plant, reference, made.sampled)
        self._observer = observer = load_observer(plant, push, load_gain, tracked)
        # After all checks: it may be compiled.
        substeps = 1 if winches is None else winches.substeps
        model = TrajectoryModel(
            plant, sample_time, made.problem.length, made.constraints, substeps, machine_code
        )
        self._law = NMPCLaw(
            sample_time=sample_time,
            model=model,
            problem=replace(made.unwound, rows=model.with_places(made.problem.rows)),
            bounds=self.bounds,
            row_bounds=made.constraints.limits,
            units=model.units(made.problem.level),
            load=None if observer is None else observer.model,
            rounds=rounds,
            tolerance=tolerance,
            max_iterations=max_iterations,
            time_limit=longest,
            path=path,
        )
        self._program = self._law.program()
        self._plan = TrajectoryPlan(model, self._program, self._law.problem, self.bounds)
        self.reset()

    @property
    def law(self) -> NMPCLaw:
        """All that it goes by, except what it remembers; not for users, and may change."""
        return self._law

    @property
    def horizon(self) -> int:
        """Number N of samples predicted."""
        return self._law.problem.length

    @property
    def sampled(self) -> ca.Function:
        """The prediction model ``(z, u) -> z⁺``; ``(z, u_before, u) -> z⁺`` where winches wind."""
        return self._law.model.motion.sampled

    @property
    def back_end(self) -> str:
        """What evaluates the derivatives: ``"machine code"`` or ``"virtual machine"``."""
        return self._law.model.back_end

    @property
    def weights(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Q, R and the terminal P, which is of ``[z; u_before]`` where winches wind."""
        problem = self._law.problem
        return problem.state_weight, problem.input_weight, problem.terminal_weight

    @property
    def plan(self) -> FloatArray:
        """Planned inputs, shape (α, N)."""
        inputs = self._plan.inputs
        return np.zeros((len(self._low), 0)) if inputs is None else frozen(inputs.T)

    @property
    def statistics(self) -> NMPCStatistics:
        """What became of the samples since the last reset."""
        return statistics(self.status_count, self.fallback_count, self._records)

    @property
    def load(self) -> FloatArray | None:
        """q̈ laid to an unknown load, m √kg/s², shape (r,); None where none is estimated."""
        return None if self._observer is None else frozen(self._observer.acceleration)

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
        self._law = replace(self._law, path=self._law.path.following(reference))

    def targets(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return what the cost measures from: r_1 … r_N, shape (N, s), and s_0 …, shape (N, α).

        Parameters
        ----------
        time : float
            Of the sample that starts now, s.
        """
        reference, origin = self._law.targets(time)
        if self._observer is None:
            return reference, origin
        return self._law.model.at_rest(reference, origin, self._observer)

    def reset(self) -> None:
        """Forget the plan, what stands, the estimated load and the statistics."""
        super().reset()
        self._plan.reset()
        self._program.reset()
        self._followed = 0
        self._seen: tuple[FloatArray, FloatArray] | None = None
        self._records: list[tuple[float, ...]] = []
        self._preparing = 0.0
        if self._observer is not None:
            self._observer.reset()

    def take_over(self, command: FloatArray) -> None:
        """See :meth:`Controller.take_over`."""
        super().take_over(command)
        self._plan.reset()
        self._followed, self._seen = 0, None

    def prepare(self) -> None:
        """Linearize along the plan, moved on by a sample: all that needs no measurement.

        A command prepares itself where this was not called before it. Before the
        first command there is no plan, and nothing to do.
        """
        if self._plan.prepared or self._plan.inputs is None:
            return
        began = perf_counter()
        self._plan.prepare()
        self._preparing = perf_counter() - began

    def _decide(self, time: float, state: FloatArray) -> Command:
        deadline = self._called + self._law.time_limit
        load = None if self._observer is None else self._corrected(self._observer, state)
        reference, origin = self.targets(time)
        if self._previous_input is None:
            self._previous_input = frozen(self._law.start(time, origin))
        standing = self._previous_input
        self._seen = state, standing
        if self._plan.inputs is None:
            self._plan.begin(state, standing, reference, origin)
        self.prepare()
        if not self._plan.prepared:  # the plan led where the dynamics have no value
            self._plan.begin(state, standing, reference, origin)
        preparing, began = self._preparing, perf_counter()
        work = 0
        for rounds in range(1, self._law.rounds + 1):
            answer, change = self._plan.improve(
                state, reference, origin, self._previous_within_bounds, standing, load, deadline
            )
            work += answer.iterations
            if answer.x is None:
                self._record(rounds, work, change, preparing, began)
                return self._continue(answer.status)
            self._followed = 0
            if change < CONVERGED or perf_counter() >= deadline:
                break
        self._plan.release(solved=True)
        self._record(rounds, work, change, preparing, began)
        assert self._plan.inputs is not None  # solved
        return Command(self._plan.inputs[0])

    def _corrected(self, observer: LoadObserver, state: FloatArray) -> FloatArray:
        """Compare with the sample before, and return accelerations by the load.

        What the input did since then is found now, from what the actuators really held.
        """
        if self._seen is not None and self._previous_input is not None:
            motion, load = self._law.model.motion, observer.acceleration
            observer.correct(state, *motion.expected(*self._seen, self._previous_input, load))
        observer.expect(np.zeros_like(state))  # all that comes is in the next prediction
        return observer.acceleration

    def _record(
        self, rounds: int, work: int, change: float, preparing: float, began: float
    ) -> None:
        self._records.append((rounds, work, change, preparing, perf_counter() - began))

    def _fall_back(self, status: Status) -> Command:
        self._seen = None
        return self._continue(status)

    def _continue(self, status: Status) -> Command:
        """Follow the plan for another sample; after its end hold what is safe."""
        self._followed += 1
        if self._followed >= self.horizon:
            self._plan.reset()
        if self._plan.inputs is not None:
            self._plan.shift()
            wanted = Command(self._plan.inputs[0], status, Fallback.PLAN_CONTINUED)
        else:
            wanted = self._hold(status)
        self._plan.release(solved=False)
        return wanted

    def __repr__(self) -> str:
        return f"NMPC({self.plant!r}, horizon {self.horizon}, sample time {self.sample_time:g} s)"
