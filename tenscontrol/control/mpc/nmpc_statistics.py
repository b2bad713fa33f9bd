"""What became of the samples of an NMPC."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.control.status import Fallback, Status
from tenscontrol.validation import FloatArray, frozen


@dataclass(frozen=True, eq=False)
class NMPCStatistics:
    """What became of the samples since the last reset.

    The arrays have an entry for each of the K samples whose measurement was used; a fallback for
    want of a measurement is counted in ``status_count`` alone.

    Attributes
    ----------
    status_count : dict of Status to int
        How often each status came; ``Status.OK`` is a solved program.
    fallback_count : dict of Fallback to int
        How often each fallback was taken.
    programs : ndarray of int, shape (K,)
        Quadratic programs solved in each sample.
    iterations : ndarray of int, shape (K,)
        OSQP iterations in each sample.
    last_change : ndarray, shape (K,)
        Largest change of an input by the last program of each sample, in units of an input: how
        far the plan is from converged. Infinite where that program was not solved.
    preparation_time, feedback_time : ndarray, shape (K,)
        Before the measurement is needed, and after it is there, s.
    """

    status_count: dict[Status, int]
    fallback_count: dict[Fallback, int]
    programs: np.ndarray
    iterations: np.ndarray
    last_change: FloatArray
    preparation_time: FloatArray
    feedback_time: FloatArray


def statistics(
    status_count: dict[Status, int],
    fallback_count: dict[Fallback, int],
    records: list[tuple[float, ...]],
) -> NMPCStatistics:
    """Return statistics of counts, and of samples with the other attributes in their order."""
    table = np.array(records).reshape(-1, 5)
    return NMPCStatistics(
        status_count=status_count,
        fallback_count=fallback_count,
        programs=frozen(table[:, 0].astype(np.int64)),
        iterations=frozen(table[:, 1].astype(np.int64)),
        last_change=frozen(table[:, 2]),
        preparation_time=frozen(table[:, 3]),
        feedback_time=frozen(table[:, 4]),
    )
