"""The structure of a scene, and values given by string or by group."""

from __future__ import annotations

from dataclasses import replace
from difflib import get_close_matches

import numpy as np

from tenscontrol.scene.document import Document, Table
from tenscontrol.scene.keys import MEMBERS, PRISM
from tenscontrol.structure import Structure, prism, skin, subdivide
from tenscontrol.validation import FloatArray, per_member


def build_structure(document: Document) -> Structure:
    """Return the structure: generated or given, then skinned, then cut.

    Parameters
    ----------
    document : Document

    Returns
    -------
    Structure
    """
    structure = _bare(document)
    if document.has("skin"):
        table = document.table("skin")
        table.need("panels")
        with table.checked():
            structure = skin(structure, **table.values)
    if document.has("subdivide"):
        table = document.table("subdivide")
        table.need("segments")
        values = dict(table.values)
        for key in {"segments", "string_mass"} & set(values):
            if isinstance(values[key], dict):
                values[key] = per_string(table, key, structure)
        with table.checked():
            structure = subdivide(structure, **values)
    return structure


def _bare(document: Document) -> Structure:
    if "generator" in document.values["structure"]:
        table = document.table("structure", PRISM, " with a generator")
        table.choice("generator", ("prism",))
        arguments = [key for key in PRISM if key not in ("generator", "fixed")]
        with table.checked():
            made = prism(**table.given(*arguments))
            return replace(made, **table.given("fixed"))
    table = document.table("structure", MEMBERS, " without a generator")
    if not table.values:
        raise table.error(
            None, "[structure] is empty, expected generator = 'prism', or nodes, bars and strings"
        )
    for key in ("nodes", "bars", "strings"):
        table.need(key)
    if table.get("bars"):
        table.need("bar_mass")
    arguments = [key for key in MEMBERS if key not in ("nodes", "bar_mass")]
    with table.checked():
        return Structure(
            nodes=np.array(table.need("nodes"), dtype=float).reshape(-1, 3).T,
            bar_mass=table.get("bar_mass", []),
            **table.given(*arguments),
        )


def whole(structure: Structure) -> Structure:
    """Return the structure with its strings whole: its parent if it was cut."""
    if structure.string_parent is None or structure.parent is None:
        return structure
    return structure.parent


def is_cut(structure: Structure) -> bool:
    """Whether strings of the structure are segments of others."""
    return whole(structure) is not structure


def per_string(table: Table, key: str, structure: Structure) -> FloatArray:
    """Return one value for each string of a structure.

    Parameters
    ----------
    table : Table
    key : str
        A number for all, a list with one per string, or a table by group.
    structure : Structure

    Returns
    -------
    ndarray, shape (α,)

    Raises
    ------
    SceneError
        If a list does not fit, or a table lacks a group or names an unknown one.
    """
    value = table.need(key)
    if not isinstance(value, dict):
        with table.checked(key):
            return per_member(key, value, len(structure.strings), "string")
    groups = tuple(dict.fromkeys(structure.string_groups))
    for group in value:
        if group not in groups:
            near = get_close_matches(group, groups, n=1)
            meant = f"; did you mean {near[0]!r}?" if near else "."
            raise table.error(
                key,
                f"in {table.title}, {key} names the string group {group!r}, which the structure "
                f"does not have{meant} Its groups are: {', '.join(groups) or 'none'}",
            )
    missing = [group for group in groups if group not in value]
    if missing:
        raise table.error(
            key,
            f"in {table.title}, {key} lacks the string group {missing[0]!r}, expected a value for "
            f"each of: {', '.join(groups)}",
        )
    with table.checked(key):
        by_string = [value[group] for group in structure.string_groups]
        return per_member(key, by_string, len(structure.strings), "string")
