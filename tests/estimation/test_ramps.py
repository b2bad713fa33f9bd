"""Winches that wind through samples: what the filter predicts, and that it is told of them."""

import numpy as np
import pytest
from scipy.linalg import expm

import tenscontrol as tc
from tests.estimation.conftest import STEP

PIECES = 8
WINCHES = tc.Winches(substeps=PIECES)


class Winding(tc.control.Controller):
    """Winds all strings along a smooth course, whatever it is told."""

    def __init__(self, plant):
        start = plant.rest_length
        super().__init__(plant, STEP, 0.5 * start, 2 * start)
        self.way = np.r_[4e-3 * np.ones(6), -2e-2 * np.ones(3)]

    def reset(self):
        super().reset()

    def _decide(self, time, state):
        return tc.control.Command(
            self.plant.rest_length + np.sin(np.pi * min(time, 1.0)) ** 2 * self.way
        )

    def _fall_back(self, status):
        return tc.control.Command(self.plant.rest_length, status)


@pytest.fixture(scope="module")
def stiff():
    """A plant of stiff strings: half a sample of winding is many times what sensors see."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(1e4, damping=2.0))
    return tc.linearize(model, tc.prestress(prism, 17.3205), input="rest_length")


def blind(plant, prediction):
    """A filter that knows the start, and is shown nothing after it."""
    sensors = tc.Sensors(structure=plant.model.structure, string_length=1e-3)
    made = tc.KalmanFilter(plant, sensors, sample_time=STEP, prediction=prediction, winches=WINCHES)
    size = len(plant.A)
    made.reset(state=np.zeros(size), covariance=np.zeros((size, size)), held=plant.rest_length)
    return made


@pytest.mark.parametrize("prediction", ["linear", "nonlinear"])
def test_a_load_acts_through_every_piece(stiff, prediction):
    sensors = tc.Sensors(structure=stiff.model.structure, string_length=1e-3, bar_direction=1e-3)
    made = tc.KalmanFilter(
        stiff, sensors, sample_time=STEP, load=True, prediction=prediction, winches=WINCHES
    )
    r = made.plant.degrees_of_freedom  # with the rotations that bar directions show
    A = np.zeros((3 * r, 3 * r))  # z and a load that stays, in continuous time
    A[: 2 * r, : 2 * r], A[r : 2 * r, 2 * r :] = made.plant.A, np.eye(r)
    state = np.r_[np.zeros(2 * r), 1e-3 * np.random.default_rng(2).normal(size=r)]
    made.reset(state=state, covariance=np.zeros(A.shape), held=stiff.rest_length)
    made.predict(stiff.rest_length)
    expected = expm(STEP * A) @ state
    found = made.update(None).state
    for part in (slice(0, r), slice(r, 2 * r), slice(2 * r, 3 * r)):  # q, rates, load
        off = np.abs(found[part] - expected[part]).max()
        # The nonlinear one takes the load to first order in a piece, by RK4 between.
        assert off < (1e-9 if prediction == "linear" else 0.02) * np.abs(expected[part]).max()


def test_the_linear_prediction_is_that_of_a_plant_whose_input_ramps(stiff):
    estimator, z = blind(stiff, "linear"), np.zeros(18)
    assert estimator.substeps == PIECES
    count = 2000
    transition, inputs, drift = stiff.discretize(STEP / count)
    rng, before = np.random.default_rng(0), stiff.rest_length
    for _ in range(20):
        held = stiff.rest_length + 1e-4 * rng.normal(size=9)
        for part in range(count):
            now = before + (part + 0.5) / count * (held - before)
            z = transition @ z + inputs @ (now - stiff.rest_length) + drift
        estimator.predict(held)
        np.testing.assert_allclose(estimator.update(None).state, z, rtol=0, atol=1e-8)
        before = held
    assert np.abs(z).max() > 1e-4


def test_the_nonlinear_prediction_is_the_simulated_motion(stiff):
    """The mean over the sample, held, would be off by the half of what is wound in one."""
    estimator = blind(stiff, "nonlinear")
    run = tc.simulate(
        stiff.model, 1.0, controller=Winding(stiff), winches=WINCHES, rest_length=stiff.rest_length,
        tolerance=1e-10, output_step=STEP, error="none",
    )  # fmt: skip
    wound = np.abs(run.control.winch_rate).max() * STEP
    at = np.searchsorted(run.time, run.control.time - 1e-9)
    off = []
    for k, place in enumerate(at):
        found = estimator.update(None).nodes
        off.append(
            np.abs(
                tc.prism().string_length(found) - tc.prism().string_length(run.nodes[:, :, place])
            ).max()
        )
        estimator.predict(run.control.applied[:, k])
    assert wound > 1e-3
    assert max(off) < 1e-3 * wound


def test_tensions_are_those_of_the_rest_lengths_at_the_sample(stiff):
    """1 mm of winding is 10 N, a hundred times the noise: with the mean, most would be refused."""
    sensors = tc.Sensors(structure=stiff.model.structure, string_length=1e-4, string_tension=0.1)
    estimator = tc.KalmanFilter(
        stiff, sensors, sample_time=STEP, prediction="nonlinear", winches=WINCHES
    )
    run = tc.simulate(
        stiff.model, 1.0, controller=Winding(stiff), winches=WINCHES, rest_length=stiff.rest_length,
        step=5e-4, estimator=estimator, error="none",
    )  # fmt: skip
    found = run.control.estimate
    assert found.statistics.refused.sum() <= 2
    assert found.status_count["ok"] >= 48
    at = np.searchsorted(run.time, found.time - 1e-9)
    length = tc.prism().string_length
    off = [length(found.nodes[:, :, k]) - length(run.nodes[:, :, i]) for k, i in enumerate(at)]
    assert np.abs(off[5:]).max() < 4e-4


def test_a_stuck_winch_and_a_lost_measurement_while_it_winds(stiff):
    """The filter is told what stands; blind, it goes on by that."""
    delay = 1  # sample
    sensors = tc.Sensors(structure=stiff.model.structure, node_position=1e-5, delay=delay)
    estimator = tc.KalmanFilter(
        stiff, sensors, sample_time=STEP, prediction="nonlinear", winches=WINCHES
    )
    faults = [tc.StuckWinch(7, time=0.2), tc.LostMeasurement(time=0.3, until=0.38)]
    run = tc.simulate(
        stiff.model, 0.5, controller=Winding(stiff), winches=WINCHES, rest_length=stiff.rest_length,
        step=5e-4, estimator=estimator, faults=faults, error="none",
    )  # fmt: skip
    found = run.control.estimate
    missed = np.isnan(found.measurement).all(axis=0)
    expected = (found.time >= 0.3 + delay * STEP - 1e-9) & (found.time < 0.38 + delay * STEP - 1e-9)
    np.testing.assert_array_equal(missed, expected | (np.arange(len(missed)) < delay))
    assert np.ptp(run.control.applied[7, 10:]) == 0
    assert np.ptp(run.control.command[7, 10:]) > 5e-3
    at = np.searchsorted(run.time, found.time - 1e-9)
    length = tc.prism().string_length
    off = [length(found.nodes[:, :, k]) - length(run.nodes[:, :, i]) for k, i in enumerate(at)]
    assert np.abs(off[10:]).max() < 1e-4


def test_winches_that_do_not_fit_are_refused(stiff):
    sensors = tc.Sensors(structure=stiff.model.structure, string_length=1e-3)
    options = {"rest_length": stiff.rest_length, "winches": WINCHES}
    plain = tc.KalmanFilter(stiff, sensors, sample_time=STEP)
    with pytest.raises(
        ValueError, match=r"with substeps=1, but .* have substeps=8: give them to Kalman"
    ):
        tc.simulate(stiff.model, 0.1, controller=Winding(stiff), estimator=plain, **options)
    with pytest.raises(TypeError, match=r"winches is a int, expected Winches"):
        tc.KalmanFilter(stiff, sensors, sample_time=STEP, winches=8)
    by_force = tc.linearize(stiff.model, tc.prestress(tc.prism(), 17.3205))
    with pytest.raises(ValueError, match=r"winches set rest lengths, but plant has input='force"):
        tc.KalmanFilter(by_force, sensors, sample_time=STEP, winches=WINCHES)
    with pytest.raises(ValueError, match=r"held has shape \(8,\), expected \(9,\)"):
        plain.reset(held=np.ones(8))
