"""Drift over many steps, and whether it can be told from zero."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy.long_run import trend
from tests.accuracy.scenes import paper_case


def covers(make, slope, count=200):
    """How often the interval of a random series covers its true slope."""
    hits = 0
    for seed in range(count):
        found, half = trend(0.1, make(np.random.default_rng(seed)))
        hits += abs(found - slope) <= half
    return hits / count


def test_noise_about_a_line_is_covered():
    line = 0.3 * 0.1 * np.arange(2000)
    assert covers(lambda random: line + random.normal(size=2000), 0.3) >= 0.95


def test_a_random_walk_is_no_drift():
    share = covers(lambda random: random.normal(size=2000).cumsum(), 0.0)
    assert 0.92 < share < 1.0


def test_three_random_walks_are_none_either():
    share = covers(lambda random: random.normal(size=(3, 2000)).cumsum(axis=1), 0.0)
    assert 0.92 < share < 1.0


def test_an_oscillation_is_no_drift_and_a_bent_rise_is_one():
    time = 0.1 * np.arange(2000)
    slope, half = trend(0.1, np.sin(time))
    assert abs(slope) <= half
    slope, half = trend(0.1, time**1.5)
    assert slope > half


def test_the_slope_of_a_line_is_exact():
    slope, half = trend(0.5, 2.0 + 3.0 * 0.5 * np.arange(100))
    assert slope == pytest.approx(3.0)
    assert half < 1e-10
    assert trend(0.5, np.zeros(100)) == (0.0, 0.0)


def test_runge_kutta_loses_energy_and_energy_momentum_does_not():
    case = paper_case(1.0, vertical=45.0)
    lossy = tc.long_run(case, "rk4", 5e-3, steps=20_000)
    exact = tc.long_run(case, "energy_momentum", 2e-2, steps=1000)
    assert not lossy.of("energy").is_zero
    assert lossy.of("energy").slope < 0
    assert exact.of("energy").largest < 1e-11 * exact.energy_scale
    assert exact.of("bar length").largest < 1e-13
    assert exact.of("momentum").largest < 1e-11
    assert lossy.work.steps == 20_000
    assert "drifts" in lossy.table()


def test_parts_make_the_same_motion_as_a_whole():
    case = paper_case(0.5)
    found = tc.long_run(case, "rk4", 1e-3, steps=500, outputs=125)
    run = tc.simulate(case.model, 0.5, rest_length=case.input_value, method="rk4", step=1e-3)
    np.testing.assert_allclose(found.time, run.time[4::4], rtol=1e-12)
    np.testing.assert_allclose(
        found.of("energy").error, (run.energy - run.energy[0])[4::4], atol=1e-9
    )
    stretch = np.abs(run.bar_length_error[:, 4::4]).max(axis=0)
    np.testing.assert_allclose(found.of("bar length").error, stretch, atol=1e-9)


def test_what_is_not_conserved_is_left_out():
    damped = tc.long_run(paper_case(1.0, damping=1.0), "rk4", 1e-3, steps=100, outputs=50)
    assert [drift.name for drift in damped.drifts] == ["momentum", "angular momentum", "bar length"]
    with pytest.raises(ValueError, match="name is 'energy', expected one of"):
        damped.of("energy")
    hung = tc.Model(tc.prism(), gravity=9.81)
    case = tc.Scene(hung, 1.0, force_density=20.0)
    falling = tc.long_run(case, "rk4", 1e-3, steps=100, outputs=50)
    assert [drift.name for drift in falling.drifts] == ["energy", "bar length"]
    assert falling.of("energy").largest < 1e-4


def test_a_method_with_own_steps():
    found = tc.long_run(paper_case(1.0, vertical=45.0), "dop853", 1e-10, steps=200, outputs=50)
    assert found.of("energy").largest < 1e-7


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "leap"}, "method is 'leap'"),
        ({"setting": -1.0}, "setting is -1.0"),
        ({"steps": 1}, "steps is 1"),
        ({"outputs": 5}, "outputs is 5"),
    ],
)
def test_bad_input_is_named(options, message):
    given = {"method": "rk4", "setting": 1e-3, "steps": 100}
    with pytest.raises(ValueError, match=message):
        tc.long_run(paper_case(1.0), **given | options)


def test_a_step_that_is_far_too_long_is_told():
    with pytest.raises(ValueError, match="rk4 ends too early to judge"):
        tc.long_run(paper_case(1.0), "rk4", 10.0, steps=100, outputs=50)


def test_a_motion_beyond_what_can_be_squared_is_not_judged():
    with pytest.raises(ValueError, match=r"too early to judge: after 9 s the motion runs away"):
        tc.long_run(paper_case(1.0), "rk4", 0.6, steps=30, outputs=30)
