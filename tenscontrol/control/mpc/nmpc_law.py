"""What a nonlinear MPC goes by: its model, its program and its reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.control.disturbance import LoadModel
from tenscontrol.control.mpc.problem import Horizon
from tenscontrol.control.mpc.sparse import TrajectoryProgram
from tenscontrol.control.mpc.trajectory_model import TrajectoryModel
from tenscontrol.plant import ReferencePreview
from tenscontrol.validation import FloatArray


@dataclass(frozen=True, eq=False)
class NMPCLaw:
    """All that a nonlinear MPC goes by, except what it remembers.

    Attributes
    ----------
    sample_time : float
        Sample time, s.
    model : TrajectoryModel
    problem : Horizon
        Its rows are those of the model.
    bounds, row_bounds : tuple of ndarray
        Least and largest inputs, shape (α,) each, and limited rows, shape (p,) each.
    units : ndarray, shape (s,)
        Units of the state.
    load : LoadModel or None
        None where no load is estimated.
    rounds : int
        Programs solved in a sample at most.
    tolerance : float
    max_iterations : int
        Of OSQP.
    time_limit : float
        s; inf for none.
    path : ReferencePreview
        What is followed.
    """

    sample_time: float
    model: TrajectoryModel
    problem: Horizon
    bounds: tuple[FloatArray, FloatArray]
    row_bounds: tuple[FloatArray, FloatArray]
    units: FloatArray
    load: LoadModel | None
    rounds: int
    tolerance: float
    max_iterations: int
    time_limit: float
    path: ReferencePreview

    def program(self) -> TrajectoryProgram:
        """Return the program, as it is before the first solve."""
        return TrajectoryProgram(
            self.problem,
            self.bounds,
            self.row_bounds,
            self.units,
            self.tolerance,
            self.max_iterations,
            even=not self.model.implicit,
        )

    def targets(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return r_1 … r_N, shape (N, s), and s_0 … s_{N−1}, shape (N, α), without a load.

        Parameters
        ----------
        time : float
            Of the sample that starts now, s.
        """
        times = time + self.sample_time * np.arange(self.problem.length + 1.0)
        return self.path.aims(times, self.model.motion.ramp)

    def start(self, time: float, origin: FloatArray) -> FloatArray:
        """Return what stands before the first command, where nothing else is known, shape (α,).

        Parameters
        ----------
        time : float
            Of the sample that starts now, s.
        origin : ndarray, shape (N, α)
            s_0 … s_{N−1}; winches that wind reach s_0 at its end only.
        """
        ramp = self.model.motion.ramp
        return np.asarray(self.path.at(np.array([time])).input[0] if ramp else origin[0])
