"""Lowest modes by sparse matrices, plants in a few modes, and laws on them with the whole model."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import linalg

import tenscontrol as tc
from tenscontrol.plant.linear_plant import clusters
from tests import known_structures

RANDOM = np.random.default_rng(0)


def tower(stages, held="rest_length", kind="internal", damping=0.0):
    """A plant of a tower of prisms."""
    structure = tc.prism_tower(stages)
    rest = tc.prestress(structure, min_force_density=5.0)
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness=1e3, damping=damping))
    return tc.linearize(model, rest, input=held, coordinates=kind)


def cut_ball(damping):
    """A ball with strings of three segments each: two mechanisms a cut node, stiffened."""
    ball = known_structures.six_bar_ball()
    cut = tc.subdivide(ball, segments=3, node_mass=0.01)
    gamma = tc.structure.spread_force_density(cut, np.full(24, 10.0))
    model = tc.Model(cut, strings=tc.LinearStrings(stiffness=300.0, damping=damping))
    at = tc.OperatingPoint(cut.nodes, gamma)
    return tc.linearize(model, at, input="rest_length", require_equilibrium=False)


PLANTS = {
    "tower": lambda: tower(6),
    "tower, force densities": lambda: tower(6, "force_density"),
    "tower, damped, minimal": lambda: tower(6, kind="minimal", damping=0.3),
    "ball, damped": lambda: cut_ball(0.1),
}


@pytest.mark.parametrize("name", PLANTS)
def test_lowest_modes_are_those_of_the_dense_way(name):
    plant = PLANTS[name]()
    every, some = tc.modes(plant), tc.modes(plant, count=12)
    assert len(some) == 12
    assert some.label == every.label[:12]
    np.testing.assert_allclose(some.pole, every.pole[:12], atol=1e-8 * np.abs(every.pole[11]))
    # Shapes of single modes are the same motion; of equal ones, any of their space.
    alone = np.abs(np.diff(every.frequency[:13], prepend=-1.0)) > 1e-4 * every.frequency[12]
    for i in np.flatnonzero(alone[:12] & np.roll(alone, -1)[:12]):
        a, b = (of.shape[:, :, i].ravel() for of in (every, some))
        assert np.abs(a.conj() @ b) == pytest.approx(
            np.linalg.norm(a) * np.linalg.norm(b), rel=1e-6
        )


def turned_by_another_library(monkeypatch, seed):
    """Let each decomposition return other bases of the same spaces, as another LAPACK may."""
    random, eigh, eigsh = np.random.default_rng(seed), np.linalg.eigh, linalg.eigsh

    def turned(values, vectors):
        for first, last in clusters(values):
            noise = random.normal(size=(last - first,) * 2)
            vectors[:, first:last] = vectors[:, first:last] @ np.linalg.qr(noise)[0]
        return values, vectors

    monkeypatch.setattr(np.linalg, "eigh", lambda matrix: turned(*eigh(matrix)))
    monkeypatch.setattr(linalg, "eigsh", lambda *a, **k: turned(*eigsh(*a, **k)))


@pytest.mark.parametrize(
    ("held", "stages"),
    [("force_density", 1), ("force_density", 2), ("rest_length", 1), ("rest_length", 8)],
)  # the last by sparse matrices
def test_reduced_coordinates_are_those_of_every_library(monkeypatch, held, stages):
    count = 7
    one = tc.reduce(tower(stages, held), count)
    with monkeypatch.context() as other:
        turned_by_another_library(other, stages)
        two = tc.reduce(tower(stages, held), count)
    moved = np.linalg.norm(one.basis)
    np.testing.assert_allclose(two.basis, one.basis, rtol=0, atol=1e-6 * moved)
    structure = one.model.structure  # the same to round-off
    nodes = structure.nodes * (1 + 1e-14 * RANDOM.normal(size=structure.nodes.shape))
    model = tc.Model(replace(structure, nodes=nodes), strings=one.model.strings)
    at = tc.OperatingPoint(nodes, one.force_density)
    three = tc.reduce(tc.linearize(model, at, input=held), count)
    np.testing.assert_allclose(three.basis, one.basis, rtol=0, atol=1e-6 * moved)
    largest = one.basis[np.abs(one.basis).argmax(axis=0), np.arange(one.basis.shape[1])]
    assert (largest > 0).sum() > count / 2


def test_a_large_plant_has_sparse_matrices_alone():
    structure = tc.prism_tower(300)
    model = tc.Model(structure)
    gamma = np.full(len(structure.strings), 10.0)
    at = tc.OperatingPoint(structure.nodes, gamma)
    plant = tc.linearize(model, at, require_equilibrium=False)
    assert plant.sparse.stiffness.nnz < 1000 * plant.degrees_of_freedom
    with pytest.raises(ValueError, match=r"expected at most 0\.5 GB.*modes\(plant, count=20\)"):
        _ = plant.A
    assert len(tc.modes(plant, count=3)) == 3


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_margins_of_the_lowest_modes_are_those_of_all(held):
    plant = tower(6, held)
    every, some = tc.controllability(plant), tc.controllability(plant, count=12)
    kept = len(some.pole) - 1  # the last may be one of a pair
    assert some.unreachable == 0
    assert kept >= 5
    np.testing.assert_allclose(some.margin[:kept], every.margin[:kept], rtol=1e-6)
    np.testing.assert_allclose(some.pole[:kept], every.pole[:kept], atol=1e-8)


# ---- plants in a few modes ----


def test_a_reduced_plant_has_the_modes_that_it_keeps():
    plant = tower(5)
    every, chosen = tc.modes(plant), [3, 0, 10]
    for modes, kept in ((8, np.arange(8)), (chosen, sorted(chosen))):
        small = tc.reduce(plant, modes)
        np.testing.assert_allclose(tc.modes(small).frequency, every.frequency[kept], rtol=1e-9)
        z = 1e-3 * RANDOM.normal(size=2 * len(kept))
        q, rates = np.split(z, 2)
        found = small.measure(small.to_nodes(q), small.to_velocities(q, rates))
        np.testing.assert_allclose(found, z, atol=1e-15)
        # What is left out does not show: the accelerations of the modes are by themselves alone.
        r, own = plant.degrees_of_freedom, len(kept)
        of_modes = small.coordinates.project(plant.basis)
        alone = small.A[own:, :own] @ of_modes
        np.testing.assert_allclose(
            of_modes @ plant.A[r:, :r], alone, atol=1e-8 * np.abs(alone).max()
        )


def largest_error(plant, small, frequencies):
    """Largest singular value of the difference of two plants from inputs to node displacements."""
    found = []
    for w in frequencies:
        gains = [
            np.hstack([each.basis, 0 * each.basis])
            @ np.linalg.solve(1j * w * np.eye(len(each.A)) - each.A, each.B)
            for each in (plant, small)
        ]
        found.append(np.linalg.norm(gains[0] - gains[1], 2))
    return max(found)


def test_the_error_of_a_damped_plant_is_within_its_bound():
    plant = tower(2, damping=2.0)
    small = tc.reduce(plant, 12)
    error = largest_error(plant, small, np.geomspace(0.1, 3 * plant.spectral_radius, 150))
    assert 0 < error < small.error_bound < 300 * error
    assert 0 < small.dropped < 1
    assert tc.reduce(tower(2), 12).error_bound == np.inf


def test_all_modes_leave_nothing_out():
    plant = tower(2, damping=0.5)
    small = tc.reduce(plant, plant.degrees_of_freedom)
    assert small.dropped < 1e-9
    sizes = (np.sort(np.abs(np.linalg.eigvals(each.A))) for each in (small, plant))
    np.testing.assert_allclose(*sizes, rtol=1e-6)


def test_what_cannot_be_reduced_is_refused():
    plant = tower(2)
    with pytest.raises(ValueError, match="'nodes' coordinates"):
        tc.reduce(tc.plant.in_coordinates(plant, "nodes"))
    with pytest.raises(ValueError, match="reduced already"):
        tc.reduce(tc.reduce(plant, 3), 2)
    with pytest.raises(ValueError, match="modes is empty"):
        tc.reduce(plant, [])
    with pytest.raises(ValueError, match="expected 0 to"):
        tc.reduce(plant, [999])


@pytest.mark.parametrize("law", ["lqr", "mpc"])
def test_a_law_on_a_few_modes_damps_the_whole_tower_as_designed(law):
    plant = tower(6)
    small, sample = tc.reduce(plant, 12), 0.05
    Q, R = tc.energy_weights(small, by_mode=True)
    designed = tc.LQR(small, Q, 3 * R, sample_time=sample)
    made = designed
    if law == "mpc":
        made = tc.MPC(small, horizon=4, sample_time=sample, Q=Q, R=3 * R)
    q = np.r_[0.02 / np.abs(small.basis[:, 0]).max(), np.zeros(11)]
    start = small.to_nodes(q)
    run = tc.simulate(plant.model, 1.2, start, 0 * start, controller=made, error="none")
    times = np.arange(0, 1.2001, sample)
    at = np.searchsorted(run.time, times - 1e-9)
    found = np.array([small.measure(run.nodes[:, :, i], run.velocities[:, :, i]) for i in at])
    transition, by_input, _ = small.discretize(sample)
    state, linear = np.r_[q, 0 * q], []
    for _ in times:
        linear.append(state)
        state = transition @ state - by_input @ designed.gain @ state
    w = 2 * np.pi * tc.modes(small).frequency[0]
    size, expected = (np.hypot(z[:, 0], z[:, 12] / w) for z in (found, np.array(linear)))
    rate, design = (np.polyfit(times, np.log(each), 1)[0] for each in (size, expected))
    assert rate == pytest.approx(design, rel=0.02)
    assert design < -0.5


def test_a_filter_on_a_few_modes_follows_the_whole_tower_and_the_law_runs_on_it():
    plant = tower(4)
    small, sample = tc.reduce(plant, 8), 0.05
    sensors = tc.Sensors(structure=plant.model.structure, node_position=1e-3)
    estimator = tc.KalmanFilter(small, sensors, sample_time=sample)
    Q, R = tc.energy_weights(small, by_mode=True)
    law = tc.LQR(small, Q, 3 * R, sample_time=sample)
    q = np.r_[0.05 / np.abs(small.basis[:, 0]).max(), np.zeros(7)]
    start = small.to_nodes(q)
    run = tc.simulate(
        plant.model, 2.0, start, 0 * start, controller=law, estimator=estimator, error="none"
    )
    ends = [small.measure(run.nodes[:, :, i], run.velocities[:, :, i])[0] for i in (0, -1)]
    assert abs(ends[1]) < 0.2 * abs(ends[0])
    found = run.control.estimate
    true = run.nodes[:, :, np.searchsorted(run.time, 1.0)]
    guessed = found.nodes[:, :, np.searchsorted(run.control.time, 1.0)]
    assert np.sqrt(((true - guessed) ** 2).mean()) < 1e-3
