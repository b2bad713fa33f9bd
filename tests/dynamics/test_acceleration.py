"""Accelerations at random states: constraint, oracle, superposition, symmetry, signs."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import tenscontrol as tc
from tests.dynamics.scenes import (
    any_motion,
    random_force_density,
    random_motion,
    random_structure,
    random_turn,
    renumbered,
)
from tests.oracle import HeldForceDensity, RigidBars, node_acceleration

seeds = st.integers(0, 10_000)


def accelerated(structure, N, V, gamma, W=None):
    """Node accelerations of the model, shape (3, n)."""
    loads = [] if W is None else [W]
    model = tc.Model(structure, external_force=W is not None)
    return np.array(model.acceleration(N, V, gamma, *loads))


def spun_bar(mass=3.0, length=2.0, rate=5.0):
    """A bar alone that spins about its middle: structure, nodes, velocities."""
    half = length / 2
    nodes = np.array([[-half, half], [0.0, 0.0], [0.0, 0.0]])
    velocities = rate * np.array([[0.0, 0.0], [-half, half], [0.0, 0.0]])
    return tc.Structure(nodes, [[0, 1]], [], bar_mass=mass), nodes, velocities


# ---- against the oracle ----


@given(seed=seeds, points=st.integers(0, 4))
def test_rigid_bodies_accelerate_alike(seed, points):
    structure = random_structure(seed, bars=3, points=points)
    N, V = random_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    W = 10 * np.random.default_rng(seed).normal(size=N.shape)
    expected = RigidBars(structure, HeldForceDensity(gamma), W).node_acceleration(N, V)
    found = accelerated(structure, N, V, gamma, W)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


@given(seed=seeds, points=st.integers(0, 4))
def test_bars_of_any_length_accelerate_as_the_saddle_point_system_says(seed, points):
    structure = random_structure(seed, bars=2, points=points)
    N, V = any_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    expected, _ = node_acceleration(structure, N, V, gamma)
    found = accelerated(structure, N, V, gamma)
    assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()


@given(seed=seeds)
def test_bars_do_not_change_their_length_to_second_order(seed):
    """``b·b̈ + ḃ·ḃ = 0``, whatever the length of the bars and however they stretch."""
    structure = random_structure(seed, bars=3, points=2)
    N, V = any_motion(structure, seed)
    acceleration = accelerated(structure, N, V, random_force_density(structure, seed))
    B, Bd, Bdd = (structure.bar_vectors(columns) for columns in (N, V, acceleration))
    terms = (B * Bdd).sum(axis=0), (Bd * Bd).sum(axis=0)
    size = np.abs(B).max() * np.abs(Bdd).max()
    assert np.abs(sum(terms)).max() < 1e-13 * size


# ---- structure of the equations ----


@given(seed=seeds)
def test_accelerations_are_affine_in_force_density(seed):
    structure = random_structure(seed, bars=3, points=2)
    N, V = any_motion(structure, seed)
    first, second = (random_force_density(structure, seed + i) for i in (0, 1))
    at = {
        name: accelerated(structure, N, V, gamma)
        for name, gamma in (
            ("none", 0 * first),
            ("first", first),
            ("second", second),
            ("mixed", 0.3 * first + 2.5 * second),
        )
    }
    by_parts = 0.3 * (at["first"] - at["none"]) + 2.5 * (at["second"] - at["none"]) + at["none"]
    scale = max(np.abs(part).max() for part in at.values())
    assert np.abs(at["mixed"] - by_parts).max() < 1e-14 * 10 * scale


@given(seed=seeds)
def test_accelerations_are_affine_in_the_load(seed):
    structure = random_structure(seed, bars=3, points=2)
    N, V = any_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    first, second = np.random.default_rng(seed).normal(size=(2, *N.shape))
    one, two, both, none = (
        accelerated(structure, N, V, gamma, W)
        for W in (first, second, first + second, np.zeros_like(N))
    )
    assert np.abs(both - one - two + none).max() < 1e-13 * max(
        np.abs(one).max(), np.abs(none).max()
    )


@given(seed=seeds)
def test_no_load_is_a_zero_load(seed):
    structure = random_structure(seed, bars=3, points=1)
    N, V = any_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    without = accelerated(structure, N, V, gamma)
    zero = accelerated(structure, N, V, gamma, np.zeros_like(N))
    np.testing.assert_allclose(zero, without, rtol=1e-14, atol=1e-14 * np.abs(without).max())


# ---- symmetry ----


@given(seed=seeds)
def test_the_laws_are_the_same_for_a_turned_moved_and_travelling_observer(seed):
    structure = random_structure(seed, bars=3, points=2)
    N, V = any_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    W = np.random.default_rng(seed).normal(size=N.shape)
    turn = random_turn(seed)
    place, travel = np.random.default_rng(seed + 1).normal(size=(2, 3, 1))
    here = accelerated(structure, N, V, gamma, W)
    there = accelerated(structure, turn @ N + place, turn @ V + travel, gamma, turn @ W)
    assert np.abs(there - turn @ here).max() < 1e-11 * np.abs(here).max()


@given(seed=seeds)
def test_a_mirror_image_moves_as_the_mirror_image(seed):
    structure = random_structure(seed, bars=3, points=2)
    N, V = any_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    mirror = np.array([[1.0], [1.0], [-1.0]])
    here = accelerated(structure, N, V, gamma)
    there = accelerated(structure, mirror * N, mirror * V, gamma)
    np.testing.assert_allclose(there, mirror * here, rtol=0, atol=1e-14 * np.abs(here).max())


@given(seed=seeds)
def test_nodes_can_be_numbered_in_any_order(seed):
    structure = random_structure(seed, bars=3, points=3)
    N, V = any_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    place = np.random.default_rng(seed + 1).permutation(N.shape[1])
    moved_N, moved_V = np.empty_like(N), np.empty_like(V)
    moved_N[:, place], moved_V[:, place] = N, V
    here = accelerated(structure, N, V, gamma)
    there = accelerated(renumbered(structure, place), moved_N, moved_V, gamma)
    np.testing.assert_allclose(there[:, place], here, rtol=0, atol=1e-13 * np.abs(here).max())


@given(seed=seeds)
def test_a_bar_or_string_has_no_preferred_end(seed):
    structure = random_structure(seed, bars=3, points=2)
    N, V = any_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    reversed_ends = tc.Structure(
        structure.nodes,
        structure.bars[:, ::-1],
        structure.strings[:, ::-1],
        structure.bar_mass,
        structure.string_node_mass,
    )
    here = accelerated(structure, N, V, gamma)
    there = accelerated(reversed_ends, N, V, gamma)
    np.testing.assert_allclose(there, here, rtol=0, atol=1e-13 * np.abs(here).max())


# ---- signs and simple cases ----


def test_bars_of_the_prism_at_rest_are_in_compression(prism, rest):
    model = tc.Model(prism)
    found = np.array(model.bar_force_density(prism.nodes, np.zeros((3, 6)), rest.force_density))
    np.testing.assert_allclose(found.ravel(), 30.0, rtol=1e-13)
    assert (
        np.abs(accelerated(prism, prism.nodes, np.zeros((3, 6)), rest.force_density)).max() < 1e-12
    )


def test_a_spinning_bar_is_in_tension_and_its_ends_accelerate_inwards():
    structure, N, V = spun_bar(mass=3.0, length=2.0, rate=5.0)
    model = tc.Model(structure)
    found = float(model.bar_force_density(N, V, []))
    assert found == pytest.approx(-3.0 * 5.0**2 / 12, rel=1e-15)
    np.testing.assert_allclose(accelerated(structure, N, V, []), -(5.0**2) * N, atol=1e-13)


@pytest.mark.parametrize(("pull", "expected"), [(4.0, -2.0), (-4.0, 2.0)])
def test_ends_pulled_apart_put_a_bar_in_tension_and_pushed_ones_in_compression(pull, expected):
    """Two forces of 4 N along a bar of 2 m: 4 N / 2 m, negative for tension."""
    structure, N, _ = spun_bar(length=2.0)
    W = np.array([[-pull, pull], [0.0, 0.0], [0.0, 0.0]])
    model = tc.Model(structure, external_force=True)
    assert float(model.bar_force_density(N, np.zeros((3, 2)), [], W)) == expected
    np.testing.assert_array_equal(accelerated(structure, N, np.zeros((3, 2)), [], W), 0)


def test_a_force_on_one_end_moves_that_end_by_four_over_the_mass():
    """A free thin rod struck across at one end: a = 4 F/m there and -2 F/m at the other."""
    structure, N, _ = spun_bar(mass=3.0)
    W = np.array([[0.0, 0.0], [0.0, 6.0], [0.0, 0.0]])
    found = accelerated(structure, N, np.zeros((3, 2)), [], W)
    np.testing.assert_allclose(found[1], [-2 * 6 / 3, 4 * 6 / 3], rtol=1e-14)


def test_two_point_masses_on_a_string_fall_together():
    structure = tc.Structure(
        nodes=[[0.0, 2.0], [0.0, 0.0], [0.0, 0.0]],
        bars=[],
        strings=[[0, 1]],
        bar_mass=[],
        string_node_mass=[1.0, 4.0],
    )
    found = accelerated(structure, structure.nodes, np.zeros((3, 2)), [3.0])
    np.testing.assert_allclose(found[0], [3.0 * 2 / 1, -3.0 * 2 / 4], rtol=1e-15)


def test_the_state_equation_stacks_velocities_and_accelerations(prism):
    N, V = any_motion(prism, 0)
    gamma = random_force_density(prism, 0)
    x = np.concatenate([N.T.ravel(), V.T.ravel()])
    xdot = np.array(tc.Model(prism).dynamics(x, gamma)).ravel()
    np.testing.assert_array_equal(xdot[:18].reshape(6, 3).T, V)
    np.testing.assert_array_equal(xdot[18:].reshape(6, 3).T, accelerated(prism, N, V, gamma))
