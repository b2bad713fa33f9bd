"""Closed loops on a ground that varies: against simulations by hand, and what is refused."""

import pickle
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tests.robustness.cases import Inline, loop_case

STEP, DURATION = 1e-3, 0.35
RNG = np.random.default_rng(0)
STRINGS = tc.LinearStrings(100.0, damping=0.5)
FLOOR = tc.Ground(2e3, damping=0.2, friction=0.4, height=-0.2)
WALL = tc.Ground(1e3, normal=[1.0, 0.0, 0.0], height=-5.0)


@pytest.fixture(scope="module")
def regulator(prism):
    rest = tc.prestress(prism, force_density=17.320508)
    plant = tc.linearize(tc.Model(prism, strings=STRINGS), rest, input="rest_length")
    Q, R = tc.energy_weights(plant)
    return tc.LQR(plant, Q, 0.1 * R, sample_time=0.02)


def on(case, ground, **changes):
    """The case on another ground."""
    model = case.scene.model
    other = tc.Model(model.structure, model.strings, gravity=model.gravity, ground=ground)
    return replace(case, scene=replace(case.scene, model=other, **changes))


@pytest.fixture(scope="module")
def dropped(prism, regulator):
    return loop_case(
        prism, STRINGS, regulator, DURATION, STEP, 0.05, gravity=9.81, ground=[FLOOR, WALL]
    )


def test_it_is_the_simulation_on_the_varied_ground(dropped, prism, regulator):
    drawn = {"ground.stiffness": [1.5, 1.0], "ground.damping": 0.5, "ground.friction": 2.0}
    figures = dropped(drawn, RNG).figures
    floor = replace(FLOOR, stiffness=3e3, damping=0.1, friction=0.8)
    model = tc.Model(prism, strings=STRINGS, gravity=9.81, ground=[floor, WALL])
    run = tc.simulate(model, DURATION, controller=regulator, step=STEP)
    assert run.nodes[2].min() < -0.21  # it has fallen on it
    assert figures["least_force_density"] == run.force_density.min()
    assert figures["largest_force_density"] == run.force_density.max()
    nominal = dropped({}, RNG).figures
    assert nominal != figures
    assert dropped({"ground.friction": 1.0}, RNG).figures == nominal


def test_a_sweep_draws_friction_and_stiffness_by_name(dropped):
    stiffness = tc.Uniform(0.5, 2.0, size=2)
    drawn = {"ground.friction": tc.Uniform(0.5, 1.5), "ground.stiffness": stiffness}
    first, again = (tc.sweep(dropped, drawn, 3, seed=4, executor=Inline()) for _ in range(2))
    assert first.completed.all()
    for name, values in first.figures.items():
        np.testing.assert_array_equal(values, again.figures[name])
    assert len(set(first.figures["final_error"])) == 3
    assert first.parameters["ground.stiffness"].shape == (3, 2)


def test_workers_get_the_ground_pickled(dropped):
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    hill = tc.Ground(2e3, friction=0.4, height=ca.Function("h", [x, y], [0.05 * x - 0.2]))
    case = on(dropped, hill, duration=0.25)
    sent = pickle.loads(pickle.dumps(case))
    assert sent({}, RNG).figures == case({}, RNG).figures
    assert sent({"ground.friction": 0.5}, RNG).figures != case({}, RNG).figures


@pytest.mark.parametrize(
    ("changes", "drawn", "error", "message"),
    [
        ({"ground": None}, {"ground.friction": 1.1}, tc.robustness.SweepError,
         "ground.friction is drawn, but there is no ground: give ground"),
        ({"ground": WALL}, {"ground.friction": 1.1}, tc.robustness.SweepError,
         "ground.friction is drawn, but the ground has none"),
        ({"ground": WALL}, {"ground.damping": 1.1}, tc.robustness.SweepError,
         "ground.damping is drawn, but the ground has none"),
        ({}, {"ground.stiffness": [1.0, 1.0, 1.0]}, ValueError,
         r"ground.stiffness has shape \(3,\), expected \(\) or \(2,\): .* contact law"),
        ({}, {"ground.friction": -1.0}, ValueError, r"friction is -0\.4, expected at least 0"),
        ({}, {"friction": 1.0}, tc.robustness.SweepError,
         r"no parameter 'friction', expected some of .*'ground\[0\].friction'"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_draw_is_named(dropped, changes, drawn, error, message):
    with pytest.raises(error, match=message):
        (on(dropped, **changes) if changes else dropped)(drawn, RNG)


def test_a_ground_that_does_not_fit_is_refused(dropped):
    with pytest.raises(TypeError, match="ground is a float, expected a contact law"):
        on(dropped, 5e3)
