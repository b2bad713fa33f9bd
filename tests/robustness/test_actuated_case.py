"""Sweeps of loops some of whose strings are driven, and of motions that are asked for more."""

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tests.robustness.cases import Inline, loop_case

BALL = tc.library.six_bar_ball()
STRINGS = tc.LinearStrings(stiffness=1000.0, damping=10.0)
MODEL = tc.Model(BALL, strings=STRINGS)
REST = tc.prestress(BALL, min_force_density=20.0)
LAYOUTS = {
    "twelve": list(range(0, 24, 2)),
    "pairs": {f"motor_{k}": {4 * k: 1.0, 4 * k + 2: -0.5} for k in range(6)},
}
DRAWN = {"stiffness": tc.Uniform(0.9, 1.1, size=24), "start": tc.Normal(0.0, 3e-3, size=24)}


def ball_case(layout, **settings):
    plant = tc.linearize(MODEL, REST, input="rest_length", actuated=LAYOUTS[layout])
    with pytest.warns(RuntimeWarning, match="no string reaches 1 mode"):
        law = tc.LQR(plant, sample_time=0.02)
    return loop_case(BALL, STRINGS, law, 0.3, 2e-3, tolerance=0.005, **settings)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_driven_strings_are_swept_and_judged(layout):
    case = ball_case(layout, winches=tc.Winches(rate=0.5), rest_length=None)
    case = replace(case, scene=replace(case.scene, rest_length=case.scene.law.plant.rest_length))
    report = tc.sweep(case, DRAWN, 4, seed=1, executor=Inline())
    assert report.completed.all()
    errors = report.figure("final_error")
    np.testing.assert_array_equal(report.success, errors <= 0.005)
    assert 0 < report.success.sum() < 4
    drawn = {name: values[0] for name, values in report.parameters.items()}
    law, scene = case.scene.law, case.scene
    model = tc.Model(BALL, strings=tc.LinearStrings(1000.0 * drawn["stiffness"], damping=10.0))
    run = tc.simulate(
        model, 0.3, law.plant.to_nodes(drawn["start"]), controller=law, step=2e-3,
        winches=scene.winches, rest_length=scene.rest_length,
    )  # fmt: skip
    assert report.figure("largest_force_density")[0] == run.force_density.max()
    passive = law.actuation.passive
    assert len(passive) == 12
    assert np.ptp(run.rest_length[passive], axis=1).max() == 0


def test_a_stuck_gang_and_a_cut_spring_are_swept():
    faults = [tc.StuckWinch(2, 0.05), tc.CutString(1, 0.1)]
    report = tc.sweep(ball_case("pairs", faults=faults), DRAWN, 2, seed=0, executor=Inline())
    assert report.completed.all()
    assert (report.figure("least_force_density") == 0).all()


# ---- motors that are not those of the design ----


def test_numbers_of_motors_are_drawn_by_name():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    rest = tc.prestress(prism, force_density=17.3205)
    plant = tc.linearize(model, rest, input="rest_length")
    regulator = tc.LQR(plant, sample_time=0.02)
    motor = tc.Motor(drum_radius=0.01, torque=0.5, speed=20.0, inertia=1e-4)
    winches = tc.Winches(ramp=True, motor=motor, substeps=10)
    how = {"winches": winches, "rest_length": plant.rest_length}
    case = loop_case(prism, model.strings, regulator, 0.2, 5e-3, 0.5, **how)
    torque = np.linspace(0.3, 0.9, 9)
    drawn = {"motor.torque": torque, "motor.speed": 0.5, "start": np.full(9, 0.02)}
    figures = case(drawn, np.random.default_rng(0)).figures
    own = replace(winches, motor=replace(motor, torque=0.5 * torque, speed=np.full(9, 10.0)))
    run = tc.simulate(
        model, 0.2, plant.to_nodes(drawn["start"]), controller=regulator, step=5e-3, winches=own,
        rest_length=plant.rest_length,
    )  # fmt: skip
    assert figures["largest_force_density"] == run.force_density.max()
    nominal = case({"start": drawn["start"]}, np.random.default_rng(0)).figures
    assert figures != nominal
    grid = tc.grid({"motor.torque": [0.1, 1.0], "motor.inertia": [2.0]})
    vary = grid | {"start": tc.Uniform(0.02, 0.02, size=9)}
    report = tc.sweep(case, vary, seed=0, executor=Inline())
    assert report.completed.all()
    for k, figures in enumerate(report.figures["largest_force_density"]):
        drawn = {name: values[k] for name, values in report.parameters.items()}
        assert figures == case(drawn, None).figures["largest_force_density"]
    with pytest.raises(tc.robustness.SweepError, match=r"lag is drawn, but .*torque"):
        case({"motor.lag": 1.1}, None)
    without = replace(case, scene=replace(case.scene, winches=None, rest_length=None))
    with pytest.raises(tc.robustness.SweepError, match=r"give Winches\(motor"):
        without({"motor.torque": 1.1}, None)


# ---- a success that is not a place ----


def higher(run):
    way = run.nodes[2, :, -1].mean() - run.nodes[2, :, 0].mean()
    return tc.robustness.Outcome(way > 0.05, {"way": way})


def told_at_once(run):
    return len(run.control.command[0]) == 15


def number(run):
    return 1.0


@pytest.mark.parametrize("method", ["dop853", "cvodes", "energy_momentum"])
def test_success_is_what_a_function_says_of_the_run(prism, method):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5), gravity=9.81)
    held = prism.string_length() * 0.9
    how = {"step": 0.01} if method == "energy_momentum" else {"tolerance": 1e-8}
    scene = tc.Scene(
        model, 0.2, velocities=np.tile([[0.0], [0.0], [1.3]], 6), rest_length=held,
        integration=tc.Integration(method=method, **how),
    )  # fmt: skip
    case = tc.ClosedLoopCase(scene, success=higher)
    outcome = case({"bar_mass": 1.3}, np.random.default_rng(0))
    assert outcome.success
    assert outcome.figures["way"] == pytest.approx(1.3 * 0.2 - 9.81 * 0.2**2 / 2, abs=1e-6)
    near = replace(case, tolerance=1e-3)({}, np.random.default_rng(0))
    assert not near.success  # both must hold
    assert near.figures["final_error"] > 1e-3


def test_the_function_sees_the_record_of_the_control():
    case = replace(ball_case("pairs"), tolerance=None, success=told_at_once)
    report = tc.sweep(case, DRAWN, 2, seed=0, executor=Inline())
    assert report.success.all()
    assert case.alone(["stiffness"]) == "success is asked of runs with their record of the control"


def test_open_loops_that_go_together_are_asked_too(prism):
    held = prism.string_length() * 0.9
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    scene = tc.Scene(
        model, 0.1, velocities=np.tile([[0.0], [0.0], [0.6]], 6), rest_length=held,
        integration=tc.Integration(step=5e-3),
    )  # fmt: skip
    case = tc.ClosedLoopCase(scene, success=higher)
    assert case.alone(["bar_mass"]) is None
    drawn = {"bar_mass": tc.Uniform(0.9, 1.1)}
    report = tc.sweep(case, drawn, 3, seed=0, executor=Inline())
    assert report.success.all()
    np.testing.assert_allclose(report.figure("way"), 0.06, atol=1e-9)


def test_what_is_no_success_is_refused(prism):
    scene = tc.Scene(
        tc.Model(prism), 0.1, force_density=10.0, integration=tc.Integration(step=0.01)
    )
    with pytest.raises(ValueError, match="neither tolerance nor success"):
        tc.ClosedLoopCase(scene)
    with pytest.raises(TypeError, match="success is a int"):
        tc.ClosedLoopCase(scene, success=3)
    case = tc.ClosedLoopCase(scene, success=number)
    with pytest.raises(tc.robustness.SweepError, match=r"success returned 1\.0, expected True"):
        case({}, np.random.default_rng(0))
