"""Model predictive control, linear and nonlinear."""

from tenscontrol.control.mpc.constraints import OutputLimit, buckling, clearance
from tenscontrol.control.mpc.linear import MPC, MPCStatistics
from tenscontrol.control.mpc.nonlinear import NMPC, NMPCStatistics
from tenscontrol.control.mpc.qp_solver import QPSolution, QPSolver
from tenscontrol.control.mpc.settings import MPCSettings
from tenscontrol.control.mpc.sparse import QuadraticProgram

__all__ = [
    "MPC",
    "NMPC",
    "MPCSettings",
    "MPCStatistics",
    "NMPCStatistics",
    "OutputLimit",
    "QPSolution",
    "QPSolver",
    "QuadraticProgram",
    "buckling",
    "clearance",
]
