"""Point group: the turns and mirrors that map a structure onto itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.structure.connectivity import member_images
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import held_directions

# Nodes and lengths that differ by less than this part of the size are the same.
_TOLERANCE = 1e-7


class Map(NamedTuple):
    """What one turn or mirror takes each node, string and bar to."""

    nodes: IntArray
    strings: IntArray
    bars: IntArray


def point_group(structure: Structure) -> list[Map]:
    """Return all turns and mirrors about the centroid that map a structure onto itself.

    Nodes go to nodes, members to members of the same kind, supports to supports. The first is that
    which leaves all as it is.
    """
    from scipy.spatial import cKDTree

    centred = structure.nodes - structure.nodes.mean(axis=1, keepdims=True)
    axes, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    axes = axes[:, sizes > _TOLERANCE * sizes[0]]
    X = axes.T @ centred  # without directions in which the structure has no extent
    size = float(np.linalg.norm(X, axis=0).max())
    kind = _kinds(structure, np.linalg.norm(X, axis=0), size)
    tree = cKDTree(X.T)
    frame = _frame(X, kind)
    maps = []
    for image in _images_of_frame(X, frame, kind, size):
        turn = X[:, image] @ np.linalg.inv(X[:, frame])
        apart, to = tree.query((turn @ X).T)
        if apart.max() > _TOLERANCE * size or len(np.unique(to)) < len(to):
            continue
        strings = member_images(structure.paths or structure.strings.tolist(), to)
        bars = member_images(structure.bars.tolist(), to)
        whole = axes @ turn @ axes.T + np.eye(len(axes)) - axes @ axes.T
        if min(strings + bars, default=0) >= 0 and _keeps_supports(structure, whole, to):
            maps.append(Map(to, np.array(strings, int), np.array(bars, int)))
    return maps


def _kinds(structure: Structure, distance: FloatArray, size: float) -> IntArray:
    """Return a number for each node: nodes with another one are not taken to each other."""
    count = len(distance)
    order = np.argsort(distance)
    shell = np.zeros(count, int)
    shell[order[1:]] = np.cumsum(np.diff(distance[order]) > _TOLERANCE * size)
    ends = [structure.bars.ravel(), structure.segments.ravel()]
    held = structure.fixed_rows // structure.dimension
    degrees = [np.bincount(nodes, minlength=count) for nodes in (*ends, held)]
    return np.unique(np.column_stack([shell, *degrees]), axis=0, return_inverse=True)[1].ravel()


def _frame(X: FloatArray, kind: IntArray) -> list[int]:
    """Return nodes that span all directions, of the rarest kinds that do so clearly."""
    rarity = np.bincount(kind)[kind]
    frame: list[int] = []
    left = X.copy()
    for _ in range(len(X)):
        heights = np.linalg.norm(left, axis=0)
        clear = np.flatnonzero(heights > 0.3 * heights.max())
        frame.append(int(clear[rarity[clear].argmin()]))
        along = left[:, frame[-1]] / heights[frame[-1]]
        left = left - np.outer(along, along @ left)
    return frame


def _images_of_frame(
    X: FloatArray, frame: list[int], kind: IntArray, size: float
) -> Iterator[list[int]]:
    """Yield nodes as far from each other as those of the frame, of the same kinds."""
    gram = X[:, frame].T @ X[:, frame]

    def extended(image: list[int]) -> Iterator[list[int]]:
        k = len(image)
        if k == len(frame):
            yield image
            return
        candidates = np.flatnonzero(kind == kind[frame[k]])
        near = np.abs(X[:, candidates].T @ X[:, image] - gram[k, :k]) < _TOLERANCE * size**2
        for node in candidates[near.all(axis=1)].tolist():
            yield from extended([*image, node])

    identity = list(frame)
    yield identity
    yield from (image for image in extended([]) if image != identity)


def _keeps_supports(structure: Structure, turn: FloatArray, to: IntArray) -> bool:
    """Return whether each support is taken to one that holds the same directions."""
    held = held_directions(structure).astype(float)
    some = np.flatnonzero(held.any(axis=1))
    turned = np.einsum("ij,nj,kj->nik", turn, held[some], turn)
    images = held[to[some]][:, :, None] * np.eye(structure.dimension)
    return bool(np.abs(turned - images).max(initial=0.0) < _TOLERANCE)
