"""What changes of a motion of supports displace and push."""

from __future__ import annotations

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.optimize.parameters import Parameter, spread
from tenscontrol.simulation.moving_supports import MovingSupports, moved_by_supports
from tenscontrol.structure.structure import Structure


class SupportChanges:
    """The displacement E of nodes that move with supports, by the values of its motion.

    Parameters
    ----------
    structure : Structure
    supports : MovingSupports
    parameter : Parameter
        Of the kind "supports".
    """

    def __init__(
        self, structure: Structure, supports: MovingSupports, parameter: Parameter
    ) -> None:
        d, fixed = structure.dimension, len(structure.fixed)
        entries = np.arange(d * fixed).reshape(fixed, d).T.ravel()  # of an array (d, fixed)
        self._moves = moved_by_supports(structure).toarray()[:, entries]
        self._inertia = -(supports.mass @ self._moves)
        self._parameter = parameter

    def at(self, time: FloatArray, within: FloatArray, order: int = 0) -> FloatArray:
        """Return E, or its derivative of an order in time, by the values, (T, d n, P)."""
        return spread(self._parameter, self._moves, time, within, order)

    def inputs(self, time: FloatArray, within: FloatArray) -> FloatArray:
        """Return what the values change of E, Ė and the load -M Ë, (T, 3 d n, P)."""
        load = spread(self._parameter, self._inertia, time, within, 2)
        return np.concatenate([self.at(time, within), self.at(time, within, 1), load], axis=1)

    def impulse(self, time: float, before: float | None, after: float) -> FloatArray:
        """Return what the values change of E, Ė and the impulse at a time, (1, 3 d n, P).

        By the pieces of times before and after it; before there may have been no motion.
        """
        now, by = np.array([time]), self._parameter
        impulse = spread(by, self._inertia, now, np.array([after]), 1)
        if before is not None:
            impulse = impulse - spread(by, self._inertia, now, np.array([before]), 1)
        return np.concatenate([np.zeros((1, 2 * impulse.shape[1], impulse.shape[2])), impulse], 1)
