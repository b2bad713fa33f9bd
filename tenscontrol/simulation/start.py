"""What a simulation starts from and what acts on it, checked."""

from __future__ import annotations

import numpy as np

from tenscontrol.dynamics import Model, pack_state
from tenscontrol.structure import (
    refuse_moved_supports,
    refuse_strings_without_length,
    refuse_wrong_bar_lengths,
)
from tenscontrol.validation import FloatArray, non_negative, per_member, positive, shaped


def held_value(model: Model, rest_length: object, force_density: object) -> FloatArray:
    """Return what is held, shape (α,): the one that is not None, checked."""
    if force_density is None:
        values = per_member("rest_length", rest_length, len(model.structure.strings), "string")
        return positive("rest_length", values, "length in m")
    gamma = per_member("force_density", force_density, len(model.structure.strings), "string")
    return non_negative("force_density", gamma, "a string can only pull")


def checked_load(model: Model, external_force: object) -> FloatArray:
    """Return all that acts on the nodes from outside, N, shape (3, n)."""
    if not model.has_external_force:
        if external_force is not None:
            raise ValueError(
                "the model takes no load as an input; build it as "
                "Model(structure, external_force=True)"
            )
        return model.constant_force
    shape = model.structure.nodes.shape
    if external_force is None:
        raise ValueError("the model takes a load: give external_force, shape (3, n), N")
    given = shaped("external_force", external_force, shape, "one force per node")
    return given + model.constant_force


def initial_state(model: Model, nodes: object, velocities: object, input: str) -> FloatArray:
    """Return the state at the start, after checking that the structure can be in it."""
    structure = model.structure
    N = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    V = np.zeros_like(N)
    if velocities is not None:
        V = structure.checked_nodes("velocities", velocities)
    refuse_wrong_bar_lengths("nodes", structure, N)
    refuse_moved_supports("nodes", structure, N)
    moving = np.flatnonzero(V[:, structure.fixed].any(axis=0))
    if len(moving):
        node = structure.fixed[moving[0]]
        raise ValueError(f"velocities move the fixed node {node} by {V[:, node]} m/s, expected 0")
    if input == "rest_length":
        refuse_strings_without_length("nodes", structure, N)
    bars, rates = structure.bar_vectors(N), structure.bar_vectors(V)
    stretching = np.abs((bars * rates).sum(axis=0)) / structure.bar_length
    allowed = 1e-8 * max(float(np.abs(V).max()), 1e-300)
    if stretching.size and stretching.max() > allowed:
        worst = int(stretching.argmax())
        raise ValueError(
            f"velocities stretch bar {worst} at {stretching[worst]:.3g} m/s, expected 0: bars "
            "are rigid. plant.to_velocities(q, rates) gives velocities that bars can have"
        )
    return pack_state(structure, N, V)
