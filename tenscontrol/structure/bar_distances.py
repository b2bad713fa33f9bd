"""How far bars are from one another, and whether they pass through one another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.structure.structure import Structure
from tenscontrol.validation import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class BarDistances:
    """Distances between the axes of all p pairs of bars.

    ``side`` is the sign of the volume that two bars span; 0 where they are nearest at an end, so
    that one can go around the other. ``nearest`` is where along its length each of two lines is
    nearest to the other, 0 at the start of the bar and 1 at its end; of parallel bars, anywhere.
    """

    pairs: IntArray  # (p, 2)
    distance: FloatArray  # (p,), m
    side: FloatArray  # (p,)
    nearest: FloatArray  # (p, 2)

    @property
    def least(self) -> float:
        """The smallest distance, m; infinite for a single bar."""
        return float(self.distance.min(initial=np.inf))


def bar_distances(structure: Structure, nodes: FloatArray) -> BarDistances:
    """Return how far the bars are from one another in a shape."""
    count = len(structure.bars)
    first, second = np.triu_indices(count, 1)
    starts, vectors = nodes[:, structure.bars[:, 0]], structure.bar_vectors(nodes)
    u, v = vectors[:, first], vectors[:, second]
    w = starts[:, first] - starts[:, second]
    uu, vv, uv = (u * u).sum(0), (v * v).sum(0), (u * v).sum(0)
    uw, vw = (u * w).sum(0), (v * w).sum(0)
    across = uu * vv - uv**2
    slanted = across > 1e-12 * uu * vv
    scale = np.where(slanted, across, 1.0)
    s, t = (uv * vw - vv * uw) / scale, (uu * vw - uv * uw) / scale
    # Two lines are nearest within both bars, or else at an end of one of them.
    inside = slanted & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    apart = [np.where(inside, np.linalg.norm(w + s * u - t * v, axis=0), np.inf)]
    for s_end in (0.0, 1.0):
        t_near = np.clip((vw + s_end * uv) / vv, 0.0, 1.0)
        apart.append(np.linalg.norm(w + s_end * u - t_near * v, axis=0))
    for t_end in (0.0, 1.0):
        s_near = np.clip((t_end * uv - uw) / uu, 0.0, 1.0)
        apart.append(np.linalg.norm(w + s_near * u - t_end * v, axis=0))
    volume = (np.cross(u.T, v.T) * w.T).sum(axis=1)
    side = np.where(inside, np.sign(volume), 0.0)
    return BarDistances(
        pairs=np.column_stack([first, second]),
        distance=np.min(apart, axis=0),
        side=side,
        nearest=np.column_stack([s, t]),
    )


def crossing(before: BarDistances, after: BarDistances) -> IntArray | None:
    """Return a pair of bars that pass through each other from one shape to one close by."""
    crossed = np.flatnonzero(before.side * after.side < 0)
    return before.pairs[crossed[0]] if len(crossed) else None
