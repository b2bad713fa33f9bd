"""Supports: free and fixed coordinates, and the members and motions that they leave."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics import kernel
from tenscontrol.structure import (
    free_coordinates,
    is_movable,
    left_by_supports,
    refuse_load_without_support,
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
    with pytest.raises(ValueError, match="nothing holds the structure"):
        refuse_load_without_support(tc.prism(), load)
