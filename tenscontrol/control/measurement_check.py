"""Which measurements a structure can have: what is beyond them is not acted on."""

from __future__ import annotations

import numpy as np

from tenscontrol.control.status import Status
from tenscontrol.plant import LinearPlant
from tenscontrol.validation import FloatArray

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
    sample_time : float or None
        Sample time, s.

    Attributes
    ----------
    farthest : float
        Largest coordinate of a node, m.
    fastest_seen : float
        Largest velocity along an axis, m/s, that is looked at closer.
    spread, fastest : float
        Largest difference of positions, m, and of velocities, m/s, of two nodes along an axis.
    off : float
        Largest distance of a fixed node from its place, m.
    bars : ndarray of int, shape (2, b)
        Ends of bars.
    squares : tuple of ndarray, shape (b,) each
        Least and largest square of their lengths, m².
    fixed : ndarray of int, shape (f,)
        Fixed nodes.
    places : ndarray, shape (3, f)
        Their places, m.
    """

    def __init__(self, plant: LinearPlant, sample_time: float | None) -> None:
        structure = plant.model.structure
        size = float(np.ptp(plant.nodes, axis=1).max())
        rate = float(np.abs(np.linalg.eigvals(plant.A)).max(initial=0.0))
        if sample_time is not None:
            rate = max(rate, 1 / sample_time)
        # A plant without stiffness, run at any sample time, has no speed of its own.
        self.fastest = _SPEED * size * rate if rate > 0 else np.finfo(float).max / _FAR
        self.fastest_seen = _FAR * self.fastest
        self.farthest, self.spread, self.off = _FAR * size, _SPREAD * size, _SUPPORT * size
        self.bars, self.fixed = structure.bars.T, structure.fixed
        self.places = plant.nodes[:, structure.fixed]
        self.squares = (
            ((1 - _BAR) * structure.bar_length) ** 2, ((1 + _BAR) * structure.bar_length) ** 2
        )  # fmt: skip

    def fault(self, nodes: FloatArray, velocities: FloatArray) -> Status | None:
        """Return a status for what is wrong, None where nothing is.

        Parameters
        ----------
        nodes, velocities : ndarray, shape (3, n)
            m and m/s; anything.
        """
        # Comparisons with what is not finite are false; no square overflows after the first.
        if not (
            np.abs(nodes).max() <= self.farthest and np.abs(velocities).max() <= self.fastest_seen
        ):
            finite = np.isfinite(nodes).all() and np.isfinite(velocities).all()
            return Status.MEASUREMENT_NOT_PLAUSIBLE if finite else Status.MEASUREMENT_NOT_FINITE
        start, end = self.bars
        bars = nodes[:, end] - nodes[:, start]
        square = (bars * bars).sum(axis=0)
        plausible = (
            np.ptp(nodes, axis=1).max() <= self.spread
            and np.ptp(velocities, axis=1).max() <= self.fastest
            and ((square >= self.squares[0]) & (square <= self.squares[1])).all()
        )
        if plausible and len(self.fixed):
            off = np.linalg.norm(nodes[:, self.fixed] - self.places, axis=0)
            plausible = bool(off.max() <= self.off)
        return None if plausible else Status.MEASUREMENT_NOT_PLAUSIBLE
