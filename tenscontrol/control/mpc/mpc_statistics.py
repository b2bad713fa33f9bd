"""What became of the solves of a linear MPC."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.control.status import Fallback, Status
from tenscontrol.validation import frozen


@dataclass(frozen=True, eq=False)
class MPCStatistics:
    """What became of the solves since the last reset.

    Attributes
    ----------
    status_count : dict of Status to int
        How often each status came; ``Status.OK`` is a solved program.
    fallback_count : dict of Fallback to int
        How often each fallback was taken.
    iterations : ndarray of int, shape (K,)
        OSQP iterations of each solve; a fallback for want of a measurement has none.
    """

    status_count: dict[Status, int]
    fallback_count: dict[Fallback, int]
    iterations: np.ndarray

    @property
    def fallbacks(self) -> int:
        """Commands that did not come from a solved program."""
        return sum(self.fallback_count.values())


def statistics(
    status_count: dict[Status, int], fallback_count: dict[Fallback, int], iterations: list[int]
) -> MPCStatistics:
    """Return statistics of counts, and of the iterations of each solve."""
    return MPCStatistics(status_count, fallback_count, frozen(np.array(iterations, dtype=np.int64)))
