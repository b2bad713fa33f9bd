"""Structures whose bars share nodes, in the plane and in space, each with what holds it in balance.

Force densities are random; a load on every node balances them together with random forces of the
bars, so that any structure is at rest in its reference shape.
"""

from itertools import combinations

import numpy as np

import tenscontrol as tc


def d_bar(dimension=2):
    """Four bars as a rhombus, two strings as its diagonals, on a pin and a roller."""
    nodes = np.array([[-1.0, 0.0, 1.0, 0.0], [0.0, -0.6, 0.0, 0.6], [0.0] * 4])[:dimension]
    bars = [[0, 1], [1, 2], [2, 3], [3, 0]]
    held = [(node, "z") for node in range(1, 4)] if dimension == 3 else []
    return tc.Structure(nodes, bars, [[0, 2], [1, 3]], [1.0, 1.1, 1.2, 1.3],
                        fixed=[0, (2, "y"), *held])  # fmt: skip


def free_d_bar():
    """The same with a payload, held by nothing."""
    square = d_bar()
    return tc.Structure(square.nodes, square.bars, square.strings, 1.0,
                        point_mass=[0.0, 0.0, 0.3, 0.0])  # fmt: skip


def tower():
    """Two twisted prisms of three bars on one another, that share nodes, on three fixed nodes."""
    turn = np.deg2rad(np.array([0, 30, 60])[:, None] + [0, 120, 240])
    height = np.array([0.0, 1.0, 1.9])[:, None]
    nodes = np.stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), height + 0 * turn]).reshape(3, -1)
    low, middle, high = np.arange(9).reshape(3, 3)
    bars = [
        *zip(low, np.roll(middle, -1), strict=True),
        *zip(middle, np.roll(high, -1), strict=True),
    ]
    rings = [pair for ring in (middle, high) for pair in zip(ring, np.roll(ring, 1), strict=True)]
    sides = [*zip(low, middle, strict=True), *zip(middle, high, strict=True)]
    return tc.Structure(nodes, np.array(bars), np.array([*rings, *sides]), 1.0, fixed=[0, 1, 2])


def arm():
    """Three bars in a row in the plane, a clustered string, and a roller at the end."""
    nodes = [[0.0, 1.0, 1.8, 2.7, 0.0], [0.0, 0.3, -0.2, 0.1, 1.0]]
    return tc.Structure(nodes, [[0, 1], [1, 2], [2, 3]], [(4, 1, 3), (0, 2), (1, 3)],
                        [1.0, 0.8, 0.5], fixed=[0, 4, (3, "y")])  # fmt: skip


def spine(count=2):
    """Rigid vertebrae of ten bars on five nodes, one more than they need, on a fixed one."""
    star = np.array([[0, 0, 0], [1, 1, -0.6], [-1, -1, -0.6], [1, -1, 0.6], [-1, 1, 0.6]]).T * 0.2
    nodes = np.hstack([star + np.array([[0.0], [0.0], [0.15 * i]]) for i in range(count + 1)])
    bars = [(5 * i + a, 5 * i + b) for i in range(count + 1) for a, b in combinations(range(5), 2)]
    strings = [
        (5 * i + a, 5 * i + 5 + b)
        for i in range(count)
        for a, b in [*((k, k) for k in range(1, 5)), *((a, b) for a in (3, 4) for b in (1, 2))]
    ]
    return tc.Structure(nodes, bars, strings, 0.1, fixed=range(5))


def random_joined(seed, dimension):
    """Bars of class 2 to 4 between random nodes, a roller, a payload and a string node."""
    random = np.random.default_rng(seed)
    count = 7
    nodes = random.uniform(-1, 1, size=(dimension, count))
    chain = [(i, i + 1) for i in range(3)]
    bars = [*chain, (1, 4), (5, 0)] if dimension == 2 else [*chain, (1, 4), (5, 0), (3, 5), (0, 2)]
    strings = [(0, 6), (6, 4), (2, 5), (3, 6), (1, 3, 5)]
    mass = np.zeros(count)
    mass[[2, 6]] = 0.4, 0.2
    return tc.Structure(nodes, bars, strings, random.uniform(0.5, 2, len(bars)),
                        point_mass=mass, fixed=[(3, "x"), (6, "y")])  # fmt: skip


SCENES = {
    "d_bar": d_bar(),
    "free_d_bar": free_d_bar(),
    "tower": tower(),
    "arm": arm(),
    "spine": spine(1),
    **{f"random_{d}d_{seed}": random_joined(seed, d) for d in (2, 3) for seed in (1, 2)},
}


def at_rest(structure, seed=0, **options):
    """A model and the operating point of random forces, which a built-in load balances."""
    random = np.random.default_rng(seed)
    gamma = random.uniform(1, 10, len(structure.strings))
    lam = random.uniform(1, 5, len(structure.bars))
    load = -internal_forces(structure, structure.nodes, gamma, lam)
    model = tc.Model(structure, external_force=load, **options)
    return model, tc.OperatingPoint(structure.nodes, gamma, load)


def internal_forces(structure, nodes, gamma, lam):
    """Forces of strings and bars on the nodes, member by member."""
    forces = np.zeros_like(nodes)
    along = structure.string_vectors(nodes)
    each = np.linalg.norm(along, axis=0)
    whole = np.array([each[structure.segment_string == i].sum() for i in range(len(gamma))])
    for k, (start, end) in enumerate(structure.segments):
        of = structure.segment_string[k]
        pull = gamma[of] * whole[of] / each[k] * along[:, k]
        forces[:, start] += pull
        forces[:, end] -= pull
    for k, (start, end) in enumerate(structure.bars):
        push = lam[k] * (nodes[:, end] - nodes[:, start])
        forces[:, start] -= push
        forces[:, end] += push
    return forces


def oracle(structure, nodes, velocities, gamma, load):
    """Accelerations of the free rows by Lagrange multipliers, dense, by least squares."""
    d, rows = structure.dimension, structure.free_rows
    M = np.zeros((nodes.shape[1],) * 2)
    for (start, end), mass in zip(structure.bars, structure.bar_mass, strict=True):
        M[np.ix_([start, end], [start, end])] += mass / 6 * np.array([[2, 1], [1, 2]])
    M += np.diag(structure.point_mass)
    M = np.kron(M, np.eye(d))[np.ix_(rows, rows)]
    forces = load + internal_forces(structure, nodes, gamma, np.zeros(len(structure.bars)))
    f = forces.ravel(order="F")[rows]
    J = np.zeros((len(structure.bars), nodes.size))
    rate = np.zeros(len(structure.bars))
    for k, (start, end) in enumerate(structure.bars):
        b = nodes[:, end] - nodes[:, start]
        J[k, d * start : d * start + d], J[k, d * end : d * end + d] = -b, b
        rate[k] = ((velocities[:, end] - velocities[:, start]) ** 2).sum()
    J = J[:, rows]
    moving = np.abs(J).max(axis=1) > 0
    J, rate = J[moving], rate[moving]
    inverse = np.linalg.inv(M)
    lam = np.linalg.lstsq(J @ inverse @ J.T, -rate - J @ inverse @ f, rcond=1e-11)[0]
    return inverse @ (f + J.T @ lam)
