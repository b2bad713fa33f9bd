"""What is measured: taken from scenes or given, and checked."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy.open_loop import fastest_rate
from tenscontrol.accuracy.peers import CasADiCVODES, SciPy
from tenscontrol.dynamics.machine_code import compiler

SCENES = Path(__file__).parent.parent.parent / "examples" / "scenes"


def test_a_scene_becomes_the_same_motion():
    scene = tc.load_scene(SCENES / "prism_free.toml")
    case = scene.open_loop()
    assert (case.name, case.note, case.input) == ("prism_free", "", "rest_length")
    np.testing.assert_array_equal(case.input_value, scene.rest_length)
    run = tc.simulate(scene.model, 0.1, case.nodes, rest_length=case.input_value, step=1e-2)
    np.testing.assert_allclose(case.state, np.r_[run.nodes[:, :, 0].T.ravel(), np.zeros(18)])


def test_a_controller_is_left_out_and_that_is_said():
    scene = tc.load_scene(SCENES / "prism_mpc.toml")
    case = scene.open_loop()
    assert case.note == (
        "The controller of the scene is left out: rest lengths are held as at the start."
    )
    np.testing.assert_array_equal(case.input_value, scene.rest_length)
    found = tc.work_precision(
        replace(case, duration=0.05),
        ["rk4"],
        {"rk4": [0.01]},
        repeats=1,
        outputs=5,
    )
    assert case.note in found.table()
    assert case.note in found.to_markdown()


def test_what_changes_in_time_is_not_compared(prism):
    gust = tc.Profile([0.0, 1.0], np.zeros((3, 6, 2)))
    model = tc.Model(prism, external_force=True)
    scene = tc.Scene(model, 1.0, force_density=20.0, external_force=gust)
    with pytest.raises(ValueError, match="external_force changes in time"):
        tc.accuracy.predictability(scene)
    scene = tc.Scene(tc.Model(prism), 1.0, force_density=lambda t: np.full(9, 20.0 + t))
    with pytest.raises(ValueError, match="force_density changes the input in time"):
        tc.accuracy.predictability(scene)


def test_a_loop_without_known_inputs_has_no_open_loop(prism):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    plant = tc.linearize(model, tc.prestress(prism, 17.3205), input="rest_length")
    scene = tc.Scene(model, 1.0, controller=tc.LQR(plant, sample_time=0.02))
    with pytest.raises(ValueError, match="no rest lengths at its start: give rest_length"):
        scene.open_loop()


def test_loads_act(prism):
    load = np.zeros((3, 6))
    load[2, 0] = 5.0
    model = tc.Model(prism, external_force=True, gravity=9.81)
    case = tc.Scene(model, 1.0, force_density=20.0, external_force=load)
    np.testing.assert_allclose(case.load, load + model.constant_force)
    slope = np.array(case.equation().slope(case.state, case.input_value, [])).ravel()
    true = np.array(model.acceleration(prism.nodes, np.zeros((3, 6)), case.input_value, load))
    np.testing.assert_allclose(slope[18:], true.T.ravel(), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"duration": 0.0}, ValueError, "duration is 0.0, expected a positive finite number"),
        ({"input": "tension"}, ValueError, "input is 'tension', expected one of 'rest_length'"),
        ({"force_density": None}, ValueError, "found neither"),
        ({"force_density": [1.0]}, ValueError, r"force_density has shape \(1,\), expected"),
        ({"nodes": np.ones((3, 6))}, ValueError, "in nodes, bar 0 has length 0 m"),
        ({"velocities": np.eye(3, 6)}, ValueError, "velocities stretch bar"),
        ({"external_force": np.ones((3, 6))}, ValueError, "takes no load as an input"),
        ({"model": None}, TypeError, "model is a NoneType"),
    ],
)
def test_what_does_not_fit_is_refused(prism, change, error, message):
    given = {"model": tc.Model(prism), "duration": 1.0, "force_density": 10.0}
    with pytest.raises(error, match=message):
        tc.Scene(**given | change)


def test_neither_case_nor_scene():
    with pytest.raises(TypeError, match="scene is a str, expected Scene"):
        tc.work_precision("prism.toml")


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
def test_structures_of_many_members_are_measured_by_methods_that_need_derivatives():
    """Their equation is loops in C by default, which have none."""
    spine = tc.library.spine()
    model = tc.Model(spine, strings=tc.LinearStrings(1e3, damping=1.0))
    case = tc.Scene(model, 0.02, rest_length=0.99 * spine.string_length())
    assert case.equation().form == "loops"
    assert case.equation(derivatives=True).form == "mapped"
    assert fastest_rate(case) > 1 / case.duration
    reference = tc.accuracy.converged_motion(case, outputs=4)
    found = tc.work_precision(
        case, ["cvodes", "energy_momentum"], {"cvodes": [1e-6], "energy_momentum": [1e-3]},
        peers=[CasADiCVODES([1e-8]), SciPy("Radau", [1e-6])], reference=reference, repeats=1,
    )  # fmt: skip
    assert not found.failures
    assert max(row.error for row in found.rows) < 1e-3


@pytest.mark.parametrize("load", [0, np.zeros((3, 2))], ids=["number", "array"])
def test_a_structure_without_strings_and_a_load_of_zero_make_a_case(load):
    bar = tc.Structure([[0, 1], [0, 0], [0, 0]], [(0, 1)], [], 1.0)
    case = tc.Scene(tc.Model(bar), 1.0, force_density=[], external_force=load)
    np.testing.assert_array_equal(case.load, np.zeros((3, 2)))


def test_a_method_that_is_named_twice_is_measured_once():
    prism = tc.prism()
    case = tc.Scene(tc.Model(prism), 0.1, force_density=17.0)
    found = tc.work_precision(case, ["rk4", "rk4"], {"rk4": [0.05]}, repeats=1, outputs=5)
    assert [row.method for row in found.rows] == ["rk4"]
