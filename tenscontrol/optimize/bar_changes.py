"""What changes of lengths of bars do to these and their rates."""

from __future__ import annotations

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.optimize.parameters import Parameter, spread


class BarChanges:
    """Lengths of all bars, by the values of a parameter of the kind "bars"."""

    def __init__(self, parameter: Parameter) -> None:
        self._parameter, self._bars = parameter, np.eye(parameter.shape[0])

    def at(self, time: FloatArray, within: FloatArray, orders: int = 3) -> FloatArray:
        """Return what the values change of lengths, rates and so on, (T, orders β, P)."""
        return np.concatenate(
            [spread(self._parameter, self._bars, time, within, order) for order in range(orders)],
            axis=1,
        )

    def impulse(self, time: float, before: float | None, after: float) -> FloatArray:
        """Return the same of lengths, of nothing, and of the jump of rates, (1, 3 β, P).

        By the pieces of times before and after it; before there may have been none.
        """
        now = np.array([time])
        length, jump = np.split(self.at(now, np.array([after]), 2), 2, axis=1)
        if before is not None:
            jump = jump - np.split(self.at(now, np.array([before]), 2), 2, axis=1)[1]
        return np.concatenate([length, np.zeros_like(jump), jump], axis=1)
