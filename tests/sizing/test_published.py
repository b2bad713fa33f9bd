"""Designs that others have published, from their materials to their numbers."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.plant.test_rigidity import elastic_frequencies

# The tower of two stages in TsgFEM, Dynamics_Examples/01_tower/main_tower_dynamic_simple.m. Its
# steel is 50 times as dense as steel, and a "safety" of 0.1 divides the stress that is allowed.
STEEL = tc.Material(modulus=300e6 / 1456e-6, density=50 * 7870.0, yield_stress=300e6)
WIRE = tc.Material(modulus=1223.5e6 / 0.016099, density=7870.0, yield_stress=1223.5e6)
PUSH = 1e5  # N, of each bar


@pytest.fixture(scope="module")
def tower():
    shape = tc.library.class2_tower(stages=2, radius=10.0, height=30.0, handedness="right")
    alpha = len(shape.strings)
    E = tc.statics.equilibrium_matrix(shape)[shape.free_rows]
    held = np.hstack([np.zeros((6, alpha)), np.diag(shape.bar_length)])
    balance, forces = np.vstack([E, held]), np.r_[np.zeros(len(E)), np.full(6, PUSH)]
    gamma = np.linalg.lstsq(balance, forces, rcond=None)[0][:alpha]
    sized = tc.design(shape, bars=STEEL, strings=WIRE, safety=10.0, min_force_density=gamma)
    rest = tc.prestress(sized.structure, force_density=gamma)
    model = tc.Model(sized.structure, strings=tc.ElasticStrings(sized.axial_rigidity))
    return sized, rest, tc.linearize(model, rest, input="rest_length")


def test_sections_of_a_tower_are_those_of_the_formulas(tower):
    sized, rest, _ = tower
    length = sized.structure.bar_length
    np.testing.assert_allclose(
        sized.bar_area, 2 * length * np.sqrt(PUSH / 0.1 / np.pi / STEEL.modulus), rtol=1e-9
    )
    pull = rest.force_density * sized.structure.string_length()
    np.testing.assert_allclose(sized.string_area, pull / 1223.5e6 / 0.1, rtol=1e-9)


def test_a_tower_has_the_frequencies_that_are_printed(tower):
    plant = tower[2]
    found = tc.modes(plant).frequency[:3]
    np.testing.assert_array_equal(found.round(4), [0.0109, 0.0195, 0.0340])


def test_elastic_bars_change_the_modes_by_what_rigidity_says(tower):
    sized, rest, plant = tower
    report = tc.rigidity(plant, sized.bar_axial_rigidity)
    # Strings as elements of EA / rest length, bars of their length at rest.
    pull = rest.force_density * sized.structure.string_length()
    rest_length = sized.structure.string_length() / (1 + pull / sized.axial_rigidity)
    elastic = elastic_frequencies(
        sized.structure, rest.force_density, rest.bar_force_density,
        sized.axial_rigidity / rest_length, sized.bar_axial_rigidity,
    )[: len(report.frequency)]  # fmt: skip
    change = elastic / report.frequency - 1
    np.testing.assert_allclose(report.change[:6], change[:6], rtol=0.05, atol=1e-7)
