"""Winches that wind through a sample: what is simulated, and what MPC predicts."""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Status
from tenscontrol.control.mpc.settings import MPCSettings, design
from tenscontrol.demo import tour as demo
from tenscontrol.plant.linear_plant import sampled

SAMPLE = 0.02
STILL = np.zeros((3, 6))


@cache
def plant_of(stiffness=1e3):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness, damping=0.02 * stiffness**0.5))
    rest = tc.prestress(prism, force_density=demo.TOP_FORCE_DENSITY)
    return tc.linearize(model, rest, input="rest_length")


class Winding(tc.control.Controller):
    """Asks for one change of the rest lengths, at once."""

    def __init__(self, plant, change):
        start = plant.rest_length
        super().__init__(plant, SAMPLE, 0.5 * start, 2 * start)
        self.change = change

    def reset(self):
        pass

    def _decide(self, time, state):
        return tc.control.Command(self.plant.rest_length + self.change)

    def _fall_back(self, reason):
        raise AssertionError(reason)


def run_of(plant, change, substeps, duration=SAMPLE, **options):
    return tc.simulate(
        plant.model, duration, controller=Winding(plant, change), step=1e-4,
        winches=tc.Winches(substeps=substeps), rest_length=plant.rest_length, **options,
    )  # fmt: skip


def test_a_winch_winds_at_constant_speed_through_the_sample():
    plant = plant_of()
    change = 1e-3 * np.arange(1.0, 10.0)
    run = run_of(plant, change, 5, duration=2 * SAMPLE, output_step=SAMPLE / 5)
    np.testing.assert_allclose(run.time, np.arange(11) * SAMPLE / 5, atol=1e-12)
    wound = run.rest_length - plant.rest_length[:, None]
    shares = np.minimum(np.arange(11) / 5, 1.0)
    np.testing.assert_allclose(wound, change[:, None] * shares, atol=1e-12)
    # The record is of whole samples.
    np.testing.assert_allclose(run.control.winch_rate, np.outer(change / SAMPLE, [1, 0]))
    np.testing.assert_allclose(run.control.applied[:, 0], plant.rest_length + change)


def test_the_last_sample_may_be_cut_short():
    plant = plant_of()
    run = run_of(plant, 1e-3 * np.ones(9), 4, duration=0.6 * SAMPLE, output_step=SAMPLE)
    np.testing.assert_allclose(run.time, [0.0, 0.6 * SAMPLE])
    wound = run.rest_length[:, -1] - plant.rest_length
    np.testing.assert_allclose(wound, 0.6e-3, rtol=1e-9)


def test_jumps_that_are_ever_smaller_converge_to_the_ramp():
    """Jumps at the start of each part of the sample lead the ramp by half a part."""
    plant = plant_of()
    change = 2e-3 * np.random.default_rng(0).uniform(-1, 1, 9)
    ramp, off = run_of(plant, change, 5).nodes[:, :, -1], []
    for count in (5, 10, 20):
        nodes, speeds = plant.nodes, STILL
        for part in range(count):
            run = tc.simulate(
                plant.model, SAMPLE / count, nodes, speeds, step=1e-4,
                rest_length=plant.rest_length + (part + 1) / count * change,
            )  # fmt: skip
            nodes, speeds = run.nodes[:, :, -1], run.velocities[:, :, -1]
        off.append(np.abs(nodes - ramp).max())
    assert off[0] / off[1] == pytest.approx(2.0, rel=0.2)
    assert off[1] / off[2] == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("pieces", [1, 7])
def test_the_model_of_a_sample_is_that_of_the_nonlinear_plant(pieces):
    plant = plant_of()
    model = sampled(plant, SAMPLE, pieces > 1)
    errors = []
    for size in (2e-4, 1e-4):
        change = size * np.random.default_rng(1).uniform(-1, 1, 9)
        run = run_of(plant, change, pieces)
        found = plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
        expected = model.by_input @ change
        errors.append(np.linalg.norm(found - expected) / np.linalg.norm(expected))
    assert errors[0] < 0.02
    assert errors[1] < 0.6 * errors[0]


def test_a_jump_is_the_zero_order_hold_and_a_ramp_adds_up():
    plant = plant_of()
    transition, input_matrix, drift = plant.discretize(SAMPLE)
    jump, wind = (sampled(plant, SAMPLE, ramp) for ramp in (False, True))
    assert not jump.ramp
    assert not jump.by_previous.any()
    for model in (jump, wind):
        np.testing.assert_allclose(model.transition, transition, atol=1e-9)
        # An input that does not change acts alike.
        np.testing.assert_allclose(model.by_previous + model.by_input, input_matrix, atol=1e-9)
        np.testing.assert_allclose(model.drift, drift, atol=1e-9)


def test_prediction_and_limits_of_winding_winches_are_those_of_the_plant():
    """What the program plans is what the linear plant then does, and γ is limited at the ends."""
    plant = plant_of()
    N, winches = 4, tc.Winches(rate=0.1, substeps=6)
    settings = MPCSettings(horizon=N, sample_time=SAMPLE, min_force_density=5.0, winches=winches)
    made = design(plant, settings)
    mpc = tc.MPC(plant, horizon=N, sample_time=SAMPLE, winches=winches, min_force_density=5.0)
    nodes = plant.to_nodes(np.random.default_rng(2).normal(size=9) * 2e-3)
    mpc.command(0.0, nodes, STILL)
    v = mpc.plan.T - plant.rest_length
    z, before = plant.measure(nodes, STILL), np.zeros(9)
    count = 3000
    fine = plant.discretize(SAMPLE / count)
    augmented = np.r_[z, before]
    block = made.problem.rows
    for k in range(N):
        for part in range(count):
            share = (part + 0.5) / count
            z = fine[0] @ z + fine[1] @ ((1 - share) * before + share * v[k])
        augmented = made.problem.transition @ augmented + made.problem.input_matrix @ v[k]
        np.testing.assert_allclose(augmented[:18], z, atol=1e-7)
        np.testing.assert_array_equal(augmented[18:], v[k])
        before = v[k]
        gamma = tc.to_force_density(plant.model, plant.to_nodes(z[:9]), plant.rest_length + v[k])
        still = augmented.copy()
        still[9:18] = 0.0
        row = plant.force_density + block.by_next_state @ still + block.by_input @ v[k]
        assert np.abs(row - gamma).max() < 0.05 * np.abs(gamma - plant.force_density).max() + 1e-3


@pytest.mark.parametrize("stiffness", [1e3, 1e5])
def test_a_height_is_reached_by_winding_where_jumps_slacken_strings(stiffness):
    prism = tc.prism()
    target = demo.prism_of_height(prism, 0.95)
    strings = tc.LinearStrings(stiffness, damping=0.02 * stiffness**0.5)
    model = tc.Model(target, strings=strings)
    plant = tc.linearize(model, tc.prestress(target, demo.TOP_FORCE_DENSITY), input="rest_length")
    reference = demo.ramp(prism, 1.0, 0.95, 1.0)
    rest = tc.prestress(prism, demo.TOP_FORCE_DENSITY)
    wound = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    slackest = {}
    for pieces in (1, 40):
        winches = tc.Winches(rate=0.2, substeps=pieces)
        mpc = tc.MPC(plant, horizon=10, sample_time=SAMPLE, reference=reference, winches=winches)
        run = tc.simulate(
            model, 1.5, prism.nodes, controller=mpc, winches=winches, rest_length=wound,
            step=5e-4,
        )  # fmt: skip
        slackest[pieces] = run.force_density.min()
    assert slackest[40] > 1.0
    assert abs(demo.height_of(run.nodes)[-1] - 0.95) < 1e-3
    assert np.abs(run.control.winch_rate).max() <= 0.2 * (1 + 1e-9)
    if stiffness > 1e4:
        assert slackest[1] == 0.0


def test_both_solvers_give_the_same_inputs():
    plant = plant_of()
    nodes = plant.to_nodes(np.random.default_rng(3).normal(size=9) * 2e-3)
    commands = [
        tc.MPC(
            plant,
            horizon=5,
            sample_time=SAMPLE,
            solver=each,
            winches=tc.Winches(rate=0.05, substeps=8),
            tolerance=1e-8,
            max_iterations=50000,
        ).command(0.0, nodes, STILL)
        for each in ("auto", "osqp")
    ]
    np.testing.assert_allclose(commands[0].value, commands[1].value, atol=1e-6)


def regulator(plant, pieces):
    Q, R = tc.energy_weights(plant)
    return tc.LQR(plant, Q, R, sample_time=SAMPLE, winches=tc.Winches(rate=0.5, substeps=pieces))


def test_the_regulator_is_that_of_the_state_and_of_what_winches_hold():
    """Its commands, sample after sample, give the linear loop the poles that it states."""
    plant = plant_of(1e4)
    law = regulator(plant, 20)
    s, a = plant.B.shape
    model = sampled(plant, SAMPLE, True)
    loop = np.zeros((s + a, s + a))
    for i, unit in enumerate(1e-7 * np.eye(s + a)):
        state, held = unit[:s], plant.rest_length + unit[s:]
        law.applied(held)
        wanted = law._decide(0.0, state)
        assert wanted.status is Status.OK
        off = wanted.value - plant.rest_length
        end = model.transition @ state + model.by_previous @ unit[s:] + model.by_input @ off
        loop[:, i] = np.concatenate([end, off]) / 1e-7
    found = np.linalg.eigvals(loop)
    assert len(law.poles) == s + a
    for pole in law.poles:
        assert np.abs(found - pole).min() < 1e-6
    assert np.abs(found).max() < 1.0


def test_the_regulator_knows_winches_that_wind():
    """One that takes them for winches that jump lets strings of 1e4 N/m go slack."""
    plant = plant_of(1e4)
    winches = tc.Winches(rate=0.5, substeps=20)
    speeds = plant.to_velocities(
        np.zeros(9), plant.basis.T @ (0.02 * np.random.default_rng(0).normal(size=18))
    )
    least = []
    for law in (regulator(plant, 20), regulator(plant, 1)):
        run = tc.simulate(
            plant.model, 1.0, plant.nodes, speeds, controller=law, winches=winches,
            rest_length=plant.rest_length, step=8e-4, output_step=SAMPLE,
        )  # fmt: skip
        least.append(run.force_density.min())
        if law.previous_input_gain is not None:
            end = plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
            assert np.abs(end[:9]).max() < 2e-4
    assert least[0] > 14.0
    assert least[1] == 0.0


def test_a_regulator_without_samples_knows_no_winding():
    plant = plant_of()
    with pytest.raises(ValueError, match=r"winches\.substeps is 5.*give sample_time"):
        tc.LQR(plant, 1.0, 1.0, winches=tc.Winches(substeps=5))
