"""Inputs that tell more: within the limits of winches, and with narrower intervals of a fit."""

import numpy as np
import pytest

import tenscontrol as tc

PRISM = tc.prism()
TIMES = np.linspace(0.02, 0.3, 15)
HELD = 0.95 * PRISM.string_length()
WINCHES = tc.Winches(rate=0.3, shortest=0.9 * HELD, longest=1.03 * HELD)
SENSORS = tc.Sensors(structure=PRISM, string_length=1e-3)


def log_of(damping, rest_length, seed=None):
    """What sensors read of a prism that is damped so."""
    model = tc.Model(PRISM, strings=tc.LinearStrings(100.0, damping=damping))
    run = tc.simulate(model, 0.3, rest_length=rest_length, output_step=0.02, error="none")
    return tc.Log.of_run(run, SENSORS, TIMES, seed=seed)


@pytest.fixture(scope="module")
def model():
    return tc.Model(PRISM, strings=tc.LinearStrings(100.0, damping=0.5))


@pytest.fixture(scope="module")
def plan(model):
    log = log_of(0.5, HELD)
    told = tc.identifiable(model, log, ["damping"], tolerance=1e-6, step=4e-3)
    return tc.exciting_input(told, WINCHES, parts=3, most_rollouts=15, seed=1)


def test_rest_lengths_keep_to_rate_and_range_and_begin_where_they_are(plan):
    lengths = plan.profile.values
    np.testing.assert_array_equal(lengths[:, 0], HELD)
    rate = np.diff(lengths) / np.diff(plan.profile.time)
    assert 0.29 < np.abs(rate).max() < 0.3 + 1e-12
    assert (lengths >= WINCHES.shortest[:, None] - 1e-12).all()
    assert (lengths <= WINCHES.longest[:, None] + 1e-12).all()


def test_the_determinant_is_that_of_the_information_and_only_grows(plan):
    assert len(plan.log_determinant) <= 15
    assert (np.diff(plan.log_determinant) >= 0).all()
    for value, told in ((0, plan.before), (-1, plan.after)):
        wanted = np.log(1 + told.singular**2).sum()
        assert plan.log_determinant[value] == pytest.approx(wanted, rel=1e-9)
    information = (plan.after.directions.T * (1 + plan.after.singular**2)) @ plan.after.directions
    covariance = np.linalg.inv(information)
    np.testing.assert_allclose(plan.after.deviation, np.sqrt(np.diag(covariance)), rtol=1e-9)
    assert plan.table().count("damping") == 9


def test_a_fit_has_intervals_of_what_was_not_told_before(model, plan):
    true = 0.5 * np.exp(0.2 * np.random.default_rng(4).normal(size=9))
    before, after = (
        tc.fit(model, log_of(true, rest_length, seed=2), ["damping"], step=4e-3)
        for rest_length in (HELD, plan.profile)
    )
    assert np.isnan(before.interval).all()
    reach = np.diff(np.log(after.interval), axis=1)[:, 0] / 2
    assert (np.abs(np.log(after.value * 0.5 / true)) < 1.5 * reach).all()
    assert reach.max() < 0.6


def test_what_cannot_be_planned_is_refused(model):
    log = log_of(0.5, HELD)
    told = tc.identifiable(model, log, ["damping"], step=0.02)
    with pytest.raises(ValueError, match="winches have no rate"):
        tc.exciting_input(told, tc.Winches())
    held = tc.Log([0.1], np.ones((1, 9)), SENSORS, force_density=np.full(9, 10.0))
    of_held = tc.identifiable(model, held, ["bar_mass"], step=0.02)
    with pytest.raises(ValueError, match="log holds force_density"):
        tc.exciting_input(of_held, WINCHES)
    several = tc.identifiable(model, [log, log], ["damping"], step=0.02)
    with pytest.raises(ValueError, match="told is of 2 logs"):
        tc.exciting_input(several, WINCHES)
    with pytest.raises(TypeError, match="told is a Model"):
        tc.exciting_input(model, WINCHES)
