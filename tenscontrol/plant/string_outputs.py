"""Force densities and tensions of the strings of a plant; maps between strings and segments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from tenscontrol.actuation.driven_strings import member_rows
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.plant.linear_plant import LinearPlant, kept
from tenscontrol.structure.segments import to_segments, to_strings

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def to_model_strings(plant: LinearPlant, quantity: str, values: FloatArray) -> FloatArray:
    """Return values of the model's strings from those of the commanded ones, on the last axis."""
    structure = plant.model.structure
    return values if plant.commanded is structure else to_segments(structure, quantity, values)


def to_commanded_strings(plant: LinearPlant, quantity: str, values: FloatArray) -> FloatArray:
    """Return values of the commanded strings from those of the model's, on the last axis."""
    structure = plant.model.structure
    return values if plant.commanded is structure else to_strings(structure, quantity, values)


def model_input(plant: LinearPlant, u: Any) -> Any:
    """Return the expression of the values of the model's strings from the inputs of a plant.

    Where lengths of bars are the input, those of the operating point.
    """
    if plant.input == "bar_length":
        return ca.DM(plant.rest_length)
    if _is_of_strings(plant):
        return u
    strings = member_rows(plant.input, plant.commanded)[0]
    offset = to_model_strings(plant, plant.string_input, plant.actuation.offset[strings])
    moved = ca.mtimes(ca.sparsify(ca.DM(input_matrix(plant, plant.string_input))), u)
    return moved + ca.sparsify(ca.DM(offset))


def input_matrix(plant: LinearPlant, quantity: str) -> FloatArray:
    """Return the change of the model's strings by the inputs of a plant, shape (α', m)."""
    strings = member_rows(plant.input, plant.commanded)[0]
    matrix = plant.actuation.matrix[strings].toarray()
    if plant.input == "bar_length":  # strings keep their rest lengths
        return np.zeros((len(plant.model.structure.strings), matrix.shape[1]))
    return to_model_strings(plant, quantity, matrix.T).T


def _is_of_strings(plant: LinearPlant) -> bool:
    """Whether each string of the model is an input, in order, and nothing else is."""
    whole = plant.commanded is plant.model.structure and plant.actuation.is_whole
    return whole and not plant.drives_bars


@dataclass(frozen=True, eq=False)
class StringMap:
    """Force densities and tensions of the strings of a plant's model, to first order."""

    force_density: FloatArray  # (α',), N/m, at the operating point
    tension: FloatArray  # (α',), N
    gamma_by_state: FloatArray  # (α', s)
    gamma_by_input: csr_array  # (α', m)
    tension_by_state: FloatArray
    tension_by_input: csr_array


@kept
def string_map(plant: LinearPlant, input: str) -> StringMap:
    """Return the map of a plant's strings for an input, which need not be that of the plant.

    Where lengths of bars are inputs, bars that grow move the nodes.
    """
    from scipy.sparse import csc_array, csr_array

    bars = plant.input_displacements if input == plant.input else None
    input = plant.string_input if input == plant.input else input
    shape, count = plant.nodes.shape, len(plant.model.structure.strings)
    held = plant.rest_length if input == "rest_length" else plant.force_density
    assert held is not None  # there is a law
    given = [ca.SX.sym("N", *shape), ca.SX.sym("Nd", *shape), ca.SX.sym("u", count)]
    outputs = [ca.densify(output) for output in string_forces(plant, input, *given)]
    # By nodes these derivatives are sparse: the basis comes in as numbers.
    slopes = [ca.jacobian(y, ca.vec(x)) for y in outputs for x in given]
    function = Function("strings", given, outputs + slopes)
    derivatives = function(plant.nodes, np.zeros(shape), to_model_strings(plant, input, held))
    values = [value.sparse() for value in derivatives]
    by_state = [np.hstack([slope @ plant.basis for slope in values[k : k + 2]]) for k in (2, 5)]
    by_input = [values[k] for k in (4, 7)]
    if not _is_of_strings(plant):
        spread = csc_array(input_matrix(plant, input))
        by_input = [slope @ spread for slope in by_input]
    if bars is not None:
        moved = csc_array(bars)
        by_input = [slope + values[k] @ moved for slope, k in zip(by_input, (2, 5), strict=True)]
    return StringMap(
        force_density=values[0].toarray().ravel(),
        tension=values[1].toarray().ravel(),
        gamma_by_state=by_state[0],
        gamma_by_input=csr_array(by_input[0]),
        tension_by_state=by_state[1],
        tension_by_input=csr_array(by_input[1]),
    )


def string_forces(plant: LinearPlant, input: str, N: Any, Nd: Any, u: Any) -> tuple[Any, Any]:
    """Return γ and tension of the model's strings, by rest lengths those of taut ones or < 0."""
    law = plant.model.strings
    length, rate = (row.T for row in kernel.string_motion(plant.model.structure, N, Nd))
    gamma = u
    if input == "rest_length":
        assert law is not None  # a rest length is held
        gamma = law.taut_force_density(length, u, rate)
        if len(plant.slack):
            gamma[plant.slack.tolist()] = 0.0
    return gamma, gamma * length
