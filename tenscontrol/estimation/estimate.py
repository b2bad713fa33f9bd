"""What a filter found, and what became of the readings."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from tenscontrol.validation import FloatArray, IntArray, frozen

OK, PARTLY, LOST, REFUSED = "ok", "partly used", "lost", "refused"
WAITING, RESTARTED = "waiting", "started anew"


@dataclass(frozen=True, eq=False)
class Estimate:
    """Motion found by a filter. Made by :meth:`KalmanFilter.update`.

    Attributes
    ----------
    nodes, velocities : ndarray, shape (3, n)
        m and m/s. Bars have their lengths. Motions as one body that no reading tells
        of are left out.
    load : ndarray, shape (3, n), or None
        Unknown force on each node, N, that acts on the bars in proportion to their mass: of all
        loads that move the structure so, one. None if the filter estimates none.
    state : ndarray, shape (s,)
        z in the coordinates of the filter; where a load is estimated, with the accelerations that
        it gives at the end.
    covariance : ndarray, shape (s, s)
        Of the state, as the filter has it.
    node_deviation : ndarray, shape (3, n)
        Standard deviation of each coordinate of the nodes, m, to first order.
    length_deviation : ndarray, shape (α,)
        That of the length of each string, m.
    status : str
        ``"ok"`` if all readings were used, ``"partly used"``, ``"lost"`` if none came,
        ``"refused"`` if those that came were, ``"waiting"`` for the first ones while delayed,
        ``"started anew"`` if the filter was taken to be wrong.
    """

    nodes: FloatArray
    velocities: FloatArray
    load: FloatArray | None
    state: FloatArray
    covariance: FloatArray
    node_deviation: FloatArray
    length_deviation: FloatArray
    status: str


@dataclass(frozen=True, eq=False)
class FilterStatistics:
    """What became of the readings of K samples. Made by :attr:`KalmanFilter.statistics`.

    Attributes
    ----------
    status_count : dict of str to int
        How often each status came.
    used, lost, not_finite, refused : ndarray of int, shape (readings,)
        How often each reading was used, did not come, was infinite, or was refused by the gate.
    normalized_innovation : ndarray, shape (K,)
        ``νᵀ S⁻¹ ν`` of the entries that were used, NaN if there were none. If the filter's
        noise is that of the plant, it is chi-square distributed.
    degrees_of_freedom : ndarray of int, shape (K,)
        Number of these entries.
    restarts : int
        How often the filter was taken to be wrong and started anew.
    """

    status_count: dict[str, int]
    used: IntArray
    lost: IntArray
    not_finite: IntArray
    refused: IntArray
    normalized_innovation: FloatArray
    degrees_of_freedom: IntArray
    restarts: int


class Tally:
    """Counts what becomes of readings.

    Parameters
    ----------
    readings : int
        How many there are.
    """

    def __init__(self, readings: int) -> None:
        self._counts = np.zeros((4, readings), dtype=np.int64)
        self._rows: list[tuple[str, float, int]] = []
        self._restarts = 0
        self._fresh = False

    @property
    def last(self) -> str:
        """Status of the last sample."""
        return self._rows[-1][0]

    def wait(self) -> None:
        """Count a sample at which nothing can have come."""
        self._close(WAITING, np.nan, 0)

    def start_over(self, after: bool = False) -> None:
        """Count a start anew: of the sample to be counted next, or after the last one was."""
        self._restarts += 1
        if after:
            self._rows[-1] = (RESTARTED, *self._rows[-1][1:])
        else:
            self._fresh = True

    def add(
        self,
        lost: np.ndarray,
        usable: np.ndarray,
        passed: np.ndarray,
        nis: float,
        entries: int,
    ) -> None:
        """Count a sample: which readings were lost, usable and used."""
        self._counts += np.array([passed, lost, ~usable & ~lost, usable & ~passed])
        if passed.all():
            status = OK
        elif passed.any():
            status = PARTLY
        else:
            status = LOST if lost.all() else REFUSED
        self._close(status, nis, entries)

    def _close(self, status: str, nis: float, entries: int) -> None:
        self._rows.append((RESTARTED if self._fresh else status, nis, entries))
        self._fresh = False

    def statistics(self) -> FilterStatistics:
        """Return the counts so far."""
        statuses, nis, entries = (list(part) for part in zip(*self._rows, strict=True)) if (
            self._rows
        ) else ([], [], [])  # fmt: skip
        used, lost, not_finite, refused = (frozen(row) for row in self._counts)
        return FilterStatistics(
            status_count=dict(Counter(statuses)),
            used=used,
            lost=lost,
            not_finite=not_finite,
            refused=refused,
            normalized_innovation=frozen(np.array(nis, dtype=float)),
            degrees_of_freedom=frozen(np.array(entries, dtype=np.int64)),
            restarts=self._restarts,
        )
