"""Supports: free and fixed coordinates, and the members and motions that they leave."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics import kernel
from tenscontrol.structure.supports import (
    affine_motions,
    free_coordinates,
    is_movable,
    left_by_supports,
    refuse_load_without_support,
    refuse_moved_supports,
    rigid_basis,
    rigid_motions,
)


@pytest.fixture
def held():
    """A prism with two of its bottom nodes in place."""
    prism = tc.prism()
    return tc.Structure(prism.nodes, prism.bars, prism.strings, 1.0, fixed=[3, 5])


def test_free_and_fixed_coordinates_are_all_coordinates(held):
    np.testing.assert_array_equal(held.fixed_rows, [9, 10, 11, 15, 16, 17])
    every = np.concatenate([held.fixed_rows, held.free_rows])
    np.testing.assert_array_equal(np.sort(every), np.arange(18))
    np.testing.assert_array_equal(held.free, [0, 1, 2, 4])


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_free_coordinates_with_supports_are_the_nodes_again(held, kind):
    free = kind.sym("free", len(held.free_rows))
    nodes = kernel.all_nodes(held, ca.reshape(free, 3, -1), held.nodes)
    whole = ca.Function("whole", [free], [nodes])
    moved = held.nodes + 0.1
    found = np.array(whole(free_coordinates(held, moved)))
    np.testing.assert_array_equal(found[:, held.free], moved[:, held.free])
    np.testing.assert_array_equal(found[:, held.fixed], held.nodes[:, held.fixed])


def test_a_member_between_two_supports_cannot_move(held):
    pairs = np.array([[3, 5], [3, 4], [0, 1]])
    np.testing.assert_array_equal(is_movable(held, pairs), [False, True, True])


def test_two_fixed_nodes_leave_the_turn_about_the_line_through_them(held):
    (field,) = left_by_supports(held, rigid_motions(held.nodes)).T
    np.testing.assert_allclose(field[held.fixed_rows], 0.0, atol=1e-14)
    assert np.linalg.norm(field) > 0.1


def test_a_load_that_nothing_holds_is_refused(held):
    load = np.zeros((3, 6))
    load[2, 0] = -5.0
    refuse_load_without_support(held, load)
    refuse_load_without_support(tc.prism(), load - load.mean(axis=1, keepdims=True))
    with pytest.raises(ValueError, match="the structure has no support"):
        refuse_load_without_support(tc.prism(), load)


# What holds a D-bar in the plane, and how many motions as one body it leaves.
PLANAR = [
    ((), 3),
    ([0], 1),
    ([0, (2, "y")], 0),
    ([(0, "y"), (2, "y")], 1),
    ([(0, "y"), (1, "y"), (2, "y")], 1),
    ([(0, "x"), (2, "y")], 1),
    ([0, 1], 0),
]


@pytest.mark.parametrize(("fixed", "count"), PLANAR)
def test_supports_in_the_plane_leave_motions_as_one_body(fixed, count):
    diamond = replace(tc.library.d_bar(), fixed=fixed)
    basis = rigid_basis(diamond)
    assert basis.shape == (8, count)
    np.testing.assert_allclose(basis.T @ basis, np.eye(count), atol=1e-14)
    np.testing.assert_allclose(basis[diamond.fixed_rows], 0.0, atol=1e-14)
    turned = rigid_motions(diamond.nodes)
    outside = basis - turned @ np.linalg.lstsq(turned, basis, rcond=None)[0]
    np.testing.assert_allclose(outside, 0.0, atol=1e-14)


def test_affine_motions_in_the_plane_are_six():
    nodes = tc.library.kite().nodes
    fields = affine_motions(nodes)
    assert fields.shape == (8, 6)
    gradient, shift = np.array([[0.3, -0.2], [0.5, 0.1]]), np.array([0.4, -0.7])
    moved = (gradient @ nodes + shift[:, None]).ravel(order="F")
    inside = fields @ np.linalg.lstsq(fields, moved, rcond=None)[0]
    np.testing.assert_allclose(inside, moved, atol=1e-14)


def test_rollers_hold_a_load_along_their_axis_only():
    rolling = replace(tc.library.d_bar(), fixed=[(0, "y")])
    down, along = np.zeros((2, 4)), np.zeros((2, 4))
    down[1, 3], along[0, 3] = -5.0, 5.0
    refuse_load_without_support(rolling, down)
    with pytest.raises(ValueError, match="the structure has no support"):
        refuse_load_without_support(rolling, along)


def test_supports_of_a_shape_are_checked_along_what_they_hold():
    rolling = replace(tc.library.d_bar(), fixed=[0, (2, "y")])
    moved = rolling.nodes + np.array([[0.0, 0.2, 0.3, 0.1], [0.0, 0.1, 0.0, 0.0]])
    refuse_moved_supports("nodes", rolling, moved)
    moved[1, 2] = 0.1
    with pytest.raises(ValueError, match=r"node 2 is 0\.1 m off its roller, which holds its y"):
        refuse_moved_supports("nodes", rolling, moved)
