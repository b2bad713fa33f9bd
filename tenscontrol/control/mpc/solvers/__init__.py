"""Solvers of quadratic programs: one file each, behind one interface."""

from tenscontrol.control.mpc.solvers.solver import QPSolution, QPSolver

__all__ = [
    "QPSolution",
    "QPSolver",
]
