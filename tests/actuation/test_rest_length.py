"""From force density to rest length and back: inverse of each other, slack said aloud."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import tenscontrol as tc
from tests.dynamics.scenes import random_structure

lengths = st.floats(0.01, 100.0)
stiffnesses = st.floats(1.0, 1e6)
LAWS = [tc.LinearStrings(120.0), tc.ElasticStrings(120.0)]
every_law = pytest.mark.parametrize("law", LAWS, ids=["linear", "elastic"])
seeds = st.integers(0, 10_000)


# ---- the laws themselves ----


@given(length=lengths, k=stiffnesses, fraction=st.floats(1e-6, 1 - 1e-6))
def test_constant_stiffness_round_trip(length, k, fraction):
    law = tc.LinearStrings(k)
    gamma = fraction * k
    rest_length = law.rest_length(length, gamma)
    assert 0 < rest_length < length
    # l0 = l (1 - γ/k): an error of round-off in l0 is one of k·eps in γ.
    assert law.force_density(length, rest_length) == pytest.approx(gamma, abs=1e-14 * k)


@given(length=lengths, rigidity=stiffnesses, gamma=st.floats(1e-6, 1e5))
def test_constant_rigidity_round_trip(length, rigidity, gamma):
    law = tc.ElasticStrings(rigidity)
    rest_length = law.rest_length(length, gamma)
    assert 0 < rest_length <= length
    scale = gamma + rigidity / length
    assert law.force_density(length, rest_length) == pytest.approx(gamma, abs=1e-14 * scale)


@every_law
@given(length=lengths, fraction=st.floats(0.01, 0.99))
def test_the_other_way_round(law, length, fraction):
    rest_length = fraction * length
    gamma = law.force_density(length, rest_length)
    assert law.rest_length(length, gamma) == pytest.approx(rest_length, rel=1e-12)


@every_law
@given(seed=seeds, count=st.integers(1, 12))
def test_arrays_are_mapped_entry_by_entry(law, seed, count):
    random = np.random.default_rng(seed)
    length, gamma = random.uniform(0.2, 3.0, count), random.uniform(0.0, 100.0, count)
    together = law.rest_length(length, gamma)
    assert together.shape == (count,)
    alone = [float(law.rest_length(one, g)) for one, g in zip(length, gamma, strict=True)]
    np.testing.assert_array_equal(together, alone)
    np.testing.assert_allclose(law.force_density(length, together), gamma, rtol=0, atol=1e-10)


@every_law
@given(length=lengths)
def test_zero_force_density_means_just_taut(law, length):
    assert law.rest_length(length, 0.0) == pytest.approx(length, rel=2.3e-16)
    assert law.force_density(length, length) == 0.0


@every_law
@given(length=lengths, first=st.floats(0, 119), second=st.floats(0, 119))
def test_more_force_density_never_takes_more_rest_length(law, length, first, second):
    less, more = sorted([first, second])
    assert law.rest_length(length, more) <= law.rest_length(length, less)


@given(k=stiffnesses, factor=st.floats(1.0, 10.0))
def test_force_densities_from_the_stiffness_upwards_are_refused(k, factor):
    with pytest.raises(ValueError, match="the rest length would not be positive"):
        tc.LinearStrings(k).rest_length(1.0, factor * k)


def test_constant_rigidity_reaches_every_force_density():
    assert tc.ElasticStrings(1.0).rest_length(1.0, 1e9) > 0


# ---- on a structure ----


@every_law
@given(seed=seeds)
def test_a_structure_s_round_trip(law, seed):
    structure = random_structure(seed % 20)
    model = tc.Model(structure, strings=law)
    random = np.random.default_rng(seed)
    nodes = random.normal(size=structure.nodes.shape)
    wanted = random.uniform(0.0, 100.0, len(structure.strings))
    found = tc.to_rest_length(model, nodes, wanted)
    back = tc.to_force_density(model, nodes, found.rest_length)
    np.testing.assert_allclose(back, wanted, rtol=0, atol=1e-9)


@every_law
def test_slack_strings_are_named(prism, law):
    model = tc.Model(prism, strings=law)
    gamma = np.full(9, 10.0)
    gamma[[2, 7]] = 0.0
    found = tc.to_rest_length(model, prism.nodes, gamma)
    np.testing.assert_array_equal(found.slack, [2, 7])
    np.testing.assert_array_equal(found.rest_length[[2, 7]], prism.string_length()[[2, 7]])


@every_law
def test_strings_longer_than_the_gap_give_no_force(prism, law):
    model = tc.Model(prism, strings=law)
    np.testing.assert_array_equal(
        tc.to_force_density(model, prism.nodes, 1.1 * prism.string_length()), 0.0
    )


@every_law
def test_the_rest_lengths_of_a_prestress_keep_the_structure_still(prism, rest, law):
    model = tc.Model(prism, strings=law)
    held = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    run = tc.simulate(model, 0.5, rest_length=held, step=1e-3)
    assert np.abs(run.nodes - prism.nodes[:, :, None]).max() < 1e-12


def test_one_number_serves_all_strings(prism):
    model = tc.Model(prism, strings=LAWS[0])
    one = tc.to_rest_length(model, prism.nodes, 20.0).rest_length
    each = tc.to_rest_length(model, prism.nodes, np.full(9, 20.0)).rest_length
    np.testing.assert_array_equal(one, each)


@pytest.mark.parametrize("law", [tc.LinearStrings(3.0), tc.ElasticStrings(3.0)])
def test_no_force_density_is_exactly_the_just_taut_length_and_counted_as_slack(prism, law):
    found = tc.to_rest_length(tc.Model(prism, strings=law), prism.nodes, 0.0)
    np.testing.assert_array_equal(found.rest_length, prism.string_length())
    np.testing.assert_array_equal(found.slack, np.arange(9))
