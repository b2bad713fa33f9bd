"""A controller that was used and reset gives the commands of a fresh one, to the last bit."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.deploy import scenes


def shape_control():
    plant = scenes.plant("force_density")
    return tc.FeedbackLinearization(
        plant,
        reference=None,
        sample_time=scenes.SAMPLE,
        max_force_density=60.0,
        frequency=1.0,
        max_change=3.0,
    )


def regulator():
    plant = scenes.plant("force_density")
    return tc.LQR(
        plant,
        *tc.energy_weights(plant),
        sample_time=scenes.SAMPLE,
        max_force_density=60.0,
        max_change=3.0,
    )


def nonlinear_winding():
    """By implicit steps, whose programs OSQP scales."""
    strings = tc.LinearStrings(1e4, damping=2.0)
    rest = tc.prestress(tc.prism(), 17.3205)
    plant = tc.linearize(tc.Model(tc.prism(), strings=strings), rest, input="rest_length")
    return tc.NMPC(
        plant, horizon=3, sample_time=scenes.SAMPLE, winches=tc.Winches(rate=0.1, substeps=10)
    )


KINDS = [
    regulator, shape_control, scenes.of_force_density, scenes.of_rest_length,
    scenes.with_load, scenes.winding, scenes.nonlinear, scenes.nonlinear_of_rest_length,
    scenes.nonlinear_with_load, nonlinear_winding,
]  # fmt: skip


def commands(controller, seed, samples, size):
    """Return commands to motions at random, one of them lost and one actuator stuck."""
    rng, plant = np.random.default_rng(seed), controller.plant
    given = []
    for k in range(samples):
        nodes = plant.to_nodes(size * rng.normal(size=9))
        speeds = plant.to_velocities(np.zeros(9), 10 * size * rng.normal(size=9))
        if k == 3:
            speeds = np.full_like(speeds, np.nan)
        command = controller.command(k * scenes.SAMPLE, nodes, speeds)
        given.append(command.value)
        if k == 2:
            controller.applied(0.999 * command.value)
    return np.array(given)


@pytest.mark.parametrize("make", KINDS)
def test_reset_is_a_fresh_start(make):
    used, fresh = make(), make()
    # Hard pushes make the solver adapt its step.
    commands(used, 0, 6, 0.03)
    used.reset()
    np.testing.assert_array_equal(commands(used, 1, 4, 0.005), commands(fresh, 1, 4, 0.005))
