"""The smoother over a log, against all readings at once."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.estimation.conftest import STEP


@pytest.fixture(scope="module")
def small_scene(held):
    """A filter of so little noise that readings are linear, with a log of its own plant."""
    small = 1e-4
    sensors = tc.Sensors(
        structure=held.model.structure, string_length=1e-3 * small,
        bar_direction=0.01 * small, bars=[1], bar_inclination=0.01 * small,
        gyroscope=0.02 * small, gyroscope_bars=[0], bias={"gyroscope": (0.1 * small, 0.03 * small)},
    )  # fmt: skip
    estimator = tc.KalmanFilter(
        held, sensors, sample_time=STEP, process_noise=0.02 * small, start_spread=0.1 * small**2,
        gate=1e-12,
    )  # fmt: skip
    design, rng, samples = estimator._design, np.random.default_rng(3), 12
    F, C, R = design.sampled.transition, estimator.C, sensors.noise
    still = np.array(design.outputs(np.zeros(len(F)), held.rest_length)[0]).ravel()
    z = np.sqrt(np.diag(design.start_covariance)) * rng.normal(size=len(F))
    root, readings = np.linalg.cholesky(design.process_covariance + 1e-26 * np.eye(len(F))), []
    for _ in range(samples):
        readings.append(still + C @ z + R * rng.normal(size=len(R)))
        z = F @ z + root @ rng.normal(size=len(F))
    return estimator, np.array(readings).T, still


def test_it_is_the_least_squares_of_the_whole_log(held, small_scene):
    """States at all samples, by noise of the process and readings at once."""
    estimator, log, still = small_scene
    design = estimator._design
    F, C, R = design.sampled.transition, estimator.C, estimator.sensors.noise
    s, samples = len(F), log.shape[1]
    # Noise at the start and of each sample is the unknown: states follow from it.
    values, vectors = np.linalg.eigh(design.process_covariance)
    drive = (vectors * np.sqrt(np.maximum(values, 0)))[:, values > 1e-14 * values.max()]
    width = s + drive.shape[1] * (samples - 1)
    by_noise = [np.hstack([np.sqrt(design.start_covariance), np.zeros((s, width - s))])]
    for k in range(samples - 1):
        following = F @ by_noise[-1]
        first = s + k * drive.shape[1]
        following[:, first : first + drive.shape[1]] += drive
        by_noise.append(following)
    rows = np.vstack([C @ each / R[:, None] for each in by_noise])
    right = ((log - still[:, None]) / R[:, None]).T.ravel()
    normal = np.vstack([rows, np.eye(width)])
    noise = np.linalg.lstsq(normal, np.r_[right, np.zeros(width)], rcond=None)[0]
    covariance = np.linalg.inv(normal.T @ normal)
    found = estimator.smooth(log, np.tile(held.rest_length[:, None], samples))
    wanted = np.array([each @ noise for each in by_noise]).T
    # What is left is the curvature of the readings.
    size = np.abs(wanted).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found.state / size, wanted / size, rtol=0, atol=1e-2)
    for k, each in enumerate(by_noise):
        P = each @ covariance @ each.T
        size = np.sqrt(np.diag(P))
        assert np.abs((found.covariance[k] - P) / np.outer(size, size)).max() < 1e-2


def test_smoothed_covariances_are_no_larger_than_filtered_ones(small_scene, held):
    estimator, log, _ = small_scene
    found = estimator.smooth(log, np.tile(held.rest_length[:, None], log.shape[1]))
    size = np.sqrt(np.diag(estimator._design.start_covariance))
    for P, filtered in zip(found.covariance, found.filtered_covariance, strict=True):
        assert np.linalg.eigvalsh((filtered - P) / np.outer(size, size)).min() > -1e-10
    assert (found.node_deviation <= found.filtered_node_deviation * (1 + 1e-9)).all()
    np.testing.assert_array_equal(found.state[:, -1], found.filtered_state[:, -1])
    assert (found.bias_deviation[:, 0] <= estimator.sensors.bias_deviation).all()


def test_a_recursion_on_a_linear_problem_is_the_batch_solution():
    from scipy.linalg import block_diag

    from tenscontrol.estimation.smoother import Pass, smoothed

    rng = np.random.default_rng(0)
    s, m, count = 4, 2, 15
    F, C = 0.5 * rng.normal(size=(s, s)), rng.normal(size=(m, s))
    Q, R, P0 = np.diag([0.1, 0.2, 0.3, 0.4]), np.diag([0.5, 0.2]), 2.0 * np.eye(s)
    y = rng.normal(size=(count, m))
    passes, z, P = [], np.zeros(s), P0
    for each in y:
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        z, P = z + K @ (each - C @ z), P - K @ C @ P
        following = F @ z, F @ P @ F.T + Q
        passes.append(Pass(z, P, *following, F))
        z, P = following
    steps = np.eye(s * count) - np.kron(np.eye(count, k=-1), F)
    noise = block_diag(P0, *[Q] * (count - 1))
    observed = np.kron(np.eye(count), C)
    information = steps.T @ np.linalg.inv(noise) @ steps
    weighed = observed.T @ np.kron(np.eye(count), np.linalg.inv(R))
    whole = np.linalg.inv(information + weighed @ observed)
    batch = (whole @ weighed @ y.ravel()).reshape(count, s)
    for k, (z, P) in enumerate(smoothed(passes)):
        np.testing.assert_allclose(z, batch[k], rtol=0, atol=1e-9)
        part = slice(k * s, k * s + s)
        np.testing.assert_allclose(P, whole[part, part], rtol=0, atol=1e-9)


def test_a_log_of_a_loop_is_smoothed_with_its_delay_and_losses(held, model, sensors_of):
    sensors = sensors_of("string_length", "bar_direction", delay=2, drop_rate=0.1)
    estimator = tc.KalmanFilter(held, sensors, sample_time=STEP, prediction="nonlinear")
    controller = tc.LQR(held, *tc.energy_weights(held), sample_time=STEP)
    start = held.to_nodes(0.02 * np.eye(9)[0])
    run = tc.simulate(
        model, 2.0, start, controller=controller, estimator=estimator, seed=2, step=1e-3,
        rest_length=held.rest_length, output_step=STEP, error="none",
    )  # fmt: skip
    record, count = run.control.estimate, len(run.control.time)
    before = estimator.statistics.used.copy()
    found = estimator.smooth(record.measurement, run.control.applied, previous=held.rest_length)
    np.testing.assert_array_equal(estimator.statistics.used, before)

    def error(nodes):
        inner = [held.coordinates.laid_over(nodes[..., k], 0 * start)[0] for k in range(count)]
        truth = [held.coordinates.laid_over(run.nodes[..., k], 0 * start)[0] for k in range(count)]
        return np.linalg.norm(np.array(inner) - np.array(truth), axis=1).mean()

    assert error(found.nodes) < 0.6 * error(record.nodes)


@pytest.mark.parametrize(
    ("readings", "held_shape", "message"),
    [((3, 5), (9, 5), "readings has shape"), ((9,), (9, 5), "readings has shape"),
     ((9, 5), (9, 4), "held has shape")],
)  # fmt: skip
def test_a_log_that_does_not_fit_is_refused(held, sensors_of, readings, held_shape, message):
    estimator = tc.KalmanFilter(held, sensors_of("string_length"), sample_time=STEP)
    with pytest.raises(ValueError, match=message):
        estimator.smooth(np.ones(readings), np.ones(held_shape))
