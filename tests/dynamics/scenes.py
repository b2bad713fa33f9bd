"""Structures and motions that several tests use."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

import tenscontrol as tc
from tenscontrol.dynamics import ContactLaw

# γ_t of the prism at rest to all digits, N/m: γ_v = √3 γ_t = 30 N/m.
TOP_FORCE_DENSITY = 30 / np.sqrt(3)


def random_structure(seed, bars=3, points=2):
    """A class-1 structure of random shape, masses and strings, its nodes in random order."""
    random = np.random.default_rng(seed)
    count = 2 * bars + points
    order = random.permutation(count)
    bar_pairs = order[: 2 * bars].reshape(-1, 2)
    bar_set = {frozenset(pair) for pair in bar_pairs.tolist()}
    free = [pair for pair in combinations(range(count), 2) if frozenset(pair) not in bar_set]
    chosen = set(map(tuple, random.permutation(free)[: 2 * count].tolist()))
    for point in order[2 * bars :]:  # a point mass hangs on two strings at least
        at_point = [pair for pair in free if point in pair]
        chosen |= set(map(tuple, random.permutation(at_point)[:2].tolist()))
    return tc.Structure(
        nodes=random.normal(size=(3, count)),
        bars=bar_pairs,
        strings=random.permutation(sorted(chosen)),
        bar_mass=random.uniform(0.5, 2.0, bars),
        string_node_mass=random.uniform(0.1, 1.0, points) if points else None,
    )


def random_motion(structure, seed):
    """Random nodes and velocities, shape (3, n) each, of rigid bars with their true lengths."""
    random = np.random.default_rng(seed)
    count, bars = structure.nodes.shape[1], len(structure.bars)
    nodes, velocities = random.normal(size=(2, 3, count))
    direction = random.normal(size=(3, bars))
    direction /= np.linalg.norm(direction, axis=0)
    arm = 0.5 * structure.bar_length * direction
    swing = np.cross(random.normal(size=(3, bars)), arm, axis=0)
    start, end = structure.bars.T
    centre, drift = nodes[:, start], velocities[:, start]
    nodes[:, start], nodes[:, end] = centre - arm, centre + arm
    velocities[:, start], velocities[:, end] = drift - swing, drift + swing
    return nodes, velocities


def any_motion(structure, seed):
    """Random nodes and velocities, shape (3, n) each; bars have any length and stretch."""
    return np.random.default_rng(seed).normal(size=(2, *structure.nodes.shape))


def random_force_density(structure, seed):
    """Random γ, shape (α,), N/m."""
    return np.random.default_rng(seed).uniform(0.0, 30.0, len(structure.strings))


def random_turn(seed):
    """A random rotation matrix."""
    return Rotation.random(None, np.random.default_rng(seed)).as_matrix()


def renumbered(structure, place):
    """The same structure with node i in the place ``place[i]``."""
    nodes = np.empty_like(structure.nodes)
    nodes[:, place] = structure.nodes
    by_new_index = np.argsort(place[structure.string_nodes])
    return tc.Structure(
        nodes=nodes,
        bars=place[structure.bars],
        strings=place[structure.strings],
        bar_mass=structure.bar_mass,
        string_node_mass=structure.string_node_mass[by_new_index],
        string_groups=structure.string_groups,
    )


def side_by_side(structure, copies):
    """Copies of a structure without string nodes, 3 m apart, as one structure."""
    count = structure.nodes.shape[1]
    places = [np.array([[3.0 * i], [0.0], [0.0]]) for i in range(copies)]
    return tc.Structure(
        nodes=np.hstack([structure.nodes + place for place in places]),
        bars=np.vstack([structure.bars + i * count for i in range(copies)]),
        strings=np.vstack([structure.strings + i * count for i in range(copies)]),
        bar_mass=np.tile(structure.bar_mass, copies),
    )


def weighted_prism(mass=0.1):
    """The paper's prism with a point mass in the middle of every vertical string."""
    prism = tc.prism()
    vertical = prism.strings[prism.strings_in("vertical")]
    other = prism.strings[np.r_[prism.strings_in("top"), prism.strings_in("bottom")]]
    middle = 0.5 * (prism.nodes[:, vertical[:, 0]] + prism.nodes[:, vertical[:, 1]])
    point = 6 + np.arange(3)
    halves = [np.column_stack([vertical[:, 0], point]), np.column_stack([point, vertical[:, 1]])]
    return tc.Structure(
        nodes=np.hstack([prism.nodes, middle]),
        bars=prism.bars,
        strings=np.vstack([other, *halves]),
        bar_mass=prism.bar_mass,
        string_node_mass=mass,
        string_groups=("horizontal",) * 6 + ("vertical",) * 6,
    )


def paper_force_density(vertical):
    """γ of the paper's prism, N/m: 17.3205 in the horizontal strings."""
    return np.repeat([17.3205, 17.3205, vertical], 3)


def rest_lengths(structure, force_density, stiffness):
    """Rest lengths, m, that give γ in the reference shape: k (l - l0) = γ l."""
    return structure.string_length() * (1 - force_density / stiffness)


@dataclass(frozen=True, eq=False)
class Cubic(ContactLaw):
    """A law of a user, with one formula."""

    def normal_force(self, depth, rate):
        return self.stiffness * depth**3 * (1 + self.damping * rate)
