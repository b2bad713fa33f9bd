"""Numbers of nodes, bars and strings, placed so that they do not cover one another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mpl_toolkits.mplot3d import proj3d

from tenscontrol.arrays import FloatArray
from tenscontrol.plot.style import NORMAL
from tenscontrol.structure.structure import Structure

# Distance of a node's number from the node, relative to the size of the structure, and what it is
# multiplied by where another number is in the way.
_DISTANCE = 0.08
_FARTHER = (1.0, 1.6, -1.0, 2.2, -1.6)

# Shares of a member's length at which its number may be, the best first. A third along a bar, not
# half: bars that cross in the middle keep their numbers apart.
_ON_BAR = (1 / 3, 2 / 3, 0.5, 0.22, 0.78, 0.42, 0.58)
_ON_STRING = (0.5, 0.38, 0.62, 0.28, 0.72, 0.2, 0.8)

# Size of the font, points, up to so many numbers, and the least of many more.
_FONT, _FEW, _SMALLEST = 8.3, 30, 5.0

# Height of a number, width of a letter and the white around it, as parts of the font's size.
_HEIGHT, _LETTER, _EDGE = 1.15, 0.68, 0.24

# White behind a number, so that it can be read on top of a member.
_CARD = {"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}


@dataclass(frozen=True, eq=False)
class NumberPlaces:
    """Where numbers go: distances from nodes, (n,), m, and shares of bars (β,) and strings (α,)."""

    from_node: FloatArray
    on_bar: FloatArray
    on_string: FloatArray

    def at(
        self, structure: Structure, nodes: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the places of the numbers, shape (count, d) each, m."""
        points = nodes.T
        outward = points - points.mean(axis=0)
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-300)
        # On a string, or the middle segment of a clustered one.
        counts = np.bincount(structure.segment_string, minlength=len(structure.strings))
        middle = np.cumsum(counts) - counts + (counts - 1) // 2
        ends = ((structure.bars, self.on_bar), (structure.segments[middle], self.on_string))
        bars, strings = (
            points[pair[:, 0]] * (1 - share[:, None]) + points[pair[:, 1]] * share[:, None]
            for pair, share in ends
        )
        return points + self.from_node[:, None] * outward, bars, strings


def write_numbers(
    ax: Any, structure: Structure, nodes: FloatArray, of_nodes: bool, of_members: bool
) -> tuple[NumberPlaces, tuple[tuple[Any, ...], ...]]:
    """Write numbers of nodes, members or both; return their places, and the texts of each kind."""
    shift = _DISTANCE * float(np.ptp(nodes, axis=1).max())
    n, bars, strings = nodes.shape[1], len(structure.bars), len(structure.strings)
    kinds = (
        ("", "black", n if of_nodes else 0, [shift * far for far in _FARTHER], n),
        ("b", NORMAL.bar_color, bars if of_members else 0, _ON_BAR, bars),
        ("s", NORMAL.string_color, strings if of_members else 0, _ON_STRING, strings),
    )
    count = sum(shown for _, _, shown, _, _ in kinds)
    font = _FONT * float(np.clip((_FEW / max(count, 1)) ** 0.5, _SMALLEST / _FONT, 1.0))
    # Where each number would be, for each choice.
    choices = max(len(options) for _, _, _, options, _ in kinds)
    tried = [
        NumberPlaces(*(np.full(k, opt[min(c, len(opt) - 1)]) for *_, opt, k in kinds))
        for c in range(choices)
    ]
    seen = [[_in_points(ax, places) for places in choice.at(structure, nodes)] for choice in tried]
    taken, half, chosen = np.zeros((0, 2)), np.zeros((0, 2)), []
    for kind, (sign, _, shown, options, total) in enumerate(kinds):
        shares = np.full(total, float(options[0]))
        for i in range(shown):
            own = font * np.array([_LETTER * len(f"{sign}{i}") + _EDGE, _HEIGHT]) / 2
            options_at = np.array([seen[c][kind][i] for c in range(len(options))])
            gap = np.abs(options_at[:, None] - taken) - (half + own)  # negative where they overlap
            covered = np.prod(np.maximum(-gap, 0.0), axis=2).sum(axis=1)
            best = int(np.argmin(np.round(covered, 6)))
            shares[i] = options[best]
            taken, half = np.vstack([taken, options_at[best]]), np.vstack([half, own])
        chosen.append(shares)
    places = NumberPlaces(*chosen)
    look: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": font, "bbox": _CARD}
    texts = tuple(
        tuple(
            ax.text(*place, f"{sign}{i}", color=color, zorder=6, **look)
            for i, place in enumerate(where[:shown])
        )
        for (sign, color, shown, *_), where in zip(kinds, places.at(structure, nodes), strict=True)
    )
    return places, texts


def _in_points(ax: Any, places: FloatArray) -> FloatArray:
    """Return where places (count, d) are seen in the figure, points."""
    if places.shape[1] == 3:
        x, y, _ = proj3d.proj_transform(*places.T, ax.get_proj())
        places = np.column_stack([x, y])
    return np.asarray(ax.transData.transform(places) * 72 / ax.figure.dpi)
