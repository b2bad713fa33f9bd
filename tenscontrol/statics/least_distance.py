"""Least distance programming: the point of a polyhedral set nearest to a target."""

from __future__ import annotations

import numpy as np

from tenscontrol.statics.equilibrium_matrix import null_space
from tenscontrol.validation import FloatArray

# In the scaled problem every quantity is of order one; round-off stays far below this.
_TOLERANCE = 1e-9
_ROUND_OFF = 1e-12

# A bound above this many lower bounds and offsets is none.
_NO_BOUND = 1e9


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


def nearest_between(
    directions: FloatArray,
    offset: FloatArray,
    target: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> FloatArray | None:
    """Return x, shape (k,), that minimizes ``‖D x + o − target‖``, ``lower ≤ D x + o ≤ upper``.

    ``D x`` is unique, so that a symmetric structure gets a symmetric answer. None if there is none.
    """
    scale = max(float(np.abs(part).max(initial=0.0)) for part in (offset, target, lower)) or 1.0
    off, rows, limits = (offset - target) / scale, directions, (offset - lower) / scale
    capped = np.zeros(len(offset), bool)
    while True:
        best = _nearest(directions, off, rows, limits)
        if best is None:
            return None
        best = scale * best
        over = offset + directions @ best - upper
        beyond = ~capped & (over > _TOLERANCE * scale)
        if not beyond.any():
            return best
        # Upper bounds take part once they are passed.
        capped |= beyond
        rows = np.vstack([rows, -directions[beyond]])
        limits = np.concatenate([limits, (upper - offset)[beyond] / scale])


def _nearest(D: FloatArray, off: FloatArray, C: FloatArray, c: FloatArray) -> FloatArray | None:
    """Minimize ``‖D x + off‖`` subject to ``C x + c ≥ 0``, scaled to order one; C has rows ±D."""
    # Round-off must not look like an equation.
    D, off, C, c = (np.where(np.abs(part) > _ROUND_OFF, part, 0.0) for part in (D, off, C, c))
    best = _least_squares(D, -off)
    if (c + C @ best >= -_TOLERANCE).all():
        return best
    free = can_be_positive(C, c)
    if free is None:
        return None
    if not free.all():
        # Entries that are zero everywhere become equations: what is left has an interior.
        start = _least_squares(C[~free], -c[~free])
        if np.abs(c[~free] + C[~free] @ start).max() > _TOLERANCE:
            return None
        along = null_space(C[~free])
        rest = _nearest(D @ along, off + D @ start, C[free] @ along, c[free] + C[free] @ start)
        return None if rest is None else np.asarray(start + along @ rest)
    # The feasible set has an interior.
    U, sizes, Vt = np.linalg.svd(D, full_matrices=False)
    keep = sizes > _TOLERANCE
    U, back = U[:, keep], Vt[keep].T / sizes[keep]
    best = -U.T @ off
    G = C @ back
    step = least_distance(G, -(c + G @ best))  # from the optimum without bounds
    return None if step is None else np.asarray(back @ (best + step))


def can_be_positive(D: FloatArray, offset: FloatArray) -> np.ndarray | None:
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


def largest_share(
    D: FloatArray, offset: FloatArray, lower: FloatArray, upper: FloatArray, most: float | None = 1
) -> float:
    """Return the largest t with ``t lower ≤ D x + o ≤ upper`` for some x; −∞ if there is none.

    It is at most ``most``. If that is None, ``upper`` bounds it.
    """
    from scipy.optimize import linprog

    # Unknowns are x and t lower, in one unit.
    sizes = [float(np.abs(part).max(initial=0.0)) for part in (offset, lower, upper)]
    scale = max(sizes[:2] if most is not None else sizes[::2]) or 1.0
    unit = sizes[1] or 1.0
    capped = upper < _NO_BOUND * scale
    k = D.shape[1]
    answer = linprog(
        c=np.append(np.zeros(k), -1.0),
        A_ub=np.vstack(
            [np.column_stack([-D, lower / unit]), np.column_stack([D, np.zeros(len(D))])[capped]]
        ),
        b_ub=np.concatenate([offset, (upper - offset)[capped]]) / scale,
        bounds=[(None, None)] * k + [(None, None if most is None else most * unit / scale)],
        method="highs",
    )
    return float(answer.x[-1]) * scale / unit if answer.status == 0 else -np.inf


def _least_squares(A: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(A, b, rcond=_TOLERANCE)[0])
