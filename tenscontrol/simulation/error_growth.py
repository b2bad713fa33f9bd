"""Growth of the error of a closed loop from sample to sample, seen while it is small."""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np

from tenscontrol.arrays import FloatArray

# Error in successive windows: it grows where so many in a row have each a maximum of so many times
# that of the one before, together of so many times, and the last of these factors are at least so
# many times the first. Powers of time slow down: t³ grows by 8, 3.4, 2.4, 2, 1.7.
_WINDOWS, _EACH, _TOGETHER, _STEADY = 6, 1.5, 30.0, 0.6

# Samples of the shortest window. Below the first part of the size an error is round-off, and it is
# said where it reaches the second.
_SHORTEST, _ROUND_OFF, _SEEN = 2, 1e-9, 1e-4

# What has fallen to this part of its largest again is no growth.
_FALLEN = 0.1


@dataclass(frozen=True)
class ErrorGrowth:
    """An error that grows exponentially from sample to sample.

    Attributes
    ----------
    begin, end : float
        From when to when it grows, s.
    time_constant : float
        Time in which it grows by a factor e, s.
    """

    begin: float
    end: float
    time_constant: float


def error_growth(time: FloatArray, error: FloatArray, size: float) -> ErrorGrowth | None:
    """Return the first growth of an error, m, of samples, of a structure of a size, m; or None.

    An error oscillates, so that maxima of windows are compared; windows of 2, 4, 8, … samples are
    tried. Growth that begins is found when six windows have passed.
    """
    width = _SHORTEST
    while _WINDOWS * width <= len(error):
        count = len(error) // width
        most = error[: count * width].reshape(count, width).max(axis=1)
        ratio = most[1:] / np.maximum(most[:-1], _ROUND_OFF * size)
        for first in range(count - _WINDOWS + 1):
            last = first + _WINDOWS - 1
            ratios = ratio[first:last]
            if most[first] < _ROUND_OFF * size or ratios.min() < _EACH:
                continue
            while last < count - 1 and ratio[last] >= _EACH:
                last += 1
            together = float(most[last] / most[first])
            steady = ratios[-2:].min() > _STEADY * ratios[:2].max()
            seen = most[last] > _SEEN * size and error[-width:].max() > _FALLEN * most[last]
            if together > _TOGETHER and steady and seen:
                begin, end = first * width, min((last + 1) * width, len(error)) - 1
                span = float(time[last * width] - time[first * width])
                return ErrorGrowth(float(time[begin]), float(time[end]), span / log(together))
        width *= 2
    return None
