"""The filter near the operating point: gain, statistics, separation."""

import numpy as np
import pytest
from scipy.special import chdtri

import tenscontrol as tc
from tests.estimation.conftest import EVERY, STEP


def still(estimator):
    """Readings at the operating point."""
    plant = estimator.plant
    law = plant.model.strings
    length = plant.model.structure.string_length(plant.nodes)
    gamma = plant.force_density
    if plant.input == "rest_length":
        gamma = law.force_density(length, plant.rest_length)
    return estimator.sensors.measure(plant.nodes, gamma * length, 0 * plant.nodes)


def recursion(estimator, pushes, count):
    """Covariance of predictions after so many samples, in information form."""
    F, _, _ = estimator.plant.discretize(STEP)
    information = estimator.C.T @ (estimator.C / estimator.sensors.noise[:, None] ** 2)
    P = np.eye(len(F))
    for _ in range(count):
        P = F @ np.linalg.inv(np.linalg.inv(P) + information) @ F.T + pushes
    return P


def noise_of(estimator, share=0.02):
    """Covariance of what unknown accelerations do in a sample, put together anew."""
    plant = estimator.plant
    structure, T = plant.model.structure, plant.basis
    pulls = []
    for (start, end), gamma in zip(structure.strings, plant.force_density, strict=True):
        force = np.zeros((3, 6))
        force[:, start] = gamma * (plant.nodes[:, end] - plant.nodes[:, start])
        force[:, end] -= force[:, start]
        pulls.append(T.T @ force.ravel(order="F"))
    size = share * np.sqrt(np.square(pulls).sum() / T.shape[1])
    # ∫ exp(A t) dt [0; 1] by Simpson's rule on many points.
    from scipy.linalg import expm

    r = T.shape[1]
    intervals = 40
    weights = np.r_[1, np.tile([4, 2], intervals // 2)[:-1], 1] * STEP / intervals / 3
    ends = [expm(plant.A * STEP * k / intervals)[:, r:] for k in range(intervals + 1)]
    push = size * np.tensordot(weights, ends, 1)
    return push @ push.T


@pytest.mark.parametrize(
    ("which", "kinds"),
    [("held", tuple(EVERY)), ("by_force", ("node_position",)), ("held", ("string_length",))],
)
def test_the_steady_gain_is_that_of_the_riccati_equation(request, which, kinds, sensors_of):
    estimator = tc.KalmanFilter(
        request.getfixturevalue(which), sensors_of(*kinds), sample_time=STEP
    )
    assert estimator.riccati_residual < 1e-11
    P = recursion(estimator, noise_of(estimator), 1000)
    size = np.sqrt(np.diag(P))
    off = (P - estimator.covariance) / np.outer(size, size)
    assert np.abs(off).max() < 1e-6
    C, R = estimator.C, np.diag(estimator.sensors.noise**2)
    gain = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    np.testing.assert_allclose(
        gain / size[:, None] * estimator.sensors.noise,
        estimator.gain / size[:, None] * estimator.sensors.noise,
        rtol=0, atol=1e-6,
    )  # fmt: skip
    F = estimator.plant.discretize(STEP)[0]
    own = np.linalg.eigvals(F - F @ estimator.gain @ C)
    np.testing.assert_allclose(
        np.sort(np.abs(own)), np.sort(np.abs(estimator.poles)), rtol=0, atol=1e-9
    )


def test_the_running_filter_settles_at_the_steady_one(held, sensors_of):
    estimator = tc.KalmanFilter(held, sensors_of(*EVERY), sample_time=STEP)
    y = still(estimator)
    for _ in range(300):
        estimator.update(y)
        estimator.predict(held.equilibrium_input)
    estimate = estimator.update(None)
    size = np.sqrt(np.diag(estimator.covariance))
    off = (estimate.covariance - estimator.covariance) / np.outer(size, size)
    assert np.abs(off).max() < 1e-8
    assert np.abs(estimate.state / size).max() < 1e-9
    # One more correction is by the steady gain.
    e = 1e-3 * estimator.sensors.noise * np.random.default_rng(0).normal(size=len(y))
    moved = estimator.update(y + e).state - estimate.state
    np.testing.assert_allclose(moved / size, estimator.gain @ e / size, rtol=0, atol=1e-6)


@pytest.fixture(scope="module")
def monte_carlo(held):
    """Normalized innovations, errors and whitened innovations of the filter on its own plant.

    So little noise that the readings are linear in the state: what is left of curvature is a
    thousandth of the noise.
    """
    small = 1e-4
    noise = {kind: small * value for kind, value in EVERY.items()}
    sensors = tc.Sensors(structure=held.model.structure, **noise)
    estimator = tc.KalmanFilter(
        held, sensors, sample_time=STEP, process_noise=0.02 * small, gate=1e-12
    )
    F = estimator.plant.discretize(STEP)[0]
    push = np.linalg.cholesky(
        noise_of(estimator, 0.02 * small) + 1e-12 * np.diag(np.diag(estimator.covariance))
    )
    P, C, R = estimator.covariance, estimator.C, sensors.noise
    start = np.linalg.cholesky(P)
    y0 = still(estimator)
    rng = np.random.default_rng(5)
    whiten = np.linalg.inv(np.linalg.cholesky(C @ P @ C.T + np.diag(R**2)))
    nis, nees, white = [], [], []
    for _ in range(15):
        estimator.reset(covariance=P)
        estimator.update(None)
        estimator.predict(held.equilibrium_input)  # from here on tensions can be used
        z = F @ start @ rng.normal(size=len(F)) + push @ rng.normal(size=len(F))
        predicted, whites = np.zeros(len(F)), []
        for _ in range(60):
            y = y0 + C @ z + R * rng.normal(size=len(R))
            estimate = estimator.update(y)
            whites.append(whiten @ (y - y0 - C @ predicted))
            error = estimate.state - z
            nees.append(error @ np.linalg.solve(estimate.covariance, error))
            predicted = F @ estimate.state
            estimator.predict(held.equilibrium_input)
            z = F @ z + push @ rng.normal(size=len(F))
        white.append(whites[20:])
        found = estimator.statistics
        assert found.status_count == {"lost": 1, "ok": 60}
        nis.append(found.normalized_innovation[1:])
        assert (found.degrees_of_freedom[1:] == len(R)).all()
    return np.concatenate(nis), np.array(nees), np.array(white), len(R), len(F)


def test_innovations_and_errors_are_as_large_as_the_filter_says(monte_carlo):
    nis, nees, _, readings, states = monte_carlo
    total = nis.sum()
    low, high = (chdtri(float(len(nis) * readings), tail) for tail in (0.9995, 0.0005))
    assert low < total < high
    # Errors of one run hang together in time; the runs are independent of each other.
    ends = nees.reshape(15, -1)[:, -1].sum() + nees.reshape(15, -1)[:, 0].sum()
    low, high = (chdtri(float(30 * states), tail) for tail in (0.9995, 0.0005))
    assert low < ends < high
    # And not too large or small at any one moment.
    assert np.mean(nees) / states == pytest.approx(1.0, abs=0.12)


def test_innovations_are_white(monte_carlo):
    *_, white, readings, _ = monte_carlo
    runs, length, _ = white.shape
    covariance = np.einsum("rti,rtj->ij", white, white) / (runs * length)
    assert np.abs(covariance - np.eye(readings)).max() < 5.5 * np.sqrt(2 / (runs * length))
    for lag in (1, 2, 5):
        pairs = runs * (length - lag)
        correlation = np.einsum("rti,rtj->ij", white[:, lag:], white[:, :-lag]) / pairs
        assert np.abs(correlation).max() < 5 / np.sqrt(pairs)


@pytest.mark.parametrize("which", ["held", "by_force"])
def test_poles_of_the_loop_are_those_of_the_regulator_and_of_the_filter(request, which, sensors_of):
    plant = request.getfixturevalue(which)
    Q, R = tc.energy_weights(plant)
    regulator = tc.LQR(plant, Q, R, sample_time=STEP)
    estimator = tc.KalmanFilter(plant, sensors_of("string_length"), sample_time=STEP)
    F, G, _ = plant.discretize(STEP)
    y0, s = still(estimator), len(F)

    def after_a_sample(both):
        z, predicted = both[:s], both[s:]
        estimator.reset(state=predicted, covariance=estimator.covariance)
        estimate = estimator.update(y0 + estimator.C @ z)
        command = regulator.command(0.0, estimate.nodes, estimate.velocities)
        assert command.status == estimate.status == "ok"
        estimator.predict(command.value)
        moved = F @ z + G @ (command.value - plant.equilibrium_input)
        return np.r_[moved, estimator.update(None).state]

    h = 1e-5
    loop = np.column_stack(
        [(after_a_sample(h * e) - after_a_sample(-h * e)) / (2 * h) for e in np.eye(2 * s)]
    )
    found = np.linalg.eigvals(loop)
    wanted = np.r_[regulator.poles, estimator.poles]
    assert len(found) == len(wanted) == 36
    for pole in wanted:
        nearest = np.abs(found - pole).argmin()
        assert abs(found[nearest] - pole) < 1e-6
        found = np.delete(found, nearest)
    assert np.abs(wanted).max() < 1
