"""Structures whose bars share nodes, in space and in the plane: scenes of several tests."""

import numpy as np

import tenscontrol as tc


def d_bar(strings=((1, 3), (0, 2)), groups=("across", "along"), **changes):
    """A rhombus in the plane of four bars of 1 m, 80° at the ends, and strings as diagonals."""
    x, y = np.sin(np.radians(40.0)), np.cos(np.radians(40.0))
    nodes = [[0.0, x, 0.0, -x], [-y, 0.0, y, 0.0]]
    bars = [[0, 1], [1, 2], [2, 3], [3, 0]]
    return tc.Structure(nodes, bars, list(strings), 1.0, string_groups=groups, **changes)


def arm(cluster=False):
    """Two bars of 1 m in the plane: 0 is fixed, 1 the elbow with 2 kg, 2 slides; 3 is an anchor."""
    nodes = [[0.0, np.cos(0.6), 2 * np.cos(0.6), 0.8], [0.0, np.sin(0.6), 0.0, -1.0]]
    return tc.Structure(
        nodes, [[0, 1], [1, 2]], [(0, 2, 3) if cluster else (0, 2), (1, 3)], 1.0,
        point_mass=[0.0, 2.0, 0.5, 0.0], fixed=[0, (2, "y"), 3], string_groups=("slide", "elbow"),
    )  # fmt: skip


def tower(**changes):
    """Two twisted prisms, the upper on the nodes of the lower."""
    ring = np.arange(3)
    turns = [2 * np.pi * ring / 3 + np.pi / 6 * (level % 2) for level in range(3)]
    nodes = np.hstack([[0.5 * np.cos(a), 0.5 * np.sin(a), 0 * a + k] for k, a in enumerate(turns)])
    bars = [(i, 3 + (i + 1) % 3) for i in ring] + [(3 + i, 6 + (i - 1) % 3) for i in ring]
    along = [(3 * k + i, 3 * k + 3 + i) for k in range(2) for i in ring]
    around = [(3 * k + i, 3 * k + (i + 1) % 3) for k in range(3) for i in ring]
    groups = ["along"] * 6 + ["bottom"] * 3 + ["middle"] * 3 + ["top"] * 3
    return tc.Structure(nodes, bars, along + around, 1.0, string_groups=groups, **changes)


def tower_force_density(level=10.0):
    """Force densities at which the tower rests: those of two prisms, N/m."""
    return level * np.repeat([np.sqrt(3), 1.0, 2.0, 1.0], [6, 3, 3, 3])


def spine():
    """A vertebra of five nodes and ten bars on one that is fixed, held by eight strings."""
    tips = 0.15 * np.array([[1, -1, 0, 0, 0], [0, 0, 1, -1, 0], [-1, -1, 1, 1, 0.0]])
    nodes = np.hstack([tips, tips + np.array([[0.0], [0.0], [0.2]])])
    bars = [(5 * k + i, 5 * k + j) for k in range(2) for i in range(5) for j in range(i + 1, 5)]
    strings = [(i, 5 + i) for i in range(4)] + [(i, 5 + j) for i in (2, 3) for j in (0, 1)]
    groups = ["along"] * 4 + ["saddle"] * 4
    return tc.Structure(nodes, bars, strings, 0.02, fixed=range(5), string_groups=groups)
