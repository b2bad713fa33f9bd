"""Structures whose bars share nodes, with rollers, payloads and clustered strings, for tests."""

import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state


def d_bar(**options):
    """Four bars in a rhombus in the plane, a string across it and one along it."""
    nodes = [[-1.0, 0.0, 1.0, 0.0], [0.0, 0.6, 0.0, -0.6]]
    bars = [[0, 1], [1, 2], [2, 3], [3, 0]]
    return tc.Structure(nodes, bars, [[1, 3], [0, 2]], bar_mass=[1.0, 0.7, 1.2, 0.9], **options)


def tower(**options):
    """Two twisted prisms on one another that share three nodes: three chains of two bars each."""
    turns = np.deg2rad([0.0, 120.0, 240.0])
    levels = [(turns + 0.9 * k, 0.5 * k) for k in range(3)]
    nodes = np.hstack([[np.cos(t), np.sin(t), 0 * t + 1.6 * z] for t, z in levels])
    ring = [(0, 1), (1, 2), (2, 0)]
    bars = [(3 * k + i, 3 * k + 3 + (i + 1) % 3) for k in range(2) for i in range(3)]
    strings = [(3 * k + i, 3 * k + j) for k in range(3) for i, j in ring]
    strings += [(3 * k + i, 3 * k + 3 + i) for k in range(2) for i in range(3)]
    return tc.Structure(nodes, bars, strings, bar_mass=np.linspace(0.8, 1.3, 6), **options)


def spine(**options):
    """A rigid vertebra of ten bars on five nodes, one of them redundant, above three fixed ones."""
    nodes = np.array(
        [[1, -0.5, -0.5, 0, 0, 1.0, -0.5, -0.5], [0, 0.9, -0.9, 0, 0.1, 0, 0.9, -0.9],
         [0, 0, 0, 0.5, -0.6, -0.9, -0.8, -0.8]]
    )  # fmt: skip
    bars = [(i, j) for i in range(5) for j in range(i)]
    strings = [(0, 5), (1, 6), (2, 7), (4, 5), (4, 6), (4, 7)]
    return tc.Structure(nodes, bars, strings, bar_mass=0.3, fixed=[5, 6, 7], **options)


def arm():
    """Two bars and a payload in the plane, on a roller, with a cable over the elbow."""
    nodes = [[0.0, 0.8, 1.5, 0.3], [0.0, 0.5, 0.0, 1.0]]
    return tc.Structure(
        nodes, [[0, 1], [1, 2]], [(0, 2), (3, 1, 2)], bar_mass=1.0,
        fixed=[0, 3, (2, "y")], point_mass=[0, 0.4, 0.2, 0],
    )  # fmt: skip


def mixed():
    """A free bar, one that swings, two that share a node, a point mass and one on a roller."""
    nodes = np.array(
        [[0, 1, 0.2, 1.4, 2.5, 3, 0.5, 2.0, -1], [0, 0.3, 1, 1.2, 0.1, 1, -1, -0.8, 0.5],
         [0, 0.5, 0, 0.4, 0, 0.9, 0.3, 1.0, 0.2]]
    )  # fmt: skip
    bars = [(0, 1), (2, 3), (3, 4), (5, 8)]
    strings = [(0, 2), (1, 3), (1, 6), (2, 6), (6, 7), (4, 7), (5, 7), (4, 5), (0, 8), (1, 7, 4)]
    mass = np.zeros(9)
    mass[[6, 7, 3]] = 0.5, 0.8, 0.3
    return tc.Structure(
        nodes, bars, strings, bar_mass=[1, 0.8, 1.1, 0.9], point_mass=mass,
        fixed=[8, (7, "z"), (4, "x")],
    )  # fmt: skip


SCENES = {"d_bar": d_bar, "tower": tower, "spine": spine, "arm": arm, "mixed": mixed}


def possible_velocities(structure, seed=0, size=0.5):
    """Random velocities, shape (d, n), that neither stretch bars nor move supports."""
    rows = structure.free_rows
    every = np.arange(len(structure.bars))
    J = tc.structure.blocks.bar_rows(structure, every, structure.nodes).toarray()[:, rows]
    v = np.random.default_rng(seed).normal(size=len(rows))
    v -= np.linalg.pinv(J, rcond=1e-10) @ (J @ v)
    flat = np.zeros(structure.nodes.size)
    flat[rows] = size * v / np.abs(v).max()
    return flat.reshape(structure.nodes.shape, order="F")


def moving(structure, seed=0, size=0.5):
    """The state of the reference shape with such velocities."""
    return pack_state(structure, structure.nodes, possible_velocities(structure, seed, size))


def errors_of_bars(structure, states):
    """Largest relative error of bar lengths, and rate along a bar, m/s."""
    nodes, velocities = tc.dynamics.equation.unpack_states(structure, states)
    start, end = structure.bars.T
    B, Bd = nodes[:, end] - nodes[:, start], velocities[:, end] - velocities[:, start]
    length = structure.bar_length[:, None]
    stretch = np.abs(np.linalg.norm(B, axis=0) / length - 1)
    return stretch.max(), np.abs((B * Bd).sum(axis=0) / length).max()
