"""Largest stable steps, measured and by theory."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy.open_loop import fastest_rate
from tenscontrol.accuracy.stability_map import prism_near_rest, theoretical_limit


def test_limits_of_theory():
    assert theoretical_limit("rk4") == pytest.approx(2 * np.sqrt(2))
    assert np.isnan(theoretical_limit("dop853"))


def test_the_limit_of_runge_and_kutta_is_where_its_polynomial_leaves_the_circle():
    def size(z):
        return abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)

    limit = theoretical_limit("rk4")
    assert size(0.999j * limit) < 1 < size(1.001j * limit)


def test_measured_steps_are_those_of_theory():
    found = tc.stability_map("rk4", [1e4, 1e2], [0.1], steps=600)
    assert found.stiffness.tolist() == [1e2, 1e4]
    np.testing.assert_allclose(found.step / found.bound, 1.0, atol=0.03)
    # The frequency rises with the root of the stiffness, less what the tension adds.
    assert 0.08 < found.step[1, 0] / found.step[0, 0] < 0.2
    assert f"theory {found.limit:.3f}" in found.table()


def test_the_fastest_rate_is_the_highest_mode(prism, rest):
    model = tc.Model(prism)
    case = tc.Scene(model, 1.0, force_density=rest.force_density)
    highest = 2 * np.pi * tc.modes(tc.linearize(model, rest)).frequency.max()
    assert fastest_rate(case) == pytest.approx(highest, rel=1e-9)


def test_heavy_points_are_slower():
    light, heavy = (fastest_rate(prism_near_rest(1e3, ratio)) for ratio in (1e-3, 1e-2))
    assert light / heavy == pytest.approx(np.sqrt(10), rel=0.1)


def test_a_users_own_case(rest):
    def make(stiffness, mass_ratio):
        prism = tc.prism(bar_mass=1 / mass_ratio)
        model = tc.Model(prism, strings=tc.LinearStrings(stiffness))
        lengths = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
        moved = prism.nodes + 1e-5 * np.random.default_rng(1).normal(size=(3, 6))
        nodes = tc.structure.restore_bar_lengths(prism, moved)
        return tc.Scene(model, 1.0, nodes, rest_length=lengths)

    found = tc.stability_map("rk4", [1e3], [1.0, 0.25], make, steps=600)
    np.testing.assert_allclose(found.step / found.bound, 1.0, atol=0.03)
    assert found.step[0, 0] / found.step[0, 1] == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"method": "dop853"}, ValueError, "method is 'dop853', which chooses its steps"),
        ({"stiffness": []}, ValueError, "stiffness is empty"),
        ({"mass_ratio": [-1.0]}, ValueError, r"mass_ratio\[0\] is -1.0"),
        ({"steps": 3}, ValueError, "steps is 3"),
        ({"case": lambda k, ratio: None}, TypeError, r"what case\(stiffness, mass_ratio\) returns"),
    ],
)
def test_bad_input_is_named(options, error, message):
    with pytest.raises(error, match=message):
        tc.stability_map(**{"method": "rk4"} | options)
