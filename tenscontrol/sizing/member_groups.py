"""Groups of members that share a cross section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.structure.point_group import point_group
from tenscontrol.structure.structure import Structure

# Lengths that differ by less than this part are equal.
_EQUAL = 1e-6

Groups = dict[str, list[list[int]]]


def symmetry_groups(structure: Structure) -> Groups:
    """Return members that turns and mirrors of a structure take to each other.

    Parameters
    ----------
    structure : Structure
        Its shape, members and supports; no turn or mirror has to be named.

    Returns
    -------
    dict
        ``"strings"`` and ``"bars"``: lists of indices, every member in one of them. It goes to
        ``design(groups=)``.

    Raises
    ------
    TypeError
        If it is no structure.

    Notes
    -----
    Turns and mirrors about the centroid of the nodes are found by where they can take nodes that
    span all directions. Supports go to supports that hold the same. Loads do not count: with
    groups, a design for one load is also one for the load turned.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> tc.sizing.symmetry_groups(tc.prism())
    {'strings': [[0, 1, 2, 3, 4, 5], [6, 7, 8]], 'bars': [[0, 1, 2]]}
    """
    validation.instance("structure", structure, Structure, "make one by Structure(...)")
    maps = point_group(structure)
    return {
        "strings": _orbits([mapping.strings for mapping in maps]),
        "bars": _orbits([mapping.bars for mapping in maps]),
    }


def length_groups(structure: Structure) -> Groups:
    """Return members of equal length, to 1e-6.

    Parameters
    ----------
    structure : Structure

    Returns
    -------
    dict
        ``"strings"`` and ``"bars"``: lists of indices, every member in one of them. It goes to
        ``design(groups=)``.

    Raises
    ------
    TypeError
        If it is no structure.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> groups = tc.sizing.length_groups(tc.library.six_bar_ball())
    >>> [len(group) for group in groups["strings"]], [len(group) for group in groups["bars"]]
    ([24], [6])
    """
    validation.instance("structure", structure, Structure, "make one by Structure(...)")
    return {
        "strings": _equal(structure.string_length()),
        "bars": _equal(structure.bar_length),
    }


def _orbits(images: Sequence[IntArray]) -> list[list[int]]:
    """Return the members that maps of a group take to each other."""
    least = np.min(images, axis=0)  # closed under composition: one step reaches all
    return [np.flatnonzero(least == first).tolist() for first in np.unique(least)]


def _equal(length: FloatArray) -> list[list[int]]:
    order = np.argsort(length, kind="stable")
    step = np.diff(length[order]) > _EQUAL * length[order][1:]
    parts = np.split(order, np.flatnonzero(step) + 1) if len(order) else []
    return [sorted(members.tolist()) for members in parts]


def area_of_member(structure: Structure, groups: Any) -> IntArray:
    """Return which area each member has, strings first, shape (α + β,), of checked groups."""
    counts = {"strings": len(structure.strings), "bars": len(structure.bars)}
    area = np.arange(sum(counts.values()))
    if groups is None:
        return area
    if not isinstance(groups, Mapping):
        raise validation.wrong_kind(
            "groups", groups, '{"strings": […], "bars": […]}, lists of groups of members'
        )
    for kind in groups:
        validation.choice("groups", kind, counts)
    for kind, first in (("strings", 0), ("bars", counts["strings"])):
        place = f'groups["{kind}"]'
        seen: dict[int, int] = {}
        for i, group in enumerate(validation.items(place, groups.get(kind, ()), "groups")):
            name = f"{place}[{i}]"
            if isinstance(group, str) and kind == "strings":
                members = structure.strings_in(group).tolist()
            else:
                members = validation.index_list(name, group, counts[kind], kind).tolist()
            for member in members:
                if member in seen:
                    raise ValueError(
                        f"{name} has {kind[:-1]} {member}, which is in {place}[{seen[member]}] too"
                    )
                seen[member] = i
            area[[first + member for member in members]] = first + min(members, default=0)
    return np.unique(area, return_inverse=True)[1]
