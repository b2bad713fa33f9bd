"""MPC and LQR that command rest lengths, from soft to stiff strings."""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.demo import tour as demo
from tenscontrol.plant.linear_plant import sampled
from tenscontrol.plant.reference import ReferencePreview
from tenscontrol.plant.string_outputs import string_map

SAMPLE = 0.02
STILL = np.zeros((3, 6))
TARGET = demo.prism_of_height(tc.prism(), demo.TARGET)


def strings(stiffness, damped=False):
    """Return strings that lose a few percent of a vibration's amplitude a radian, if damped."""
    return tc.LinearStrings(stiffness, damping=0.02 * np.sqrt(stiffness) if damped else 0.0)


@cache
def at_target(stiffness, damped=False):
    model = tc.Model(TARGET, strings=strings(stiffness, damped))
    rest = tc.prestress(TARGET, demo.TOP_FORCE_DENSITY)
    return tc.linearize(model, rest, input="rest_length")


def kick(plant, share=0.2):
    """Return velocities whose energy is a share of what all strings store, so that none slackens.

    A stiff string stores little: T²/2k. The softest motion, the twist, is left out: strings
    act on it through the prestress alone, and it dies away in many seconds.
    """
    stretch = plant.model.structure.string_length(plant.nodes) - plant.rest_length
    stored = 0.5 * float((plant.model.strings.stiffness * stretch**2).sum())
    rates = np.random.default_rng(0).normal(size=plant.degrees_of_freedom)
    r = plant.degrees_of_freedom
    modes = np.linalg.eigh(-0.5 * (plant.A[r:, :r] + plant.A[r:, :r].T))[1]
    rates -= modes[:, 0] * (modes[:, 0] @ rates)
    rates *= np.sqrt(2 * share * stored / 9) / np.linalg.norm(rates)
    return plant.to_velocities(np.zeros(plant.degrees_of_freedom), rates)


def step_for(plant):
    return min(2e-3, 0.15 / np.abs(np.linalg.eigvals(plant.A)).max())


def vibration(plant, nodes, velocities):
    """Return the energy of a motion in the modes of stretching strings, all but the softest."""
    r = plant.degrees_of_freedom
    z = plant.measure(nodes, velocities)
    sizes, modes = np.linalg.eigh(-0.5 * (plant.A[r:, :r] + plant.A[r:, :r].T))
    q, rates = modes.T @ z[:r], modes.T @ z[r:]
    return 0.5 * (sizes * q**2 + rates**2)[1:].sum()


@pytest.mark.parametrize("stiffness", [1e2, 1e3, 1e4, 1e5, 1e6])
@pytest.mark.parametrize("kind", ["lqr", "mpc"])
def test_target_is_held_after_a_push_whatever_the_stiffness(stiffness, kind):
    """Undamped strings: what takes the vibration out is the controller alone."""
    plant = at_target(stiffness)
    if kind == "mpc":
        controller = tc.MPC(plant, horizon=20, sample_time=SAMPLE)
    else:
        Q, R = tc.energy_weights(plant, by_mode=True)
        controller = tc.LQR(plant, Q, R, sample_time=SAMPLE)
        assert controller.riccati_residual < 1e-9
    start, duration = kick(plant), 2.0 if stiffness < 1e5 else 0.5
    run = tc.simulate(
        plant.model, duration, TARGET.nodes, start, controller=controller, step=step_for(plant)
    )
    height = demo.height_of(run.nodes)
    late = run.time > duration - 0.1
    assert np.abs(height[late] - demo.TARGET).max() < 1e-3
    before = vibration(plant, TARGET.nodes, start)
    after = vibration(plant, run.nodes[:, :, -1], run.velocities[:, :, -1])
    assert after < 0.5 * before
    assert run.force_density.min() > 0
    assert set(run.control.status) == {"ok"}


@pytest.mark.parametrize(("stiffness", "damped", "ramp"), [
    (1e2, False, 2.0), (1e4, True, 2.0), (1e4, False, 6.0),
])  # fmt: skip
def test_new_height_is_reached_by_winches(stiffness, damped, ramp):
    """A winch that stands still within samples jerks strings; undamped stiff ones need time."""
    prism = tc.prism()
    plant = at_target(stiffness, damped)
    winches = tc.Winches(rate=0.5, shortest=0.1)
    mpc = tc.MPC(
        plant,
        horizon=15,
        sample_time=SAMPLE,
        reference=demo.ramp(prism, 1.0, demo.TARGET, ramp),
        winches=winches,
    )
    rest = tc.prestress(prism, demo.TOP_FORCE_DENSITY)
    wound = tc.to_rest_length(plant.model, prism.nodes, rest.force_density).rest_length
    run = tc.simulate(
        plant.model, ramp + 1.0, prism.nodes, controller=mpc, winches=winches, rest_length=wound,
        step=step_for(plant),
    )  # fmt: skip
    height = demo.height_of(run.nodes[:, :, run.time > ramp + 0.5])
    assert np.abs(height - demo.TARGET).max() < 1e-3
    assert run.control.rate_limited.sum() == 0
    assert run.control.range_limited.sum() == 0


@pytest.mark.parametrize("stiffness", [1e2, 1e6])
def test_first_input_without_active_limits_is_that_of_the_discrete_lqr(stiffness):
    plant = at_target(stiffness)
    Q, R = tc.energy_weights(plant, by_mode=True)
    mpc = tc.MPC(
        plant, horizon=5, sample_time=SAMPLE, Q=Q, R=R, tolerance=1e-9, max_iterations=20000
    )
    law = tc.LQR(plant, Q, R, sample_time=SAMPLE)
    pushed = kick(plant, share=1e-3)
    for velocities in (STILL, pushed):
        found, wanted = (
            each.command(0.0, plant.nodes, velocities).value - plant.rest_length
            for each in (mpc, law)
        )
        stretch = TARGET.string_length(TARGET.nodes) - plant.rest_length
        assert np.allclose(found / stretch, wanted / stretch, atol=1e-5)
    assert np.abs(wanted / stretch).max() > 1e-3


@pytest.mark.parametrize("stiffness", [1e2, 1e4, 1e6])
def test_sampled_prediction_is_that_of_the_nonlinear_plant(stiffness):
    """One sample with wound strings: stiff ones vibrate many times within it."""
    plant = at_target(stiffness)
    inputs = plant.discretize(SAMPLE)[1]
    stretch = TARGET.string_length(TARGET.nodes) - plant.rest_length
    errors = []
    for share in (0.2, 0.1):
        v = share * stretch * np.random.default_rng(1).uniform(-1, 1, 9)
        run = tc.simulate(
            plant.model, SAMPLE, TARGET.nodes, rest_length=plant.rest_length + v,
            step=0.1 * step_for(plant),
        )  # fmt: skip
        found = plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
        errors.append(np.linalg.norm(found - inputs @ v) / np.linalg.norm(inputs @ v))
    assert errors[0] < 0.05
    # What is left is second order, down to the error of integration.
    assert errors[1] < max(0.6 * errors[0], 1e-4)


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_first_order_strings_are_those_of_the_model(held):
    plant = at_target(1e3)
    found = string_map(plant, held)
    rng = np.random.default_rng(2)
    q, v = 1e-6 * rng.normal(size=9), 1e-6 * rng.normal(size=9)
    nodes = plant.to_nodes(q)
    length = TARGET.string_length(nodes)
    gamma = plant.force_density + v
    if held == "rest_length":
        gamma = plant.model.strings.force_density(length, plant.rest_length + v)
    z = np.r_[q, np.zeros(9)]
    for name, value, start in (
        ("gamma", gamma, found.force_density),
        ("tension", gamma * length, found.tension),
    ):
        change = getattr(found, f"{name}_by_state") @ z + getattr(found, f"{name}_by_input") @ v
        assert np.allclose(value - start, change, rtol=1e-3, atol=1e-3 * np.abs(change).max())


def test_path_holds_each_shape_of_a_reference():
    """Rest lengths along the way balance all forces there, and shapes in balance drift nowhere."""
    prism = tc.prism()
    plant = at_target(1e4)
    reference = demo.ramp(prism, 1.0, demo.TARGET, 2.0)
    path = ReferencePreview(plant, reference, sampled(plant, SAMPLE, False))
    stretch = path.at(reference.time[[0, 7, 40]])
    for k, at in enumerate((0, 7, 40)):
        nodes = reference.nodes[:, :, at]
        rest = tc.prestress(
            demo.prism_of_height(prism, demo.height_of(nodes[:, :, None])[0]),
            demo.TOP_FORCE_DENSITY,
        )
        wound = tc.to_rest_length(plant.model, nodes, rest.force_density).rest_length
        assert np.allclose(stretch.input[k], wound, atol=1e-9)
        assert np.abs(stretch.drift[k]).max() < 1e-9


def test_shape_out_of_balance_shows_as_drift():
    plant = at_target(1e3)
    # Turned tops: no force density holds that.
    angle = 0.2
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0]])
    q = plant.measure(np.vstack([
        np.hstack([(turn @ TARGET.nodes)[:, :3], TARGET.nodes[:2, 3:]]), TARGET.nodes[2:]
    ]), STILL)[:9]  # fmt: skip
    shape = plant.to_nodes(q)
    reference = tc.Reference([0.0], shape[:, :, None])
    path = ReferencePreview(plant, reference, sampled(plant, SAMPLE, False))
    stretch = path.at(np.zeros(1))
    run = tc.simulate(plant.model, SAMPLE, shape, rest_length=stretch.input[0], step=1e-4)
    found = plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
    moved = found - stretch.rest[0]
    assert np.linalg.norm(moved) > 1e-5
    assert np.linalg.norm(moved - stretch.drift[0]) < 0.2 * np.linalg.norm(moved)


@pytest.mark.parametrize("solver", ["auto", "osqp"])
def test_commands_keep_range_and_rate_of_the_winches(solver):
    plant = at_target(1e3)
    shortest = plant.rest_length - 0.003
    winches = tc.Winches(rate=0.05, shortest=shortest, longest=plant.rest_length + 0.004)
    mpc = tc.MPC(
        plant, horizon=8, sample_time=SAMPLE, solver=solver, winches=winches, tolerance=1e-3
    )
    rng, last = np.random.default_rng(3), plant.rest_length
    for k in range(20):
        nodes = plant.to_nodes(0.01 * rng.normal(size=9))
        command = mpc.command(SAMPLE * k, nodes, STILL)
        assert command.status == "ok"
        assert (command.value >= shortest).all()
        assert (command.value <= plant.rest_length + 0.004).all()
        assert np.abs(command.value - last).max() <= 0.05 * SAMPLE * (1 + 1e-9)
        last = command.value


def test_bad_measurement_leaves_the_winches_where_they_are():
    plant = at_target(1e3)
    mpc = tc.MPC(plant, horizon=3, sample_time=SAMPLE)
    first = mpc.command(0.0, plant.nodes, kick(plant)).value
    broken = np.full((3, 6), np.nan)
    for k in range(1, 5):
        command = mpc.command(SAMPLE * k, broken, STILL)
    assert str(command) == "measurement not finite: previous input held"
    assert np.isfinite(command.value).all()
    assert np.abs(command.value - first).max() < 0.01


def test_weights_by_mode_are_the_energy_of_any_vibration():
    plant = at_target(1e4)
    Q, _ = tc.energy_weights(plant, by_mode=True)
    transition, _, _ = plant.discretize(SAMPLE)
    left = transition.T @ Q @ transition - Q
    assert np.abs(left).max() < 1e-9 * np.abs(Q).max()
