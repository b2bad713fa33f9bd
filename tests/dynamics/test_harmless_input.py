"""Models of structures that lack something: laws, loads, ground and supports that do nothing."""

import numpy as np
import pytest

import tenscontrol as tc

PRISM = tc.prism()
GAMMA = tc.prestress(PRISM, 17.3205).force_density


def bar(**changes):
    return tc.Structure([[0, 1], [0, 0], [0, 0]], [(0, 1)], [], 1.0, **changes)


def last(model, **given):
    return tc.simulate(model, 0.1, force_density=GAMMA, step=1e-3, **given).nodes[:, :, -1]


@pytest.mark.parametrize("stiffness", [100.0, []])
def test_a_law_of_strings_where_there_are_none_does_nothing(stiffness):
    model = tc.Model(bar(), tc.LinearStrings(stiffness))
    assert model.strings.stiffness.shape == (0,)
    assert model.state_equation("rest_length").size_in(1) == (0, 1)


def test_a_law_answers_for_no_strings():
    law = tc.LinearStrings(100.0)
    assert law.force_density([], 1.0).shape == (0,)
    assert law.rest_length([], []).shape == (0,)


def test_no_damping_and_no_friction_may_be_none():
    assert tc.LinearStrings(100.0, damping=None).damping == 0
    assert tc.ElasticStrings(100.0, None).damping == 0
    ground = tc.Ground(1e3, damping=None, friction=None)
    assert (ground.damping, ground.friction) == (0.0, 0.0)


def test_a_column_of_stiffness_is_one_a_string():
    stiffness = np.arange(1.0, 10.0)
    law = tc.LinearStrings(stiffness[:, None], damping=stiffness[:, None])
    np.testing.assert_array_equal(law.stiffness, stiffness)
    np.testing.assert_array_equal(law.damping, stiffness)


def test_a_load_of_zero_may_be_one_number():
    for load in (0, 0.0, np.zeros((3, 6)), None, False):
        assert not tc.Model(PRISM, external_force=load).constant_force.any()
    with pytest.raises(ValueError, match=r"external_force has shape \(\), expected \(3, 6\)"):
        tc.Model(PRISM, external_force=1.0)


def test_ground_of_no_nodes_holds_nothing():
    free = last(tc.Model(PRISM, gravity=9.81))
    for ground in (tc.Ground(1e4, nodes=[]), tc.Ground(1e4, nodes=np.zeros(6, bool)), [], ()):
        model = tc.Model(PRISM, gravity=9.81, ground=ground)
        np.testing.assert_allclose(last(model), free, atol=1e-12)


def test_ground_takes_nodes_as_any_collection_or_mask():
    known = last(tc.Model(PRISM, gravity=9.81, ground=tc.Ground(1e4, nodes=[3, 4])))
    for nodes in ({3, 4}, [4, 3, 4], np.isin(np.arange(6), [3, 4]), [[3], [4]]):
        model = tc.Model(PRISM, gravity=9.81, ground=tc.Ground(1e4, nodes=nodes))
        np.testing.assert_array_equal(last(model), known)
    one = tc.Ground(1e4, nodes=3)
    assert one.nodes.tolist() == [3]


def test_a_profile_takes_its_times_as_a_column():
    assert tc.Profile([[0.0], [1.0]], [2.0, 4.0]).at(0.5) == 3.0


def test_rates_may_be_a_column():
    plant = tc.linearize(tc.Model(PRISM), tc.prestress(PRISM, 17.3205))
    rates = np.arange(9.0)
    np.testing.assert_array_equal(
        plant.coordinates.to_velocities(np.zeros(9), rates[:, None]),
        plant.coordinates.to_velocities(np.zeros(9), rates),
    )
