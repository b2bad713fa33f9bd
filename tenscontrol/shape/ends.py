"""Checks of the two ends of a path."""

from __future__ import annotations

import numpy as np

from tenscontrol.dynamics import Model
from tenscontrol.shape.target import ShapeTarget
from tenscontrol.statics import Prestress
from tenscontrol.structure import (
    free_coordinates,
    refuse_moved_supports,
    refuse_wrong_bar_lengths,
    same_members,
)
from tenscontrol.validation import instance


def path_end(model: Model, name: str, value: object) -> Prestress:
    """Return an end of the path as an equilibrium of this model."""
    rest = value.prestress if isinstance(value, ShapeTarget) else value
    instance(name, rest, Prestress, "make one by shape_target(model, ...) or prestress(...)")
    assert isinstance(rest, Prestress)  # just checked
    structure, ours = rest.structure, model.structure
    if not same_members(structure, ours):
        raise ValueError(
            f"{name} is a prestress of {structure!r}, expected one of the structure of the model, "
            f"{ours!r}, with the same members and fixed nodes"
        )
    refuse_wrong_bar_lengths(name, ours, structure.nodes)
    refuse_moved_supports(name, ours, structure.nodes)
    load = free_coordinates(ours, model.constant_force)
    off = float(np.abs(free_coordinates(ours, rest.external_force) - load).max(initial=0.0))
    if off > 1e-9 * max(float(np.abs(load).max(initial=0.0)), float(rest.force_density.max())):
        raise ValueError(
            f"{name} rests under loads that differ from those of the model by {off:.3g} N; "
            "make it by shape_target(model, ...), or by prestress(..., "
            "external_force=model.constant_force)"
        )
    return rest


def refuse_same(start: Prestress, goal: Prestress) -> None:
    """Raise if there is no way to go."""
    travel = np.linalg.norm(goal.structure.nodes - start.structure.nodes, axis=0).max()
    change = np.abs(goal.force_density - start.force_density).max()
    level = max(float(rest.force_density.max()) for rest in (start, goal))
    size = float(np.ptp(start.structure.nodes, axis=1).max())
    if travel <= 1e-9 * size and change <= 1e-9 * level:
        raise ValueError("start and goal are the same shape with the same γ: there is no way to go")
