"""A filter of a structure that rolls: turns of any angle, and the way that the lowest node goes."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tenscontrol as tc

SAMPLE = 0.05


def readings_of(structure, **more):
    return tc.Sensors(structure=structure, bar_direction=0.01, bar_rate=0.02, **more)


@cache
def plant_of(name, **changes):
    structure = {"prism": tc.prism, "x": tc.library.snelson_x}[name]()
    model = tc.Model(structure, strings=tc.LinearStrings(300.0, damping=1.0), **changes)
    rest = tc.prestress(structure, min_force_density=30.0)
    at = tc.OperatingPoint(structure.nodes, rest.force_density, model.constant_force)
    return tc.linearize(model, at, input="rest_length", require_equilibrium=False)


def filter_of(name, start=None, **settings):
    plant = plant_of(name)
    sensors = readings_of(plant.model.structure, string_length=1e-3)
    given = {"sensors": sensors, "sample_time": SAMPLE, "rolling": True}
    return tc.KalmanFilter(plant, start=start, **given | settings)


def centred(nodes):
    return nodes - nodes.mean(axis=1, keepdims=True)


def followed(estimator, motion, samples):
    """Return the estimates along a motion, sample by sample, from exact readings."""
    estimates = []
    for k in range(samples):
        nodes, velocities = motion(k * SAMPLE)
        y = estimator.sensors.measure(nodes, velocities=velocities)
        estimates.append(estimator.update(y))
        estimator.predict(estimator.plant.rest_length)
    return estimates


def test_it_follows_a_structure_round_and_round():
    """A prism that spins about a skew axis, more than twice, as if it were rigid."""
    shape, axis = plant_of("prism").nodes, np.array([1.0, 2.0, -1.0]) / np.sqrt(6)
    speed = 3.0

    def spinning(time):
        nodes = Rotation.from_rotvec(speed * time * axis).as_matrix() @ centred(shape)
        return nodes, speed * np.cross(axis, nodes, axis=0)

    samples = int(5 * np.pi / speed / SAMPLE)
    estimates = followed(filter_of("prism", process_noise=1.0), spinning, samples)
    truth = [spinning(k * SAMPLE)[0] for k in range(samples)]
    off = [np.abs(centred(e.nodes) - t).max() for e, t in zip(estimates, truth, strict=True)]
    assert max(off[10:]) < 0.02
    assert {str(e.status) for e in estimates[5:]} == {"ok"}
    fixed = followed(filter_of("prism", process_noise=1.0, rolling=False), spinning, 20)
    assert np.abs(centred(fixed[-1].nodes) - truth[19]).max() > 0.2


@pytest.mark.parametrize("load", [False, True])
def test_what_is_turned_at_the_start_is_estimated_turned(load):
    """Readings and start of one filter are those of the other, turned; states are the same."""
    turn = Rotation.from_rotvec([0.4, -1.7, 2.0]).as_matrix()
    shape, rng = plant_of("prism").nodes, np.random.default_rng(0)
    given = {"load": load, "process_noise": 0.3}
    one, other = filter_of("prism", shape, **given), filter_of("prism", turn @ shape, **given)
    for _ in range(8):
        y = one.sensors.measure(shape, velocities=0 * shape)
        y += one.sensors.noise * rng.normal(size=len(y))
        y[rng.integers(len(y))] = rng.choice([np.nan, np.inf, 1e308])
        apart_read, vectors = y.copy(), y[9:].reshape(-1, 3).copy()  # after nine lengths
        good = np.isfinite(vectors).all(axis=1)
        vectors[good] = vectors[good] @ turn.T
        apart_read[9:] = vectors.ravel()
        straight, apart = one.update(y), other.update(apart_read)
        assert straight.status is apart.status
        off = turn @ centred(straight.nodes) - centred(apart.nodes)
        assert np.abs(off).max() < 1e-9
        np.testing.assert_allclose(apart.state, straight.state, rtol=0, atol=1e-9)
        np.testing.assert_allclose(
            (apart.node_deviation**2).sum(axis=0), (straight.node_deviation**2).sum(axis=0)
        )
        if load:
            np.testing.assert_allclose(apart.load, turn @ straight.load, rtol=0, atol=1e-7)
        for estimator in (one, other):
            estimator.predict(estimator.plant.rest_length)


def test_it_travels_by_its_circumference_in_a_turn():
    """A quadrilateral that is rolled over its corners: a turn takes it on by its four sides."""
    structure = plant_of("x").model.structure
    shape = tc.plant.set_down(tc.Model(structure, ground=tc.Ground(1e3)), [0, 1])
    corners = centred(shape)
    order = np.argsort(np.arctan2(corners[1], corners[0]))
    around = np.linalg.norm(shape[:, order] - shape[:, np.roll(order, 1)], axis=0).sum()

    def rolled(time):
        c, s = np.cos(-speed * time), np.sin(-speed * time)
        nodes = np.array([[c, -s], [s, c]]) @ corners
        return nodes, -speed * np.array([-nodes[1], nodes[0]])

    samples = 200
    speed = 2 * np.pi / ((samples - 1) * SAMPLE)
    estimates = followed(filter_of("x", shape, process_noise=0.5), rolled, samples)
    way = estimates[-1].nodes.mean(axis=1) - estimates[0].nodes.mean(axis=1)
    assert way == pytest.approx([around, 0.0], abs=0.01 * around)
    assert all(abs(e.nodes[1].min() - shape[1].min()) < 1e-12 for e in estimates)
    still = [np.abs(e.velocities).min(axis=1).max() for e in estimates]
    assert max(still) < 1e-12


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: tc.KalmanFilter(
                plant_of("prism", gravity=9.81),
                readings_of(tc.prism()),
                sample_time=SAMPLE,
                rolling=True,
            ),
            "rolling is True, but the model of plant has gravity",
        ),
        (
            lambda: filter_of("prism", sensors=readings_of(tc.prism(), bar_inclination=0.01)),
            "sensors read bar_inclination, which is neither a vector",
        ),
        (
            lambda: filter_of(
                "prism", sensors=tc.Sensors(structure=tc.prism(), string_length=1e-3)
            ),
            "does not show how the structure is turned",
        ),
        (
            lambda: filter_of(
                "prism", sensors=readings_of(tc.prism(), bias={"bar_rate": (0.1, 0.01)})
            ),
            "bar_rate has a bias",
        ),
        (
            lambda: filter_of("prism", sensors=readings_of(tc.prism(), gravity=0.0)),
            "gravity 0: give it",
        ),
        (lambda: filter_of("prism").smooth(np.zeros((21, 2)), np.ones((9, 2))), "does not smooth"),
        (lambda: filter_of("prism").predict(np.ones(9), np.zeros((3, 6))), "takes none"),
    ],
)
def test_what_a_rolling_filter_cannot_do_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
