"""Solvers of quadratic programs: one file each, behind one interface."""

from tenscontrol.control.mpc.solvers.c_source import active_set_source, stages_source
from tenscontrol.control.mpc.solvers.daqp_adapter import DAQPSolver, least_distance
from tenscontrol.control.mpc.solvers.osqp_adapter import OSQPSolver
from tenscontrol.control.mpc.solvers.piqp_adapter import PIQPSolver
from tenscontrol.control.mpc.solvers.solver import QPSolution, QPSolver

__all__ = [
    "DAQPSolver",
    "OSQPSolver",
    "PIQPSolver",
    "QPSolution",
    "QPSolver",
    "active_set_source",
    "least_distance",
    "stages_source",
]
