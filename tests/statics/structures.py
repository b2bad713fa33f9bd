"""Structures of any class: the plane, shared nodes, rollers, clustered strings, redundant bars."""

from itertools import combinations

import numpy as np

import tenscontrol as tc


def snelson_x(dimension=2):
    """Two crossed bars in a unit square of strings."""
    nodes = np.zeros((dimension, 4))
    nodes[:2] = [[0, 1, 1, 0], [0, 0, 1, 1]]
    return tc.Structure(nodes, [[0, 2], [1, 3]], [[0, 1], [1, 2], [2, 3], [3, 0]], bar_mass=1.0)


def d_bar(dimension=2):
    """A rhombus of four bars with both diagonals as strings, held at one corner."""
    nodes = np.zeros((dimension, 4))
    nodes[:2] = [[0, 1, 2, 1], [0, -1, 0, 1]]
    bars = [[0, 1], [1, 2], [2, 3], [3, 0]]
    return tc.Structure(nodes, bars, [[0, 2], [1, 3]], bar_mass=1.0, fixed=[0])


def bipyramid():
    """The D-bar in space: six bars from two apexes to a triangle of strings, and an axis."""
    angle = 2 * np.pi * np.arange(3) / 3
    ring = np.vstack([0.6 * np.cos(angle), 0.6 * np.sin(angle), np.zeros(3)])
    nodes = np.hstack([ring, [[0.0, 0.0], [0.0, 0.0], [0.8, -0.8]]])
    bars = [[i, apex] for apex in (3, 4) for i in range(3)]
    return tc.Structure(nodes, bars, [[0, 1], [1, 2], [2, 0], [3, 4]], bar_mass=1.0)


def two_crosses():
    """An arm of two X frames in series that share two nodes, pinned and on a roller."""
    nodes = [[0, 0, 1, 1, 2, 2], [0, 1, 0, 1, 0, 1]]
    bars = [[0, 3], [1, 2], [2, 5], [3, 4]]
    strings = [[0, 2], [1, 3], [2, 3], [2, 4], [3, 5], [4, 5], [0, 1]]
    return tc.Structure(nodes, bars, strings, bar_mass=1.0, fixed=[0, (1, "x")])


def square_body():
    """A square of four bars with both diagonals as bars, one more than makes it rigid, on strings.

    Four strings hold it to the corners of a larger square.
    """
    small = np.array([[-1.0, 1, 1, -1], [-1, -1, 1, 1]])
    sides = [[0, 1], [1, 2], [2, 3], [3, 0], [0, 2], [1, 3]]
    return tc.Structure(
        np.hstack([small, 2 * small]), sides, [[i, 4 + i] for i in range(4)], bar_mass=1.0,
        fixed=[4, 5, 6, 7],
    )  # fmt: skip


def star_prism(sides, skip, offset):
    """The prism D_q^{skip, offset} of radius and height 1, turned to where it can be prestressed.

    Bars join node i of top and bottom, horizontal strings i and i + skip, vertical ones i of the
    top and i − offset of the bottom (Connelly & Terrell 1995, doi:10.1007/BF02570698).
    """
    node = np.arange(sides)
    top = 2 * np.pi * node / sides
    bottom = top + np.pi / 2 + np.pi * offset / sides
    nodes = np.hstack([[np.cos(top), np.sin(top), 0 * top + 1],
                       [np.cos(bottom), np.sin(bottom), 0 * top]])  # fmt: skip
    ring = np.column_stack([node, (node + skip) % sides])
    sloped = np.column_stack([node, sides + (node - offset) % sides])
    strings = np.vstack([ring, sides + ring, sloped])
    return tc.Structure(nodes, np.column_stack([node, sides + node]), strings, bar_mass=1.0)


def random_any(seed):
    """Bars that share nodes anywhere, with rollers, clusters and payloads, in space or plane."""
    rng = np.random.default_rng(seed)
    d, n = int(rng.integers(2, 4)), int(rng.integers(6, 9))
    pairs = list(combinations(range(n), 2))
    rng.shuffle(pairs)
    bars, strings = pairs[: n - 2], [tuple(pair) for pair in pairs[n - 2 : 2 * n]]
    path = rng.permutation(n)[:4].tolist()
    strings += [(*path, path[0]) if rng.random() < 0.5 else tuple(path)]
    used = set(np.ravel(bars).tolist())
    mass = np.array([0.0 if i in used else 1.0 for i in range(n)])
    fixed = [0, (1, "x"), (2, "y")][: int(rng.integers(0, 4))]
    if 0 in fixed:
        mass[0] = 0.0
    else:
        mass[3] += rng.uniform(0, 2)
    strings += [(i, (i + 1) % n) for i in range(n) if i not in used]
    return tc.Structure(
        rng.uniform(-1, 1, (d, n)), bars, strings, rng.uniform(0.5, 2, len(bars)),
        point_mass=mass, fixed=fixed,
    )  # fmt: skip


def random_balance(structure, seed):
    """Random γ and λ, and the load that balances them."""
    rng = np.random.default_rng(seed)
    gamma = rng.uniform(1.0, 10.0, len(structure.strings))
    compression = rng.uniform(-10.0, 10.0, len(structure.bars))
    load = tc.statics.equilibrium_matrix(structure) @ np.concatenate([gamma, compression])
    return gamma, compression, load.reshape(structure.nodes.shape, order="F")
