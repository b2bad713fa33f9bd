"""Prestress and rest lengths go where their arrays do."""

import numpy as np
import pytest

import tenscontrol as tc


@pytest.fixture(scope="module")
def model():
    return tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0))


@pytest.fixture(scope="module")
def rest(model):
    return tc.prestress(model.structure, force_density=10.0)


def test_what_to_rest_length_returns_goes_on(model, rest):
    lengths = tc.to_rest_length(model, rest)
    by_arrays = tc.to_rest_length(model, rest.structure.nodes, rest.force_density)
    np.testing.assert_array_equal(lengths.rest_length, by_arrays.rest_length)
    found = tc.to_force_density(model, rest, lengths)
    np.testing.assert_allclose(found, rest.force_density, rtol=1e-13)
    run = tc.simulate(model, 0.02, nodes=rest, rest_length=lengths, step=1e-3)
    np.testing.assert_array_equal(run.rest_length[:, 0], lengths.rest_length)
    still = np.zeros((1, 3, 6))
    scene = tc.Scene(
        model, 0.02, nodes=rest, rest_length=lengths, integration=tc.Integration(step=1e-3)
    )
    batch = tc.simulate_many(scene, {"velocities": still})
    np.testing.assert_array_equal(batch.nodes[0, ..., -1], run.nodes[..., -1])
    settled = tc.equilibrium(model, rest_length=lengths)
    np.testing.assert_allclose(settled.tension, rest.tension, rtol=1e-6)


def test_a_prestress_is_its_force_densities_and_its_nodes(model, rest):
    run = tc.simulate(model, 0.02, force_density=rest, step=1e-3)
    np.testing.assert_array_equal(run.force_density[:, 0], rest.force_density)
    again = tc.prestress(rest.structure, rest)
    np.testing.assert_array_equal(again.force_density, rest.force_density)
    np.testing.assert_array_equal(
        tc.linearize(model, tc.OperatingPoint(rest, rest)).nodes, rest.nodes
    )


def test_a_record_never_stands_for_another_quantity(model, rest):
    with pytest.raises(TypeError, match=r"stands for force_density.*give to_rest_length"):
        tc.simulate(model, 0.1, rest_length=rest)
    with pytest.raises(TypeError, match="force_density is a RestLengths, which stands for rest_l"):
        tc.simulate(model, 0.1, force_density=tc.to_rest_length(model, rest))


def test_forces_at_rest_and_in_a_run_are_densities_times_lengths(model, rest):
    """The prism in closed form: λ = √3 γ, and both forces balance at each node."""
    np.testing.assert_allclose(rest.bar_force, 10 * np.sqrt(3) * rest.structure.bar_length)
    B, S = rest.structure.bar_vectors(rest), rest.structure.string_vectors(rest)
    C_b = (rest.structure.C_b @ rest.structure.C_nb).toarray()
    units = B / np.linalg.norm(B, axis=0), S / np.linalg.norm(S, axis=0)
    forces = (rest.bar_force * units[0]) @ C_b - (rest.tension * units[1]) @ rest.structure.C_s
    np.testing.assert_allclose(forces, 0.0, atol=1e-13)
    run = tc.simulate(model, 0.02, force_density=rest, step=1e-3)
    np.testing.assert_allclose(run.bar_force, np.tile(rest.bar_force[:, None], 21), rtol=1e-9)
    np.testing.assert_allclose(run.tension[:, 0], rest.tension, rtol=1e-13)
