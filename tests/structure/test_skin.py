"""Skins: counts, mass and balance of the mesh, and loops that are no panels."""

import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial import ConvexHull

import tenscontrol as tc


def polygon(sides, radius=1.0, seed=None):
    """A ring of strings in a tilted plane; corners at random angles if there is a seed."""
    angle = 2 * np.pi * np.arange(sides) / sides
    if seed is not None:
        angle += np.random.default_rng(seed).uniform(-0.3, 0.3, sides) * 2 * np.pi / sides
    flat = radius * np.array([np.cos(angle), np.sin(angle), np.zeros(sides)])
    tilt = np.linalg.qr(np.random.default_rng(sides).normal(size=(3, 3)))[0]
    k = np.arange(sides)
    return tc.Structure(
        nodes=tilt @ flat + [[1.0], [2.0], [3.0]],
        bars=[],
        strings=np.column_stack([k, (k + 1) % sides]),
        bar_mass=[],
        string_node_mass=0.5,
        string_groups=["rim"] * sides,
    )


def sheet(places):
    """Nodes in a plane, each joined to the next so that none is alone."""
    nodes = np.array([[x, y, 0.0] for x, y in places]).T
    return tc.Structure(
        nodes=nodes,
        bars=[],
        strings=list(pairwise(range(len(places)))),
        bar_mass=[],
        string_node_mass=1.0,
    )


def area(structure, loop):
    """Area of a flat convex loop, m², by triangles from its first corner."""
    N = structure.nodes[:, loop]
    sides = N[:, 1:] - N[:, :1]
    return 0.5 * np.linalg.norm(np.cross(sides[:, :-1].T, sides[:, 1:].T), axis=1).sum()


def new_mass(skinned):
    return skinned.string_node_mass[len(skinned.parent.string_nodes) :]


# ---- counts and geometry ----


@given(st.integers(3, 8), st.integers(1, 4))
def test_a_panel_has_the_numbers_of_nodes_and_strings_of_the_closed_form(v, n):
    skinned = tc.skin(polygon(v), "rim", iterations=n, node_mass=0.01)
    assert skinned.nodes.shape[1] - v == 1 + v * (3 ** (n - 1) - 1) // 2
    assert len(skinned.strings_in("skin")) == v * (3**n - 1) // 2


def test_numbers_of_example_2(prism):
    skinned = tc.skin(prism, ("top", "bottom"), iterations=2, node_mass=0.01)
    assert skinned.nodes.shape[1] == 14
    assert len(skinned.strings) == 9 + 2 * (3 + 9)


def test_no_iteration_gives_the_structure(prism):
    assert tc.skin(prism, ("top", "bottom"), iterations=0, node_mass=0.01) is prism


def test_what_was_there_is_kept_and_comes_first(prism):
    skinned = tc.skin(prism, ("top", "sides"), iterations=2, node_mass=0.01)
    np.testing.assert_array_equal(skinned.nodes[:, :6], prism.nodes)
    np.testing.assert_array_equal(skinned.strings[:9], prism.strings)
    np.testing.assert_array_equal(skinned.bars, prism.bars)
    np.testing.assert_array_equal(skinned.bar_mass, prism.bar_mass)
    assert skinned.string_groups[:9] == prism.string_groups
    assert set(skinned.string_groups[9:]) == {"skin"}
    assert skinned.parent is prism
    assert skinned.string_parent is None


@given(st.integers(3, 7), st.integers(0, 100))
def test_the_first_node_is_the_mean_of_the_corners_and_the_next_of_each_triangle(v, seed):
    structure = polygon(v, seed=seed)
    skinned = tc.skin(structure, "rim", iterations=2, node_mass=0.01)
    N = skinned.nodes
    np.testing.assert_allclose(N[:, v], N[:, :v].mean(axis=1), rtol=1e-14)
    for k in range(v):
        corners = N[:, [k, (k + 1) % v, v]]
        np.testing.assert_allclose(N[:, v + 1 + k], corners.mean(axis=1), rtol=1e-14)


def test_a_group_can_be_named(prism):
    both = tc.skin(prism, "top", node_mass=0.01, group="skin_top")
    both = tc.skin(both, "bottom", node_mass=0.01, group="skin_bottom")
    assert len(both.strings_in("skin_top")) == len(both.strings_in("skin_bottom")) == 3
    assert both.parent.parent is prism


def test_fixed_nodes_and_string_nodes_are_kept():
    net = tc.net(3, 3, spacing=1.0, node_mass=0.5)
    skinned = tc.skin(net, [(0, 1, 4, 3), (4, 5, 8, 7)], node_mass=0.01)
    np.testing.assert_array_equal(skinned.fixed, net.fixed)
    np.testing.assert_array_equal(skinned.string_node_mass, [0.5] * 5 + [0.01] * 2)
    assert len(skinned.strings) == len(net.strings) + 8


def test_a_ring_of_segments_is_a_panel_too(prism):
    cut = tc.subdivide(prism, [3] * 3 + [1] * 6, node_mass=0.01)
    skinned = tc.skin(cut, "top", iterations=2, node_mass=0.01)
    assert len(skinned.strings_in("skin")) == 9 * (3**2 - 1) // 2


def test_a_group_of_several_loops_is_several_panels():
    one, other = polygon(3), polygon(4)
    pair = tc.Structure(
        nodes=np.hstack([one.nodes, other.nodes + 10]),
        bars=[],
        strings=np.vstack([one.strings, other.strings + 3]),
        bar_mass=[],
        string_node_mass=1.0,
    )
    skinned = tc.skin(pair, "string", panel_mass=[1.0, 2.0])
    assert new_mass(skinned).tolist() == [1.0, 2.0]


# ---- edges ----


def test_edges_that_are_there_are_not_made_again(prism):
    skinned = tc.skin(prism, [(0, 1, 4), (0, 1, 2)], node_mass=0.01)
    # Nodes 0 and 4 are joined by a bar, 0 and 1 by a top string, 1 and 4 by a vertical one.
    assert len(skinned.strings_in("skin")) == 6


def test_an_edge_that_is_missing_is_made_once_for_the_panels_that_share_it(prism):
    skinned = tc.skin(prism, [(0, 1, 3), (4, 3, 1)], node_mass=0.01)
    made = skinned.strings[skinned.strings_in("skin")]
    assert sum({*pair} == {1, 3} for pair in made.tolist()) == 1
    assert len(made) == 6 + 1


# ---- the sides of a prism ----


@pytest.mark.parametrize("hand", ["left", "right"])
@pytest.mark.parametrize("sides", [3, 4, 5])
@pytest.mark.parametrize("top_radius", [0.3, 0.5])
def test_sides_top_and_bottom_are_the_hull_of_the_prism(sides, top_radius, hand):
    prism = tc.prism(sides, top_radius=top_radius, handedness=hand)
    skinned = tc.skin(prism, ("sides", "top", "bottom"), areal_density=1.0)
    assert skinned.nodes.shape[1] == 2 * sides + 2 * sides + 2
    hull = ConvexHull(prism.nodes.T)
    np.testing.assert_allclose(new_mass(skinned).sum(), hull.area, rtol=1e-12)
    # Every new node is on the hull.
    heights = hull.equations[:, :3] @ skinned.nodes[:, 2 * sides :] + hull.equations[:, 3:]
    np.testing.assert_allclose(heights.max(axis=0), 0, atol=1e-12)


@pytest.mark.parametrize("sides", range(3, 9))
def test_sides_close_the_surface_between_top_and_bottom(sides):
    prism = tc.prism(sides)
    skinned = tc.skin(prism, "sides", node_mass=0.01)
    made = skinned.strings[skinned.strings_in("skin")]
    across = made[(made < 2 * sides).all(axis=1)]
    assert len(across) == sides
    assert len(made) == 3 * 2 * sides + sides
    bars = {frozenset(pair) for pair in prism.bars.tolist()}
    assert not bars & {frozenset(pair) for pair in across.tolist()}


def test_a_structure_that_is_no_prism_has_no_sides():
    with pytest.raises(ValueError, match=r"panels\[0\] is 'sides', .*\('rim'\)"):
        tc.skin(polygon(4), ["sides"], node_mass=0.01)


# ---- mass ----


@given(st.integers(3, 7), st.integers(1, 4), st.integers(0, 100), st.floats(0.01, 10.0))
def test_the_mass_of_a_panel_is_preserved(v, n, seed, mass):
    structure = polygon(v, seed=seed)
    by_panel = new_mass(tc.skin(structure, "rim", iterations=n, panel_mass=mass))
    density = mass / area(structure, range(v))
    by_area = new_mass(tc.skin(structure, "rim", iterations=n, areal_density=density))
    np.testing.assert_allclose([by_panel.sum(), by_area.sum()], mass, rtol=1e-12)
    np.testing.assert_allclose(by_panel, by_area, rtol=1e-12)
    assert by_panel.min() > 0


@given(st.integers(3, 7), st.integers(1, 4))
def test_a_regular_panel_keeps_its_centre_of_mass(v, n):
    skinned = tc.skin(polygon(v), "rim", iterations=n, areal_density=1.0)
    mass = new_mass(skinned)
    centre = skinned.nodes[:, v:] @ mass / mass.sum()
    np.testing.assert_allclose(centre, skinned.nodes[:, v], atol=1e-12)


def test_the_moment_of_inertia_grows_towards_that_of_the_sheet():
    structure = polygon(6)
    exact = 5 / 12 * area(structure, range(6))  # of a hexagon of side 1 about its axis
    found = []
    for n in range(1, 7):
        skinned = tc.skin(structure, "rim", iterations=n, areal_density=1.0)
        arm = skinned.nodes[:, 6:] - skinned.nodes[:, 6:7]
        found.append((new_mass(skinned) * (arm**2).sum(axis=0)).sum())
    assert found[0] == 0
    assert np.all(np.diff(found) > 0)
    assert found[-1] < exact
    assert exact - found[-1] < 0.5 * (exact - found[1])


def test_masses_can_differ_from_panel_to_panel(prism):
    skinned = tc.skin(prism, ("top", "bottom"), iterations=2, panel_mass=[0.1, 0.3])
    assert np.allclose(new_mass(skinned)[:4].sum(), 0.1)
    assert np.allclose(new_mass(skinned)[4:].sum(), 0.3)


def test_each_triangle_of_the_sides_is_a_panel(prism):
    skinned = tc.skin(prism, ("top", "sides"), panel_mass=0.1)
    np.testing.assert_allclose(new_mass(skinned), np.full(7, 0.1), rtol=1e-14)


def test_one_mass_for_each_new_node(prism):
    skinned = tc.skin(prism, ("top", "bottom"), iterations=3, node_mass=0.02)
    np.testing.assert_array_equal(skinned.string_node_mass, np.full(26, 0.02))


# ---- statics ----


@given(st.integers(3, 7), st.integers(1, 4), st.integers(0, 100))
def test_one_force_density_holds_every_new_node_in_its_place(v, n, seed):
    skinned = tc.skin(polygon(v, seed=seed), "rim", iterations=n, node_mass=0.01)
    force = skinned.nodes @ tc.statics.stress_matrix(
        skinned, np.full(len(skinned.strings), 3.0), []
    )
    np.testing.assert_allclose(force[:, v:], 0, atol=1e-10)


def test_a_skin_without_stress_leaves_the_prism_at_rest(prism, rest):
    skinned = tc.skin(prism, ("top", "bottom"), iterations=2, node_mass=0.01)
    gamma = np.zeros(len(skinned.strings))
    gamma[:9] = rest.force_density
    assert tc.prestress(skinned, gamma).residual < 1e-12


def test_a_stretched_skin_has_a_prestress_of_its_own(prism):
    skinned = tc.skin(prism, ("top", "bottom"), iterations=2, node_mass=0.01)
    # By symmetry the skin pulls each corner inwards, so the outer strings need less.
    found = tc.prestress(skinned, 5.0, reference="skin")
    assert found.residual < 1e-11
    assert found.force_density.min() > 0


def test_the_skin_can_be_cut_into_segments(prism):
    skinned = tc.skin(prism, ("top", "bottom"), iterations=1, node_mass=0.01)
    cut = tc.subdivide(skinned, 2, node_mass=0.01)
    assert len(cut.strings_in("skin")) == 12
    assert cut.parent is skinned


# ---- what is refused ----

SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]


def on_sheet(places, loop=None):
    """A skin over a loop of nodes in a plane."""
    return tc.skin(sheet(places), [range(len(places)) if loop is None else loop], node_mass=0.01)


def over(panels, **mass):
    """A skin over panels of the prism."""
    return tc.skin(tc.prism(), panels, **(mass or {"node_mass": 0.01}))


def bent(height):
    """A skin over a square of which one corner is off the plane of the others."""
    square = sheet(SQUARE)
    nodes = square.nodes.copy()
    nodes[2, 2] = height
    lifted = tc.Structure(nodes, [], square.strings, bar_mass=[], string_node_mass=1.0)
    return tc.skin(lifted, [(0, 1, 2, 3)], node_mass=0.01)


REFUSED = {
    "no structure": (lambda: tc.skin("prism", "top", node_mass=1), TypeError, "structure is a str"),
    "name": (
        lambda: over(["lid"]),
        ValueError,
        "panels[0] is 'lid', expected a name of panels of this structure "
        "('top', 'bottom', 'sides'), or a loop of node indices",
    ),
    "a group that is no loop": (
        lambda: over(["top", "vertical"]),
        ValueError,
        "panels[1] is 'vertical', expected a name of panels",
    ),
    "no name at all": (lambda: on_sheet(SQUARE, "string"), ValueError, "(none), or a loop"),
    "number": (lambda: over(3), TypeError, "panels is 3, expected a sequence"),
    "a bare loop": (
        lambda: over([0, 1, 2]),
        ValueError,
        "panels[0] has shape (), expected a panel name or a sequence of node indices; a single "
        "loop is given as panels=[loop]",
    ),
    "two nodes": (lambda: over([(0, 1)]), ValueError, "panels[0] has 2 nodes, expected at least 3"),
    "none": (lambda: over([()]), ValueError, "panels[0] has 0 nodes, expected at least 3"),
    "twice": (
        lambda: over(["top", (0, 1, 3, 0)]),
        ValueError,
        "panels[1] names node 0 twice, expected each corner once; the loop closes by itself",
    ),
    "range": (lambda: over([(0, 1, 6)]), ValueError, "panels[0][2] is node 6, expected 0 to 5"),
    "below": (lambda: over([(0, 1, -1)]), ValueError, "panels[0][2] is node -1, expected 0 to 5"),
    "part": (
        lambda: over([(0, 1, 2.5)]),
        TypeError,
        "panels[0][2] is 2.5, expected a whole number",
    ),
    "words": (lambda: over([("a", "b", "c")]), TypeError, "panels[0] must be an array"),
    "not flat": (
        lambda: over([(0, 1, 4, 3)]),
        ValueError,
        "panels[0] is not flat: node 0 is",
    ),
    "a little bent": (lambda: bent(0.01), ValueError, "expected at most 0.000141 m (0.0001 of its"),
    "line": (
        lambda: on_sheet([(0, 0), (1, 0), (2, 0)]),
        ValueError,
        "panels[0] has no area: its nodes [0, 1, 2] are on a line",
    ),
    "bow tie": (
        lambda: on_sheet(SQUARE, [0, 2, 1, 3]),
        ValueError,
        "panels[0] crosses itself or is not convex: its edge ",
    ),
    "star": (
        lambda: pentagram(),
        ValueError,
        "panels[0] crosses itself or is not convex: its edge ",
    ),
    "touching": (
        lambda: on_sheet([(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)]),
        ValueError,
        "panels[0] crosses itself or is not convex: its edge ",
    ),
    "spike": (
        lambda: on_sheet([(0, 0), (2, 0), (1, 0), (1, 2)]),
        ValueError,
        "panels[0] crosses itself or is not convex: its edge ",
    ),
    "arrow": (
        lambda: on_sheet([(0, 0), (4, 4), (0, 1), (-4, 4)]),
        ValueError,
        "panels[0] crosses itself or is not convex: its edge",
    ),
    "no mass": (
        lambda: over("top", node_mass=None),
        ValueError,
        "found no mass, expected exactly one of node_mass",
    ),
    "two masses": (
        lambda: over("top", node_mass=0.1, panel_mass=0.1),
        ValueError,
        "found node_mass and panel_mass, expected exactly one of node_mass",
    ),
    "node mass": (lambda: over("top", node_mass=0), ValueError, "node_mass is 0, expected"),
    "panel mass": (
        lambda: over(["top", "bottom"], panel_mass=[0.1, 0.0]),
        ValueError,
        "panel_mass[1] is 0, expected a positive mass in kg",
    ),
    "panel masses": (
        lambda: over(["top", "sides"], panel_mass=[0.1, 0.1]),
        ValueError,
        "panel_mass has shape (2,), expected () or (7,): one number for all, or one per panel",
    ),
    "density": (
        lambda: over("top", areal_density=-1.0),
        ValueError,
        "areal_density[0] is -1, expected a positive areal density in kg/m²",
    ),
    "iterations": (
        lambda: tc.skin(tc.prism(), "top", iterations=-1, node_mass=0.01),
        ValueError,
        "iterations is -1, expected a whole number of at least 0",
    ),
    "group": (
        lambda: tc.skin(tc.prism(), "top", node_mass=0.01, group="my skin"),
        ValueError,
        "group is 'my skin', expected a name of letters",
    ),
    "loop, though not filled": (
        lambda: tc.skin(tc.prism(), [(0, 1)], iterations=0, node_mass=0.01),
        ValueError,
        "panels[0] has 2 nodes",
    ),
}


def pentagram():
    angle = 2 * np.pi * np.arange(5) / 5
    return on_sheet(list(zip(np.cos(angle), np.sin(angle), strict=True)), [0, 2, 4, 1, 3])


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_panel_is_refused(case):
    call, exception, message = REFUSED[case]
    with pytest.raises(exception, match=re.escape(message)):
        call()


def test_nodes_written_with_four_digits_are_flat_enough():
    assert bent(1e-4).nodes.shape[1] == 5


# ---- rest lengths of skins stretched from the start ----


def skinned():
    return tc.skin(tc.prism(), panels=["top", "bottom"], iterations=2, node_mass=0.01)


def test_strain_of_the_skin_is_the_prestretch_and_the_others_keep_theirs():
    structure = skinned()
    given = np.linspace(0.5, 0.8, 9)
    rest_length = tc.structure.skin_rest_length(structure, given, prestretch=0.1)
    np.testing.assert_array_equal(rest_length[:9], given)
    np.testing.assert_allclose(structure.string_length()[9:] / rest_length[9:], 1.1)


def test_prestretch_gives_tension_and_its_lack_gives_none():
    structure = skinned()
    model = tc.Model(structure, strings=tc.LinearStrings(100.0))
    for prestretch, pulls in ((0.1, True), (0.0, False), (-0.1, False)):
        rest_length = tc.structure.skin_rest_length(structure, 0.7, prestretch)
        gamma = tc.to_force_density(model, structure.nodes, rest_length)
        assert (gamma[9:] > 0).all() == pulls
        assert (gamma[9:] >= 0).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: tc.structure.skin_rest_length(tc.subdivide(tc.prism(), 2, 0.1), 0.7),
            "structure is subdivided: give its parent",
        ),
        (
            lambda: tc.structure.skin_rest_length(skinned(), 0.7, -1.0),
            "prestretch is -1.0, expected",
        ),
        (lambda: tc.structure.skin_rest_length(skinned(), -0.7), r"rest_length\[0\] is -0.7"),
        (
            lambda: tc.structure.skin_rest_length(skinned(), [0.7] * 8),
            r"rest_length has shape \(8,\)",
        ),
    ],
)
def test_bad_prestretch_is_refused_by_name(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_skin_keeps_supports_payloads_and_clusters():
    prism = tc.prism()
    mass = np.array([0.5, 0, 0, 0, 0, 0])
    over = tc.Structure(
        prism.nodes, prism.bars, [(0, 1, 2, 0), *prism.strings[3:].tolist()], 1.0,
        point_mass=mass, fixed=[3, (4, "z")], string_groups=["top", *prism.string_groups[3:]],
    )  # fmt: skip
    skinned = tc.skin(over, ["top", "bottom"], iterations=1, panel_mass=0.3)
    assert skinned.paths[0] == (0, 1, 2, 0)
    assert skinned.rollers == ((4, "z"),)
    np.testing.assert_array_equal(skinned.point_mass, [*mass, 0.3, 0.3])
    plain = tc.skin(prism, ["top", "bottom"], iterations=1, panel_mass=0.3)
    np.testing.assert_array_equal(skinned.nodes, plain.nodes)
    np.testing.assert_array_equal(skinned.segments, plain.segments)
    of_skin = skinned.strings_in("skin")
    np.testing.assert_allclose(skinned.string_length()[of_skin], 0.5, rtol=1e-14)
    stretched = tc.structure.skin_rest_length(skinned, 0.8, prestretch=0.25)
    np.testing.assert_allclose(stretched[of_skin], 0.4, rtol=1e-14)
    assert len(stretched) == len(skinned.strings)


def test_panels_of_joined_bars_are_covered():
    tip = tc.library.d_bar_3d(sides=4)
    skinned = tc.skin(tip, [(0, 1, 4)], iterations=1, node_mass=0.1)
    assert len(skinned.strings) == len(tip.strings) + 3
    assert len(skinned.blocks) == 1


def test_strings_side_by_side_are_no_panel():
    prism = tc.prism()
    doubled = tc.Structure(
        prism.nodes, prism.bars, [*prism.strings.tolist(), (0, 3), (3, 0)], 1.0,
        string_groups=[*prism.string_groups, "pair", "pair"],
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"panels\[0\] is 'pair', expected a name of panels"):
        tc.skin(doubled, ["pair"], node_mass=0.1)
    assert len(tc.skin(doubled, ["top"], node_mass=0.1).strings) == 14
