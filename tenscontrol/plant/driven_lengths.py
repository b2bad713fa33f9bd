"""Lengths of bars, and their rates, that the inputs of a plant drive."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.actuation.driven_strings import member_rows, moved_by, strings_of
from tenscontrol.arrays import FloatArray
from tenscontrol.plant.linear_plant import LinearPlant

# Driven bars are no longer than so many times their lengths at the operating point.
MOST_LENGTH = 1000.0


def known_size(plant: LinearPlant) -> int:
    """Return how many numbers say what inputs do at a moment.

    Those of the inputs. Where lengths of bars are among these, their rates follow, m/s.
    """
    inputs = len(plant.actuation.lead)
    return 2 * inputs if plant.drives_bars else inputs


def known_at_rest(plant: LinearPlant, inputs: FloatArray) -> FloatArray:
    """Return what inputs do that do not move, see :func:`known_size`."""
    return np.pad(inputs, (0, known_size(plant) - len(inputs)))


def length_symbols(plant: LinearPlant, known: Any) -> tuple[Any, Any] | None:
    """Return expressions of the lengths of all bars, m, and their rates; None where bars are rigid.

    ``known`` is what :func:`known_size` says, a column.
    """
    if not plant.drives_bars:
        return None
    act, inputs = plant.actuation, len(plant.actuation.lead)
    bars = member_rows(plant.input, plant.commanded)[1]
    matrix = ca.sparsify(ca.DM(act.matrix[bars].toarray()))
    rate = ca.mtimes(matrix, known[inputs:])
    return ca.DM(act.offset[bars]) + ca.mtimes(matrix, known[:inputs]), rate


def lengths_of(
    plant: LinearPlant, known: FloatArray | None
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return the lengths of all bars, m, and their rates; None each where bars are rigid."""
    if not plant.drives_bars:
        return None, None
    assert known is not None  # lengths of bars are always known
    bars = member_rows(plant.input, plant.commanded)[1]
    value, rate = np.split(known, 2)
    return strings_of(plant.actuation, value)[bars], moved_by(plant.actuation, rate)[bars]
