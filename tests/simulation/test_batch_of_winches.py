"""Batches with winches: the numbers of single runs, with motors that differ from run to run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc


@pytest.fixture(scope="module")
def scene():
    model = tc.Model(replace(tc.prism(), fixed=[3, 4, 5]), tc.LinearStrings(300.0, damping=2.0))
    rest = tc.prestress(model.structure, min_force_density=20.0)
    plant = tc.linearize(model, rest, "rest_length")
    motor = tc.Motor(drum_radius=0.01, gear_ratio=20.0, torque=0.02)
    winches = tc.Winches(ramp=True, substeps=2, rate=1.0, motor=motor)
    law = tc.LQR(plant, sample_time=0.02, winches=winches)
    return tc.Scene(
        model, 0.1, controller=law, winches=winches, rest_length=plant.equilibrium_input,
        nodes=plant.to_nodes(np.full(6, 0.01)), integration=tc.Integration(step=5e-3),
        faults=[tc.StuckWinch(0, time=0.04)],
    )  # fmt: skip


def test_runs_with_winches_are_single_runs(scene):
    vary = {
        "motor.torque": np.array([0.02, 0.012, -1.0]),
        "motor.drum_radius": 0.01 * np.ones((3, 9)),
        "rest_length": np.array([[1.0], [1.01], [1.0]]) * scene.rest_length,
    }
    batch = tc.simulate_many(scene, vary, error="none")
    assert batch.completed.tolist() == [True, True, False]
    assert "torque" in batch.messages[2]
    limited = []
    for run in (0, 1):
        single = batch.scene_of(run).simulate()
        motor = single.scene.winches.motor
        assert float(motor.torque[0]) == vary["motor.torque"][run]
        np.testing.assert_array_equal(batch.nodes[run], single.nodes[..., [0, -1]])
        np.testing.assert_array_equal(batch.command[run], single.control.command)
        limited.append(single.control.motors.torque_limited.sum())
    assert limited[1] > limited[0]
    assert batch.error is None


def test_estimators_and_moving_supports_go_through_the_same_call(scene):
    moved = tc.Profile([0.0, 0.1], np.stack([np.zeros((3, 3)), np.full((3, 3), 0.01)], axis=2))
    model, law = scene.model, scene.law
    sensors = tc.Sensors(structure=model.structure, string_length=1e-3)
    estimator = tc.KalmanFilter(law.plant, sensors, sample_time=0.02, winches=scene.winches)
    filtered = replace(scene, estimator=estimator, faults=(), seed=1)
    driven = tc.Scene(
        model, 0.1, rest_length=scene.rest_length, support_motion=moved,
        integration=scene.integration,
    )  # fmt: skip
    for each in (filtered, driven):
        batch = tc.simulate_many(each, {"stiffness": np.array([290.0, 310.0])}, error="none")
        assert batch.completed.all(), batch.messages
        single = batch.scene_of(1).simulate()
        np.testing.assert_array_equal(batch.nodes[1], single.nodes[..., [0, -1]])


def test_what_no_motor_has_is_refused(scene):
    with pytest.raises(ValueError, match=r"vary is 'motor.lag', expected one of"):
        tc.simulate_many(scene, {"motor.lag": [0.01, 0.02]})
