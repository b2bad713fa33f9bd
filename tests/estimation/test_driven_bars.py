"""Filters of structures whose bars are driven: python-control's gain, loops, shapes, refusals."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.plant.linear_plant import sampled
from tenscontrol.status import Status
from tests.known_structures import d_bar

STEP = 0.02
RAMP = tc.Winches(ramp=True, rate=2.0, shortest=0.3, longest=3.0)


def _plant(structure, coordinates="internal", actuated=None):
    model = tc.Model(structure, tc.LinearStrings(300.0, damping=2.0))
    rest = tc.prestress(structure, min_force_density=20.0)
    return tc.linearize(model, rest, "bar_length", coordinates, actuated=actuated)


@pytest.fixture(scope="module")
def plant():
    """A prism on three fixed nodes, two of whose bars are driven."""
    return _plant(replace(tc.prism(), fixed=[3, 4, 5]), actuated=[0, 2])


def _filter(plant, **options):
    readings = {"node_position": 1e-4, "string_tension": 0.01, "gyroscope": 1e-3}
    sensors = tc.Sensors(structure=plant.model.structure, **readings)
    return tc.KalmanFilter(plant, sensors, **({"sample_time": STEP, "winches": RAMP} | options))


def test_gains_are_those_of_python_control_on_the_driven_columns(plant):
    """Of the regulator with the lengths held as states, and of the filter by duality."""
    regulator = tc.LQR(plant, sample_time=STEP, winches=RAMP)
    A, B = sampled(plant, STEP, True).augmented
    Q, R = tc.plant.natural_weights(plant)
    weights = np.zeros_like(A)
    weights[: len(Q), : len(Q)] = Q
    gain = control.dlqr(A, B, weights, np.diag(R))[0]
    found = np.hstack([regulator.gain, regulator.previous_input_gain])
    np.testing.assert_allclose(found, gain, rtol=0, atol=1e-9 * np.abs(gain).max())
    estimator = _filter(plant)
    design, C = estimator.design, estimator.C
    noise = np.diag(estimator.sensors.noise**2)
    _, P, _ = control.dlqe(
        design.sampled.transition, np.eye(len(C.T)), C, design.process_covariance, noise
    )
    np.testing.assert_allclose(estimator.covariance, P, rtol=0, atol=1e-9 * np.abs(P).max())
    expected = P @ C.T @ np.linalg.inv(C @ P @ C.T + noise)
    np.testing.assert_allclose(estimator.gain, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["on supports", "joined, loose"])
def test_an_estimate_follows_bars_that_change_their_lengths(plant, kind):
    """Also where the filter sees motions as one body that the plant leaves out."""
    if kind == "joined, loose":
        plant = _plant(d_bar())
    structure, r = plant.model.structure, plant.degrees_of_freedom
    estimator = _filter(plant)
    start = plant.to_nodes((3e-4 if r == 1 else 3e-3) * np.arange(1.0, 1.0 + r))
    how = {"controller": tc.LQR(plant, sample_time=STEP, winches=RAMP), "winches": RAMP}
    run = tc.simulate(
        plant.model, 0.4, nodes=start, estimator=estimator, tolerance=1e-9, error="none", **how
    )
    record = run.control.estimate
    assert record.status_count[Status.OK] > 18
    at = np.searchsorted(run.time, record.time - 1e-9)
    for found, true, noise in (
        (record.nodes, run.nodes, 1e-4), (record.velocities, run.velocities, 0.02)
    ):  # fmt: skip
        off = np.abs(found[..., 1:] - true[:, :, at[1:]])
        assert off.max() < 5 * noise
        assert np.abs(true).max() > 100 * noise or found is record.velocities
    # The bars of the estimate are as long as their drives have made them.
    for k in (5, 19):
        length = np.linalg.norm(structure.bar_vectors(record.nodes[:, :, k]), axis=0)
        np.testing.assert_allclose(length, run.control.applied[:, k - 1], rtol=1e-10)
    # A log is smoothed about the same lengths.
    smooth = estimator.smooth(record.measurement, run.control.applied, previous=plant.string_values)
    np.testing.assert_allclose(smooth.nodes[..., -1], record.nodes[..., -1], atol=1e-9)
    assert (smooth.node_deviation <= smooth.filtered_node_deviation + 1e-15).all()


def test_coordinates_of_driven_bars_are_one_to_one(plant):
    """Shapes and velocities of any lengths and rates, in numbers and as expressions."""
    random = np.random.default_rng(0)
    for one in (plant, _plant(tc.library.d_bar_3d(), "minimal")):
        structure, r = one.model.structure, one.degrees_of_freedom
        z = 0.02 * random.normal(size=2 * r)
        length = structure.bar_length * random.uniform(0.9, 1.1, len(structure.bars))
        rate = random.normal(size=len(length))
        N, V = one.to_nodes(z[:r], length), one.to_velocities(z[:r], z[r:], length, rate)
        b, change = structure.bar_vectors(N), structure.bar_vectors(V)
        np.testing.assert_allclose(np.linalg.norm(b, axis=0), length, rtol=1e-12)
        np.testing.assert_allclose((b * change).sum(axis=0), length * rate, atol=1e-11)
        np.testing.assert_allclose(one.coordinates.project((N - one.nodes).T.ravel()), z[:r],
                                   atol=1e-12)  # fmt: skip
        np.testing.assert_allclose(one.coordinates.project(V.T.ravel()), z[r:], atol=1e-11)
    with pytest.raises(ValueError, match="bar_length"):
        plant.to_nodes(z[:6], [1.0, -1.0, 1.0])


def test_a_filter_starts_from_the_lengths_of_its_start(plant):
    shape = plant.to_nodes(np.zeros(6), plant.string_values * [0.95, 1.0, 1.05])
    estimator = _filter(plant, start=shape)
    assert estimator.update(None).status is Status.LOST
    np.testing.assert_allclose(estimator.update(None).nodes, shape, atol=1e-9)


REFUSED = {
    "jump": ({"winches": None}, {}, "lengths of bars cannot jump"),
    "nonlinear": ({"prediction": "nonlinear"}, {}, "give prediction='linear'"),
    "acceleration": ({}, {"accelerometer": 0.1}, "leave accelerometer out"),
    "winding": ({"rest_length_error": (1e-3, 1e-4)}, {}, "plant has input='bar_length'"),
    "passive": ({"start": [1, 1.1, 1]}, {}, "the drives of the plant leave it at"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_filter_of_bars_does_not_take_is_refused_by_name(plant, case):
    options, more, message = REFUSED[case]
    if "start" in options:
        lengths = plant.string_values * options["start"]
        options = {"start": plant.to_nodes(np.zeros(6), lengths)}
    sensors = tc.Sensors(structure=plant.model.structure, node_position=1e-3, **more)
    with pytest.raises(ValueError, match=message):
        tc.KalmanFilter(plant, sensors, **({"sample_time": STEP, "winches": RAMP} | options))
    with pytest.raises(ValueError, match="expected a length above 0"):
        _filter(plant).predict(-plant.string_values)
