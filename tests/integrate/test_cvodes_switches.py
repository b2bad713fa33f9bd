"""Calls of CVODES that end where strings go slack or taut."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics import Equation
from tenscontrol.dynamics.equation import pack_state, unpack_states
from tenscontrol.integrate import IntegrationError
from tenscontrol.integrate.cvodes import CVODES
from tests.dynamics.scenes import paper_force_density, rest_lengths
from tests.integrate.stepping import smooth_equation
from tests.integrate.test_rk4 import explosion, oscillator
from tests.located_motion import exact_motion
from tests.oracle import HeldRestLength

# Border of slack in units of the scene, as documented.
BAND = 1e-11


def switched(slope, gap, states):
    """An equation with one string, from functions of the state and of whether it pulls."""
    x, u, taut = ca.SX.sym("x", states), ca.SX.sym("u", 0), ca.SX.sym("taut")
    return Equation(
        slope=ca.Function("slope", [x, u, taut], [slope(x, taut)]),
        gap=ca.Function("gap", [x, u], [gap(x), ca.SX(1, 1)]),
    )


def valley(bottom):
    """A gap ``(t - 1)² + bottom``, and the time that it is negative as the third state."""
    return switched(
        lambda x, taut: ca.vertcat(x[1], 2.0, 1 - taut), lambda x: x[0] + bottom, states=3
    )


def test_the_time_spent_slack_is_exact():
    """Two switches 2√0.3 s apart, in a motion that the methods follow in long steps."""
    run = CVODES(valley(-0.3), 1e-8).advance(np.array([1.0, -2.0, 0.0]), np.zeros(0), 3.0, 30)
    assert run.work.switches == 2
    assert run.work.missed == 0
    times = 0.1 * np.arange(1, 31)
    root = np.sqrt(0.3)
    slack = np.clip(times - (1 - root), 0, 2 * root)
    error = np.abs(run.states - [(times - 1) ** 2, 2 * (times - 1), slack]).max()
    assert error < 1e-6


@pytest.mark.parametrize("depth", [1e-2, 1e-4, 1e-6])
def test_both_switches_within_one_step_are_found(depth):
    """Slack for 2√depth s: less than the distance of the times looked at."""
    run = CVODES(valley(-depth), 1e-11).advance(np.array([1.0, -2.0, 0.0]), np.zeros(0), 3.0, 1)
    assert run.work.switches == 2
    np.testing.assert_allclose(run.states[2, -1], 2 * np.sqrt(depth), rtol=1e-3)


@pytest.mark.parametrize("bottom", [0.0, 1e-13, -1e-13, 1e-9])
def test_a_string_that_grazes_the_border_keeps_pulling(bottom):
    run = CVODES(valley(bottom), 1e-10).advance(np.array([1.0, -2.0, 0.0]), np.zeros(0), 3.0, 7)
    assert run.work.switches in (0, 2)  # round-off decides whether it was touched
    assert run.states[2, -1] < 5e-5
    np.testing.assert_allclose(run.states[0, -1], 4.0, rtol=1e-6)


def test_a_string_that_rests_on_the_border_does_not_switch():
    still = switched(lambda x, taut: ca.vertcat(x[1], 0.0), lambda x: x[0], states=2)
    run = CVODES(still, 1e-8).advance(np.zeros(2), np.zeros(0), 1.0, 5)
    assert run.work.switches == 0
    np.testing.assert_array_equal(run.states, np.zeros((2, 5)))


def test_a_string_that_neither_pulls_nor_hangs_is_reported():
    """Slack it is drawn taut, taut it is let slack: no motion goes on from there."""
    sliding = switched(lambda x, taut: 1 - 2 * taut, lambda x: x, states=1)
    with pytest.raises(
        IntegrationError, match=r"go slack and taut, or .* 200 times within"
    ) as info:
        CVODES(sliding, 1e-8).advance(np.array([0.25]), np.zeros(0), 1.0, 10)
    assert info.value.time == pytest.approx(0.25, abs=1e-6)
    np.testing.assert_allclose(info.value.span.states[0], [0.15, 0.05], atol=1e-12)
    assert info.value.span.work.switches == 200


def test_a_mass_on_a_string_flies_free_and_bounces():
    """Between a taut string and free flight its speed at the border stays the same."""
    k = 400.0
    bounce = switched(
        lambda x, taut: ca.vertcat(x[1], -k * taut * x[0] + 2.0 * (1 - taut)), lambda x: x[0], 2
    )
    # It starts farthest out: π/ω taut and, with 1 m/s at the border, 2 v/a slack.
    period = np.pi / np.sqrt(k) + 1.0
    tolerance = 1e-11
    run = CVODES(bounce, tolerance).advance(np.array([0.05, 0.0]), np.zeros(0), 5 * period, 10)
    assert run.work.switches == 10
    error = np.abs(run.states[:, 1::2] - [[0.05], [0.0]]).max()
    assert error < 1e-5  # of a speed that changes by 20 m/s²


def test_damped_strings_follow_the_oracle(prism):
    """They go slack before they are short, and taut with a jerk: 48 switches in 1.5 s."""
    damping = 0.05
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    times = np.linspace(0, 1.5, 16)
    law = HeldRestLength(lengths, 100.0, damping)
    exact, _ = exact_motion(prism, law, times)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping))
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    tolerance = 1e-11
    run = CVODES(model.equation("rest_length"), tolerance).advance(state, lengths, 1.5, 15)
    assert run.work.switches == 48
    assert np.abs(unpack_states(prism, run.states)[0] - exact[:, :, 1:]).max() < 2e-8


@pytest.mark.parametrize("damping", [0.0, 1.0])
def test_a_slack_string_may_have_no_length(damping):
    """Two masses in one place: no direction of the string, and none of its derivatives."""
    line = tc.Structure(
        [[0.0, 0.0, 1.0, -1.0], [0.0] * 4, [0.0] * 4],
        [],
        [[0, 1], [1, 2], [0, 3]],
        [],
        string_node_mass=1.0,
    )
    model = tc.Model(line, strings=tc.LinearStrings(100.0, damping))
    state = pack_state(line, line.nodes, np.zeros((3, 4)))
    run = CVODES(model.equation("rest_length"), 1e-9).advance(
        state, np.array([0.5, 0.8, 0.8]), 0.1, 10
    )
    assert run.work.switches == 0
    x = unpack_states(line, run.states)[0][0]
    np.testing.assert_allclose(x, -x[[1, 0, 3, 2]], atol=1e-12)
    if damping == 0.0:  # each pair closes 0.2 m beyond its rest length with ω² = 2 k/m
        expected = 0.8 + 0.2 * np.cos(np.sqrt(200.0) * 0.01 * np.arange(1, 11))
        np.testing.assert_allclose(x[2] - x[1], expected, atol=1e-6)


def test_nothing_is_looked_for_where_no_string_can_go_slack():
    integrator = CVODES(smooth_equation(oscillator()), 1e-8)
    run = integrator.advance(np.zeros(2), np.ones(1), 5.0, 5)
    assert run.work.switches == 0
    assert integrator._gap_of is None


def test_a_tolerance_below_round_off_is_refused():
    with pytest.raises(ValueError, match="double precision goes no further"):
        CVODES(smooth_equation(oscillator()), 1e-16)


def test_progress_is_reported_up_to_the_end():
    times = []
    CVODES(smooth_equation(oscillator()), 1e-6).advance(
        np.zeros(2), np.ones(1), 0.3, 3, times.append
    )
    assert times == sorted(times)
    assert times[-1] == 0.3


def test_a_singularity_stops_with_what_was_good(capfd):
    with pytest.raises(IntegrationError, match="cvodes stopped after") as info:
        CVODES(smooth_equation(explosion()), 1e-8).advance(np.ones(1), np.zeros(1), 2.0, 40)
    good = info.value.span.states
    assert info.value.time == pytest.approx(1.0, abs=1e-3)
    assert good.shape[1] in (19, 20)
    np.testing.assert_allclose(good[0, :19], 1 / (1 - 0.05 * np.arange(1, 20)), rtol=1e-4)
    assert info.value.span.work.steps > 0
    assert capfd.readouterr() == ("", "")


def test_a_start_without_finite_forces_is_refused(capfd):
    x, u = ca.SX.sym("x"), ca.SX.sym("u")
    pole = smooth_equation(ca.Function("pole", [x, u], [1 / x + 0 * u]))
    with pytest.raises(IntegrationError, match="cvodes stopped after 0 s") as info:
        CVODES(pole, 1e-8).advance(np.zeros(1), np.zeros(1), 1.0, 4)
    assert info.value.span.states.shape == (1, 0)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("outputs", [1, 7, 64, 100, 300, 513])
def test_states_do_not_depend_on_how_many_are_asked_for(outputs):
    """The methods' own steps, or calls, differ by outputs for one of them: by the tolerance."""
    run = CVODES(smooth_equation(oscillator()), 1e-10).advance(
        np.zeros(2), np.ones(1), 5.0, outputs
    )
    times = 5.0 * np.arange(1, outputs + 1) / outputs
    assert run.states.shape == (2, outputs)
    error = np.abs(run.states - [1 - np.cos(times), np.sin(times)]).max()
    assert error < 5e-8


def test_the_border_is_as_documented():
    """A string may pass it by a band before it switches, and has to come back by two."""
    steady = switched(lambda x, taut: ca.vertcat(ca.DM(-1.0), 1 - taut), lambda x: x[0], 2)
    run = CVODES(steady, 1e-10).advance(np.array([0.5, 0.0]), np.zeros(0), 1.0, 1)
    # Slack from when the gap is minus a band.
    assert 0.5 - run.states[1, -1] == pytest.approx(BAND, rel=0.3)
