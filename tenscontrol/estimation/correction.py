"""Correction of a predicted state by gated readings: iterated extended Kalman filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.estimation.filter_design import LEAST_NOISE, FilterDesign
from tenscontrol.estimation.sensors import Sensors

# The correction is repeated about its own result until it moves by less than this part of the
# standard deviation before it, but not more often than this.
SETTLED, MOST_REPEATS = 1e-3, 6


@dataclass(frozen=True, eq=False)
class Fit:
    """State and covariance after a correction, the readings that were used, and νᵀ S⁻¹ ν."""

    z: FloatArray
    P: FloatArray
    passed: np.ndarray
    nis: float


class Gate:
    """Chi-square gate of single readings, so that a corrupt one does not spoil the others.

    A reading with the innovation ν and its covariance S passes where ``νᵀ S⁻¹ ν`` is at
    most the quantile of the chi-square distribution with as many degrees of freedom as the reading
    has entries. ``probability`` is that of refusing a good reading.
    """

    def __init__(self, sensors: Sensors, probability: float) -> None:
        from scipy.special import chdtri

        self._of = sensors.reading_of
        self._count = len(sensors.readings)
        sizes = np.bincount(self._of)
        starts = np.r_[0, np.cumsum(sizes)[:-1]]
        self._single = np.flatnonzero(sizes == 1)
        self._single_rows = starts[self._single]
        vectors = (np.flatnonzero(sizes == size) for size in np.unique(sizes[sizes > 1]))
        self._vectors = [
            (which, starts[which][:, None] + np.arange(sizes[which[0]])) for which in vectors
        ]
        self.limit = chdtri(sizes.astype(float), probability)
        self.needs_input = sensors.needs_input

    def lost(self, y: FloatArray) -> np.ndarray:
        """Return which readings are lost: NaN in an entry, shape (readings,)."""
        return np.asarray(np.bincount(self._of, weights=np.isnan(y), minlength=self._count) > 0)

    def finite(self, y: FloatArray) -> np.ndarray:
        """Return which readings are numbers, shape (readings,)."""
        return np.asarray(
            np.bincount(self._of, weights=~np.isfinite(y), minlength=self._count) == 0
        )

    def passes(self, innovation: FloatArray, S: FloatArray) -> np.ndarray:
        """Return which readings are near enough by S, (m, m), the innovation's covariance."""
        every = np.ones(self._count, dtype=bool)
        # What is not finite, or too large to square, does not pass.
        with np.errstate(invalid="ignore", over="ignore"):
            return np.asarray(self._distance(innovation, S, every) <= self.limit)

    def beyond(
        self, innovation: FloatArray, weight: FloatArray, rows: np.ndarray, used: np.ndarray
    ) -> FloatArray:
        """Return the distance of readings from all others, in limits, shape (readings,).

        The innovation of a reading given those of all others is ``W⁻¹ₖₖ (W ν)ₖ`` with
        ``W = S⁻¹``, and its covariance ``W⁻¹ₖₖ``, with blocks k of the reading. ``rows`` are the
        entries of y in ν, shape (p,), and W, (p, p); ``used`` says of which readings, shape
        (readings,). Zero where unused.
        """
        weighed = np.zeros(len(self._of))
        weighed[rows] = weight @ innovation
        blocks = np.zeros((len(self._of),) * 2)
        blocks[np.ix_(rows, rows)] = weight
        return np.asarray(self._distance(weighed, blocks, used) / self.limit)

    def _distance(self, vector: FloatArray, S: FloatArray, used: np.ndarray) -> FloatArray:
        """Return ``vᵀ S⁻¹ v`` with the parts of each reading, zero where it is not used."""
        distance = np.zeros(self._count)
        single = used[self._single]
        one = self._single_rows[single]
        distance[self._single[single]] = vector[one] ** 2 / S[one, one]
        for which, rows in self._vectors:
            axes = rows[used[which]]
            entries, blocks = vector[axes], S[axes[:, :, None], axes[:, None, :]]
            weighed = np.linalg.solve(blocks, entries[..., None])[..., 0]
            distance[which[used[which]]] = (entries * weighed).sum(axis=1)
        return distance


class Correction:
    """Measurement update without memory, by the outputs and the gate of a design."""

    def __init__(self, design: FilterDesign) -> None:
        self._outputs = Evaluator(design.outputs)
        self._noise = design.sensors.noise**2
        self._reading_of = design.sensors.reading_of
        self.gate = Gate(design.sensors, design.settings.gate)
        self._design = design

    def fit(
        self,
        y: FloatArray,
        usable: np.ndarray,
        z: FloatArray,
        P: FloatArray,
        held: FloatArray,
    ) -> Fit:
        """Return the most likely state by the readings y, shape (m,), that are near enough.

        First each of the usable readings is gated against the prediction z with its covariance P.
        Of those that pass, the one farthest from all others and the prediction together is
        refused, until every one agrees with the rest. What is held acts on the tensions.
        """
        innovation, C = self._innovation(y, z, held)
        if not np.isfinite(C).all():  # the prediction is no shape of the structure
            return Fit(z, P, np.zeros_like(usable), np.nan)
        passed = usable & self.gate.passes(innovation, self._covariance(C, P, self._noise)[0])
        while passed.any():
            rows = np.flatnonzero(passed[self._reading_of])
            used = self._use(y, rows, passed, z, P, held)
            if used is None:  # what these readings say is no shape of the structure
                break
            fit, innovation, weight = used
            beyond = self.gate.beyond(innovation, weight, rows, passed)
            if beyond.max() <= 1:
                return fit
            passed = passed.copy()
            passed[int(beyond.argmax())] = False
        return Fit(z, P, np.zeros_like(usable), np.nan)

    def _innovation(
        self, y: FloatArray, z: FloatArray, held: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return ``y − h(z)`` and ∂h/∂z."""
        read, C = self._outputs(z, held)
        return y - np.atleast_1d(read), C.reshape(len(y), -1)

    @staticmethod
    def _covariance(C: FloatArray, P: FloatArray, noise: FloatArray) -> tuple[FloatArray, ...]:
        """Return S of the innovation, and R of the readings from their variances."""
        predicted = C @ P @ C.T
        R = np.diag(np.maximum(noise, LEAST_NOISE * np.diag(predicted)))
        return predicted + R, R

    def _use(
        self,
        y: FloatArray,
        rows: np.ndarray,
        passed: np.ndarray,
        prior: FloatArray,
        P: FloatArray,
        held: FloatArray,
    ) -> tuple[Fit, FloatArray, FloatArray] | None:
        """Return the most likely state by some entries of y, ν and S⁻¹; None if it is no shape."""
        z = prior
        size = np.sqrt(np.maximum(np.diag(P), np.finfo(float).tiny))  # 0 where the state is known
        for _ in range(MOST_REPEATS):
            innovation, C = self._innovation(y, z, held)
            C = C[rows].copy()
            if not np.isfinite(C).all():  # at the edge of what the coordinates reach
                return None
            linear = innovation[rows] - C @ (prior - z)
            S, R = self._covariance(C, P, self._noise[rows])
            weight = np.asarray(np.linalg.inv(S), dtype=float)
            gain = P @ C.T @ weight
            new = prior + gain @ linear
            moved = float(np.max(np.abs(new - z) / size))
            z = new
            if not self.reaches(z, held):
                return None
            if moved < SETTLED:
                break
        # Joseph's form stays symmetric and positive definite.
        left = np.eye(len(P)) - gain @ C
        P = left @ P @ left.T + gain @ R @ gain.T
        nis = float(linear @ weight @ linear)
        return Fit(z, 0.5 * (P + P.T), passed, nis), linear, weight

    def reaches(self, z: FloatArray, held: FloatArray | None) -> bool:
        """Whether the coordinates reach the shape: no bar is turned by a right angle."""
        if not np.isfinite(z).all():
            return False
        try:
            self._design.nodes(z, held)
        except ValueError:
            return False
        return True
