"""Inputs of a simulation, loads among them: held, or pieces of polynomials in time."""

from __future__ import annotations

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.held_inputs import given_load, held_value
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Pieces, Profile, as_pieces
from tenscontrol.structure.structure import Structure

# An input below zero by this part of its largest value is zero.
_ROUND_OFF = 1e-12


def changes_in_time(value: object) -> bool:
    """Return whether an argument may change in time."""
    return isinstance(value, Profile) or callable(value)


def checked_inputs(
    structure: Structure, rest_length: object, force_density: object, start: float, end: float
) -> Pieces:
    """Return what is held, or changes: the one of the two that is not None, checked."""
    name = "rest_length" if force_density is None else "force_density"
    value = rest_length if force_density is None else force_density
    if not changes_in_time(value):
        return Pieces.constant(held_value(structure, rest_length, force_density))
    shape = (len(structure.strings),)
    pieces = as_pieces(name, value, shape, "one per string", start, end)
    least, time = pieces.least(start, end)
    round_off = _ROUND_OFF * float(np.abs(pieces.coefficients[:, :, 0]).max(initial=0.0))
    if least < -round_off or (least <= 0 and name == "rest_length"):
        meaning = "a positive length in m" if name == "rest_length" else "at least 0"
        raise ValueError(
            f"{name} falls to {least:.3g} at {time:.6g} s, expected {meaning}. Cubic interpolation "
            "may go below the values given; linear interpolation does not"
        )
    return pieces


def load_in_time(
    model: Model, external_force: object, start: float, end: float
) -> FloatArray | Pieces:
    """Return all that acts on the nodes from outside, N, shape (d, n), or in time."""
    if not (model.has_external_force and changes_in_time(external_force)):
        return checked_load(model, external_force)
    shape = model.structure.nodes.shape
    pieces = as_pieces("external_force", external_force, shape, "one force per node", start, end)
    return Pieces.added([pieces, Pieces.constant(model.constant_force.ravel(order="F"))])


def checked_load(model: Model, external_force: object) -> FloatArray:
    """Return all that acts on the nodes from outside, N, shape (d, n)."""
    if external_force is not None:
        return given_load(model, external_force) + model.constant_force
    if model.has_external_force:
        d = model.structure.dimension
        raise ValueError(f"the model takes a load: give external_force, shape ({d}, n), N, or 0")
    return model.constant_force
