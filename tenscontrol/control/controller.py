"""The face that every controller shows to a simulation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from tenscontrol.analysis import LinearPlant
from tenscontrol.validation import FloatArray, float_array, frozen, measured

OK = "ok"
BAD_MEASUREMENT = "measurement not finite"


@dataclass(frozen=True, eq=False)
class Command:
    """What a controller wants for one sample.

    Attributes
    ----------
    value : ndarray, shape (α,)
        γ, N/m, or rest lengths, m, as the controller's ``input`` says. Finite
        and within the controller's bounds, always.
    status : str
        ``"ok"``, or why the command is not what the controller would have wished.
    """

    value: FloatArray
    status: str


class Controller(ABC):
    """Turns measured motion into commands, one a sample. Holds state; ``reset()`` clears it.

    Parameters
    ----------
    plant : LinearPlant
        What it was designed on.
    step : float or None
        Sample time, s. None for a law in continuous time, which is run at
        whatever sample time the simulation is given.
    low, high : ndarray, shape (α,)
        Least and largest command.
    """

    def __init__(
        self, plant: LinearPlant, step: float | None, low: FloatArray, high: FloatArray
    ) -> None:
        self._plant = plant
        self._step = step
        self._low, self._high = frozen(low), frozen(high)

    @property
    def plant(self) -> LinearPlant:
        """The linear plant that the controller was designed on."""
        return self._plant

    @property
    def step(self) -> float | None:
        """Sample time, s, or None."""
        return self._step

    @property
    def input(self) -> str:
        """What it commands: ``"force_density"`` or ``"rest_length"``."""
        return self._plant.input

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest command, shape (α,) each."""
        return self._low, self._high

    def command(self, time: float, nodes: object, velocities: object) -> Command:
        """Return the command for the sample that starts now.

        A measurement that is not finite is not used: the command is then the
        controller's fallback, and the status says so.

        Parameters
        ----------
        time : float
            s.
        nodes, velocities : array_like, shape (3, n)
            Measured motion, m and m/s.

        Returns
        -------
        Command

        Raises
        ------
        TypeError, ValueError
            If an array is not of numbers or has the wrong shape, or the time is
            not a finite number.
        """
        time = float(float_array("time", time))
        shape = self._plant.nodes.shape
        N, V = (measured(*pair, shape) for pair in (("nodes", nodes), ("velocities", velocities)))
        if np.isfinite(N).all() and np.isfinite(V).all():
            wish, status = self._decide(time, self._plant.measure(N, V))
        else:
            wish, status = self._fall_back(BAD_MEASUREMENT)
        return Command(frozen(np.clip(wish, self._low, self._high)), status)

    @abstractmethod
    def reset(self) -> None:
        """Forget everything that was measured or planned."""

    @abstractmethod
    def _decide(self, time: float, state: FloatArray) -> tuple[FloatArray, str]:
        """Return the wanted input, shape (α,), for the reduced state z, and a status."""

    @abstractmethod
    def _fall_back(self, reason: str) -> tuple[FloatArray, str]:
        """Return a safe input, shape (α,), where there is nothing to decide on, and a status."""
