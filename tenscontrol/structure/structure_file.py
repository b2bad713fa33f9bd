"""The table of a structure that structure files and scenes share."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.files import read_text, write_file
from tenscontrol.parsing import TomlLimits, parse_json, parse_toml

_Made = TypeVar("_Made")

#: Version of the form; files of a later one are refused.
VERSION = 1
#: Keys of the table of a structure, in the order in which they are written.
STRUCTURE_KEYS = (
    "version", "nodes", "bars", "strings", "string_groups", "bar_mass", "point_mass",
    "string_node_mass", "fixed", "string_parent", "parent",
)  # fmt: skip

_ENDINGS = (".toml", ".json")
_HEAD = """\
# A tensegrity structure of tenscontrol. SI units: nodes in m, masses in kg. Nodes count from 0.
# With [prestress] and [run] added, this is a scene.
"""
# Of 3 million members; each structure that this one was made from is a level.
_MOST_BYTES = 500_000_000
_LIMITS = TomlLimits("a structure file", keys=1_000, lists=20_000_000, levels=16)


def points(name: str, rows: Sequence[Sequence[float]], dimension: int | None = None) -> FloatArray:
    """Return points given one a row, shape (d, n), all with as many coordinates as the first."""
    wanted = "{} is {!r:.60}, expected a list of [x, y, z] (or [x, y])"
    is_list = isinstance(rows, list | tuple)
    if not is_list or not all(isinstance(row, list | tuple) for row in rows):
        raise TypeError(wanted.format(name, rows))
    d = dimension or (len(rows[0]) if rows else 3)
    wrong = [i for i, row in enumerate(rows) if len(row) != d]
    if wrong:
        like = f"{d} coordinates" + ("" if dimension else f" as {name}[0] has")
        raise ValueError(f"{name}[{wrong[0]}] is {rows[wrong[0]]}, expected {like}")
    try:
        return np.array(rows, dtype=float).reshape(-1, d).T
    except (TypeError, ValueError, OverflowError):
        raise TypeError(wanted.format(name, rows)) from None


def to_table(structure: Any) -> dict[str, Any]:
    """Return a structure as a table, in plain Python: it comes back bit by bit."""
    supports = [*structure.fixed.tolist(), *(list(pair) for pair in structure.rollers)]
    table: dict[str, Any] = {
        "version": VERSION,
        "nodes": structure.nodes.T.tolist(),
        "bars": structure.bars.tolist(),
        "strings": list(map(list, structure.paths)) or structure.strings.tolist(),
        "string_groups": list(structure.string_groups),
        "bar_mass": structure.bar_mass.tolist(),
        "point_mass": structure.point_mass.tolist(),
        "fixed": supports,
    }
    if structure.string_parent is not None:
        table["string_parent"] = structure.string_parent.tolist()
    if structure.parent is not None:
        table["parent"] = to_table(structure.parent)
    return table


def from_table(table: Mapping[str, Any], make: Callable[..., _Made]) -> _Made:
    """Return the structure that a table describes; ``make`` is :class:`Structure`."""
    version = validation.whole_number("version", table.get("version", VERSION), 1)
    if version > VERSION:
        raise ValueError(
            f"version is {version}, expected at most {VERSION}: the file is of a later release of "
            "tenscontrol, which can read it"
        )
    if "generator" in table:
        raise ValueError(
            f"generator is {table['generator']!r:.60}, expected nodes, bars and strings: a scene "
            "that generates its structure is read by load_scene(file).structure"
        )
    for key in table:
        if key not in STRUCTURE_KEYS:
            near = get_close_matches(str(key), STRUCTURE_KEYS, n=1)
            meant = f"did you mean {near[0]!r}? " if near else ""
            raise ValueError(
                f"{key!r:.60} is no key of a structure; {meant}The keys are: "
                f"{', '.join(STRUCTURE_KEYS)}"
            )
    needed = ("nodes", "bars", "strings", *(["bar_mass"] if table.get("bars") else []))
    missing = [key for key in needed if key not in table]
    if missing:
        raise ValueError(f"the key {missing[0]!r} is missing; a structure has {', '.join(needed)}")
    values = {key: value for key, value in table.items() if key not in ("version", "nodes")}
    if values.get("parent") is not None:
        if not isinstance(values["parent"], Mapping):
            raise TypeError(
                f"parent is {values['parent']!r:.60}, expected the table of a structure"
            )
        try:
            values["parent"] = from_table(values["parent"], make)
        except (TypeError, ValueError) as error:
            raise type(error)(f"parent: {error}") from error
    return make(points("nodes", table["nodes"]), **{"bar_mass": [], **values})


def write_structure(structure: Any, path: object) -> Path:
    """Write a structure as TOML or JSON, as the name of the file ends."""
    file, table = validation.file_path("path", path, _ENDINGS), to_table(structure)
    if file.suffix.lower() == ".json":
        return write_file(file, json.dumps({"structure": table}, indent=1) + "\n")
    return write_file(file, _HEAD + "\n".join(_lines("structure", table)) + "\n")


def read_structure(path: object, make: Callable[..., _Made]) -> _Made:
    """Return the structure of a TOML or JSON file, or raise a ValueError that names the file."""
    file = validation.file_path("path", path, _ENDINGS)
    text, name = read_text(file, _MOST_BYTES), str(file)
    content: Any
    if file.suffix.lower() == ".json":
        content = parse_json(name, text)
    else:
        content, _ = parse_toml(name, text, _LIMITS)
    table = content.get("structure") if isinstance(content, dict) else None
    if not isinstance(table, dict):
        raise ValueError(f"{file}: no structure: the table [structure] is missing")
    try:
        return from_table(table, make)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError(f"{file}: {error}") from error


def _lines(name: str, table: Mapping[str, Any]) -> list[str]:
    """Return a table as lines of TOML. Lists of lists have a line for each."""
    lines, inner = [f"[{name}]"], []
    for key, value in table.items():
        if isinstance(value, dict):
            inner += ["", *_lines(f"{name}.{key}", value)]
        elif isinstance(value, list) and value and isinstance(value[0], list):
            rows = (f"  {json.dumps(row, ensure_ascii=False)}," for row in value)
            lines += [f"{key} = [", *rows, "]"]
        else:
            lines.append(f"{key} = {json.dumps(value, ensure_ascii=False)}")
    return lines + inner
