"""How force densities and tensions change with the state and the input of a plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics import kernel
from tenscontrol.plant import LinearPlant
from tenscontrol.structure import spread_force_density, spread_rest_length
from tenscontrol.validation import FloatArray


@dataclass(frozen=True, eq=False)
class StringMap:
    """First-order force densities and tensions of the strings of a plant's model.

    Attributes
    ----------
    force_density, tension : ndarray, shape (α',)
        γ, N/m, and tension, N, at the operating point, one a string of the model.
    gamma_by_state, tension_by_state : ndarray, shape (α', s)
    gamma_by_input, tension_by_input : ndarray, shape (α', α)
    """

    force_density: FloatArray
    tension: FloatArray
    gamma_by_state: FloatArray
    gamma_by_input: FloatArray
    tension_by_state: FloatArray
    tension_by_input: FloatArray


def string_map(plant: LinearPlant, held: str) -> StringMap:
    """Return the map of a plant's strings, with γ or the rest length as the input.

    Parameters
    ----------
    plant : LinearPlant
    held : {"force_density", "rest_length"}
        Need not be the input of the plant.
    """
    structure, r = plant.model.structure, plant.degrees_of_freedom
    n, count = structure.nodes.shape[1], len(structure.strings)
    q, rates, u = ca.SX.sym("q", r), ca.SX.sym("rates", r), ca.SX.sym("u", count)
    T = ca.sparsify(ca.DM(plant.basis))
    N = ca.DM(plant.nodes) + ca.reshape(ca.mtimes(T, q), 3, n)
    Nd = ca.reshape(ca.mtimes(T, rates), 3, n)
    at = spread(plant, "force_density", plant.force_density)
    if held == "rest_length":
        assert plant.rest_length is not None  # there is a law
        at = spread(plant, "rest_length", plant.rest_length)
    z = ca.vertcat(q, rates)
    outputs = [ca.densify(part) for part in string_forces(plant, held, N, Nd, u)]
    function = ca.Function(
        "strings",
        [z, u],
        outputs + [ca.densify(ca.jacobian(y, x)) for y in outputs for x in (z, u)],
    )
    values = [np.array(value.full()) for value in function(np.zeros(2 * r), at)]
    whole = np.eye(plant.B.shape[1])
    spreading = np.column_stack([spread(plant, held, column) for column in whole])
    return StringMap(
        force_density=values[0].ravel(),
        tension=values[1].ravel(),
        gamma_by_state=values[2],
        gamma_by_input=values[3] @ spreading,
        tension_by_state=values[4],
        tension_by_input=values[5] @ spreading,
    )


def string_forces(plant: LinearPlant, held: str, N: Any, Nd: Any, u: Any) -> tuple[Any, Any]:
    """Return expressions of γ and tension of the strings, shape (α', 1) each.

    Where the rest length is held, they are those of strings that pull, and negative beyond.

    Parameters
    ----------
    plant : LinearPlant
    held : {"force_density", "rest_length"}
    N, Nd : casadi matrix, shape (3, n)
        Motion of the nodes.
    u : casadi vector, shape (α', 1)
        What is held of each string of the model.
    """
    strings, law = plant.model.structure.strings, plant.model.strings
    S, Sd = (kernel.differences(part, strings) for part in (N, Nd))
    length = ca.sqrt(kernel.dots(S, S)).T
    gamma = u
    if held == "rest_length":
        assert law is not None  # a rest length is held
        gamma = law.taut_force_density(length, u, kernel.dots(S, Sd).T / length)
    return gamma, gamma * length


def spreading(plant: LinearPlant, u: Any) -> Any:
    """Return the expression of the inputs of the model's strings from the commanded ones."""
    if plant.commanded is plant.model.structure:
        return u
    columns = [spread(plant, plant.input, row) for row in np.eye(plant.B.shape[1])]
    return ca.mtimes(ca.sparsify(ca.DM(np.column_stack(columns))), u)


def spread(plant: LinearPlant, what: str, values: FloatArray) -> FloatArray:
    """Return γ or rest lengths of the model's strings from those of the commanded ones.

    Parameters
    ----------
    plant : LinearPlant
    what : {"force_density", "rest_length"}
    values : ndarray, shape (α,)
    """
    structure = plant.model.structure
    if plant.commanded is structure:
        return values
    if what == "force_density":
        return spread_force_density(structure, values)
    return spread_rest_length(structure, values)


def gather_lengths(plant: LinearPlant, values: FloatArray) -> FloatArray:
    """Return lengths of the commanded strings from those of the model's, along the last axis."""
    structure = plant.model.structure
    if plant.commanded is structure:
        return values
    of = structure.string_parent
    assert of is not None  # a subdivision
    total = np.zeros((*values.shape[:-1], len(plant.commanded.strings)))
    for segment, string in enumerate(of.tolist()):
        total[..., string] += values[..., segment]
    return total
