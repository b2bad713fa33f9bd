"""Offset-free tracking under a load that the model does not know."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol import demo

SAMPLE, LOAD = 0.02, 2.0


def height_row():
    row = np.zeros((3, 6))
    row[2, :3], row[2, 3:] = 1 / 3, -1 / 3
    return row.ravel(order="F")[None]


def final_height(load_gain):
    """Return the mean height over the last second of a run under 2 N that pull at both ends, m."""
    prism = tc.prism()
    pull = np.zeros((3, 6))
    pull[2, :3], pull[2, 3:] = LOAD / 3, -LOAD / 3
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, demo.TOP_FORCE_DENSITY))
    tracked = None if load_gain is None else height_row()
    mpc = tc.MPC(plant, 10, SAMPLE, 80.0, load_gain=load_gain, tracked=tracked)
    loaded = tc.Model(prism, external_force=pull)
    run = tc.simulate(loaded, 40.0, controller=mpc, step=4e-3, output_step=SAMPLE)
    assert mpc.statistics.fallbacks == 0
    late = np.flatnonzero(run.time > 39.0)
    shapes = [
        plant.to_nodes(plant.measure(run.nodes[:, :, k], run.velocities[:, :, k])[:9]) for k in late
    ]
    return np.array([demo.height_of(N[:, :, None])[0] for N in shapes]), mpc


def test_unknown_load_leaves_no_offset_where_it_is_estimated():
    without, _ = final_height(None)
    height, mpc = final_height(0.1)
    assert np.abs(without - 1.0).max() > 2e-3
    assert np.abs(height - 1.0).max() < 1e-4
    # The estimate is the load, as accelerations in reduced coordinates, up to what is nonlinear.
    pull = np.zeros((3, 6))
    pull[2, :3], pull[2, 3:] = LOAD / 3, -LOAD / 3
    expected = mpc.plant.basis.T @ pull.ravel(order="F")
    assert np.linalg.norm(mpc.load - expected) < 0.15 * np.linalg.norm(expected)


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_estimate_converges_and_the_rest_is_a_rest(held):
    """On the linear plant, where everything is exact."""
    from tenscontrol.control.load_observer import LoadObserver
    from tenscontrol.control.path import acceleration_response

    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(1e3))
    plant = tc.linearize(model, tc.prestress(prism, 17.3205), input=held)
    push = acceleration_response(plant, SAMPLE)
    tracked = height_row() @ plant.basis
    observer = LoadObserver(plant, push, 0.3, tracked)
    transition, inputs, _ = plant.discretize(SAMPLE)
    rng = np.random.default_rng(0)
    load, z, v, errors = rng.normal(size=9), np.zeros(18), np.zeros(9), []
    for _ in range(30):
        observer.correct(z, inputs @ v)
        errors.append(np.linalg.norm(observer.acceleration - load))
        v = rng.normal(size=9)
        observer.expect(transition @ z + observer.drift)
        z = transition @ z + inputs @ v + push @ load
    assert np.allclose(np.diff(np.log(errors[1:20])), np.log(0.7), atol=1e-6)
    shift, effort = observer.rest(np.zeros((1, 9)))
    rest = np.r_[shift[0], np.zeros(9)]
    left = transition @ rest + inputs @ effort[0] + observer.drift - rest
    assert np.linalg.norm(left) < 1e-6 * np.linalg.norm(rest)
    assert np.abs(tracked @ shift[0]).max() < 1e-4 * np.linalg.norm(shift[0])
