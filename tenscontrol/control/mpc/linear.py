"""Linear model predictive control with γ ≥ 0."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.command import Command, ControlWarning, Fallback
from tenscontrol.control.controller import clipped
from tenscontrol.control.disturbance import LoadObserver
from tenscontrol.control.held_loop import warn_of_held_lengths
from tenscontrol.control.mpc.problem import LinearProgram, StageData
from tenscontrol.control.mpc.settings import (
    Design,
    MPCSettings,
    PredictiveController,
    PredictiveLaw,
    design,
    from_settings,
    law_in_shape,
    make_solver,
    uses_stages,
)
from tenscontrol.control.mpc.sparse import QuadraticProgram, Sparse, SparseProgram
from tenscontrol.control.mpc.stages import StagesProgram
from tenscontrol.docstrings import with_parameters_of
from tenscontrol.plant.controllability import pushed_one_way
from tenscontrol.plant.linear_plant import LinearPlant, state_units
from tenscontrol.plant.reference import Preview, ReferencePreview
from tenscontrol.plant.riccati import horizon_radius
from tenscontrol.short_repr import short_repr
from tenscontrol.status import Status
from tenscontrol.tables import percent
from tenscontrol.warn import warn

# A reference is farther than the linear plant holds where its loop comes to rest off by more than
# this part of the size, or errors grow faster, 1/s. Those nearer than the third part of the size
# are not tried. ``python -m tests.benchmarks.reference_distance`` shows runs on both sides.
_OFF, _GROWS, _NEAR = 0.02, 0.5, 0.02

# A loop decays where its spectral radius is below 1 by this. Where some inputs go one way only, it
# is run from so many starts for so many samples, with inputs of this part of their unit.
_DECAYS, _STARTS, _SAMPLES, _NEXT_TO = 1e-9, 4, 200, 1e-3

# Inputs named in a warning.
_LISTED = 3


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

    __repr__ = short_repr

    @property
    def fallbacks(self) -> int:
        """Commands that did not come from a solved program."""
        return sum(self.fallback_count.values())


@dataclass(frozen=True, eq=False, kw_only=True)
class MPCLaw(PredictiveLaw):
    """What a linear MPC solves in a sample, except what it remembers."""

    plant: LinearPlant
    design: Design

    def program(self) -> LinearProgram:
        """Return the program with its solver, as it is before the first solve."""
        settings, designed = self.settings, self.design
        if uses_stages(settings):
            limits, bounds = designed.constraints.limits, (designed.low, designed.high)
            return StagesProgram(designed.problem, limits, settings.max_iterations, bounds)
        form = Sparse(designed.problem)
        return SparseProgram(form, make_solver(settings, form))

    def preview(self, time: float) -> Preview:
        """Return the reference over the horizon: the same object while it rests."""
        return self.path.over_horizon(time, self.design.problem.length)

    def stage_data(self, preview: Preview, load: FloatArray | None) -> StageData:
        """Return what is known of the horizon before its start is measured; load: q̈ or None."""
        problem, ramp = self.design.problem, self.design.sampled.ramp
        origin, drift, reference = preview.input[:-1], preview.drift, preview.reference
        effort, start = np.zeros_like(origin), preview.start
        if self.load is not None and load is not None:
            drift = drift + self.load.response @ load
            r = self.plant.degrees_of_freedom
            ends = preview.rest[:-1] if ramp else preview.rest[1:]
            whole = np.vstack([start, reference])
            known = (whole - np.vstack([preview.rest[:1], ends]))[:, :r] @ self.plant.A[r:, :r].T
            offset, effort = self.load.rest(known + load)
            whole = whole + np.hstack([offset, np.zeros_like(offset)])
            start, reference, effort = whole[0], whole[1:], effort[1:]
        if ramp:
            none = np.zeros_like(origin)
            drift, reference = np.hstack([drift, none]), np.hstack([reference, none])
            start = np.concatenate([start, none[0]])
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
            first_reference=start,
        )

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


def warn_of_loop(plant: LinearPlant, settings: MPCSettings, designed: Design) -> None:
    """Warn where the loop of a horizon does not hold the linear plant, within bounds, near rest."""
    pole = pushed_one_way(plant, designed.low, designed.high)
    if pole is not None:
        motion = "drifts" if pole == 0 else f"grows by a factor e in {1 / pole:.2g} s"
        warn(
            f"inputs at a bound push a motion that {motion} one way only, so no law can hold the "
            "linear plant in this shape: tighten slack strings, drive strings that pull the other "
            "way, or choose another shape",
            ControlWarning,
        )
    elif designed.proven:
        return
    elif designed.free.all():
        problem = designed.problem
        radius = horizon_radius(
            plant, problem.transition, problem.input_matrix, problem.state_weight,
            problem.input_weight, problem.terminal_weight, problem.length, problem.cross_weight,
        )  # fmt: skip
        if radius > 1 - _DECAYS:
            warn(
                f"a horizon of {problem.length} samples with this terminal_weight does not hold "
                f"the linear plant: the spectral radius of its loop is {radius:.6g} a sample, "
                "expected less than 1. Take a longer horizon, or leave terminal_weight out",
                ControlWarning,
            )
    elif _leaves(plant, settings, designed):
        names = [plant.input_names[i] for i in np.flatnonzero(~designed.free)]
        more = ", …" if len(names) > _LISTED else ""
        warn(
            f"a horizon of {designed.problem.length} samples does not hold the linear plant: from "
            f"starts next to the operating point its loop is farther off {_SAMPLES} samples later. "
            f"{', '.join(names[:_LISTED])}{more} can go one way only there. Take a longer horizon, "
            "tighten slack strings, or drive others",
            ControlWarning,
        )


def _leaves(plant: LinearPlant, settings: MPCSettings, designed: Design) -> bool:
    """Return whether the loop on the linear plant ends farther from rest than it starts.

    Starts are random, and so near that only bounds that the operating point is at are felt. What
    is far is said by the cost to go of the LQR.
    """
    settings = replace(
        settings, reference=None, load_gain=None, tracked=None, time_limit=None, tolerance=1e-9
    )
    path = ReferencePreview(plant, None, designed.sampled)
    law = MPCLaw(plant=plant, settings=settings, design=designed, load=None, path=path)
    program, data, problem = law.program(), law.stage_data(law.preview(0.0), None), designed.problem
    random, (units, _) = np.random.default_rng(0), state_units(plant)
    for _ in range(_STARTS):
        state, previous = units * random.normal(size=len(units)), data.previous_origin
        wanted = problem.feedback[:, : len(state)] @ state
        state *= _NEXT_TO * problem.level / max(float(np.abs(wanted).max()), 1e-300)
        costs = []
        for _ in range(_SAMPLES):
            first = law.first_state(data, state, previous)
            costs.append(float(first @ designed.regulator_cost @ first))
            answer = program.solve(first, data, previous, np.inf)
            if answer.input is None:
                return True
            value = clipped(answer.input, designed.low, designed.high)
            free = law.free_response(data, state, previous)
            state, previous = free + designed.sampled.by_input @ value, value
        if costs[-1] > costs[0]:
            return True
    return False


@final
@with_parameters_of(MPCSettings)
class MPC(PredictiveController):
    """Linear model predictive control; no string is ever commanded to push (γ ≥ 0).

    At each sample it predicts the plant over a horizon by the exact zero-order-hold
    discretization, solves a quadratic program, and applies the first input. The terminal cost is
    that of the discrete LQR, if no other is given: of inputs that can go both ways at the operating
    point, where these hold the plant alone, so that the loop comes to rest with any horizon.

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
        If the loop on the linear plant does not come to rest: inputs at a bound push a motion that
        grows or drifts one way only, or the horizon is too short.
        If a reference is farther than the linear plant holds: on the plant linearized in its last
        shape, the LQR of the program comes to rest more than 2 % of the size off, or lets errors
        grow by a factor e in 2 s or less. If a reference breaks a soft limit.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=300.0)
    >>> pushed = plant.to_nodes(np.r_[0.01, np.zeros(8)])
    >>> command = mpc.command(0.0, pushed, np.zeros((3, 6)))
    >>> str(command), bool((command.value >= 0).all()), command.value.shape
    ('ok', True, (9,))
    """

    _law: MPCLaw

    @from_settings(MPCSettings)
    def __init__(self, plant: LinearPlant, settings: MPCSettings) -> None:
        validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        designed = design(plant, settings)
        super().__init__(plant, settings, designed)
        self._law = MPCLaw(
            plant=plant,
            settings=settings,
            design=designed,
            load=None if self._observer is None else self._observer.model,
            path=ReferencePreview(plant, settings.reference, designed.sampled),
        )
        for text in self._concerns(self._law.path):
            warn(text, ControlWarning)
        warn_of_loop(plant, settings, designed)
        self._program = self._law.program()
        self._sparse: Sparse | None = None  # for other solvers, once it is asked for
        # The data of a reference that rests, which no sample changes.
        self._resting: tuple[Preview, StageData] | None = None
        self.reset()
        converts = plant.input == "force_density" and plant.model.strings is not None
        if converts and plant.actuation.is_whole:
            warn_of_held_lengths(plant, designed.problem.feedback, settings.sample_time)

    def _concerns(self, path: ReferencePreview) -> list[str]:
        concerns = super()._concerns(path)
        # What slack strings do where they are taut is not known.
        if not path.given or len(self.plant.slack) or self.plant.drives_bars:
            return concerns
        plant, size = self.plant, float(np.ptp(self.plant.nodes, axis=1).max())
        end = path.span[1]
        way = path.nodes_at(np.array([end]))[:, :, 0] - plant.nodes
        if np.linalg.norm(way, axis=0).max() < _NEAR * size:
            return concerns
        growth, off = law_in_shape(plant, self._law.design, path, end)
        if growth <= _GROWS and off <= _OFF * size:
            return concerns
        failure = f"comes to rest {off:.2g} m off, {percent(off / size)} of the size"
        if growth > _GROWS:
            failure = f"lets errors grow by a factor e in {1 / growth:.2g} s"
        concerns.append(
            f"the reference at {end:g} s is outside the range of the linear plant: there the "
            "closed loop "
            f"{failure}. Linearize nearer to it, or use NMPC"
        )
        return concerns

    @property
    def law(self) -> MPCLaw:
        """What it computes with, except what it remembers; not for users, and may change."""
        return self._law

    @property
    def solver(self) -> str:
        """What solves its programs: ``"stages"``, ``"osqp"``, or the name of a class."""
        return self._program.solver_name

    @property
    def statistics(self) -> MPCStatistics:
        """Counts and iterations of the programs solved since the last reset."""
        iterations = frozen(np.array(self._iterations, dtype=np.int64))
        return MPCStatistics(self.status_count, self.fallback_count, iterations)

    @property
    def plan(self) -> FloatArray:
        """Inputs that the last solved program planned, shape (α, N); empty before the first."""
        return frozen(self._planned.T)

    @property
    def _planned(self) -> FloatArray:
        # Solved to a tolerance: what is left outside the bounds is cut off.
        plan = self._program.plan
        return clipped(plan, self._low, self._high) if len(plan) else np.zeros((0, len(self._low)))

    def reset(self) -> None:
        """See :meth:`PredictiveController.reset`."""
        super().reset()
        self._program.reset()
        self._used = 0
        self._iterations: list[int] = []

    def _stage_data(self, time: float, observer: LoadObserver | None) -> StageData:
        """Return the data of this sample: those of the last one where nothing moves."""
        preview = self._law.preview(time)
        if observer is not None:
            return self._law.stage_data(preview, observer.acceleration)
        if self._resting is None or self._resting[0] is not preview:
            self._resting = preview, self._law.stage_data(preview, None)
        return self._resting[1]

    def program(self, time: float, nodes: object, velocities: object) -> QuadraticProgram:
        """Return the quadratic program of the sample that starts now, for another solver.

        It is the one that :meth:`command` would solve; nothing is commanded or remembered.

        Parameters
        ----------
        time : float
            s.
        nodes, velocities : array_like, shape (d, n)
            Measured motion, m and m/s.

        Returns
        -------
        QuadraticProgram
            P, q, A, l, u, with the states as unknowns, and ``inputs(x)`` of a solution x.

        Raises
        ------
        TypeError, ValueError
            If an argument does not fit or is not finite.

        Examples
        --------
        >>> import numpy as np, tenscontrol as tc
        >>> prism = tc.prism()
        >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
        >>> mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=300.0)
        >>> program = mpc.program(0.0, prism.nodes, np.zeros((3, 6)))
        >>> program.P.shape, program.A.shape
        ((540, 540), (540, 540))
        """
        time = validation.number("time", time, "s")
        state = self.plant.measure(nodes, velocities)
        data, previous, first = self._sample(time, state, copy.copy(self._observer))
        if self._sparse is None:
            self._sparse = Sparse(self._law.design.problem)
        within = clipped(previous, self._low, self._high)
        return self._sparse.program(first, data, within)

    def _sample(
        self, time: float, state: FloatArray, observer: LoadObserver | None
    ) -> tuple[StageData, FloatArray, FloatArray]:
        """Return data, previous input and z_0 of a sample; the observer learns from the state."""
        law, previous = self._law, self._previous_input
        if observer is not None and previous is not None:
            observer.correct(state, law.design.sampled.by_input @ previous)
        data = self._stage_data(time, observer)
        if previous is None:
            previous = data.previous_origin
        return data, previous, law.first_state(data, state, previous)

    def _decide(self, time: float, state: FloatArray) -> Command:
        law, observer = self._law, self._observer
        deadline = self._called + self._longest_time
        data, previous, first = self._sample(time, state, observer)
        free = law.free_response(data, state, previous)
        if observer is not None:
            observer.expect(free)
        if self._previous_input is None:
            self._previous_input = frozen(previous)
        within = clipped(previous, self._low, self._high)
        answer = self._program.solve(first, data, within, deadline)
        self._iterations.append(answer.iterations)
        if answer.input is None:
            return self._continue(answer.status)
        self._used = 0
        value = clipped(answer.input, self._low, self._high)
        self._predicted = free + law.design.sampled.by_input @ value
        return Command(value)

    def _fall_back(self, status: Status) -> Command:
        if self._observer is not None:
            self._observer.expect(None)
        return self._continue(status)

    def _continue(self, status: Status) -> Command:
        """Go on without a new plan."""
        self._used += 1
        self._program.forget()
        if self._used < len(planned := self._planned):
            return Command(planned[self._used], status, Fallback.PLAN_CONTINUED)
        return self._hold(status)

    def __repr__(self) -> str:
        return (
            f"MPC({self.plant!r}, horizon {self.horizon}, "
            f"sample time {self.sample_time:g} s, {self.solver})"
        )
