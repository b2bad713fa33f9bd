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


# Columns that are as light as their complexity allows: R. E. Skelton and M. C. de Oliveira,
# Tensegrity Systems (2009), chapter 3, and Optimal complexity of deployable compressive structures,
# J. Franklin Institute 347 (2010) 228. Masses are over that of one bar of this length and load.
ALUMINIUM = tc.Material(modulus=60e9, density=2700.0, yield_stress=110e6)
SPAN, LOAD = 2.0, 1e4


def one_bar():
    return 2 * ALUMINIUM.density * SPAN**2 * np.sqrt(LOAD / (np.pi * ALUMINIUM.modulus))


def nested(complexity, angle):
    """A bar, of which each is replaced by four bars around a string, as often as asked."""
    nodes, bars, strings = [np.zeros(2), np.array([SPAN, 0.0])], [(0, 1)], []
    for _ in range(complexity):
        finer = []
        for start, end in bars:
            along = nodes[end] - nodes[start]
            across = 0.5 * np.tan(angle) * np.array([-along[1], along[0]])
            middle, left, right = 0.5 * (nodes[start] + nodes[end]), len(nodes), len(nodes) + 1
            nodes += [middle + across, middle - across]
            strings.append((left, right))
            finer += [(start, left), (left, end), (start, right), (right, end)]
        bars = finer
    return tc.Structure(np.array(nodes).T, bars, strings, bar_mass=1.0)


def pressed_mass(structure, **limits):
    load = np.zeros(structure.nodes.shape)
    load[0, :2] = LOAD, -LOAD
    return tc.design(structure, bars=ALUMINIUM, strings=ALUMINIUM, loads=[load],
                     min_force_density=0.0, **limits).mass  # fmt: skip


@pytest.mark.parametrize("complexity", [1, 2, 3])
def test_self_similar_d_bars_have_the_masses_that_are_published(complexity):
    angle = np.radians(8)
    epsilon = ALUMINIUM.density / ALUMINIUM.yield_stress * LOAD * SPAN / one_bar()
    bars = (2 * np.cos(angle) ** 5) ** (-complexity / 2)
    strings = epsilon * (np.cos(angle) ** (-2 * complexity) - 1)
    mass = pressed_mass(nested(complexity, angle))
    assert mass / one_bar() == pytest.approx(bars + strings, rel=1e-9)


def test_a_t_bar_has_half_the_mass_of_a_bar():
    """Without prestress, its crossing bar and its strings bear nothing, and halves buckle late."""
    nodes = [[0.0, SPAN, SPAN / 2, SPAN / 2, SPAN / 2], [0.0, 0.0, 0.0, 0.2, -0.2]]
    structure = tc.Structure(nodes, [(0, 2), (2, 1), (2, 3), (2, 4)],
                             [(0, 3), (3, 1), (1, 4), (4, 0)], bar_mass=1.0)  # fmt: skip
    mass = pressed_mass(structure, least_radius=1e-6)
    assert mass / one_bar() == pytest.approx(0.5, rel=1e-6)
