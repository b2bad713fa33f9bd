"""Searches for shapes with limits that are none and nodes in any collection."""

import numpy as np
import pytest

import tenscontrol as tc

PRISM = tc.prism()
MODEL = tc.Model(PRISM, tc.LinearStrings(100.0))
REST = tc.prestress(PRISM, 17.3205)


def target(demands, **given):
    return tc.shape_target(MODEL, demands, force_density=17.3205, **given)


def test_nodes_of_a_demand_may_be_a_set_a_mask_or_a_column():
    known = target(tc.Height(0.97, [0, 1, 2], [3, 4, 5])).nodes
    low = np.arange(6) > 2
    for top, bottom in (({0, 1, 2}, {3, 4, 5}), (~low, low), ([[0], [1], [2]], [3.0, 4.0, 5.0])):
        np.testing.assert_array_equal(target(tc.Height(0.97, top, bottom)).nodes, known)
    with pytest.raises(ValueError, match="top has node 0 twice"):  # of another mean
        tc.Height(0.97, [0, 0, 1], [3, 4, 5])


def test_infinite_limits_are_none():
    demand = tc.Height(0.97, [0, 1, 2], [3, 4, 5])
    known = target(demand)
    for given in ({"max_force_density": np.inf}, {"winches": tc.Winches(longest=np.inf)}):
        np.testing.assert_allclose(target(demand, **given).nodes, known.nodes, atol=1e-7)


def test_no_demands_may_be_none():
    for nothing in ((), [], None):
        np.testing.assert_allclose(target(nothing).force_density, REST.force_density, rtol=1e-5)
