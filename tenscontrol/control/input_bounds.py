"""Bounds of the commands and of their changes."""

from __future__ import annotations

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.plant import LinearPlant
from tenscontrol.validation import FloatArray, per_member, positive

# A rest length is kept above this fraction of its value at the operating point.
_SHORTEST = 0.01


def input_bounds(
    plant: LinearPlant, max_force_density: object, winches: Winches | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return least and largest command, shape (α,) each, of γ, N/m, or of rest lengths, m.

    Raises TypeError or ValueError if a limit does not fit, or excludes the operating point.
    """
    count = plant.B.shape[1]
    if plant.input == "rest_length":
        if max_force_density is not None:
            raise ValueError(
                "max_force_density limits plants with input='force_density'; this one has "
                "input='rest_length', and winches limit rest lengths"
            )
        least, most = _SHORTEST * plant.equilibrium_input, np.full(count, np.inf)
        if winches is not None:
            winches.refuse_out_of_range("plant.rest_length", plant.equilibrium_input)
            if winches.shortest is not None:
                least = np.maximum(least, winches.shortest)
            if winches.longest is not None:
                most = np.minimum(most, winches.longest)
        return least, most
    if winches is not None:
        raise ValueError(
            "winches limit rest lengths, but plant has input='force_density'; linearize with "
            "input='rest_length'"
        )
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


def largest_change(
    plant: LinearPlant, max_change: object, winches: Winches | None, sample_time: float | None
) -> FloatArray | None:
    """Return the largest change of a command from sample to sample, shape (α,), None for any.

    Raises TypeError or ValueError if a limit does not fit, or there is one but no sample time.
    """
    count = plant.B.shape[1]
    change = None
    if max_change is not None:
        change = per_member("max_change", max_change, count, "string")
        positive("max_change", change, f"change of {plant.input.replace('_', ' ')}")
    rate = None if winches is None else winches.rate
    if sample_time is None:
        if change is not None or rate is not None:
            name = "max_change" if change is not None else "winches.rate"
            raise ValueError(f"{name} limits changes from sample to sample: give sample_time, s")
        return None
    if rate is not None:
        reach = per_member("winches.rate", rate, count, "string") * sample_time
        change = reach if change is None else np.minimum(change, reach)
    return change
