"""Which readings can be used: whole, finite, and as near as their spread allows."""

from __future__ import annotations

import numpy as np

from tenscontrol.estimation.sensors import Sensors
from tenscontrol.validation import FloatArray


class Gate:
    """Judges readings one by one, so that a corrupt one does not take others with it.

    A reading with the innovation ν and its covariance S passes where ``νᵀ S⁻¹ ν`` is at
    most the quantile of the chi-square distribution with as many degrees of freedom as the reading
    has entries.

    Parameters
    ----------
    sensors : Sensors
    probability : float
        Of refusing a good reading.
    """

    def __init__(self, sensors: Sensors, probability: float) -> None:
        from scipy.special import chdtri

        self._of = sensors.reading_of
        self._count = len(sensors.readings)
        sizes = np.bincount(self._of)
        starts = np.r_[0, np.cumsum(sizes)[:-1]]
        self._single = np.flatnonzero(sizes == 1)
        self._triple = np.flatnonzero(sizes == 3)
        self._single_rows = starts[self._single]
        self._triple_rows = starts[self._triple][:, None] + np.arange(3)
        self._limit = chdtri(sizes.astype(float), probability)
        self.is_tension = np.array([name.startswith("string_tension") for name in sensors.readings])

    def lost(self, y: FloatArray) -> np.ndarray:
        """Return which readings are lost: NaN in an entry, shape (readings,)."""
        return np.asarray(np.bincount(self._of, weights=np.isnan(y), minlength=self._count) > 0)

    def finite(self, y: FloatArray) -> np.ndarray:
        """Return which readings are numbers, shape (readings,)."""
        return np.asarray(
            np.bincount(self._of, weights=~np.isfinite(y), minlength=self._count) == 0
        )

    def passes(self, innovation: FloatArray, S: FloatArray) -> np.ndarray:
        """Return which readings are near enough, shape (readings,); never one that is not finite.

        Parameters
        ----------
        innovation : ndarray, shape (m,)
        S : ndarray, shape (m, m)
            Its covariance.
        """
        distance = np.zeros(self._count)
        one, three = self._single_rows, self._triple_rows
        parts, blocks = innovation[three], S[three[:, :, None], three[:, None, :]]
        # What is not finite, or too large to square, does not pass.
        with np.errstate(invalid="ignore", over="ignore"):
            distance[self._single] = innovation[one] ** 2 / S[one, one]
            weighed = np.linalg.solve(blocks, parts[..., None])[..., 0]
            distance[self._triple] = (parts * weighed).sum(axis=1)
            return np.asarray(distance <= self._limit)

    def beyond(
        self, innovation: FloatArray, weight: FloatArray, rows: np.ndarray, used: np.ndarray
    ) -> FloatArray:
        """Return how far readings are from what all others say, in limits, shape (readings,).

        The innovation of a reading given those of all others is ``W⁻¹ₖₖ (W ν)ₖ`` with
        ``W = S⁻¹``, and its covariance ``W⁻¹ₖₖ``, with blocks k of the reading. Zero where unused.

        Parameters
        ----------
        innovation : ndarray, shape (p,)
            Of the entries in use.
        weight : ndarray, shape (p, p)
            Inverse of its covariance.
        rows : ndarray of int, shape (p,)
            Which entries of y these are.
        used : ndarray of bool, shape (readings,)
        """
        weighed = np.zeros(len(self._of))
        weighed[rows] = weight @ innovation
        blocks = np.zeros((len(self._of),) * 2)
        blocks[np.ix_(rows, rows)] = weight
        distance = np.zeros(self._count)
        single, triple = used[self._single], used[self._triple]
        one, three = self._single_rows[single], self._triple_rows[triple]
        distance[self._single[single]] = weighed[one] ** 2 / blocks[one, one]
        inner = np.linalg.solve(
            blocks[three[:, :, None], three[:, None, :]], weighed[three][..., None]
        )
        distance[self._triple[triple]] = (weighed[three] * inner[..., 0]).sum(axis=1)
        return np.asarray(distance / self._limit)
