"""What a value in a scene file may be, and what to say of one that is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite

# Beyond, squares and products leave the range of double precision.
_LEAST, _MOST = 1e-30, 1e30


@dataclass(frozen=True)
class Kind:
    """A kind of value: how messages call it, and a test.

    Parameters
    ----------
    text : str
        What messages expect, for example ``"a number"``.
    fits : callable
        Whether a value is of this kind; of a list, whether it is a list.
    entry : Kind, optional
        The kind of the entries, where a list fits.
    """

    text: str
    fits: Callable[[object], bool]
    entry: Kind | None = None

    def fault(self, name: str, value: object, unit: str) -> str | None:
        """Return what is wrong with a value, or None.

        Parameters
        ----------
        name : str
            What the message calls it.
        value : object
        unit : str
            Unit of its numbers, or nothing.
        """
        if not self.fits(value):
            wanted = self.text + (f" in {unit}" if unit else "")
            hint = ""
            if isinstance(value, str) and unit and value[:1].isdigit():
                hint = "; quantities are in SI units, without quotes and without the unit"
            return f"{name} is {_told(value)}, expected {wanted}{hint}"
        for number in value if isinstance(value, list) else [value]:
            if not _is_in_range(number):
                return (
                    f"{name} holds {_told(number)}, expected numbers of a size between "
                    f"{_LEAST:g} and {_MOST:g}, or 0"
                )
        if isinstance(value, dict) and self.entry is not None:
            for key, number in value.items():
                found = self.entry.fault(f"{name}.{key}", number, unit)
                if found:
                    return found
        if isinstance(value, list) and self.entry is not None:
            for i, entry in enumerate(value):
                found = self.entry.fault(f"{name}[{i}]", entry, unit)
                if found:
                    return found
        return None


def _told(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {value!r}" if len(value) < 40 else "a text"
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, int):
        return str(value) if abs(value) < 10**20 else "a number of more than 20 digits"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list):
        return str(value) if len(str(value)) < 40 else f"a list of {len(value)}"
    return f"a {type(value).__name__}"


def is_number(value: object) -> bool:
    """Whether a value is a number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_in_range(value: object) -> bool:
    """Whether a value is no number, or one of a size to reckon with; nan and inf are met later."""
    if not isinstance(value, int | float) or value == 0:
        return True
    if isinstance(value, float) and not isfinite(value):
        return True
    return _LEAST <= abs(value) <= _MOST


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**53


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_truth(value: object) -> bool:
    return isinstance(value, bool)


def _is_list(value: object) -> bool:
    return isinstance(value, list)


def _is_point(value: object) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(map(is_number, value))


def _is_pair(value: object) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_is_whole, value))


def _number_or(*kinds: type) -> Callable[[object], bool]:
    return lambda value: is_number(value) or isinstance(value, kinds)


NUMBER = Kind("a number", is_number)
WHOLE = Kind("a whole number", _is_whole)
TEXT = Kind("text", _is_text)
TRUTH = Kind("true or false", _is_truth)
POINT = Kind("[x, y, z]", _is_point)
TEXTS = Kind("a list of texts", _is_list, TEXT)
NODES = Kind("a list of node numbers", _is_list, WHOLE)
INDICES = Kind("a list of indices from 0", _is_list, WHOLE)
PAIRS = Kind("a list of pairs of node numbers", _is_list, Kind("a pair of node numbers", _is_pair))
POINTS = Kind("a list of [x, y, z]", _is_list, POINT)
NUMBERS = Kind("a number or a list of numbers", _number_or(list), NUMBER)
BY_STRING = Kind(
    "a number, a list with one per string, or a table by string group",
    _number_or(list, dict),
    NUMBER,
)
COUNT_BY_STRING = Kind(
    "a whole number, a list with one per string, or a table by string group",
    lambda value: _is_whole(value) or isinstance(value, list | dict),
    WHOLE,
)
VECTOR = Kind("a number or [x, y, z]", lambda value: is_number(value) or _is_point(value))
WEIGHT = Kind(
    "a number, a diagonal or a matrix",
    _number_or(list),
    Kind("a number or a row of numbers", _number_or(list), NUMBER),
)
PANELS = Kind(
    "a panel name, or a list of panel names and node loops",
    lambda value: isinstance(value, str | list),
    Kind("a panel name or a loop of nodes", lambda value: isinstance(value, str | list), WHOLE),
)
FORCES = Kind(
    "a list of {node = ..., force = [x, y, z]}",
    _is_list,
    Kind("{node = ..., force = [x, y, z]}", lambda value: isinstance(value, dict)),
)
TABLES_OF_KEYS = Kind(
    "a list of tables", _is_list, Kind("a table", lambda value: isinstance(value, dict))
)
