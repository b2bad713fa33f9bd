"""Random structures of any kind, and motions that their bars allow.

Bars of class 1 to 6 in space and in the plane: single bars, stars, chains, rigid bodies with and
without redundant bars; with fixed nodes, rollers, payloads, string nodes, parallel members and
clustered strings. The same seed gives the same structure.
"""

from __future__ import annotations

import warnings
from itertools import combinations, pairwise
from typing import Any

import numpy as np

import tenscontrol as tc

# Nodes are no nearer than this, and the bars' constraints no nearer to dependence: then results
# can be compared to round-off.
_APART, _INDEPENDENT = 0.3, 0.1


def any_structure(seed: int, structure_class: int | None = None, dimension: int | None = None,
                  clusters: bool | None = None) -> tc.Structure:  # fmt: skip
    """Return a random structure; what is not given is drawn.

    ``structure_class`` is 1 to 6, ``dimension`` 2 or 3, ``clusters`` whether some strings run over
    several nodes.
    """
    random = np.random.default_rng(seed)
    k = int(random.integers(1, 7)) if structure_class is None else structure_class
    d = int(random.integers(2, 4)) if dimension is None else dimension
    has_clusters = bool(random.integers(2)) if clusters is None else clusters
    while True:
        structure = _attempt(random, k, d, has_clusters)
        if structure is not None:
            return structure


def quietly_made(*arguments: Any, **options: Any) -> tc.Structure:
    """Return a structure; strings beside others or along bars are meant, without a warning."""
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        return tc.Structure(*arguments, **options)


def any_motion_of(structure: tc.Structure, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the structure's nodes and random velocities that its bars and supports allow."""
    random = np.random.default_rng(seed)
    rows = structure.free_rows
    J = constraint_rows(structure, structure.nodes)[:, rows]
    rates = random.normal(size=len(rows))
    if len(J) and len(rows):
        rates -= np.linalg.pinv(J, rcond=1e-9) @ (J @ rates)
    velocities = np.zeros(structure.nodes.size)
    velocities[rows] = rates
    d, n = structure.nodes.shape
    return structure.nodes.copy(), velocities.reshape(n, d).T


def constraint_rows(structure: tc.Structure, nodes: np.ndarray) -> np.ndarray:
    """Return half the derivatives of the squared bar lengths, shape (β, d n), dense."""
    d, n = nodes.shape
    J = np.zeros((len(structure.bars), n, d), nodes.dtype)
    for i, (start, end) in enumerate(structure.bars):
        J[i, end] += nodes[:, end] - nodes[:, start]
        J[i, start] -= nodes[:, end] - nodes[:, start]
    return J.reshape(len(J), n * d)


def _attempt(
    random: np.random.Generator, k: int, d: int, has_clusters: bool
) -> tc.Structure | None:
    bars, count = _bars(random, k, d)
    points = int(random.integers(0, 3))
    count += points
    place = random.permutation(count)
    bars = place[np.array(bars)]
    nodes = 1.5 * random.uniform(-1, 1, (d, count))
    apart = np.linalg.norm(nodes[:, :, None] - nodes[:, None, :], axis=0)
    if apart[np.triu_indices(count, 1)].min() < _APART:
        return None
    fixed, held = _supports(random, count, d)
    is_free = np.ones((count, d), bool)
    for node, axis in held:
        is_free[node, axis] = False
    J = np.zeros((len(bars), count, d))
    for i, (start, end) in enumerate(bars):
        J[i, end] = nodes[:, end] - nodes[:, start]
        J[i, start] = -J[i, end]
    J = (J * is_free).reshape(len(bars), -1)
    size = np.linalg.norm(J, axis=1)
    values = np.linalg.svd(J[size > 0] / size[size > 0, None], compute_uv=False)
    doubtful = (values > 1e-9) & (values < _INDEPENDENT)
    if doubtful.any() or ((size > 0) & (size < _APART)).any():
        return None
    mass = np.zeros(count)
    mass[place[count - points :]] = random.uniform(0.1, 1.0, points)
    loaded = random.random(count) < 0.2
    mass[loaded] = random.uniform(0.1, 1.0, loaded.sum())
    mass[~is_free.any(axis=1)] = 0.0
    strings = _strings(random, count, place[count - points :], has_clusters)
    return quietly_made(
        nodes, bars, strings, random.uniform(0.5, 2.0, len(bars)), fixed=fixed, point_mass=mass
    )


def _bars(random: np.random.Generator, k: int, d: int) -> tuple[list[tuple[int, int]], int]:
    """Return bars of which at most k meet, at least once k, and the number of their nodes."""
    star = [(0, i + 1) for i in range(k)]
    kinds = [(star, k + 1)]
    if k >= 2:
        kinds.append(([(0, 1), (1, 2), (2, 3)], 4))
    if k >= d:  # a body of as many bars as hold it
        kinds.append((list(combinations(range(d + 1), 2)), d + 1))
    if k >= d + 1:  # and one more node, tied to all: redundant bars
        kinds.append((list(combinations(range(d + 2), 2)), d + 2))
    chosen = [0, *random.integers(0, len(kinds), random.integers(0, 3))]
    bars: list[tuple[int, int]] = []
    count = 0
    for which in chosen:
        some, nodes = kinds[which]
        bars += [(a + count, b + count) if random.integers(2) else (b + count, a + count)
                 for a, b in some]  # fmt: skip
        count += nodes
    single = int(random.integers(0, 2))
    bars += [(count, count + 1)] * single
    return bars, count + 2 * single


def _supports(
    random: np.random.Generator, count: int, d: int
) -> tuple[list[object], list[tuple[int, int]]]:
    """Return what ``fixed`` takes, and the (node, axis) pairs that are held."""
    nodes = random.permutation(count)
    whole = nodes[: random.integers(0, 3)].tolist()
    rolling = nodes[len(whole) : len(whole) + random.integers(0, 3)].tolist()
    fixed: list[object] = list(whole)
    held = [(node, axis) for node in whole for axis in range(d)]
    for node in rolling:
        axes = random.permutation(d)[: random.integers(1, d)].tolist()
        fixed += [(node, "xyz"[axis]) for axis in axes]
        held += [(node, axis) for axis in axes]
    return fixed, held


def _strings(
    random: np.random.Generator, count: int, points: np.ndarray, has_clusters: bool
) -> list[tuple[int, ...]]:
    """Return strings that touch every node, some beside others or beside bars."""
    around = random.permutation(count).tolist()
    strings: list[tuple[int, ...]] = list(pairwise(around))
    pairs = list(combinations(range(count), 2))
    strings += [pairs[i] for i in random.integers(0, len(pairs), count // 2)]
    for point in points:
        others = [i for i in range(count) if i != point]
        strings.append((int(point), int(random.choice(others))))
    if has_clusters:
        for size in (3, 4, 3):
            path = random.permutation(count)[: min(size, count)].tolist()
            closed = len(path) >= 3 and random.integers(3) == 0
            strings.append((*path, path[0]) if closed else tuple(path))
    return [strings[i] for i in random.permutation(len(strings))]
