"""Weights of bars and point masses."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, float_array


def gravity_vector(gravity: object, dimension: int) -> FloatArray:
    """Return the acceleration of free fall, m/s², shape (d,), from what a user gives."""
    vector = float_array("gravity", gravity)
    if vector.ndim == 0:
        if vector < 0:
            raise ValueError(
                f"gravity is {vector:g} m/s², expected at least 0: a number is the size of an "
                f"acceleration that points down. Give {-vector:g}, or a vector"
            )
        return np.append(np.zeros(dimension - 1), -float(vector))
    if vector.shape != (dimension,):
        raise ValueError(
            f"gravity has shape {vector.shape}, expected () or ({dimension},): m/s² downward, or a "
            "vector"
        )
    return vector


def weights(
    structure: Structure, gravity: FloatArray, bar_mass: FloatArray, point_mass: FloatArray
) -> FloatArray:
    """Return the weights at the nodes, N, shape (…, d, n): half a bar's at each of its ends.

    Of masses of shape (…, β) and (…, n), kg, and a fall of shape (…, d), m/s².
    """
    runs = np.broadcast_shapes(gravity.shape[:-1], bar_mass.shape[:-1], point_mass.shape[:-1])
    mass = np.broadcast_to(point_mass, (*runs, point_mass.shape[-1])).copy()
    halves = np.broadcast_to(bar_mass[..., None] / 2, (*runs, len(structure.bars), 2))
    places: Any = (..., structure.bars)
    np.add.at(mass, places, halves)
    return np.asarray(gravity[..., None] * mass[..., None, :])
