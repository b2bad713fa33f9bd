"""What depends on time alone: a table with a row a sample."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, floor

import numpy as np

from tenscontrol.validation import FloatArray

# Numbers that a table may have: some hundred megabytes of C text.
_LARGEST = 5_000_000


def over_time(
    span: tuple[float, float], step: float, length: int, row: Callable[[float], FloatArray]
) -> tuple[int, FloatArray]:
    """Return the number of the first sample and a row for each from there on.

    Parameters
    ----------
    span : tuple of float
        First and last time at which the reference changes, s.
    step : float
        Sample time, s.
    length : int
        Samples that are seen ahead.
    row : callable
        What depends on a time, s.

    Raises
    ------
    ValueError
        If the table were too large.
    """
    begin, end = span
    if begin == end:
        return 0, row(0.0)[None]
    # Before the first and after the last nothing changes any more.
    first, last = floor(begin / step) - length - 1, ceil(end / step) + 1
    size = (last - first + 1) * len(row(first * step))
    if size > _LARGEST:
        raise ValueError(
            f"controller follows a reference of {end - begin:g} s, {last - first + 1} samples: a "
            f"table of {size:.1e} numbers, expected at most {_LARGEST:.0e}. Follow a shorter "
            "one, or take a longer step"
        )
    return first, np.array([row(k * step) for k in range(first, last + 1)])
