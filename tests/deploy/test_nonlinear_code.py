"""Nonlinear MPC as C code does what it does in Python."""

import numpy as np
import pytest

from tenscontrol.demo import tour as demo
from tenscontrol.dynamics.machine_code import compiler
from tests.deploy import scenes

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


def test_force_density_along_a_moving_reference(tmp_path):
    pair = scenes.pair_of(scenes.nonlinear(), tmp_path)
    run = scenes.closed_loop(pair)
    scenes.check(pair)
    # Within 2 mm of the new height, although eight samples were spoilt.
    assert np.abs(demo.height_of(run.nodes)[run.time > 3.5] - demo.TARGET).max() < 2e-3


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """An estimate of the load, and code that does the same."""
    return scenes.pair_of(scenes.nonlinear_with_load(), tmp_path_factory.mktemp("loaded"))


def test_unknown_load_is_estimated_alike(loaded):
    run = scenes.closed_loop(loaded, pull=2 / 3)
    scenes.check(loaded)
    assert np.linalg.norm(loaded.one.load) > 0.1
    # Without the estimate 2 N leave the height off by 5 mm.
    assert np.abs(demo.height_of(run.nodes)[run.time > 3.5] - demo.TARGET).max() < 1.5e-3


def test_motions_that_no_load_explains(loaded):
    """Shaken, with actuators that do not hold what is commanded."""
    plant, rng = loaded.plant, np.random.default_rng(0)
    loaded.reset()
    for k in range(60):
        given = loaded.command(
            k * scenes.SAMPLE,
            plant.to_nodes(0.05 * rng.normal(size=9)),
            plant.to_velocities(np.zeros(9), 0.3 * rng.normal(size=9)),
        )
        if k % 7 == 0:
            loaded.applied(given.value + rng.uniform(0.0, 1.0, size=9))
    assert loaded.statuses[0] == loaded.statuses[1]
    assert {"ok", "measurement not finite: plan continued"} <= set(loaded.statuses[1])
    assert loaded.error < 1e-10


def test_no_load_is_told_from_a_motion_without_a_value(loaded):
    """Strings that pull this hard turn bars beyond what the coordinates can say."""
    plant, still = loaded.plant, np.zeros((3, 6))
    loaded.reset()
    pulled, nodes = np.linspace(1e4, 1e6, 9), plant.to_nodes(np.full(9, 0.01))
    assert np.isnan(
        loaded.one.law.model.discretization.advance(plant.measure(nodes, still), pulled, pulled)[0]
    ).any()
    for k in range(6):
        loaded.command(k * scenes.SAMPLE, nodes, still)
        if k == 2:
            before = loaded.one.load
            loaded.applied(pulled)
        if k == 3:
            np.testing.assert_array_equal(loaded.one.load, before)
    assert loaded.statuses == (["ok"] * 6,) * 2
    assert loaded.error < 1e-10


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    """Winches, limited rows, and code that does the same."""
    return scenes.pair_of(scenes.nonlinear_of_rest_length(), tmp_path_factory.mktemp("limited"))


def test_limited_rows_and_winches(limited):
    plant, rng = limited.plant, np.random.default_rng(3)
    limited.reset()
    for k in range(100):
        given = limited.command(
            k * scenes.SAMPLE,
            plant.to_nodes(0.003 * rng.normal(size=9)),
            plant.to_velocities(np.zeros(9), 0.02 * rng.normal(size=9)),
        )
        if k % 3 == 0:
            limited.applied(given.value + 0.01 * rng.normal(size=9))
    assert limited.statuses[0] == limited.statuses[1]
    assert {"ok", "measurement not finite: plan continued"} <= set(limited.statuses[1])
    assert max(limited.iterations) > 10  # changes of the active set
    assert limited.error < 1e-10


def test_plan_that_ends_is_forgotten(limited):
    """Rest lengths that stand are held once the plan is used up, and before there is one."""
    lost, nodes = np.full((3, 6), np.inf), limited.plant.nodes
    limited.reset()
    limited.applied(1.01 * limited.plant.rest_length)
    for k, measured in enumerate([lost, nodes, lost, lost, lost, lost, nodes]):
        limited.command(scenes.SAMPLE * k, measured, np.zeros((3, 6)))
    held, followed = "previous input held", "plan continued"
    statuses = [status.split(": ")[-1] for status in limited.statuses[1]]
    assert statuses == [held, "ok", followed, followed, held, held, "ok"]
    assert limited.statuses[0] == limited.statuses[1]
    assert limited.error < 1e-10
