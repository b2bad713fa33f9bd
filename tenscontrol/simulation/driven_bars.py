"""Bars whose lengths are driven in time: telescopic struts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.profile import Pieces, Profile, as_pieces
from tenscontrol.structure.bar_geometry import refuse_other_bar_lengths
from tenscontrol.structure.structure import Structure

# A length that changes by more than this part of the size at once jumps; two lengths that differ by
# less than the second part are equal.
_JUMP, _EQUAL = 1e-9, 1e-12

# Rates of which one differs from another by less than this part are the same.
_SAME_RATE = 1e-12


@dataclass(frozen=True, eq=False)
class DrivenBars:
    """Lengths of all bars in time, m, one row a bar, and which of them change.

    Under a controller they are those at the start: it commands the rest.
    """

    lengths: Pieces
    bars: IntArray  # those that change
    is_commanded: bool = False

    def at(self, time: float) -> FloatArray:
        """Return the length of each bar at a time, m, shape (β,)."""
        return self.lengths.at(np.array([time]))[:, 0]

    def rates(self, structure: Structure, nodes: FloatArray, velocities: FloatArray) -> FloatArray:
        """Return at what rates driven bars stretch, m/s, shape (β,); of the others 0."""
        rate = np.zeros(len(structure.bars))
        rate[self.bars] = stretching(structure, nodes, velocities)[self.bars]
        return rate

    def jump(self, before: FloatArray, after: FloatArray) -> FloatArray | None:
        """Return by how much rates jump, m/s, shape (β,); None where they do not."""
        jump, size = after - before, np.maximum(np.abs(before), np.abs(after))
        jump[np.abs(jump) <= _SAME_RATE * size] = 0.0
        return jump if jump.any() else None


def stretching(structure: Structure, nodes: FloatArray, velocities: FloatArray) -> FloatArray:
    """Return at what rate each bar stretches, m/s, shape (β,)."""
    B, Bd = structure.bar_vectors(nodes), structure.bar_vectors(velocities)
    return np.asarray((B * Bd).sum(axis=0) / np.linalg.norm(B, axis=0))


def driven_bars(
    structure: Structure, value: object, start: float, end: float, stretches: bool = False
) -> DrivenBars | None:
    """Return the lengths of the bars between two times; None where all are those of the structure.

    But not None where bars have stretched before the start. Raises an error where a length jumps or
    is not positive, or a bar cannot be driven.
    """
    own, meaning = structure.bar_length, "one length per bar, m"
    if isinstance(value, Profile) or callable(value):
        pieces = as_pieces("bar_length", value, own.shape, meaning, start, end)
    else:
        given = validation.per_member("bar_length", value, len(own), "bar")
        pieces = Pieces.constant(given)
    if not len(own):
        return None
    least, time = pieces.least(start, end)
    if least <= 0:
        raise ValueError(
            f"bar_length falls to {least:.3g} m at {time:.6g} s, expected a positive length. Cubic "
            "interpolation may go below the values given; linear interpolation does not"
        )
    jump, time = pieces.jumps(start, end)
    if jump > _JUMP * float(own.max()):
        raise ValueError(
            f"bar_length jumps by {jump:.3g} m at {time:.6g} s, expected a continuous length: "
            "interpolate by 'linear' or 'cubic'"
        )
    inside = pieces.within(start, end).coefficients
    changes = inside[:, :, 1:].any(axis=(0, 2)) | (np.ptp(inside[:, :, 0], axis=0) > _EQUAL * own)
    others = changes | (np.abs(inside[0, :, 0] - own) > _EQUAL * own)
    refuse_other_bar_lengths("bar_length", structure, np.flatnonzero(others))
    return DrivenBars(pieces, np.flatnonzero(changes)) if stretches or others.any() else None
