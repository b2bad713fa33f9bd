"""Input that is no mistake where a script runs over many structures, and what it means."""

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc

PRISM = tc.prism()
CORNERS = [[0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0]]


def prism(**changes):
    return tc.Structure(PRISM.nodes, PRISM.bars, PRISM.strings, 1.0, **changes)


def kite(**changes):
    """Two bars in the plane that share node 1, and node 3 between strings."""
    given = {"bars": [(0, 1), (1, 2)], "strings": [(2, 3), (3, 0)], "bar_mass": 1.0}
    return tc.Structure(CORNERS, **({"point_mass": [0.0, 0.0, 0.0, 0.2]} | given | changes))


@pytest.mark.parametrize(
    "fixed",
    [
        [4, 1, 4, 1],
        {1, 4},
        frozenset({4, 1}),
        np.array([1, 4, 1]),
        np.array([[1], [4]]),
        [1.0, 4.0],
        [False, True, False, False, True, False],
        np.isin(np.arange(6), [1, 4]),
        [1, 4, (4, "z"), (1, "x")],
    ],
    ids=repr,
)
def test_nodes_may_be_fixed_by_any_collection_or_mask(fixed):
    assert prism(fixed=fixed).fixed.tolist() == [1, 4]


def test_none_and_nothing_fix_nothing():
    for nothing in (None, [], (), set(), np.zeros(6, bool), np.zeros(0)):
        assert len(prism(fixed=nothing, rollers=None, paths=None).fixed_rows) == 0


def test_a_roller_may_be_named_twice():
    for fixed in ([(2, "x"), (2, "x")], {(2, "x")}, {0, (2, "x"), (0, "y")} - {0, (0, "y")}):
        assert prism(fixed=fixed).rollers == ((2, "x"),)
    assert prism(fixed={0, (2, "x")}).fixed.tolist() == [0]


def test_a_mask_of_another_count_is_refused():
    with pytest.raises(ValueError, match=r"fixed is a mask of shape \(5,\), expected \(6,\)"):
        prism(fixed=[True] * 5)


def test_one_point_mass_is_that_of_each_node():
    np.testing.assert_array_equal(prism(point_mass=0.5).point_mass, np.full(6, 0.5))
    np.testing.assert_array_equal(prism(point_mass=np.ones((6, 1))).point_mass, np.ones(6))


def test_columns_serve_as_vectors():
    one = prism()
    two = tc.Structure(PRISM.nodes, PRISM.bars, PRISM.strings, bar_mass=[[1.0]] * 3)
    np.testing.assert_array_equal(one.bar_mass, two.bar_mass)


def test_a_mass_on_a_fixed_node_is_kept_and_does_nothing():
    """Nodes 1 and 3 are fixed: a bar swings about one, and the other is between strings."""
    light = kite(fixed=[1, 3], point_mass=[0.1, 0.0, 0.0, 0.0])
    heavy = kite(fixed=[1, 3], point_mass=[0.1, 7.0, 0.0, 3.0])
    assert heavy.point_mass.tolist() == [0.1, 7.0, 0.0, 3.0]
    runs = [
        tc.simulate(tc.Model(each, gravity=9.81), 0.3, force_density=5.0) for each in (light, heavy)
    ]
    np.testing.assert_array_equal(runs[0].nodes, runs[1].nodes)
    np.testing.assert_array_equal(*(run.kinetic_energy for run in runs))
    released = replace(heavy, fixed=())
    assert released.point_mass.tolist() == [0.1, 7.0, 0.0, 3.0]


def test_a_node_that_is_fixed_later_keeps_its_mass():
    assert replace(kite(), fixed=[3]).point_mass[3] == 0.2


def test_masses_of_string_nodes_may_count_the_fixed_ones():
    nodes = [[0, 1, 2, 3], [0] * 4, [0] * 4]
    given = {"nodes": nodes, "bars": [[1, 2]], "strings": [[0, 1], [2, 3]], "bar_mass": 1.0}
    both = tc.Structure(**given, string_node_mass=[0.1, 0.2], fixed=[0])
    assert both.string_node_mass.tolist() == [0.2]
    assert tc.Structure(**given, string_node_mass=[0.2], fixed=[0]).string_node_mass == 0.2
    assert not prism(string_node_mass=0.1).point_mass.any()


def test_a_structure_without_bars_needs_no_mass_of_bars():
    net = tc.Structure(CORNERS, [], [(0, 1), (1, 2), (2, 3)], None, string_node_mass=0.1)
    assert net.bar_mass.shape == (0,)
    with pytest.raises(TypeError, match="bar_mass is None"):
        kite(bar_mass=None)


def test_a_fixed_node_may_have_no_member():
    anchored = tc.Structure(
        np.column_stack([PRISM.nodes, [2.0, 2.0, 2.0]]), PRISM.bars, PRISM.strings, 1.0, fixed=[6]
    )
    runs = [tc.simulate(tc.Model(each), 0.2, force_density=20.0) for each in (PRISM, anchored)]
    np.testing.assert_allclose(runs[1].nodes[:, :6], runs[0].nodes, atol=1e-12)


def test_whole_floats_are_counts():
    assert tc.prism(sides=3.0).bars.shape == tc.prism(sides=np.int64(3)).bars.shape == (3, 2)
    assert len(tc.prism_tower(np.array(2.0)).bars) == 6
    for wrong in (2.5, float("nan"), float("inf"), True, "3", [3]):
        with pytest.raises((TypeError, ValueError), match=r"^sides is .*expected a whole number"):
            tc.prism(sides=wrong)


def test_one_segment_leaves_a_string_as_it_is_and_needs_no_mass():
    whole = tc.subdivide(PRISM, 1)
    assert whole.parent is PRISM
    np.testing.assert_array_equal(whole.nodes, PRISM.nodes)
    np.testing.assert_array_equal(whole.strings, PRISM.strings)
    np.testing.assert_array_equal(tc.structure.segment_counts(whole), np.ones(9))
    clustered = kite(strings=[(2, 3, 0)], point_mass=[0, 0, 0, 0.2])
    assert tc.subdivide(clustered, 1).paths == ((2, 3, 0),)


def test_a_whole_structure_is_one_of_one_segment_a_string():
    gamma = np.arange(1.0, 10.0)
    np.testing.assert_array_equal(tc.structure.segment_counts(PRISM), np.ones(9))
    np.testing.assert_array_equal(tc.structure.spread_force_density(PRISM, gamma), gamma)
    np.testing.assert_array_equal(tc.structure.spread_rest_length(PRISM, 0.7), np.full(9, 0.7))


def test_no_panel_and_no_iteration_make_no_skin():
    assert tc.skin(PRISM, []) is PRISM
    assert tc.skin(PRISM, "top", iterations=0) is PRISM
    np.testing.assert_array_equal(
        tc.structure.skin_rest_length(PRISM, np.arange(1.0, 10.0)), np.arange(1.0, 10.0)
    )


def test_a_panel_that_is_named_twice_is_one():
    once = tc.skin(PRISM, "top", node_mass=0.1)
    for panels in (["top", "top"], ["top", (2, 1, 0)]):
        again = tc.skin(PRISM, panels, node_mass=0.1)
        np.testing.assert_array_equal(again.strings, once.strings)
    sides = tc.skin(PRISM, "sides", node_mass=0.1)
    assert len(tc.skin(PRISM, ["sides", (0, 1, 3)], node_mass=0.1).strings) == len(sides.strings)
