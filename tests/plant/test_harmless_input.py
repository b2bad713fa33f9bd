"""Plants of structures that lack something, and counts beyond what there is."""

import warnings

import numpy as np
import pytest

import tenscontrol as tc

PRISM = tc.prism()
LAW = tc.LinearStrings(100.0)
REST = tc.prestress(PRISM, 17.3205)
PLANT = tc.linearize(tc.Model(PRISM), REST)


def bar(**changes):
    return tc.Structure([[0, 1], [0, 0], [0, 0]], [(0, 1)], [], 1.0, **changes)


def test_a_structure_without_strings_has_a_prestress_of_none():
    for given in ({}, {"force_density": 17.0}, {"force_density": []}, {"min_force_density": 1.0}):
        rest = tc.prestress(bar(), **given)
        assert rest.force_density.shape == (0,)
        np.testing.assert_array_equal(rest.bar_force_density, [0.0])


def test_a_bar_under_opposite_loads_carries_them():
    pushed = tc.prestress(bar(), external_force=[[5.0, -5.0], [0, 0], [0, 0]])
    np.testing.assert_allclose(pushed.bar_force_density, 5.0)
    with pytest.raises(ValueError, match="unbalanced force"):
        tc.prestress(bar(), external_force=np.ones((3, 2)))


def test_loads_of_zero_balance():
    np.testing.assert_array_equal(
        tc.prestress(PRISM, 17.3205, external_force=0).force_density, REST.force_density
    )


def test_force_density_may_be_a_column_and_have_no_upper_limit():
    column = tc.prestress(PRISM, REST.force_density[:, None])
    np.testing.assert_array_equal(column.force_density, REST.force_density)
    for most in (np.inf, [np.inf] * 9, [np.inf] * 8 + [1e3]):
        high = tc.prestress(PRISM, 17.3205, max_force_density=most)
        np.testing.assert_allclose(high.force_density, REST.force_density, rtol=1e-6)


@pytest.mark.parametrize("law", [None, LAW])
def test_equilibrium_without_strings_needs_no_input(law):
    model = tc.Model(bar(fixed=[0]), law, gravity=9.81)
    rest = tc.equilibrium(model)
    np.testing.assert_allclose(rest.structure.nodes[:, 1], [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose(rest.bar_force_density, -9.81 / 2)


def test_settling_and_a_load_of_zero_change_nothing_in_the_air():
    model = tc.Model(PRISM, LAW)
    wound = tc.to_rest_length(model, PRISM.nodes, REST.force_density).rest_length
    rest = tc.equilibrium(model, rest_length=wound, settle=True, external_force=0)
    np.testing.assert_allclose(rest.structure.nodes, PRISM.nodes, atol=1e-9)


def test_some_slack_strings_are_no_reason_to_warn():
    cross = tc.Structure(
        [[0, 1, 0.5], [0, 0, -1]], [], [(0, 2), (2, 1), (0, 2)], [], 0.1, fixed=[0, 1]
    )
    model = tc.Model(cross, LAW, gravity=9.81)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rest = tc.equilibrium(model, rest_length=[1.0, 1.0, 5.0])
    assert rest.force_density[2] == 0
    assert (rest.force_density[:2] > 0).all()


@pytest.mark.parametrize("law", [None, LAW, tc.LinearStrings([])])
def test_a_lone_bar_has_a_plant_and_modes(law):
    model = tc.Model(bar(), law)
    kinds = ("force_density",) if law is None else ("force_density", "rest_length")
    for kind in kinds:
        inner = tc.linearize(model, tc.prestress(bar()), input=kind)
        whole = tc.linearize(model, tc.prestress(bar()), input=kind, coordinates="minimal")
        assert (inner.A.shape, inner.B.shape) == ((0, 0), (0, 0))
        assert (whole.A.shape, whole.B.shape) == ((10, 10), (10, 0))
        assert len(tc.modes(inner).frequency) == len(tc.modes(inner, 20).frequency) == 0
        np.testing.assert_array_equal(tc.modes(whole, 20).frequency, np.zeros(5))
        assert len(tc.controllability(inner, 20).pole) == 0
        assert tc.controllability(whole).unreachable == 10


def test_more_modes_than_there_are_means_all():
    np.testing.assert_array_equal(tc.modes(PLANT, 20).frequency, tc.modes(PLANT).frequency)
    assert len(tc.controllability(PLANT, 20).pole) == len(tc.controllability(PLANT).pole)
    assert tc.reduce(PLANT, 20).degrees_of_freedom == 9
    with pytest.raises(ValueError, match="count is 0"):
        tc.modes(PLANT, 0)


def test_modes_may_be_chosen_by_any_collection_or_mask():
    known = tc.reduce(PLANT, [1, 2]).A
    for chosen in ([1, 2, 1], {1, 2}, np.isin(np.arange(9), [1, 2]), [1.0, 2.0]):
        np.testing.assert_array_equal(tc.reduce(PLANT, chosen).A, known)
    for count in (2.0, np.array(2), np.int64(2)):
        np.testing.assert_array_equal(tc.reduce(PLANT, count).A, tc.reduce(PLANT, [0, 1]).A)


def test_an_operating_point_takes_a_column():
    at = tc.OperatingPoint(PRISM.nodes, REST.force_density[:, None])
    np.testing.assert_array_equal(tc.linearize(tc.Model(PRISM), at).A, PLANT.A)


def test_a_stance_takes_feet_as_any_collection_or_mask():
    model = tc.Model(PRISM, LAW, gravity=9.81, ground=tc.Ground(1e4))
    known = tc.plant.set_down(model, [3, 4, 5])
    for feet in ({3, 4, 5}, [3, 4, 5, 3], np.arange(6) > 2, [[3], [4], [5]]):
        np.testing.assert_allclose(tc.plant.set_down(model, feet), known, atol=1e-12)


def test_a_payload_on_a_foot_stays_in_the_model_of_the_stance():
    heavy = tc.Structure(
        PRISM.nodes, PRISM.bars, PRISM.strings, 1.0, point_mass=[0, 0, 0, 2.0, 0, 0]
    )
    model = tc.Model(heavy, tc.LinearStrings(1e3), gravity=9.81, ground=tc.Ground(1e5, friction=1))
    wound = tc.to_rest_length(model, PRISM.nodes, 5 * REST.force_density).rest_length
    plant = tc.linearize(model, tc.equilibrium(model, rest_length=wound), input="rest_length")
    standing = plant.model
    assert standing.structure.point_mass[3] == 2.0
    np.testing.assert_allclose(standing.constant_force, model.constant_force)


@pytest.mark.parametrize("most", [np.inf, [1.0] * 8 + [np.inf]])
def test_there_is_no_largest_prestress_without_a_limit(most):
    with pytest.raises(ValueError, match=r"max_force_density\[\d\] is inf, so that there are no"):
        tc.prestress(PRISM, max_force_density=most)
