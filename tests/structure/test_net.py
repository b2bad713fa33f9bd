"""A net: strings only, flat, evenly spaced, and held where it is told to be."""

import re

import numpy as np
import pytest
from hypothesis import given, strategies as st

import tenscontrol as tc

sizes = st.integers(2, 6)


@given(sizes, st.integers(3, 6))
def test_numbers_of_nodes_and_strings(rows, columns):
    net = tc.net(rows, columns, spacing=0.1, node_mass=0.01)
    assert net.nodes.shape[1] == rows * columns
    assert len(net.bars) == 0
    assert len(net.strings_in("row")) == rows * (columns - 1)
    assert len(net.strings_in("column")) == columns * (rows - 1)
    assert len(net.fixed) == 4
    np.testing.assert_array_equal(net.string_node_mass, np.full(rows * columns - 4, 0.01))


@given(sizes, st.integers(3, 6), st.floats(0.01, 10.0))
def test_every_string_joins_neighbours(rows, columns, spacing):
    net = tc.net(rows, columns, spacing, node_mass=0.01)
    np.testing.assert_allclose(net.string_length(), spacing, rtol=1e-12)
    along = net.string_vectors(net.nodes)
    assert np.all(along[1:, net.strings_in("row")] == 0)
    assert np.all(along[[0, 2]][:, net.strings_in("column")] == 0)
    assert np.all(along >= 0)


def test_nodes_are_numbered_row_by_row():
    net = tc.net(3, 4, spacing=2.0, node_mass=0.01)
    np.testing.assert_array_equal(net.nodes[:, 6], [4.0, 2.0, 0.0])


def test_corners_are_the_far_ends():
    net = tc.net(3, 5, spacing=1.0, node_mass=0.01, fixed="corners")
    assert net.fixed.tolist() == [0, 4, 10, 14]


@given(st.integers(3, 6), st.integers(3, 6))
def test_edges_are_all_but_the_inner_knots(rows, columns):
    net = tc.net(rows, columns, spacing=1.0, node_mass=0.01, fixed="edges")
    assert len(net.fixed) == 2 * (rows + columns) - 4
    x, y = net.nodes[:2, net.string_nodes]
    assert np.all((x > 0) & (x < columns - 1) & (y > 0) & (y < rows - 1))


def test_indices_say_what_is_held():
    net = tc.net(3, 3, spacing=1.0, node_mass=0.01, fixed=[4])
    assert net.fixed.tolist() == [4]
    assert len(net.string_nodes) == 8


def test_one_tension_everywhere_holds_a_net_with_fixed_edges():
    net = tc.net(4, 5, spacing=0.1, node_mass=0.01, fixed="edges")
    force = net.nodes @ tc.statics.stress_matrix(net, np.full(len(net.strings), 7.0), [])
    np.testing.assert_allclose(force[:, net.string_nodes], 0, atol=1e-14)


@pytest.mark.parametrize("fixed", [None, (), [], set(), [False] * 4])
def test_a_net_may_be_held_nowhere(fixed):
    net = tc.net(2, 2, spacing=1.0, node_mass=0.01, fixed=fixed)
    assert len(net.fixed) == 0
    assert len(net.string_nodes) == 4


REFUSED = {
    "rows": ({"rows": 1}, ValueError, "rows is 1, expected a whole number of at least 2"),
    "columns": ({"columns": 2.5}, TypeError, "columns is 2.5, expected a whole number"),
    "spacing": ({"spacing": 0.0}, ValueError, "spacing is 0.0, expected a positive finite number"),
    "mass": ({"node_mass": -1}, ValueError, "node_mass is -1, expected a positive finite number"),
    "word": (
        {"fixed": "sides"},
        ValueError,
        "fixed is 'sides', expected one of 'corners', 'edges'",
    ),
    "range": ({"fixed": [0, 9]}, ValueError, "fixed[1] is node 9, expected 0 to 8"),
    "part": ({"fixed": [0.5]}, TypeError, "fixed[0] is 0.5, expected a whole number"),
    "words": ({"fixed": ["a"]}, TypeError, "fixed must be an array of real numbers"),
    "all": ({"fixed": range(9)}, ValueError, "fixed holds all 9 knots of the net"),
    "all corners": ({"rows": 2, "columns": 2}, ValueError, "fixed holds all 4 knots of the net"),
    "all edges": ({"rows": 2, "fixed": "edges"}, ValueError, "fixed holds all 6 knots of the net"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused(case):
    changes, exception, message = REFUSED[case]
    arguments = {"rows": 3, "columns": 3, "spacing": 0.1, "node_mass": 0.01}
    with pytest.raises(exception, match=re.escape(message)):
        tc.net(**(arguments | changes))
