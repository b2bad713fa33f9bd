"""The filter at work: delay, losses, refusals, large motions, starts anew."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.plant.linear_plant import acceleration_response
from tests.estimation.conftest import EVERY, STEP

NAN, INF = float("nan"), float("inf")


def test_process_noise_is_that_of_tensions_with_independent_errors(by_force, sensors_of):
    """Errors of 5 % in each tension, drawn at random, give the unknown acceleration."""
    sensors = sensors_of("node_position")
    estimator = tc.KalmanFilter(by_force, sensors, sample_time=STEP, process_noise=0.05)
    plant, noise = estimator.plant, estimator._design.process_covariance
    error = 0.05 * np.random.default_rng(4).normal(size=(len(plant.force_density), 20_000))
    accelerations = plant.B[plant.degrees_of_freedom :] @ (plant.force_density[:, None] * error)
    driven = acceleration_response(plant, STEP)
    variance = np.trace(noise) / np.trace(driven @ driven.T)
    assert np.mean(accelerations**2) == pytest.approx(variance, rel=0.02)


@pytest.fixture(scope="module")
def motion(model, rest):
    """A free motion of the prism with held rest lengths, sampled, and its readings' source."""
    plant = tc.linearize(model, rest, input="rest_length")
    start = plant.to_nodes(0.01 * np.random.default_rng(2).normal(size=9))
    run = tc.simulate(
        model, 4.0, start, rest_length=plant.rest_length, tolerance=1e-10, output_step=STEP,
        error="none",
    )  # fmt: skip
    np.testing.assert_allclose(run.time, STEP * np.arange(201), rtol=0, atol=1e-9)
    return run


def readings(sensors, run, k):
    length = run.structure.string_length(run.nodes[:, :, k])
    tension = run.force_density[:, k] * length
    return sensors.measure(run.nodes[:, :, k], tension, run.velocities[:, :, k])


def follow(estimator, run, count, disturb=lambda k, y: y):
    """Run the filter beside a motion and return its estimates."""
    estimates = []
    delay = estimator.sensors.delay
    for k in range(count):
        y = readings(estimator.sensors, run, k - delay) if k >= delay else None
        estimates.append(estimator.update(disturb(k, y)))
        estimator.predict(run.rest_length[:, k])
    return estimates


def off(estimate, run, k):
    """Largest distance of an estimated node from where it is, and speed, in the world."""
    return (
        np.linalg.norm(estimate.nodes - run.nodes[:, :, k], axis=0).max(),
        np.linalg.norm(estimate.velocities - run.velocities[:, :, k], axis=0).max(),
    )


def test_without_noise_the_nonlinear_estimate_becomes_the_motion(held, sensors_of, motion):
    sensors = sensors_of(*EVERY, delay=3)
    estimator = tc.KalmanFilter(held, sensors, sample_time=STEP, prediction="nonlinear")
    estimates = follow(estimator, motion, 201)
    first = off(estimates[0], motion, 0)[0]
    last = max(off(estimates[k], motion, k)[0] for k in (170, 200))
    assert first < 0.1
    assert last < 2e-6
    assert off(estimates[200], motion, 200)[1] < 2e-5
    # A linear prediction is off by what it leaves out.
    linear = follow(tc.KalmanFilter(held, sensors, sample_time=STEP), motion, 201)
    assert off(linear[200], motion, 200)[0] > 10 * last


def test_a_delayed_estimate_is_the_prediction_of_the_undelayed_one(held, sensors_of, motion):
    delay = 4
    prompt = tc.KalmanFilter(held, sensors_of(*EVERY), sample_time=STEP)
    late = tc.KalmanFilter(held, sensors_of(*EVERY, delay=delay), sample_time=STEP)
    early, later = follow(prompt, motion, 60), follow(late, motion, 60)
    F, G, d = prompt.plant.discretize(STEP)
    assert [each.status for each in later[:5]] == ["waiting"] * 4 + ["partly used"]
    for k in range(delay, 60):
        z = early[k - delay].state
        for i in range(k - delay, k):
            z = F @ z + G @ (motion.rest_length[:, i] - held.rest_length) + d
        np.testing.assert_allclose(later[k].state, z, rtol=0, atol=1e-13)
    # What is farther from its readings is less sure.
    assert (later[-1].node_deviation > early[-1].node_deviation).all()


@pytest.mark.parametrize(
    ("spoil", "status", "delay"),
    [
        (lambda y: None, "lost", 2),
        (lambda y: np.full_like(y, NAN), "lost", 0),
        (lambda y: np.full_like(y, INF), "refused", 2),
        (lambda y: np.full_like(y, -INF), "refused", 0),
        (lambda y: y + 1e6, "refused", 2),
        (lambda y: np.full_like(y, 1e308), "refused", 0),
        (lambda y: np.where(np.arange(len(y)) % 2, NAN, INF), "refused", 2),
    ],
    ids=["none", "nan", "inf", "-inf", "far", "overflow", "mixed"],
)
def test_a_bad_measurement_is_a_prediction_bit_for_bit(
    held, sensors_of, motion, spoil, status, delay
):
    one, other = (
        tc.KalmanFilter(held, sensors_of(*EVERY, delay=delay), sample_time=STEP) for _ in range(2)
    )
    bad = follow(one, motion, 24, lambda k, y: spoil(y) if k == 20 else y)
    gap = follow(other, motion, 24, lambda k, y: None if k == 20 else y)
    assert bad[20].status == status
    assert gap[20].status == "lost"
    for k in range(24):
        np.testing.assert_array_equal(bad[k].state, gap[k].state)
        np.testing.assert_array_equal(bad[k].covariance, gap[k].covariance)
        assert np.isfinite(bad[k].state).all()


@pytest.mark.parametrize("bad", [INF, NAN, 5.0, 1e300])
def test_a_bad_reading_leaves_the_others_in_use(held, sensors_of, motion, bad):
    # One number of a node's position: the others of that node go with it.
    def spoil(k, y, value):
        if k == 20:
            y[4] = value
        return y

    one, other = (tc.KalmanFilter(held, sensors_of(*EVERY), sample_time=STEP) for _ in range(2))
    spoilt = follow(one, motion, 24, lambda k, y: spoil(k, y, bad))
    without = follow(other, motion, 24, lambda k, y: spoil(k, y, NAN))
    assert spoilt[20].status == "partly used"
    for one_of, other_of in zip(spoilt, without, strict=True):
        np.testing.assert_array_equal(one_of.state, other_of.state)
    found = one.statistics
    assert found.degrees_of_freedom[20] == len(one.sensors.noise) - 3
    what = {INF: found.not_finite, NAN: found.lost}.get(bad, found.refused)
    if np.isnan(bad):
        what = found.lost
    assert what[1] == 1
    assert found.used[1] == 23
    assert found.refused.sum() + found.not_finite.sum() == (0 if np.isnan(bad) else 1)


def test_a_sensor_that_sticks_is_refused_for_good(held, sensors_of, motion):
    def stick(k, y):
        y[7] += 0.3
        return y

    estimator = tc.KalmanFilter(held, sensors_of(*EVERY), sample_time=STEP, prediction="nonlinear")
    estimates = follow(estimator, motion, 100, stick)
    found = estimator.statistics
    # Once the start is forgotten; the reading of node 2 never comes in again.
    assert found.refused[2] >= 97
    assert found.restarts == 0
    assert off(estimates[99], motion, 99)[0] < 1e-4


@pytest.mark.parametrize("patience", [1, 5])
def test_a_filter_that_is_wrong_does_not_shut_out_good_readings(held, sensors_of, motion, patience):
    estimator = tc.KalmanFilter(
        held,
        sensors_of("node_position"),
        sample_time=STEP,
        prediction="nonlinear",
        patience=patience,
    )
    size = len(estimator.plant.A)
    wrong = np.r_[0.03 * np.random.default_rng(0).normal(size=size // 2), np.zeros(size // 2)]
    estimator.reset(state=wrong, covariance=1e-10 * np.eye(size))
    estimates = follow(estimator, motion, 100)
    found = estimator.statistics
    assert [each.status for each in estimates[: patience - 1]] == ["refused"] * (patience - 1)
    assert estimates[patience - 1].status == "started anew"
    assert 1 <= found.restarts <= 4
    assert estimates[99].status == "ok"
    assert off(estimates[99], motion, 99)[0] < 2e-3


def test_a_start_far_beyond_the_spread_is_found_all_the_same(held, sensors_of, motion):
    # The spread grows from one start anew to the next until the readings pass.
    estimator = tc.KalmanFilter(
        held,
        sensors_of("node_position"),
        sample_time=STEP,
        prediction="nonlinear",
        start_spread=1e-4,
    )
    estimator.reset(state=np.r_[0.08 * np.ones(15), np.zeros(15)])
    estimates = follow(estimator, motion, 120)
    assert 1 < estimator.statistics.restarts < 15
    assert off(estimates[119], motion, 119)[0] < 2e-3


def test_readings_that_never_agree_are_refused_without_end(held, sensors_of):
    estimator = tc.KalmanFilter(held, sensors_of("node_position"), sample_time=STEP, patience=1)
    y = -estimator.sensors.measure(held.nodes)
    for _ in range(400):  # a spread that grew each time would leave the range of numbers
        assert np.isfinite(estimator.update(y).covariance).all()
        estimator.predict(held.rest_length)
    assert estimator.statistics.restarts > 100


@pytest.mark.parametrize("kind", ["node_position", "string_length"])
def test_readings_may_be_as_good_as_round_off(held, sensors_of, motion, kind):
    sensors = tc.Sensors(held.model.structure, **{kind: 1e-11})
    estimator = tc.KalmanFilter(held, sensors, sample_time=STEP, prediction="nonlinear")
    estimates = follow(estimator, motion, 50)
    assert {estimate.status for estimate in estimates} <= {"ok", "partly used"}
    lengths = (
        held.model.structure.string_length(N) for N in (estimates[49].nodes, motion.nodes[:, :, 49])
    )
    np.testing.assert_allclose(*lengths, rtol=1e-9)


def test_an_estimate_of_no_shape_starts_again_from_the_operating_point(held, sensors_of):
    estimator = tc.KalmanFilter(held, sensors_of("string_length"), sample_time=STEP)
    state = np.r_[np.zeros(9), 40.0 * np.ones(9)]  # so fast that bars turn over in a sample
    estimator.reset(state=state)
    assert estimator.update(None).status == "lost"
    estimator.predict(held.rest_length)
    estimate = estimator.update(None)
    assert estimate.status == "started anew"
    np.testing.assert_array_equal(estimate.state, 0.0)
    assert estimator.statistics.restarts == 1
    assert estimator.statistics.status_count == {"lost": 1, "started anew": 1}


def test_a_known_start_stays_known_and_an_unknown_one_is_given_up(held, sensors_of, motion):
    estimator = tc.KalmanFilter(held, sensors_of("string_length"), sample_time=STEP)
    estimator.reset(covariance=np.zeros((18, 18)))
    estimate = estimator.update(readings(estimator.sensors, motion, 0) * np.nan)
    np.testing.assert_array_equal(estimate.covariance, 0.0)
    y = estimator.sensors.measure(held.nodes)
    assert estimator.update(y).status == "ok"
    np.testing.assert_array_equal(estimator.update(y).covariance, 0.0)
    estimator.reset(covariance=1e20 * np.eye(18))
    estimator.predict(held.rest_length)
    assert estimator.update(None).covariance.max() < 1e3
    assert estimator.statistics.restarts == 1


def test_the_filter_starts_where_it_is_told(held, sensors_of, motion):
    start = motion.nodes[:, :, 0]
    estimator = tc.KalmanFilter(held, sensors_of("node_position"), sample_time=STEP, start=start)
    np.testing.assert_allclose(estimator.update(None).nodes, start, rtol=0, atol=1e-9)


def test_a_structure_that_travels_is_not_one_that_changes_its_shape(held, sensors_of, model):
    velocities = np.tile([[0.2], [-0.1], [0.05]], (1, 6))
    run = tc.simulate(
        model, 2.0, velocities=velocities, rest_length=held.rest_length, step=1e-3,
        output_step=STEP, error="none",
    )  # fmt: skip
    sensors = sensors_of("node_position", scale=0.1)
    estimator = tc.KalmanFilter(held, sensors, sample_time=STEP)
    rng = np.random.default_rng(0)
    estimates = follow(estimator, run, 101, lambda k, y: sensors.disturb(y, rng))
    apart, speed = off(estimates[100], run, 100)
    assert np.linalg.norm(run.nodes[:, 0, 100] - run.nodes[:, 0, 0]) > 0.4
    assert apart < 1e-3
    assert speed < 0.05
    inner = held.measure(estimates[100].nodes, estimates[100].velocities)
    assert np.abs(inner[:9]).max() < 1e-3
    assert set(estimator.statistics.status_count) == {"ok"}


def test_velocities_and_nodes_of_an_estimate_are_those_bars_can_have(held, sensors_of, motion):
    estimate = follow(tc.KalmanFilter(held, sensors_of(*EVERY), sample_time=STEP), motion, 30)[-1]
    structure = motion.structure
    bars, rates = (structure.bar_vectors(part) for part in (estimate.nodes, estimate.velocities))
    length = np.linalg.norm(bars, axis=0)
    np.testing.assert_allclose(length, structure.bar_length, rtol=1e-13)
    assert np.abs((bars * rates).sum(axis=0)).max() < 1e-12


def test_reset_forgets(held, sensors_of, motion):
    estimator = tc.KalmanFilter(held, sensors_of(*EVERY, delay=1), sample_time=STEP)
    first = follow(estimator, motion, 20)
    estimator.reset()
    assert estimator.statistics.status_count == {}
    again = follow(estimator, motion, 20)
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.state, other.state)
        np.testing.assert_array_equal(one.covariance, other.covariance)
