"""What a linear MPC solves in a sample, as a function of time, state, what stands and the load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.control.disturbance import LoadModel
from tenscontrol.control.mpc.condensed import Condensed, Sparse
from tenscontrol.control.mpc.osqp_adapter import QuadraticProgram
from tenscontrol.control.mpc.problem import Ahead, Course, Form, Horizon
from tenscontrol.control.mpc.settings import Design
from tenscontrol.plant import LinearPlant, ReferencePreview
from tenscontrol.validation import FloatArray, choice

_FORMS = ("auto", "condensed", "sparse")

# Up to so many unknown inputs the dense form is the cheaper one: tests/benchmarks/mpc_step.py.
_LARGEST_CONDENSED = 600

# Beyond so many its dense matrices fill gigabytes.
_MOST_CONDENSED = 5000


@dataclass(frozen=True, eq=False)
class MPCLaw:
    """All that a linear MPC goes by, except what it remembers.

    Attributes
    ----------
    plant : LinearPlant
    sample_time : float
        Sample time, s.
    design : Design
    form : Form
    load : LoadModel or None
        None where no load is estimated.
    tolerance : float
    max_iterations : int
        Of OSQP.
    time_limit : float
        s; inf for none.
    path : ReferencePreview
        What is followed.
    """

    plant: LinearPlant
    sample_time: float
    design: Design
    form: Form
    load: LoadModel | None
    tolerance: float
    max_iterations: int
    time_limit: float
    path: ReferencePreview

    def program(self) -> QuadraticProgram:
        """Return the program, as it is before the first solve."""
        return QuadraticProgram(self.form.P, self.form.A, self.tolerance, self.max_iterations)

    def ahead(self, time: float, load: FloatArray | None) -> Ahead:
        """Return what is known of the horizon before anything is measured at its start.

        Parameters
        ----------
        time : float
            Of the start, s.
        load : ndarray, shape (r,), or None
            Accelerations laid to the load; None where none is estimated.
        """
        problem, ramp = self.design.problem, self.design.sampled.ramp
        preview = self.path.over_horizon(time, problem.length)
        origin, drift, reference = preview.input[:-1], preview.drift, preview.reference
        effort = np.zeros_like(origin)
        if self.load is not None and load is not None:
            drift = drift + self.load.push @ load
            r = self.plant.degrees_of_freedom
            ends = preview.rest[:-1] if ramp else preview.rest[1:]
            known = (reference - ends)[:, :r] @ self.plant.A[r:, :r].T
            offset, effort = self.load.rest(known + load)
            reference = reference + np.hstack([offset, np.zeros_like(offset)])
        if ramp:
            none = np.zeros_like(origin)
            drift, reference = np.hstack([drift, none]), np.hstack([reference, none])
        row_low, row_high = self.design.constraints.bounds(preview, problem.length)
        course = Course(
            drift=drift,
            input_reference=effort,
            low=self.design.low - origin,
            high=self.design.high - origin,
            shift=np.diff(origin, axis=0, prepend=origin[:1]),
            row_low=row_low,
            row_high=row_high,
        )
        return Ahead(preview.previous_input, reference, origin, course)

    def vectors(
        self, ahead: Ahead, state: FloatArray, standing: FloatArray, reachable: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, l and u of the program.

        Parameters
        ----------
        ahead : Ahead
        state : ndarray, shape (s,)
            z as measured.
        standing, reachable : ndarray, shape (α,)
            What the actuators hold, and the same within bounds.
        """
        begun = self._begun(ahead, state, standing)
        previous = reachable - ahead.origin[0]
        return self.form.vectors(begun, ahead.reference, previous, ahead.course)

    def inputs(
        self, x: FloatArray, ahead: Ahead, state: FloatArray, standing: FloatArray
    ) -> FloatArray:
        """Return the inputs that a solution of the program plans, shape (N, α)."""
        begun = self._begun(ahead, state, standing)
        return ahead.origin + self.form.inputs(x, begun, ahead.course)

    def coasting(self, ahead: Ahead, state: FloatArray, standing: FloatArray) -> FloatArray:
        """Return the state a sample later, the load but not the input of the sample included."""
        before = standing - ahead.before
        coasting = self.design.sampled.free_response(state, before, ahead.origin[0])
        return coasting + ahead.course.drift[0, : len(state)]

    def _begun(self, ahead: Ahead, state: FloatArray, standing: FloatArray) -> FloatArray:
        """Return z_0 of the program: ``[z; v_before]`` where winches wind."""
        if not self.design.sampled.ramp:
            return state
        return np.concatenate([state, standing - ahead.before])


def form_of(problem: Horizon, form: str) -> Form:
    """Return a form by its name, or raise where there is none, or it would be too large."""
    if choice("form", form, _FORMS) == "auto":
        form = "condensed" if problem.input_count <= _LARGEST_CONDENSED else "sparse"
    if form == "condensed" and problem.input_count > _MOST_CONDENSED:
        raise ValueError(
            f"form is 'condensed', which is dense, for {problem.input_count} unknown inputs; "
            f"expected at most {_MOST_CONDENSED}. Take form='sparse'"
        )
    return Condensed(problem) if form == "condensed" else Sparse(problem)
