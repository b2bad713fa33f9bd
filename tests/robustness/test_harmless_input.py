"""Draws that are always the same, and closed loops of structures that lack something."""

import numpy as np

import tenscontrol as tc
from tests.robustness.cases import loop_case


def test_a_distribution_may_have_no_width():
    rng = np.random.default_rng(0)
    assert tc.Uniform(1.5, 1.5).draw(rng) == 1.5
    np.testing.assert_array_equal(tc.Normal(2.0, 0, size=3.0).draw(rng), np.full(3, 2.0))
    assert tc.OneOf([[0.1]]).draw(rng) == 0.1


def test_a_case_without_strings_needs_no_input():
    bar = tc.Structure([[0, 1], [0, 0], [0, 0]], [(0, 1)], [], 1.0)
    for law in (None, tc.LinearStrings(100.0)):
        case = loop_case(bar, law, None, 0.1, step=1e-2, tolerance=0.1, faults=None)
        outcome = case({}, np.random.default_rng(0))
        assert outcome.success
        assert list(outcome.figures) == ["final_error"]


def test_a_number_that_does_not_vary_leaves_the_sweep_as_it_is():
    prism = tc.prism()
    gamma = tc.prestress(prism, 17.3205).force_density
    case = loop_case(
        prism, None, None, 0.05, step=1e-2, tolerance=0.1, force_density=gamma, faults=()
    )
    rng = np.random.default_rng(0)
    drawn = tc.Uniform(1.0, 1.0).draw(rng)
    assert case({"bar_mass": drawn}, rng).figures == case({}, rng).figures
