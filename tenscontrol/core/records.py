"""The layout of data that the core takes."""

from __future__ import annotations

import ctypes
from typing import Any

_POINTER = ctypes.c_void_p
_COUNT = ctypes.c_int32
_NUMBER = ctypes.c_double
_BYTES = ctypes.c_char * 1


def address(array: Any) -> int:
    """Return where in memory an array is, which has to outlive what is given it."""
    if array.size and array.flags.carray:  # in a third of the time of the other
        return ctypes.addressof(_BYTES.from_buffer(array))
    place: int = array.__array_interface__["data"][0]
    return place


def pointers(*arrays: Any) -> list[Any]:
    """Return arrays as calls of the core take them."""
    return [
        _BYTES.from_buffer(array)  # which goes as a pointer
        if array.size and array.flags.carray
        else _POINTER(array.__array_interface__["data"][0])
        for array in arrays
    ]


class Ground(ctypes.Structure):
    """A plane that some nodes can touch."""

    _fields_ = (
        *((name, _COUNT) for name in ("kind", "count", "first_switch", "damped", "rubs")),
        ("node", _POINTER),
        ("normal", _NUMBER * 3),
    )  # fmt: skip


class Scene(ctypes.Structure):
    """A structure with its strings, loads, supports and ground."""

    _fields_ = (
        *((name, _COUNT) for name in (
            "dimension", "entries", "free",
            "law", "damped", "strings", "segments", "clustered", "slacking", "switches",
            "free_bars", "swinging_bars", "points", "grounds", "bars",
            "block_bars", "block_rows", "unknowns", "factors",
        )),
        ("size", _NUMBER), ("shortest", _NUMBER),
        *((name, _POINTER) for name in (
            "free_row", "place", "load", "segment_start", "segment_end", "segment_string",
            "stiffness", "damping", "bar_start", "bar_end", "bar_row", "bar_constants",
            "hinge", "tip", "tip_row", "tip_constants", "point", "point_inverse_mass", "ground",
            "ground_numbers", "any_start", "any_end", "bar_mass", "point_mass",
            "block_start", "block_end", "entry_start", "entry_end", "right_place", "block_mass",
            "factor_row", "factor_first", "factor_pair", "block_row", "block_place",
            "free_bar", "swinging_bar", "block_bar", "segment_row",
        )),
    )  # fmt: skip


class Drive(ctypes.Structure):
    """The inputs of a span as polynomials in time."""

    _fields_ = (
        ("coefficients", _POINTER), ("begin", _NUMBER),
        *((name, _COUNT) for name in ("count", "degree", "is_loaded", "is_moved", "is_driven")),
    )  # fmt: skip


class Body(ctypes.Structure):
    """A block of bars that nothing holds."""

    _fields_ = (
        ("bars", _COUNT), ("nodes", _COUNT),
        *((name, _POINTER) for name in ("start", "end", "bar_mass", "node", "point_mass")),
    )  # fmt: skip


class Lengths(ctypes.Structure):
    """Bars that are put on their lengths after a step."""

    _fields_ = (
        *((name, _POINTER) for name in ("bar_length", "tip_length", "block_length", "block_free")),
        ("bodies", _COUNT), ("body", _POINTER),
    )  # fmt: skip


class Motion(ctypes.Structure):
    """Nodes or their rates at many times, of any layout."""

    _fields_ = (
        ("values", _POINTER),
        *((name, ctypes.c_int64) for name in ("axis", "node", "time")),
    )  # fmt: skip

    @classmethod
    def of(cls, array: Any) -> Motion:
        """Return the record of an array (d, n, T) of floats, which has to outlive it."""
        size, (axis, node, time) = array.itemsize, array.strides
        return cls(address(array), axis // size, node // size, time // size)


class Rates(ctypes.Structure):
    """Rates of some nodes as intervals begin and end."""

    _fields_ = (("begin", Motion), ("end", Motion), ("count", _COUNT), ("nodes", _POINTER))


class Conservation(ctypes.Structure):
    """How well a motion keeps its energy, J, and its bars."""

    _fields_ = tuple((name, _NUMBER) for name in ("kinetic", "energy", "change", "stretch"))


class Quadrature(ctypes.Structure):
    """A quadrature over parts from 0 to 1."""

    _fields_ = (("count", _COUNT), ("shares", _POINTER), ("weights", _POINTER))


#: What is counted in a motion.
COUNTED = (
    "tries", "rejections", "landings", "approaches", "switches", "interpolants", "missed",
    "carries", "carried", "short_tries",
)  # fmt: skip


class Progress(ctypes.Structure):
    """A motion between two calls."""

    _fields_ = (
        ("time", _NUMBER), ("step", _NUMBER), ("stuck", _COUNT), ("stalls", _COUNT),
        *((name, ctypes.c_int64) for name in COUNTED),
        *((name, _COUNT) for name in ("kept", "every", "since", "short_left")),
        ("last", _NUMBER),
    )  # fmt: skip


class Settings(ctypes.Structure):
    """How a motion is integrated."""

    _fields_ = (
        *((name, _COUNT) for name in ("method", "projects", "traces", "outputs", "budget", "room")),
        *(
            (name, _NUMBER)
            for name in ("duration", "step", "longest", "limit", "smooth", "loose", "path")
        ),
        ("scale", _POINTER),
    )  # fmt: skip


class Spans(ctypes.Structure):
    """Spans of one motion, one after the other."""

    _fields_ = (
        ("count", _COUNT), *((name, _POINTER) for name in ("inputs", "duration", "outputs")),
        *((name, _NUMBER) for name in (
            "tolerance", "length", "mass", "frequency", "first", "whole", "stable",
        )),
    )  # fmt: skip


class Runs(ctypes.Structure):
    """Runs of one scene, and what they differ in."""

    _fields_ = (
        ("count", _COUNT),
        *((name, _POINTER) for name in (
            "inputs", "stiffness", "damping", "bar_constants", "tip_constants",
            "point_inverse_mass", "ground_numbers", "step", "longest", "scale", "slope", "taut",
        )),
    )  # fmt: skip


class Tableau(ctypes.Structure):
    """An explicit Runge-Kutta method."""

    _fields_ = (("stages", _COUNT), *((name, _POINTER) for name in ("a", "b", "c")))


class Steps(ctypes.Structure):
    """Steps that follow one another."""

    _fields_ = (
        ("count", _COUNT), *((name, _POINTER) for name in ("length", "states", "inputs", "taut")),
        ("first", _COUNT),
    )  # fmt: skip


class Switches(ctypes.Structure):
    """What switches at the ends of steps."""

    _fields_ = (
        ("count", _COUNT),
        *((name, _POINTER) for name in ("step", "by_state", "by_input", "rate", "jump")),
    )  # fmt: skip


class Profile(ctypes.Structure):
    """Values of strings at some times, and by what each counts in steps."""

    _fields_ = (*((name, _COUNT) for name in ("first", "values", "rows")), ("share", _POINTER))


class Changes(ctypes.Structure):
    """Changes of what steps depend on, in columns, or derivatives of a cost by them."""

    _fields_ = (
        ("columns", _COUNT), ("gravity", _NUMBER * 3),
        *((name, _POINTER) for name in (
            "profile", "by_values", "input", "stiffness", "damping", "load", "bar_mass",
            "point_mass", "ground",
        )),
    )  # fmt: skip


class Reduced(ctypes.Structure):
    """A plant in reduced coordinates."""

    _fields_ = (
        ("scene", _POINTER),
        *((name, _COUNT) for name in ("coordinates", "inputs", "bars")),
        *((name, _POINTER) for name in ("place", "basis", "project")),
        *((name, _COUNT) for name in ("inner", "is_complement")),
        *((name, _POINTER) for name in (
            "left", "right", "end", "axis", "share", "square", "spread", "offset", "taut",
        )),
    )  # fmt: skip


class Rows(ctypes.Structure):
    """Values of strings and places of nodes that are limited."""

    _fields_ = (
        *((name, _COUNT) for name in (
            "count", "density", "tension", "nodes", "at_end", "node_rows",
        )),
        ("on_nodes", _POINTER),
    )  # fmt: skip


#: Numbers of a plane, in this order.
GROUND_NUMBERS = "stiffness", "damping", "friction", "slip_speed", "height", "width"

#: Columns of changes are a multiple of this many.
COLUMNS = 8
