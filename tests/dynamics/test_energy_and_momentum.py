"""Energies and momenta, and their rates."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import tenscontrol as tc
from tests.dynamics.scenes import (
    any_motion,
    random_force_density,
    random_motion,
    random_structure,
)
from tests.oracle import HeldForceDensity, RigidBars, consistent_mass

seeds = st.integers(0, 10_000)


def state(N, V):
    return np.concatenate([N.T.ravel(), V.T.ravel()])


@given(seed=seeds)
def test_kinetic_energy_is_half_the_trace(seed):
    structure = random_structure(seed, bars=3, points=2)
    N, V = any_motion(structure, seed)
    expected = 0.5 * np.trace(V @ consistent_mass(structure) @ V.T)
    assert float(tc.Model(structure).kinetic_energy(state(N, V))) == pytest.approx(expected, 1e-14)


@given(seed=seeds)
def test_kinetic_energy_and_momenta_are_those_of_the_bodies(seed):
    structure = random_structure(seed, bars=3, points=2)
    N, V = random_motion(structure, seed)
    bodies = RigidBars(structure, HeldForceDensity(np.zeros(len(structure.strings))))
    model = tc.Model(structure)
    energy = float(model.kinetic_energy(state(N, V)))
    assert energy == pytest.approx(bodies.kinetic_energy(N, V), rel=1e-13)
    found = [np.array(part).ravel() for part in model.momentum(state(N, V))]
    np.testing.assert_allclose(found, bodies.momentum(N, V), rtol=1e-12, atol=1e-13)


@given(seed=seeds)
def test_kinetic_energy_grows_by_the_power_of_strings_and_load(seed):
    """Rigid bars do no work: d/dt ½ tr(Ṅ M Ṅᵀ) = W·Ṅ - Σ γ s·ṡ."""
    structure = random_structure(seed, bars=3, points=2)
    N, V = random_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    W = 10 * np.random.default_rng(seed).normal(size=N.shape)
    acceleration = np.array(tc.Model(structure, external_force=True).acceleration(N, V, gamma, W))
    rate = np.trace(V @ consistent_mass(structure) @ acceleration.T)
    strings = gamma * (structure.string_vectors(N) * structure.string_vectors(V)).sum(axis=0)
    terms = np.concatenate([(W * V).ravel(), -strings])
    assert rate == pytest.approx(terms.sum(), abs=1e-12 * np.abs(terms).sum())


@given(seed=seeds)
def test_momenta_change_by_the_resultant_of_the_load_only(seed):
    structure = random_structure(seed, bars=3, points=2)
    N, V = any_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    W = np.random.default_rng(seed).normal(size=N.shape)
    acceleration = np.array(tc.Model(structure, external_force=True).acceleration(N, V, gamma, W))
    rate = acceleration @ consistent_mass(structure)
    size = np.abs(rate).sum()
    np.testing.assert_allclose(rate.sum(axis=1), W.sum(axis=1), rtol=0, atol=1e-13 * size)
    # L = Σ n × (Ṅ M)ₙ; the terms in Ṅ × Ṅ M cancel since M is symmetric.
    moment = np.cross(N.T, rate.T).sum(axis=0)
    expected = np.cross(N.T, W.T).sum(axis=0)
    np.testing.assert_allclose(moment, expected, rtol=0, atol=1e-13 * size * np.abs(N).max())


@pytest.mark.parametrize("law", [tc.LinearStrings(100.0), tc.ElasticStrings(100.0)])
@pytest.mark.parametrize("seed", range(3))
def test_string_forces_are_the_slope_of_the_stored_energy(law, seed):
    """dE/dt of the strings, by a central difference along a motion, is Σ γ s·ṡ."""
    structure = random_structure(seed, bars=3, points=2)
    N, V = any_motion(structure, seed)
    model = tc.Model(structure, strings=law)
    rest = structure.string_length(N) * np.random.default_rng(seed).uniform(
        0.5, 1.4, len(structure.strings)
    )
    assert (rest > structure.string_length(N)).any(), "some strings are slack"
    gamma = np.array(model.string_force_density(state(N, V), rest)).ravel()
    powers = gamma * (structure.string_vectors(N) * structure.string_vectors(V)).sum(axis=0)
    step = 1e-5
    ahead, behind = (float(model.elastic_energy(state(N + s * V, V), rest)) for s in (step, -step))
    slope = (ahead - behind) / (2 * step)
    assert slope == pytest.approx(powers.sum(), abs=1e-8 * np.abs(powers).sum())


def test_potential_energy_of_held_force_densities(prism):
    N, V = any_motion(prism, 1)
    gamma = random_force_density(prism, 1)
    expected = 0.5 * gamma @ (prism.string_vectors(N) ** 2).sum(axis=0)
    found = float(tc.Model(prism).potential_energy(state(N, V), gamma))
    assert found == pytest.approx(expected, rel=1e-14)
