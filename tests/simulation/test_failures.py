"""Motions that run away: the error carries what was good."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.integrate import IntegrationError
from tests.simulation.test_closed_loop import Script


def stiff_model():
    """Strings of 1e6 N/m: their modes need steps far below a millisecond."""
    return tc.Model(tc.prism(), strings=tc.LinearStrings(1e6))


def tight():
    return 0.8 * tc.prism().string_length()


@pytest.fixture(scope="module")
def failure():
    """rk4 with a step some thirty times too long."""
    with pytest.raises(tc.simulation.SimulationError) as info:
        tc.simulate(stiff_model(), 2.0, rest_length=tight(), step=1e-2)
    return info.value


def test_the_message_says_when_and_what_to_try(failure):
    assert "the simulation stopped at 0." in str(failure)
    assert "try a step below 0.01 s" in str(failure)
    assert ".trajectory" in str(failure)


def test_the_cause_is_an_integration_error(failure):
    assert isinstance(failure.__cause__, IntegrationError)
    assert isinstance(failure, ArithmeticError)


def test_the_trajectory_holds_the_finite_part(failure):
    run = failure.trajectory
    assert 0 < run.time[-1] < 2.0
    assert len(run.time) == run.nodes.shape[2] == run.force_density.shape[1] > 5
    assert np.isfinite(run.nodes).all()
    assert np.isfinite(run.velocities).all()
    assert run.steps >= len(run.time) - 1


def test_the_trajectory_is_that_of_a_shorter_run(failure):
    with pytest.warns(
        RuntimeWarning, match=r"bar length error .* above its limit .* step below 0\.01 s"
    ):
        shorter = tc.simulate(stiff_model(), 0.05, rest_length=tight(), step=1e-2)
    np.testing.assert_allclose(failure.trajectory.nodes[:, :, :6], shorter.nodes, rtol=1e-9)


def test_a_short_enough_step_cures_it():
    run = tc.simulate(stiff_model(), 0.05, rest_length=tight(), step=1e-4)
    assert np.abs(run.nodes).max() < 2.0
    assert np.abs(run.bar_length_error).max() < 1e-2


def test_a_failure_in_the_first_step_leaves_the_start():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(1e70))
    with pytest.raises(tc.simulation.SimulationError) as info:
        tc.simulate(model, 1.0, rest_length=tight(), step=0.1, method="rk4")
    run = info.value.trajectory
    assert run.time.tolist() == [0.0]
    np.testing.assert_array_equal(run.nodes[:, :, 0], tc.prism().nodes)


def test_the_adaptive_method_fails_loudly_too():
    """A tolerance so loose that a bar loses its length and with it its direction."""
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(1e5))
    options = {"rest_length": tight(), "tolerance": 5e-2, "project": False}
    with pytest.raises(tc.simulation.SimulationError, match="dop853 stopped after") as info:
        tc.simulate(model, 0.2, method="dop853", **options)
    with pytest.warns(RuntimeWarning, match="bar length error .* smaller tolerance"):
        assert "dop853 stopped after" in tc.simulate(model, 0.2, **options).choice.changes[0].reason
    run = info.value.trajectory
    assert 0 < run.time[-1] < 0.2
    assert np.isfinite(run.nodes).all()


def test_one_that_stops_before_the_first_output_leaves_the_start():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(1e5))
    options = {"rest_length": tight(), "tolerance": 5e-2, "project": False, "output_step": 2.0}
    with pytest.raises(tc.simulation.SimulationError, match="dop853 stopped after") as info:
        tc.simulate(model, 2.0, method="dop853", **options)
    assert info.value.trajectory.time.tolist() == [0.0]


def test_in_closed_loop_the_record_comes_with_it(rest):
    model = stiff_model()
    plant = tc.linearize(model, rest, "rest_length")
    controller = Script(plant, [tight()], step=0.02)
    with pytest.raises(tc.simulation.SimulationError) as info:
        tc.simulate(model, 2.0, controller=controller, step=1e-2)
    run = info.value.trajectory
    assert np.isfinite(run.nodes).all()
    # Every command that was given is on record, the last one's sample included.
    assert len(run.control.time) == len(controller.seen)
    assert run.control.time[-1] <= run.time[-1] < run.control.time[-1] + 0.02 + 1e-9


def test_a_motion_that_stretches_bars_is_returned_with_a_warning():
    """A tolerance too loose for stiff strings: nothing breaks, but the motion means nothing."""
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(1e5))
    with pytest.warns(RuntimeWarning, match="bar length error .* smaller tolerance"):
        tc.simulate(model, 1.0, rest_length=tight(), tolerance=5e-4, project=False)


@pytest.mark.parametrize(("stiffness", "step"), [(1e4, 5e-3), (1e5, 5e-3), (1e7, 0.02)])
def test_a_motion_that_runs_away_on_the_ground_is_in_the_error(stiffness, step):
    """Works of the ground over its last steps mean nothing, or overflow."""
    ball = tc.library.six_bar_ball()
    ground = tc.Ground(stiffness=stiffness, damping=100.0, friction=0.5)
    model = tc.Model(ball, strings=tc.LinearStrings(1e3), gravity=9.81, ground=ground)
    nodes = ball.nodes + np.array([[0.0], [0.0], [0.3 - ball.nodes[2].min()]])
    with pytest.raises(tc.simulation.SimulationError, match="no longer finite") as info:
        tc.simulate(model, 1.0, nodes, rest_length=0.9 * ball.string_length(), step=step)
    run = info.value.trajectory
    assert len(run.time) > 10
    assert np.isfinite(run.nodes).all()
    assert run.contacts.work_error > 1
    assert "stopped" in run.summary()
