"""What a trajectory says of the motion."""

import copy
import pickle
from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest

import tenscontrol as tc
from tests.dynamics.scenes import paper_force_density, rest_lengths, weighted_prism
from tests.oracle import HeldForceDensity, RigidBars, consistent_mass


@pytest.fixture(scope="module")
def weighted_run():
    """A prism with point masses, rest lengths held, 0.3 s."""
    structure = weighted_prism()
    model = tc.Model(structure, strings=tc.LinearStrings(200.0))
    lengths = rest_lengths(structure, np.r_[np.full(6, 17.0), np.full(6, 18.0)], 200.0)
    return tc.simulate(model, 0.3, rest_length=lengths, step=1e-3)


def test_shapes_have_time_last(weighted_run):
    shapes = {
        "time": (301,),
        "nodes": (3, 9, 301),
        "velocities": (3, 9, 301),
        "force_density": (12, 301),
        "rest_length": (12, 301),
        "kinetic_energy": (301,),
        "potential_energy": (301,),
        "energy": (301,),
        "momentum": (3, 301),
        "angular_momentum": (3, 301),
        "bar_length_error": (3, 301),
    }
    assert {name: getattr(weighted_run, name).shape for name in shapes} == shapes


EVALUATED = (
    "force_density", "kinetic_energy", "potential_energy", "momentum", "angular_momentum",
    "bar_length_error",
)  # fmt: skip


def test_every_array_is_read_only(weighted_run):
    names = [*EVALUATED, *(field.name for field in fields(weighted_run))]
    values = [getattr(weighted_run, name) for name in names]
    arrays = [value for value in values if isinstance(value, np.ndarray)]
    assert len(arrays) == 12
    assert not any(array.flags.writeable for array in arrays)
    with pytest.raises(FrozenInstanceError):
        weighted_run.nodes = None


def test_what_nobody_reads_is_not_evaluated():
    """Health needs the energies of an undamped motion; of a controlled or damped one, nothing."""
    damped = tc.Model(tc.prism(), strings=tc.LinearStrings(200.0, damping=1.0))
    run = tc.simulate(damped, 0.1, rest_length=1.0, step=1e-3)
    evaluated = [name for name in EVALUATED if name in vars(run)]
    assert evaluated == ["bar_length_error"]
    assert run.momentum is run.momentum
    before = run.rest_length.strides
    assert before[1] == 0  # held: one column for all times


def test_a_pickled_or_copied_run_holds_all_values_and_no_model(weighted_run):
    kept = pickle.loads(pickle.dumps(weighted_run))
    for other in (kept, copy.copy(weighted_run), copy.deepcopy(kept)):
        for name in (*EVALUATED, "nodes", "rest_length", "energy"):
            np.testing.assert_array_equal(getattr(other, name), getattr(weighted_run, name))
        assert other.health == weighted_run.health
        assert not any(isinstance(value, tc.Model) for value in vars(other).values())


def test_it_starts_at_the_start(weighted_run):
    assert weighted_run.time[0] == 0.0
    np.testing.assert_array_equal(weighted_run.nodes[:, :, 0], weighted_run.structure.nodes)
    np.testing.assert_array_equal(weighted_run.velocities[:, :, 0], 0.0)


def test_velocities_are_the_rate_of_the_nodes(weighted_run):
    """Central differences over 2 ms: error of second order, third derivative near 400 m/s³."""
    rate = (weighted_run.nodes[:, :, 2:] - weighted_run.nodes[:, :, :-2]) / 2e-3
    error = np.abs(rate - weighted_run.velocities[:, :, 1:-1]).max()
    assert error < 1e-3 * np.abs(weighted_run.velocities).max()


def test_energies_momenta_and_bar_lengths_are_those_of_the_bodies(weighted_run):
    structure = weighted_run.structure
    bodies = RigidBars(structure, HeldForceDensity(np.zeros(12)))
    for i in range(0, 301, 60):
        N, V = weighted_run.nodes[:, :, i], weighted_run.velocities[:, :, i]
        kinetic = 0.5 * np.trace(V @ consistent_mass(structure) @ V.T)
        assert weighted_run.kinetic_energy[i] == pytest.approx(kinetic, rel=1e-12, abs=1e-15)
        stretch = structure.string_length(N) - weighted_run.rest_length[:, i]
        stored = 0.5 * 200.0 * (np.maximum(stretch, 0) ** 2).sum()
        assert weighted_run.potential_energy[i] == pytest.approx(stored, rel=1e-12)
        linear, angular = bodies.momentum(N, V)
        np.testing.assert_allclose(weighted_run.momentum[:, i], linear, atol=1e-13)
        np.testing.assert_allclose(weighted_run.angular_momentum[:, i], angular, atol=1e-7)
        length = np.linalg.norm(structure.bar_vectors(N), axis=0)
        error = length - structure.bar_length
        np.testing.assert_allclose(weighted_run.bar_length_error[:, i], error, atol=1e-15)


def test_force_densities_follow_the_string_law(weighted_run):
    structure = weighted_run.structure
    ends = [weighted_run.nodes[:, structure.strings[:, i]] for i in (0, 1)]
    length = np.linalg.norm(ends[1] - ends[0], axis=0)
    tension = np.maximum(0, 200.0 * (length - weighted_run.rest_length))
    np.testing.assert_allclose(weighted_run.force_density * length, tension, rtol=0, atol=1e-11)
    assert (weighted_run.force_density == 0).any()


def test_where_force_density_is_held_there_is_no_rest_length(prism, rest):
    run = tc.simulate(tc.Model(prism), 0.01, force_density=rest.force_density, step=1e-3)
    assert run.rest_length is None
    assert run.control is None
    expected = np.tile(rest.force_density[:, None], (1, 11))
    np.testing.assert_array_equal(run.force_density, expected)


def test_potential_energy_of_held_force_density_and_load(prism):
    gamma = paper_force_density(9.0)
    load = np.random.default_rng(0).normal(size=(3, 6))
    run = tc.simulate(
        tc.Model(prism, external_force=True),
        0.1,
        force_density=gamma,
        external_force=load,
        step=1e-3,
    )
    for i in (0, 50, 100):
        N = run.nodes[:, :, i]
        expected = 0.5 * gamma @ prism.string_length(N) ** 2 - (load * N).sum()
        assert run.potential_energy[i] == pytest.approx(expected, rel=1e-12)


def test_work_is_counted(prism, rest):
    run = tc.simulate(tc.Model(prism), 0.1, force_density=rest.force_density, step=1e-3)
    assert (run.method, run.step, run.steps, run.evaluations) == ("rk4", 1e-3, 100, 400)


def test_the_summary_names_the_figures_to_trust_it_by(weighted_run):
    text = weighted_run.summary()
    for words in (
        "0.3 s by rk4",
        " steps, ",
        "energy",
        "momentum",
        "bar-length",
    ):
        assert words in text
