"""Least distance programming: the point of a polyhedral set nearest to a target."""

from __future__ import annotations

import numpy as np

from tenscontrol.statics.equilibrium_matrix import null_space
from tenscontrol.validation import FloatArray

# In the scaled problem every quantity is of order one; round-off stays far below this.
_TOLERANCE = 1e-9
_ROUND_OFF = 1e-12


def least_distance(G: FloatArray, h: FloatArray) -> FloatArray | None:
    """Return the y of least norm with ``G y ≥ h``, shape (k,), or None if there is none.

    By non-negative least squares (Lawson & Hanson, *Solving Least Squares
    Problems*, chapter 23): exact up to round-off. G and h are of order one.
    """
    from scipy.optimize import nnls

    matrix = np.vstack([G.T, h[None, :]])
    goal = np.zeros(len(matrix))
    goal[-1] = 1.0
    multipliers, _ = nnls(matrix, goal)
    slack = matrix @ multipliers - goal
    if slack[-1] > -_TOLERANCE:
        return None
    return np.asarray(-slack[:-1] / slack[-1])


def nearest_in_cone(
    directions: FloatArray, offset: FloatArray, target: FloatArray
) -> FloatArray | None:
    """Return x, shape (k,), that minimizes ``‖D x + o − target‖`` subject to ``D x + o ≥ 0``.

    ``D x`` is unique, so that a symmetric structure gets a symmetric answer. None if there is none.
    """
    scale = max(float(np.abs(offset).max()), float(np.abs(target).max()))
    best = _nearest(directions, offset / scale, target / scale)
    return None if best is None else np.asarray(scale * best)


def _nearest(D: FloatArray, offset: FloatArray, target: FloatArray) -> FloatArray | None:
    """Solve the problem scaled to order one."""
    # Round-off must not look like an equation.
    D, offset = (np.where(np.abs(part) > _ROUND_OFF, part, 0.0) for part in (D, offset))
    best = _least_squares(D, target - offset)
    if (offset + D @ best >= -_TOLERANCE).all():
        return best
    free = _can_be_positive(D, offset)
    if free is None:
        return None
    if not free.all():
        # Entries that are zero everywhere become equations: what is left has an interior.
        start = _least_squares(D[~free], -offset[~free])
        if np.abs(offset[~free] + D[~free] @ start).max() > _TOLERANCE:
            return None
        along = null_space(D[~free])
        moved = offset + D @ start
        rest = _nearest(D[free] @ along, moved[free], target[free])
        return None if rest is None else np.asarray(start + along @ rest)
    # The feasible set has an interior.
    U, sizes, Vt = np.linalg.svd(D, full_matrices=False)
    keep = sizes > _TOLERANCE
    U, sizes, Vt = U[:, keep], sizes[keep], Vt[keep]
    best = U.T @ (target - offset)
    step = least_distance(U, -(offset + U @ best))  # from the optimum without bounds
    return None if step is None else np.asarray(Vt.T @ ((best + step) / sizes))


def _can_be_positive(D: FloatArray, offset: FloatArray) -> np.ndarray | None:
    """Return which entries of ``D x + o`` can be positive, or None if the set is empty."""
    from scipy.optimize import linprog

    # The most entries of at least 1 in the cone over the set.
    m, k = D.shape
    answer = linprog(
        c=np.concatenate([np.zeros(k + 1), -np.ones(m)]),
        A_ub=np.hstack([-D, -offset[:, None], np.eye(m)]),
        b_ub=np.zeros(m),
        bounds=[(None, None)] * k + [(1, None)] + [(0, 1)] * m,
        method="highs",
    )
    if answer.status == 2:
        return None
    if answer.status != 0:
        raise ArithmeticError(f"the linear program of the prestress failed: {answer.message}")
    return np.asarray(answer.x[k + 1 :] > 0.5)


def _least_squares(A: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(A, b, rcond=_TOLERANCE)[0])
