"""Designs on what strings reach; what they do not reach is left alone, or refused."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.machine_code import compiler
from tenscontrol.plant.linear_plant import sampled
from tenscontrol.plant.riccati import regulator
from tenscontrol.robustness import farthest_node
from tests.control.reached import (
    campaign,
    controlled_part,
    disturbed,
    known_plant,
    known_structures,
    moved_reference,
    oracle,
)
from tests.deploy import scenes

SAMPLE = 0.02
LEFT = {"six-bar ball": 1, "six-bar ball on a face": 0, "X frame in space": 1, "prism(6)": 1,
        "radial net": 8}  # fmt: skip


def quiet(make, *arguments, **settings):
    """Make a controller without the warning of modes left alone."""
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        return make(*arguments, **settings)


# ---- known structures ----


def test_every_known_structure_is_here():
    assert set(known_structures()) == set(LEFT)


@pytest.mark.parametrize("name", LEFT)
def test_a_regulator_brings_back_all_but_what_is_left_alone(name):
    plant = known_plant(name)
    law = quiet(tc.LQR, plant, sample_time=SAMPLE)
    assert len(law.left_alone) == LEFT[name]
    assert np.count_nonzero(np.abs(law.poles) < 1 - 1e-9) == len(plant.A) - 2 * LEFT[name]
    np.testing.assert_allclose(np.abs(law.poles[len(plant.A) - 2 * LEFT[name] :]), 1.0, rtol=1e-9)
    run = tc.simulate(
        plant.model, 1.0, disturbed(plant, 0.02), controller=law, step=2e-3, output_step=SAMPLE
    )
    sizes = controlled_part(plant, run)
    slowest = np.abs(law.poles[: len(plant.A) - 2 * LEFT[name]]).max()
    # What swings on disturbs the others a little, to second order.
    assert sizes[-1] < (2 * slowest ** (1 / SAMPLE) + 0.01) * sizes[0]
    assert set(run.control.status_count) == {tc.control.Status.OK}


@pytest.mark.parametrize(
    ("name", "make", "horizon"),
    [("six-bar ball", tc.MPC, 8), ("X frame in space", tc.NMPC, 4), ("radial net", tc.MPC, 8)],
)
def test_predictive_controllers_bring_back_what_strings_reach(name, make, horizon):
    plant = known_plant(name)
    with pytest.warns(RuntimeWarning, match=r"no string reaches \d modes? of the plant, at 2\.\d"):
        law = make(plant, horizon=horizon, sample_time=SAMPLE)
    run = tc.simulate(
        plant.model, 0.6, disturbed(plant), controller=law, step=2e-3, output_step=SAMPLE
    )
    sizes = controlled_part(plant, run)
    assert sizes[-1] < 0.2 * sizes[0]
    assert set(run.control.status_count) == {tc.control.Status.OK}


def test_the_mode_left_alone_swings_on_as_it_would_without_control():
    plant = known_plant("six-bar ball")
    law = quiet(tc.LQR, plant, sample_time=SAMPLE)
    (frequency,) = law.left_alone.frequency
    assert law.left_alone.label == ("mechanism",)
    shape = law.left_alone.shape[:, :, 0].real
    q = plant.coordinates.project(shape.T.reshape(-1, 1))[:, 0]
    run = tc.simulate(
        plant.model, 0.5, plant.to_nodes(1e-3 * q), controller=law, step=1e-3, output_step=SAMPLE
    )
    moved = [q @ plant.measure(run.nodes[:, :, i], run.velocities[:, :, i])[:24] / (q @ q)
             for i in range(len(run.time))]  # fmt: skip
    expected = 1e-3 * np.cos(2 * np.pi * frequency * run.time)
    np.testing.assert_allclose(moved, expected, atol=2e-5)


@pytest.mark.parametrize("damping", [0.0, 0.02])
@pytest.mark.parametrize("stiffness", [1e3, 1e7])
@pytest.mark.parametrize(
    ("make", "unreached"),
    [(tc.library.six_bar_ball, 2), (tc.library.geiger_dome, 4), (tc.library.class2_tower, 0)],
)
def test_the_count_is_that_of_a_staircase(make, unreached, stiffness, damping):
    """Also where strings are stiff beside soft mechanisms, and damped: by Arnoldi in 80 bits."""
    structure = make()
    law = tc.LinearStrings(stiffness, damping=damping * stiffness**0.5)
    rest = tc.prestress(structure, min_force_density=5.0, max_force_density=200.0)
    plant = tc.linearize(tc.Model(structure, strings=law), rest, input="rest_length")
    found = tc.controllability(plant)
    assert found.unreachable == unreached == len(plant.A) - oracle(plant).shape[1]
    np.testing.assert_allclose(found.unreached.damping, 0.0, atol=1e-9)


def test_a_node_moves_beside_a_mode_that_is_left_alone():
    plant = known_plant("X frame in space")
    reference, goal = moved_reference("X frame in space", plant)
    mpc = quiet(tc.MPC, plant, horizon=8, sample_time=SAMPLE, reference=reference)
    run = tc.simulate(plant.model, 1.0, plant.nodes, controller=mpc, step=2e-3, output_step=SAMPLE)
    assert np.linalg.norm(goal - plant.nodes, axis=0).max() == pytest.approx(0.1, rel=1e-3)
    assert farthest_node(plant, run.nodes[:, :, -1:], goal) < 1e-4


def test_a_warning_names_the_mode_at_the_line_of_the_user():
    plant = known_plant("six-bar ball")
    for make in (
        lambda: tc.LQR(plant),
        lambda: tc.MPC(plant, horizon=2, sample_time=SAMPLE),
    ):
        with pytest.warns(RuntimeWarning, match=r"1 mode .*at 2\.013 Hz \(mechanism\)") as caught:
            make()
        assert [each.filename for each in caught] == [__file__]


def test_nothing_is_left_alone_of_a_prism():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    plant = tc.linearize(model, tc.prestress(prism, force_density=17.3205), input="rest_length")
    law = tc.LQR(plant)
    assert len(law.left_alone) == 0
    assert repr(law.left_alone) == "Modes(0)"
    assert law.left_alone.shape.shape == (3, 6, 0)


@pytest.mark.parametrize("held", ["rest_length", "force_density"])
def test_weights_not_given_are_those_of_model_predictive_control(held):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    plant = tc.linearize(model, tc.prestress(prism, force_density=17.3205), input=held)
    law = tc.LQR(plant, sample_time=SAMPLE)
    most = 60.0 if held == "force_density" else None
    mpc = tc.MPC(plant, horizon=2, sample_time=SAMPLE, max_force_density=most)
    np.testing.assert_allclose(mpc.law.design.problem.feedback, law.gain, rtol=1e-12)


# ---- the feedforward of what is left alone ----


def coupled_plant(decay):
    """A plant of which no input reaches two coordinates, that push on those it reaches."""
    plant = known_plant("X frame in space")
    r = plant.degrees_of_freedom
    rng = np.random.default_rng(0)
    stiffness = np.diag(rng.uniform(50, 200, r))
    friction = 0.3 * np.eye(r)
    stiffness[: r - 2, r - 2 :] = rng.normal(size=(r - 2, 2)) * 20
    friction[r - 2 :, r - 2 :] *= decay
    B = np.vstack([np.zeros((r, 6)), rng.normal(size=(r, 6))])
    B[-2:] = 0
    A = np.block([[np.zeros((r, r)), np.eye(r)], [-stiffness, -friction]])
    return replace(plant, A=A, B=B[:, : plant.B.shape[1]])


@pytest.mark.parametrize("ramp", [False, True])
@pytest.mark.parametrize("decay", [0.0, 1.0])
def test_the_gain_on_what_is_left_alone_is_that_of_dynamic_programming(decay, ramp):
    """Riccati's recursion: its gain settles also where the cost itself grows without end."""
    plant = coupled_plant(decay)
    half = np.random.default_rng(1).normal(size=(len(plant.A), len(plant.A)))
    Q, R = half @ half.T, np.eye(plant.B.shape[1])
    A, B = sampled(plant, SAMPLE, ramp).augmented
    weight, (gain, poles, cost, residual) = regulator(plant, A, B, Q, R, discrete=True)
    P = weight
    for _ in range(4000):
        K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        P = weight + A.T @ P @ (A - B @ K)
    np.testing.assert_allclose(gain, K, atol=1e-6 * np.abs(K).max())
    assert residual < 1e-10
    assert np.abs(gain).min() > 0
    np.testing.assert_allclose(cost, cost.T)
    assert np.linalg.eigvalsh(cost).min() > -1e-9 * np.linalg.eigvalsh(cost).max()
    np.testing.assert_allclose(
        np.sort(np.abs(poles)), np.sort(np.abs(np.linalg.eigvals(A - B @ gain))), atol=1e-7
    )


@pytest.mark.parametrize("decay", [0.0, 1.0])
def test_the_continuous_gain_is_the_limit_of_short_samples(decay):
    plant = coupled_plant(decay)
    half = np.random.default_rng(1).normal(size=(len(plant.A), len(plant.A)))
    Q, R = half @ half.T, np.eye(plant.B.shape[1])
    _, (gain, *_) = regulator(plant, plant.A, plant.B, Q, R, discrete=False)
    step = 1e-5
    A, B = sampled(plant, step, False).augmented
    _, (short, *_) = regulator(plant, A, B, step * Q, step * R, discrete=True)
    np.testing.assert_allclose(gain, short, atol=1e-3 * np.abs(gain).max())


# ---- random structures ----


def test_designs_on_random_structures():
    """A campaign of ``python -m tests.control.reached``, small."""
    done = campaign(1, start=2)
    assert [outcome for outcome, _, _ in done.values()] == ["holds"]
    assert all(figures["residual"] < 1e-9 for _, figures, _ in done.values())


# ---- filters and C code ----


def test_a_filter_leaves_alone_what_is_neither_seen_nor_reached():
    plant = known_plant("six-bar ball")
    sensors = tc.Sensors(structure=plant.model.structure, string_length=0.001)
    expected = r"no reading shows and no string reaches 1 mode of the plant, at 2\.013 Hz"
    with pytest.warns(RuntimeWarning, match=expected) as caught:
        estimator = tc.KalmanFilter(plant, sensors, sample_time=SAMPLE)
    assert caught[0].filename == __file__
    assert len(estimator.left_alone) == 1
    law = quiet(tc.LQR, plant, sample_time=SAMPLE)
    run = tc.simulate(
        plant.model, 1.0, disturbed(plant, 0.02), controller=law, estimator=estimator,
        step=2e-3, output_step=SAMPLE, seed=1,
    )  # fmt: skip
    sizes = controlled_part(plant, run)
    assert sizes[-1] < 0.15 * sizes[0]
    # The covariance neither grows nor is there a gain on what is not seen.
    shape = estimator.left_alone.shape[:, :, 0].real
    unseen = plant.coordinates.project(shape.T.reshape(-1, 1))[:, 0]
    unseen /= np.linalg.norm(unseen)
    assert np.abs(unseen @ estimator.gain[:24]).max() < 1e-9 * np.abs(estimator.gain).max()
    estimator.reset()
    start = None
    for _ in range(200):
        estimate = estimator.update(plant.model.structure.string_length())
        estimator.predict(plant.equilibrium_input)
        energy = unseen @ estimate.covariance[24:, 24:] @ unseen
        energy += (2 * np.pi * 2.01317) ** 2 * (unseen @ estimate.covariance[:24, :24] @ unseen)
        start = energy if start is None else start
        assert energy == pytest.approx(start, rel=1e-3)


def test_a_filter_refuses_what_strings_reach_and_no_reading_shows():
    plant = known_plant("six-bar ball")
    few = tc.Sensors(structure=plant.model.structure, string_length=0.001, strings=[0, 1])
    with pytest.raises(ValueError, match=r"16 of the 48 .*Measure .*string_length of all strings"):
        tc.KalmanFilter(plant, few, sample_time=SAMPLE)


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
@pytest.mark.parametrize("make", [tc.LQR, tc.NMPC])
def test_code_commands_what_python_does(make, tmp_path):
    plant = known_plant("X frame in space")
    more = {} if make is tc.LQR else {"horizon": 3}
    sample_time = 0.005  # NMPC predicts by explicit steps
    one = quiet(make, plant, sample_time=sample_time, **more)
    pair = scenes.Pair(one, tc.generate_c(one, tmp_path).compile(), (), ())
    rng, r = np.random.default_rng(2), plant.degrees_of_freedom
    pair.applied(plant.equilibrium_input)
    for k in range(10):
        q, rates = 1e-3 * rng.normal(size=r), 2e-3 * rng.normal(size=r)
        nodes, velocities = plant.to_nodes(q), plant.to_velocities(q, rates)
        pair.applied(pair.command(k * sample_time, nodes, velocities).value)
    assert pair.statuses[0] == pair.statuses[1] == ["ok"] * 10
    assert pair.error < 1e-8
