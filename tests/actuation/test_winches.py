"""Winches: what they reach is within their limits, nearest to the command, and flagged."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import tenscontrol as tc
from tenscontrol.plant.input_bounds import largest_change

COUNT = 5
RATE, SHORTEST, LONGEST, STEP = 0.5, 0.3, 1.5, 0.02
limited = tc.Winches(rate=RATE, shortest=SHORTEST, longest=LONGEST)
within = arrays(float, COUNT, elements=st.floats(SHORTEST, LONGEST))
anywhere = arrays(float, COUNT, elements=st.floats(0.01, 3.0))


@given(current=within, wanted=anywhere)
def test_the_reached_rest_lengths_keep_every_limit(current, wanted):
    reached = limited.move(current, wanted, STEP).rest_length
    assert (reached >= SHORTEST).all()
    assert (reached <= LONGEST).all()
    assert (np.abs(reached - current) <= RATE * STEP * (1 + 1e-12)).all()


@given(current=within, wanted=anywhere)
def test_the_reached_rest_lengths_are_the_nearest_to_the_command(current, wanted):
    reached = limited.move(current, wanted, STEP).rest_length
    for start, goal, found in zip(current, wanted, reached, strict=True):
        low, high = max(SHORTEST, start - RATE * STEP), min(LONGEST, start + RATE * STEP)
        assert found == min(max(goal, low), high)


@given(current=within, wanted=anywhere)
def test_flags_name_the_limits_that_were_met(current, wanted):
    move = limited.move(current, wanted, STEP)
    outside = (wanted < SHORTEST) | (wanted > LONGEST)
    np.testing.assert_array_equal(move.range_limited, np.flatnonzero(outside))
    late = move.rest_length != np.minimum(np.maximum(wanted, SHORTEST), LONGEST)
    np.testing.assert_array_equal(move.rate_limited, np.flatnonzero(late))


@given(current=within, wanted=anywhere)
def test_a_reached_rest_length_is_reached_again_at_once(current, wanted):
    once = limited.move(current, wanted, STEP).rest_length
    again = limited.move(current, once, STEP)
    np.testing.assert_array_equal(again.rest_length, once)
    stay = limited.move(once, once, STEP)
    np.testing.assert_array_equal(stay.rest_length, once)
    assert len(stay.rate_limited) == len(stay.range_limited) == 0


@given(current=within, wanted=within)
def test_a_command_within_range_is_reached_in_the_time_it_takes(current, wanted):
    now = current
    for _ in range(int(np.ceil((LONGEST - SHORTEST) / (RATE * STEP))) + 1):
        now = limited.move(now, wanted, STEP).rest_length
    np.testing.assert_array_equal(now, wanted)


@given(current=within, wanted=anywhere)
def test_two_half_samples_reach_what_one_sample_does(current, wanted):
    whole = limited.move(current, wanted, STEP).rest_length
    half = limited.move(current, wanted, STEP / 2).rest_length
    both = limited.move(half, wanted, STEP / 2).rest_length
    np.testing.assert_allclose(both, whole, rtol=1e-14)


@given(current=within, wanted=anywhere)
def test_winches_without_limits_follow_at_once(current, wanted):
    move = tc.Winches().move(current, wanted, STEP)
    np.testing.assert_array_equal(move.rest_length, wanted)
    assert len(move.rate_limited) == len(move.range_limited) == 0


@given(current=within, wanted=anywhere, rates=arrays(float, COUNT, elements=st.floats(0.01, 10.0)))
def test_each_winch_has_its_own_limits(current, wanted, rates):
    together = tc.Winches(rate=rates).move(current, wanted, STEP).rest_length
    alone = [
        tc.Winches(rate=rates[i]).move(current[i : i + 1], wanted[i : i + 1], STEP).rest_length[0]
        for i in range(COUNT)
    ]
    np.testing.assert_array_equal(together, alone)


def test_results_are_read_only():
    move = limited.move(np.ones(2), np.ones(2), STEP)
    with pytest.raises(ValueError, match="read-only"):
        move.rest_length[0] = 0.0


def test_angles_and_rest_lengths_are_inverse():
    motor = tc.Motor(drum_radius=[0.01, 0.02], gear_ratio=20.0, zero=[0.8, 0.9])
    lengths = np.random.default_rng(0).uniform(0.5, 1.0, (2, 7))
    np.testing.assert_allclose(motor.rest_length(motor.angle(lengths)), lengths, rtol=1e-14)
    np.testing.assert_allclose(motor.rest_length([1.0, 0.0]), [0.8 - 0.01 / 20, 0.9])
    np.testing.assert_array_equal(motor.angle(lengths[:, 0], lengths[:, 0]), [0.0, 0.0])


def test_the_speed_of_a_motor_bounds_the_rate():
    motor = tc.Motor(drum_radius=0.01, gear_ratio=20.0, speed=400.0)  # 0.2 m/s
    winches = tc.Winches(rate=[0.1, 0.3], motor=motor)
    np.testing.assert_array_equal(winches.largest_rate, [0.1, 0.2])
    move = winches.move([1.0, 1.0], [0.9, 0.9], STEP)
    np.testing.assert_allclose(move.rest_length, 1.0 - STEP * np.array([0.1, 0.2]))
    assert tc.Winches(motor=tc.Motor(0.01)).largest_rate is None
    plant = tc.linearize(
        tc.Model(tc.prism(), strings=tc.LinearStrings(1e3)),
        tc.prestress(tc.prism(), 17.3),
        input="rest_length",
    )
    change = largest_change(plant.input, plant.actuation, None, tc.Winches(motor=motor), STEP)
    np.testing.assert_allclose(change, np.full(9, 0.2 * STEP))


@pytest.mark.parametrize("more", [{}, {"ramp": True}, {"motor": tc.Motor(0.01), "ramp": True}])
@pytest.mark.parametrize("kind", [tc.LQR, tc.MPC])
def test_an_infinite_rate_is_no_limit(prism, rest, kind, more):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    plant = tc.linearize(model, rest, input="rest_length")
    ends = []
    for rate in (None, np.inf, np.full(9, np.inf)):
        winches = tc.Winches(rate=rate, **more)
        horizon = {"horizon": 4} if kind is tc.MPC else {}
        run = tc.simulate(
            model, 0.1, plant.to_nodes(0.02 * np.ones(9)), step=2e-3, winches=winches,
            controller=kind(plant, sample_time=0.02, winches=winches, **horizon),
            rest_length=plant.rest_length,
        )  # fmt: skip
        assert run.control.rate_limited.max() == 0
        ends.append(run.nodes[..., -1])
    np.testing.assert_array_equal(ends[0], ends[1])
    np.testing.assert_array_equal(ends[0], ends[2])


def test_one_winch_without_a_limit_of_rate_jumps():
    rate = np.full(9, 0.1)
    rate[4] = np.inf
    move = tc.Winches(rate=rate).move(np.ones(9), np.full(9, 0.5), 0.02)
    expected = np.full(9, 0.998)
    expected[4] = 0.5
    np.testing.assert_allclose(move.rest_length, expected, rtol=1e-12)
    assert move.rate_limited.tolist() == [0, 1, 2, 3, 5, 6, 7, 8]


def test_no_message_names_a_bound_that_is_not_there(prism, rest):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    low = tc.Height(0.85, top=[0, 1, 2], bottom=[3, 4, 5])
    plant = tc.linearize(model, rest, input="rest_length")
    with pytest.raises(ValueError, match="leave the 'top' strings at least 17 N/m in the mean"):
        tc.shape_target(model, low, force_density=5.0, min_force_density=17.0)
    with pytest.raises(ValueError, match=r"plant.rest_length\[0\] is .* expected at least 2 m: "):
        tc.LQR(plant, sample_time=0.02, winches=tc.Winches(shortest=2.0))
    held = tc.Structure(
        [[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]], [], [[0, 1]], [], point_mass=[0.0, 1.0], fixed=[0]
    )
    force = np.array([[0.0, 5.0], [0.0, 0.0], [0.0, 0.0]])
    with pytest.raises(ValueError, match="get γ = 5 N/m, expected at least 9 N/m"):
        tc.prestress(held, min_force_density=9.0, external_force=force)
