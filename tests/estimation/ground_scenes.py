"""Structures dropped on the ground, and filters that know its force or do not."""

from functools import cache

import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics import SmoothGround
from tenscontrol.plant.linear_plant import acceleration_response
from tests import coupled

SAMPLE = 0.01
GROUND = {"stiffness": 5e3, "damping": 0.3, "friction": 0.5, "slip_speed": 0.1}
STRINGS = tc.LinearStrings(stiffness=800.0, damping=2.0)

# Structure, its force densities, nodes that are seen, and bars with inertial sensors.
SCENES = {
    "x": (tc.library.snelson_x, 40.0, [0], [0, 1]),
    "ball": (lambda: tc.library.six_bar_ball(bar_length=1.0), 60.0, [0, 4, 8], [0, 3]),
    "tower": (coupled.tower, coupled.tower_force_density(15.0), [0, 4, 8], [0, 3]),
}


@cache
def plant_of(name, ground, height=0.1):
    """Return the plant of a scene above a ground of :data:`GROUNDS`."""
    structure, force = SCENES[name][0](), SCENES[name][1]
    model = tc.Model(structure, STRINGS, gravity=9.81, ground=ground)
    rest = tc.prestress(structure, force_density=force)
    nodes = structure.nodes.copy()
    nodes[-1] += height - nodes[-1].min()
    at = tc.OperatingPoint(nodes, rest.force_density, model.constant_force)
    return tc.linearize(
        model, at, input="rest_length", coordinates="minimal", require_equilibrium=False
    )


GROUNDS = {
    "sharp": tc.Ground(**GROUND),
    "smooth": SmoothGround(**GROUND, width=0.005),
    "none": None,
}


def sensors_of(name, **more):
    """A few markers, lengths of the winches' strings, and inertial sensors on a few bars."""
    structure, _, nodes, bars = SCENES[name]
    return tc.Sensors(
        structure=structure(), node_position=5e-3, nodes=nodes, string_length=2e-3,
        bar_direction=0.01, bars=bars, bar_rate=0.02, rate_bars=bars, **more,
    )  # fmt: skip


@cache
def dropped(name, seed, duration):
    """A drop on the sharp law, turning and moving sideways, so that it rocks and slides."""
    plant, rng = plant_of(name, GROUNDS["sharp"]), np.random.default_rng(seed)
    arms = plant.nodes - plant.nodes.mean(axis=1, keepdims=True)
    velocities = np.zeros_like(arms)
    velocities[0] = 0.3
    if len(arms) == 3:
        velocities += np.cross(0.6 * rng.normal(size=3), arms, axis=0)
    else:
        velocities += 0.8 * np.array([-arms[1], arms[0]])
    return tc.simulate(
        plant.model, duration, plant.nodes, velocities, rest_length=plant.rest_length,
        output_step=SAMPLE, error="none",
    )  # fmt: skip


def errors(name, ground, run, seed, **options):
    """Return mean errors of places, m, and of velocities, m/s, sample by sample."""
    plant, sensors = plant_of(name, GROUNDS[ground]), sensors_of(name)
    settings = {"prediction": "nonlinear", "start_spread": 0.01} | options
    estimator = tc.KalmanFilter(plant, sensors, sample_time=SAMPLE, **settings)
    generator, found = np.random.default_rng(seed), []
    for k in range(len(run.time)):
        nodes, velocities = run.nodes[..., k], run.velocities[..., k]
        exact = sensors.measure(nodes, velocities=velocities)
        estimate = estimator.update(sensors.disturb(exact, generator))
        estimator.predict(plant.rest_length)
        off = estimate.nodes - nodes, estimate.velocities - velocities
        found.append([float(np.abs(part).mean()) for part in off])
    return np.array(found).T, estimator


def normalized_errors(name, seed, count):
    """Return ``eᵀ P⁻¹ e`` and innovations per degree of freedom where noises are as supposed.

    The motion is that of the sharp law from sample to sample, kicked by accelerations that are
    constant over each, from a start that is drawn.
    """
    plant, sensors = plant_of(name, GROUNDS["sharp"], height=0.02), sensors_of(name)
    estimator = tc.KalmanFilter(
        plant, sensors, sample_time=SAMPLE, prediction="nonlinear", start_spread=0.005
    )
    estimator.update(None)
    rng, r = np.random.default_rng(seed), plant.degrees_of_freedom
    start = estimator.update(None).covariance
    response = acceleration_response(plant, SAMPLE)
    noise = estimator._design.process_covariance
    pull = np.sqrt(np.trace(noise) / np.trace(response @ response.T))
    estimator.reset()
    z = rng.normal(size=2 * r) * np.sqrt(np.diag(start))
    found = []
    for _ in range(count):
        nodes, velocities = plant.to_nodes(z[:r]), plant.to_velocities(z[:r], z[r:])
        exact = sensors.measure(nodes, velocities=velocities)
        estimate = estimator.update(sensors.disturb(exact, rng))
        off = estimate.state - z
        found.append(off @ np.linalg.solve(estimate.covariance, off) / len(off))
        estimator.predict(plant.rest_length)
        run = tc.simulate(
            plant.model, SAMPLE, nodes, velocities, rest_length=plant.rest_length, tolerance=1e-7,
            error="none",
        )  # fmt: skip
        z = plant.measure(run.nodes[..., -1], run.velocities[..., -1])
        z = z + response @ (pull * rng.normal(size=r))
    used = estimator.statistics
    share = np.nansum(used.normalized_innovation) / used.degrees_of_freedom.sum()
    return np.mean(found), share
