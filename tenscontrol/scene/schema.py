"""The tables and keys of a scene file.

A table has the arguments of the class or function that it is given to: the default of a key is in
the signature; kind, unit and meaning are in the docstring.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from inspect import Parameter, signature
from itertools import chain
from types import MappingProxyType
from typing import Any, NamedTuple

from tenscontrol import control, library
from tenscontrol.actuation.motors import Motor
from tenscontrol.actuation.winches import Winches
from tenscontrol.control.controller import Controller
from tenscontrol.control.function_controller import FunctionController
from tenscontrol.control.linear_controller import LinearController
from tenscontrol.control.mpc.constraints import OutputLimit
from tenscontrol.docstrings import documented
from tenscontrol.dynamics.contact_laws import ContactLaw, Ground, HertzGround, SmoothGround
from tenscontrol.dynamics.forces import TERMS
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.string_laws import ElasticStrings, LinearStrings, StringLaw
from tenscontrol.estimation.kalman_filter import KalmanFilter
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.plant.linearize import linearize
from tenscontrol.scene.kinds import (
    BARS,
    FIXED,
    FORCES,
    NODES,
    NUMBER,
    NUMBERS,
    POINT,
    POINTS,
    ROWS,
    TABLE,
    TABLES_OF_KEYS,
    TEXT,
    TRUTH,
    WHOLE,
    Kind,
    kind_of,
)
from tenscontrol.simulation.faults import CutString, LostMeasurement, StuckWinch
from tenscontrol.simulation.simulate import simulate
from tenscontrol.sizing.materials import Material, materials
from tenscontrol.sizing.sections import sections
from tenscontrol.statics.prestress import prestress
from tenscontrol.structure.segments import subdivide
from tenscontrol.structure.skin import skin
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.structure_file import STRUCTURE_KEYS


class Key(NamedTuple):
    """A key of a table: kind, unit and meaning of its value; its default, None for none."""

    kind: Kind
    unit: str
    meaning: str
    default: Any = None
    required: bool = False


Keys = Mapping[str, Key]

_BASE = r"(?:kg|m|s|N|rad|Hz|1)(?:[²³]|\^[\d.]+)?"
_UNIT = rf"{_BASE}(?:[ /]{_BASE})*"
_IN_UNITS = re.compile(rf", ({_UNIT}(?: (?:or|and) {_UNIT})?)(?=[,;.:]|$)")


def _unit_and_meaning(text: str, choices: str) -> tuple[str, str]:
    """Return the unit in the first clause of a description, and what it says as a comment."""
    clause = re.split(r"[.:;](?: |$)", text)[0]
    unit = _IN_UNITS.search(clause)
    fallback = re.match(r"[^.:;]*(; [^.:;]* if not given)", text)
    meaning = clause[: unit and unit.start()] + (fallback[1] if fallback else "")
    meaning = re.sub(r":\w+:`[~.]*([^`]*)`|``(.*?)``", r"\1\2", meaning)
    if not re.match(r"[A-Z]\b|[A-Z]{2}", meaning):  # no symbol and no abbreviation
        meaning = meaning[:1].lower() + meaning[1:]
    words = re.findall(r'"(\w+)"', choices)
    return unit[1] if unit else "", f"{meaning}: {_one_of(words)}" if words else meaning


def _one_of(names: Sequence[str]) -> str:
    words = [f'"{name}"' for name in names]
    return " or ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def keys_of(
    function: Callable[..., object], names: str = "", *, without: str = "", **kinds: Kind
) -> dict[str, Key]:
    """Return the keys for the arguments of a function or class: for all that TOML can hold.

    Arguments that are objects of the package are none; ``kinds`` are those of arguments for which
    a scene has a form of its own.
    """
    keys, described = {}, documented(function)
    for name, parameter in signature(function).parameters.items():
        if name not in names.split() if names else name in without.split():
            continue
        if name not in described:
            raise LookupError(
                f"{name} is not in the docstring of {function.__name__}, from which scene files "
                "take what it means; python -OO leaves docstrings out: run without it"
            )
        kind, text = described[name]
        if re.match("[A-Z]", kind) and name not in kinds:
            continue
        unit, meaning = _unit_and_meaning(text, kind)
        is_required = parameter.default is Parameter.empty
        default = None if is_required else parameter.default
        keys[name] = Key(
            kinds.get(name) or kind_of(name, kind), unit, meaning, default, is_required
        )
    return keys


def _by_name(*classes: Any) -> dict[str, Any]:
    """Return classes by their names in a scene: ``CutString`` is ``cut_string``."""
    return {re.sub(r"(?<=[a-z])(?=[A-Z])", "_", kind.__name__).lower(): kind for kind in classes}


def _choice(meaning: str, *names: str) -> Key:
    return Key(TEXT, "", f"{meaning}: {_one_of(names)}")


def _together(kinds: Mapping[str, Keys]) -> dict[str, Key]:
    return dict(chain.from_iterable(keys.items() for keys in kinds.values()))


_PER = Key(TEXT, "", 'values are those of a whole "string" or of each "segment"', "string")
_SEED = Key(WHOLE, "", "seed of the random numbers")
_INPUTS = "force_density", "rest_length"

# Keys of a table for one choice of its first key; those of the other choices are unknown.
GENERATORS: Mapping[str, Callable[..., Structure]] = MappingProxyType(
    {name: getattr(library, name) for name in library.__all__}
)
_GENERATOR = {
    "generator": Key(TEXT, "", "the function of tenscontrol.library that makes the structure")
}
GENERATOR_KEYS: Mapping[str, Keys] = MappingProxyType(
    {
        name: _GENERATOR | keys_of(make) | keys_of(Structure, "point_mass fixed") | keys_of(make)
        for name, make in GENERATORS.items()
    }
)
_MEMBERS = {"version": Key(WHOLE, "", "format of the file")} | keys_of(
    Structure, " ".join(STRUCTURE_KEYS), parent=TABLE
)
MEMBERS = MappingProxyType({name: _MEMBERS[name] for name in STRUCTURE_KEYS})
LAWS: Mapping[str, type[StringLaw]] = MappingProxyType(
    {"linear": LinearStrings, "elastic": ElasticStrings}
)
LAW_KEYS: Mapping[str, Keys] = MappingProxyType(
    {
        kind: {"law": _choice("the law of the strings", *LAWS)} | keys_of(law) | {"per": _PER}
        for kind, law in LAWS.items()
    }
)
GROUNDS: Mapping[str, type[ContactLaw]] = MappingProxyType(
    {"linear": Ground, "hertz": HertzGround, "smooth": SmoothGround}
)
GROUND_KEYS: Mapping[str, Keys] = MappingProxyType(
    {
        kind: {"kind": _choice("contact law", *GROUNDS)} | keys_of(law)
        for kind, law in GROUNDS.items()
    }
)
CONTROLLERS: Mapping[str, Callable[..., Controller]] = MappingProxyType(
    _by_name(
        *(
            exported
            for exported in (getattr(control, name) for name in control.__all__)
            if isinstance(exported, type) and issubclass(exported, Controller)
            if exported not in (Controller, LinearController)  # a file holds no matrices
        )
    )
)
_OF_CONTROLLERS: dict[str, Key] = {
    "kind": _choice("which one", *CONTROLLERS, "python"),
    "input": _choice("what the controller commands", *_INPUTS),
} | keys_of(linearize, "actuated")
CONTROLLER_KEYS: Mapping[str, Keys] = MappingProxyType(
    {
        kind: _OF_CONTROLLERS
        | keys_of(
            make,
            without="plant machine_code",
            reference=TABLES_OF_KEYS,
            tracked=TABLES_OF_KEYS,
            outputs=TABLES_OF_KEYS,
        )
        for kind, make in CONTROLLERS.items()
    }
    | {
        "python": _OF_CONTROLLERS
        | {
            "function": Key(TEXT, "", 'a function of your own: "file.py:name" or "module:name"'),
            "factory": Key(TEXT, "", "a function that makes the controller: as for function"),
            "settings": Key(TABLE, "", "arguments of the factory"),
        }
        | keys_of(FunctionController, "sample_time low high max_change")
    }
)
FAULTS: Mapping[str, type[CutString | StuckWinch | LostMeasurement]] = MappingProxyType(
    _by_name(CutString, StuckWinch, LostMeasurement)
)
FAULT_KEYS: Mapping[str, Keys] = MappingProxyType(
    {kind: {"kind": _choice("which one", *FAULTS)} | keys_of(f) for kind, f in FAULTS.items()}
)


class TableKeys(NamedTuple):
    """A table of a scene: its keys, its meaning, and whether a file may have a list of it."""

    keys: Keys
    meaning: str
    is_list: bool = False  # with headings like [[faults]]
    may_be_one: bool = True  # [ground], if there is but one


_START = {
    "velocities": Key(POINTS, "m/s", "velocity of each node"),
    "disturbance": Key(NUMBER, "m", "random change of shape, as far as the node that moves most"),
    "seed": _SEED,
}
_STRUTS = {
    "bars": Key(BARS, "", "bars that are driven; all if not given"),
    "time": Key(NUMBERS, "s", "times, ascending", required=True),
    "length": Key(ROWS, "m", "for each time, the length of each of these bars", required=True),
    "interpolation": Key(
        TEXT, "", f"how lengths go from time to time: {_one_of(('cubic', 'linear'))}", "cubic"
    ),
}
# Forces of a model that are numbers.
FORCE_KEYS = MappingProxyType(
    {name: Key(NUMBER, term.unit, term.meaning) for name, term in TERMS.items() if term.unit}
)
TABLES: Mapping[str, TableKeys] = MappingProxyType(
    {
        "structure": TableKeys(
            _together(GENERATOR_KEYS) | MEMBERS | {"fixed": MEMBERS["fixed"]._replace(kind=FIXED)},
            "nodes, bars and strings: from a generator, or listed",
        ),
        "skin": TableKeys(keys_of(skin), "panels of elastic skin between the strings"),
        "materials": TableKeys(keys_of(Material), "a material of your own, [materials.name]"),
        "sections": TableKeys(
            {
                "bars": _choice("material of the bars", *materials)._replace(required=True),
                "strings": _choice("material of the strings", *materials)._replace(required=True),
            }
            | keys_of(sections),
            "materials and cross sections: masses, and axial rigidity of elastic strings",
        ),
        "subdivide": TableKeys(keys_of(subdivide), "strings cut into segments with mass"),
        "strings": TableKeys(_together(LAW_KEYS), "the law of the strings"),
        "loads": TableKeys(
            keys_of(Model, "gravity")
            | {"forces": Key(FORCES, "", "forces on nodes: [{node = 0, force = [0.0, 0.0, -1.0]}]")}
            | FORCE_KEYS,
            "weight and constant forces on nodes",
        ),
        "ground": TableKeys(
            _together(GROUND_KEYS),
            "ground that nodes can touch; [[ground]] for several",
            is_list=True,
        ),
        "prestress": TableKeys(
            keys_of(prestress, "force_density min_force_density max_force_density reference")
            | {
                "per": _PER,
                "shape_gives": Key(
                    TRUTH, "", "true: the shape that is in balance with the loads is found"
                ),
            },
            "force densities (tension per length) in the shape of the structure",
        ),
        "start": TableKeys(
            _START, "how the motion begins, if not at rest in the shape of the structure"
        ),
        "struts": TableKeys(_STRUTS, "bars whose lengths are driven in time"),
        "run": TableKeys(
            keys_of(simulate, "duration step tolerance output_step method sample_time")
            | {"input": _choice("what the actuators hold", *_INPUTS)},
            "duration and accuracy of the simulation",
        ),
        "controller": TableKeys(_together(CONTROLLER_KEYS), "the control law"),
        "winches": TableKeys(
            keys_of(Winches) | keys_of(Motor),
            "limits of the winches that set the rest lengths, and their motors",
        ),
        "sensors": TableKeys(
            keys_of(Sensors) | {"seed": _SEED},
            "standard deviation of each kind of measurement; goes with [estimator]",
        ),
        "estimator": TableKeys(
            {"kind": _choice("which one", "kalman")}
            | keys_of(KalmanFilter, without="sample_time start"),
            "the filter between the sensors and the controller",
        ),
        "faults": TableKeys(
            _together(FAULT_KEYS),
            "strings that are cut, winches that stick, measurements that are lost",
            is_list=True,
            may_be_one=False,
        ),
    }
)

# Entries of lists.
FORCE = MappingProxyType(
    {
        "node": Key(WHOLE, "", "number of the node, from 0"),
        "force": Key(POINT, "N", "force on it"),
    }
)
TRACKED = MappingProxyType(
    {
        "node": FORCE["node"],
        "relative_to": Key(WHOLE, "", "node from which the coordinate is measured"),
        "axis": _choice("axis of the coordinate", "x", "y", "z"),
    }
)
OUTPUT = MappingProxyType(
    TRACKED | keys_of(OutputLimit, without="matrix of", low=NUMBER, high=NUMBER)
)
WAYPOINT = MappingProxyType(
    {
        "start": Key(NUMBER, "s", "when the move begins; at the end of the last one if not given"),
        "time": Key(NUMBER, "s", "when the shape is reached"),
        "height": Key(NUMBER, "m", "distance from the centre of the bottom to that of the top"),
        "twist": Key(NUMBER, "rad", "rotation of the top against the bottom"),
        "top": Key(NODES, "", "nodes of the top; those of a prism if not given"),
        "bottom": Key(NODES, "", "nodes of the bottom; those of a prism if not given"),
        "nodes": Key(NODES, "", "nodes whose positions are demanded"),
        "positions": Key(POINTS, "m", "where they are to be"),
        "force_density": Key(NUMBER, "N/m", "mean force density of the group of the first string"),
    }
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
