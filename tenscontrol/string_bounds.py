"""Bounds of force densities and of rest lengths, string by string."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray

# γ is kept below what a string can have by this fraction.
_SHORT_OF_LIMIT = 1e-6


@dataclass(frozen=True, eq=False)
class StringBounds:
    """Bounds of γ, N/m, and of rest lengths, m, shape (α,) each."""

    low: FloatArray  # at least 0: a string can only pull
    high: FloatArray
    largest: FloatArray  # γ that the string law allows
    rest_length: tuple[FloatArray, FloatArray] | None  # shortest and longest, if they are bounded

    @property
    def highest(self) -> FloatArray:
        """What the user and the string law allow, N/m."""
        return np.minimum(self.high, self.largest)

    def at_lengths(self, length: FloatArray, law: Any) -> tuple[FloatArray, FloatArray]:
        """Return the least and the largest γ, N/m, with which rest lengths are within bounds too.

        Lengths of the strings have shape (α,), m; the string law may be None without such bounds.
        """
        low, high = self.low, self.highest
        if self.rest_length is not None:
            shortest, longest = self.rest_length
            is_tight, is_loose = shortest > 0, np.isfinite(longest)
            most = law.force_density(length, np.where(is_tight, shortest, length))
            least = law.force_density(length, np.where(is_loose, longest, length))
            high = np.where(is_tight, np.minimum(high, most), high)
            low = np.where(is_loose, np.maximum(low, least), low)
        return low, high

    def refuse_outside(self, name: str, gamma: FloatArray) -> None:
        """Raise if γ of an end of a path is outside."""
        slack = 1e-9 * float(gamma.max(initial=0.0))
        out = np.flatnonzero((gamma < self.low - slack) | (gamma > self.high + slack))
        if len(out):
            i = out[0]
            wanted = validation.span(self.low[i], self.high[i], "N/m")
            raise ValueError(
                f"{name} has γ = {gamma[i]:g} N/m in string {i}, expected {wanted}: "
                "min_force_density and max_force_density bound the ends too"
            )

    def refuse_rest_lengths(self, rest_length: FloatArray, time: FloatArray) -> None:
        """Raise if a rest length, shape (α, T), leaves the range of its winch on the way."""
        if self.rest_length is None:
            return
        refuse_out_of_range(
            "string {} needs a rest length", rest_length, self.rest_length, time,
            "the range of the winches",
        )  # fmt: skip


def refuse_out_of_range(
    what: str, lengths: FloatArray, span: tuple[FloatArray, FloatArray], time: FloatArray, of: str
) -> None:
    """Raise if lengths on the way, m, shape (k, T), leave their span, naming the first that does.

    The message has ``what`` with the index of a member put in, and what the span is ``of``.
    """
    low, high = span
    below = lengths < low[:, None] * (1 - 1e-9)
    out = np.argwhere(below | (lengths > high[:, None] * (1 + 1e-9)))
    if len(out):
        i, k = out[out[:, 1].argmin()]
        raise ValueError(
            f"on the way, at {time[k]:.4g} s, {what.format(i)} of {lengths[i, k]:.6g} m, expected "
            f"{validation.span(low[i], high[i], 'm')}: {of}"
        )


def string_bounds(
    count: int,
    min_force_density: object = None,
    max_force_density: object = None,
    *,
    largest: FloatArray | float = np.inf,
    rest_length: tuple[FloatArray, FloatArray] | None = None,
    may_be_slack: bool = False,
) -> StringBounds:
    """Return the bounds of so many strings, or raise naming the argument.

    ``largest`` is γ that the string law allows. Where strings may be slack, the largest γ may be 0.
    """
    least = 0.0 if min_force_density is None else min_force_density
    low = validation.per_member("min_force_density", least, count, "string")
    validation.non_negative("min_force_density", low, "a string can only pull")
    high = validation.limit_per_member("max_force_density", max_force_density, count, "string")
    if may_be_slack:
        validation.non_negative("max_force_density", high, "a string can only pull")
    else:
        validation.positive("max_force_density", high, "force density in N/m")
    crossed = np.flatnonzero(low > high)
    if len(crossed):
        i = crossed[0]
        raise ValueError(
            f"min_force_density[{i}] is {low[i]:g} N/m, more than max_force_density[{i}] = "
            f"{high[i]:g} N/m"
        )
    largest = largest * (1 - _SHORT_OF_LIMIT) * np.ones(count)
    soft = np.flatnonzero(low > largest)
    if len(soft):
        i = soft[0]
        raise ValueError(
            f"min_force_density[{i}] is {low[i]:g} N/m, but string {i} stays below "
            f"{largest[i]:g} N/m by its law"
        )
    return StringBounds(low, high, largest, rest_length)
