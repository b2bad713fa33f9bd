"""The equilibrium matrix: virtual work, and agreement with the dynamics."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.dynamics.scenes import any_motion, random_force_density, random_structure
from tests.oracle import node_acceleration

SEEDS = range(4)


@pytest.mark.parametrize("seed", SEEDS)
def test_its_transpose_gives_the_rates_of_the_squared_lengths(seed):
    """Virtual work: the load does the work γ s·ds in the strings and -λ b·db in the bars."""
    structure = random_structure(seed)
    N, V = any_motion(structure, seed)
    work = tc.statics.equilibrium_matrix(structure, N).T @ V.ravel(order="F")
    strings = (structure.string_vectors(N) * structure.string_vectors(V)).sum(axis=0)
    bars = (structure.bar_vectors(N) * structure.bar_vectors(V)).sum(axis=0)
    np.testing.assert_allclose(work, np.concatenate([strings, -bars]), rtol=0, atol=1e-13)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_load_that_it_names_holds_the_structure_still(seed):
    structure = random_structure(seed)
    gamma = random_force_density(structure, seed)
    compression = np.random.default_rng(seed).uniform(-10, 30, len(structure.bars))
    needed = tc.statics.equilibrium_matrix(structure) @ np.concatenate([gamma, compression])
    load = needed.reshape(3, -1, order="F")
    still = np.zeros_like(structure.nodes)
    acceleration, multipliers = node_acceleration(structure, structure.nodes, still, gamma, load)
    np.testing.assert_allclose(acceleration, 0, atol=1e-10)
    np.testing.assert_allclose(multipliers, compression, atol=1e-11)


@pytest.mark.parametrize("seed", SEEDS)
def test_member_forces_are_balanced_as_a_whole(seed):
    structure = random_structure(seed)
    E = tc.statics.equilibrium_matrix(structure).reshape(-1, 3, len(structure.strings) + 3)
    np.testing.assert_allclose(E.sum(axis=0), 0, atol=1e-14)
    moment = np.cross(structure.nodes.T[:, :, None], E, axis=1).sum(axis=0)
    np.testing.assert_allclose(moment, 0, atol=1e-13)
