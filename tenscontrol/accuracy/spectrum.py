"""How fast a motion can change: eigenvalues of the state equation at its start."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscontrol.accuracy.case import Case
from tenscontrol.validation import FloatArray

# States up to which all eigenvalues are found; of more, only the largest.
_DENSE = 600


def eigenvalues(case: Case) -> FloatArray:
    """Return eigenvalues of ∂f/∂x at the start with all strings pulling, 1/s, complex.

    All of them, or the six largest where there are many.

    Parameters
    ----------
    case : Case

    Returns
    -------
    ndarray of complex
    """
    equation = case.equation()
    x, u, taut = (
        ca.SX.sym("x", equation.states),
        ca.SX.sym("u", equation.inputs),
        ca.SX.sym("taut", equation.switches),
    )
    jacobian = ca.Function("jacobian", [x, u, taut], [ca.jacobian(equation.slope(x, u, taut), x)])
    matrix = jacobian(case.state, case.value, np.ones(equation.switches))
    if equation.states <= _DENSE:
        return np.asarray(np.linalg.eigvals(matrix.full()))
    from scipy.sparse.linalg import eigs

    return np.asarray(eigs(matrix.sparse().tocsc(), k=6, which="LM", return_eigenvectors=False))


def fastest_rate(case: Case) -> float:
    """Return the largest magnitude of the eigenvalues, 1/s.

    Of an undamped structure that is its highest angular frequency ω. A motion
    without any is given the rate at which it passes its duration.

    Parameters
    ----------
    case : Case

    Returns
    -------
    float
    """
    return max(float(np.abs(eigenvalues(case)).max(initial=0.0)), 1 / case.duration)
