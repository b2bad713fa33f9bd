"""Runs of structures that lack something, and arguments that do nothing."""

import numpy as np
import pytest

import tenscontrol as tc

PRISM = tc.prism()
GAMMA = tc.prestress(PRISM, 17.3205).force_density
MODEL = tc.Model(PRISM)


def bar(dimension=3, **changes):
    """A level bar from the origin."""
    nodes = [[0, 1], [0, 0], [0, 0]][:dimension]
    return tc.Structure(nodes, [(0, 1)], [], 1.0, **changes)


def turning(dimension):
    """Velocities of a bar that turns in the plane of x and y by 2 rad/s about node 0."""
    velocities = np.zeros((dimension, 2))
    velocities[1, 1] = 2.0
    return velocities


@pytest.mark.parametrize("law", [None, tc.LinearStrings(100.0), tc.LinearStrings([])])
@pytest.mark.parametrize("given", [{}, {"rest_length": []}, {"force_density": 1.0}], ids=repr)
@pytest.mark.parametrize("dimension", [2, 3])
def test_without_strings_no_input_is_needed(law, given, dimension):
    model = tc.Model(bar(dimension, fixed=[0]), law)
    run = tc.simulate(model, 0.5, None, turning(dimension), **given)
    np.testing.assert_allclose(run.nodes[:2, 1, -1], [np.cos(1), np.sin(1)], atol=1e-6)


@pytest.mark.parametrize("method", ["rk4", "energy_momentum"])
def test_every_method_runs_without_strings(method):
    model = tc.Model(bar(), tc.LinearStrings(100.0), gravity=9.81)
    run = tc.simulate(model, 0.5, method=method, step=1e-2)
    np.testing.assert_allclose(run.nodes[2, :, -1], -9.81 / 8, rtol=1e-9)


def test_many_runs_without_strings_need_no_input():
    starts = np.array([turning(3), 2 * turning(3)])
    for law in (None, tc.LinearStrings(100.0)):
        model = tc.Model(bar(fixed=[0]), law)
        scene = tc.Scene(model, 0.5, integration=tc.Integration(step=1e-3))
        batch = tc.simulate_many(scene, {"velocities": starts})
        np.testing.assert_allclose(batch.nodes[0, :2, 1, -1], [np.cos(1), np.sin(1)], atol=1e-9)
        np.testing.assert_allclose(batch.nodes[1, :2, 1, -1], [np.cos(2), np.sin(2)], atol=1e-9)


def test_with_strings_an_input_is_still_asked_for():
    with pytest.raises(ValueError, match="expected one of rest_length, force_density and contr"):
        tc.simulate(MODEL, 0.1)
    with pytest.raises(ValueError, match=r"rest_length has shape \(2,\), expected \(\) or \(0,\)"):
        tc.simulate(tc.Model(bar()), 0.1, rest_length=[1.0, 1.0])


@pytest.mark.parametrize("load", [0, 0.0, np.zeros((3, 6)), [[0] * 6] * 3], ids=repr)
def test_a_load_of_zero_needs_no_model_that_takes_one(load):
    bare = tc.simulate(MODEL, 0.1, force_density=GAMMA, step=1e-3)
    loaded = tc.Model(PRISM, external_force=True)
    for model in (MODEL, loaded):
        run = tc.simulate(model, 0.1, force_density=GAMMA, step=1e-3, external_force=load)
        np.testing.assert_allclose(run.nodes, bare.nodes, atol=1e-14)
    starts = np.zeros((2, 3, 6))
    scene = tc.Scene(
        MODEL, 0.1, force_density=GAMMA, external_force=load, integration=tc.Integration(step=1e-3)
    )
    for vary in ({}, {"external_force": np.zeros((2, 3, 6))}):
        batch = tc.simulate_many(scene, {"velocities": starts} | vary)
        np.testing.assert_allclose(batch.nodes[1, :, :, -1], bare.nodes[:, :, -1], atol=1e-14)


@pytest.mark.parametrize(
    "load",
    [1.0, np.ones((3, 6)), lambda time: np.zeros((3, 6))],
    ids=["number", "array", "function"],
)
def test_another_load_does(load):
    with pytest.raises(ValueError, match=r"takes no load|has shape"):
        tc.simulate(MODEL, 0.1, force_density=GAMMA, external_force=load)


def test_loads_of_many_runs_are_not_lost():
    loads = np.zeros((2, 3, 6))
    loads[1] = 1.0
    with pytest.raises(ValueError, match="the model takes no load"):
        tc.simulate_many(tc.Scene(MODEL, 0.1, force_density=GAMMA), {"external_force": loads})


def test_inputs_may_be_columns():
    known = tc.simulate(MODEL, 0.1, force_density=0.9 * GAMMA, step=1e-3)
    run = tc.simulate(MODEL, 0.1, force_density=0.9 * GAMMA[:, None], step=1e-3)
    np.testing.assert_array_equal(run.nodes, known.nodes)


def test_no_faults_may_be_none():
    run = tc.simulate(MODEL, 0.1, force_density=GAMMA, faults=None)
    assert not run.faults


def test_a_fault_without_an_end_may_end_at_infinity():
    assert tc.StuckWinch(string=2.0, time=0.1, until=np.inf) == tc.StuckWinch(string=2, time=0.1)
    for until in (np.inf, None):
        assert tc.LostMeasurement(time=0.5, until=until).end == np.inf


def test_a_seed_without_an_estimator_does_nothing():
    known = tc.simulate(MODEL, 0.1, force_density=GAMMA, step=1e-3)
    run = tc.simulate(MODEL, 0.1, force_density=GAMMA, step=1e-3, seed=3)
    np.testing.assert_array_equal(run.nodes, known.nodes)


def test_infinite_limits_of_health_are_none():
    none = tc.HealthLimits(energy_error=None, position_error=None)
    limits = tc.HealthLimits(energy_error=np.inf, position_error=np.float64(np.inf))
    assert limits == none


def test_supports_that_are_not_there_may_move():
    run = tc.simulate(MODEL, 0.1, force_density=GAMMA, support_motion=np.zeros((3, 0)))
    assert run.completed if hasattr(run, "completed") else len(run.time)
    with pytest.raises(ValueError, match="no node of the structure is fixed"):
        tc.simulate(MODEL, 0.1, force_density=GAMMA, support_motion=np.zeros((3, 1)))


def test_supports_at_rest_may_be_told_by_0():
    model = tc.Model(tc.Structure(PRISM.nodes, PRISM.bars, PRISM.strings, 1.0, fixed=[3, 4, 5]))
    runs = [
        tc.simulate(model, 0.1, force_density=10.0, support_motion=motion)
        for motion in (0, np.zeros((3, 3)))
    ]
    np.testing.assert_array_equal(runs[0].nodes, runs[1].nodes)


def test_kept_nodes_may_be_a_mask():
    starts = np.zeros((2, 3, 6))
    how = tc.Integration(step=1e-2)
    scene = tc.Scene(MODEL, 0.1, force_density=0.9 * GAMMA, integration=how)
    known = tc.simulate_many(scene, {"velocities": starts}, keep_nodes=[1, 2])
    for nodes in (np.isin(np.arange(6), [1, 2]), [1, 2, 1], {1, 2}):
        batch = tc.simulate_many(scene, {"velocities": starts}, keep_nodes=nodes)
        np.testing.assert_array_equal(batch.nodes, known.nodes)
