"""Input that must be refused by name: shared nodes, the plane, rollers, point masses, clusters."""

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tests.refused import INF, NAN, assert_refused, refused, with_entry

SQUARE = [[0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0]]
BODY = [(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (1, 3), (1, 4), (2, 3), (2, 4), (3, 4)]


def square(**changes):
    """Two bars of a square in the plane that share node 1, with strings along its other sides."""
    arguments = {
        "nodes": SQUARE,
        "bars": [(0, 1), (1, 2)],
        "strings": [(2, 3), (3, 0)],
        "bar_mass": 1.0,
        "point_mass": [0.0, 0.0, 0.0, 0.2],
    }
    return tc.Structure(**(arguments | changes))


def body():
    """Five nodes joined by ten bars, one more than hold them, on a string."""
    nodes = [[0, 1, 0, 0, 1.1], [0, 0, 1, 0, 1.2], [0, 0, 0, 1, 1.3]]
    return tc.Structure(nodes, BODY, [(0, 4)], 1.0)


def toggle(middle=0.0, **changes):
    """Two bars in a row between fixed nodes."""
    arguments = {
        "nodes": [[0, 1, 2], [0, middle, 0]],
        "bars": [(0, 1), (1, 2)],
        "strings": [],
        "bar_mass": 1.0,
        "fixed": [0, 2],
    }
    return tc.Structure(**(arguments | changes))


def lever(**changes):
    """A level bar in the plane from node 0 to node 1."""
    arguments = {
        "nodes": [[0, 1], [0, 0]], "bars": [(0, 1)], "strings": [], "bar_mass": 1.0,
    }  # fmt: skip
    return tc.Structure(**(arguments | changes))


def shape_of_body(change):
    """The shape of the body with one coordinate of its last node changed."""
    return with_entry(body().nodes, (2, 4), body().nodes[2, 4] + change)


# fmt: off
PLANE = [
    refused("nodes on a line", lambda: square(nodes=SQUARE[:1]), ValueError,
            r"nodes has shape \(1, 4\), expected \(3, n\), or \(2, n\) in the plane"),
    refused("nodes one flat list", lambda: square(nodes=[0.0, 1.0, 2.0, 3.0]), ValueError,
            r"nodes has shape \(4,\), expected \(3, n\), or \(2, n\)"),
    refused("nodes of four rows", lambda: square(nodes=np.zeros((4, 4))), ValueError,
            r"nodes has shape \(4, 4\), expected \(3, n\), or \(2, n\)"),
    refused("planar nodes transposed", lambda: square(nodes=np.transpose(SQUARE)), ValueError,
            r"nodes has shape \(4, 2\), .*transpose it"),
    refused("shape of three rows for a planar structure",
            lambda: square().string_length(np.zeros((3, 4))), ValueError,
            r"nodes has shape \(3, 4\), expected \(2, 4\).*one column of x, y per node"),
    refused("shape of two rows for one in space",
            lambda: body().bar_vectors(np.zeros((2, 5))), ValueError,
            r"nodes has shape \(2, 5\), expected \(3, 5\).*x, y, z"),
    refused("skin of a planar structure",
            lambda: tc.skin(square(), [(0, 1, 2)], node_mass=0.1), ValueError,
            r"structure is planar, nodes of shape \(2, n\); a skin needs one in space"),
]

SUPPORTS = [
    refused("fixed out of range", lambda: square(fixed=[4]), ValueError,
            r"fixed\[0\] is node 4, expected 0 to 3"),
    refused("fixed below zero", lambda: square(fixed=[-1]), ValueError,
            r"fixed\[0\] is node -1, expected 0 to 3"),
    refused("roller along z in the plane", lambda: square(fixed=[(2, "z")]), ValueError,
            r"fixed axis of node 2 is 'z', expected one of 'x', 'y'"),
    refused("roller along an unknown axis", lambda: square(fixed=[(2, "w")]), ValueError,
            r"fixed axis of node 2 is 'w', expected one of 'x', 'y'"),
    refused("roller along an axis by number", lambda: square(fixed=[(2, 1)]), ValueError,
            r"fixed axis of node 2 is 1, expected one of 'x', 'y'"),
    refused("roller at no node", lambda: square(fixed=[(9, "x")]), ValueError,
            r"fixed\[0\] is node 9, expected 0 to 3"),
    refused("roller at half a node", lambda: square(fixed=[(0.5, "x")]), TypeError,
            r"fixed\[0\] is 0\.5, expected a whole number"),
    refused("roller with two axes", lambda: square(fixed=[(2, "x", "y")]), ValueError,
            r"fixed has \(2, 'x', 'y'\), expected pairs of a node and an axis"),
    refused("roller of two nodes", lambda: square(fixed=[((1, 2), "x")]), ValueError,
            r"fixed has \(\(1, 2\), 'x'\), expected pairs of a node and an axis"),
    refused("one pair that is not in a list", lambda: square(fixed=(2, "x")), TypeError,
            r"fixed is \(2, 'x'\), expected node indices; .* a pair of their own, as in \[0, \("),
    refused("fixed a word", lambda: square(fixed="corners"), TypeError, r"fixed .*'corners'"),
    refused("fixed a table", lambda: square(fixed=[[0, 1], [2, 3]]), ValueError,
            r"fixed axis of node 0 is 1,"),
    refused("rollers a word", lambda: square(rollers="x"), TypeError, r"rollers is .*'x'"),
    refused("rollers without axes", lambda: square(rollers=[1, 2]), ValueError,
            r"rollers has 1, expected pairs of a node and an axis"),
]

DEAD = [
    refused("two bars in a row between supports", toggle, ValueError,
            r"bars \[0, 1\], .*where bar [01] changes its length: at such a dead centre"),
    refused("the same in space", lambda: toggle(nodes=[[0, 1, 2], [0] * 3, [0] * 3]), ValueError,
            r"a dead centre"),
    refused("bar held along itself at both ends",
            lambda: lever(fixed=[(0, "x"), (1, "x")]), ValueError,
            r"bars \[0\], with their supports, are rigid in this shape, .*a dead centre"),
    refused("bar fixed and held along itself", lambda: lever(fixed=[0, (1, "x")]), ValueError,
            r"a dead centre .*remove a bar, or release a support"),
    refused("flat linkage of three bars", lambda: tc.Structure(
                [[0, 1, 3, 4], [0] * 4], [(0, 1), (1, 2), (2, 3)], [], 1.0, fixed=[0, 3]),
            ValueError, r"bars \[0, 1, 2\].*a dead centre"),
    refused("flat triangle", lambda: tc.Structure(
                [[0, 1, 2], [0] * 3], [(0, 1), (1, 2), (0, 2)], [], 1.0), ValueError,
            r"bars \[0, 1, 2\].*a dead centre"),
    refused("run of a structure that is held everywhere",
            lambda: tc.simulate(tc.Model(lever(fixed=[0, 1])), 0.1, force_density=[]), ValueError,
            r"every node of the model is fixed: nothing can move"),
    refused("equilibrium of a structure that is held everywhere",
            lambda: tc.equilibrium(tc.Model(lever(fixed=[0, 1])), force_density=[]), ValueError,
            r"every node of the model is fixed: nothing can move"),
    refused("net held everywhere",
            lambda: tc.net(3, 3, spacing=0.1, node_mass=0.1, fixed=range(9)), ValueError,
            r"fixed holds all 9 knots of the net"),
]

MASSES = [
    refused("masses of another count", lambda: square(point_mass=[0.1, 0.1, 0.1]), ValueError,
            r"point_mass has shape \(3,\), expected \(\) or \(4,\): .* or one per node"),
    refused("mass below zero", lambda: square(point_mass=[0, 0, -1.0, 0.2]), ValueError,
            r"point_mass\[2\] is -1, expected .*at least 0"),
    refused("mass not a number", lambda: square(point_mass=[0, NAN, 0, 0.2]), ValueError,
            r"point_mass\[1\] is nan"),
    refused("mass without end", lambda: square(point_mass=[0, INF, 0, 0.2]), ValueError,
            r"point_mass\[1\] is inf"),
    refused("mass by name", lambda: square(point_mass={"node": 1}), TypeError,
            r"point_mass .*dict"),
    refused("string node without mass", lambda: square(point_mass=None), ValueError,
            r"node 3 is in none of bars, so it is a point mass and needs string_node_mass"),
    refused("string node with mass 0", lambda: square(point_mass=[0.1, 0.1, 0.1, 0.0]), ValueError,
            r"node 3 is in none of bars.*or give point_mass, one number, or one for each of the 4"),
    refused("masses of string nodes where there are none",
            lambda: square(fixed=[3], point_mass=None, string_node_mass=[0.2, 0.3]), ValueError,
            r"string_node_mass has shape \(2,\), expected \(\) or \(0,\): .* one per string node"),
]

CLUSTERS = [
    refused("path that stays", lambda: square(strings=[(2, 3, 3, 0)]), ValueError,
            r"strings\[0\] joins node 3 to itself"),
    refused("path there and back", lambda: square(strings=[(2, 3, 0), (0, 3, 0)]), ValueError,
            r"strings\[1\] passes node 0 twice, .*at least three nodes"),
    refused("path through a node twice", lambda: square(strings=[(2, 3, 0, 2, 1)]), ValueError,
            r"strings\[0\] passes node 2 twice, expected each node once"),
    refused("closed path with a loop", lambda: square(strings=[(0, 3, 2, 3, 0)]), ValueError,
            r"strings\[0\] passes node 3 twice"),
    refused("path of one node", lambda: square(strings=[(2, 3), (3,)]), ValueError,
            r"strings\[1\] has shape \(1,\), expected \(k,\) with k at least 2"),
    refused("path of no node", lambda: square(strings=[(2, 3), ()]), ValueError,
            r"strings\[1\] has shape \(0,\), expected \(k,\)"),
    refused("path to a node that is not there", lambda: square(strings=[(2, 3, 7)]), ValueError,
            r"strings\[0\]\[2\] is node 7, expected 0 to 3"),
    refused("path over half a node", lambda: square(strings=[(2, 3, 0.5)]), TypeError,
            r"strings\[0\]\[2\] is 0\.5, expected a whole number"),
    refused("path of names", lambda: square(strings=[("a", "b", "c")]), TypeError,
            r"strings\[0\] .*'a'"),
    refused("path in a path", lambda: square(strings=[(2, 3, (0, 1))]), TypeError,
            r"strings\[0\] must be an array of real numbers"),
    refused("string that closes on two nodes", lambda: square(strings=[(3, 3), (2, 3, 0)]),
            ValueError, r"strings\[0\] joins node 3 to itself"),
    refused("other strings than the paths",
            lambda: replace(square(strings=[(2, 3, 0)]), strings=[(0, 2), (2, 3)]), ValueError,
            r"strings and paths differ, .*With new strings give paths=\(\)"),
    refused("paths a word", lambda: square(paths="ab"), TypeError, r"paths is .*'ab'"),
    refused("groups of segments, not of strings",
            lambda: square(strings=[(2, 3, 0)], string_groups=["a", "b"]), ValueError,
            r"string_groups has 2 names, expected 1: one per string"),
    refused("clusters cut", lambda: tc.subdivide(square(strings=[(2, 3, 0)]), 2, node_mass=0.1),
            ValueError, r"structure has clustered strings, .*cannot be cut"),
]

SHAPES = [
    refused("a bar twice in a body", lambda: tc.Structure(
                body().nodes, [*BODY, (1, 0)], [], 1.0), ValueError,
            r"bars\[10\] joins nodes 0 and 1, as bars\[0\] does"),
    refused("a body with a bar of no length", lambda: tc.Structure(
                with_entry(body().nodes, (slice(None), 4), body().nodes[:, 0]), BODY, [], 1.0),
            ValueError, r"bars\[3\] has no length: nodes 0 and 4"),
    refused("a body with bars of inconsistent length",
            lambda: tc.structure.bar_geometry.refuse_wrong_bar_lengths(
                "nodes", body(), shape_of_body(1e-3)),
            ValueError, r"in nodes, bar \d has length .*restore_bar_lengths"),
    refused("a linkage pulled straight",
            lambda: tc.structure.restore_bar_lengths(
                toggle(1.0), with_entry(toggle(1.0).nodes, (1, 1), 0.0)),
            ValueError, r"in nodes, bars \[0, 1\], .*cannot all have their lengths"),
    refused("joined bars without direction",
            lambda: tc.structure.restore_bar_lengths(body(), np.zeros((3, 5))), ValueError,
            r"in nodes, the ends of bar 0 are at the same point"),
    refused("a fixed node moved",
            lambda: tc.structure.supports.refuse_moved_supports(
                "nodes", toggle(1.0), with_entry(toggle(1.0).nodes, (0, 2), 2.1)), ValueError,
            r"in nodes, the fixed node 2 is 0\.1 m from its place"),
    refused("a roller off its line",
            lambda: tc.structure.supports.refuse_moved_supports(
                "nodes", lever(fixed=[0, (1, "y")]), np.array([[0, 1.3], [0, 0.2]])), ValueError,
            r"in nodes, node 1 is 0\.2 m off its roller, which holds its y at 0 m"),
]
# fmt: on

CASES = [*PLANE, *SUPPORTS, *DEAD, *MASSES, *CLUSTERS, *SHAPES]


@pytest.mark.parametrize(("call", "exception", "message"), CASES)
def test_bad_input_is_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)


def test_there_are_enough_cases():
    assert len(CASES) >= 40
