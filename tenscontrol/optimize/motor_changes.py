"""What changes of the numbers of motors make of the rest lengths that they wind."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.profile import polynomial_at
from tenscontrol.optimize.parameters import Parameter
from tenscontrol.simulation.actuators import Actuators

# Change of a number as part of it: rest lengths are smooth functions of it between the moments at
# which a winch is at its rate or leaves it, and are differenced to order 4.
_CHANGE = 1e-4


class MotorChanges:
    """Derivatives of rest lengths by numbers of the motors, under the same commands.

    Parameters
    ----------
    actuators : Actuators
        At the end of the run.
    winches : Winches
    parameters : sequence of Parameter
        Of the kind "motor".

    Raises
    ------
    ValueError
        If a motor met its torque: what it winds then depends on the motion.
    """

    def __init__(self, actuators: Actuators, winches: Winches, parameters: list[Parameter]) -> None:
        if actuators.meets_torque:
            raise ValueError(
                "a motor of the run met its torque, which makes its rest length depend on the "
                "motion: no derivative by motors is taken through that. Give more torque"
            )
        pieces = actuators.followed(winches)
        self._start, self._origin = pieces.start, pieces.origin
        self._by = {by.name: self._differenced(actuators, winches, by) for by in parameters}

    def at(self, parameter: Parameter, time: FloatArray, within: FloatArray) -> FloatArray:
        """Return derivatives of each rest length by its own number at times, (α, T).

        By the pieces of the times ``within``, of which they may be the ends.
        """
        i = np.searchsorted(self._start, within, side="right") - 1
        coefficients = self._by[parameter.name][i].transpose(1, 2, 0)
        return polynomial_at(coefficients, time - self._origin[i])

    @staticmethod
    def _differenced(actuators: Actuators, winches: Winches, by: Parameter) -> FloatArray:
        """Return derivatives of the coefficients of all pieces, (P, α, degree + 1)."""
        if by.field == "rate":
            value = np.asarray(winches.rate)
        else:
            value = np.asarray(getattr(winches.motor, by.field))

        def coefficients(share: float) -> FloatArray:
            number: dict[str, Any] = {by.field: value * (1 + share)}
            if by.field == "rate":
                return actuators.followed(replace(winches, **number)).coefficients
            assert winches.motor is not None  # of which it is a number
            motor = replace(winches.motor, **number)
            return actuators.followed(replace(winches, motor=motor)).coefficients

        ends = [coefficients(k * _CHANGE) for k in (1, -1, 2, -2)]
        by_share = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * _CHANGE)
        return np.asarray(by_share / np.broadcast_to(value, by.shape)[:, None])
