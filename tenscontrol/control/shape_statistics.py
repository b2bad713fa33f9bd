"""What became of the samples of shape control."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.control.status import Fallback, Status
from tenscontrol.validation import FloatArray, frozen


@dataclass(frozen=True, eq=False)
class FeedbackLinearizationStatistics:
    """What became of the samples since the last reset.

    Attributes
    ----------
    status_count : dict of Status to int
        How often the law was reached (``Status.OK``), how often not.
    fallback_count : dict of Fallback to int
        How often each fallback was taken.
    residual : ndarray, shape (K,)
        How far the applied γ misses the law: largest entry of ``Ë + a Ė + b E``, m/s².
        NaN for a fallback, which asks for nothing.
    unbounded_residual : ndarray, shape (K,)
        What would be missed without bounds on γ, m/s²: the strings pull in no such direction.
        NaN for a fallback too.
    at_bound : ndarray of int, shape (K,)
        Strings commanded at a bound of γ or of its change; 0 for a fallback.
    iterations : ndarray of int, shape (K,)
        OSQP iterations; 0 where no program was begun.
    """

    status_count: dict[Status, int]
    fallback_count: dict[Fallback, int]
    residual: FloatArray
    unbounded_residual: FloatArray
    at_bound: np.ndarray
    iterations: np.ndarray

    @property
    def largest_residual(self) -> float:
        """Largest residual, m/s²; zero where no sample has one."""
        return float(np.nanmax(self.residual, initial=0.0))


def statistics(
    status_count: dict[Status, int],
    fallback_count: dict[Fallback, int],
    records: list[tuple[float, ...]],
) -> FeedbackLinearizationStatistics:
    """Return statistics of counts, and of samples with the other attributes in their order."""
    table = np.array(records).reshape(-1, 4)
    return FeedbackLinearizationStatistics(
        status_count=status_count,
        fallback_count=fallback_count,
        residual=frozen(table[:, 0]),
        unbounded_residual=frozen(table[:, 1]),
        at_bound=frozen(table[:, 2].astype(np.int64)),
        iterations=frozen(table[:, 3].astype(np.int64)),
    )
