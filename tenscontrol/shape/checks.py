"""Checks of what a demand is made of."""

from __future__ import annotations

import numpy as np

from tenscontrol.structure import Structure
from tenscontrol.validation import IntArray, float_array, frozen


def node_list(name: str, nodes: object) -> IntArray:
    """Return node indices, at least one and each once."""
    array = float_array(name, nodes)
    if array.ndim != 1 or len(array) == 0:
        raise ValueError(f"{name} has shape {array.shape}, expected (k,): indices of nodes")
    for i, node in enumerate(array.tolist()):
        if not node.is_integer():
            raise TypeError(f"{name}[{i}] is {node:g}, expected a whole number")
        if node < 0:
            raise ValueError(f"{name}[{i}] is {node:g}, expected 0 or more: nodes count from 0")
    indices, counts = np.unique(array, return_counts=True)
    if (counts > 1).any():
        raise ValueError(f"{name} has node {indices[counts.argmax()]:g} twice")
    return frozen(array.astype(np.int64))


def refuse_missing(name: str, nodes: IntArray, structure: Structure) -> None:
    """Raise if the structure has no such node."""
    count = structure.nodes.shape[1]
    if nodes.max() >= count:
        i = int(nodes.argmax())
        raise ValueError(
            f"{name}[{i}] is {nodes[i]}, expected 0 to {count - 1}: "
            f"there are {count} nodes, counted from 0"
        )


def refuse_bad_directions(directions: object) -> None:
    """Raise if these are not letters out of "xyz"."""
    fits = isinstance(directions, str) and directions and not set(directions) - set("xyz")
    if not fits or len(set(str(directions))) < len(str(directions)):
        raise ValueError(f"directions is {directions!r}, expected letters out of 'xyz', each once")


def axis_rows(directions: str) -> list[int]:
    """Return the rows of N that the letters name."""
    return ["xyz".index(axis) for axis in directions]


def checked_tolerance(value: object, unit: str) -> float:
    """Return a tolerance, at least 0."""
    number = float_array("tolerance", value)
    if number.ndim or number < 0:
        raise ValueError(f"tolerance is {value!r}, expected one number in {unit}, at least 0")
    return float(number)


def one_number(name: str, value: object, unit: str) -> float:
    """Return a single finite number."""
    number = float_array(name, value)
    if number.ndim:
        raise ValueError(f"{name} has shape {number.shape}, expected one number in {unit}")
    return float(number)
