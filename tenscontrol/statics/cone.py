"""The point of a polyhedral set nearest to a target."""

from __future__ import annotations

import numpy as np

from tenscontrol.validation import FloatArray

# In the scaled problem every quantity is of order one; round-off stays far below this.
_TOLERANCE = 1e-9


def nearest_in_cone(
    directions: FloatArray, offset: FloatArray, target: FloatArray
) -> FloatArray | None:
    """Return x that minimizes ``‖D x + o − target‖`` subject to ``D x + o ≥ 0``.

    Parameters
    ----------
    directions : ndarray, shape (m, k)
        D.
    offset, target : ndarray, shape (m,)
        o and the target.

    Returns
    -------
    ndarray, shape (k,), or None
        None if no x is feasible.

    Notes
    -----
    Least distance programming by non-negative least squares (Lawson & Hanson,
    *Solving Least Squares Problems*, chapter 23): exact up to round-off, and
    unique in ``D x``, so that a symmetric structure gets a symmetric answer.
    """
    from scipy.optimize import nnls

    scale = max(float(np.abs(offset).max()), float(np.abs(target).max()))
    offset, target = offset / scale, target / scale
    U, sizes, Vt = np.linalg.svd(directions, full_matrices=False)
    keep = sizes > _TOLERANCE
    U, sizes, Vt = U[:, keep], sizes[keep], Vt[keep]
    free = U.T @ (target - offset)
    best = offset + U @ free
    if best.size == 0 or best.min() >= -_TOLERANCE:
        return np.asarray(scale * (Vt.T @ (free / sizes)))
    # Minimal ‖y‖ with U y ≥ −best, the step from the free optimum.
    matrix = np.vstack([U.T, -best[None, :]])
    goal = np.zeros(len(matrix))
    goal[-1] = 1.0
    multipliers, distance = nnls(matrix, goal)
    if distance < _TOLERANCE:
        return None
    slack = matrix @ multipliers - goal
    step = -slack[:-1] / slack[-1]
    return np.asarray(scale * (Vt.T @ ((free + step) / sizes)))
