"""What the independent models are worth: two methods, two tolerances, two formulations."""

import numpy as np
import pytest
from scipy.integrate import Radau, solve_ivp

import tenscontrol as tc
from tests.dynamics.scenes import (
    paper_force_density,
    random_force_density,
    random_motion,
    random_structure,
    rest_lengths,
    weighted_prism,
)
from tests.oracle import (
    HeldForceDensity,
    HeldRestLength,
    RigidBars,
    consistent_mass,
    node_acceleration,
)


def paper_scene(damping=0.0):
    """Example 1 of the paper as rigid bodies: the horizontal strings go slack at 0.07 s."""
    prism = tc.prism()
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    return RigidBars(prism, HeldRestLength(lengths, 100.0, damping))


def moved(bodies, times, **how):
    start = bodies.structure.nodes
    return bodies.integrate(start, np.zeros_like(start), times, **how)


def test_two_tolerances_agree_over_five_seconds(paper_motion):
    nodes, _ = moved(paper_scene(), paper_motion.time[::500], tolerance=1e-12)
    assert np.abs(nodes - paper_motion.nodes[:, :, ::500]).max() < 1e-10


def test_an_implicit_method_agrees_across_the_first_switches():
    times = np.linspace(0, 0.3, 31)
    explicit, switches = moved(paper_scene(), times)
    implicit, _ = moved(paper_scene(), times, method=Radau, tolerance=1e-9)
    assert len(switches) == 4
    assert np.abs(implicit - explicit).max() < 1e-9


def test_strings_go_slack_when_the_theory_says(paper_motion):
    assert paper_motion.switches[0] == pytest.approx(0.0708, abs=5e-5)
    assert len(paper_motion.switches) > 50


def test_all_horizontal_strings_switch_together_and_vertical_ones_never(paper_motion):
    structure = tc.prism()
    length = np.linalg.norm(
        paper_motion.nodes[:, structure.strings[:, 1]]
        - paper_motion.nodes[:, structure.strings[:, 0]],
        axis=0,
    )
    slack = length < rest_lengths(structure, paper_force_density(9.0), 100.0)[:, None]
    assert not slack[6:].any()
    assert np.abs(length[:6] - length[0]).max() < 1e-9
    assert slack[0].mean() == pytest.approx(0.22, abs=0.01)


def test_saddle_point_system_gives_the_same_motion():
    """Lagrange multipliers over node coordinates, in a scene that never goes slack."""
    prism = tc.prism()
    law = HeldRestLength(rest_lengths(prism, paper_force_density(45.0), 100.0), 100.0, 0.3)

    def slope(_, x):
        N, V = (part.reshape(-1, 3).T for part in np.split(x, 2))
        S, Sd = prism.string_vectors(N), prism.string_vectors(V)
        length = np.linalg.norm(S, axis=0)
        gamma = law(length, (S * Sd).sum(axis=0) / length, True)
        return np.r_[V.T.ravel(), node_acceleration(prism, N, V, gamma)[0].T.ravel()]

    start = np.r_[prism.nodes.T.ravel(), np.zeros(18)]
    found = solve_ivp(slope, (0, 0.5), start, "DOP853", rtol=1e-12, atol=1e-13).y[:18, -1]
    expected, _ = moved(RigidBars(prism, law), np.array([0.0, 0.5]))
    assert np.abs(found.reshape(6, 3).T - expected[:, :, -1]).max() < 1e-11


@pytest.mark.parametrize("seed", range(5))
def test_both_formulations_give_the_same_accelerations(seed):
    structure = random_structure(seed, bars=3, points=seed % 3)
    N, V = random_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    load = np.random.default_rng(seed).normal(size=N.shape)
    bodies = RigidBars(structure, HeldForceDensity(gamma), load)
    saddle, _ = node_acceleration(structure, N, V, gamma, load)
    scale = np.abs(saddle).max()
    assert np.abs(bodies.node_acceleration(N, V) - saddle).max() < 1e-12 * scale


def test_bodies_keep_their_bars_and_their_energy():
    """Point masses in the verticals; γ held, so that the energy is ½ Σ γ l²."""
    structure = weighted_prism()
    gamma = np.r_[np.full(6, 17.3205), np.full(6, 18.0)]
    bodies = RigidBars(structure, HeldForceDensity(gamma))
    state = bodies.state(structure.nodes, np.zeros_like(structure.nodes))
    pulls = bodies.pulls(state)
    found = solve_ivp(
        lambda _, y: bodies.slope(y, pulls), (0, 1.0), state, "DOP853", rtol=1e-12, atol=1e-13
    )
    energies = []
    for y in found.y.T[::10]:
        N, V = bodies.nodes(y)
        stored = 0.5 * gamma @ (structure.string_vectors(N) ** 2).sum(axis=0)
        energies.append(stored + bodies.kinetic_energy(N, V))
        length = np.linalg.norm(structure.bar_vectors(N), axis=0)
        assert np.abs(length - structure.bar_length).max() < 1e-10
    assert np.ptp(energies) < 1e-9


def test_consistent_mass_is_that_of_a_thin_rod():
    structure = tc.Structure([[0.0, 2.0], [0.0, 0.0], [0.0, 0.0]], [[0, 1]], [], bar_mass=6.0)
    np.testing.assert_allclose(consistent_mass(structure), [[2.0, 1.0], [1.0, 2.0]], rtol=1e-15)
