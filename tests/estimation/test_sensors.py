"""Rates of bars, as gyros tell them: values, derivatives, and what they are good for."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.estimation.observability import observed_plant, output_function
from tests import coupled
from tests.estimation.differences import differences


def ball():
    return tc.library.six_bar_ball()


STRUCTURES = {"ball": ball, "d_bar": coupled.d_bar, "tower": coupled.tower}

every_structure = pytest.mark.parametrize("name", STRUCTURES)


@every_structure
def test_rates_of_a_turning_body_are_its_own_across_each_bar(name):
    structure = STRUCTURES[name]()
    d, rng = structure.dimension, np.random.default_rng(1)
    N, along = structure.nodes, rng.normal(size=(d, 1))
    axes = structure.bar_vectors(N) / structure.bar_length
    if d == 2:
        velocities, expected = along + 0.7 * np.array([-N[1], N[0]]), np.full(len(axes.T), 0.7)
    else:
        turn = rng.normal(size=3)
        velocities = along + np.cross(turn, N, axis=0)
        across = turn[:, None] - axes * (turn @ axes)  # a thin bar does not spin
        expected = across.ravel(order="F")
    sensors = tc.Sensors(structure=structure, bar_rate=0.05)
    found = sensors.measure(N, velocities=velocities)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    assert np.isnan(sensors.measure(N)).all()
    assert sensors.reading_of.tolist() == np.repeat(range(len(axes.T)), 1 if d == 2 else 3).tolist()


def plant_of(name):
    structure = STRUCTURES[name]()
    force = coupled.tower_force_density() if name == "tower" else 10.0
    model = tc.Model(structure, strings=tc.LinearStrings(500.0, damping=1.0))
    rest = tc.prestress(structure, force_density=force)
    return tc.linearize(model, rest, input="rest_length")


@every_structure
def test_derivatives_of_rates_and_directions(name):
    """Against differences of what the sensors read of the motion itself, on a few bars."""
    plant = plant_of(name)
    sensors = tc.Sensors(
        structure=plant.model.structure, bar_direction=0.01, bar_rate=0.05, bars=[1],
        rate_bars=[3, 0],
    )  # fmt: skip
    plant = observed_plant(plant, sensors)
    r, function = plant.degrees_of_freedom, output_function(plant, sensors)
    rng = np.random.default_rng(0)

    def read(z):
        nodes, velocities = plant.to_nodes(z[:r]), plant.to_velocities(z[:r], z[r:])
        return sensors.measure(nodes, velocities=velocities)

    z = 0.02 * rng.normal(size=2 * r)
    y, C = (np.array(part.full()) for part in function(z, plant.equilibrium_input))
    np.testing.assert_allclose(y.ravel(), read(z), rtol=0, atol=1e-12)
    along, changes = differences(read, z)
    np.testing.assert_allclose(C @ along, changes, rtol=0, atol=1e-8)


@pytest.fixture(scope="module")
def swinging_ball():
    plant = plant_of("ball")
    still = np.zeros((3, 12))
    pushed = plant.to_velocities(
        np.zeros(plant.degrees_of_freedom),
        0.3 * np.random.default_rng(4).normal(size=plant.degrees_of_freedom),
    )
    run = tc.simulate(
        plant.model, 0.6, plant.nodes + still, pushed, rest_length=plant.rest_length,
        output_step=0.01, error="none",
    )  # fmt: skip
    return plant, run


def estimated(plant, run, lost=(), **kinds):
    """Return the errors of the rates of all bars, rad/s, over a run, and the filter."""
    every = tc.Sensors(structure=plant.model.structure, bar_rate=1.0)
    sensors = tc.Sensors(
        structure=plant.model.structure, string_length=1e-3, node_position=5e-3, nodes=[0, 5, 9],
        **kinds,
    )  # fmt: skip
    estimator = tc.KalmanFilter(plant, sensors, sample_time=0.01, start_spread=0.05)
    generator, errors = np.random.default_rng(0), []
    for k in range(len(run.time)):
        nodes, velocities = run.nodes[..., k], run.velocities[..., k]
        exact = sensors.measure(nodes, velocities=velocities)
        reading = sensors.disturb(exact, generator)
        estimate = estimator.update(None if k in lost else reading)
        estimator.predict(plant.rest_length)
        found = every.measure(estimate.nodes, velocities=estimate.velocities)
        errors.append(found - every.measure(nodes, velocities=velocities))
    return np.array(errors), estimator


def test_rates_are_known_from_a_few_gyros(swinging_ball):
    """Two gyros of 0.01 rad/s make the turning of all six bars known twice as well, soon."""
    plant, run = swinging_ball
    plain, _ = estimated(plant, run, bar_direction=0.01)
    known, estimator = estimated(plant, run, bar_direction=0.01, bar_rate=0.01, rate_bars=[0, 3])
    early = slice(2, 10)
    assert 2 * np.abs(known[early]).mean() < np.abs(plain[early]).mean()
    used = estimator.statistics
    share = np.nansum(used.normalized_innovation) / used.degrees_of_freedom.sum()
    assert 0.9 < share < 1.1


def test_an_outage_is_bridged(swinging_ball):
    plant, run = swinging_ball
    kinds = {"bar_direction": 0.01, "bar_rate": 0.02, "bars": [0, 1, 2], "rate_bars": [3, 4, 5]}
    whole, _ = estimated(plant, run, **kinds)
    bridged, estimator = estimated(plant, run, lost=range(20, 30), **kinds)
    assert estimator.statistics.status_count["lost"] == 10
    np.testing.assert_array_equal(whole[:20], bridged[:20])
    assert np.abs(bridged[40:]).mean() < 1.5 * np.abs(whole[40:]).mean()
