"""Inputs, loads and supports that change in time, against an oracle that ends at each kink."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics import Evaluator, pack_state
from tests.simulation.piecewise import integrated

TIME = np.array([0.0, 0.03, 0.07, 0.15])


def scene(structure, damping=0.0, **options):
    """A model, its rest lengths in equilibrium, and some over time that let strings go slack."""
    model = tc.Model(structure, strings=tc.LinearStrings(400.0, damping), **options)
    gamma = tc.prestress(structure, force_density=20.0).force_density
    lengths = tc.to_rest_length(model, structure.nodes, gamma).rest_length
    moved = np.random.default_rng(1).uniform(-0.25, 0.25, (len(lengths), len(TIME)))
    moved[:, 0] = 0.0
    return model, lengths, lengths[:, None] * (1 + moved)


def oracle(model, profile, until=TIME[-1], load=None):
    """State at the end and switches."""
    structure = model.structure
    equation = model.equation("rest_length")
    slope, gap = Evaluator(equation.slope), Evaluator(equation.gap)
    breaks = [0.0, *(t for t in profile.time if 0 < t < until), until]
    return integrated(
        lambda t, x, taut: slope(x, profile.at(t), taut)[0].copy(),
        lambda t, x: gap(x, profile.at(t))[0].copy(),
        pack_state(structure, structure.nodes, np.zeros_like(structure.nodes)),
        breaks,
    )


def end(run):
    return pack_state(run.structure, run.nodes[:, :, -1], run.velocities[:, :, -1])


@pytest.mark.parametrize("interpolation", ["hold", "linear", "cubic"])
def test_rest_lengths_follow_a_profile(interpolation):
    ball = tc.library.six_bar_ball(bar_length=1.0)
    model, _, values = scene(ball)
    profile = tc.Profile(TIME, values, interpolation)
    exact, switches = oracle(model, profile)
    errors = []
    for step in (1e-3, 5e-4, 2.5e-4):
        run = tc.simulate(model, TIME[-1], rest_length=profile, step=step)
        errors.append(np.abs(end(run) - exact)[: ball.nodes.size].max())
    assert run.work.switches == switches > 10
    assert errors[-1] < 1e-9
    assert np.log2(errors[0] / errors[-1]) / 2 > 3.8
    at = [profile.at(t) for t in run.time[1:]]
    assert (run.rest_length[:, 0] == values[:, 0]).all()
    before = np.isin(run.time, TIME)  # at a jump, the value before it
    np.testing.assert_allclose(
        run.rest_length[:, 1:][:, ~before[1:]], np.array(at).T[:, ~before[1:]]
    )
    assert not run.conserves_energy
    assert run.health.energy_error is None
