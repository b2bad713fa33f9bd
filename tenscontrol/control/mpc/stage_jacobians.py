"""First-order functions along a trajectory."""

from __future__ import annotations

from dataclasses import dataclass

from tenscontrol.dynamics import Evaluator
from tenscontrol.validation import FloatArray


@dataclass(frozen=True, eq=False)
class Tangents:
    """First-order functions along a trajectory: ``value ≈ offset + Σ slope · argument``.

    Slopes are stored by columns: entry [k, j, i] is the derivative of value i by argument j.

    Attributes
    ----------
    offset : ndarray, shape (N, m)
    slopes : tuple of ndarray, shape (N, columns, m) each
        Of the motion by z_k, u_k and, where winches wind, u_{k−1}; of limited rows by z_k, u_k and
        z_{k+1}. Views of memory that the next call may overwrite.
    """

    offset: FloatArray
    slopes: tuple[FloatArray, ...]


def evaluated(evaluator: Evaluator, *arguments: FloatArray) -> Tangents:
    """Return the tangents of N functions that give their values and derivatives.

    Parameters
    ----------
    evaluator : Evaluator
        Of ``(x, y, …) -> (value, ∂value/∂x, ∂value/∂y, …)``, mapped N times.
    *arguments : ndarray, shape (N, columns) each
    """
    N = len(arguments[0])
    # One sample is a vector to an evaluator, several are columns.
    values, *slopes = evaluator(*(x.T if N > 1 else x[0] for x in arguments))
    offset = values.reshape(-1, N, order="F").T.copy()
    blocks = []
    for slope, argument in zip(slopes, arguments, strict=True):
        by_columns = slope.ravel(order="K").reshape(N, argument.shape[1], -1)
        offset -= (argument[:, None, :] @ by_columns)[:, 0]
        blocks.append(by_columns)
    return Tangents(offset, tuple(blocks))
