"""Plants of subdivided structures whose inputs are the uncut strings."""

import numpy as np
import pytest

import tenscontrol as tc

TOP = 30 / np.sqrt(3)


def massive_plant(kind, mass=0.02, segments=2):
    structure = tc.subdivide(tc.prism(), segments, node_mass=mass)
    strings = tc.LinearStrings(100.0 * tc.structure.segment_counts(structure))
    model = tc.Model(structure, strings=strings)
    gamma = tc.structure.spread_force_density(structure, tc.statics.prism_force_density(3, TOP)[0])
    return tc.linearize(model, tc.prestress(structure, gamma), input=kind)


@pytest.mark.parametrize("kind", ["force_density", "rest_length"])
def test_a_command_of_the_parent_is_that_command_spread_over_the_segments(kind):
    plant = massive_plant(kind, segments=3)
    whole = tc.plant.command_parents(plant)
    structure = plant.model.structure
    command = np.random.default_rng(0).normal(size=9)
    size = 3.0 if kind == "force_density" else 1 / 3
    np.testing.assert_allclose(
        whole.B @ command, plant.B @ (size * command[structure.string_parent]), atol=1e-12
    )
    np.testing.assert_allclose(whole.force_density, tc.statics.prism_force_density(3, TOP)[0])
    np.testing.assert_allclose(whole.rest_length.sum(), plant.rest_length.sum())
    assert len(whole.input_names) == 9
    assert tc.plant.in_coordinates(whole, "minimal").B.shape[1] == 9
    assert tc.plant.command_parents(whole) is whole


def test_a_regulator_designed_with_string_mass_damps_the_strings_as_well():
    """Strings of 20 % of the mass of the bars, wound as a whole."""
    whole = tc.plant.command_parents(massive_plant("rest_length", mass=0.2 * 3 / 9))
    Q, R = tc.energy_weights(whole)
    regulator = tc.LQR(whole, Q, 0.1 * R)
    assert regulator.gain.shape == (9, 2 * whole.degrees_of_freedom)
    start = whole.to_nodes(0.001 * np.random.default_rng(0).normal(size=whole.degrees_of_freedom))
    wound = tc.structure.spread_rest_length(whole.model.structure, whole.rest_length)
    options = {"step": 1e-3, "output_step": 0.01}
    free = tc.simulate(whole.model, 3.0, start, rest_length=wound, **options)
    run = tc.simulate(whole.model, 3.0, start, controller=regulator, sample_time=2e-3, **options)
    assert run.kinetic_energy[-100:].max() < 0.2 * free.kinetic_energy[-100:].max()


def test_force_densities_of_whole_strings_cannot_damp_every_swing_of_the_strings():
    """By symmetry: 18 states of sideways motion that no γ reaches, and the design says so."""
    whole = tc.plant.command_parents(massive_plant("force_density"))
    assert tc.controllability(whole).unreachable == 18
    with pytest.warns(RuntimeWarning, match="no string reaches 9 modes of the plant, at"):
        regulator = tc.LQR(whole, *tc.energy_weights(whole))
    assert len(regulator.left_alone) == 9
    assert np.count_nonzero(regulator.poles.real < -1e-6) == len(whole.A) - 18


def test_a_plant_of_whole_strings_commands_them_already():
    plant = tc.linearize(tc.Model(tc.prism()), tc.prestress(tc.prism(), TOP))
    assert tc.plant.command_parents(plant) is plant


def test_a_plant_with_a_skin_has_no_parents_to_command():
    skinned = tc.skin(tc.prism(), "top", node_mass=0.1)
    at = tc.OperatingPoint(skinned.nodes, np.full(12, 10.0))
    plant = tc.linearize(tc.Model(skinned), at, require_equilibrium=False)
    with pytest.raises(ValueError, match="not that of a subdivided structure"):
        tc.plant.command_parents(plant)
