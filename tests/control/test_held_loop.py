"""Where a law in γ holds on winches, and where it does not: prediction and nonlinear prism."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import held_loop
from tenscontrol.demo import tour as demo

SAMPLE = 0.02


def designed(stiffness, weight):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness))
    target = demo.prism_of_height(prism, demo.TARGET)
    plant = tc.linearize(model, tc.prestress(target, demo.TOP_FORCE_DENSITY))
    Q, R = tc.energy_weights(plant)
    reference = demo.ramp(prism, 1.0, demo.TARGET, 1.5)
    return tc.MPC(
        plant,
        horizon=10,
        sample_time=SAMPLE,
        max_force_density=55.0,
        Q=Q,
        R=weight * R,
        reference=reference,
    )


def worst_height(mpc):
    """Return the largest error of the height in the last half second, m."""
    plant = mpc.plant
    step = min(2e-3, 0.15 / np.sqrt(12 * plant.model.strings.stiffness.max()))
    run = tc.simulate(plant.model, 3.5, tc.prism().nodes, controller=mpc, step=step)
    return np.abs(demo.height_of(run.nodes)[run.time > 3.0] - demo.TARGET).max()


@pytest.mark.parametrize(("stiffness", "weight"), [(1e2, 0.1), (1e3, 0.1), (3e2, 1.0)])
def test_loops_that_are_said_to_hold_do(stiffness, weight):
    mpc = designed(stiffness, weight)  # warnings are errors
    assert worst_height(mpc) < 1e-3


@pytest.mark.parametrize(("stiffness", "weight"), [(1e3, 10.0), (2e3, 1.0), (1e4, 0.1)])
def test_loops_that_are_said_not_to_hold_do_not(stiffness, weight):
    with pytest.warns(RuntimeWarning, match=r"input='rest_length'.*without a string law"):
        mpc = designed(stiffness, weight)
    assert worst_height(mpc) > 1e-3


def test_model_without_string_law_is_not_warned_of():
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, 17.3205))
    tc.MPC(plant, horizon=5, sample_time=SAMPLE, max_force_density=60.0)
    with pytest.raises(ValueError, match="no string law"):
        held_loop(plant, np.zeros((9, 18)), sample_time=SAMPLE)


def test_prediction_is_what_a_small_motion_does():
    """The slowest decay seen on the nonlinear prism is the predicted radius."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(2e3))
    plant = tc.linearize(model, tc.prestress(prism, 17.3205))
    Q, R = tc.energy_weights(plant)
    law = tc.LQR(plant, Q, 0.1 * R, sample_time=SAMPLE)
    loop = held_loop(plant, law.gain, sample_time=SAMPLE)
    assert loop.radius > 1
    assert not loop.holds
    # A start that has a part in the growing mode.
    start = plant.to_nodes(plant.basis.T @ (1e-6 * np.random.default_rng(2).normal(size=18)))
    law = tc.LQR(plant, Q, 0.1 * R, sample_time=SAMPLE, max_force_density=1e3)
    run = tc.simulate(model, 16.0, start, controller=law, step=1e-3)
    at = np.searchsorted(run.time, run.control.time[-151:] - 1e-9)
    size = [np.linalg.norm(plant.measure(run.nodes[:, :, k], run.velocities[:, :, k])) for k in at]
    grown = (np.mean(size[-20:]) / np.mean(size[:20])) ** (1 / 131)
    assert grown == pytest.approx(loop.radius, abs=1e-3)
