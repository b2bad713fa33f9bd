"""Checks of user input, with messages that say what was found, what is expected and what to do."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Iterable, Mapping, Set
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from tenscontrol.arrays import ArrayRecord, FloatArray, IntArray

# Squares and fourth powers must stay within double precision.
LARGEST = 1e70
_LEAST, _LARGEST_SQUARE = 1 / LARGEST, LARGEST**2

# Relative size of what counts as round-off in a weight matrix: of its asymmetry, which products of
# matrices and Riccati equations leave, and of an eigenvalue below zero.
_SYMMETRIC = 1e-9
_SEMIDEFINITE = 1e-12

# How much one call may ask for: memory, time, and whole numbers that compiled code can count with.
# Far above what is sensible, and far below what ends a process or a day.

#: C code, CasADi and OSQP count in 32 bits.
LARGEST_WHOLE = 2**31 - 1
#: The seeds of NumPy's generators hold 128 bits.
LARGEST_SEED = 2**128 - 1
#: Runs, outputs and draws of one call.
MOST_RUNS = 10_000_000
#: Samples of a horizon or a delay, and substeps of a sample.
MOST_SAMPLES = 10_000
#: Plants and controllers that one call designs.
MOST_DESIGNS = 1_000

#: Seconds that a call may take, or wait for a program: a day.
LONGEST_WAIT = 86_400.0

_MOST_BYTES = 4e9


# So many numbers have a scalar product in one thread.
_FEW = 4096

# Kinds of numbers; the last are whole numbers to Python and NumPy.
_WHOLE, _REAL, _TRUTH = (int, np.integer), (float, np.floating), (bool, np.bool_)
_NUMBERS, _NO_NUMBERS = (*_WHOLE, *_REAL), (bool, np.timedelta64)

_KIND = {"b": "bool", "c": "complex", "U": "text (str)", "S": "bytes", "M": "datetime"}


def _brief(value: object) -> str:
    """Return a value as text that fits in a message."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python writes no whole number of more than 4300 digits
        return "beyond 1e4000"
    return text if len(text) <= 60 else text[:57] + "..."


def float_array(name: str, value: object) -> FloatArray:
    """Return ``value`` as a finite float array, or say which entry is none or is too large."""
    array = real_array(name, value)
    if not is_bounded(array):
        bad = np.argwhere(~(np.abs(array) <= LARGEST))
        where = "" if array.ndim == 0 else f"[{', '.join(str(i) for i in bad[0])}]"
        entry = array[tuple(bad[0])]
        if np.isfinite(entry):
            raise ValueError(f"{name}{where} is {entry:g}, expected at most {LARGEST:g} in size")
        raise ValueError(
            f"{name}{where} is {entry}, expected a finite number; "
            f"{array.size - int(np.isfinite(array).sum())} of {array.size} entries are not finite"
        )
    return array


def is_bounded(array: FloatArray) -> bool:
    """Return whether all entries are finite numbers, and none is too large."""
    # As a rule the squares of few numbers tell, in a third of the time; of many, BLAS would start
    # threads. What is not a number makes all of it false.
    if array.size <= _FEW and np.vdot(array, array) <= _LARGEST_SQUARE:
        return True
    least = np.minimum.reduce(array, axis=None, initial=0.0)
    return bool(least >= -LARGEST and np.maximum.reduce(array, axis=None, initial=0.0) <= LARGEST)


def vector(name: str, value: object) -> FloatArray:
    """Return ``value`` as a finite float array; a column, shape (k, 1), as a vector, shape (k,)."""
    return _flat(float_array(name, value))


def _flat(array: FloatArray) -> FloatArray:
    """Return a column, shape (k, 1), as a vector; other arrays as they are."""
    return array[:, 0] if array.ndim == 2 and array.shape[1] == 1 else array


def measured(
    name: str, value: object, shape: tuple[int, ...], meaning: str = "one column per node"
) -> FloatArray:
    """Return a measurement as an array of this shape; it may hold what is not finite."""
    if _is_alike(value, shape):
        return value.astype(float)
    array = real_array(name, value)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}: {meaning}")
    return array


def _is_alike(value: object, shape: tuple[int, ...]) -> TypeGuard[FloatArray]:
    """Return whether a value is a float array of this shape, as most are."""
    return type(value) is np.ndarray and value.dtype == np.float64 and value.shape == shape


def real_array(name: str, value: object) -> FloatArray:
    """Return ``value`` as a new float array, if it is made of real numbers."""
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value.astype(float)
    if value is None:
        raise TypeError(f"{name} is None, expected an array of real numbers")
    value = array_of(name, value)
    masked = sys.modules.get("numpy.ma")  # NumPy loads it for who makes one
    if masked is not None and isinstance(value, masked.MaskedArray):
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
    with np.errstate(over="ignore"):  # of a longer kind of float: infinite
        return given.astype(float)


# What makes an array of one kind from a record of another.
_CONVERSIONS = {
    "rest_length": "to_rest_length(model, prestress), or an array",
    "force_density": "to_force_density(model, nodes, rest_length), or an array",
}


def array_of(name: str, value: object) -> object:
    """Return the array of a record that stands for this argument; other values as they are."""
    if not isinstance(value, ArrayRecord):
        return value
    known = value.stands_for
    if name.rpartition(".")[2] not in known:
        raise TypeError(
            f"{name} is a {type(value).__name__}, which stands for {', '.join(known)}; give "
            f"{_CONVERSIONS.get(name, 'an array')}"
        )
    return getattr(value, known[name.rpartition(".")[2]])


def shaped(name: str, value: object, shape: tuple[int, ...], meaning: str) -> FloatArray:
    """Return ``value`` as a finite float array of this shape; a column serves as a vector."""
    if _is_alike(value, shape) and is_bounded(value):
        return value.astype(float)
    array = vector(name, value) if len(shape) == 1 else float_array(name, value)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}: {meaning}")
    return array


def node_forces(name: str, value: object, shape: tuple[int, ...]) -> FloatArray:
    """Return a load, N, shape (d, n), one force a node; the number 0 is none."""
    array = float_array(name, value)
    if array.ndim == 0 and array == 0:
        return np.zeros(shape)
    return shaped(name, array, shape, "one force per node, N; or 0")


def per_member(name: str, value: object, count: int, member: str) -> FloatArray:
    """Return one finite float a member: a scalar is repeated, a vector or column must fit."""
    if _is_alike(value, (count,)) and is_bounded(value):
        return value.astype(float)
    return _repeated(name, vector(name, value), count, member)


def limits(name: str, value: object, none: float = np.inf) -> FloatArray:
    """Return limits of any shape, of which some may be ``none``: no limit; None stands for all."""
    array = np.asarray(none) if value is None else _flat(real_array(name, value))
    float_array(name, np.where(array == none, 0.0, array))
    return array


def limit_per_member(
    name: str, value: object, count: int, member: str, none: float = np.inf
) -> FloatArray:
    """Return one limit a member, as :func:`per_member`, of which some may be ``none``."""
    return _repeated(name, limits(name, value, none), count, member)


def is_unlimited(value: object) -> bool:
    """Return whether an upper limit is none: None or infinite."""
    return value is None or (isinstance(value, float | np.floating) and float(value) == np.inf)


def _repeated(name: str, array: FloatArray, count: int, member: str) -> FloatArray:
    if array.ndim == 0:
        return np.full(count, float(array))
    if array.shape != (count,):
        raise ValueError(
            f"{name} has shape {array.shape}, expected () or ({count},): "
            f"one number for all, or one per {member}"
        )
    return array


def one_or_per_member(name: str, array: FloatArray, count: int, noun: str = "string") -> None:
    """Refuse an array that is neither one number nor one per string, or other member."""
    if array.shape not in ((), (count,)):
        raise ValueError(
            f"{name} has shape {array.shape}, expected () or ({count},): one number, or one per "
            f"{noun}"
        )


def refuse_fractions(name: str, array: FloatArray) -> None:
    """Refuse an array, shape (k,), with an entry that is not a whole number."""
    bad = np.flatnonzero(array != np.floor(array))
    if len(bad):
        raise TypeError(f"{name}[{bad[0]}] is {array[bad[0]]:g}, expected a whole number")


def indices(name: str, value: FloatArray, count: int, of: str, noun: str = "") -> IntArray:
    """Return whole numbers from 0 to ``count - 1``, shape (k,), or say which one is not."""
    if value.ndim != 1:
        raise ValueError(f"{name} has shape {value.shape}, expected (k,): a number for each")
    refuse_fractions(name, value)
    bad = np.flatnonzero((value < 0) | (value >= count))
    if len(bad):
        raise ValueError(
            f"{name}[{bad[0]}] is {noun}{value[bad[0]]:g}, expected 0 to {count - 1}: {of}, "
            "counted from 0"
        )
    return value.astype(np.int64)


def index_list(name: str, value: object, count: int, of: str, noun: str = "") -> IntArray:
    """Return indices from 0 to ``count - 1``, shape (k,), each once, in the order given.

    ``value`` is one index, a sequence or set of them, or a mask: a boolean array, shape (count,).
    """
    array = index_array(name, value, count)
    numbers = indices(name, array, count, of, noun)
    return numbers[np.sort(np.unique(numbers, return_index=True)[1])]


def index_array(name: str, value: object, count: int | None = None) -> FloatArray:
    """Return an index, a sequence or set of them, or a mask of ``count`` as numbers, shape (k,)."""
    given = sorted(value) if isinstance(value, Set) else value
    if _is_mask(given):
        mask = np.asarray(given)
        if count is not None and len(mask) != count:
            raise ValueError(
                f"{name} is a mask of shape {mask.shape}, expected ({count},): True or False for "
                "each"
            )
        return np.flatnonzero(mask).astype(float)
    array = np.atleast_1d(vector(name, given))
    if array.ndim != 1:
        raise ValueError(f"{name} has shape {array.shape}, expected (k,): indices from 0")
    return array


def _is_mask(value: object) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype == bool and value.ndim == 1
    listed = isinstance(value, list | tuple) and len(value) > 0
    return listed and all(isinstance(entry, bool | np.bool_) for entry in value)  # type: ignore[attr-defined]


def direction(name: str, value: object, dimension: int = 3) -> FloatArray:
    """Return a direction, in space or in the plane, as a vector of length 1, shape (d,)."""
    vector = shaped(name, value, (dimension,), "a direction")
    size = np.abs(vector).max()
    if size == 0:
        raise ValueError(f"{name} is 0, expected a direction")
    vector = vector / size  # squares of tiny entries would vanish
    return np.asarray(vector / np.linalg.norm(vector))


def positive(name: str, array: FloatArray, quantity: str) -> FloatArray:
    """Refuse an array with an entry that is not greater than zero."""
    if (array < 1 / LARGEST).any():
        bad = np.flatnonzero(array < 1 / LARGEST)
        entry = array.flat[bad[0]]
        least = f" of at least {1 / LARGEST:g}" if entry > 0 else ""
        raise ValueError(f"{name}[{bad[0]}] is {entry:g}, expected a positive {quantity}{least}")
    return array


def non_negative(name: str, array: FloatArray, why: str) -> FloatArray:
    """Refuse an array with an entry below zero."""
    if (array < 0).any():
        bad = np.flatnonzero(array < 0)
        raise ValueError(f"{name}[{bad[0]}] is {array.flat[bad[0]]:g}, expected at least 0: {why}")
    return array


def positive_number(name: str, value: object, unit: str, most: float = LARGEST) -> float:
    """Return a positive finite number of at most ``most``."""
    if type(value) is float and _LEAST <= value <= most:  # as a rule
        return value
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, _NO_NUMBERS) or not isinstance(value, _NUMBERS):
        raise TypeError(f"{name} is {_brief(value)}, expected a positive number in {unit}")
    try:
        number = float(value)
    except OverflowError:
        number = np.inf
    if not 1 / LARGEST <= number <= most:
        raise ValueError(
            f"{name} is {_brief(value)}, expected a positive finite number in {unit}, between "
            f"{1 / LARGEST:g} and {most:g}"
        )
    return number


def whole_number(name: str, value: Any, least: int, most: int = LARGEST_WHOLE) -> int:
    """Return an integer from ``least`` to ``most``; a float may stand for one."""
    if type(value) is int and least <= value <= most:  # as a rule
        return value
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    is_whole = isinstance(value, _WHOLE)
    if isinstance(value, _REAL):
        is_whole = bool(value == np.floor(value))
    if isinstance(value, _NO_NUMBERS) or not is_whole:
        raise TypeError(f"{name} is {_brief(value)}, expected a whole number of at least {least}")
    if isinstance(value, np.floating) and np.isfinite(value):  # limits exceed single precision
        value = int(value)
    if value < least:
        raise ValueError(f"{name} is {_brief(value)}, expected a whole number of at least {least}")
    if value > most:
        raise ValueError(f"{name} is {_brief(value)}, expected a whole number of at most {most}")
    return int(value)


def choice(name: str, value: object, options: Iterable[str]) -> str:
    """Return a string that is one of the options."""
    allowed = tuple(options)
    if type(value) is str and value in allowed:
        return value
    if not isinstance(value, str) or value not in allowed:
        quoted = ", ".join(repr(option) for option in allowed) or "none"
        near = get_close_matches(value, allowed, n=1) if isinstance(value, str) else ()
        meant = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"{name} is {_brief(value)}, expected one of {quoted}{meant}")
    return value


def identifier(name: str, value: object) -> str:
    """Return a string that can be the name of a group."""
    if not isinstance(value, str) or not value.isidentifier():
        raise ValueError(f"{name} is {_brief(value)}, expected a name of letters, digits and _")
    return value


def truth(name: str, value: object, meaning: str) -> bool:
    """Return True or False, and refuse what only looks like it."""
    if value is True or value is False:
        return value
    if not isinstance(value, _TRUTH):
        raise TypeError(
            f"{name} is {_brief(value)} ({type(value).__name__}), expected True or False: {meaning}"
        )
    return bool(value)


def member_parameters(parameters: dict[str, FloatArray]) -> None:
    """Refuse parameters that are not one number, or one per string, of one count."""
    for name, array in parameters.items():
        if array.ndim > 1:
            raise ValueError(
                f"{name} has shape {array.shape}, expected one number, or one per string"
            )
    counts = {array.shape for array in parameters.values() if array.ndim == 1}
    if len(counts) > 1:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in parameters.items())
        raise ValueError(f"shapes do not go together: {shapes}; expected one count of strings")


def wrong_kind(name: str, value: object, expected: str) -> TypeError:
    """Return the error of a value that is of another kind."""
    return TypeError(f"{name} is a {type(value).__name__}, expected {expected}")


def instance(name: str, value: object, kind: type, how: str) -> Any:
    """Return a value, and refuse one of the wrong class and say where the right one comes from."""
    if type(value) is not kind and not isinstance(value, kind):
        raise wrong_kind(name, value, f"{kind.__name__}: {how}")
    return value


def number(name: str, value: object, unit: str) -> float:
    """Return one finite real number."""
    if type(value) is float and abs(value) <= LARGEST:  # most are
        return value
    return float(shaped(name, value, (), f"one number, {unit}"))


def span(low: float, high: float, unit: str) -> str:
    """Return bounds as text: ``"2 to 5 N/m"``, or ``"at least 2 N/m"`` where none is above."""
    return f"at least {low:g} {unit}" if np.isposinf(high) else f"{low:g} to {high:g} {unit}"


def function(name: str, value: object, meaning: str, arguments: int | None = None) -> None:
    """Refuse what cannot be called, or not with so many arguments."""
    if not callable(value):
        raise wrong_kind(name, value, f"a function: {meaning}")
    if arguments is None:
        return
    try:
        inspect.signature(value).bind(*range(arguments))
    except (TypeError, ValueError) as error:  # of some that are built in, nobody knows them
        raise TypeError(f"{name} cannot be called as {meaning}: {error}") from None


def text(name: str, value: object, meaning: str) -> str:
    """Return a string."""
    if type(value) is not str and not isinstance(value, str):
        raise TypeError(f"{name} is {_brief(value)}, expected text: {meaning}")
    return value


def named(name: str, value: Any, of: str) -> None:
    """Refuse what is no dict with names for keys."""
    if not isinstance(value, Mapping):
        raise wrong_kind(name, value, of)
    for key in value:
        if not isinstance(key, str) or not key:
            raise TypeError(f"{name} has the key {key!r}, expected a name")


def items(name: str, value: object, of: str) -> tuple[Any, ...]:
    """Return the items of a sequence; a string is none."""
    with suppress(TypeError):
        if not isinstance(value, str | bytes | Mapping):
            return tuple(value)  # type: ignore[arg-type]  # refused below
    raise TypeError(f"{name} is {_brief(value)}, expected a sequence of {of}")


def file_path(name: str, value: object, endings: Iterable[str] = ()) -> Path:
    """Return a path, or say why no file can have it or that it has none of the endings."""
    if not isinstance(value, str | os.PathLike):
        raise TypeError(f"{name} is {_brief(value)}, expected a path: text or pathlib.Path")
    try:
        encoded = os.fsencode(value)
    except UnicodeEncodeError:
        encoded = b""
    if not encoded or b"\0" in encoded:
        raise ValueError(f"{name} is {_brief(value)}, expected a name that a file can have")
    path, allowed = Path(os.fsdecode(encoded)), tuple(endings)
    if allowed and path.suffix.lower() not in allowed:
        raise ValueError(f"{name} is {str(path)!r}, expected a name ending in {', '.join(allowed)}")
    return path


def weight(name: str, value: object, size: int, definite: bool) -> FloatArray:
    """Return a symmetric weight, shape (size, size), or its diagonal, of a number or a diagonal."""
    array = float_array(name, value)
    if array.shape == (size, 1):
        array = array[:, 0]
    if array.shape not in ((), (size,), (size, size)):
        raise ValueError(
            f"{name} has shape {array.shape}, expected (), ({size},) or ({size}, {size}): "
            "a number, a diagonal or a matrix"
        )
    largest = float(np.abs(array).max(initial=0.0))
    if array.ndim < 2:
        array = np.broadcast_to(array, (size,))
    elif np.abs(array - array.T).max(initial=0.0) > _SYMMETRIC * largest:
        raise ValueError(f"{name} is not symmetric")
    else:
        array = np.asarray((array + array.T) / 2)
    sizes = array if array.ndim == 1 else np.linalg.eigvalsh(array)
    least = float(sizes.min()) if size else 0.0
    if least < -_SEMIDEFINITE * largest or (definite and least <= 0):
        wanted = "positive" if definite else "at least 0"
        raise ValueError(f"{name} has the eigenvalue {least:.3g}, expected {wanted}")
    return np.asarray(array)


def weight_matrix(name: str, value: object, size: int, definite: bool) -> FloatArray:
    """Return a symmetric weight, shape (size, size), of a number, a diagonal or a matrix."""
    matrix = weight(name, value, size, definite)
    return np.diag(matrix) if matrix.ndim == 1 else matrix


def refuse_memory(asked: str, count: float, things: str, size: float, hint: str = "") -> None:
    """Raise if ``count`` things of ``size`` bytes do not fit; ``asked``: "sides is 9"."""
    if not count * size <= _MOST_BYTES:
        raise ValueError(
            f"{asked}, which makes {count:.3g} {things}, about {count * size / 1e9:.3g} GB of "
            f"memory; expected at most {_MOST_BYTES / size:.2g}, {_MOST_BYTES / 1e9:g} GB{hint}"
        )


def refuse_time(asked: str, count: float, things: str, time: float, hint: str = "") -> None:
    """Raise if ``count`` things of ``time`` seconds are not done in a day."""
    if not count * time <= LONGEST_WAIT:
        raise ValueError(
            f"{asked}, which makes {count:.3g} {things}, about {count * time / 86_400:.3g} days; "
            f"expected at most {LONGEST_WAIT / time:.2g}, a day{hint}"
        )
