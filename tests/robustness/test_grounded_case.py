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
    drawn = {"ground_stiffness": [1.5, 1.0], "ground_damping": 0.5, "friction": 2.0}
    figures = dropped(drawn, RNG).figures
    floor = replace(FLOOR, stiffness=3e3, damping=0.1, friction=0.8)
    model = tc.Model(prism, strings=STRINGS, gravity=9.81, ground=[floor, WALL])
    run = tc.simulate(model, DURATION, controller=regulator, step=STEP)
    assert run.nodes[2].min() < -0.21  # it has fallen on it
    assert figures["least_force_density"] == run.force_density.min()
    assert figures["largest_force_density"] == run.force_density.max()
    nominal = dropped({}, RNG).figures
    assert nominal != figures
    assert dropped({"friction": 1.0}, RNG).figures == nominal


def test_a_sweep_draws_friction_and_stiffness_by_name(dropped):
    drawn = {"friction": tc.Uniform(0.5, 1.5), "ground_stiffness": tc.Uniform(0.5, 2.0, size=2)}
    first, again = (tc.sweep(dropped, drawn, 3, seed=4, executor=Inline()) for _ in range(2))
    assert first.completed.all()
    for name, values in first.figures.items():
        np.testing.assert_array_equal(values, again.figures[name])
    assert len(set(first.figures["final_error"])) == 3
    assert first.parameters["ground_stiffness"].shape == (3, 2)


def test_workers_get_the_ground_pickled(dropped):
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    hill = tc.Ground(2e3, friction=0.4, height=ca.Function("h", [x, y], [0.05 * x - 0.2]))
    case = on(dropped, hill, duration=0.25)
    sent = pickle.loads(pickle.dumps(case))
    assert sent({}, RNG).figures == case({}, RNG).figures
    assert sent({"friction": 0.5}, RNG).figures != case({}, RNG).figures


@pytest.mark.parametrize(
    ("changes", "drawn", "error", "message"),
    [
        ({"ground": None}, {"friction": 1.1}, tc.robustness.SweepError,
         "friction is drawn, but there is no ground: give ground"),
        ({"ground": WALL}, {"friction": 1.1}, tc.robustness.SweepError,
         "friction is drawn, but the ground has none"),
        ({"ground": WALL}, {"ground_damping": 1.1}, tc.robustness.SweepError,
         "ground_damping is drawn, but the ground has none"),
        ({}, {"ground_stiffness": [1.0, 1.0, 1.0]}, ValueError,
         r"ground_stiffness has shape \(3,\), expected \(\) or \(2,\): .* contact law"),
        ({}, {"friction": -1.0}, ValueError, r"friction is -0\.4, expected at least 0"),
        ({}, {"ground_friction": 1.0}, tc.robustness.SweepError,
         "no parameter 'ground_friction', expected some of .*'friction'"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_draw_is_named(dropped, changes, drawn, error, message):
    with pytest.raises(error, match=message):
        (on(dropped, **changes) if changes else dropped)(drawn, RNG)


def test_a_ground_that_does_not_fit_is_refused(dropped):
    with pytest.raises(TypeError, match="ground is a float, expected a contact law"):
        on(dropped, 5e3)
