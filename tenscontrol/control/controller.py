"""Base classes of controllers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping
from copy import deepcopy
from time import perf_counter
from types import MappingProxyType
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    Actuation,
    every_string,
    inputs_of,
    member_rows,
    strings_of,
)
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.control.command import Command, Fallback
from tenscontrol.control.measurement_check import MeasurementCheck
from tenscontrol.dynamics.evaluator import Exclusive, exclusive
from tenscontrol.dynamics.model import Model
from tenscontrol.plant.controllability import reached_states, unreached_modes, warn_of_left_alone
from tenscontrol.plant.linear_plant import PLANT_INPUTS, LinearPlant
from tenscontrol.plant.modes import Modes
from tenscontrol.status import Status
from tenscontrol.structure.structure import Structure

# Methods of controllers that use what they remember of the samples before.
_WITH_MEMORY = {"applied", "command", "fall_back", "follow", "prepare", "program", "reset"}


def clipped(value: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the nearest value within bounds; ``np.clip`` takes three times as long."""
    return np.minimum(np.maximum(value, low), high)


class BaseController(ABC):
    """Base class of controllers: check of measurements, bounds, fallback, counts.

    Parameters
    ----------
    structure : Structure
        The structure whose nodes it is given.
    input : {"force_density", "rest_length", "bar_length", "length"}
        What it commands.
    sample_time : float or None
        As for :class:`Controller`, s.
    low, high : ndarray, shape (m,)
        Least and largest input, N/m or m: one for each driven string or winch, see ``actuation``.
    change : ndarray, shape (m,), optional
        Largest change from the previous input, N/m or m; no limit if not given.
    commanded : Structure, optional
        The structure whose strings it commands, if that is the parent.
    equilibrium_input : ndarray, shape (m,), optional
        Commanded where there is neither a decision nor a previous input.
    check : MeasurementCheck, optional
        Of measurements, if not that of the shape of the structure.
    size : int
        Rows or columns of the largest matrix of a command, if there are any.
    """

    #: What a kind of controller adds to :attr:`made_with`.
    _settings: Mapping[str, Any] = MappingProxyType({})

    def __init__(
        self,
        structure: Structure,
        input: str,
        sample_time: float | None,
        low: FloatArray,
        high: FloatArray,
        change: FloatArray | None = None,
        *,
        commanded: Structure | None = None,
        equilibrium_input: FloatArray | None = None,
        check: MeasurementCheck | None = None,
        size: int = 0,
    ) -> None:
        #: The thread that uses the controller: another one is refused meanwhile.
        self.in_use = Exclusive(f"this {type(self).__name__}", size)
        validation.instance("structure", structure, Structure, "for example prism()")
        if sample_time is not None:
            sample_time = validation.positive_number("sample_time", sample_time, "s")
        self._structure = structure
        self._commanded = structure if commanded is None else commanded
        self._input = validation.choice("input", input, PLANT_INPUTS)
        self._sample_time = sample_time
        self._actuation = self._driven()
        shape = self._actuation.lead.shape
        self._low = frozen(validation.shaped("low", low, shape, "one per driven string"))
        self._high = frozen(validation.measured("high", high, shape, "one per driven string"))
        wrong = np.flatnonzero(~(self._low <= self._high))
        if len(wrong):
            i = wrong[0]
            raise ValueError(
                f"high[{i}] is {self._high[i]:g}, expected at least low[{i}] = {self._low[i]:g}"
            )
        self._change = None
        if change is not None:
            change = validation.limit_per_member("change", change, len(self._low), "string")
            self._change = frozen(validation.positive("change", change, "change of the input"))
        self._equilibrium_input = equilibrium_input
        rate = 0.0 if sample_time is None else 1 / sample_time
        self._measurement_check = check or MeasurementCheck(structure, structure.nodes, rate)
        self._called = 0.0  # start of the last command, by perf_counter
        # Input over the last sample: as applied() says, else the last command; None before.
        self._previous_input: FloatArray | None = None
        self._status_count: Counter[Status] = Counter()
        self._fallback_count: Counter[Fallback] = Counter()

    def __repr__(self) -> str:
        when = "" if self.sample_time is None else f", every {self.sample_time:g} s"
        return f"{type(self).__name__}(input {self.input}{when})"

    @property
    def label(self) -> str:
        """What it is called in messages."""
        return type(self).__name__

    @property
    def structure(self) -> Structure:
        """The structure whose nodes it is given."""
        return self._structure

    @property
    def commanded(self) -> Structure:
        """The structure whose strings it commands."""
        return self._commanded

    @property
    def actuation(self) -> Actuation:
        """Which of the commanded strings it drives: a command has the values of all."""
        return self._actuation

    def _driven(self) -> Actuation:
        return every_string(len(self._commanded.strings))

    @property
    def feet(self) -> IntArray | tuple[()]:
        """Fixed nodes that ground holds by friction, of a law for a stance; else none."""
        return ()

    @property
    def sample_time(self) -> float | None:
        """Sample time, s, or None."""
        return self._sample_time

    @property
    def input(self) -> str:
        """What it commands, as the input of a plant: ``"rest_length"``, ``"length"`` and so on."""
        return self._input

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest input, shape (m,) each."""
        return self._low, self._high

    @property
    def largest_change(self) -> FloatArray | None:
        """Largest change from the previous input, shape (m,); None for any."""
        return self._change

    @property
    def made_with(self) -> dict[str, Any]:
        """Kind, input, sample time, s, bounds and other settings by name; a run records them."""
        return {
            "kind": type(self).__name__,
            "input": self._input,
            "sample_time": self._sample_time,
            "low": self._low,
            "high": self._high,
            "max_change": self._change,
            **self._settings,
        }

    @property
    def prediction_error(self) -> float | None:
        """How far the last measurement was off what was predicted a sample before, m.

        Of the node that is off most. None for a controller that predicts nothing, and where there
        was no measurement or no prediction.
        """
        return None

    def begin(self, model: Model, nodes: FloatArray) -> None:
        """Reset before a run. A controller may warn that the model of the run is not its own.

        Parameters
        ----------
        model : Model
            Of the run.
        nodes : ndarray, shape (d, n)
            At its start, m.
        """
        self.reset()

    def reference_nodes(self, times: FloatArray) -> FloatArray | None:
        """Return the shapes that it steers to at given times, shape (d, n, K), m; None if none.

        The tracking error of a run is measured from them. A controller of your own may say its.

        Parameters
        ----------
        times : ndarray, shape (K,)
            s.
        """
        return None

    @property
    def measurement_check(self) -> MeasurementCheck:
        """Which measurements are used."""
        return self._measurement_check

    def __init_subclass__(cls, **keywords: object) -> None:
        """Let one thread at a time call what uses the memory of a controller."""
        super().__init_subclass__(**keywords)
        for name in _WITH_MEMORY & vars(cls).keys():
            if callable(vars(cls)[name]):
                setattr(cls, name, exclusive(vars(cls)[name]))

    @exclusive
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
        nodes, velocities : array_like, shape (d, n)
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
        time = validation.number("time", time, "s")
        shape = self._structure.nodes.shape
        N, V = (
            validation.measured("nodes", nodes, shape),
            validation.measured("velocities", velocities, shape),
        )
        state, fault = self._measure(N, V)
        if fault is not None:
            return self.fall_back(fault)
        # The previous input may be of any size: what overflows shows in the status.
        with np.errstate(over="ignore", invalid="ignore"):
            desired = self._decide(time, state)
        if not np.isfinite(desired.value).all():
            return self.fall_back(Status.INPUT_NOT_FINITE)
        return self._issue(desired)

    @exclusive
    def fall_back(self, status: Status) -> Command:
        """Return the fallback for a sample without a usable measurement or decision.

        Parameters
        ----------
        status : Status
            Why there is none.

        Returns
        -------
        Command

        Raises
        ------
        TypeError
            If it is no :class:`Status`.
        """
        validation.instance("status", status, Status, "for example Status.MEASUREMENT_NOT_FINITE")
        return self._issue(self._fall_back(status))

    def _measure(
        self, nodes: FloatArray, velocities: FloatArray
    ) -> tuple[FloatArray, Status | None]:
        """Return the state for ``_decide``, and what is wrong with the measurement."""
        return np.stack([nodes, velocities]), self._measurement_check.fault(nodes, velocities)

    def _issue(self, desired: Command) -> Command:
        """Return the nearest command within bounds; note it as the previous input and count it."""
        self._previous_input = frozen(self._within_bounds(desired.value))
        self._status_count[desired.status] += 1
        if desired.fallback is not None:
            self._fallback_count[desired.fallback] += 1
        value = self._previous_input
        if not self._actuation.is_whole:
            value = frozen(strings_of(self._actuation, value))
        return Command(value, desired.status, desired.fallback, desired.detail)

    @exclusive
    def applied(self, value: object) -> None:
        """Set the previous input, where it may differ from the last command.

        A winch may be slow, at the end of its range or stuck. Changes are limited
        from the input given here. A simulation calls this after each command, and
        before the first with the rest lengths at the start. Without it the last
        command is the previous input.

        Parameters
        ----------
        value : array_like, shape (α,)
            γ, N/m, or rest lengths, m, as the controller's ``input`` says, of all strings; those of
            passive ones say nothing.

        Raises
        ------
        TypeError, ValueError
            If it is not finite or has the wrong shape.
        """
        shape = self._actuation.input.shape
        strings = validation.shaped("value", value, shape, "one per string")
        self._previous_input = frozen(inputs_of(self._actuation, strings))

    @property
    def _previous_within_bounds(self) -> FloatArray:
        """The previous input within bounds: changes are limited from here."""
        previous = self._previous_input
        if previous is None:
            previous = self._equilibrium_input
        assert previous is not None  # a law on a plant has the second, others are asked before
        # Bounds come before the limit of change, wherever the actuators are.
        return clipped(previous, self._low, self._high)

    @property
    def _sample_bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest command of this sample, the limit of change included."""
        unknown = self._previous_input is None and self._equilibrium_input is None
        if self._change is None or unknown:
            return self._low, self._high
        previous = self._previous_within_bounds
        low, high = previous - self._change, previous + self._change
        return np.maximum(self._low, low), np.minimum(self._high, high)

    def _within_bounds(self, desired: FloatArray) -> FloatArray:
        """Return the nearest input within the bounds of this sample."""
        return clipped(desired, *self._sample_bounds)

    @exclusive
    def reset(self) -> None:
        """Forget everything that was measured, planned or applied."""
        self._previous_input = None
        self._status_count, self._fallback_count = Counter(), Counter()

    @abstractmethod
    def _decide(self, time: float, state: FloatArray) -> Command:
        """Return the desired input at a state; it need not be within bounds."""

    def _fall_back(self, status: Status) -> Command:
        """Return a safe input where there is no usable measurement or decision."""
        return self._hold(status)

    def _hold(self, status: Status) -> Command:
        """Return the previous rest lengths, or γ of the operating point if it is known."""
        usual, previous = self._equilibrium_input, self._previous_input
        if previous is not None and (self.input != "force_density" or usual is None):
            return Command(previous, status, Fallback.PREVIOUS_INPUT_HELD)
        if usual is None:
            raise ValueError(
                f"{status} at the first sample, where there is no previous input to hold: give "
                "simulate the rest_length at the start, or FunctionController an equilibrium_input"
            )
        return Command(usual, status, Fallback.EQUILIBRIUM_HELD)

    @property
    def status_count(self) -> dict[Status, int]:
        """How often each status came since the last reset."""
        return dict(self._status_count)

    @property
    def fallback_count(self) -> dict[Fallback, int]:
        """How often each fallback was taken since the last reset."""
        return dict(self._fallback_count)


class Controller(BaseController):
    """Base class of controllers designed on a linear plant: one command in each sample.

    A controller of your own is a subclass with ``_decide``. Give it ``_fall_back`` if holding the
    previous input is not safe, and ``reset`` if it has a memory. A function needs no class: see
    :class:`FunctionController`.

    Parameters
    ----------
    plant : LinearPlant
        The plant that it was designed on.
    sample_time : float or None
        Sample time, s. None for a law in continuous time, which is run at
        whatever sample time the simulation is given.
    low, high : ndarray, shape (α,)
        Least and largest command, N/m or m.
    change : ndarray, shape (α,), optional
        Largest change from the previous input, N/m or m; no limit if not given.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or no finite command is within the bounds.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> from tenscontrol.control import Command, Controller
    >>> class Damper(Controller):
    ...     def _decide(self, time, state):
    ...         rates = state[self.plant.degrees_of_freedom:]
    ...         return Command(self.plant.equilibrium_input - self.plant.B[len(rates):].T @ rates)
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> damper = Damper(plant, 0.02, np.zeros(9), np.full(9, 60.0))
    >>> str(damper.command(0.0, prism.nodes, np.zeros((3, 6))))
    'ok'
    """

    def __init__(
        self,
        plant: LinearPlant,
        sample_time: float | None,
        low: FloatArray,
        high: FloatArray,
        change: FloatArray | None = None,
    ) -> None:
        validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        self._plant = plant
        rate = plant.spectral_radius
        if sample_time is not None:
            rate = max(rate, 1 / validation.positive_number("sample_time", sample_time, "s"))
            plant.refuse_long_sample_time(sample_time)
        structure, lengths = plant.model.structure, None
        if plant.drives_bars:
            bars = member_rows(plant.input, plant.commanded)[1]
            lengths = (
                strings_of(plant.actuation, low)[bars], strings_of(plant.actuation, high)[bars]
            )  # fmt: skip
        super().__init__(
            structure, plant.input, sample_time, low, high, change,
            commanded=plant.commanded, equilibrium_input=plant.equilibrium_input,
            check=MeasurementCheck(structure, plant.nodes, rate, lengths), size=sum(plant.B.shape),
        )  # fmt: skip
        # z that a subclass predicts for the next sample; what it predicted for the last, and that.
        self._predicted: FloatArray | None = None
        self._compared: tuple[FloatArray, FloatArray] | None = None
        self._displacements, self._dimension = plant.basis, len(plant.nodes)

    @property
    def prediction_error(self) -> float | None:
        """See :attr:`BaseController.prediction_error`."""
        if self._compared is None:
            return None
        state, predicted = self._compared
        off = (state - predicted)[: self._displacements.shape[1]]
        nodes = (self._displacements @ off).reshape(-1, self._dimension)
        return float(np.sqrt((nodes * nodes).sum(axis=1).max()))

    @exclusive
    def reset(self) -> None:
        """See :meth:`BaseController.reset`."""
        super().reset()
        self._predicted = None

    @exclusive
    def fall_back(self, status: Status) -> Command:
        """See :meth:`BaseController.fall_back`."""
        self._compare(None)
        return super().fall_back(status)

    def _compare(self, state: FloatArray | None) -> None:
        """Note how far a state, None if there is none, is off what was predicted."""
        predicted, self._predicted = self._predicted, None
        self._compared = None
        if predicted is not None and state is not None:
            self._compared = state, predicted

    def twin(self) -> Controller:
        """Return a controller that decides as this one, with a memory of its own.

        Returns
        -------
        Controller
            On the same plant. Reset it before its first command.

        Raises
        ------
        TypeError
            If it has parts that cannot be copied, as locks and open files.
        """
        shared = self._plant, self._plant.model, self._structure, self._commanded
        return deepcopy(self, {id(kept): kept for kept in shared})

    @property
    def left_alone(self) -> Modes:
        """The modes of the plant that no string reaches; empty if there are none.

        To first order no command changes them: what swings in them goes on, or decays by itself.
        """
        return unreached_modes(self._plant)

    @property
    def plant(self) -> LinearPlant:
        """The linear plant that the controller was designed on."""
        return self._plant

    def _driven(self) -> Actuation:
        return self._plant.actuation

    @property
    def feet(self) -> IntArray:
        """See :attr:`BaseController.feet`."""
        return self._plant.feet

    def _measure(
        self, nodes: FloatArray, velocities: FloatArray
    ) -> tuple[FloatArray, Status | None]:
        """Return the reduced state z, and what is wrong with the measurement."""
        fault = self._measurement_check.fault(nodes, velocities)
        if fault is not None:
            return np.zeros(0), fault
        state = self._plant.coordinates.state_of(nodes, velocities)
        self._compare(state)
        return state, None


def warn_of_unreached(controller: Controller) -> None:
    """Warn of modes that a controller leaves alone and that do not decay."""
    if not len(reached_states(controller.plant).unreached_pole):
        return
    warn_of_left_alone(
        controller.left_alone,
        "no string reaches",
        "No command changes a vibration in these modes; the other modes are controlled.",
    )
