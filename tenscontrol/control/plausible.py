"""Which measurements a structure can have: what is beyond them is not acted on."""

from __future__ import annotations

import numpy as np

from tenscontrol.analysis import LinearPlant
from tenscontrol.validation import FloatArray

BAD_MEASUREMENT = "measurement not finite"
ABSURD_MEASUREMENT = "measurement not plausible"

# A bar may seem longer or shorter by this part of its length, and a fixed node off its place by
# this part of the size: far above the noise of sensors, far below a swapped or lost marker.
_BAR, _SUPPORT = 0.1, 0.1

# Along no axis nodes are farther apart than this many sizes of the structure.
_SPREAD = 10.0

# Farther from the origin, in sizes, too few digits of the shape are left.
_FAR = 1e6

# No node moves against another by more sizes than this in a sample, and in the time constant of
# the fastest pole.
_SPEED = 10.0


class Plausible:
    """Says what is wrong with a measurement.

    Parameters
    ----------
    plant : LinearPlant
        Gives bars, supports, size and poles.
    step : float or None
        Sample time, s.
    """

    def __init__(self, plant: LinearPlant, step: float | None) -> None:
        structure = plant.model.structure
        size = float(np.ptp(plant.nodes, axis=1).max())
        rate = float(np.abs(np.linalg.eigvals(plant.A)).max(initial=0.0))
        if step is not None:
            rate = max(rate, 1 / step)
        # A plant without stiffness, run at any sample time, has no speed of its own.
        self._fastest = _SPEED * size * rate if rate > 0 else np.finfo(float).max / _FAR
        self._far, self._spread, self._off = _FAR * size, _SPREAD * size, _SUPPORT * size
        self._bars, self._fixed = structure.bars.T, structure.fixed
        self._places = plant.nodes[:, structure.fixed]
        self._shortest, self._longest = (
            (part * structure.bar_length) ** 2 for part in (1 - _BAR, 1 + _BAR)
        )

    def fault(self, nodes: FloatArray, velocities: FloatArray) -> str | None:
        """Return a status for what is wrong, None where nothing is.

        Parameters
        ----------
        nodes, velocities : ndarray, shape (3, n)
            m and m/s; anything.
        """
        # Comparisons with what is not finite are false; no square overflows after the first.
        if not (
            np.abs(nodes).max() <= self._far and np.abs(velocities).max() <= _FAR * self._fastest
        ):
            finite = np.isfinite(nodes).all() and np.isfinite(velocities).all()
            return ABSURD_MEASUREMENT if finite else BAD_MEASUREMENT
        start, end = self._bars
        bars = nodes[:, end] - nodes[:, start]
        square = (bars * bars).sum(axis=0)
        plausible = (
            np.ptp(nodes, axis=1).max() <= self._spread
            and np.ptp(velocities, axis=1).max() <= self._fastest
            and ((square >= self._shortest) & (square <= self._longest)).all()
        )
        if plausible and len(self._fixed):
            off = np.linalg.norm(nodes[:, self._fixed] - self._places, axis=0)
            plausible = bool(off.max() <= self._off)
        return None if plausible else ABSURD_MEASUREMENT
