"""String laws: tension by hand, slackness, damping, and the inverse map."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, strategies as st

import tenscontrol as tc
from tenscontrol.dynamics.machine_code import compiler
from tests.dynamics.scenes import any_motion, random_structure

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")

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


@dataclass(frozen=True, eq=False)
class GreenStrings(tc.dynamics.StringLaw):
    """A law of a user: tension by Green's strain, ``T = k l ((l/l0)² − 1)/2``."""

    stiffness: np.ndarray
    damping: np.ndarray = 0.0

    def tension(self, length, rest_length):
        return self.stiffness * length * ((length / rest_length) ** 2 - 1) / 2

    def taut_rest_length(self, length, force_density):
        return length / ca.sqrt(1 + 2 * force_density / self.stiffness)

    def stored_energy(self, length, rest_length):
        strain = ca.fmax(0, (length / rest_length) ** 2 - 1) / 2
        return self.stiffness * rest_length**2 * strain**2 / 2

    @property
    def largest_force_density(self):
        return np.full(np.shape(self.stiffness), np.inf)


@pytest.mark.parametrize("damping", [0.0, 0.4])
@pytest.mark.parametrize("form", ["mapped", pytest.param("loops", marks=needs_compiler)])
def test_a_law_of_your_own_works_in_every_form(form, damping):
    prism = tc.prism()
    law = GreenStrings(np.linspace(50.0, 90.0, 9), damping)
    lengths = law.rest_length(prism.string_length(prism.nodes), 12.0)
    model = tc.Model(prism, strings=law)
    np.testing.assert_allclose(law.force_density(prism.string_length(prism.nodes), lengths), 12.0)
    rng = np.random.default_rng(0)
    x = np.concatenate([prism.nodes.T.ravel(), np.zeros(18)]) + 0.05 * rng.normal(size=36)
    taut = (np.arange(9) % 3 > 0).astype(float)
    flat, other = (model.equation("rest_length", form=each) for each in ("flat", form))
    for name, arguments in (("slope", (x, lengths, taut)), ("gap", (x, lengths))):
        one, two = (getattr(each, name)(*arguments) for each in (flat, other))
        np.testing.assert_allclose(np.array(one), np.array(two), rtol=1e-12, atol=1e-12)


def test_energy_stays_under_a_law_of_your_own():
    """Also checks the energy against the tension."""
    prism = tc.prism()
    law = GreenStrings(100.0)
    lengths = 0.8 * prism.string_length(prism.nodes)
    run = tc.simulate(tc.Model(prism, strings=law), 0.5, rest_length=lengths, tolerance=1e-10)
    assert run.kinetic_energy.max() > 0.1
    np.testing.assert_allclose(run.energy, run.energy[0], rtol=1e-7)


@dataclass(frozen=True, eq=False)
class WithoutField(tc.dynamics.StringLaw):
    stiffness: float

    damping = 0.0
    tension = GreenStrings.tension
    taut_rest_length = GreenStrings.taut_rest_length
    stored_energy = GreenStrings.stored_energy
    largest_force_density = GreenStrings.largest_force_density


def test_a_law_without_damping_is_refused_with_what_to_do():
    with pytest.raises(TypeError, match=r"no parameter 'damping'.*0\.0 for none"):
        WithoutField(1.0)
