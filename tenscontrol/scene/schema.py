"""The tables and keys of a scene file, with the kind and the unit of each value.

A table has the arguments of the class or function that it is given to.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import Parameter, signature
from math import isfinite
from types import MappingProxyType
from typing import TypeVar

from tenscontrol import library
from tenscontrol.actuation import Motor, Winches
from tenscontrol.control import (
    LQR,
    MPC,
    NMPC,
    Controller,
    FeedbackLinearization,
    MPCSettings,
    OutputLimit,
)
from tenscontrol.dynamics import (
    TERMS,
    ContactLaw,
    ElasticStrings,
    Ground,
    HertzGround,
    LinearStrings,
    SmoothGround,
)
from tenscontrol.estimation import KalmanFilter, Sensors
from tenscontrol.simulation import CutString, LostMeasurement, StuckWinch
from tenscontrol.structure import STRUCTURE_KEYS, Structure, skin, subdivide
from tenscontrol.validation import LARGEST_WHOLE

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
POINT = Kind("[x, y, z] (or [x, y])", _is_point)
TEXTS = Kind("a list of texts", _is_list, TEXT)
NODES = Kind("a list of node numbers", _is_list, WHOLE)
INDICES = Kind("a list of indices from 0", _is_list, WHOLE)
PAIR = Kind("a pair of node numbers", _row(2, 2, _is_whole))
PAIRS = Kind("a list of pairs of node numbers", _is_list, PAIR)
PATHS = Kind(
    "a list of pairs of node numbers, or of paths of more",
    _is_list,
    Kind("a pair of node numbers, or a path of more", _row(2, LARGEST_WHOLE, _is_whole)),
)
SUPPORTS = Kind(
    'a list of node numbers, and of pairs like [4, "z"]',
    _is_list,
    Kind('a node number, or a pair like [4, "z"]', _is_support),
)
KNOTS = Kind("'corners', 'edges' or a list of node numbers", _a(str, list), WHOLE)
POINTS = Kind("a list of [x, y, z] (or of [x, y])", _is_list, POINT)
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
VECTOR = Kind("a number or [x, y, z] (or [x, y])", lambda v: _is_number(v) or _is_point(v))
WEIGHT = Kind(
    "a number, a diagonal or a matrix",
    _number_or(list),
    Kind("a number or a row of numbers", _number_or(list), NUMBER),
)
PANELS = Kind(
    "a panel name, or a list of panel names and node loops",
    _a(str, list),
    Kind("a panel name or a loop of nodes", _a(str, list), WHOLE),
)
FORCES = Kind(
    "a list of {node = ..., force = [x, y, z]}",
    _is_list,
    Kind("{node = ..., force = [x, y, z]}", _is_table),
)
TABLES_OF_KEYS = Kind("a list of tables", _is_list, Kind("a table", _is_table))

Keys = Mapping[str, tuple[Kind, str]]
_Entry = TypeVar("_Entry")

# What a name means in every table that does not say otherwise.
_MEANINGS: Keys = {
    name: (kind, unit)
    for kind, unit, names in (
        (
            TEXT,
            "",
            "kind law per input method form solver prediction generator handedness group axis",
        ),
        (TRUTH, "", "diagonals shape_gives ramp load floating continuous"),
        (WHOLE, "", "sides iterations seed node relative_to string"),
        (WHOLE, "", "stages sections vertebrae hoops spokes rows columns dimension"),
        (WHOLE, "", "horizon max_iterations substeps delay patience version"),
        (NUMBER, "m", "radius height top_radius disturbance low high"),
        (NUMBER, "m", "bar_length leg_length length width spacing rise sag"),
        (NUMBER, "s", "duration step output_step sample_time time_limit start time until"),
        (NUMBER, "rad", "twist slope spread"),
        (NUMBER, "", "linearization_tolerance overlap across up friction"),
        (NUMBER, "m/s", "slip_speed"),
        (NUMBER, "Hz", "frequency"),
        (NUMBER, "1/m", "penalty"),
        (NUMBER, "kg", "node_mass"),
        (NUMBER, "", "tolerance regularization string_penalty load_gain drop_rate outlier_rate"),
        (NUMBER, "", "process_noise load_noise gate start_spread linearization_tolerance"),
        (NUMBERS, "kg", "bar_mass string_node_mass point_mass panel_mass"),
        (NUMBERS, "kg/m²", "areal_density"),
        (NUMBERS, "m", "node_position string_length"),
        (NUMBERS, "N", "string_tension"),
        (NUMBERS, "", "bar_direction"),
        (NUMBERS, "rad/s", "bar_rate"),
        (BY_STRING, "N/m", "stiffness force_density max_force_density min_force_density"),
        (BY_STRING, "N", "axial_rigidity max_tension"),
        (BY_STRING, "N/m or m", "max_change"),
        (BY_STRING, "N s/m", "damping"),
        (BY_STRING, "kg", "string_mass"),
        (BY_STRING, "m/s", "rate"),
        (BY_STRING, "m", "shortest longest drum_radius zero"),
        (BY_STRING, "", "gear_ratio"),
        (BY_STRING, "N m", "torque"),
        (BY_STRING, "rad/s", "speed"),
        (BY_STRING, "kg m²", "inertia"),
        (BY_STRING, "s", "lag"),
        (BY_STRING, "rad", "backlash"),
        (COUNT_BY_STRING, "", "segments"),
        (NODES, "", "nodes top bottom"),
        (SUPPORTS, "", "fixed"),
        (INDICES, "", "strings bars tension_strings rate_bars"),
        (POINTS, "m", "positions"),
        (POINTS, "m/s", "velocities"),
        (POINT, "N", "force"),
        (POINT, "", "normal"),
        (VECTOR, "m/s²", "gravity"),
        (FORCES, "", "forces"),
        (TEXTS, "", "string_groups"),
        (PANELS, "", "panels"),
        (WEIGHT, "", "Q R"),
        (TABLES_OF_KEYS, "", "tracked outputs reference"),
    )
    for name in names.split()
}

# Arguments that come from another table or from the scene itself.
_ELSEWHERE = (
    "structure parent string_parent rollers paths plant sensors winches motor machine_code matrix"
)


def arguments(function: Callable[..., object]) -> dict[str, Parameter]:
    """Return the arguments of a function or class that a table of a scene file gives."""
    found: dict[str, Parameter] = {}
    for name, argument in signature(function).parameters.items():
        # The keywords that MPC and NMPC share are the fields of their settings.
        shared = argument.kind is Parameter.VAR_KEYWORD
        found |= signature(MPCSettings).parameters if shared else {name: argument}
    return {name: argument for name, argument in found.items() if name not in _ELSEWHERE.split()}


def required(function: Callable[..., object]) -> list[str]:
    """Return the keys without which a function or class cannot be called."""
    return [name for name, each in arguments(function).items() if each.default is Parameter.empty]


def _keys(
    names: str, *functions: Callable[..., object], without: str = "", **own: tuple[Kind, str]
) -> dict[str, tuple[Kind, str]]:
    """Return the keys of a table: names, arguments of functions, and own meanings of some."""
    found = [*names.split(), *(name for each in functions for name in arguments(each))]
    return {
        name: own[name] if name in own else _MEANINGS[name]
        for name in dict.fromkeys(found)
        if name not in without.split()
    }


def _named(**entries: _Entry) -> Mapping[str, _Entry]:
    return MappingProxyType(entries)


# Keys of a table for one choice of its first key; those of the other choices are unknown.
GENERATORS: Mapping[str, Callable[..., Structure]] = MappingProxyType(
    {name: getattr(library, name) for name in library.__all__}
)
GENERATOR_KEYS: Mapping[str, Keys] = MappingProxyType(
    {
        name: _keys("generator", make, fixed=(KNOTS, "")) | _keys("point_mass")
        if name == "net"
        else _keys("generator", make) | _keys("point_mass fixed")
        for name, make in GENERATORS.items()
    }
)
MEMBERS = _keys(
    " ".join(STRUCTURE_KEYS), nodes=(POINTS, "m"), bars=(PAIRS, ""), strings=(PATHS, ""),
    string_parent=(INDICES, ""), parent=(Kind("the table of a structure", _is_table), ""),
)  # fmt: skip
LAWS = _named(
    linear=_keys("law", LinearStrings) | _keys("per"),
    elastic=_keys("law", ElasticStrings) | _keys("per"),
)
GROUNDS: Mapping[str, type[ContactLaw]] = _named(
    linear=Ground, hertz=HertzGround, smooth=SmoothGround
)
GROUND_KEYS: Mapping[str, Keys] = MappingProxyType(
    {
        kind: _keys(
            "kind", law, damping=(NUMBER, "s/m"),
            stiffness=(NUMBER, "N/m^1.5" if kind == "hertz" else "N/m"),
        )
        for kind, law in GROUNDS.items()
    }
)  # fmt: skip
CONTROLLERS: Mapping[str, Callable[..., Controller]] = _named(
    lqr=LQR, mpc=MPC, nmpc=NMPC, feedback_linearization=FeedbackLinearization
)
CONTROLLER_KEYS: Mapping[str, Keys] = MappingProxyType(
    {kind: _keys("kind input", make, damping=(NUMBER, "")) for kind, make in CONTROLLERS.items()}
    | {
        "python": _keys(
            "kind function factory settings input sample_time low high max_change",
            function=(TEXT, ""),
            factory=(TEXT, ""),
            settings=(Kind("a table", _is_table), ""),
            low=(BY_STRING, "N/m or m"),
            high=(BY_STRING, "N/m or m"),
        )
    }
)
FAULTS: Mapping[str, type[CutString | StuckWinch | LostMeasurement]] = _named(
    cut_string=CutString, stuck_winch=StuckWinch, lost_measurement=LostMeasurement
)
FAULT_KEYS: Mapping[str, Keys] = MappingProxyType(
    {kind: _keys("kind", fault) for kind, fault in FAULTS.items()}
)

# Forces of a model that are numbers.
FORCE_KEYS: Keys = MappingProxyType(
    {name: (NUMBER, force.unit) for name, force in TERMS.items() if force.unit}
)
TABLES = _named(
    structure={key: each for keys in GENERATOR_KEYS.values() for key, each in keys.items()}
    | MEMBERS
    | {"fixed": (Kind(SUPPORTS.text, _a(str, list)), "")},
    skin=_keys("", skin),
    subdivide=_keys("", subdivide),
    strings=_keys("law stiffness axial_rigidity damping per"),
    loads=_keys("gravity forces") | {**FORCE_KEYS},
    ground={key: each for keys in GROUND_KEYS.values() for key, each in keys.items()},
    prestress=_keys(
        "force_density min_force_density max_force_density reference per shape_gives",
        reference=(TEXT, ""),
    ),
    start=_keys("velocities disturbance seed"),
    run=_keys(
        "duration step tolerance output_step method input sample_time",
        tolerance=(NUMBER, "m and m/s"),
    ),
    controller={key: each for keys in CONTROLLER_KEYS.values() for key, each in keys.items()},
    winches=_keys("", Winches, Motor),
    sensors=_keys("", Sensors) | _keys("seed"),
    estimator=_keys("kind", KalmanFilter, without="sample_time start"),
    faults={key: each for keys in FAULT_KEYS.values() for key, each in keys.items()},
)
# Those of which a file has a list, each with a heading like [[faults]].
LISTS = ("faults", "ground")
# Those of which one may be written like [ground] too.
ONE_OR_LIST = ("ground",)

# Entries of lists.
FORCE = _keys("node force")
TRACKED = _keys("node relative_to axis")
OUTPUT = TRACKED | _keys("", OutputLimit)
WAYPOINT = _keys(
    "start time height twist top bottom nodes positions force_density",
    force_density=(NUMBER, "N/m"),
)

# Keys, and values of keys, by the way to them: what older files have, and what to write.
RENAMED: Mapping[tuple[str | int, ...], str] = MappingProxyType(
    {
        ("controller", "step"): "sample_time",
        ("controller", "kind", "shape_control"): "feedback_linearization",
        ("run", "hold"): "input",
        ("winches", "pieces"): "substeps",
    }
)
