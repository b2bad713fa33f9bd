"""Run times at equal error: how many times as long others take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tenscontrol.accuracy.runs import NOT_KNOWN, Measurement
from tenscontrol.tables import aligned, shown
from tenscontrol.validation import FloatArray


@dataclass(frozen=True, eq=False)
class Ratios:
    """Run time of other methods by that of our fastest, at equal error.

    Made by :meth:`WorkPrecision.ratios`.

    Attributes
    ----------
    errors : tuple of float, length E
        m.
    best : tuple of str, length E
        Our fastest method at each error; empty where none reaches it.
    time : ndarray, shape (E,)
        Its run time, s; NaN where none reaches the error.
    against : tuple of str, length P
        What it is compared with.
    ratio : ndarray, shape (E, P)
        Above 1 where ours is faster; NaN where one of the two does not reach the error.
    reached : ndarray of bool, shape (E, P)
        Whether the other one reaches the error.
    """

    errors: tuple[float, ...]
    best: tuple[str, ...]
    time: FloatArray
    against: tuple[str, ...]
    ratio: FloatArray
    reached: np.ndarray

    @property
    def least(self) -> float:
        """The smallest ratio; NaN if no error is reached by both."""
        known = self.ratio[np.isfinite(self.ratio)]
        return float(known.min()) if known.size else NOT_KNOWN

    def table(self) -> str:
        """Return the ratios as text, one error a line.

        Returns
        -------
        str
        """
        head = ["error m", "ours", "time s", *self.against]
        rows = []
        for i, error in enumerate(self.errors):
            cells = [
                shown(float(self.ratio[i, j]), ".3g") if self.reached[i, j] else "not reached"
                for j in range(len(self.against))
            ]
            rows.append([f"{error:.0e}", self.best[i] or "–", shown(float(self.time[i])), *cells])
        return aligned(head, rows, left=2)

    def __repr__(self) -> str:
        return f"Ratios({len(self.errors)} errors, {len(self.against)} others)"


def frontier(rows: Sequence[Measurement], floor: float) -> tuple[FloatArray, FloatArray]:
    """Return times and errors of the runs that no faster run beats, from coarse to fine.

    Parameters
    ----------
    rows : sequence of Measurement
        Of one method.
    floor : float
        Error of the reference, m: no error is known to be less.

    Returns
    -------
    times, errors : ndarray, shape (k,)
    """
    points = sorted(
        (row.time, max(row.error, floor)) for row in rows if not row.failure and row.time > 0
    )
    kept: list[tuple[float, float]] = []
    for time, error in points:
        if np.isfinite(error) and (not kept or error < kept[-1][1]):
            kept.append((time, error))
    found = np.array(kept).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def time_to_reach(rows: Sequence[Measurement], error: float, floor: float) -> float:
    """Return the run time at which a method has an error, s.

    Interpolated between logarithms; never carried on beyond what was run: to
    a larger error than any the fastest run goes, a smaller one is not reached.

    Parameters
    ----------
    rows : sequence of Measurement
        Of one method.
    error, floor : float
        m; ``floor`` as in :func:`frontier`.

    Returns
    -------
    float
        NaN where the error is not reached.
    """
    times, errors = frontier(rows, floor)
    if not len(times) or error < errors[-1]:
        return NOT_KNOWN
    if error >= errors[0]:
        return float(times[0])
    falling = np.log(np.maximum(errors, np.finfo(float).tiny))
    return float(np.exp(np.interp(-np.log(error), -falling, np.log(times))))
