"""What a generated controller is made of, whatever its law."""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from tenscontrol.control.mpc import OSQPSolver, QPSolver
from tenscontrol.validation import FloatArray


@dataclass(frozen=True, eq=False)
class Parts:
    """What one law adds to the code that all share.

    Attributes
    ----------
    templates : tuple of str
        C files of the package that hold the law.
    constants : dict of str to int or float
        Names of the preprocessor.
    arrays : dict of str to ndarray
        Constants of one or two dimensions.
    matrices : dict of str to ndarray
        Constants that are multiplied with, without their zeros.
    program : OSQPSolver or None
        The program to be solved, as it is before the first solve.
    table : tuple of int and ndarray, shape (K, m), or None
        Number of the first sample, and what depends on time alone, a row a sample.
    functions : dict of str to casadi.Function
        What CasADi writes as C code beside the measurement.
    """

    templates: tuple[str, ...]
    constants: dict[str, int | float]
    arrays: dict[str, np.ndarray]
    matrices: dict[str, FloatArray]
    program: OSQPSolver | None = None
    table: tuple[int, FloatArray] | None = None
    functions: dict[str, ca.Function] = field(default_factory=dict)


def refuse_time_limit(limit: float) -> None:
    """Raise ValueError if a controller has a limit of time, s: C99 has no clock for it."""
    if np.isfinite(limit):
        raise ValueError(
            f"controller has time_limit={limit:g} s, and C code without an operating system has no "
            "clock: make it without, and limit the work by max_iterations"
        )


def osqp_program(solver: QPSolver) -> OSQPSolver:
    """Return the solver of a controller, or raise ValueError where C code cannot be written."""
    if not isinstance(solver, OSQPSolver):
        raise ValueError(
            f"controller solves its programs by {type(solver).__name__}, and C code is written for "
            "OSQP: make it with solver='osqp'"
        )
    return solver
