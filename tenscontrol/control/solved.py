"""Several systems of linear equations at once, where one that has no solution is no error."""

from __future__ import annotations

import numpy as np

from tenscontrol.validation import FloatArray


def solved(systems: FloatArray, sides: FloatArray) -> FloatArray:
    """Return the solutions of K systems; not a number, all of them, where one has none.

    Parameters
    ----------
    systems : ndarray, shape (K, m, m)
    sides : ndarray, shape (K, m, columns)

    Returns
    -------
    ndarray, shape (K, m, columns)
    """
    try:
        return np.asarray(np.linalg.solve(systems, sides), dtype=float)
    except np.linalg.LinAlgError:
        return np.full(sides.shape, np.nan)
