"""Bar lengths made exact: what changes, and what does not."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state, unpack_states
from tenscontrol.integrate.projection import project, projected
from tests.dynamics.scenes import any_motion, paper_force_density, random_structure
from tests.integrate.stepping import (
    bar_errors,
    fitted_order,
    march,
    moving,
    records,
    rk4,
    smooth_equation,
    smooth_motion,
    supported_structure,
)
from tests.integrate.test_rk4 import oscillator
from tests.oracle import consistent_mass

seeds = st.integers(0, 10_000)


def near(structure, seed, size=0.1):
    """A state whose bars are too long or short by about ``size`` of their length, and stretch."""
    noise = size * np.random.default_rng(seed).normal(size=6 * len(structure.free))
    return moving(structure, seed) + noise


def after(structure, x):
    return np.array(project(structure)(x)).ravel()


@given(seed=seeds)
def test_bars_have_their_lengths_and_do_not_stretch(seed):
    structure = supported_structure(seed)
    x = near(structure, seed)
    held = structure.end_share.any(axis=1)
    assert bar_errors(structure, x)[0] > 1e-3
    assert held.sum() == 3
    stretch, rate = bar_errors(structure, after(structure, x))
    assert stretch < 1e-14
    assert rate < 1e-13


@given(seed=seeds)
def test_momenta_stay(seed):
    structure = random_structure(seed, bars=3, points=2)
    N, V = any_motion(structure, seed)  # bars of any length
    x = pack_state(structure, N, V)
    momentum = tc.Model(structure).momentum
    before = np.array(momentum(x)).ravel()
    found = np.array(momentum(after(structure, x))).ravel()
    np.testing.assert_allclose(found, before, rtol=0, atol=1e-13 * np.abs(N).max())


@given(seed=seeds)
def test_a_state_with_exact_bars_is_left_alone(seed):
    structure = supported_structure(seed)
    x = after(structure, near(structure, seed))
    np.testing.assert_allclose(after(structure, x), x, rtol=0, atol=1e-14)
    swung = moving(structure, seed)
    np.testing.assert_allclose(after(structure, swung), swung, rtol=0, atol=1e-13)


@given(seed=seeds)
def test_positions_move_to_the_nearest_in_the_metric_of_the_mass(seed):
    """The change is orthogonal, ``δᵀ M t = 0``, to every motion t that keeps the bar lengths."""
    structure = supported_structure(seed)
    x = near(structure, seed)
    y = after(structure, x)
    count = len(structure.free)
    M = consistent_mass(structure)[np.ix_(structure.free, structure.free)]
    change = (M @ (y - x)[: 3 * count].reshape(count, 3)).T
    nodes = unpack_states(structure, y[:, None])[0][:, :, 0]
    for shift in np.random.default_rng(seed).normal(size=(5, 6 * count)):
        swing = after(structure, np.concatenate([y[: 3 * count], shift[: 3 * count]]))
        tangent = swing[3 * count :].reshape(count, 3).T
        assert abs((change * tangent).sum()) < 1e-12 * np.abs(nodes).max()


def test_centres_and_string_nodes_stay():
    structure = random_structure(5, bars=3, points=2)
    N, V = any_motion(structure, 5)
    x = pack_state(structure, N, V)
    found = unpack_states(structure, after(structure, x)[:, None])
    start, end = structure.bars.T
    for before, now in zip((N, V), (each[:, :, 0] for each in found), strict=True):
        np.testing.assert_allclose(
            now[:, start] + now[:, end], before[:, start] + before[:, end], rtol=0, atol=1e-14
        )
        np.testing.assert_array_equal(
            now[:, structure.string_nodes], before[:, structure.string_nodes]
        )


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_the_order_of_a_step_stays(prism, held):
    """RK4 with its bars made exact, over 1 s against the oracle; no string goes slack."""
    equation, u, x, exact = smooth_motion(prism, held)
    counts = np.array([160, 320, 640])
    step = projected(rk4(equation), equation)
    errors = [np.abs(march(step, x, u, 1 / n, n)[:18] - exact).max() for n in counts]
    assert 3.8 < fitted_order(1 / counts, errors) < 4.2


def test_bar_lengths_hold_over_many_projected_steps(prism):
    equation = tc.Model(prism).equation("force_density")
    x, gamma = moving(prism, 1), paper_force_density(9.0)
    plain = records(rk4(equation), x, gamma, 5e-3, 20, 500)
    exact = records(projected(rk4(equation), equation), x, gamma, 5e-3, 20, 500)
    assert bar_errors(prism, plain)[0] > 1e-7
    assert max(bar_errors(prism, exact)) < 1e-13


def test_a_step_without_bars_is_returned_as_it_is():
    equation = smooth_equation(oscillator())
    step = rk4(equation)
    assert projected(step, equation) is step
    points = tc.Structure(np.eye(3), [], [[0, 1], [1, 2]], [], string_node_mass=1.0)
    equation = tc.Model(points).equation("force_density")
    step = rk4(equation)
    assert projected(step, equation) is step
