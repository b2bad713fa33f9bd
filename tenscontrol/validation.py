"""Checks of user input, with messages that say what was found, what is expected and what to do."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tenscontrol.limits import LARGEST_WHOLE

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Squares and fourth powers must stay within double precision.
LARGEST = 1e70


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only copy of an array, so that a value handed out cannot change."""
    copy = np.array(array, order="C", copy=True)
    copy.setflags(write=False)
    return copy


def freeze_arrays(record: object) -> None:
    """Make the arrays of a frozen dataclass read-only, when it is made."""
    for name, value in vars(record).items():
        if isinstance(value, np.ndarray):
            object.__setattr__(record, name, frozen(value))


_KIND = {"b": "bool", "c": "complex", "U": "text (str)", "S": "bytes", "M": "datetime"}


def _brief(value: object) -> str:
    """Return a value as text that fits in a message."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python writes no whole number of more than 4300 digits
        return "beyond 1e4000"
    return text if len(text) <= 60 else text[:57] + "..."


def float_array(name: str, value: object) -> FloatArray:
    """Return ``value`` as a finite float array, or say which entry is not a finite number."""
    array = _real_array(name, value)
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        where = "" if array.ndim == 0 else f"[{', '.join(str(i) for i in bad[0])}]"
        raise ValueError(
            f"{name}{where} is {array[tuple(bad[0])]}, expected a finite number; "
            f"{len(bad)} of {array.size} entries are not finite"
        )
    return array


def measured(
    name: str, value: object, shape: tuple[int, ...], meaning: str = "one column per node"
) -> FloatArray:
    """Return a measurement as an array of this shape; it may hold what is not finite."""
    array = _real_array(name, value)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}: {meaning}")
    return array


def _real_array(name: str, value: object) -> FloatArray:
    """Return ``value`` as a new float array, if it is made of real numbers."""
    if value is None:
        raise TypeError(f"{name} is None, expected an array of real numbers")
    if isinstance(value, np.ma.MaskedArray):
        raise TypeError(f"{name} is a masked array, expected one without a mask: fill or drop")
    try:
        given = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name} must be an array of real numbers: {error}") from None
    if given.dtype.kind not in "iuf":
        kind = _KIND.get(given.dtype.kind, type(value).__name__)
        raise TypeError(
            f"{name} must be an array of real numbers; found {_brief(value)} of type {kind}"
        )
    return given.astype(float)


def shaped(name: str, value: object, shape: tuple[int, ...], meaning: str) -> FloatArray:
    """Return ``value`` as a finite float array of exactly this shape."""
    array = float_array(name, value)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}: {meaning}")
    return array


def per_member(name: str, value: object, count: int, member: str) -> FloatArray:
    """Return one finite float a member: a scalar is repeated, a vector must fit."""
    array = float_array(name, value)
    if array.ndim == 0:
        return np.full(count, float(array))
    if array.shape != (count,):
        raise ValueError(
            f"{name} has shape {array.shape}, expected () or ({count},): "
            f"one number for all, or one per {member}"
        )
    return array


def one_or_per_string(name: str, array: FloatArray, count: int) -> None:
    """Refuse an array that is neither one number nor one per string."""
    if array.shape not in ((), (count,)):
        raise ValueError(
            f"{name} has shape {array.shape}, expected () or ({count},): one number, or one per "
            "string"
        )


def refuse_fractions(name: str, array: FloatArray) -> None:
    """Refuse an array, shape (k,), with an entry that is not a whole number."""
    bad = np.flatnonzero(array != np.floor(array))
    if len(bad):
        raise TypeError(f"{name}[{bad[0]}] is {array[bad[0]]:g}, expected a whole number")


def indices(name: str, value: FloatArray, count: int, of: str, noun: str = "") -> IntArray:
    """Return whole numbers from 0 to ``count - 1``, shape (k,), or say which one is not."""
    refuse_fractions(name, value)
    bad = np.flatnonzero((value < 0) | (value >= count))
    if len(bad):
        raise ValueError(
            f"{name}[{bad[0]}] is {noun}{value[bad[0]]:g}, expected 0 to {count - 1}: {of}, "
            "counted from 0"
        )
    return value.astype(np.int64)


def direction(name: str, value: object) -> FloatArray:
    """Return a direction in space as a vector of length 1, shape (3,)."""
    vector = shaped(name, value, (3,), "a direction")
    if not vector.any():
        raise ValueError(f"{name} is 0, expected a direction")
    return np.asarray(vector / np.linalg.norm(vector))


def positive(name: str, array: FloatArray, what: str) -> FloatArray:
    """Refuse an array with an entry that is not greater than zero."""
    bad = np.flatnonzero(array <= 0)
    if len(bad):
        raise ValueError(f"{name}[{bad[0]}] is {array[bad[0]]:g}, expected a positive {what}")
    return array


def non_negative(name: str, array: FloatArray, why: str) -> FloatArray:
    """Refuse an array with an entry below zero."""
    bad = np.flatnonzero(array < 0)
    if len(bad):
        raise ValueError(f"{name}[{bad[0]}] is {array[bad[0]]:g}, expected at least 0: {why}")
    return array


def positive_number(name: str, value: object, unit: str) -> float:
    """Return a positive finite number."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise TypeError(f"{name} is {_brief(value)}, expected a positive number in {unit}")
    try:
        number = float(value)
    except OverflowError:
        number = np.inf
    if not 1 / LARGEST <= number <= LARGEST:
        raise ValueError(
            f"{name} is {_brief(value)}, expected a positive finite number in {unit}, between "
            f"{1 / LARGEST:g} and {LARGEST:g}, so that squares stay within double precision"
        )
    return number


def whole_number(name: str, value: object, least: int, most: int = LARGEST_WHOLE) -> int:
    """Return an integer from ``least`` to ``most``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name} is {_brief(value)}, expected a whole number of at least {least}")
    if value < least:
        raise ValueError(f"{name} is {_brief(value)}, expected a whole number of at least {least}")
    if value > most:
        raise ValueError(f"{name} is {_brief(value)}, expected a whole number of at most {most}")
    return int(value)


def choice(name: str, value: object, options: Iterable[str]) -> str:
    """Return a string that is one of the options."""
    allowed = tuple(options)
    if not isinstance(value, str) or value not in allowed:
        quoted = ", ".join(repr(option) for option in allowed)
        raise ValueError(f"{name} is {value!r}, expected one of {quoted}")
    return value


def identifier(name: str, value: object) -> str:
    """Return a string that can be the name of a group."""
    if not isinstance(value, str) or not value.isidentifier():
        raise ValueError(f"{name} is {value!r}, expected a name of letters, digits and _")
    return value


def truth(name: str, value: object, meaning: str) -> bool:
    """Return True or False, and refuse what only looks like it."""
    if not isinstance(value, bool | np.bool_):
        raise TypeError(
            f"{name} is {_brief(value)} ({type(value).__name__}), expected True or False: {meaning}"
        )
    return bool(value)


def member_parameters(parameters: dict[str, FloatArray]) -> None:
    """Refuse parameters that are not one number, or one per string, of one count."""
    for name, array in parameters.items():
        if array.ndim > 1 or array.size == 0:
            raise ValueError(
                f"{name} has shape {array.shape}, expected one number, or one per string"
            )
    counts = {array.shape for array in parameters.values() if array.ndim == 1}
    if len(counts) > 1:
        found = ", ".join(f"{name} {array.shape}" for name, array in parameters.items())
        raise ValueError(f"shapes do not go together: {found}; expected one count of strings")


def refuse_overflow(name: str, array: FloatArray, unit: str) -> None:
    """Refuse an array with entries whose products and squares would overflow."""
    largest = float(np.abs(array).max(initial=0.0))
    if largest > LARGEST:
        raise ValueError(
            f"{name} has entries up to {largest:g} {unit}, expected at most {LARGEST:g} {unit}: "
            "products and squares would overflow"
        )


def wrong_kind(name: str, value: object, expected: str) -> TypeError:
    """Return the error of a value that is of another kind."""
    return TypeError(f"{name} is a {type(value).__name__}, expected {expected}")


def instance(name: str, value: object, kind: type, how: str) -> None:
    """Refuse a value of the wrong class and say where the right one comes from."""
    if not isinstance(value, kind):
        raise wrong_kind(name, value, f"{kind.__name__}: {how}")
