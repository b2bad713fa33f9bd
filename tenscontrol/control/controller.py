"""The controller interface: measured motion in, commands within bounds out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from tenscontrol.control.measurement_check import Plausible
from tenscontrol.control.status import Fallback, Status, merged_count
from tenscontrol.plant import LinearPlant
from tenscontrol.validation import FloatArray, float_array, frozen, measured, shaped


@dataclass(frozen=True, eq=False)
class Command:
    """What a controller wants for one sample.

    Attributes
    ----------
    value : ndarray, shape (α,)
        γ, N/m, or rest lengths, m, as the controller's ``input`` says. Finite
        and within the controller's bounds, always; where the change is limited,
        no farther than that from what stands.
    status : Status
        ``Status.OK``, or why the command is not what the controller wanted.
    fallback : Fallback or None
        What took the place of the decision; None where there was one.
    detail : str
        Figures to the status, for people.
    """

    value: FloatArray
    status: Status = Status.OK
    fallback: Fallback | None = None
    detail: str = ""

    def __str__(self) -> str:
        """Return status, fallback and detail in one line."""
        return ": ".join(filter(None, (self.status, self.fallback, self.detail)))


class Controller(ABC):
    """Turns measured motion into commands, one a sample. Holds state; ``reset()`` clears it.

    Parameters
    ----------
    plant : LinearPlant
        What it was designed on.
    sample_time : float or None
        Sample time, s. None for a law in continuous time, which is run at
        whatever sample time the simulation is given.
    low, high : ndarray, shape (α,)
        Least and largest command.
    change : ndarray, shape (α,), optional
        Largest change from what the actuators hold; no limit if not given.
    """

    def __init__(
        self,
        plant: LinearPlant,
        sample_time: float | None,
        low: FloatArray,
        high: FloatArray,
        change: FloatArray | None = None,
    ) -> None:
        self._plant = plant
        self._sample_time = sample_time
        self._low, self._high = frozen(low), frozen(high)
        self._change = None if change is None else frozen(change)
        self._plausible = Plausible(plant, sample_time)
        self._called = 0.0  # when a command was asked for, by perf_counter
        # What the actuators hold: as told, else the last command; None before the first.
        self._previous_input: FloatArray | None = None
        self._status_count: Counter[tuple[Status, Fallback | None]] = Counter()

    @property
    def plant(self) -> LinearPlant:
        """The linear plant that the controller was designed on."""
        return self._plant

    @property
    def sample_time(self) -> float | None:
        """Sample time, s, or None."""
        return self._sample_time

    @property
    def input(self) -> str:
        """What it commands: ``"force_density"`` or ``"rest_length"``."""
        return self._plant.input

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest command, shape (α,) each."""
        return self._low, self._high

    @property
    def largest_change(self) -> FloatArray | None:
        """Largest change from what the actuators hold, shape (α,); None for any."""
        return self._change

    @property
    def plausible(self) -> Plausible:
        """Which measurements are acted on."""
        return self._plausible

    def command(self, time: float, nodes: object, velocities: object) -> Command:
        """Return the command for the sample that starts now.

        A measurement that is not finite, or that the structure cannot have, is
        not used: the command is then the controller's fallback, and the status
        says so. The structure cannot have bars off their length by a tenth, fixed
        nodes off their places by a tenth of its size, nodes 10 sizes apart along an
        axis or a million from the origin, or nodes that move against each other by
        10 sizes in a sample and in the time constant of the fastest pole.

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
        self._called = perf_counter()
        time = float(float_array("time", time))
        shape = self._plant.nodes.shape
        N, V = (measured(*pair, shape) for pair in (("nodes", nodes), ("velocities", velocities)))
        state, fault = self._perceived(N, V)
        if fault is None:
            wanted = self._decide(time, state)
            if not np.isfinite(wanted.value).all():
                wanted = self._fall_back(Status.INPUT_NOT_FINITE)
        else:
            wanted = self._fall_back(fault)
        return self._given(wanted)

    def _perceived(
        self, nodes: FloatArray, velocities: FloatArray
    ) -> tuple[FloatArray, Status | None]:
        """Return what is decided on, and what is wrong with the measurement, None for nothing.

        The first is the reduced state z, unless a subclass measures for itself.
        """
        fault = self._plausible.fault(nodes, velocities)
        if fault is not None:
            return np.zeros(0), fault
        return self._plant.measure(nodes, velocities), None

    def _given(self, wanted: Command) -> Command:
        """Return the command within bounds that comes nearest to what is wanted."""
        self._previous_input = frozen(self._within_reach(wanted.value))
        self._status_count[wanted.status, wanted.fallback] += 1
        return replace(wanted, value=self._previous_input)

    def applied(self, value: object) -> None:
        """Tell what the actuators hold, where that may not be the last command.

        A winch may be slow, at the end of its range or stuck. Changes are limited
        from what is told here. A simulation tells it after each command, and where
        the winches stand before the first. Without it the last command is taken
        for what is held.

        Parameters
        ----------
        value : array_like, shape (α,)
            γ, N/m, or rest lengths, m, as the controller's ``input`` says.

        Raises
        ------
        TypeError, ValueError
            If it is not finite or has the wrong shape.
        """
        self._previous_input = frozen(shaped("value", value, self._low.shape, "one per string"))

    @property
    def _previous_within_bounds(self) -> FloatArray:
        """The previous input within bounds: changes are limited from here."""
        previous = self._previous_input
        if previous is None:
            previous = self._plant.equilibrium_input
        # Bounds come first: a command outside them is none, wherever the actuators stand.
        return np.clip(previous, self._low, self._high)

    def _within_reach(self, wish: FloatArray) -> FloatArray:
        """Return the wish within the change allowed and the bounds."""
        if self._change is not None:
            before = self._previous_within_bounds
            wish = np.clip(wish, before - self._change, before + self._change)
        return np.clip(wish, self._low, self._high)

    @abstractmethod
    def reset(self) -> None:
        """Forget everything that was measured, planned or applied."""
        self._previous_input = None
        self._status_count = Counter()

    def take_over(self, command: FloatArray) -> None:
        """Go on after another controller: what was planned from its own commands is void.

        Parameters
        ----------
        command : ndarray, shape (α,)
            What stands, or the last command of that one.
        """
        self._previous_input = frozen(command)

    @abstractmethod
    def _decide(self, time: float, state: FloatArray) -> Command:
        """Return what is wanted for what is perceived, bounds aside."""

    @abstractmethod
    def _fall_back(self, status: Status) -> Command:
        """Return a safe input where there is nothing to decide on."""

    def _hold(self, status: Status) -> Command:
        """Return the rest lengths that the actuators hold, or γ of the operating point."""
        if self.input == "rest_length" and self._previous_input is not None:
            return Command(self._previous_input, status, Fallback.PREVIOUS_INPUT_HELD)
        return Command(self._plant.equilibrium_input, status, Fallback.EQUILIBRIUM_HELD)

    @property
    def status_count(self) -> dict[Status, int]:
        """How often each status came since the last reset."""
        return merged_count((status, n) for (status, _), n in self._status_count.items())

    @property
    def fallback_count(self) -> dict[Fallback, int]:
        """How often each fallback was taken since the last reset."""
        return merged_count(
            (fallback, n) for (_, fallback), n in self._status_count.items() if fallback
        )
