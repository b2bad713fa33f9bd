"""Linear model predictive control with γ ≥ 0, and its condensed quadratic program."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, final

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.command import Command, ControlWarning, Fallback
from tenscontrol.control.controller import clipped
from tenscontrol.control.held_loop import warn_of_held_lengths
from tenscontrol.control.mpc.problem import (
    Form,
    LimitRows,
    MPCProblem,
    Pair,
    StageData,
    Triple,
    prediction,
    shifted,
)
from tenscontrol.control.mpc.settings import (
    Design,
    MPCSettings,
    PredictiveController,
    PredictiveLaw,
    design,
    from_settings,
    law_in_shape,
    make_solver,
    solver_kind,
    solver_name,
)
from tenscontrol.control.mpc.solvers.daqp_adapter import DAQPSolver
from tenscontrol.control.mpc.solvers.solver import QPSolver
from tenscontrol.control.mpc.sparse import Sparse
from tenscontrol.control.mpc.stages import LinearProgram, has_compiled_program
from tenscontrol.docstrings import with_parameters_of
from tenscontrol.fields import checked
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.reference import Preview, ReferencePreview
from tenscontrol.status import Status

if TYPE_CHECKING:
    from scipy.sparse import csc_array

_FORMS = ("auto", "condensed", "sparse", "stages")

# Up to so many unknown inputs the dense form is the cheaper one: tests/benchmarks/mpc_step.py.
_LARGEST_CONDENSED: dict[type[QPSolver], int] = {DAQPSolver: 2000}
_LARGEST_OF_OTHERS = 600

# A reference is farther than the linear plant holds where its loop comes to rest off by more than
# this part of the size, or errors grow faster, 1/s. Those nearer than the third part of the size
# are not tried. ``python -m tests.benchmarks.reference_distance`` shows runs on both sides.
_OFF, _GROWS, _NEAR = 0.02, 0.5, 0.02

# From so many on the compiled active set along the stages is faster than DAQP, and built sooner.
# It is so below too, by tenths of a millisecond: not worth a compiler's second.
_SMALLEST_STAGES = 200

# Of unknown inputs. Beyond, dense matrices fill gigabytes.
_MOST_CONDENSED = 5000


@dataclass(frozen=True, eq=False)
class MPCStatistics:
    """Counts and iterations of the programs solved since the last reset.

    Attributes
    ----------
    status_count : dict of Status to int
        How often each status came; ``Status.OK`` is a solved program.
    fallback_count : dict of Fallback to int
        How often each fallback was taken.
    iterations : ndarray of int, shape (K,)
        Iterations of the solver in each solve; a fallback for want of a measurement has none.
    """

    status_count: dict[Status, int]
    fallback_count: dict[Fallback, int]
    iterations: np.ndarray

    @property
    def fallbacks(self) -> int:
        """Commands that did not come from a solved program."""
        return sum(self.fallback_count.values())


@dataclass(frozen=True, eq=False, kw_only=True)
class MPCLaw(PredictiveLaw):
    """What a linear MPC solves in a sample, except what it remembers."""

    plant: LinearPlant
    design: Design
    form: Form | None  # None: along the stages

    def solver(self) -> QPSolver | LinearProgram:
        """Return the solver of the programs, as it is before the first solve."""
        if self.form is not None:
            return make_solver(self.settings, self.form)
        made = self.design
        return LinearProgram(
            made.problem, made.constraints.limits, self.settings.max_iterations,
            (made.low, made.high),
        )  # fmt: skip

    def preview(self, time: float) -> Preview:
        """Return the reference over the horizon: the same object while it rests."""
        return self.path.over_horizon(time, self.design.problem.length)

    def stage_data(self, preview: Preview, load: FloatArray | None) -> StageData:
        """Return what is known of the horizon before its start is measured; load: q̈ or None."""
        problem, ramp = self.design.problem, self.design.sampled.ramp
        origin, drift, reference = preview.input[:-1], preview.drift, preview.reference
        effort = np.zeros_like(origin)
        if self.load is not None and load is not None:
            drift = drift + self.load.response @ load
            r = self.plant.degrees_of_freedom
            ends = preview.rest[:-1] if ramp else preview.rest[1:]
            known = (reference - ends)[:, :r] @ self.plant.A[r:, :r].T
            offset, effort = self.load.rest(known + load)
            reference = reference + np.hstack([offset, np.zeros_like(offset)])
        if ramp:
            none = np.zeros_like(origin)
            drift, reference = np.hstack([drift, none]), np.hstack([reference, none])
        row_low, row_high = self.design.constraints.bounds(preview, problem.length)
        return StageData(
            reference=reference,
            input_reference=effort,
            drift=drift,
            low=self.design.low - origin,
            high=self.design.high - origin,
            shift=np.diff(origin, axis=0, prepend=origin[:1]),
            row_low=row_low,
            row_high=row_high,
            origin=origin,
            previous_origin=preview.previous_input,
        )

    def vectors(
        self,
        data: StageData,
        state: FloatArray,
        previous_input: FloatArray,
        previous_within_bounds: FloatArray,
    ) -> Triple:
        """Return q, l and u of the program, from the measured state and what actuators hold."""
        assert self.form is not None  # else a program of its own is solved
        first = self.first_state(data, state, previous_input)
        previous = previous_within_bounds - data.origin[0]
        return self.form.vectors(first, data, previous)

    def inputs(
        self,
        x: FloatArray,
        data: StageData,
        state: FloatArray,
        previous_input: FloatArray,
        samples: int | None = None,
    ) -> FloatArray:
        """Return the inputs that a solution of the program plans, shape (N, α), or the first."""
        assert self.form is not None  # else a program of its own is solved
        first = self.first_state(data, state, previous_input)
        return data.origin[:samples] + self.form.inputs(x, first, data, samples)

    def free_response(
        self, data: StageData, state: FloatArray, previous_input: FloatArray
    ) -> FloatArray:
        """Return the state a sample later, the load but not the input of the sample included."""
        before = previous_input - data.previous_origin
        free = self.design.sampled.free_response(state, before, data.origin[0])
        return free + data.drift[0, : len(state)]

    def first_state(
        self, data: StageData, state: FloatArray, previous_input: FloatArray
    ) -> FloatArray:
        """Return z_0 of the program: ``[z; v_before]`` where inputs are ramps."""
        if not self.design.sampled.ramp:
            return state
        return np.concatenate([state, previous_input - data.previous_origin])


@dataclass(frozen=True, eq=False)
class _Horizon:
    """What stage data make of a condensed program at ``z_0 = 0``, with a previous input of 0."""

    data: StageData
    low: FloatArray  # bounds of the rows
    high: FloatArray
    inputs: FloatArray  # v_0 …, without limits


@final
class Condensed(Form):
    """Only the departures from the LQR law, and violations, are unknown: small and dense.

    With ``v_k = −K z_k + c_k`` and the LQR cost at the end, the Hessian in the
    c_k is block diagonal and the same at each sample (Rossiter, Kouvaritakis &
    Rice 1998, doi:10.1016/S0005-1098(97)00192-5). Measured by its Cholesky
    factor it is the identity, and an ADMM solver needs a few iterations where
    the problem in the v_k takes tens. Measured from the optimum without limits,
    the program asks for the least distance from it that keeps them.
    """

    dense = True

    def __init__(self, problem: MPCProblem) -> None:
        from scipy.linalg import solve_triangular
        from scipy.sparse import block_diag, csc_array, diags_array, hstack, identity

        self._length, self._count = problem.length, problem.input_count
        N, states = problem.length, len(problem.drift)
        scale = problem.cost_scale
        free, forced, drifts = prediction(problem)
        feedback = np.kron(np.eye(N), problem.feedback)
        # v = by_state z_0 + by_choice c + by_drift d: the law sees z_0 … z_{N−1}.
        before = [np.vstack([first, part[:-states]]) for first, part in (
            (np.eye(states), free),
            (np.zeros((states, forced.shape[1])), forced),
            (np.zeros((states, N * states)), drifts),
        )]  # fmt: skip
        by_state, by_choice, by_drift = (-feedback @ part for part in before)
        by_choice += np.eye(len(by_choice))
        weighted = _weigh(problem, forced)
        effort = np.kron(np.eye(N), problem.input_weight) @ by_choice
        hessian = scale * (forced.T @ weighted + by_choice.T @ effort)
        factor = np.linalg.cholesky(0.5 * (hessian + hessian.T))
        # c = unit x, with unitᵀ hessian unit = I.
        unit = solve_triangular(factor, np.eye(len(factor)), lower=True).T
        self._to_inputs = by_choice @ unit
        self._by_state, self._by_drift = by_state, by_drift
        limits = LimitRows(problem)
        self._limits, self._violations = limits, len(limits.price)
        on_choice = limits.on_inputs @ _trimmed(self._to_inputs)
        if problem.rows is not None:
            on_choice = on_choice + limits.on_states @ _trimmed(forced @ unit)
        self.A = csc_array(hstack([on_choice, limits.on_violations]))
        self.P = csc_array(block_diag([identity(len(unit)), diags_array(limits.price)]))
        self._moved_by_state = (
            limits.on_inputs @ by_state + limits.on_states @ free + limits.on_first.toarray()
        )
        self._moved_by_drift = limits.on_inputs @ by_drift + limits.on_states @ drifts
        slope = scale * unit.T
        self._from_reference = -slope @ weighted.T
        self._from_drift = slope @ (weighted.T @ drifts + effort.T @ by_drift)
        self._from_input_reference = -slope @ effort.T
        # The optimum without limits is at x = −(from_state z_0 + …): x is measured from there.
        from_state = slope @ (weighted.T @ free + effort.T @ by_state)
        self._moved_by_state -= on_choice @ from_state
        self._by_state -= self._to_inputs @ from_state
        self._on_choice = on_choice
        self._q = frozen(np.concatenate([np.zeros(self._count), limits.price]))
        self._kept: _Horizon | None = None

    def vectors(self, state: FloatArray, data: StageData, previous: FloatArray) -> Triple:
        """See :meth:`Form.vectors`."""
        known = self._known(data)
        offset = self._moved_by_state @ state
        low, high = known.low - offset, known.high - offset
        first = self._limits.first_change
        if first is not None:
            moved = previous / self._limits.level
            low[first] += moved
            high[first] += moved
        return self._q, low, high

    def inputs(
        self, x: FloatArray, state: FloatArray, data: StageData, samples: int | None = None
    ) -> FloatArray:
        """See :meth:`Form.inputs`."""
        width = self._count // self._length
        taken = slice(None if samples is None else samples * width)
        base = self._by_state[taken] @ state + self._known(data).inputs[taken]
        v = self._to_inputs[taken] @ x[: self._count] + base
        return np.asarray(v.reshape(-1, width))

    def _known(self, data: StageData) -> _Horizon:
        """Return what does not depend on the measured state; kept while the data stay."""
        kept = self._kept
        if kept is None or kept.data is not data:
            drift = data.drift.ravel()
            slope = self._from_reference @ data.reference.ravel() + self._from_drift @ drift
            if data.input_reference.any():
                slope += self._from_input_reference @ data.input_reference.ravel()
            offset = self._moved_by_drift @ drift - self._on_choice @ slope
            low, high = self._limits.bounds(np.zeros(self._count // self._length), data)
            inputs = self._by_drift @ drift - self._to_inputs @ slope
            kept = self._kept = _Horizon(data, low - offset, high - offset, inputs)
        return kept

    def shifted(self, x: FloatArray, y: FloatArray) -> Pair:
        """See :meth:`Form.shifted`."""
        # After the horizon the law is followed as it is.
        N = self._length
        return (
            shifted(x, N, [self._count // N, self._violations // N], repeat=False),
            shifted(y, N, self._limits.widths, repeat=False),
        )


def _weigh(problem: MPCProblem, forced: FloatArray) -> FloatArray:
    blocks = forced.reshape(problem.length, len(problem.drift), -1)
    weighted = np.einsum("ij,kjm->kim", problem.state_weight, blocks)
    weighted[-1] = problem.terminal_weight @ blocks[-1]
    return np.asarray(weighted.reshape(forced.shape))


def _trimmed(matrix: FloatArray) -> csc_array:
    """Return a block triangular matrix without the round-off above its diagonal blocks."""
    from scipy.sparse import csc_array

    return csc_array(np.where(np.abs(matrix) > 1e-14 * np.abs(matrix).max(), matrix, 0.0))


@with_parameters_of(MPCSettings)
@dataclass(frozen=True, eq=False, kw_only=True)
class LinearSettings(MPCSettings):
    """Settings of :class:`MPC`.

    Parameters
    ----------
    form : {"auto", "condensed", "sparse", "stages"}
        Form of the quadratic program. All give the same inputs; "auto" takes the cheapest one by
        size and solver. "stages" has a solver of its own, an active set along the stages of the
        horizon, compiled where there is a compiler, and goes with solver="auto".
    """

    form: str = field(default="auto", metadata=checked(validation.choice, _FORMS))


def form_of(problem: MPCProblem, settings: LinearSettings) -> Form | None:
    """Return the form of a program, None for that along the stages, or raise where it cannot be."""
    count, automatic, form = problem.input_count, settings.solver == "auto", settings.form
    if form == "auto":
        largest = _LARGEST_CONDENSED.get(solver_kind(settings, dense=True), _LARGEST_OF_OTHERS)
        form = "condensed" if count <= largest else "sparse"
        large = count >= _SMALLEST_STAGES
        if automatic and (form == "sparse" or (large and has_compiled_program())):
            form = "stages"
    if form == "stages":
        if not automatic:
            raise ValueError(
                f"form is 'stages', which has a solver of its own, and solver is "
                f"{settings.solver!r}; expected 'auto'"
            )
        return None
    if form == "condensed" and count > _MOST_CONDENSED:
        raise ValueError(
            f"form is 'condensed', which is dense, for {count} unknown inputs; "
            f"expected at most {_MOST_CONDENSED}. Take form='stages'"
        )
    return Condensed(problem) if form == "condensed" else Sparse(problem)


@final
@with_parameters_of(LinearSettings)
class MPC(PredictiveController):
    """Linear model predictive control; no string is ever commanded to push (γ ≥ 0).

    At each sample it predicts the plant over a horizon by the exact zero-order-hold
    discretization, solves a quadratic program, and applies the first input. The terminal cost is
    that of the discrete LQR.

    If the rest length is the input, γ depends on the motion. Its limits are then linear in state
    and input. They are soft, as a disturbance may make a string slack before any winch moves.
    With a reference, the plant is linearized about the rest lengths that hold its shapes. Winches
    that move through a sample (``Winches(substeps=...)``) are predicted as ramps; limits of the
    strings then apply at the ends of samples.

    If the program is not solved, or the structure cannot have the measured shape, the command is
    the next input of the last solution. After its end it is γ of the operating point, or the rest
    lengths that the actuators hold. The status shows both cases, and :attr:`statistics` counts
    them. ``max_change`` counts from the input that the actuators reached (:meth:`applied`).

    Parameters
    ----------
    plant : LinearPlant
        In internal coordinates.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, no string reaches a motion that
        grows or drifts, or the operating point or the reference breaks a hard limit.

    Warns
    -----
    RuntimeWarning
        If γ is commanded but the strings are so stiff that winches, which hold
        rest lengths between samples, would undo it: see :func:`held_loop`. If no string reaches
        a mode that does not decay, naming it: see ``left_alone``.
    ControlWarning
        If a reference is farther than the linear plant holds: on the plant linearized in its last
        shape, the LQR of the program comes to rest more than 2 % of the size off, or lets errors
        grow by a factor e in 2 s or less. If a reference breaks a soft limit.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=300.0)
    >>> pushed = plant.to_nodes(np.r_[0.01, np.zeros(8)])
    >>> command = mpc.command(0.0, pushed, np.zeros((3, 6)))
    >>> str(command), bool((command.value >= 0).all()), command.value.shape
    ('ok', True, (9,))
    """

    _law: MPCLaw

    @from_settings(LinearSettings)
    def __init__(self, plant: LinearPlant, settings: LinearSettings) -> None:
        validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        made = design(plant, settings)
        super().__init__(plant, settings, made)
        self._law = MPCLaw(
            plant=plant,
            settings=settings,
            design=made,
            form=form_of(made.problem, settings),
            load=None if self._observer is None else self._observer.model,
            path=ReferencePreview(plant, settings.reference, made.sampled),
        )
        for text in self._concerns(self._law.path):
            warnings.warn(text, ControlWarning, stacklevel=3)
        self._solver = self._law.solver()
        # The data of a reference that rests, which no sample changes.
        self._resting: tuple[Preview, StageData] | None = None
        self.reset()
        if plant.input == "force_density" and plant.model.strings is not None:
            warn_of_held_lengths(plant, made.problem.feedback, settings.sample_time)

    def _concerns(self, path: ReferencePreview) -> list[str]:
        found = super()._concerns(path)
        # What slack strings do where they are taut is not known.
        if not path.given or len(self.plant.slack):
            return found
        plant, size = self.plant, float(np.ptp(self.plant.nodes, axis=1).max())
        end = path.span[1]
        way = path.nodes_at(np.array([end]))[:, :, 0] - plant.nodes
        if np.linalg.norm(way, axis=0).max() < _NEAR * size:
            return found
        growth, off = law_in_shape(plant, self._law.design, path, end)
        if growth <= _GROWS and off <= _OFF * size:
            return found
        what = f"comes to rest {off:.2g} m off, {100 * off / size:.2g} % of the size"
        if growth > _GROWS:
            what = f"lets errors grow by a factor e in {1 / growth:.2g} s"
        found.append(
            f"the reference at {end:g} s is outside the range of the linear plant: there the "
            "closed loop "
            f"{what}. Linearize nearer to it, or use NMPC"
        )
        return found

    @property
    def law(self) -> MPCLaw:
        """What it computes with, except what it remembers; not for users, and may change."""
        return self._law

    @property
    def form(self) -> str:
        """``"condensed"``, ``"sparse"`` or ``"stages"``."""
        if self._law.form is None:
            return "stages"
        return "condensed" if isinstance(self._law.form, Condensed) else "sparse"

    @property
    def solver(self) -> str:
        """What solves its programs: ``"daqp"``, ``"stages"``, … or the name of a class."""
        if isinstance(self._solver, LinearProgram):
            return self._solver.program.solver_name
        return solver_name(self._solver)

    @property
    def statistics(self) -> MPCStatistics:
        """Counts and iterations of the programs solved since the last reset."""
        iterations = frozen(np.array(self._iterations, dtype=np.int64))
        return MPCStatistics(self.status_count, self.fallback_count, iterations)

    @property
    def plan(self) -> FloatArray:
        """Inputs that the last solved program planned, shape (α, N); empty before the first."""
        return frozen(self._plan.T)

    def reset(self) -> None:
        """See :meth:`PredictiveController.reset`."""
        super().reset()
        # What the last solved program was, and its plan once it is asked for.
        self._solved: tuple[FloatArray, StageData, FloatArray, FloatArray] | None = None
        self._planned: FloatArray | None = None
        self._used = 0
        self._forget_guess()
        self._iterations: list[int] = []
        if not isinstance(self._solver, LinearProgram):
            self._solver.reset()

    def _forget_guess(self) -> None:
        self._guess: Pair | None = None
        if isinstance(self._solver, LinearProgram):
            self._solver.program.forget()

    @property
    def _plan(self) -> FloatArray:
        """Inputs that the last solved program planned, shape (N, α)."""
        if self._planned is None:
            if self._solved is None:
                return np.zeros((0, len(self._low)))
            # Solved to a tolerance: what is left outside the bounds is cut off.
            self._planned = clipped(self._law.inputs(*self._solved), self._low, self._high)
        return self._planned

    def _stage_data(self, time: float) -> StageData:
        """Return the data of this sample: those of the last one where nothing moves."""
        preview = self._law.preview(time)
        if self._observer is not None:
            return self._law.stage_data(preview, self._observer.acceleration)
        if self._resting is None or self._resting[0] is not preview:
            self._resting = preview, self._law.stage_data(preview, None)
        return self._resting[1]

    def _decide(self, time: float, state: FloatArray) -> Command:
        law, observer = self._law, self._observer
        by_input = law.design.sampled.by_input
        deadline = self._called + self._longest_time
        if observer is not None and self._previous_input is not None:
            observer.correct(state, by_input @ self._previous_input)
        data = self._stage_data(time)
        if self._previous_input is None:
            self._previous_input = frozen(data.previous_origin)
        previous = self._previous_input
        free = law.free_response(data, state, previous)
        if observer is not None:
            observer.expect(free)
        within = self._previous_within_bounds
        if isinstance(self._solver, LinearProgram):
            start = law.first_state(data, state, previous)
            found = self._solver.solve(start, data, within, deadline)
            self._iterations.append(found.iterations)
            if found.plan is None:
                return self._continue(found.status)
            self._planned = clipped(found.plan[1][1:], self._low, self._high)
            value = self._planned[0]
        else:
            assert law.form is not None  # as the solver has its program
            vectors = law.vectors(data, state, previous, within)
            answer = self._solver.solve(*vectors, start=self._guess, deadline=deadline)
            self._iterations.append(answer.iterations)
            if answer.x is None or answer.y is None:
                return self._continue(answer.status)
            self._solved, self._planned = (answer.x, data, state, previous), None
            self._guess = law.form.shifted(answer.x, answer.y)
            first = law.inputs(*self._solved, samples=1)[0]
            value = clipped(first, self._low, self._high)
        self._used = 0
        self._predicted = free + by_input @ value
        return Command(value)

    def _fall_back(self, status: Status) -> Command:
        if self._observer is not None:
            self._observer.expect(None)
        return self._continue(status)

    def _continue(self, status: Status) -> Command:
        """Go on without a new plan."""
        self._used += 1
        self._forget_guess()
        if self._used < len(self._plan):
            return Command(self._plan[self._used], status, Fallback.PLAN_CONTINUED)
        return self._hold(status)

    def __repr__(self) -> str:
        return (
            f"MPC({self.plant!r}, horizon {self.horizon}, "
            f"sample time {self.sample_time:g} s, {self.form}, {self.solver})"
        )
