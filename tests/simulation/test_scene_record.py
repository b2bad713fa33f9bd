"""The record of a scene: checked where it is made, kept by its run, and changed by ``replace``."""

import copy
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

import tenscontrol as tc

STEPS = tc.Integration(step=1e-3)


@pytest.fixture(scope="module")
def model(prism):
    return tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.2))


@pytest.fixture(scope="module")
def lengths(model, prism):
    gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    return tc.to_rest_length(model, prism.nodes, gamma).rest_length


@pytest.fixture(scope="module")
def regulated(model, prism):
    rest = tc.prestress(prism, 17.3205)
    plant = tc.linearize(model, rest, input="rest_length")
    law = tc.LQR(plant, sample_time=0.02)
    start = plant.to_nodes(np.full(plant.degrees_of_freedom, 0.01))
    return tc.Scene(
        model, 0.1, start, controller=law, rest_length=plant.rest_length, integration=STEPS
    )


def test_a_scene_is_run_as_its_arguments_are(model, lengths):
    scene = tc.Scene(model, 0.1, rest_length=lengths, integration=STEPS)
    run = scene.simulate()
    np.testing.assert_array_equal(
        run.nodes, tc.simulate(model, 0.1, rest_length=lengths, step=1e-3).nodes
    )
    np.testing.assert_array_equal(scene.nodes, model.structure.nodes)
    with pytest.raises(FrozenInstanceError):
        scene.duration = 1.0


def test_a_run_keeps_its_scene(model, lengths):
    run = tc.simulate(model, 0.1, rest_length=lengths, step=1e-3)
    again = replace(run.scene, duration=0.05).simulate()
    np.testing.assert_array_equal(again.nodes, run.nodes[:, :, :51])
    assert copy.copy(run).scene is None
    more = tc.simulate(model, 0.05, start=run, step=1e-3)
    assert more.scene is None  # it would keep the runs before it
    np.testing.assert_array_equal(run.scene.simulate(start=run).nodes[:, :, :51], more.nodes)


def test_a_loop_is_run_twice_alike(regulated):
    first, second = regulated.simulate(), regulated.simulate()
    np.testing.assert_array_equal(first.control.command, second.control.command)
    assert "LQR" in repr(regulated)


def test_a_loop_in_open_loop_holds_what_it_holds_at_the_start(regulated):
    scene = replace(regulated, faults=[tc.CutString(0, 0.05)]).open_loop()
    np.testing.assert_array_equal(scene.input_value, regulated.rest_length)
    assert scene.note == (
        "The controller of the scene is left out: rest lengths are held as at the start. "
        "Its faults are left out: string 0 cut."
    )
    np.testing.assert_array_equal(scene.nodes, regulated.nodes)
    assert scene.open_loop() is scene


def test_a_scene_is_linearized_about_its_input(regulated, model, prism):
    rest = tc.prestress(prism, 17.3205)
    true = tc.modes(tc.linearize(model, rest, input="rest_length")).frequency
    held = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    for scene in (tc.Scene(model, 1.0, rest_length=held), regulated):
        np.testing.assert_allclose(tc.modes(scene.linearize()).frequency, true, rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"duration": -1.0}, ValueError, "duration is -1.0"),
        ({"integration": 1e-3}, TypeError, "integration is a float, expected Integration"),
        ({"prestress": -1.0}, ValueError, r"prestress\[0\] is -1"),
        ({"force_density": 1.0}, ValueError, "found both"),
        ({"input": np.ones((2, 3))}, ValueError, "input is array"),
        ({"input": "force_density"}, ValueError, "but rest_length is given and held"),
        ({"seed": -1}, ValueError, "seed is -1"),
        ({"winches": 0.5}, TypeError, "winches is a float"),
        ({"sensors": 1}, TypeError, "sensors is a int"),
        ({"faults": [tc.CutString(9, 0.1)]}, ValueError, r"faults\[0\].string is 9"),
        ({"name": 1}, TypeError, "name"),
    ],
)
def test_what_does_not_fit_is_refused_where_it_is_made(model, lengths, change, error, message):
    scene = tc.Scene(model, 1.0, rest_length=lengths)
    with pytest.raises(error, match=message):
        replace(scene, **change)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"method": "rk4"}, "'rk4' needs a step"),
        ({"method": "dop853", "step": 1e-3}, "'dop853' chooses its own steps"),
        ({"tolerance": 0}, "tolerance is 0"),
        ({"output_step": -1.0}, "output_step is -1"),
        ({"error": "some"}, "error is 'some'"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        tc.Integration(**settings)


def test_another_integration_takes_over_what_was_found(model, lengths):
    scene = tc.Scene(model, 0.1, rest_length=lengths)
    how = tc.Integration(tolerance=1e-4)
    other = replace(scene, integration=how)
    assert other.initial is scene.initial
    assert other.inputs is scene.inputs
    assert other.integration is how
    assert scene.integration is not how
    anew = tc.Scene(model, 0.1, rest_length=lengths.copy(), integration=how)
    assert anew.initial is not scene.initial
    assert np.array_equal(other.simulate().nodes, anew.simulate().nodes)
    with pytest.raises(TypeError, match="integration"):
        replace(anew, integration=1e-4)


def test_what_else_is_another_is_found_anew(model, lengths):
    scene = tc.Scene(model, 0.1, rest_length=lengths)
    assert replace(scene, duration=0.2).simulate().time[-1] == 0.2
    assert np.array_equal(replace(scene, rest_length=2 * lengths).input_value, 2 * lengths)
    with pytest.raises(ValueError, match="duration"):
        replace(scene, duration=-1.0)


def test_functions_of_time_are_looked_at_in_each_scene(model, lengths):
    part = [1.0]
    scene = tc.Scene(model, 0.1, rest_length=lambda time: part[0] * lengths)
    part[0] = 0.5
    other = replace(scene, integration=tc.Integration(tolerance=1e-4))
    assert np.allclose(other.inputs.at(np.zeros(1))[:, 0], 0.5 * lengths)
