"""When a path is where: as fast as the winches allow, with smooth ends."""

from __future__ import annotations

import numpy as np

from tenscontrol.validation import FloatArray

# Where a path stands still but for round-off, it goes as if this much faster.
_LEAST_PACE = 1e-6


class Clock:
    """The place on a path at any time.

    The pace p(s) is the time that a unit of the path takes at full speed. The
    speed, as a share of the full one, rises over a ramp by ``3τ² − 2τ³``, stays,
    and falls again; acceleration is zero at both ends of a ramp.

    Parameters
    ----------
    places : ndarray, shape (K,)
        s, ascending from 0 to 1.
    pace : ndarray, shape (K,)
        p at these places, s or any other unit; straight in between.
    ramp : float
        Share of the duration that each ramp takes, at most 1/2.
    """

    def __init__(self, places: FloatArray, pace: FloatArray, ramp: float) -> None:
        self._places = places
        self._pace = np.maximum(pace, _LEAST_PACE * pace.max())
        parts = np.diff(places) * (self._pace[1:] + self._pace[:-1]) / 2
        self._passed = np.concatenate([[0.0], np.cumsum(parts)])
        self._ramp = ramp

    @property
    def shortest(self) -> float:
        """The duration at which the full speed is just reached."""
        return float(self._passed[-1] / (1 - self._ramp))

    def at(self, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return s and ds/dτ at shares τ of the duration, from 0 to 1."""
        r = self._ramp
        begun = np.clip(share / r, 0.0, 1.0)
        left = np.clip((1 - share) / r, 0.0, 1.0)
        speed = _step(begun) * _step(left) / (1 - r)
        travelled = r * _integral(begun) - r * _integral(left) + r / 2
        travelled = travelled + np.clip(share - r, 0.0, 1 - 2 * r)
        passed = np.clip(travelled / (1 - r), 0.0, 1.0) * self._passed[-1]
        k = np.clip(np.searchsorted(self._passed, passed, side="right") - 1, 0, len(self._pace) - 2)
        # Within a piece the pace is p + c x: passed = p x + c x²/2, solved for x.
        p, length = self._pace[k], self._places[k + 1] - self._places[k]
        c = (self._pace[k + 1] - p) / length
        rest = passed - self._passed[k]
        x = np.clip(2 * rest / (p + np.sqrt(np.maximum(p**2 + 2 * c * rest, 0.0))), 0.0, length)
        return self._places[k] + x, speed * self._passed[-1] / (p + c * x)


def _step(x: FloatArray) -> FloatArray:
    return x * x * (3 - 2 * x)


def _integral(x: FloatArray) -> FloatArray:
    return x**3 - x**4 / 2
