"""Forces of the bars of a plant, to first order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.tangent import Tangent, tangent
from tenscontrol.plant.linear_plant import LinearPlant, kept
from tenscontrol.plant.string_outputs import input_matrix, to_model_strings
from tenscontrol.structure.supports import is_movable


@dataclass(frozen=True, eq=False)
class BarMap:
    """Axial forces of the bars, N, positive in compression, about the operating point.

    By the state and the input of the plant; and, at rest, by the state and by γ of the strings, as
    along a reference whose γ is known.
    """

    force: FloatArray  # (β,), N, at the operating point
    by_state: FloatArray  # (β, s)
    by_input: FloatArray  # (β, m)
    string_force_density: FloatArray  # (α',), N/m, γ at the operating point
    by_state_at_rest: FloatArray  # (β, s), with γ held
    by_force_density: FloatArray  # (β, α')


@kept
def bar_map(plant: LinearPlant) -> BarMap:
    """Return the forces of the bars, or refuse bars whose forces statics alone does not give."""
    structure = plant.model.structure
    shared = np.setdiff1d(
        np.flatnonzero(is_movable(structure, structure.bars)), structure.kept_bars
    )
    if len(shared):
        raise ValueError(
            f"the force of bar {shared[0]} is not determined: rigid bars around it share a load as "
            "their elasticity has it"
        )
    gamma = to_model_strings(plant, "force_density", plant.force_density)
    held = to_model_strings(plant, plant.input, plant.string_values)
    load = plant.external_force
    here = tangent(plant.model, plant.nodes, plant.input, held, load)
    at_rest = tangent(plant.model, plant.nodes, "force_density", gamma, load)
    none = np.zeros((len(structure.kept_bars), 1))
    return BarMap(
        force=_forces(plant, at_rest, at_rest.force[:, None], none)[:, 0],
        by_state=_by_state(plant, here),
        by_input=_by_input(plant, here) @ input_matrix(plant, plant.input),
        string_force_density=gamma,
        by_state_at_rest=_by_state(plant, at_rest),
        by_force_density=_by_input(plant, at_rest),
    )


def _by_state(plant: LinearPlant, here: Tangent) -> FloatArray:
    """Return the slopes of the forces by ``[q; q̇]``, shape (β, s)."""
    T = plant.basis
    by_q = _forces(plant, here, -(here.stiffness @ T), -(here.curvature @ T))
    still = np.zeros((here.curvature.shape[0], T.shape[1]))
    return np.hstack([by_q, _forces(plant, here, -(here.damping @ T), still)])


def _by_input(plant: LinearPlant, here: Tangent) -> FloatArray:
    """Return the slopes of the forces by the input of all strings of the model, shape (β, α')."""
    inputs = here.by_input.toarray()
    return _forces(plant, here, inputs, np.zeros((here.curvature.shape[0], inputs.shape[1])))


def _forces(plant: LinearPlant, here: Tangent, forces: FloatArray, bent: FloatArray) -> FloatArray:
    """Return the forces of all bars from the right sides of the equations, N, shape (β, k)."""
    structure = plant.model.structure
    forces_of_bars = np.zeros((len(structure.bars), forces.shape[1]))
    forces_of_bars[structure.kept_bars] = here.bar_force_densities(forces, bent)
    return forces_of_bars * structure.bar_length[:, None]
