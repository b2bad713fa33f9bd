"""Nonlinear model predictive control by real-time iterations."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import final

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.command import Command, ControlWarning, Fallback
from tenscontrol.control.disturbance import LoadObserver
from tenscontrol.control.mpc.linear import warn_of_loop
from tenscontrol.control.mpc.problem import MPCProblem, Pair, StageData, Subproblem, Triple
from tenscontrol.control.mpc.real_time_iteration import RealTimeIterate, TrajectoryModel
from tenscontrol.control.mpc.settings import (
    MPCSettings,
    PredictiveController,
    PredictiveLaw,
    design,
    from_settings,
    make_solver,
    uses_stages,
)
from tenscontrol.control.mpc.sparse import Sparse, SparseSubproblem
from tenscontrol.control.mpc.stages import StagesSubproblem
from tenscontrol.docstrings import with_parameters_of
from tenscontrol.fields import checked, optional
from tenscontrol.plant.linear_plant import LinearPlant, refuse_driven_bars
from tenscontrol.plant.reference import ReferencePreview
from tenscontrol.properties import cached_property
from tenscontrol.short_repr import short_repr
from tenscontrol.status import Status
from tenscontrol.warn import warn

# Sequential quadratic programming has converged when no input changes by more, in its unit.
CONVERGED = 1e-5

# Commands differ by about a thousandth of the unit of an input from those without.
LINEARIZATION_TOLERANCE = 0.05


@dataclass(frozen=True, eq=False)
class NMPCStatistics:
    """Counts and times of the samples since the last reset.

    The arrays have an entry for each of the K samples whose measurement was used; a fallback for
    want of a measurement is counted in ``status_count`` alone.

    Attributes
    ----------
    status_count : dict of Status to int
        How often each status came; ``Status.OK`` is a solved program.
    fallback_count : dict of Fallback to int
        How often each fallback was taken.
    programs : ndarray of int, shape (K,)
        Quadratic programs solved in each sample.
    iterations : ndarray of int, shape (K,)
        Iterations of the solver in each sample.
    linearized : ndarray of int, shape (K,)
        Samples of the plan whose derivatives were found anew.
    last_change : ndarray, shape (K,)
        Largest change of an input by the last program of each sample, in units of an input: how
        far the plan is from converged. Infinite where that program was not solved.
    preparation_time, feedback_time : ndarray, shape (K,)
        Before the measurement is needed, and after it is there, s.
    """

    status_count: dict[Status, int]
    fallback_count: dict[Fallback, int]
    programs: np.ndarray
    iterations: np.ndarray
    linearized: np.ndarray
    last_change: FloatArray
    preparation_time: FloatArray
    feedback_time: FloatArray

    __repr__ = short_repr


@dataclass(frozen=True, eq=False, kw_only=True)
class NMPCLaw(PredictiveLaw):
    """What a nonlinear MPC computes with, except what it remembers."""

    model: TrajectoryModel
    problem: MPCProblem  # its rows are those of the model
    bounds: Pair  # of inputs, shape (α,) each
    row_bounds: Pair  # of limited rows, shape (p,) each
    units: FloatArray  # of the state, shape (s,)
    rounds: int  # programs solved in a sample at most
    linearization_tolerance: float

    def program(self) -> Subproblem:
        """Return the SQP subproblem with its solver."""
        settings = self.settings
        if uses_stages(settings):
            return StagesSubproblem(
                self.problem, self.row_bounds, settings.max_iterations, self.bounds,
                self.linearization_tolerance,
            )  # fmt: skip
        form, implicit = Sparse(self.problem, self.units, varying=True), self.model.implicit
        # Slopes by implicit steps are of different sizes in these units: the solver scales them.
        # Stiff strings are sensitive to rest lengths: measured from those of the plan.
        solver = make_solver(settings, form, equations=not implicit)
        return SparseSubproblem(form, solver, relative=implicit)

    def targets(self, time: float) -> Pair:
        """Return r_1 … r_N, shape (N, s), and s_0 … s_{N−1}, shape (N, α), without a load."""
        preview = self.path.over_horizon(time, self.problem.length)
        return preview.reference, preview.input[:-1]

    def stage_data(self, time: float, reference: FloatArray, inputs: FloatArray) -> StageData:
        """Return the data with these targets, without a load; inputs are measured from zero."""
        start = None
        if self.problem.cross_weight is not None:
            start = self.path.over_horizon(time, self.problem.length).start
        return replace(
            self._limits, reference=reference, input_reference=inputs, first_reference=start
        )

    @cached_property
    def _limits(self) -> StageData:
        """The data without targets."""
        N, (s, a) = self.problem.length, self.problem.input_matrix.shape
        nothing = np.zeros((N, a))
        low, high, row_low, row_high = (
            np.tile(bound, (N, 1)) for bound in (*self.bounds, *self.row_bounds)
        )
        return StageData(
            reference=np.zeros((N, s)),
            input_reference=nothing,
            drift=np.zeros((N, s)),
            low=low,
            high=high,
            shift=nothing,
            row_low=row_low,
            row_high=row_high,
            origin=nothing,
            previous_origin=nothing[0],
        )

    def first_input(self, time: float, inputs: FloatArray) -> FloatArray:
        """Return the previous input at the first command, where no other is known, shape (α,).

        It is s_0; as a ramp reaches that at the end of the sample only, then that of the path.
        """
        ramp = self.model.discretization.ramp
        return np.asarray(self.path.at(np.array([time])).input[0] if ramp else inputs[0])


def _part(name: str, value: object) -> float:
    tolerance = validation.number(name, value, "a part")
    if tolerance < 0:
        raise ValueError(f"{name} is {tolerance:g}, expected at least 0")
    return tolerance


@with_parameters_of(MPCSettings)
@dataclass(frozen=True, eq=False, kw_only=True)
class NonlinearSettings(MPCSettings):
    """Settings of :class:`NMPC`.

    Parameters
    ----------
    iterations : int
        Quadratic programs solved in a sample at most; fewer if the plan has converged.
    linearization_tolerance : float, optional
        Part by which a sample of the plan may change and keep its derivatives. They are kept until
        its state or an input has moved, since they were found, by more than this part of: for
        positions the size of the structure, or, where rest lengths are held, the longest stretch of
        a string at rest; for velocities that size in a sample; for inputs their unit. Then it takes
        those of another sample that were found as near, if there are any. What is predicted is
        exact all the same. 0 finds all anew, in every sample, as C code does. By default 0.05 where
        steps are implicit and one program is solved in a sample, else 0.
    machine_code : bool
        Compile the derivatives that the package's compiled core does not have, where there is a C
        compiler: of laws of your own, and where bars share nodes. The same numbers, sooner.
        Libraries are kept for the next run, and serve every horizon.
    """

    iterations: int = field(default=1, metadata=checked(validation.whole_number, 1))
    linearization_tolerance: float | None = field(default=None, metadata=optional(_part))
    machine_code: bool = field(
        default=False, metadata=checked(validation.truth, "whether to compile the derivatives")
    )

    __repr__ = short_repr


@final
@with_parameters_of(NonlinearSettings)
class NMPC(PredictiveController):
    """Nonlinear model predictive control by real-time iterations (SQP).

    Before each sample, the last solution is shifted by a sample and the dynamics are linearized
    along it (preparation). With the measured state, one quadratic program of fixed sparsity is
    solved (feedback). This is one iteration of sequential quadratic programming with the
    Gauss-Newton Hessian; ``iterations`` asks for more. The states are reduced coordinates in which
    bars keep their lengths. They are chosen anew at each sample.

    If the program is not solved, or the structure cannot have the measured shape, the command is
    the next input of the last solution. After its end it is γ of the operating point, or the rest
    lengths that the actuators hold, and the next measurement starts a new solution. The status
    shows these cases. ``max_change`` counts from the input that the actuators reached
    (:meth:`applied`).

    Parameters
    ----------
    plant : LinearPlant
        In internal coordinates, at an equilibrium. It says which input, and gives the terminal
        cost, as for :class:`MPC`, if no other is given. Of a model with ground in minimal
        coordinates, where it stands or in the air: contact is predicted.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, no string reaches a motion that grows, or drifts without
        ground, or the operating point or the reference breaks a hard limit.

    Warns
    -----
    RuntimeWarning
        If no string reaches a mode that does not decay, naming it: see ``left_alone``.
    ControlWarning
        If the loop of linear MPC with these settings does not come to rest at the operating point,
        where there is no ground: see :class:`MPC`. If a reference breaks a soft limit.

    Notes
    -----
    Diehl, Bock & Schlöder (2005), doi:10.1137/S0363012902400713.

    Limits are on what is predicted, linearized along the plan. Where the input is the rest length,
    limits of γ are soft, and one of 0 keeps strings taut. The shape at rest under an unknown load
    is that of the nonlinear plant. In the time limit preparation counts where it was not done
    before, and no other program is begun after it.

    A sample is predicted by RK4; where inputs are ramps, or held strings are so stiff that it takes
    more than 4 steps, by one implicit step. Strings that would be slack push in it, as in linear
    MPC, and a load is not estimated then; ``min_force_density`` keeps plans clear of that.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> from tenscontrol.control import NMPC
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> nmpc = NMPC(plant, horizon=10, sample_time=0.02, max_force_density=60.0)
    >>> command = nmpc.command(0.0, plant.to_nodes(np.full(9, 0.01)), np.zeros((3, 6)))
    >>> str(command), bool((command.value >= 0).all())
    ('ok', True)
    >>> nmpc.prepare()  # while the plant moves; the next command is then quicker
    """

    _law: NMPCLaw
    _nonlinear = True

    @from_settings(NonlinearSettings)
    def __init__(self, plant: LinearPlant, settings: NonlinearSettings) -> None:
        validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        refuse_driven_bars(plant, "NMPC")
        tolerance = settings.linearization_tolerance
        if tolerance and plant.model.contacts is not None:
            raise ValueError(
                f"linearization_tolerance is {tolerance:g}, and plant has ground, which changes "
                "derivatives within far less: expected 0 or None"
            )
        for i, limit in enumerate(settings.outputs):
            if limit.of == "bars":
                raise ValueError(
                    f"outputs[{i}] limits forces of bars, which NMPC does not predict: take MPC, "
                    "or max_force_density"
                )
        designed = design(plant, settings, nonlinear=True)
        if designed.problem.cross_weight is not None and settings.load_gain is not None:
            raise ValueError(
                "N and load_gain are both given: NMPC has no cross weight about a shape at rest "
                "under a load. Leave one out, or take MPC, which has both"
            )
        super().__init__(plant, settings, designed)
        if plant.model.contacts is None:
            warn_of_loop(plant, settings, designed)
        path = ReferencePreview(plant, settings.reference, designed.sampled)
        for text in self._concerns(path):
            warn(text, ControlWarning)
        # After all checks: it may be compiled.
        model = TrajectoryModel(plant, settings, designed.constraints, settings.machine_code)
        if tolerance is None:
            tolerance = (
                LINEARIZATION_TOLERANCE if model.implicit and settings.iterations == 1 else 0.0
            )
        self._law = NMPCLaw(
            settings=settings,
            model=model,
            problem=replace(designed.plant_problem, rows=model.with_pattern(designed.problem.rows)),
            bounds=self.bounds,
            row_bounds=designed.constraints.limits,
            units=model.units(designed.problem.level),
            load=None if self._observer is None else self._observer.model,
            rounds=settings.iterations,
            linearization_tolerance=tolerance,
            path=path,
        )
        self._plan = RealTimeIterate(
            model, self._law.program(), self._law.problem, self.bounds, tolerance
        )
        self.reset()

    @property
    def law(self) -> NMPCLaw:
        """What it computes with, except what it remembers; not for users, and may change."""
        return self._law

    @property
    def sampled(self) -> ca.Function:
        """The prediction ``(z, u) -> z⁺``; ``(z, u_before, u) -> z⁺`` where inputs are ramps."""
        return self._law.model.discretization.sampled

    @property
    def back_end(self) -> str:
        """What finds the derivatives: ``"core"``, ``"machine code"`` or ``"virtual machine"``."""
        return self._law.model.back_end

    @property
    def solver(self) -> str:
        """What solves its programs: ``"stages"``, ``"osqp"``, or the name of a class."""
        return self._plan.program.solver_name

    @property
    def weights(self) -> Triple:
        """Q, R and the terminal P, which is of ``[z; u_before]`` where inputs are ramps."""
        problem = self._law.problem
        R = problem.input_weight
        full = np.diag(R) if R.ndim == 1 else R
        return problem.state_weight, full, problem.terminal_weight

    @property
    def plan(self) -> FloatArray:
        """Planned inputs, shape (α, N)."""
        inputs = self._plan.inputs
        return np.zeros((len(self._low), 0)) if inputs is None else frozen(inputs.T)

    @property
    def statistics(self) -> NMPCStatistics:
        """Counts and times of the samples since the last reset."""
        table = np.array(self._records).reshape(-1, 6)
        return NMPCStatistics(
            status_count=self.status_count,
            fallback_count=self.fallback_count,
            programs=frozen(table[:, 0].astype(np.int64)),
            iterations=frozen(table[:, 1].astype(np.int64)),
            linearized=frozen(table[:, 2].astype(np.int64)),
            last_change=frozen(table[:, 3]),
            preparation_time=frozen(table[:, 4]),
            feedback_time=frozen(table[:, 5]),
        )

    def targets(self, time: float) -> Pair:
        """Return what the cost measures from: r_1 … r_N, shape (N, s), and s_0 …, shape (N, α).

        Parameters
        ----------
        time : float
            Of the sample that starts now, s.

        Raises
        ------
        TypeError, ValueError
            If it is not one finite number.
        """
        return self._targets(validation.number("time", time, "s"))

    def _targets(self, time: float) -> Pair:
        reference, inputs = self._law.targets(time)
        if self._observer is None:
            return reference, inputs
        return self._law.model.at_rest(reference, inputs, self._observer)

    def reset(self) -> None:
        """See :meth:`PredictiveController.reset`."""
        super().reset()
        self._plan.reset()
        self._followed = 0
        self._seen: Pair | None = None
        self._records: list[tuple[float, ...]] = []
        self._preparing = 0.0

    def prepare(self) -> None:
        """Linearize along the plan, moved on by a sample: all that needs no measurement.

        A command prepares itself where this was not called before it. Before the
        first command there is no plan, and nothing to do.
        """
        if self._plan.linearized or self._plan.inputs is None:
            return
        began = perf_counter()
        self._plan.prepare()
        self._preparing = perf_counter() - began

    def _decide(self, time: float, state: FloatArray) -> Command:
        law = self._law
        deadline = self._called + self._longest_time
        load = None if self._observer is None else self._corrected(self._observer, state)
        data = law.stage_data(time, *self._targets(time))
        if self._previous_input is None:
            self._previous_input = frozen(law.first_input(time, data.input_reference))
        previous_input, within_bounds = self._previous_input, self._previous_within_bounds
        self._seen = state, previous_input
        if self._plan.inputs is None:
            self._plan.begin(state, previous_input, data)
        self.prepare()
        if not self._plan.linearized:  # the plan led where the dynamics have no value
            self._plan.begin(state, previous_input, data)
        preparing, began = self._preparing, perf_counter()
        work = 0
        for rounds in range(1, law.rounds + 1):
            answer, change = self._plan.iterate(
                state, data, within_bounds, previous_input, load, deadline
            )
            work += answer.iterations
            if answer.plan is None:
                self._record(rounds, work, change, preparing, began)
                return self._continue(answer.status)
            self._followed = 0
            if change < CONVERGED or perf_counter() >= deadline:
                break
        self._plan.release(solved=True)
        self._record(rounds, work, change, preparing, began)
        assert self._plan.inputs is not None  # solved
        self._predicted = self._plan.next_state
        return Command(self._plan.inputs[0])

    def _corrected(self, observer: LoadObserver, state: FloatArray) -> FloatArray:
        """Return accelerations by the load, from what the actuators held since the last sample."""
        if self._seen is not None and self._previous_input is not None:
            predict, load = self._law.model.discretization.predict, observer.acceleration
            observer.correct(state, *predict(*self._seen, self._previous_input, load))
        observer.expect(np.zeros_like(state))  # all that comes is in the next prediction
        return observer.acceleration

    def _record(
        self, rounds: int, work: int, change: float, preparing: float, began: float
    ) -> None:
        fresh, self._plan.fresh = self._plan.fresh, 0
        self._records.append((rounds, work, fresh, change, preparing, perf_counter() - began))

    def _fall_back(self, status: Status) -> Command:
        self._seen = None
        return self._continue(status)

    def _continue(self, status: Status) -> Command:
        """Follow the plan for another sample; after its end hold what is safe."""
        self._followed += 1
        if self._followed >= self.horizon:
            self._plan.clear()
        if self._plan.inputs is not None:
            self._plan.shift()
            wanted = Command(self._plan.inputs[0], status, Fallback.PLAN_CONTINUED)
        else:
            wanted = self._hold(status)
        self._plan.release(solved=False)
        return wanted

    def __repr__(self) -> str:
        return f"NMPC({self.plant!r}, horizon {self.horizon}, sample time {self.sample_time:g} s)"
