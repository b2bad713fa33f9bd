"""Structures that fall, touch and rock, estimated with the force of the contact known or not."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tests.control.mpc import contact_scenes
from tests.estimation.ground_scenes import (
    GROUNDS,
    SAMPLE,
    dropped,
    errors,
    normalized_errors,
    plant_of,
    sensors_of,
)


def test_the_known_contact_keeps_estimates_sharp():
    """Against a filter that takes the ground for an unknown load, on a drop and its rebounds."""
    name = "ball"
    run = dropped(name, 1, 0.6)
    assert run.nodes[-1].min() < -1e-3
    late = slice(20, None)
    known, estimator = errors(name, "sharp", run, 5)
    load, _ = errors(name, "none", run, 5, load=True)
    assert 1.5 * known[0, late].mean() < load[0, late].mean()
    assert 4 * known[1, late].mean() < load[1, late].mean()
    assert known[0, late].max() < 5e-3
    assert estimator.statistics.status_count["ok"] >= len(run.time) - 3


def test_without_ground_the_ball_is_lost():
    run = dropped("ball", 1, 0.6)
    lost, _ = errors("ball", "none", run, 5)
    assert lost[0, -10:].mean() > 0.1


def ground_forces(plant, run, parts):
    """Return the mean force of the ground on the nodes over each sample, N, shape (K, d, n)."""
    N, V = (ca.SX.sym(name, *plant.nodes.shape) for name in "NV")
    force = ca.Function("force", [N, V], [plant.model.contacts.on_nodes(N, V)])
    each = [
        force(run.nodes[..., k], run.velocities[..., k]).full() for k in range(len(run.time) - 1)
    ]
    return np.array(each).reshape(-1, parts, *plant.nodes.shape).mean(axis=1)


def test_measured_contact_forces_stand_in_for_the_ground():
    """Feet that feel: the filter has no ground in its model, and is told what they feel."""
    touched, parts, delay = plant_of("x", GROUNDS["sharp"]), 20, 2
    run = tc.simulate(
        touched.model, 0.6, touched.nodes, rest_length=touched.rest_length, tolerance=1e-8,
        output_step=SAMPLE / parts, error="none",
    )  # fmt: skip
    forces = ground_forces(touched, run, parts)
    assert forces.max() > 20.0
    plant, sensors = plant_of("x", None), sensors_of("x", delay=delay)
    generator, off = np.random.default_rng(3), {}
    readings = [
        sensors.disturb(
            sensors.measure(run.nodes[..., k], velocities=run.velocities[..., k]), generator
        )
        for k in range(0, len(run.time), parts)
    ]
    for told in (True, False):
        estimator = tc.KalmanFilter(
            plant, sensors, sample_time=SAMPLE, prediction="nonlinear", start_spread=0.01
        )
        off[told] = []
        for k, force in enumerate(forces):
            estimate = estimator.update(readings[k - delay] if k >= delay else None)
            estimator.predict(plant.rest_length, force if told else None)
            off[told].append(np.abs(estimate.velocities - run.velocities[..., parts * k]).mean())
    assert np.mean(off[True][20:]) < 0.05 < 10 * np.mean(off[True][20:]) < np.mean(off[False][20:])


@pytest.mark.parametrize("prediction", ["linear", "nonlinear"])
def test_a_known_force_that_carries_the_weight_ends_the_fall(prediction):
    plant = plant_of("x", None)
    estimator = tc.KalmanFilter(
        plant, sensors_of("x"), sample_time=SAMPLE, prediction=prediction, load=True
    )
    for _ in range(5):
        estimator.predict(plant.rest_length, -plant.model.constant_force)
    np.testing.assert_allclose(estimator.update(None).nodes, plant.nodes, rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match=r"force has shape \(2,\), expected \(2, 4\)"):
        estimator.predict(plant.rest_length, [0.0, 1.0])


@pytest.mark.parametrize("name", ["x", "tower"])  # in the plane, and bars that share nodes
def test_errors_are_as_large_as_the_filter_says(name):
    each = [normalized_errors(name, seed, 14) for seed in range(2 if name == "x" else 1)]
    found, innovations = np.mean(each, axis=0)
    assert 0.75 < found < 1.3
    assert 0.85 < innovations < 1.15


def test_a_linear_prediction_of_a_fall_is_refused():
    plant = plant_of("x", GROUNDS["smooth"])
    with pytest.raises(ValueError, match=r"plant is not at rest.*prediction='nonlinear'"):
        tc.KalmanFilter(plant, sensors_of("x"), sample_time=SAMPLE)
    falling = plant_of("x", None)  # without ground a fall is linear
    assert tc.KalmanFilter(falling, sensors_of("x"), sample_time=SAMPLE).sample_time == SAMPLE


@pytest.mark.filterwarnings("ignore:under NMPC the run:tenscontrol.control.ControlWarning")
def test_an_x_jumps_by_estimates_through_an_outage():
    """A marker of 5 mm, lengths and inertial sensors; nothing arrives while it lands."""
    plant = contact_scenes.STRUCTURES["x"](height=0.1)
    sharp = contact_scenes.models(plant.model.structure)[0]
    at = tc.OperatingPoint(plant.nodes, plant.force_density, sharp.constant_force)
    known = tc.linearize(
        sharp, at, input="rest_length", coordinates="minimal", require_equilibrium=False
    )
    estimator = tc.KalmanFilter(
        known, sensors_of("x"), sample_time=0.02, prediction="nonlinear", start_spread=0.01
    )
    nmpc = contact_scenes.hop(plant, 0.15, 12)
    run = tc.simulate(
        sharp, 1.2, plant.nodes, rest_length=plant.rest_length, controller=nmpc,
        estimator=estimator, seed=1, faults=[tc.LostMeasurement(0.12, 0.2)], tolerance=1e-8,
        error="none",
    )  # fmt: skip
    assert set(nmpc.status_count) == {tc.control.Status.OK}
    assert estimator.statistics.status_count["lost"] == 4
    assert run.nodes[1].min(axis=0)[run.time > 0.5].max() > 0.08
    found = run.control.estimate
    rows = np.abs(run.time[:, None] - found.time).argmin(axis=0)
    assert np.abs(found.nodes - run.nodes[..., rows]).max() < 0.02
