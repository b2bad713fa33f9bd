"""A commented scene file for each structure of the library."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import getdoc
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.string_laws import LinearStrings
from tenscontrol.plant.controllability import controllability
from tenscontrol.plant.linearize import linearize
from tenscontrol.plant.modes import modes
from tenscontrol.scene.kinds import TABLES_OF_KEYS
from tenscontrol.scene.schema import (
    CONTROLLER_KEYS,
    GENERATOR_KEYS,
    GENERATORS,
    LAW_KEYS,
    TABLES,
    Key,
    Keys,
)
from tenscontrol.statics.prestress import prestress
from tenscontrol.structure.structure import Structure

# Arguments without a default. A flat net has all strings taut where its edges are held.
_SIZES: Mapping[str, dict[str, Any]] = {
    "net": {"rows": 5, "columns": 5, "spacing": 0.5, "node_mass": 0.1, "fixed": "edges"},
    "prism_tower": {"stages": 2},
}

# Least force density, N/m; how much stiffer strings are than the largest; periods of the slowest
# mode that are simulated; samples in a period of the fastest; and the size of the disturbance.
_LEAST, _STIFFER, _PERIODS, _SAMPLES, _DISTURBED = 20.0, 20.0, 5.0, 8.0, 0.01

# The horizon of MPC in samples. With more strings, or more states, a command takes longer.
_HORIZON, _MOST_STRINGS, _MOST_STATES = 20, 12, 40


def scene_names() -> dict[str, str]:
    """Return the names of the structures that :func:`scene_template` takes, with a line each.

    Returns
    -------
    dict of str to str
        By name, in alphabetical order: what the structure is.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.scene.scene_names()["d_bar"]
    'The D-bar: a diamond of four bars joined at their ends, with strings as diagonals.'
    """
    return {name: _title(name) for name in sorted(GENERATORS)}


def _title(name: str) -> str:
    """Return the first line of a generator's docstring, without its verb."""
    line = (getdoc(GENERATORS[name]) or name).partition("\n")[0].removeprefix("Return ")
    return line[:1].upper() + line[1:]


def scene_template(name: str) -> str:
    """Return a commented scene file for a structure of the library, as TOML.

    The scene has a prestress, strings of finite stiffness, a disturbed start and, where the
    strings reach all modes, a controller: MPC for structures with few strings, LQR for others.

    Parameters
    ----------
    name : str
        A function of :mod:`tenscontrol.library`.

    Returns
    -------
    str
        The text of the file. :func:`load_scene` reads it as it is.

    Raises
    ------
    ValueError
        If ``name`` is not one of :func:`scene_names`.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> text = tc.scene.scene_template("six_bar_ball")
    >>> print(text[text.index("[start]") : text.index("# velocities")])
    [start]  # how the motion begins, if not at rest in the shape of the structure
    disturbance = 0.02  # m: random change of shape, as far as the node that moves most
    seed = 1            # seed of the random numbers
    <BLANKLINE>
    """
    validation.choice("name", name, tuple(scene_names()))
    keys = GENERATOR_KEYS[name]
    sizes = _SIZES.get(name, {})
    sizes = {key: known.default for key, known in keys.items() if _has_default(known)} | sizes
    structure = GENERATORS[name](**sizes)
    rest = prestress(structure, min_force_density=_LEAST)
    stiffness = _digits(_STIFFER * float(rest.force_density.max()))
    model = Model(structure, strings=LinearStrings(stiffness, stiffness / 500))
    plant = linearize(model, rest, input="rest_length")
    vibrations = np.abs(modes(plant).pole) / (2 * np.pi)
    slowest = float(vibrations[vibrations > 1e-3 * vibrations.max()].min())
    sample_time = _nice(1 / (_SAMPLES * float(vibrations.max())))
    size = structure.size
    duration = max(1.0, _nice(_PERIODS / slowest))
    missed = len(controllability(plant).unreached)
    parts = [
        _header(name),
        _table("structure", {"generator": name, **sizes}, keys),
        _table(
            "strings",
            {"law": "linear", "stiffness": stiffness, "damping": stiffness / 500},
            LAW_KEYS["linear"],
        ),
        _table("prestress", {"min_force_density": _LEAST}, TABLES["prestress"].keys),
        _table(
            "start", {"disturbance": _digits(_DISTURBED * size), "seed": 1}, TABLES["start"].keys
        ),
        _controller(structure, plant.A.shape[0], sample_time, missed),
        _table(
            "run",
            {
                "duration": duration,
                "tolerance": 1e-6,
                "output_step": duration / 200,
                "method": "auto",
                "input": "rest_length",
            },
            TABLES["run"].keys,
        ),
    ]
    written = "\n\n".join(parts)
    return f"{written}\n\n{_others(written)}\n"


def _header(name: str) -> str:
    return (
        f"# {_title(name)}\n"
        "#\n"
        f"#   tenscontrol simulate {name}.toml\n"
        f"#   tenscontrol modes {name}.toml\n"
        "#\n"
        "# All quantities are in SI units. Keys behind a # are optional: with a value, it is the\n"
        "# default."
    )


def _controller(structure: Structure, states: int, sample_time: float, missed: int) -> str:
    """Return the table of a controller, as a comment where it would leave modes alone."""
    small = len(structure.strings) <= _MOST_STRINGS and states <= _MOST_STATES and not missed
    values: dict[str, Any] = {"kind": "mpc" if small else "lqr", "input": "rest_length"}
    values |= {"horizon": _HORIZON} if small else {}
    values |= {"sample_time": sample_time}
    keys = CONTROLLER_KEYS[values["kind"]]
    if not missed:
        return _table("controller", values, keys)
    title, *lines = _table("controller", values, {key: keys[key] for key in values}).splitlines()
    return "\n".join(
        [
            f"# There is no controller, as the strings do not reach {missed} of the "
            f"{states // 2} modes.",
            "# Remove the first # of these lines for an LQR that leaves those modes alone:",
            *(f"# {line}" for line in (title, *lines)),
        ]
    )


def _table(name: str, values: Mapping[str, Any], keys: Keys) -> str:
    """Return a table with the keys that have a value, then the others as comments."""
    lines = [(f"{key} = {_toml(value)}", key) for key, value in values.items()]
    for name_of_key, key in keys.items():
        if name_of_key not in values:
            default = f" {_toml(key.default)}" if _has_default(key) else ""
            lines.append((f"# {name_of_key} ={default}", name_of_key))
    width = max(len(line) for line, _ in lines)
    written = [f"{line:<{width}}  {comment(f'{name}.{key}', keys[key])}" for line, key in lines]
    return "\n".join([f"[{name}]  # {TABLES[name].meaning}", *written])


def comment(path: str, key: Key) -> str:
    """Return unit and meaning of a key as a comment; ``path`` is like ``controller.outputs``."""
    where = f", in tables [[{path}]]" if key.kind is TABLES_OF_KEYS else ""
    return f"# {f'{key.unit}: ' if key.unit else ''}{key.meaning}{where}"


def _has_default(key: Key) -> bool:
    return key.default is not None and key.default != ()


def _others(written: str) -> str:
    """Return the tables that the text does not have, as comments."""
    absent = {name: table for name, table in TABLES.items() if f"[{name}]" not in written}
    titles = [f"[{name}]" if table.may_be_one else f"[[{name}]]" for name, table in absent.items()]
    width = max(map(len, titles))
    lines = [
        f"#   {title:<{width}}  {table.meaning}"
        for title, table in zip(titles, absent.values(), strict=True)
    ]
    return "\n".join(["# Other tables (see the documentation, Scene files):", *lines])


def _toml(value: Any) -> str:
    """Return a word, a truth or a number as TOML."""
    if isinstance(value, str):
        return f'"{value}"'
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _digits(value: float, count: int = 1) -> float:
    """Return a number rounded to so many digits."""
    return float(f"{value:.{count - 1}e}")


def _nice(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a number."""
    power = 10.0 ** np.floor(np.log10(value))
    return _digits(float(max(f * power for f in (1, 2, 5) if f * power <= value * (1 + 1e-9))))
