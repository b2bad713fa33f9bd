"""Model predictive control, linear and nonlinear."""

from tenscontrol.control.mpc.constraints import OutputLimit, clearance
from tenscontrol.control.mpc.linear import MPC, MPCStatistics
from tenscontrol.control.mpc.nonlinear import NMPC, NMPCStatistics
from tenscontrol.control.mpc.osqp_adapter import OSQPSolver
from tenscontrol.control.mpc.problem import QPSolution, QPSolver
from tenscontrol.control.mpc.settings import MPCSettings

__all__ = [
    "MPC",
    "NMPC",
    "MPCSettings",
    "MPCStatistics",
    "NMPCStatistics",
    "OSQPSolver",
    "OutputLimit",
    "QPSolution",
    "QPSolver",
    "clearance",
]
