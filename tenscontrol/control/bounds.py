"""Bounds of the commands."""

from __future__ import annotations

import numpy as np

from tenscontrol.analysis import LinearPlant
from tenscontrol.validation import FloatArray, per_member, positive

# A rest length is kept above this fraction of its value at the operating point.
_SHORTEST = 0.01


def input_bounds(plant: LinearPlant, max_force_density: object) -> tuple[FloatArray, FloatArray]:
    """Return least and largest command of a plant, shape (α,) each.

    Parameters
    ----------
    plant : LinearPlant
    max_force_density : float or array_like, shape (α,), or None
        N/m.

    Returns
    -------
    low, high : ndarray, shape (α,)
        ``0 ≤ γ ≤ max_force_density``, or a positive rest length.

    Raises
    ------
    TypeError, ValueError
        If the limit does not fit, or does not leave room for the operating point.
    """
    count = plant.B.shape[1]
    if plant.input == "rest_length":
        if max_force_density is not None:
            raise ValueError(
                "max_force_density limits plants with input='force_density'; this one has "
                "input='rest_length', and winches limit rest lengths"
            )
        return _SHORTEST * plant.equilibrium_input, np.full(count, np.inf)
    if max_force_density is None:
        return np.zeros(count), np.full(count, np.inf)
    high = per_member("max_force_density", max_force_density, count, "string")
    positive("max_force_density", high, "force density in N/m")
    over = np.flatnonzero(plant.force_density > high)
    if len(over):
        i = over[0]
        raise ValueError(
            f"max_force_density[{i}] is {high[i]:g} N/m, but string {i} has "
            f"{plant.force_density[i]:g} N/m at the operating point; expected at least that"
        )
    return np.zeros(count), high
