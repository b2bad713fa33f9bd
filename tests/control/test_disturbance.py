"""Offset-free tracking under a load that the model does not know."""

import numpy as np
import pytest
from scipy.linalg import expm

import tenscontrol as tc
from tenscontrol.control.disturbance import LoadObserver, load_model
from tenscontrol.demo import tour as demo
from tenscontrol.plant.linear_plant import acceleration_response
from tests.known_structures import height_row

SAMPLE, LOAD = 0.02, 2.0


def final_height(load_gain, duration):
    """Return the mean height over the last second of a run under 2 N that pull at both ends, m."""
    prism = tc.prism()
    pull = np.zeros((3, 6))
    pull[2, :3], pull[2, 3:] = LOAD / 3, -LOAD / 3
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, demo.TOP_FORCE_DENSITY))
    tracked = None if load_gain is None else height_row()
    mpc = tc.MPC(
        plant,
        horizon=10,
        sample_time=SAMPLE,
        max_force_density=80.0,
        load_gain=load_gain,
        tracked=tracked,
    )
    loaded = tc.Model(prism, external_force=pull)
    run = tc.simulate(loaded, duration, controller=mpc, step=4e-3, output_step=SAMPLE)
    assert mpc.statistics.fallbacks == 0
    late = np.flatnonzero(run.time > duration - 1.0)
    shapes = [
        plant.to_nodes(plant.measure(run.nodes[:, :, k], run.velocities[:, :, k])[:9]) for k in late
    ]
    return np.array([demo.height_of(N[:, :, None])[0] for N in shapes]), mpc


def test_unknown_load_leaves_no_offset_where_it_is_estimated():
    without, _ = final_height(None, 15.0)
    height, mpc = final_height(0.1, 30.0)
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
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(1e3))
    plant = tc.linearize(model, tc.prestress(prism, 17.3205), input=held)
    push = acceleration_response(plant, SAMPLE)
    tracked = height_row() @ plant.basis
    observer = LoadObserver(load_model(plant, push, 0.3, tracked))
    transition, inputs, _ = plant.discretize(SAMPLE)
    rng = np.random.default_rng(0)
    load, z, v, errors = rng.normal(size=9), np.zeros(18), np.zeros(9), []
    for _ in range(30):
        observer.correct(z, inputs @ v)
        errors.append(np.linalg.norm(observer.acceleration - load))
        v = rng.normal(size=9)
        observer.expect(transition @ z + observer.model.response @ observer.acceleration)
        z = transition @ z + inputs @ v + push @ load
    assert np.allclose(np.diff(np.log(errors[1:20])), np.log(0.7), atol=1e-6)
    shift, effort = observer.model.rest(observer.acceleration[None])
    rest = np.r_[shift[0], np.zeros(9)]
    left = (
        transition @ rest
        + inputs @ effort[0]
        + observer.model.response @ observer.acceleration
        - rest
    )
    assert np.linalg.norm(left) < 1e-6 * np.linalg.norm(rest)
    assert np.abs(tracked @ shift[0]).max() < 1e-4 * np.linalg.norm(shift[0])


def controlled(kind, plant, pieces):
    """Return a controller that estimates, and what a sample does, ``(z, before, v) -> z``."""
    winches = tc.Winches(rate=0.2, shortest=0.4, longest=1.3, substeps=pieces)
    if kind == "NMPC":
        made = tc.NMPC(plant, horizon=4, sample_time=SAMPLE, winches=winches, load_gain=0.5)
        return made, lambda z, before, now: made.sampled(z, now).full().ravel()
    made = tc.MPC(plant, horizon=8, sample_time=SAMPLE, winches=winches, load_gain=0.5)
    (states, inputs), ramp = plant.B.shape, pieces > 1
    exponent = np.zeros((states + 2 * inputs,) * 2)  # of [z; v; what v gains in the sample]
    exponent[:states, : states + inputs] = SAMPLE * np.hstack([plant.A, plant.B])
    exponent[states : states + inputs, states + inputs :] = ramp * np.eye(inputs)
    grown = expm(exponent)[:states]

    def sample(z, before, now):
        start = before if ramp else now
        return grown @ np.concatenate([z, start - plant.rest_length, now - before])

    return made, sample


@pytest.mark.parametrize(("kind", "pieces"), [("MPC", 1), ("MPC", 6), ("NMPC", 1)])
def test_the_load_is_found_exactly_whatever_the_winches_do(kind, pieces):
    """Two winches stick, one is slower than it should be, and three measurements are lost."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(200.0, damping=0.3))
    plant = tc.linearize(model, tc.prestress(prism, 17.3205), input="rest_length")
    made, sample = controlled(kind, plant, pieces)
    push = acceleration_response(plant, SAMPLE)
    load = 0.3 * np.random.default_rng(0).normal(size=9)
    z, stands, off, statuses = np.zeros(18), plant.rest_length, [], []
    made.applied(stands)
    for k in range(60):
        lost = np.nan if 20 <= k < 23 else 1.0
        q, rates = np.split(z, 2)
        command = made.command(k * SAMPLE, lost * plant.to_nodes(q), plant.to_velocities(q, rates))
        statuses.append(command.status)
        off.append(np.linalg.norm(made.load - load))
        moved = command.value.copy()
        if k > 4:
            moved[:2] = stands[:2]
        moved[5] = np.clip(moved[5], stands[5] - 2e-4, stands[5] + 2e-4)
        z = sample(z, stands, moved) + push @ load
        stands = moved
        made.applied(stands)
    # Halved by each comparison: none at the first sample, while blind, and at the first after.
    compared = np.cumsum([k not in (0, 20, 21, 22, 23) for k in range(60)])
    np.testing.assert_allclose(off[:40], off[0] * 0.5 ** compared[:40], rtol=1e-6, atol=1e-11)
    assert off[-1] < 1e-10
    assert statuses.count("ok") == 57
    assert np.abs(z).max() > 1e-3  # it did move


@pytest.mark.parametrize("kind", ["MPC", "NMPC"])
def test_a_shape_without_dynamics_spoils_no_estimate(kind):
    """Bars turned round have their lengths; the coordinates do not reach where they go."""
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, 17.3205))
    made = getattr(tc, kind)(
        plant, horizon=4, sample_time=SAMPLE, max_force_density=60.0, load_gain=0.5
    )
    rng, still = np.random.default_rng(1), np.zeros((3, 6))
    start, end = prism.bars.T
    for k in range(60):
        middle = (prism.nodes[:, start] + prism.nodes[:, end]) / 2
        along = rng.normal(size=(3, 3))
        along *= prism.bar_length / 2 / np.linalg.norm(along, axis=0)
        nodes = np.empty((3, 6))
        nodes[:, start], nodes[:, end] = middle - along, middle + along
        assert np.isfinite(
            made.command(k * SAMPLE, nodes, 10 * rng.normal(size=(3, 6))).value
        ).all()
        assert np.isfinite(made.load).all()
    assert made.command(2.0, prism.nodes, still).status == "ok"
