"""Profiles, and what replaces callables: polynomials piece by piece."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import tenscontrol as tc
from tenscontrol.dynamics.profile import Pieces, as_pieces

TIME = np.array([0.3, 0.5, 1.2, 2.0])
LOOKS = np.linspace(0.3, 2.0, 200)[:-1]


@pytest.fixture
def values():
    return np.random.default_rng(3).uniform(0.5, 2.0, (2, 3, 4))


def test_linear_profiles_go_straight(values):
    profile = tc.Profile(TIME, values)
    expected = [np.interp(LOOKS, TIME, row) for row in values.reshape(6, 4)]
    np.testing.assert_allclose(profile.at(LOOKS).reshape(6, -1), expected, rtol=1e-14)
    np.testing.assert_allclose(profile.rate(1.0), (values[..., 2] - values[..., 1]) / 0.7)


def test_cubic_profiles_are_the_clamped_spline(values):
    profile = tc.Profile(TIME, values, "cubic")
    spline = CubicSpline(TIME, values, axis=2, bc_type="clamped")
    np.testing.assert_allclose(profile.at(LOOKS), spline(LOOKS), rtol=1e-13)
    np.testing.assert_allclose(profile.rate(LOOKS), spline(LOOKS, 1), atol=1e-12)


def test_cubic_profiles_keep_rates_that_are_given():
    time = np.array([0.0, 0.3, 1.1, 2.0])
    cubic = tc.Profile(time, [time**3, 1 - time], "cubic", [3 * time**2, 0 * time - 1])
    look = np.linspace(0.0, 1.999, 50)
    np.testing.assert_allclose(cubic.at(look), [look**3, 1 - look], atol=1e-14)
    np.testing.assert_allclose(cubic.rate(look), [3 * look**2, 0 * look - 1], atol=1e-13)
    for rates, how, text in ((time, "linear", "they are for 'cubic'"), (3.0, "cubic", "rates")):
        with pytest.raises(ValueError, match=text):
            tc.Profile(time, time, how, rates)


def test_held_profiles_jump_and_so_does_a_time_given_twice():
    held = tc.Profile([0.0, 1.0, 2.0], [5.0, 6.0, 7.0], "hold")
    assert held.at([-1.0, 0.0, 0.9, 1.0, 1.9, 2.0, 9.0]).tolist() == [5, 5, 5, 6, 6, 7, 7]
    jumping = tc.Profile([0.0, 1.0, 1.0, 2.0], [0.0, 1.0, 3.0, 3.0])
    assert jumping.at([0.5, 1.0, 1.5]).tolist() == [0.5, 3.0, 3.0]


@pytest.mark.parametrize("interpolation", ["hold", "linear", "cubic"])
def test_first_and_last_value_hold_outside(values, interpolation):
    profile = tc.Profile(TIME, values, interpolation)
    np.testing.assert_array_equal(profile.at(0.0), values[..., 0])
    np.testing.assert_array_equal(profile.at([2.0, 8.0])[..., 1], values[..., -1])
    assert not profile.rate([0.1, 2.5]).any()


def test_a_stack_has_the_pieces_of_all(values):
    parts = [tc.Profile(TIME, values, "cubic"), tc.Profile([0.1, 0.7], values[0, :, :2])]
    stacked = Pieces.stacked([part.pieces for part in parts])
    expected = np.vstack([part.at(LOOKS).reshape(-1, len(LOOKS)) for part in parts])
    np.testing.assert_allclose(stacked.at(LOOKS), expected, rtol=1e-13)
    assert stacked.breaks(0.0, 3.0) == [0.1, 0.3, 0.5, 0.7, 1.2, 2.0]


def test_callables_become_polynomials():
    def wave(t):
        return np.array([[np.sin(9 * t), 2.0 + t], [0.0, np.exp(-t)]])

    pieces = as_pieces("external_force", wave, (2, 2), "", 0.0, 4.0)
    looks = np.linspace(0.0, 4.0, 777)
    expected = np.array([wave(t).ravel(order="F") for t in looks]).T
    np.testing.assert_allclose(pieces.at(looks), expected, atol=1e-11)
    assert len(pieces.start) < 60


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda t: float(t > 1.234), "x jumps, has a kink or is not smooth near 1.23"),
        (lambda t: abs(t - 1.234), "x jumps, has a kink .* Give a tc.Profile"),
        (lambda t: np.nan if t > 1 else 1.0, r"x at 1\..* s is nan"),
        (lambda t: [1.0, 2.0, 3.0], r"x returns shape \(3,\) at 0 s, expected \(2,\)"),
    ],
)
def test_callables_that_cannot_be_resolved_are_refused(function, message):
    with pytest.raises(ValueError, match=message):
        as_pieces("x", function, (2,), "", 0.0, 3.0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (([0.0, 1.0], [1.0, 2.0, 3.0]), r"values has shape \(3,\), expected \(\.\.\., 2\)"),
        (([], []), r"time has shape \(0,\)"),
        (([0.0, 2.0, 1.0], [1.0, 2.0, 3.0]), r"time\[2\] is 1 s after 2 s"),
        (([0.0, 1.0, 1.0], [1.0, 2.0, 3.0], "cubic"), r"time\[2\] is 1 s after 1 s"),
        (([0.0, 0.0, 0.0], [1.0, 2.0, 3.0]), r"time\[2\]"),
        (([0.0, 1.0], [1.0, np.inf]), r"values\[1\] is inf"),
        (([0.0, 1.0], [1.0, 2.0], "quintic"), "interpolation"),
    ],
)
def test_wrong_profiles_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        tc.Profile(*given)
