"""Limits of winches and motors that are none."""

import numpy as np
import pytest

import tenscontrol as tc

INF = np.inf


def test_infinite_limits_of_winches_are_none():
    for winches in (
        tc.Winches(rate=INF, shortest=0.0, longest=INF),
        tc.Winches(rate=[INF] * 3, shortest=[0.0] * 3, longest=[[INF]] * 3),
        tc.Winches(rate=[], shortest=[], longest=[]),
    ):
        assert (winches.rate, winches.shortest, winches.longest) == (None, None, None)
        assert winches.move([1.0, 1.0, 1.0], [5.0, 1.0, 0.1], 0.02).rest_length[0] == 5.0


def test_some_winches_may_have_no_limit():
    winches = tc.Winches(rate=[INF, 0.5], shortest=[0.2, 0.0], longest=[INF, 0.9])
    move = winches.move([0.8, 0.8], [[0.1], [0.1]], 0.02)
    np.testing.assert_allclose(move.rest_length, [0.2, 0.79])


def test_infinite_limits_of_motors_are_none():
    motor = tc.Motor(drum_radius=0.01, torque=INF, speed=[INF, INF])
    assert (motor.torque, motor.speed) == (None, None)
    some = tc.Motor(drum_radius=0.01, speed=[INF, 10.0])
    np.testing.assert_allclose(tc.Winches(motor=some).largest_rate, [INF, 0.1])


def test_a_motor_with_inertia_still_needs_a_torque():
    for torque in (None, INF, [1.0, INF]):
        with pytest.raises(ValueError, match="inertia needs torque"):
            tc.Motor(drum_radius=0.01, torque=torque, inertia=1e-6)


@pytest.mark.parametrize("wrong", [np.nan, -INF, 0.0, [INF, 0.0]])
def test_other_limits_are_refused(wrong):
    with pytest.raises(ValueError, match="rate"):
        tc.Winches(rate=wrong)
    with pytest.raises(ValueError, match="torque"):
        tc.Motor(drum_radius=0.01, torque=wrong)


def test_a_winch_that_is_never_short_enough_is_refused():
    with pytest.raises(ValueError, match="shortest is inf"):
        tc.Winches(shortest=INF)
