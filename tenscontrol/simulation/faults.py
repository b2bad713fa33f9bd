"""Faults in a simulation: cut strings, stuck winches, lost measurements."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray

# A cut string is given a rest length of so many sizes of the structure: it is slack for good.
_SLACK = 1e6


class Fault(ABC):
    """A fault during a simulation; see :func:`simulate`."""

    time: float
    until: float | None = None

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"

    def __post_init__(self) -> None:
        if hasattr(self, "string"):
            object.__setattr__(
                self, "string", validation.whole_number("string", self.string, least=0)
            )
        time = validation.float_array("time", self.time)
        if time.ndim != 0 or time < 0:
            raise ValueError(f"time is {self.time}, expected a time in s of at least 0")
        object.__setattr__(self, "time", float(time))
        if self.until is not None:
            end = (
                None
                if validation.is_unlimited(self.until)
                else validation.positive_number("until", self.until, "s")
            )
            if end is not None and end <= self.time:
                raise ValueError(f"until is {end:g} s, expected after time, {self.time:g} s")
            object.__setattr__(self, "until", end)

    @property
    def start(self) -> float:
        """When it begins, s."""
        return self.time

    @property
    def end(self) -> float:
        """End, s; infinite if it never ends."""
        return np.inf if self.until is None else self.until

    @property
    @abstractmethod
    def label(self) -> str:
        """What fails, in a few words."""


@final
@dataclass(frozen=True)
class CutString(Fault):
    """A string that is cut at a given time.

    From exactly that time the γ of the string is 0, whatever is commanded: integration stops
    there and starts again. Where rest lengths are the input, that of the string is set to a
    million times the size of the structure, so that it stays slack. The energy that it stored is
    lost (:attr:`Trajectory.released_energy`). The controller is not informed.

    Parameters
    ----------
    string : int
        Number of the string, from 0, of the model. In a subdivided structure it is a segment: the
        others of its string stay where they are, and dangle. A clustered string carries nothing on
        its whole length.
    time : float
        When it is cut, s, at least 0.

    Raises
    ------
    TypeError, ValueError
        If ``string`` is not a whole number or ``time`` not a finite one of at least 0.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> gamma = tc.prestress(prism, force_density=10.0).force_density
    >>> cut = tc.CutString(string=6, time=0.1)
    >>> run = tc.simulate(tc.Model(prism), 0.2, force_density=gamma, faults=[cut])
    >>> run.force_density[6, [0, -1]].round(2), round(float(run.released_energy[-1]), 2)
    (array([17.32,  0.  ]), 9.24)
    """

    string: int
    time: float

    @property
    def label(self) -> str:
        """Which string is cut."""
        return f"string {self.string} cut"


@final
@dataclass(frozen=True)
class StuckWinch(Fault):
    """A winch that is stuck for a time: it keeps its rest length, or its γ.

    Commands at samples from ``time`` up to, but not at, ``until`` have no effect. The controller is
    told the input that was applied (:meth:`Controller.applied`).

    Parameters
    ----------
    string : int
        Number of the string, from 0, among those that the controller commands: for the controller
        of a parent structure, a string of the parent.
    time : float
        When it sticks, s, at least 0. At 0 it holds what ``rest_length`` of :func:`simulate` says.
    until : float, optional
        When it is free again, s; never if infinite or not given.

    Raises
    ------
    TypeError, ValueError
        If ``string`` is not a whole number, a time is not a finite one of at
        least 0, or ``until`` is not after ``time``.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.StuckWinch(string=5, time=0.8, until=1.5).label
    'winch 5 stuck'
    """

    string: int
    time: float
    until: float | None = None

    @property
    def label(self) -> str:
        """Which winch is stuck."""
        return f"winch {self.string} stuck"


@final
@dataclass(frozen=True)
class LostMeasurement(Fault):
    """A period without measurements.

    The controller receives NaN for positions and velocities. With an estimator, the readings of
    this period are lost, and the controller receives the estimate without them.

    Parameters
    ----------
    time : float
        From when on samples are lost, s, at least 0.
    until : float or None
        From when on samples are measured again, s; never if None or inf.

    Raises
    ------
    TypeError, ValueError
        If a time is not a finite one of at least 0, or ``until`` is not after ``time``.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.LostMeasurement(time=0.5, until=0.7).end
    0.7
    """

    time: float
    until: float | None

    @property
    def label(self) -> str:
        """What is lost."""
        return "measurement lost"


class Faults:
    """The faults of a run, checked, of a structure of a size, m, under an input of a kind."""

    def __init__(self, faults: Any, size: float, input: str) -> None:
        faults = () if faults is None else faults
        is_list = type(faults) in (list, tuple)
        if not is_list and (isinstance(faults, Fault) or not isinstance(faults, Sequence)):
            raise TypeError(
                f"faults is a {type(faults).__name__}, expected a list, like "
                "[CutString(string=3, time=1.0)]"
            )
        for i, fault in enumerate(faults):
            how = "make one by CutString(...), StuckWinch(...) or LostMeasurement(...)"
            validation.instance(f"faults[{i}]", fault, Fault, how)
        self.listed: tuple[Fault, ...] = tuple(faults)
        self._cuts = [fault for fault in faults if isinstance(fault, CutString)]
        #: Whether strings are cut.
        self.cuts = bool(self._cuts)
        self._stuck = [fault for fault in faults if isinstance(fault, StuckWinch)]
        self._lost = [fault for fault in faults if isinstance(fault, LostMeasurement)]
        self._slack = 0.0 if input == "force_density" else _SLACK * size

    def refuse_unknown(self, strings: int, winches: int | None) -> None:
        """Refuse indices beyond the model's strings, or the winches; None without a controller."""
        for i, fault in enumerate(self.listed):
            if isinstance(fault, CutString):
                _refuse_index(i, fault.string, strings, "strings in the model")
                continue
            if winches is None:
                raise ValueError(
                    f"faults[{i}] is a {type(fault).__name__}, which goes with a controller; "
                    "in open loop a string can be cut"
                )
            if isinstance(fault, StuckWinch):
                _refuse_index(i, fault.string, winches, "strings of the controller")

    def cut_times(self, start: float, end: float) -> list[float]:
        """Return when strings are cut after ``start`` and before ``end``, ascending, s."""
        return sorted({cut.time for cut in self._cuts if start < cut.time < end})

    def without_cut(self, held: FloatArray, time: float) -> FloatArray:
        """Return the input held, shape (α,), with that of strings cut by a time replaced.

        Or coefficients of polynomials, one row a quantity, those of the strings first.
        """
        cut = [fault.string for fault in self._cuts if fault.time <= time] if self.cuts else ()
        if not cut:
            return held
        left = held.copy()
        left[cut] = 0.0
        left.reshape(len(left), -1)[cut, 0] = self._slack
        return left

    def stuck(self, time: float) -> IntArray:
        """Return which winches are stuck at a time, s."""
        return np.array([f.string for f in self._stuck if f.start <= time < f.end], dtype=np.int64)

    def lost(self, time: float) -> bool:
        """Return whether there is no measurement at a time, s."""
        return any(fault.start <= time < fault.end for fault in self._lost)


def _refuse_index(place: int, string: int, count: int, things: str) -> None:
    if string >= count:
        raise ValueError(
            f"faults[{place}].string is {string}, expected 0 to {count - 1}: there are "
            f"{count} {things}, counted from 0"
        )
