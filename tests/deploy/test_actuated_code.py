"""C code of controllers and filters on plants some of whose strings are driven or ganged."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.machine_code import compiler
from tests.benchmarks.filter_code import Code
from tests.deploy import scenes

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")

WINCHES = {"lid": [0, 1, 2], "side": {6: 1.0, 7: -0.5}, "last": [4]}
LIMITS = tc.Winches(rate=0.5, shortest=0.1)


@pytest.fixture(scope="module")
def plant():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=1.0))
    rest = tc.prestress(tc.prism(), 17.3205)
    return tc.linearize(model, rest, input="rest_length", actuated=WINCHES)


LAWS = {
    "lqr": lambda plant: tc.LQR(plant, sample_time=0.02, winches=LIMITS),
    "mpc": lambda plant: tc.MPC(
        plant, horizon=5, sample_time=0.02, winches=LIMITS, max_tension=31.5, load_gain=0.1,
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", LAWS)
def test_commands_of_winches_are_those_of_python(plant, kind, tmp_path):
    """In a closed loop on the nonlinear plant, spoilt measurements included."""
    law = LAWS[kind](plant)
    made = tc.generate_c(law, tmp_path)
    pair = scenes.Pair(law, made.compile(), spoilt=(20,), absurd=(25,))
    start = plant.to_nodes(np.r_[0.03, np.zeros(8)])
    run = tc.simulate(
        plant.model, 0.8, start, controller=pair, winches=LIMITS, rest_length=plant.rest_length,
        step=4e-3, error="none",
    )  # fmt: skip
    assert pair.statuses[0] == pair.statuses[1]
    assert pair.error < 1e-12
    assert made.low.shape == (3,)
    passive = plant.actuation.passive
    assert np.ptp(pair.commands[1][:, passive], axis=0).max() == 0
    assert np.ptp(run.control.applied[6]) > 1e-4
    assert "1: rest_length_side: string 6, string 7 by -0.5" in (
        tmp_path / "controller.h"
    ).read_text("utf-8")


def test_nonlinear_mpc_of_ganged_winches(tmp_path):
    arm = tc.library.arm(sections=1)
    model = tc.Model(arm, strings=tc.LinearStrings(500.0, damping=1.0))
    rest = tc.prestress(arm, min_force_density=20.0)
    plant = tc.linearize(
        model, rest, input="rest_length", actuated={"pair": {0: 1.0, 1: -1.0}, "one": [2]}
    )
    law = tc.NMPC(plant, horizon=2, sample_time=0.01)
    pair = scenes.Pair(law, tc.generate_c(law, tmp_path).compile(), spoilt=(5,), absurd=(8,))
    start = plant.to_nodes(0.01 * np.ones(plant.degrees_of_freedom))
    tc.simulate(
        model, 0.2, start, controller=pair, rest_length=plant.rest_length, step=2e-3, error="none"
    )
    assert pair.statuses[0] == pair.statuses[1]
    assert pair.error < 1e-12


def test_many_loops_of_compiled_code_move_the_winches_of_one(plant, tmp_path):
    law = tc.LQR(plant, sample_time=0.02)
    code = tc.generate_c(law, tmp_path).compile()
    starts = np.array([plant.to_nodes(q * np.ones(9)) for q in (0.004, 0.01)])
    how = tc.Integration(method="rk4", step=4e-3)
    scene = tc.Scene(plant.model, 0.2, controller=code, integration=how)
    batch = tc.simulate_many(scene, {"nodes": starts})
    for k, start in enumerate(starts):
        run = tc.simulate(
            plant.model, 0.2, start, controller=law, method="rk4", step=4e-3, error="none"
        )
        np.testing.assert_allclose(batch.command[k], run.control.command, rtol=0, atol=1e-12)
        np.testing.assert_allclose(batch.nodes[k, ..., -1], run.nodes[..., -1], atol=1e-12)


def test_a_filter_takes_the_commands_of_winches(plant, tmp_path):
    sensors = tc.Sensors(structure=plant.model.structure, string_length=1e-3)
    estimator = tc.KalmanFilter(plant, sensors, sample_time=0.02)
    law = tc.LQR(plant, sample_time=0.02)
    code = Code(tc.generate_c(law, tmp_path, estimator=estimator))
    design, rng, actuation = estimator.design, np.random.default_rng(3), plant.actuation
    z, held = np.r_[5e-3 * rng.normal(size=9), np.zeros(len(design.start) - 9)], None
    for _ in range(100):
        u = plant.equilibrium_input if held is None else held
        y = np.array(design.outputs(z, u)[0]).ravel()
        y += estimator.sensors.noise * rng.normal(size=len(y))
        estimate = estimator.update(y)
        N, V, status = code.estimate(y)
        assert status is estimate.status
        np.testing.assert_allclose(N, estimate.nodes, rtol=0, atol=1e-12)
        value = law.command(0.0, estimate.nodes, estimate.velocities).value
        held = code.command(N, V)
        np.testing.assert_allclose(actuation.strings(held), value, rtol=0, atol=1e-12)
        estimator.predict(value)
        code.predict(held)
        moved = design.sampled.transition @ z + design.sampled.by_input @ (
            held - plant.equilibrium_input
        )
        z = moved + 1e-4 * rng.normal(size=len(z))


def test_a_filter_of_other_winches_is_refused(plant, tmp_path):
    sensors = tc.Sensors(structure=plant.model.structure, string_length=1e-3)
    rest = tc.prestress(tc.prism(), 17.3205)
    whole = tc.linearize(plant.model, rest, input="rest_length")
    estimator = tc.KalmanFilter(whole, sensors, sample_time=0.02)
    with pytest.raises(ValueError, match="in C the filter takes the commands"):
        tc.generate_c(tc.LQR(plant, sample_time=0.02), tmp_path / "a", estimator=estimator)


def test_motors_wind_several_strings(plant):
    """Torque and energy are those of all strings of a winch, by their ratios."""
    motor = tc.Motor(drum_radius=0.01, gear_ratio=20.0, speed=2000.0, lag=0.01)
    winches = tc.Winches(ramp=True, motor=motor, substeps=4)
    law = tc.LQR(plant, sample_time=0.02, winches=winches)
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))  # all work is kept
    run = tc.simulate(
        model, 0.6, plant.to_nodes(np.r_[0.02, np.zeros(8)]), controller=law,
        winches=winches, rest_length=plant.rest_length, method="dop853", tolerance=1e-10,
        output_step=1e-3, error="none",
    )  # fmt: skip
    record, lever = run.control.motors, 0.01 / 20.0
    assert record.angle.shape[0] == 3
    inputs = plant.actuation.inputs(run.rest_length)
    wound = (plant.equilibrium_input[:, None] - inputs) / lever
    np.testing.assert_allclose(record.angle, wound, rtol=0, atol=1e-6 * np.abs(wound).max())
    G = plant.actuation.matrix.toarray()
    torque = lever * G.T @ run.tension
    np.testing.assert_allclose(record.torque[:, 1:], torque[:, 1:], rtol=0, atol=1e-9)
    given, stored = record.energy.sum(axis=0), run.energy - run.energy[0]
    assert np.ptp(given) > 1e-3
    np.testing.assert_allclose(given, stored, rtol=0, atol=1e-6)
