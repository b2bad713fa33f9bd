"""String laws: tension by hand, slackness, damping, and the inverse map."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tenscontrol as tc
from tests.dynamics.scenes import any_motion, random_structure

lengths = st.floats(0.01, 100.0)
fractions = st.floats(0.01, 0.999)
stiffnesses = st.floats(1.0, 1e6)


@given(length=lengths, stretch=st.floats(1e-3, 0.9), k=stiffnesses)
def test_constant_stiffness_pulls_in_proportion_to_the_stretch(length, stretch, k):
    rest_length = length * (1 - stretch)
    tension = tc.LinearStrings(k).force_density(length, rest_length) * length
    assert tension == pytest.approx(k * (length - rest_length), rel=1e-11)


@given(length=lengths, stretch=st.floats(1e-3, 0.9), rigidity=stiffnesses)
def test_constant_rigidity_pulls_in_proportion_to_the_strain(length, stretch, rigidity):
    rest_length = length * (1 - stretch)
    tension = tc.ElasticStrings(rigidity).force_density(length, rest_length) * length
    assert tension == pytest.approx(rigidity * (length - rest_length) / rest_length, rel=1e-11)


@pytest.mark.parametrize("law", [tc.LinearStrings(50.0, 3.0), tc.ElasticStrings(50.0, 3.0)])
@given(length=lengths, longer=st.floats(1.0, 10.0), rate=st.floats(-100.0, 100.0))
def test_a_slack_string_never_pulls(law, length, longer, rate):
    assert law.force_density(length, length * longer, rate) == 0.0


@pytest.mark.parametrize("law", [tc.LinearStrings(50.0, 3.0), tc.ElasticStrings(50.0, 3.0)])
@given(length=lengths, fraction=fractions, rate=st.floats(-1e4, 1e4))
def test_a_string_never_pushes_and_damping_adds_in_proportion_to_the_rate(
    law, length, fraction, rate
):
    rest_length = length * fraction
    still = law.force_density(length, rest_length) * length
    moving = law.force_density(length, rest_length, rate) * length
    assert moving == pytest.approx(max(0.0, still + 3.0 * rate), rel=1e-12, abs=1e-9)


def test_damping_starts_with_a_jump_where_a_string_goes_taut():
    law = tc.LinearStrings(stiffness=100.0, damping=2.0)
    just_slack, just_taut = (law.force_density(1.0, 1.0 + gap, 0.5) for gap in (1e-9, -1e-9))
    assert just_slack == 0.0
    assert just_taut == pytest.approx(2.0 * 0.5, rel=1e-6)


@pytest.mark.parametrize("law", [tc.LinearStrings([50.0, 80.0]), tc.ElasticStrings([50.0, 80.0])])
def test_each_string_has_its_own_parameters(law):
    together = law.force_density([1.0, 1.0], 0.8)
    alone = [type(law)(k).force_density(1.0, 0.8) for k in (50.0, 80.0)]
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize("damping", [0.0, 2.0])
@pytest.mark.parametrize("kind", [tc.LinearStrings, tc.ElasticStrings])
@pytest.mark.parametrize("seed", range(3))
def test_the_model_applies_the_law_to_its_strings(kind, damping, seed):
    structure = random_structure(seed, bars=3, points=2)
    count = len(structure.strings)
    law = kind(np.linspace(50.0, 200.0, count), damping)
    N, V = any_motion(structure, seed)
    S = structure.string_vectors(N)
    length = np.sqrt((S * S).sum(axis=0))
    rate = (S * structure.string_vectors(V)).sum(axis=0) / length
    rest_length = length * np.random.default_rng(seed).uniform(0.6, 1.3, count)
    x = np.concatenate([N.T.ravel(), V.T.ravel()])
    model = tc.Model(structure, strings=law)
    found = np.array(model.string_force_density(x, rest_length)).ravel()
    expected = law.force_density(length, rest_length, rate)
    assert 0 < np.count_nonzero(expected) < count
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    by_length = np.array(model.rest_length_dynamics(x, rest_length))
    np.testing.assert_allclose(by_length, np.array(model.dynamics(x, expected)), rtol=1e-11)


def test_parameters_of_a_law_cannot_be_changed():
    law = tc.LinearStrings(stiffness=[100.0, 200.0])
    with pytest.raises(ValueError, match="read-only"):
        law.stiffness[0] = 1.0
