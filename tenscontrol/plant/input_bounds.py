"""Bounds of the inputs of a plant, and of their change from sample to sample."""

from __future__ import annotations

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    Actuation,
    bounds_of_inputs,
    changes_of_inputs,
    member_rows,
)
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.string_bounds import string_bounds

# Least rest length commanded, as part of that at the operating point, or of the string's length.
_SHORTEST = 0.01


def input_bounds(
    plant: LinearPlant,
    max_force_density: object,
    winches: Winches | None = None,
    min_force_density: object = None,
) -> tuple[FloatArray, FloatArray]:
    """Return least and largest input, shape (m,) each, or raise naming what does not fit.

    Those of a ganged input are the tightest of its strings.
    """
    if winches is not None:
        validation.instance("winches", winches, Winches, "make them by Winches(rate=...)")
    if plant.input != "force_density":
        if not validation.is_unlimited(max_force_density):
            raise ValueError(
                "max_force_density limits plants with input='force_density'; this one has "
                f"input={plant.input!r}, and winches limit {plant.input.replace('_', ' ')}s"
            )
        usual, driven = plant.string_values, plant.actuation.driven
        if winches is not None:
            if plant.drives_bars:
                refuse_motors_of_bars(winches)
            winches.refuse_out_of_range(f"plant.{plant.input}", usual, driven)
            strings, _ = member_rows(plant.input, plant.commanded)
            refuse_still(plant.actuation, winches, strings.stop)
        return bounds_of_inputs(plant.actuation, *rest_length_bounds(usual, winches))
    if winches is not None:
        raise ValueError(
            "winches limit rest lengths, but plant has input='force_density'; linearize with "
            "input='rest_length'"
        )
    gamma = plant.force_density
    bounds = string_bounds(len(gamma), min_force_density, max_force_density)
    for name, limit, is_beyond, expected in (
        ("max_force_density", bounds.high, gamma > bounds.high, "least"),
        ("min_force_density", bounds.low, gamma < bounds.low, "most"),
    ):
        is_beyond[plant.actuation.passive] = False
        if is_beyond.any():
            i = int(is_beyond.argmax())
            raise ValueError(
                f"{name}[{i}] is {limit[i]:g} N/m, but string {i} has {gamma[i]:g} N/m at the "
                f"operating point; expected at {expected} that"
            )
    return bounds_of_inputs(plant.actuation, bounds.low, bounds.high)


def refuse_motors_of_bars(winches: Winches) -> None:
    """Raise if drives of bars have motors, which wind strings."""
    if winches.motor is not None:
        raise ValueError(
            "winches has a motor, which winds a string, but lengths of bars are the input: give "
            "rate, shortest, longest and ramp=True alone"
        )


def refuse_still(actuation: Actuation, winches: Winches, strings: int) -> None:
    """Raise if a winch that is to drive a string cannot move, or a drive of a bar after those."""
    shortest, longest = winches.range(len(actuation.input))
    still = np.intersect1d(np.flatnonzero(shortest == longest), actuation.driven)
    if len(still):
        i = int(still[0])
        member = f"string {i}" if i < strings else f"bar {i - strings}"
        raise ValueError(
            f"winches.shortest and winches.longest are both {longest[i]:g} m for {member}, which "
            "the plant takes as driven, so that a design on it is wrong: say which members are "
            "driven by linearize(..., actuated=[...])"
        )


def rest_length_bounds(
    usual: FloatArray, winches: Winches | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return least and largest rest length commanded, m, shape (α,) each.

    At least a hundredth of the usual one, and what winches reach.
    """
    low, high = _SHORTEST * usual, np.full(len(usual), np.inf)
    if winches is not None:
        shortest, high = winches.range(len(usual))
        low = np.maximum(low, shortest)
    return low, high


def largest_change(
    input: str,
    actuation: Actuation,
    max_change: object,
    winches: Winches | None,
    sample_time: float | None,
) -> FloatArray | None:
    """Return the largest change of the inputs in a sample, shape (m,), or None for any."""
    change, count = None, len(actuation.input)
    if not validation.is_unlimited(max_change):
        change = validation.limit_per_member("max_change", max_change, count, "string")
        validation.positive("max_change", change, f"change of {input.replace('_', ' ')}")
    rate = None if winches is None else winches.largest_rate
    if sample_time is None:
        if change is not None or rate is not None:
            name = "max_change" if change is not None else "winches.rate"
            raise ValueError(f"{name} limits changes from sample to sample: give sample_time, s")
        return None
    if rate is not None:
        reach = validation.limit_per_member("winches.rate", rate, count, "string") * sample_time
        change = reach if change is None else np.minimum(change, reach)
    return None if change is None else changes_of_inputs(actuation, change)
