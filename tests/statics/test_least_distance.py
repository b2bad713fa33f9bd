"""The nearest point of a polyhedral set, checked by its optimality conditions."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.optimize import lsq_linear

import tenscontrol as tc
from tenscontrol.statics.least_distance import nearest_between


def nearest_in_cone(directions, offset, target):
    """The nearest point with no entry below zero."""
    nothing = np.zeros(len(offset))
    return nearest_between(directions, offset, target, nothing, nothing + np.inf)


@given(seed=st.integers(0, 10_000), rows=st.integers(2, 12), columns=st.integers(1, 4))
def test_the_answer_satisfies_the_optimality_conditions(seed, rows, columns):
    random = np.random.default_rng(seed)
    directions = random.normal(size=(rows, columns))
    # A shift inside makes it feasible.
    offset = np.abs(random.normal(size=rows)) - directions @ random.normal(size=columns)
    target = random.normal(size=rows)
    found = nearest_in_cone(directions, offset, target)
    point = directions @ found + offset
    assert point.min() > -1e-8
    # The gradient Dᵀ(y - target) is a combination, with weights >= 0, of the active rows of D.
    gradient = directions.T @ (point - target)
    active = directions[point < 1e-7]
    if len(active) == 0:
        np.testing.assert_allclose(gradient, 0, atol=1e-8)
    else:
        weights = lsq_linear(active.T, gradient, bounds=(0, np.inf), tol=1e-14).x
        np.testing.assert_allclose(active.T @ weights, gradient, atol=1e-6)


def test_an_empty_set_has_no_nearest_point():
    # y1 = x >= 0 and y2 = -x - 1 >= 0 exclude each other.
    directions, offset = np.array([[1.0], [-1.0]]), np.array([0.0, -1.0])
    assert nearest_in_cone(directions, offset, np.ones(2)) is None


@pytest.mark.parametrize("level", [1e-6, 1.0, 1e6])
def test_the_answer_scales_with_the_problem(level):
    directions = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]])
    offset, target = np.array([0.0, 0.0, 1.0]), np.array([2.0, 0.5, 0.0])
    one = nearest_in_cone(directions, offset, target)
    scaled = nearest_in_cone(directions, level * offset, level * target)
    np.testing.assert_allclose(scaled, level * one, rtol=1e-9, atol=1e-9 * level)


def test_a_set_without_interior_is_not_taken_for_an_empty_one():
    """Entries that can only be zero: one equation in the guise of two inequalities."""
    directions = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [1.0, -1.0]])
    offset = np.array([0.1, -0.1, -0.3, 0.7])
    found = nearest_in_cone(directions, offset, np.array([1.0, 1.0, 1.0, -1.0]))
    point = directions @ found + offset
    np.testing.assert_allclose(point[:2], 0, atol=1e-9)
    assert point.min() > -1e-9


@pytest.mark.parametrize("sides", [3, 4, 5, 6])
@pytest.mark.parametrize("stages", [1, 2, 3])
def test_towers_whose_bounds_meet_in_many_places_have_a_prestress(stages, sides):
    tower = tc.prism_tower(stages, sides, radius=0.12, height=0.3)
    assert tc.prestress(tower, min_force_density=60.0).force_density.min() > 60 - 1e-8
