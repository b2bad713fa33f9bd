"""Inputs of a model that are held over a step."""

from __future__ import annotations

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Profile
from tenscontrol.structure.structure import Structure


def own_input(model: Model, rest_length: object, force_density: object) -> tuple[object, object]:
    """Return rest lengths and γ, one of them None, for a structure without strings.

    It needs neither, and rest lengths of no strings need no law. Others are returned as given.
    """
    count = len(model.structure.strings)
    if count or force_density is not None:
        return rest_length, force_density
    if rest_length is not None:
        validation.per_member("rest_length", rest_length, count, "string")
    return (None, ()) if rest_length is None or model.strings is None else (rest_length, None)


def given_load(model: Model, external_force: object) -> FloatArray:
    """Return a load beside what is built in, N, shape (d, n): of a model that takes none, 0."""
    if callable(external_force) or isinstance(external_force, Profile):
        refuse_load(model)
    load = validation.node_forces("external_force", external_force, model.structure.nodes.shape)
    if load.any():
        refuse_load(model)
    return load


def refuse_load(model: Model) -> None:
    """Raise if a model takes no load as an input."""
    if not model.has_external_force:
        raise ValueError(
            "the model takes no load as an input; build it as Model(structure, external_force=True)"
        )


def held_value(structure: Structure, rest_length: object, force_density: object) -> FloatArray:
    """Return what is held, shape (α,): the one that is not None, checked."""
    count = len(structure.strings)
    if force_density is None:
        values = validation.per_member("rest_length", rest_length, count, "string")
        return validation.positive("rest_length", values, "length in m")
    gamma = validation.per_member("force_density", force_density, count, "string")
    return validation.non_negative("force_density", gamma, "a string can only pull")
