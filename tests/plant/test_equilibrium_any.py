"""Equilibria of structures of any class: shared nodes, the plane, rollers, clusters, no tension."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tests.plant.equilibria import random_rest_of_any
from tests.statics.structures import bipyramid, d_bar, square_body, two_crosses


def model_of(structure, stiffness=100.0, **more):
    return tc.Model(structure, strings=tc.LinearStrings(stiffness), **more)


def assert_at_rest(model, rest, wound, scale):
    """Nothing accelerates, bars have their lengths, and what is held is where it was."""
    structure = model.structure
    nodes = rest.structure.nodes
    state = pack_state(structure, nodes, np.zeros_like(nodes))
    rate = np.array(model.rest_length_dynamics(state, wound))
    np.testing.assert_allclose(rate, 0, atol=1e-9 * scale)
    np.testing.assert_allclose(rest.structure.bar_length, structure.bar_length, rtol=1e-12)
    held = structure.fixed_rows
    at, before = (part.ravel(order="F")[held] for part in (nodes, structure.nodes))
    np.testing.assert_array_equal(at, before)


# ---- next to no tension ----


@pytest.mark.filterwarnings("ignore:.* are slack")
@pytest.mark.parametrize("ratio", [0.9, 0.999, 1.0, 1.1])
@pytest.mark.parametrize("held", ["corners", [0], [0, 5]])
def test_nets_with_hardly_a_tension_come_to_rest(held, ratio):
    net = tc.net(6, 6, 0.3, 0.1, held)
    model = model_of(net, 1000.0)
    rest = tc.equilibrium(model, rest_length=ratio * net.string_length())
    assert rest.residual < 1e-8
    if held == [0] or ratio >= 1:
        np.testing.assert_array_equal(rest.force_density, 0.0)


def test_a_structure_that_is_slack_stays_where_it_is():
    prism = tc.prism(5)
    with pytest.warns(UserWarning, match="all strings are slack; shorter rest lengths"):
        rest = tc.equilibrium(model_of(prism), rest_length=1.1 * prism.string_length())
    np.testing.assert_allclose(rest.structure.nodes, prism.nodes, atol=1e-12)


# ---- class k ----


@pytest.mark.parametrize("make", [two_crosses, square_body, bipyramid, d_bar])
def test_shared_nodes_rollers_and_redundant_bars(make):
    structure = make()
    model = model_of(structure)
    wound = 0.8 * structure.string_length()
    rest = tc.equilibrium(model, rest_length=wound)
    assert_at_rest(model, rest, wound, 100.0)
    stiffness = tc.LinearStrings(100.0).stiffness
    assert rest.tangent_stiffness(float(stiffness)).is_stable


def test_the_plane_and_space_agree_where_gravity_holds_them():
    flat = two_crosses()
    held = [0, (1, "x")]
    deep = tc.Structure(
        np.vstack([flat.nodes, np.zeros(6)]), flat.bars, flat.strings, 1.0,
        fixed=[*held, *[(i, "z") for i in range(1, 6)]],
    )  # fmt: skip
    wound = 0.9 * flat.string_length()
    one = tc.equilibrium(model_of(flat, 1e3, gravity=9.81), rest_length=wound)
    two = tc.equilibrium(model_of(deep, 1e3, gravity=[0.0, -9.81, 0.0]), rest_length=wound)
    np.testing.assert_allclose(two.structure.nodes[:2], one.structure.nodes, atol=1e-10)
    np.testing.assert_allclose(two.force_density, one.force_density, atol=1e-8)


def class_two_tower(joint):
    """Two prisms of radius 0.5 m one on the other: by shared nodes, or hung in short strings."""
    angle, node = 2 * np.pi * np.arange(3) / 3, np.arange(3)
    turn = np.pi / 6
    heights = [0.0, 1.0, 2.0] if joint is None else [0.0, 1.0, 1.0 - joint, 2.0 - joint]
    turns = [0, 1, 2] if joint is None else [0, 1, 1, 2]
    nodes = np.hstack(
        [
            [0.5 * np.cos(angle + t * turn), 0.5 * np.sin(angle + t * turn), 0 * angle + z]
            for z, t in zip(heights, turns, strict=True)
        ]
    )
    feet, heads = (0, 3) if joint is None else (0, 6), (3, 6) if joint is None else (3, 9)
    rings = [np.column_stack([r + node, r + (node + 1) % 3]) for r in range(0, nodes.shape[1], 3)]
    sides = [np.column_stack([f + node, h + node]) for f, h in zip(feet, heads, strict=True)]
    bars = [np.column_stack([f + node, h + (node + 1) % 3])
            for f, h in zip(feet, heads, strict=True)]  # fmt: skip
    joints = [] if joint is None else [np.column_stack([3 + node, 6 + node])]
    strings = np.vstack([*rings, *sides, *joints])
    return tc.Structure(nodes, np.vstack(bars), strings, 1.0, fixed=[0, 1, 2])


@pytest.mark.parametrize("gravity", [None, 9.81])
def test_a_class_two_tower_is_found_with_shared_nodes_and_with_short_strings(gravity):
    tops = []
    for joint in (None, 0.03, 0.003):
        tower = class_two_tower(joint)
        model = model_of(tower, 1000.0, gravity=gravity)
        # Joints are as long as they are; all else is wound.
        ratio = np.where(tower.string_length() < 0.05, 1.0, 0.9)
        wound = ratio * tower.string_length()
        rest = tc.equilibrium(model, rest_length=wound)
        if joint is not None and gravity is None:  # nothing pulls the two apart
            assert (rest.force_density == 0).any()
        assert rest.residual < 1e-9
        assert_at_rest(model, rest, wound, 1e3)
        tops.append(rest.structure.nodes[2, -3:].mean())
    if gravity is not None:  # it hangs in the joints, which shrink to nothing
        assert abs(tops[2] - tops[1]) < 0.06


# ---- clusters ----


def test_a_mass_runs_along_a_string_to_where_both_sides_slope_alike():
    """A string of 3 m between supports 2 m apart, the one 0.5 m lower: L = 2 / cos(slope)."""
    nodes = [[-1.0, 1.0, 0.2], [0.0, -0.5, -1.0]]
    bead = tc.Structure(nodes, np.zeros((0, 2)), [(0, 2, 1)], 1.0, point_mass=[0, 0, 0.5],
                        fixed=[0, 1])  # fmt: skip
    model = model_of(bead, 1e4, gravity=9.81)
    rest = tc.equilibrium(model, rest_length=3.0)
    at = rest.structure.nodes
    slopes = [abs(at[1, i] - at[1, 2]) / abs(at[0, i] - at[0, 2]) for i in (0, 1)]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-9)
    length = rest.structure.string_length()[0]
    assert length == pytest.approx(2 / np.cos(np.arctan(slopes[0])), rel=1e-12)
    assert length == pytest.approx(3 + rest.force_density[0] * length / 1e4, rel=1e-12)
    tension = rest.force_density[0] * length
    assert 2 * tension * np.sin(np.arctan(slopes[0])) == pytest.approx(0.5 * 9.81, rel=1e-9)


def test_a_string_that_draws_its_nodes_together_is_named():
    """A mass on a string is driven to its end, and cannot go on: there the string holds it."""
    nodes = [[0.0, 0.5, 1.0], [0.0, 0.1, 0.0]]
    bead = tc.Structure(nodes, np.zeros((0, 2)), [(0, 1, 2)], 1.0, point_mass=[0, 1.0, 0],
                        fixed=[0, 2])  # fmt: skip
    model = model_of(bead, gravity=[-9.81, 0.0])
    with pytest.raises(ValueError, match=r"strings\[0\] runs over nodes 0 and 1 and pulls them"):
        tc.equilibrium(model, rest_length=0.9)


@pytest.mark.filterwarnings("ignore:.* are slack", "ignore:.* pass through each other")
@pytest.mark.parametrize("seed", [0, 1, 2, 4, 5, 6, 7])
def test_random_structures_of_any_class_come_to_rest(seed):
    case = random_rest_of_any(seed)
    try:
        rest = tc.equilibrium(**case)
    except ValueError as error:
        assert "pulls them to one point" in str(error)  # noqa: PT017
        assert seed == 7
        return
    scale = case["model"].strings.stiffness.max()
    assert_at_rest(case["model"], rest, case["rest_length"], max(scale, 1.0))


# ---- what is said ----


def test_bars_that_pass_through_each_other_are_told():
    """A bar above a fixed one is wound down to below it."""
    nodes = np.array(
        [[0, -1, 0], [0, 1, 0], [-1, 0, 0.5], [1, 0, 0.5], [-1, 0, -0.5], [1, 0, -0.5]], float
    ).T
    structure = tc.Structure(nodes, [[0, 1], [2, 3]], [[2, 4], [3, 5]], 1.0, fixed=[0, 1, 4, 5])
    with pytest.warns(UserWarning, match="bars 0 and 1 pass through each other"):
        rest = tc.equilibrium(model_of(structure, gravity=1.0), rest_length=0.1)
    (only,) = rest.crossings
    height = rest.structure.nodes[2, 2]  # straight down from 0.5 m, the axis of the other at 0 m
    assert only.bars == (0, 1)
    assert only.time == pytest.approx(0.5 / (0.5 - height))
    assert rest.clearance == pytest.approx(-height)
    again = tc.equilibrium(model_of(rest.structure, gravity=1.0), rest_length=0.1)
    assert again.crossings == ()


def test_a_shape_in_the_plane_has_no_clearance():
    flat = tc.library.snelson_x(dimension=2)
    assert tc.prestress(flat, 1.0).clearance == np.inf


def test_only_what_was_given_is_blamed():
    nodes = [[0.0, 1.0, 1.0], [0.0, 0.0, 0.0]]
    structure = tc.Structure(nodes, [[0, 1]], [[0, 2], [1, 2]], 1.0, point_mass=[0, 0, 1.0])
    with pytest.raises(ValueError, match=r"^in the structure, strings\[1\] has no length"):
        tc.equilibrium(model_of(structure), rest_length=0.5)
    with pytest.raises(ValueError, match="the model has no string law"):
        tc.equilibrium(tc.Model(two_crosses()), rest_length=0.5)
