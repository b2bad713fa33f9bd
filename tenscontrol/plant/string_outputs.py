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
from tenscontrol.dynamics.tangent import string_stretch
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
    if is_of_strings(plant):
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


def is_of_strings(plant: LinearPlant) -> bool:
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
    from scipy.sparse import csc_array, csr_array, diags_array

    bars = plant.input_displacements if input == plant.input else None
    input = plant.string_input if input == plant.input else input
    structure, count = plant.model.structure, len(plant.model.structure.strings)
    held = plant.rest_length if input == "rest_length" else plant.force_density
    assert held is not None  # there is a law
    given = [ca.SX.sym(name, count) for name in ("length", "u", "rate")]
    gamma = _force_density(plant, input, *given)
    # Entry by entry: one direction has all derivatives.
    slopes = [ca.densify(ca.jtimes(gamma, x, ca.DM.ones(count))) for x in given]
    function = Function("strings", given, [ca.densify(gamma), *slopes])
    length = structure.string_length(plant.nodes)
    values = function(length, to_model_strings(plant, input, held), np.zeros(count))
    gamma, by_length, by_own, by_rate = (np.array(value.full()).ravel() for value in values)
    stretch = string_stretch(structure, plant.nodes)
    slopes = [diags_array(by_length) @ stretch, diags_array(by_rate) @ stretch]
    lengths = diags_array(length)
    pulls = [lengths @ slopes[0] + diags_array(gamma) @ stretch, lengths @ slopes[1]]
    by_state = [np.hstack([slope @ plant.basis for slope in own]) for own in (slopes, pulls)]
    by_input = [diags_array(by_own), diags_array(length * by_own)]
    if not is_of_strings(plant):
        spread = csc_array(input_matrix(plant, input))
        by_input = [slope @ spread for slope in by_input]
    if bars is not None:
        moved = csc_array(bars)
        by_input = [
            slope + own[0] @ moved for slope, own in zip(by_input, (slopes, pulls), strict=True)
        ]
    return StringMap(
        force_density=gamma,
        tension=gamma * length,
        gamma_by_state=by_state[0],
        gamma_by_input=csr_array(by_input[0]),
        tension_by_state=by_state[1],
        tension_by_input=csr_array(by_input[1]),
    )


def string_forces(plant: LinearPlant, input: str, N: Any, Nd: Any, u: Any) -> tuple[Any, Any]:
    """Return γ and tension of the model's strings, by rest lengths those of taut ones or < 0."""
    length, rate = (row.T for row in kernel.string_motion(plant.model.structure, N, Nd))
    gamma = _force_density(plant, input, length, u, rate)
    return gamma, gamma * length


def _force_density(plant: LinearPlant, input: str, length: Any, u: Any, rate: Any) -> Any:
    """Return γ of strings, by rest lengths that of taut ones or < 0; columns."""
    if input == "force_density":
        return u
    law = plant.model.strings
    assert law is not None  # a rest length is held
    gamma = law.taut_force_density(length, u, rate)
    if len(plant.slack):
        gamma[plant.slack.tolist()] = 0.0
    return gamma
