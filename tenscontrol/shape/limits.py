"""Level and bounds of the forces in a shape, checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.dynamics import Model
from tenscontrol.structure import free_coordinates, is_movable
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    instance,
    non_negative,
    per_member,
    positive,
    positive_number,
)

# γ is kept below what a string can have by this fraction.
_SHORT_OF_LIMIT = 1e-6


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of γ and of rest lengths.

    Attributes
    ----------
    low, high : ndarray, shape (α,)
        Bounds of γ, N/m.
    largest : ndarray, shape (α,)
        What the string law allows, N/m.
    shortest, longest : ndarray, shape (α,), or None
        Bounds of the rest length, m.
    """

    low: FloatArray
    high: FloatArray
    largest: FloatArray
    shortest: FloatArray | None
    longest: FloatArray | None

    def refuse_outside(self, name: str, gamma: FloatArray) -> None:
        """Raise if γ of an end of a path is outside."""
        slack = 1e-9 * float(gamma.max(initial=0.0))
        out = np.flatnonzero((gamma < self.low - slack) | (gamma > self.high + slack))
        if len(out):
            i = out[0]
            raise ValueError(
                f"{name} has γ = {gamma[i]:g} N/m in string {i}, expected {self.low[i]:g} to "
                f"{self.high[i]:g} N/m: min_force_density and max_force_density bound the ends too"
            )

    def refuse_rest_lengths(self, rest_length: FloatArray, time: FloatArray) -> None:
        """Raise if a rest length, shape (α, T), leaves the range of its winch on the way."""
        if self.shortest is None or self.longest is None:
            return
        low, high = self.shortest[:, None], self.longest[:, None]
        out = np.argwhere((rest_length < low * (1 - 1e-9)) | (rest_length > high * (1 + 1e-9)))
        if len(out):
            i, k = out[out[:, 1].argmin()]
            raise ValueError(
                f"on the way, at {time[k]:.4g} s, string {i} needs a rest length of "
                f"{rest_length[i, k]:.6g} m, expected {self.shortest[i]:g} to "
                f"{self.longest[i]:g} m: the range of the winches"
            )


@dataclass(frozen=True, eq=False)
class HealthLimits:
    """Level and bounds of the forces.

    Attributes
    ----------
    bounds : Bounds
    clearance : float
        Least distance of bars, m; 0 if not asked for.
    level : float or None
        Mean γ of the reference strings, N/m.
    reference : ndarray of int
    scale : float
        Size of the force densities, N/m.
    """

    bounds: Bounds
    clearance: float
    level: float | None
    reference: IntArray
    scale: float

    @property
    def level_text(self) -> str:
        """The level in words."""
        return "" if self.level is None else f", {self.level:g} N/m in the reference strings"

    def bounded(
        self, gamma: FloatArray, rest_length: FloatArray | None
    ) -> list[tuple[str, str, FloatArray, FloatArray, FloatArray]]:
        """Return name, unit, values and bounds of what the user bounds."""
        rows, b = [], self.bounds
        if b.low.any() or np.isfinite(b.high).any():
            rows.append(("force_density", "N/m", gamma, b.low, b.high))
        if rest_length is not None and b.shortest is not None and b.longest is not None:
            rows.append(("rest_length", "m", rest_length, b.shortest, b.longest))
        return rows


def checked_limits(
    model: Model,
    force_density: object,
    reference: str | None,
    min_force_density: object,
    max_force_density: object,
    winches: Winches | None,
    prestress: str,
    min_clearance: object,
) -> HealthLimits:
    """Return level and bounds, or raise naming the argument."""
    bounds = checked_bounds(model, min_force_density, max_force_density, winches)
    structure, low, high = model.structure, bounds.low, bounds.high
    clearance = 0.0
    if min_clearance is not None:
        clearance = positive_number("min_clearance", min_clearance, "m")
    group = structure.string_groups[0] if reference is None else reference
    strings = structure.strings_in(group)
    # A string between two fixed nodes is part of the support.
    strings = strings[is_movable(structure, structure.strings[strings])]
    if len(strings) == 0:
        raise ValueError(
            f"the {group!r} strings are held at both ends, so that their γ says nothing; "
            "refer to another group by reference=..."
        )
    level = None
    if force_density is not None:
        level = positive_number("force_density", force_density, "N/m")
        if level < low[strings].mean() or level > high[strings].mean():
            raise ValueError(
                f"force_density is {level:g} N/m, but the bounds leave the {group!r} strings "
                f"{low[strings].mean():g} to {high[strings].mean():g} N/m in the mean"
            )
    elif reference is not None:
        raise ValueError(f"reference is {reference!r}, but it goes with force_density")
    loaded = bool(free_coordinates(structure, model.constant_force).any())
    if level is None and prestress == "centred" and not np.isfinite(high).all():
        raise ValueError(
            "nothing bounds the level of the prestress: give force_density or "
            "max_force_density, or ask for prestress='least'"
        )
    if level is None and not low.any() and not loaded and not np.isfinite(high).all():
        raise ValueError(
            "without load γ = 0 balances in every shape: give force_density or "
            "min_force_density, N/m"
        )
    candidates = [level, float(low.max())]
    if np.isfinite(high).all():
        candidates.append(float((low + high).mean() / 2))
    if loaded:
        size = float(np.ptp(structure.nodes, axis=1).max())
        candidates.append(float(np.abs(model.constant_force).max()) / size)
    scale = max(value for value in candidates if value)
    return HealthLimits(bounds, clearance, level, strings, scale)


def checked_bounds(
    model: Model, min_force_density: object, max_force_density: object, winches: Winches | None
) -> Bounds:
    """Return the bounds, or raise naming the argument."""
    structure = model.structure
    count = len(structure.strings)
    if count == 0:
        raise ValueError("the structure has no strings, so there is nothing to balance")
    low = per_member("min_force_density", min_force_density, count, "string")
    non_negative("min_force_density", low, "a string can only pull")
    high = np.full(count, np.inf)
    if max_force_density is not None:
        high = per_member("max_force_density", max_force_density, count, "string")
        positive("max_force_density", high, "force density in N/m")
    over = np.flatnonzero(low > high)
    if len(over):
        i = over[0]
        raise ValueError(
            f"min_force_density[{i}] is {low[i]:g} N/m, more than max_force_density[{i}] = "
            f"{high[i]:g} N/m"
        )
    shortest, longest = _rest_length_range(model, winches)
    largest = np.full(count, np.inf)
    if model.strings is not None:
        largest = model.strings.largest_force_density * (1 - _SHORT_OF_LIMIT) * np.ones(count)
        soft = np.flatnonzero(low > largest)
        if len(soft):
            i = soft[0]
            raise ValueError(
                f"min_force_density[{i}] is {low[i]:g} N/m, but string {i} stays below "
                f"{largest[i]:g} N/m by its law"
            )
    return Bounds(low, high, largest, shortest, longest)


def _rest_length_range(
    model: Model, winches: Winches | None
) -> tuple[FloatArray | None, FloatArray | None]:
    if winches is None:
        return None, None
    instance("winches", winches, Winches, "make them by Winches(shortest=...)")
    if model.strings is None:
        raise ValueError(
            "winches bound rest lengths, but the model has no string law; "
            "build it as Model(structure, strings=LinearStrings(stiffness=...))"
        )
    count = len(model.structure.strings)
    low = 0.0 if winches.shortest is None else winches.shortest
    high = np.inf if winches.longest is None else winches.longest
    for name, value in (("shortest", low), ("longest", high)):
        if np.shape(value) not in ((), (count,)):
            raise ValueError(
                f"winches.{name} has shape {np.shape(value)}, expected () or ({count},): "
                "one number, or one per string"
            )
    if winches.shortest is None and winches.longest is None:
        return None, None
    return np.full(count, low), np.full(count, high)
