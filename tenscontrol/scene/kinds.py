"""Kinds of values in a scene file."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite

from tenscontrol import validation

# Beyond, squares and products leave the range of double precision.
_LEAST, _MOST = 1e-30, 1e30


@dataclass(frozen=True)
class Kind:
    """A kind of value: its name in messages, a test, and the kind of entries of a list or table."""

    text: str
    fits: Callable[[object], bool]
    entry: Kind | None = None

    def fault(self, name: str, value: object, unit: str) -> str | None:
        """Return what is wrong with the value of this name, whose numbers have this unit."""
        if not self.fits(value):
            wanted = self.text + (f" in {unit}" if unit else "")
            hint = ""
            if isinstance(value, str) and unit and value[:1].isdigit():
                hint = "; quantities are in SI units, without quotes and without the unit"
            return f"{name} is {_described(value)}, expected {wanted}{hint}"
        for number in value if isinstance(value, list) else [value]:
            if not _is_in_range(number):
                return (
                    f"{name} holds {_described(number)}, expected numbers of a size between "
                    f"{_LEAST:g} and {_MOST:g}, or 0"
                )
        if self.entry is None or not isinstance(value, dict | list):
            return None
        if isinstance(value, dict):
            entries = {f"{name}.{key}": entry for key, entry in value.items()}
        else:
            entries = {f"{name}[{i}]": entry for i, entry in enumerate(value)}
        faults = (self.entry.fault(place, entry, unit) for place, entry in entries.items())
        return next(filter(None, faults), None)


def _described(value: object) -> str:
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


def _is_in_range(value: object) -> bool:
    """Whether a value is no number, 0, or of a size in range; nan and inf are refused later."""
    if not isinstance(value, int | float) or value == 0:
        return True
    if isinstance(value, float) and not isfinite(value):
        return True
    return _LEAST <= abs(value) <= _MOST


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_whole(value: object) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return value % 1 == 0 and abs(value) < 2**53


def _row(least: int, most: int, fits: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda row: isinstance(row, list) and least <= len(row) <= most and all(map(fits, row))


def _is_support(value: object) -> bool:
    if isinstance(value, list):
        return len(value) == 2 and _is_whole(value[0]) and isinstance(value[1], str)
    return _is_whole(value)


def _a(*kinds: type) -> Callable[[object], bool]:
    return lambda value: isinstance(value, kinds)


def _number_or(*kinds: type) -> Callable[[object], bool]:
    return lambda value: _is_number(value) or isinstance(value, kinds)


_is_list, _is_table, _is_point = _a(list), _a(dict), _row(2, 3, _is_number)
NUMBER = Kind("a number", _is_number)
WHOLE = Kind("a whole number", _is_whole)
TEXT = Kind("text", _a(str))
TRUTH = Kind("true or false", _a(bool))
TABLE = Kind("a table", _is_table)
TABLES_OF_KEYS = Kind("a list of tables", _is_list, TABLE)
POINT = Kind("[x, y, z] (or [x, y])", _is_point)
NODES = Kind("a list of node numbers", _is_list, WHOLE)
BARS = Kind("a list of bar numbers", _is_list, WHOLE)
NUMBERS = Kind("a list of numbers", _is_list, NUMBER)
ROWS = Kind("a list of lists of numbers", _is_list, NUMBERS)
VECTOR = Kind("a number or [x, y, z] (or [x, y])", lambda v: _is_number(v) or _is_point(v))
BY_STRING = Kind(
    "a number, a list with one per string, or a table by string group",
    _number_or(list, dict),
    NUMBER,
)
POINTS = Kind("a list of [x, y, z] (or of [x, y])", _is_list, POINT)
SUPPORTS = Kind(
    'a list of node numbers, and of pairs like [4, "z"]',
    _is_list,
    Kind('a node number, or a pair like [4, "z"]', _is_support),
)
KNOTS = Kind("'corners', 'edges' or a list of node numbers", _a(str, list), WHOLE)
FIXED = Kind(SUPPORTS.text, _a(str, list))  # those of any generator
FORCES = Kind(
    "a list of {node = ..., force = [x, y, z]}",
    _is_list,
    Kind("{node = ..., force = [x, y, z]}", _is_table),
)

_WINCH = Kind(
    "an index, a string group, a list of them, or a table of their ratios",
    lambda value: _is_whole(value) or isinstance(value, str | list | dict),
    Kind("an index, a string group or a ratio", lambda v: _is_number(v) or isinstance(v, str)),
)
ACTUATED = Kind(
    "a list of indices and string groups, or a table of winches with their strings",
    _a(str, list, dict),
    _WINCH,
)

# By the type that a docstring gives, without ", optional": the first that fits.
_BY_TYPE = (
    (r"float( or None| or casadi\.Function)?", NUMBER),
    (r"int|\{\d[\d, ]*\}", WHOLE),
    (r"bool", TRUTH),
    (r"\(float, float\)", Kind("a pair of numbers", _row(2, 2, _is_number))),
    (r"mapping of str to .*", TABLE),
    (r'\{"corners".*sequence of int.*', KNOTS),
    (r'str( or \w+)?|\{".*', TEXT),
    (r"float or array_like, shape \(α,\)", BY_STRING),
    (
        r"int or array_like of int, shape \(α,\)",
        Kind(
            "a whole number, a list with one per string, or a table by string group",
            lambda value: _is_whole(value) or isinstance(value, list | dict),
            WHOLE,
        ),
    ),
    (
        r"float or array_like, shape \(.*,\) or \(.*\)",
        Kind(
            "a number, a diagonal or a matrix",
            _number_or(list),
            Kind("a number or a row of numbers", _number_or(list), NUMBER),
        ),
    ),
    (
        r"array_like, shape \(2r, .*\)",
        Kind("a list of rows", _is_list, Kind("a row of numbers", _is_list, NUMBER)),
    ),
    (r"float or array_like, shape \(d,\)", VECTOR),
    (
        r"float or array_like, shape \(.*,\)",
        Kind("a number or a list of numbers", _number_or(list), NUMBER),
    ),
    (r"array_like, shape \(d,\)", POINT),
    (r"array_like, shape \(d, \w+\)", POINTS),
    (
        r"array_like of int, shape \(α, 2\), or sequence of paths",
        Kind(
            "a list of pairs of node numbers, or of paths of more",
            _is_list,
            Kind(
                "a pair of node numbers, or a path of more",
                _row(2, validation.LARGEST_WHOLE, _is_whole),
            ),
        ),
    ),
    (
        r"array_like of int, shape \(\w+, 2\)",
        Kind(
            "a list of pairs of node numbers",
            _is_list,
            Kind("a pair of node numbers", _row(2, 2, _is_whole)),
        ),
    ),
    (r"sequence or set of int and of \(int, str\).*", SUPPORTS),
    (r"sequence of int or str, dict.*", ACTUATED),
    (
        r"(array_like|sequence)( or set)? of int.*",
        Kind("a list of indices from 0", _is_list, WHOLE),
    ),
    (r"sequence of str.*", Kind("a list of texts", _is_list, TEXT)),
    (
        r"sequence, or one name",
        Kind(
            "a panel name, or a list of panel names and node loops",
            _a(str, list),
            Kind("a panel name or a loop of nodes", _a(str, list), WHOLE),
        ),
    ),
)


def kind_of(name: str, described: str) -> Kind:
    """Return the kind of a parameter of this name, whose type a docstring describes so."""
    plain = described.removesuffix(", optional")
    for pattern, kind in _BY_TYPE:
        if re.fullmatch(pattern, plain):
            return NODES if name == "nodes" and kind.text == "a list of indices from 0" else kind
    raise LookupError(f"{name} is documented as {described!r}, which is no kind of TOML value")
