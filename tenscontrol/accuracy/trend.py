"""Whether a series drifts: its slope, with a confidence interval that minds its memory."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tenscontrol.validation import FloatArray

# Blocks that a series is averaged over, and the part of cases that the interval is to cover.
BLOCKS, _CONFIDENCE = 21, 0.95

# Differences of block means of a random walk share a block with the next: they are correlated by
# 1/4 with either neighbour, so that their mean varies by 1 + 2/4 times what it would alone.
_SHARED = 1.5


def trend(spacing: float, values: FloatArray) -> tuple[float, float]:
    """Return the slope of a series and the half-width of its 95 % confidence interval.

    The series is cut into 21 blocks, and the slope is the mean difference of
    the means of successive blocks, by their time. The interval is Student's t
    of these differences as they come from a random walk, which round-off makes:
    a walk is no drift. For an oscillation about a level the differences cancel,
    and the interval is wider than it need be.

    Parameters
    ----------
    spacing : float
        Time from one value to the next, s.
    values : ndarray, shape (T,) or (k, T)
        Of several series, that with the clearest slope is returned; its
        interval allows for the choice (Bonferroni).

    Returns
    -------
    slope, half_width : float
    """
    from scipy.special import stdtrit

    rows = np.atleast_2d(values)
    ends = np.linspace(0, rows.shape[1], min(BLOCKS, rows.shape[1]) + 1).round().astype(int)
    means = np.stack([rows[:, a:b].mean(axis=1) for a, b in pairwise(ends)])
    centres = spacing * (ends[:-1] + ends[1:] - 1) / 2
    rates = np.diff(means, axis=0) / np.diff(centres)[:, None]
    count = len(rates)
    slope = rates.mean(axis=0)
    likely = 1 - (1 - _CONFIDENCE) / 2 / len(rows)
    half = stdtrit(count - 1, likely) * rates.std(axis=0, ddof=1) / np.sqrt(count / _SHARED)
    # Of a series without any change, nothing is clear.
    clear = np.abs(slope) / np.where(half > 0, half, np.inf)
    worst = int(clear.argmax())
    return float(slope[worst]), float(half[worst])
