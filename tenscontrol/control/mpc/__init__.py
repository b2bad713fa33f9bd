"""Model predictive control, linear and nonlinear."""

from tenscontrol.control.mpc.constraints import OutputLimit, clearance
from tenscontrol.control.mpc.linear import MPC, Condensed, MPCLaw, MPCStatistics
from tenscontrol.control.mpc.nonlinear import CONVERGED, NMPC, NMPCStatistics
from tenscontrol.control.mpc.problem import MPCProblem, StageData, StageJacobians
from tenscontrol.control.mpc.real_time_iteration import NEWTON_STEPS
from tenscontrol.control.mpc.settings import MPCSettings
from tenscontrol.control.mpc.shooting import RK4
from tenscontrol.control.mpc.solvers import (
    DAQPSolver,
    OSQPSolver,
    PIQPSolver,
    QPSolution,
    QPSolver,
    active_set_source,
    stages_source,
)
from tenscontrol.control.mpc.sparse import Sparse
from tenscontrol.control.mpc.stages import STAGES_TOLERANCE, stages_data

__all__ = [
    "CONVERGED",
    "MPC",
    "NEWTON_STEPS",
    "NMPC",
    "RK4",
    "STAGES_TOLERANCE",
    "Condensed",
    "DAQPSolver",
    "MPCLaw",
    "MPCProblem",
    "MPCSettings",
    "MPCStatistics",
    "NMPCStatistics",
    "OSQPSolver",
    "OutputLimit",
    "PIQPSolver",
    "QPSolution",
    "QPSolver",
    "Sparse",
    "StageData",
    "StageJacobians",
    "active_set_source",
    "clearance",
    "stages_data",
    "stages_source",
]
