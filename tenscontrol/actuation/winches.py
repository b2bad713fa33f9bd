"""Winches: what they can do to a rest length within a sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.limits import MOST_SAMPLES
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    float_array,
    frozen,
    member_parameters,
    one_or_per_string,
    positive,
    positive_number,
    truth,
    whole_number,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


_SUBSTEPS = 10

_UNITS = (("rate", "speed in m/s"), ("shortest", "length in m"), ("longest", "length in m"))


@dataclass(frozen=True, eq=False)
class WinchMove:
    """What winches made of a command. Made by :meth:`Winches.move`.

    Attributes
    ----------
    rest_length : ndarray, shape (α,)
        Rest lengths reached, m.
    rate_limited : ndarray of int
        Strings whose winch was too slow for the command.
    range_limited : ndarray of int
        Strings commanded beyond the shortest or longest rest length.
    """

    rest_length: FloatArray
    rate_limited: IntArray
    range_limited: IntArray


@dataclass(frozen=True, eq=False)
class Winches:
    """Limits of the winches that set the rest lengths.

    Parameters
    ----------
    rate : float or array_like, shape (α,), optional
        Largest speed of winding, m/s; unlimited if not given.
    shortest, longest : float or array_like, shape (α,), optional
        Range of the rest length, m; any positive length if not given.
    ramp : bool
        Whether rest lengths ramp through a sample (first-order hold). If not, a winch
        jumps at the start of a sample and stands still (zero-order hold).
    substeps : int, optional
        Equal steps that a ramp is made of, 10 if not given; more than 1 means a ramp. A step should
        be shorter than the stretch of the strings, T/k.

    Raises
    ------
    TypeError, ValueError
        If a limit is not a positive finite number, ``shortest`` exceeds ``longest``, or
        ``substeps`` is not a whole number from 1 to 10,000, or 1 for a ramp.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> winches = tc.Winches(rate=0.5, shortest=0.2)
    >>> move = winches.move(current=[0.8, 0.8], wanted=[0.79, 0.70], sample_time=0.02)
    >>> move.rest_length, move.rate_limited
    (array([0.79, 0.79]), array([1]))
    """

    rate: FloatArray | None = None
    shortest: FloatArray | None = None
    longest: FloatArray | None = None
    ramp: bool = False
    substeps: int = None  # type: ignore[assignment]  # an int from __post_init__ on

    if TYPE_CHECKING:  # arguments are anything array-like, attributes are arrays

        def __init__(
            self,
            rate: ArrayLike | None = None,
            shortest: ArrayLike | None = None,
            longest: ArrayLike | None = None,
            ramp: bool = False,
            substeps: int | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        ramp = truth("ramp", self.ramp, "whether rest lengths ramp through a sample")
        steps = _SUBSTEPS if ramp else 1
        if self.substeps is not None:
            steps = whole_number("substeps", self.substeps, 1, MOST_SAMPLES)
        if ramp and steps == 1:
            raise ValueError("substeps is 1, expected at least 2 for a ramp; leave out ramp=True")
        object.__setattr__(self, "ramp", steps > 1)
        object.__setattr__(self, "substeps", steps)
        limits = {}
        for name, unit in _UNITS:
            value = getattr(self, name)
            if value is not None:
                limits[name] = float_array(name, value)
                positive(name, np.atleast_1d(limits[name]), unit)
                object.__setattr__(self, name, frozen(limits[name]))
        member_parameters(limits)
        if self.shortest is None or self.longest is None:
            return
        if np.any(self.shortest > self.longest):
            raise ValueError(f"shortest {self.shortest} m exceeds longest {self.longest} m")

    def refuse_out_of_range(self, name: str, rest_length: FloatArray) -> None:
        """Raise if a rest length is out of the range of its winch, and name the string.

        Parameters
        ----------
        name : str
            What the message calls them.
        rest_length : ndarray, shape (α,)
            m.
        """
        low = 0.0 if self.shortest is None else self.shortest
        high = np.inf if self.longest is None else self.longest
        rest_length = float_array("rest_length", rest_length)
        shape = np.broadcast_shapes(np.shape(low), np.shape(high))
        if rest_length.ndim != 1 or shape not in ((), rest_length.shape):
            raise ValueError(f"rest_length has shape {rest_length.shape}, expected one per string")
        out = np.flatnonzero((rest_length < low) | (rest_length > high))
        if len(out):
            i = out[0]
            least, most = (np.broadcast_to(limit, rest_length.shape)[i] for limit in (low, high))
            raise ValueError(
                f"{name}[{i}] is {rest_length[i]:g} m, expected {least:g} to {most:g} m: "
                "the range of the winches"
            )

    def move(self, current: object, wanted: object, sample_time: float) -> WinchMove:
        """Return the rest lengths reached from ``current`` towards ``wanted`` in one sample.

        Parameters
        ----------
        current, wanted : array_like, shape (α,)
            Rest lengths, m.
        sample_time : float
            Sample time, s.
        """
        start = float_array("current", current)
        goal = float_array("wanted", wanted)
        sample_time = positive_number("sample_time", sample_time, "s")
        if start.ndim != 1 or goal.shape != start.shape:
            raise ValueError(
                f"current has shape {start.shape} and wanted {goal.shape}, expected (α,) twice: "
                "one rest length per string"
            )
        positive("current", start, "rest length in m")
        positive("wanted", goal, "rest length in m")
        for name, _ in _UNITS:
            value = getattr(self, name)
            if value is not None:
                one_or_per_string(name, value, len(start))
        low = -np.inf if self.shortest is None else self.shortest
        high = np.inf if self.longest is None else self.longest
        within = np.clip(goal, low, high)
        reach = np.inf if self.rate is None else self.rate * sample_time
        reached = np.clip(within, start - reach, start + reach)
        return WinchMove(
            frozen(reached),
            frozen(np.flatnonzero(reached != within)),
            frozen(np.flatnonzero(within != goal)),
        )
