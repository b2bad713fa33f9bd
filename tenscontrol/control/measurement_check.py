"""Check of measurements: what a structure cannot have is not used."""

from __future__ import annotations

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.status import Status
from tenscontrol.structure.structure import Structure

# A bar may be measured longer or shorter by this part of its length, and a fixed node off its
# place by this part of the size: far above sensor noise, far below a swapped or lost marker.
_BAR, _SUPPORT = 0.1, 0.1

# Largest distance of two nodes along an axis, and of a node from the origin (where too few digits
# of the shape are left), in sizes of the structure.
_SPREAD, _FAR = 10.0, 1e6

# Largest relative motion of two nodes, in sizes, in a sample and in the time constant of the
# fastest pole.
_SPEED = 10.0


class MeasurementCheck:
    """Which measurements a structure can have; a controller does not use any other."""

    def __init__(
        self,
        structure: Structure,
        nodes: FloatArray,
        rate: float,
        lengths: tuple[FloatArray, FloatArray] | None = None,
    ) -> None:
        # ``nodes``, (d, n), are those of the usual shape, m; ``rate`` is the fastest, 1/s;
        # ``lengths`` are the least and the largest of driven bars, m, (β,) each.
        size = float(np.ptp(nodes, axis=1).max())
        # Largest difference of velocities of two nodes along an axis, m/s. A plant without
        # stiffness, run at any sample time, gives no limit.
        self.fastest = _SPEED * size * rate if rate > 0 else 0.5 * np.finfo(float).max / _FAR
        self.spread = _SPREAD * size  # the same of positions, m
        # Largest velocity, m/s, and coordinate, m, of a node along an axis.
        self.largest_velocity, self.farthest = _FAR * self.fastest, _FAR * size
        self.support_distance = _SUPPORT * size  # of a fixed node from its place, m
        # The same axis by axis, of positions and then of velocities.
        self._limits = [(self.farthest, self.spread)] * len(nodes)
        self._limits += [(self.largest_velocity, self.fastest)] * len(nodes)
        self.fixed, self.places = structure.fixed, nodes[:, structure.fixed]
        rolling = np.setdiff1d(structure.fixed_rows // len(nodes), self.fixed)
        is_held = np.zeros(nodes.size, bool)
        is_held[structure.fixed_rows] = True
        # Nodes on rollers, along which axes they are held, and where.
        self.rolling, self.held = rolling, is_held.reshape(nodes.shape, order="F")[:, rolling]
        self.held_at = nodes[:, rolling]
        self.bars = structure.bars.T
        # Least and largest square of the lengths of bars, m².
        least, largest = lengths or (structure.bar_length, structure.bar_length)
        self.squares = ((1 - _BAR) * least) ** 2, ((1 + _BAR) * largest) ** 2

    def fault(self, nodes: FloatArray, velocities: FloatArray) -> Status | None:
        """Return a status for what is wrong with a measurement, shapes (d, n); None if nothing."""
        motion, plausible = np.concatenate([nodes, velocities]), True
        extents = motion.min(axis=1).tolist(), motion.max(axis=1).tolist()
        for least, most, (distance, spread) in zip(*extents, self._limits, strict=True):
            # What is not finite is the least or the largest, and comparisons with it are false; no
            # square overflows after this.
            if not -distance <= least <= most <= distance:
                finite = np.isfinite(motion).all()
                return Status.MEASUREMENT_NOT_PLAUSIBLE if finite else Status.MEASUREMENT_NOT_FINITE
            plausible = plausible and most - least <= spread
        start, end = self.bars
        bars = nodes.take(end, axis=1) - nodes.take(start, axis=1)
        square = np.einsum("ij,ij->j", bars, bars)
        shortest, longest = self.squares
        plausible = plausible and bool(((square >= shortest) & (square <= longest)).all())
        if plausible and len(self.fixed):
            off = np.linalg.norm(nodes[:, self.fixed] - self.places, axis=0)
            plausible = bool(off.max() <= self.support_distance)
        if plausible and len(self.rolling):
            off = np.abs(nodes[:, self.rolling] - self.held_at)[self.held]
            plausible = bool(off.max() <= self.support_distance)
        return None if plausible else Status.MEASUREMENT_NOT_PLAUSIBLE
