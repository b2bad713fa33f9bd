"""Geometry of bars and strings: length checks, restored bar lengths, distances between bars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.structure.blocks import restore_block
from tenscontrol.structure.structure import Structure
from tenscontrol.validation import FloatArray, IntArray, instance

# How far, relative to its length, a bar may be off in a shape given by the user.
_TOLERANCE = 1e-8


def restore_bar_lengths(structure: Structure, nodes: object) -> FloatArray:
    """Return the nodes, corrected so that every bar has its true length.

    A bar is stretched about its centre, or about its fixed end. Bars that share nodes are moved
    together, as little as can be in the metric of their mass.

    Parameters
    ----------
    structure : Structure
        Gives the bar lengths.
    nodes : array_like, shape (d, n)
        Node positions, m, for example a disturbed shape.

    Returns
    -------
    ndarray, shape (d, n)
        Node positions, m. String nodes and the directions of bars that share no node are unchanged.

    Raises
    ------
    ValueError
        If the shape does not fit, a bar has no direction left, or bars that share nodes cannot be
        given their lengths near by.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> nodes = tc.structure.restore_bar_lengths(prism, 1.1 * prism.nodes)
    >>> bool(np.allclose(np.linalg.norm(prism.bar_vectors(nodes), axis=0), prism.bar_length))
    True
    """
    instance("structure", structure, Structure, "make one by Structure(...) or prism(...)")
    moved = structure.checked_nodes("nodes", nodes).copy()
    largest = np.abs(moved[:, structure.bar_nodes]).max(initial=0.0)
    most = _TOLERANCE / np.finfo(float).eps * structure.bar_length.min(initial=np.inf)
    if largest > most:
        raise ValueError(
            f"nodes has entries up to {largest:g} m, expected at most {most:g} m: beyond that, "
            "double precision cannot resolve the shortest bar"
        )
    vectors = structure.bar_vectors(moved)
    length = np.linalg.norm(vectors, axis=0)
    lost = np.flatnonzero(length == 0)
    if len(lost):
        raise ValueError(
            f"in nodes, the ends of bar {lost[0]} are at the same point, so that it has no "
            "direction; move one of them"
        )
    alone = np.concatenate([structure.free_bars, structure.swinging_bars])
    change = (vectors * (structure.bar_length / length - 1))[:, alone]
    share = structure.end_share[alone]
    start, end = structure.bars[alone].T
    moved[:, start] -= share[:, 0] * change
    moved[:, end] += share[:, 1] * change
    for block in structure.blocks:
        moved = restore_block(structure, block, moved)
    return moved


def refuse_wrong_bar_lengths(
    name: str, structure: Structure, nodes: FloatArray, tolerance: float = _TOLERANCE
) -> None:
    """Raise if a bar of this shape has not its length, naming the worst one."""
    length = np.linalg.norm(structure.bar_vectors(nodes), axis=0)
    off = np.abs(length / structure.bar_length - 1)
    if off.size and off.max() > tolerance:
        worst = int(off.argmax())
        raise ValueError(
            f"in {name}, bar {worst} has length {length[worst]:.9g} m, expected "
            f"{structure.bar_length[worst]:.9g} m as in the structure; bars are rigid. "
            "restore_bar_lengths(structure, nodes) corrects a shape"
        )


def refuse_strings_without_length(name: str, structure: Structure, nodes: FloatArray) -> None:
    """Raise if the ends of a string are at the same place: its force has no direction."""
    length = np.linalg.norm(structure.string_vectors(nodes), axis=0)
    short = np.flatnonzero(length <= 1e-12 * length.max(initial=0.0))
    if len(short):
        start, end = structure.segments[short[0]]
        raise ValueError(
            f"in {name}, strings[{structure.segment_string[short[0]]}] has no length: nodes "
            f"{start} and {end} are at the same point, so that its force has no direction; move "
            "one of them"
        )


@dataclass(frozen=True, eq=False)
class BarDistances:
    """Distances between the axes of all p pairs of bars that share no node.

    ``side`` is the sign of the volume that two bars span; 0 where they are nearest at an end, so
    that one can go around the other, and in the plane, where bars lie in layers. ``nearest`` is
    where along its length each of two lines is nearest to the other, 0 at the start of the bar and
    1 at its end; of parallel bars, anywhere.
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
    first, second = np.triu_indices(len(structure.bars), 1)
    ends = structure.bars
    joined = (ends[first][:, :, None] == ends[second][:, None, :]).any(axis=(1, 2))
    first, second = first[~joined], second[~joined]
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
    side = np.zeros(len(first))
    if structure.dimension == 3:
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
