"""Motors of winches: their limits and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.fields import Array, OptionalArray, check_fields, checked, converted, optional
from tenscontrol.short_repr import short_repr

# Numbers that need not be given.
_ABSENT = {"torque": np.inf, "speed": np.inf, "zero": np.nan}


class EachMotor(NamedTuple):
    """Numbers of motors, one entry a string, shape (α,) each."""

    lever: FloatArray  # rest length wound for each radian, m
    torque: FloatArray  # N m; infinite where there is no limit
    inertia: FloatArray  # kg m²
    lag: FloatArray  # s
    play: FloatArray  # rest length within the play of the drum, m
    zero: FloatArray  # rest length at angle zero, m; not finite where it is that at the start
    rate: FloatArray  # rest length wound at the largest speed, m/s; infinite where there is none

    @classmethod
    def of(cls, numbers: Mapping[str, Any]) -> EachMotor:
        """Return what follows of the numbers of :class:`Motor`, or of ones with derivatives."""
        lever = numbers["drum_radius"] / numbers["gear_ratio"]
        play = numbers["backlash"] * numbers["drum_radius"]
        torque, inertia, lag, zero = (
            numbers[name] for name in ("torque", "inertia", "lag", "zero")
        )
        return cls(lever, torque, inertia, lag, play, zero, numbers["speed"] * lever)

    @property
    def most_tension(self) -> FloatArray:
        """Force that the largest torque holds, N."""
        return self.torque / self.lever


# Checks of one number each, or one per string.


def _size(name: str, value: object, meaning: str) -> FloatArray:
    array = validation.vector(name, value)
    validation.positive(name, np.atleast_1d(array), meaning)
    return array


def _size_or_zero(name: str, value: object, meaning: str) -> FloatArray:
    array = validation.vector(name, value)
    validation.non_negative(name, np.atleast_1d(array), f"{meaning}, 0 for none")
    return array


def limits_or_none(
    name: str, value: object, meaning: str, none: float = np.inf
) -> FloatArray | None:
    """Return limits, positive, of which some may be ``none``; None if all are."""
    array = validation.limits(name, value, none)
    if not (array != none).any():
        return None
    if none:
        validation.positive(name, np.atleast_1d(array), meaning)
    else:
        validation.non_negative(name, np.atleast_1d(array), f"{meaning}, 0 for any")
    return array


@dataclass(frozen=True, eq=False)
class Motor:
    """Motors of the winches, with gears and drums: one number for all, or one per string.

    A positive angle winds the string in: ``l0 = zero − (r/G) θ`` with drum radius r and gear ratio
    G. The torque of a motor is ``τ = F r/G + J dω/dt``. F is the force on the drum: the negative
    derivative of the elastic energy of the string by its rest length. It is the tension of a
    linear string, and ``T (1 + ε/2)`` of an elastic string with strain ε. Gears have no losses.
    String damping acts between the ends of a string and gives no torque.

    Parameters
    ----------
    drum_radius : float or array_like, shape (α,)
        Radius r of the drum, m.
    gear_ratio : float or array_like, shape (α,)
        Turns of the motor for one turn of the drum: G.
    torque : float or array_like, shape (α,), optional
        Largest torque of the motor, N m; unlimited if infinite or not given. Where the tension
        needs more, a brake gives the rest: the winch holds or pays out, but does not wind in. A
        drum that pays out some strings as it winds others holds or turns with the pull.
    speed : float or array_like, shape (α,), optional
        Largest speed of the motor, rad/s; unlimited if infinite or not given.
    inertia : float or array_like, shape (α,)
        Inertia J of the rotor, with that of the drum by 1/G², kg m². A motor with inertia needs
        ``torque``, from which its acceleration follows; it then moves with a speed that does not
        jump.
    lag : float or array_like, shape (α,)
        Time constant T of the drive, s: the rest length follows by ``(r − l0)/T``. The reference r
        is the command, or the ramp from the last command to it.
    backlash : float or array_like, shape (α,)
        Play of the drum, rad: after a reversal the motor turns the drum only when the play is
        taken up. At the start the drum is in the middle of it.
    zero : float or array_like, shape (α,), optional
        Rest length at which the angle is zero, m; that at the start of a run if not given.

    Raises
    ------
    TypeError, ValueError
        If a number is not finite or not positive (inertia, lag and backlash may be 0, torque and
        speed infinite), shapes do not go together, or there is inertia without torque.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> motor = tc.Motor(drum_radius=0.01, gear_ratio=20.0, torque=0.05, speed=400.0, zero=0.8)
    >>> tc.Winches(rate=0.5, motor=motor).largest_rate  # 400 rad/s × 0.01 m / 20
    array(0.2)
    >>> motor.angle([0.8, 0.79]).round(6), motor.rest_length([0.0, 20.0])
    (array([ 0., 20.]), array([0.8 , 0.79]))
    """

    drum_radius: Array = converted(metadata=checked(_size, "radius in m"))
    gear_ratio: Array = converted(1.0, checked(_size, "ratio"))
    torque: OptionalArray = converted(None, checked(limits_or_none, "torque in N m"))
    speed: OptionalArray = converted(None, checked(limits_or_none, "speed in rad/s"))
    inertia: Array = converted(0.0, checked(_size_or_zero, "moment of inertia in kg m²"))
    lag: Array = converted(0.0, checked(_size_or_zero, "time in s"))
    backlash: Array = converted(0.0, checked(_size_or_zero, "angle in rad"))
    zero: OptionalArray = converted(None, optional(_size, "rest length in m"))

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        validation.member_parameters(
            {name: value for name, value in vars(self).items() if value is not None}
        )
        torque = np.inf if self.torque is None else self.torque
        if np.any((self.inertia > 0) & (torque == np.inf)):
            raise ValueError(
                "inertia needs torque, N m: the largest acceleration of a motor follows from both"
            )

    @property
    def lever(self) -> FloatArray:
        """Rest length wound for each radian of the motor, r/G, m."""
        return np.asarray(self.drum_radius / self.gear_ratio)

    def angle(self, rest_length: object, zero: object = None) -> FloatArray:
        """Return the angles of the motors at rest lengths, rad: commands in radians.

        Parameters
        ----------
        rest_length : array_like, shape (α,) or (α, K)
            m.
        zero : float or array_like, shape (α,), optional
            Rest length at which the angle is zero, m; that of the motor if not given.

        Returns
        -------
        ndarray, of the shape of ``rest_length``
            Positive where shorter than ``zero``. Backlash is not made up for.
        """
        length, zero_length, lever = self._together("rest_length", rest_length, zero)
        return np.asarray((zero_length - length) / lever)

    def rest_length(self, angle: object, zero: object = None) -> FloatArray:
        """Return the rest lengths at angles of the motors, m; the inverse of :meth:`angle`.

        Parameters
        ----------
        angle : array_like, shape (α,) or (α, K)
            rad.
        zero : float or array_like, shape (α,), optional
            As for :meth:`angle`.

        Returns
        -------
        ndarray, of the shape of ``angle``
        """
        angles, zero_length, lever = self._together("angle", angle, zero)
        return np.asarray(zero_length - lever * angles)

    def _together(self, name: str, value: object, zero: object) -> tuple[FloatArray, ...]:
        """Return values, the rest length at angle zero, and levers, to be computed with."""
        array = validation.float_array(name, value)
        if array.ndim not in (1, 2):
            raise ValueError(f"{name} has shape {array.shape}, expected (α,) or (α, K)")
        if zero is None and self.zero is None:
            raise ValueError("zero is not known: give the rest length at which the angle is 0, m")
        length = _for_each("zero", self.zero if zero is None else zero, name, array)
        validation.positive("zero", length, "rest length in m")
        lever = _for_each("drum_radius / gear_ratio", self.lever, name, array)
        if array.ndim == 2:
            return array, length[:, None], lever[:, None]
        return array, length, lever


def _for_each(label: str, value: object, name: str, array: FloatArray) -> FloatArray:
    """Return a number of motors for each row of an array that is called ``name``."""
    numbers = validation.float_array(label, value)
    if numbers.shape not in ((), (len(array),)):
        raise ValueError(
            f"{name} has shape {array.shape}, and {label} {numbers.shape}: expected one number for "
            "all strings, or as many"
        )
    return np.broadcast_to(numbers, len(array)).copy()


def motor_numbers(motor: Motor | None, count: int) -> dict[str, FloatArray]:
    """Return the numbers of motors that are there, one a string, by names as ``"motor.torque"``."""
    numbers = {} if motor is None else vars(motor)
    return {
        f"motor.{name}": np.broadcast_to(value, (count,))
        for name, value in numbers.items()
        if value is not None and np.any(value)
    }


def with_motor_numbers(motor: Motor, values: Mapping[str, FloatArray]) -> Motor:
    """Return motors with other numbers, by the names of :func:`motor_numbers`."""
    changes: dict[str, Any] = {name.removeprefix("motor."): value for name, value in values.items()}
    return replace(motor, **changes) if changes else motor


def each_motor(motor: Motor | None, count: int) -> EachMotor:
    """Return the numbers of each motor, for so many strings, or raise if they do not fit."""
    for name, value in ({} if motor is None else vars(motor)).items():
        if value is not None:
            validation.one_or_per_member(f"motor.{name}", value, count)

    return EachMotor.of(all_numbers(motor, count))


def all_numbers(motor: Motor | None, count: int) -> dict[str, FloatArray]:
    """Return all numbers of motors by name, for so many strings; infinite where there is no limit.

    Of no motor those of one that moves at once, with any torque.
    """
    numbers = vars(Motor(drum_radius=1.0) if motor is None else motor)
    return {
        name: np.broadcast_to(_ABSENT[name] if value is None else value, (count,))
        for name, value in numbers.items()
    }
