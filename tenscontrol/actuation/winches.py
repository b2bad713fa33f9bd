"""Winches, which wind strings in and out: their limits."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.motors import Motor, limits_or_none
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.fields import Field, OptionalArray, check_fields, checked, converted, optional
from tenscontrol.short_repr import short_repr

_SUBSTEPS = 10


@dataclass(frozen=True, eq=False)
class WinchMove:
    """Rest lengths that winches reach after a command. Made by :meth:`Winches.move`.

    Attributes
    ----------
    rest_length : ndarray, shape (α,)
        Rest lengths reached, m.
    rate_limited : ndarray of int
        Strings whose winch was too slow for the command.
    range_limited : ndarray of int
        Strings commanded beyond the shortest or longest rest length.
    torque_limited : ndarray of int
        Strings whose motor met its limit of torque. Only a run can tell.
    """

    rest_length: FloatArray
    rate_limited: IntArray
    range_limited: IntArray
    torque_limited: IntArray = field(default_factory=lambda: frozen(np.zeros(0, dtype=np.int64)))

    __repr__ = short_repr


_LIMITS = "rate", "shortest", "longest"


@dataclass(frozen=True, eq=False)
class Winches:
    """Limits of the winches that set the rest lengths: speed, range, motors.

    Also of the drives of bars, where lengths of bars are inputs: β values, or α of the strings and
    then β of the bars where both are.

    Parameters
    ----------
    rate : float or array_like, shape (α,), optional
        Largest speed of winding, m/s; unlimited if infinite or not given.
    shortest : float or array_like, shape (α,), optional
        Least rest length, m; 0, for any positive one, if not given.
    longest : float or array_like, shape (α,), optional
        Largest rest length, m; unlimited if infinite or not given.
    ramp : bool
        Whether rest lengths change linearly through a sample (first-order hold). If not, they
        jump at the start of a sample and stay (zero-order hold).
    substeps : int, optional
        Number of parts of a ramp, 10 if not given; more than 1 means a ramp, which is linear. In
        each part, torque and backlash of the motors are evaluated, and a Kalman filter with
        nonlinear prediction takes a step. The change of rest length in it should be below the
        stretch of the strings, T/k.
    motor : Motor, optional
        The motors: limits of torque and speed, inertia, lag, backlash. A run then reports their
        angle, speed, torque, power and energy, ``run.control.motors``.

    Raises
    ------
    TypeError, ValueError
        If a limit is no positive number, ``shortest`` exceeds ``longest``, or
        ``substeps`` is not a whole number from 1 to 10,000, or 1 for a ramp.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> winches = tc.Winches(rate=0.5, shortest=0.2)
    >>> move = winches.move(current=[0.8, 0.8], wanted=[0.79, 0.70], sample_time=0.02)
    >>> move.rest_length, move.rate_limited
    (array([0.79, 0.79]), array([1]))
    """

    rate: OptionalArray = converted(None, checked(limits_or_none, "speed in m/s"))
    shortest: OptionalArray = converted(None, checked(limits_or_none, "length in m", 0.0))
    longest: OptionalArray = converted(None, checked(limits_or_none, "length in m"))
    ramp: bool = field(
        default=False,
        metadata=checked(validation.truth, "whether rest lengths ramp through a sample"),
    )
    substeps: Field[int | None, int] = converted(
        None, optional(validation.whole_number, 1, validation.MOST_SAMPLES)
    )
    motor: Motor | None = field(
        default=None,
        metadata=optional(validation.instance, Motor, "make them by Motor(drum_radius=...)"),
    )

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        steps = self.substeps or (_SUBSTEPS if self.ramp else 1)
        if self.ramp and steps == 1:
            raise ValueError("substeps is 1, expected at least 2 for a ramp; leave out ramp=True")
        object.__setattr__(self, "ramp", steps > 1)
        object.__setattr__(self, "substeps", steps)
        given = {name: getattr(self, name) for name in _LIMITS}
        if self.motor is not None:
            given["motor.drum_radius / gear_ratio"] = self.motor.lever
        validation.member_parameters(
            {name: limit for name, limit in given.items() if limit is not None}
        )
        if self.shortest is None or self.longest is None:
            return
        if np.any(self.shortest > self.longest):
            raise ValueError(f"shortest {self.shortest} m exceeds longest {self.longest} m")

    @property
    def largest_rate(self) -> FloatArray | None:
        """Largest speed of winding, m/s: ``rate``, or less by the speed of the motors."""
        if self.motor is None or self.motor.speed is None:
            return self.rate
        rate = self.motor.speed * self.motor.lever
        return np.asarray(rate if self.rate is None else np.minimum(rate, self.rate))

    @property
    def jumps(self) -> bool:
        """Whether rest lengths jump at the start of a sample in place of moving through it."""
        return not self.ramp and not self.has_drive

    @property
    def degree(self) -> int:
        """Degree of the polynomials in time that rest lengths follow within a tick."""
        if self.jumps:
            return 0
        return 2 if self.motor is not None and self.motor.inertia.any() else 1

    @property
    def ticks(self) -> int:
        """Equal parts of a sample, in each of which a rest length moves as one polynomial."""
        motor = self.motor
        if self.jumps or motor is None:
            return 1
        if self.has_drive or motor.torque is not None or motor.backlash.any():
            return self.substeps if self.ramp else _SUBSTEPS
        return 1

    @property
    def has_drive(self) -> bool:
        """Whether motors have a lag or an inertia: they never jump."""
        return self.motor is not None and bool(self.motor.lag.any() or self.motor.inertia.any())

    def range(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Return the shortest and the longest rest length of each of so many strings, m.

        Parameters
        ----------
        count : int
            α.

        Returns
        -------
        shortest, longest : ndarray, shape (α,)
            m; 0 and inf where there is no limit.

        Raises
        ------
        TypeError, ValueError
            If it is no such number, or the limits are of another number of strings.
        """
        count = validation.whole_number("count", count, 0)
        low = np.asarray(0.0 if self.shortest is None else self.shortest)
        high = np.asarray(np.inf if self.longest is None else self.longest)
        for name, limit in (("shortest", low), ("longest", high)):
            validation.one_or_per_member(f"winches.{name}", limit, count)
        return np.full(count, low), np.full(count, high)

    def refuse_out_of_range(
        self, name: str, rest_length: FloatArray, strings: IntArray | None = None
    ) -> None:
        """Raise if a rest length is out of the range of its winch, and name the string.

        Parameters
        ----------
        name : str
            What the message calls them.
        rest_length : ndarray, shape (α,)
            m.
        strings : ndarray of int, optional
            Those that have a winch; all if not given.
        """
        rest_length = validation.float_array("rest_length", rest_length)
        if rest_length.ndim != 1:
            raise ValueError(f"rest_length has shape {rest_length.shape}, expected one per string")
        low, high = self.range(len(rest_length))
        out = np.flatnonzero((rest_length < low) | (rest_length > high))
        if strings is not None:
            out = np.intersect1d(
                out, validation.index_list("strings", strings, len(low), "strings")
            )
        if len(out):
            i = out[0]
            raise ValueError(
                f"{name}[{i}] is {rest_length[i]:g} m, expected "
                f"{validation.span(low[i], high[i], 'm')}: the range of the winches"
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
        start, goal = validation.vector("current", current), validation.vector("wanted", wanted)
        sample_time = validation.positive_number("sample_time", sample_time, "s")
        if start.ndim != 1 or goal.shape != start.shape:
            raise ValueError(
                f"current has shape {start.shape} and wanted {goal.shape}, expected (α,) twice: "
                "one rest length per string"
            )
        validation.positive("current", start, "rest length in m")
        validation.positive("wanted", goal, "rest length in m")
        if self.rate is not None:
            validation.one_or_per_member("rate", self.rate, len(start))
        within = np.clip(goal, *self.range(len(start)))
        rate = self.largest_rate
        reached = within_reach(within, start, np.inf if rate is None else rate * sample_time)
        return WinchMove(
            frozen(reached),
            frozen(np.flatnonzero(reached != within)),
            frozen(np.flatnonzero(within != goal)),
        )


def within_reach(goal: Any, start: Any, reach: Any) -> Any:
    """Return what comes next to a goal, m, at most so far from a start."""
    return np.clip(goal, start - reach, start + reach)
