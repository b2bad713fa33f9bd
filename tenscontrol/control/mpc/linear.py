"""Linear model predictive control of strings that cannot push."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Unpack, final

import numpy as np

from tenscontrol.control.controller import Command, Controller
from tenscontrol.control.disturbance import LoadModel, load_observer
from tenscontrol.control.held_loop import warn_of_held_lengths
from tenscontrol.control.mpc.condensed import Condensed
from tenscontrol.control.mpc.problem import Form, MPCProblem, QPSolver, StageData
from tenscontrol.control.mpc.settings import Design, MPCSettings, SettingsKeywords, design
from tenscontrol.control.mpc.sparse import Sparse
from tenscontrol.control.status import Fallback, Status
from tenscontrol.plant import LinearPlant, ReferencePreview, acceleration_response
from tenscontrol.validation import FloatArray, choice, frozen, instance

_FORMS = ("auto", "condensed", "sparse")

# Up to so many unknown inputs the dense form is the cheaper one: tests/benchmarks/mpc_step.py.
_LARGEST_CONDENSED = 600

# Beyond so many its dense matrices fill gigabytes.
_MOST_CONDENSED = 5000


@dataclass(frozen=True, eq=False)
class MPCStatistics:
    """What became of the solves since the last reset.

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


@dataclass(frozen=True, eq=False)
class MPCLaw:
    """What a linear MPC solves in a sample, except what it remembers.

    Attributes
    ----------
    plant : LinearPlant
    settings : MPCSettings
    design : Design
    form : Form
    load : LoadModel or None
        None where no load is estimated.
    path : ReferencePreview
        What is followed.
    """

    plant: LinearPlant
    settings: MPCSettings
    design: Design
    form: Form
    load: LoadModel | None
    path: ReferencePreview

    def solver(self) -> QPSolver:
        """Return the solver of the programs, as it is before the first solve."""
        return self.settings.make_solver(self.form)

    def stage_data(self, time: float, load: FloatArray | None) -> StageData:
        """Return what is known of the horizon before anything is measured at its start, at a time.

        The load is accelerations, shape (r,); None where none is estimated.
        """
        problem, ramp = self.design.problem, self.design.sampled.ramp
        preview = self.path.over_horizon(time, problem.length)
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
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, l and u of the program, from the measured state and what actuators hold."""
        first = self._first_state(data, state, previous_input)
        previous = previous_within_bounds - data.origin[0]
        return self.form.vectors(first, data, previous)

    def inputs(
        self, x: FloatArray, data: StageData, state: FloatArray, previous_input: FloatArray
    ) -> FloatArray:
        """Return the inputs that a solution of the program plans, shape (N, α)."""
        first = self._first_state(data, state, previous_input)
        return data.origin + self.form.inputs(x, first, data)

    def free_response(
        self, data: StageData, state: FloatArray, previous_input: FloatArray
    ) -> FloatArray:
        """Return the state a sample later, the load but not the input of the sample included."""
        before = previous_input - data.previous_origin
        free = self.design.sampled.free_response(state, before, data.origin[0])
        return free + data.drift[0, : len(state)]

    def _first_state(
        self, data: StageData, state: FloatArray, previous_input: FloatArray
    ) -> FloatArray:
        """Return z_0 of the program: ``[z; v_before]`` where inputs are ramps."""
        if not self.design.sampled.ramp:
            return state
        return np.concatenate([state, previous_input - data.previous_origin])


def form_of(problem: MPCProblem, form: str) -> Form:
    """Return a form by its name, or raise where there is none, or it would be too large."""
    if choice("form", form, _FORMS) == "auto":
        form = "condensed" if problem.input_count <= _LARGEST_CONDENSED else "sparse"
    if form == "condensed" and problem.input_count > _MOST_CONDENSED:
        raise ValueError(
            f"form is 'condensed', which is dense, for {problem.input_count} unknown inputs; "
            f"expected at most {_MOST_CONDENSED}. Take form='sparse'"
        )
    return Condensed(problem) if form == "condensed" else Sparse(problem)


@final
class MPC(Controller):
    """Model predictive control with γ ≥ 0, whatever else.

    At each sample the plant is predicted over a horizon by its exact
    zero-order-hold discretization, a quadratic program is solved, and
    the first input is applied. The terminal cost is that of the discrete LQR.

    Where the plant's input is the rest length, γ moves with the structure: its
    limits are linear in state and input, and soft, since a push may slacken a
    string before any winch moves. Along a reference, rest lengths start from
    those that hold its shapes, and the plant's dynamics are taken about them. Winches
    that move through samples (``Winches(substeps=...)``) are predicted as they do: about
    the motion of the reference, with limits of strings at the ends of samples.

    If a program is not solved, or the measurement is not one that the structure can
    have, the command is the next input of the last plan; when that is used up, γ of
    the operating point, or the rest lengths that the actuators hold. Either is counted
    (:attr:`statistics`) and shows in the status. Changes are limited from what the
    actuators hold (:meth:`applied`), and the next solved program makes a new plan.

    Parameters
    ----------
    plant : LinearPlant
        In internal coordinates.
    form : {"auto", "condensed", "sparse"}
        How the program is written. Both give the same inputs; "auto" takes the
        cheaper one by size.
    **settings
        Horizon and sample time, and bounds, weights, limits and solver, as keyword arguments of
        :class:`MPCSettings`.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, or the plant has a
        pole that no string reaches.

    Warns
    -----
    RuntimeWarning
        If γ is commanded but the strings are so stiff that winches, which hold
        rest lengths between samples, would undo it: see :func:`held_loop`.

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

    def __init__(
        self, plant: LinearPlant, *, form: str = "auto", **settings: Unpack[SettingsKeywords]
    ) -> None:
        instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        given = MPCSettings(**settings)
        made, sample_time = design(plant, given), given.sample_time
        super().__init__(plant, sample_time, made.low, made.high, made.problem.change)
        observer = None
        if given.load_gain is not None:
            response = acceleration_response(plant, sample_time)
            observer = load_observer(plant, response, given.load_gain, given.tracked)
        self._observer = observer
        self._law = MPCLaw(
            plant=plant,
            settings=given,
            design=made,
            form=form_of(made.problem, form),
            load=None if observer is None else observer.model,
            path=ReferencePreview(plant, given.reference, made.sampled),
        )
        self._solver, self._longest_time = self._law.solver(), given.longest_time
        self.reset()
        if plant.input == "force_density" and plant.model.strings is not None:
            warn_of_held_lengths(plant, made.problem.feedback, sample_time)

    @property
    def law(self) -> MPCLaw:
        """What it computes with, except what it remembers; not for users, and may change."""
        return self._law

    @property
    def form(self) -> str:
        """``"condensed"`` or ``"sparse"``."""
        return "condensed" if isinstance(self._law.form, Condensed) else "sparse"

    @property
    def statistics(self) -> MPCStatistics:
        """What became of the solves since the last reset."""
        iterations = frozen(np.array(self._iterations, dtype=np.int64))
        return MPCStatistics(self.status_count, self.fallback_count, iterations)

    @property
    def plan(self) -> FloatArray:
        """Inputs that the last solved program planned, shape (α, N); empty before the first."""
        return frozen(self._plan.T)

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
        settings = replace(self._law.settings, reference=reference)
        path = self._law.path.following(reference)
        self._law = replace(self._law, settings=settings, path=path)

    def reset(self) -> None:
        """Forget the last plan, the previous input, the estimated load and the statistics."""
        self._plan = np.zeros((0, len(self._low)))
        self._used = 0
        self._guess: tuple[FloatArray, FloatArray] | None = None
        super().reset()
        self._iterations: list[int] = []
        self._solver.reset()
        if self._observer is not None:
            self._observer.reset()

    def take_over(self, command: FloatArray) -> None:
        """See :meth:`Controller.take_over`."""
        super().take_over(command)
        self._plan, self._used, self._guess = self._plan[:0], 0, None
        if self._observer is not None:
            self._observer.expect(None)

    def _decide(self, time: float, state: FloatArray) -> Command:
        law, observer = self._law, self._observer
        deadline = self._called + self._longest_time
        if observer is not None and self._previous_input is not None:
            observer.correct(state, law.design.sampled.by_input @ self._previous_input)
        data = law.stage_data(time, None if observer is None else observer.acceleration)
        if self._previous_input is None:
            self._previous_input = frozen(data.previous_origin)
        previous = self._previous_input
        if observer is not None:
            observer.expect(law.free_response(data, state, previous))
        vectors = law.vectors(data, state, previous, self._previous_within_bounds)
        answer = self._solver.solve(*vectors, start=self._guess, deadline=deadline)
        self._iterations.append(answer.iterations)
        if answer.x is None or answer.y is None:
            return self._continue(answer.status)
        # Solved to a tolerance: what is left outside the bounds is cut off.
        inputs = law.inputs(answer.x, data, state, previous)
        self._plan = np.clip(inputs, self._low, self._high)
        self._used = 0
        self._guess = law.form.shifted(answer.x, answer.y)
        return Command(self._plan[0])

    def _fall_back(self, status: Status) -> Command:
        if self._observer is not None:
            self._observer.expect(None)
        return self._continue(status)

    def _continue(self, status: Status) -> Command:
        """Go on without a new plan."""
        self._used += 1
        self._guess = None
        if self._used < len(self._plan):
            return Command(self._plan[self._used], status, Fallback.PLAN_CONTINUED)
        return self._hold(status)

    def __repr__(self) -> str:
        return (
            f"MPC({self.plant!r}, horizon {self._law.design.problem.length}, "
            f"sample time {self.sample_time:g} s, {self.form})"
        )
