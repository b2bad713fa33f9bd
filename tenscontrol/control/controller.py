"""The face that every controller shows to a simulation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from tenscontrol.analysis import LinearPlant
from tenscontrol.validation import FloatArray


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
    """

    def __init__(self, plant: LinearPlant, step: float | None) -> None:
        self._plant = plant
        self._step = step

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
    @abstractmethod
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest command, shape (α,) each."""

    @abstractmethod
    def command(self, time: float, nodes: FloatArray, velocities: FloatArray) -> Command:
        """Return the command for the sample that starts now.

        Parameters
        ----------
        time : float
            s.
        nodes, velocities : ndarray, shape (3, n)
            Measured motion, m and m/s.

        Returns
        -------
        Command
        """

    @abstractmethod
    def reset(self) -> None:
        """Forget everything that was measured or planned."""
