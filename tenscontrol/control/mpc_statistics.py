"""What became of the solves of a linear MPC."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from tenscontrol.control.quadratic_program import Status
from tenscontrol.validation import frozen


@dataclass(frozen=True, eq=False)
class MPCStatistics:
    """What became of the solves since the last reset.

    Attributes
    ----------
    status_count : dict of str to int
        How often each status came; ``"ok"`` is a solved program.
    fallbacks : int
        Commands that did not come from a solved program.
    iterations : ndarray of int, shape (K,)
        OSQP iterations of each solve; a fallback for want of a measurement has none.
    """

    status_count: dict[str, int]
    fallbacks: int
    iterations: np.ndarray


def statistics(statuses: list[str], iterations: list[int]) -> MPCStatistics:
    """Return statistics of the status of each sample, and of the iterations of each solve."""
    counts = dict(Counter(statuses))
    return MPCStatistics(
        status_count=counts,
        fallbacks=len(statuses) - counts.get(Status.SOLVED.value, 0),
        iterations=frozen(np.array(iterations, dtype=np.int64)),
    )
