"""The correction of a predicted state by those readings that agree with it and with each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.dynamics import Evaluator
from tenscontrol.estimation.design import FilterDesign
from tenscontrol.estimation.gate import Gate
from tenscontrol.validation import FloatArray

# The correction is repeated about its own result until it moves by less than this part of the
# standard deviation before it, but not more often than this.
_SETTLED, _MOST_REPEATS = 1e-3, 6


@dataclass(frozen=True, eq=False)
class Fit:
    """State and covariance after a correction, the readings that were used, and νᵀ S⁻¹ ν."""

    z: FloatArray
    P: FloatArray
    passed: np.ndarray
    nis: float


class Correction:
    """Corrects states; remembers nothing.

    Parameters
    ----------
    design : FilterDesign
    """

    def __init__(self, design: FilterDesign) -> None:
        plant = design.plant
        self._outputs = Evaluator(design.outputs)
        self._noise = design.sensors.noise**2
        self._reading_of = design.sensors.reading_of
        self._rest = plant.equilibrium_input
        self.gate = Gate(design.sensors, design.gate)
        # Bar vectors move by these rows; the bars of the reference have no part across themselves.
        structure, T = plant.model.structure, plant.basis
        self._r = plant.degrees_of_freedom
        by_node = T.reshape(-1, 3, T.shape[1]).swapaxes(0, 1)
        bars = by_node[:, structure.bars[:, 1]] - by_node[:, structure.bars[:, 0]]
        self._bar_rows = bars.reshape(-1, T.shape[1])
        self._axes = structure.bar_vectors(plant.nodes) / structure.bar_length
        self._reach = structure.bar_length**2

    def fit(
        self,
        y: FloatArray,
        usable: np.ndarray,
        z: FloatArray,
        P: FloatArray,
        before: FloatArray | None,
    ) -> Fit:
        """Return the most likely state by the readings that are near enough.

        First each reading is held against the prediction alone. Of those that pass, the one
        farthest from what all others and the prediction together say is taken out, until
        every one agrees with the rest.

        Parameters
        ----------
        y : ndarray, shape (m,)
        usable : ndarray of bool, shape (readings,)
            Which readings are whole and finite.
        z : ndarray, shape (s,)
            Predicted state.
        P : ndarray, shape (s, s)
            Its covariance.
        before : ndarray, shape (α,), or None
            The input that acted on the tensions.
        """
        held = self._rest if before is None else before
        innovation, C = self._innovation(y, z, held)
        passed = usable & self.gate.passes(innovation, C @ P @ C.T + np.diag(self._noise))
        while passed.any():
            rows = np.flatnonzero(passed[self._reading_of])
            fit, innovation, weight = self._use(y, rows, passed, z, P, held)
            if fit is None:  # what these readings say is no shape of the structure
                break
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

    def _use(
        self,
        y: FloatArray,
        rows: np.ndarray,
        passed: np.ndarray,
        prior: FloatArray,
        P: FloatArray,
        held: FloatArray,
    ) -> tuple[Fit | None, FloatArray, FloatArray]:
        """Return the state by some entries of y, their innovation, and the inverse of its S.

        The most likely state, by repeated linearization of h; None if it is of no shape of the
        structure.
        """
        z = prior
        size = np.sqrt(np.maximum(np.diag(P), np.finfo(float).tiny))  # 0 where the state is known
        R = np.diag(self._noise[rows])
        for _ in range(_MOST_REPEATS):
            innovation, C = self._innovation(y, z, held)
            C = C[rows].copy()
            linear = innovation[rows] - C @ (prior - z)
            weight = np.linalg.inv(C @ P @ C.T + R)
            gain = P @ C.T @ weight
            new = prior + gain @ linear
            moved = float(np.max(np.abs(new - z) / size))
            z = new
            if not self.reaches(z):
                return None, linear, weight
            if moved < _SETTLED:
                break
        # Joseph's form stays symmetric and positive definite.
        left = np.eye(len(P)) - gain @ C
        P = left @ P @ left.T + gain @ R @ gain.T
        nis = float(linear @ weight @ linear)
        return Fit(z, 0.5 * (P + P.T), passed, nis), linear, weight

    def reaches(self, z: FloatArray) -> bool:
        """Whether the coordinates reach the shape: no bar is turned by a right angle."""
        if not np.isfinite(z).all():
            return False
        bars = (self._bar_rows @ z[: self._r]).reshape(3, -1)
        across = bars - (bars * self._axes).sum(axis=0) * self._axes
        return bool(((across**2).sum(axis=0) < self._reach).all())
