"""Every structure of the library moves as the dense oracle says."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.library.structures import STRUCTURES
from tests.oracle import node_acceleration
from tests.random_structures import any_motion_of


@pytest.mark.parametrize("name", STRUCTURES)
def test_accelerations_and_bar_forces_are_those_of_the_oracle(name):
    structure = STRUCTURES[name]()
    gamma = np.random.default_rng(len(name)).uniform(0.0, 20.0, len(structure.strings))
    N, V = any_motion_of(structure, len(name))
    expected, compression = node_acceleration(structure, N, V, gamma)
    model, free = tc.Model(structure), structure.free
    found = model.acceleration(N[:, free], V[:, free], gamma).full()
    assert np.abs(found - expected[:, free]).max() < 1e-10 * np.abs(expected).max()
    lam = model.bar_force_density(N[:, free], V[:, free], gamma).full().ravel()
    largest = np.abs(compression).max(initial=1e-300)
    assert np.abs(lam - compression).max(initial=0.0) < 1e-10 * largest
