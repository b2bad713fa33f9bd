"""The shape of the prism: the paper's figures and its symmetries."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

import tenscontrol as tc

SIDES = range(3, 9)
HANDS = ("left", "right")


def azimuth(nodes):
    """Angle of each node about the axis, degrees."""
    return np.rad2deg(np.arctan2(nodes[1], nodes[0]))


def apart(first, second):
    """Turn from one angle to another, degrees, within half a turn."""
    return (second - first + 180) % 360 - 180


def test_first_node_is_where_the_paper_says(prism):
    np.testing.assert_allclose(prism.nodes[:, 0], [0.4830, -0.1294, 1.0], atol=5e-5)


def test_top_and_bottom_nodes_stand_at_the_angles_of_the_paper(prism):
    expected = np.array([-15.0, 105.0, 225.0])
    angles = azimuth(prism.nodes)
    np.testing.assert_allclose(apart(angles[:3], expected), 0, atol=1e-12)
    np.testing.assert_allclose(apart(angles[3:], expected + 30), 0, atol=1e-12)


def test_members_have_the_lengths_of_the_paper(prism):
    np.testing.assert_allclose(prism.bar_length, 1.3903, atol=5e-5)
    lengths = prism.string_length()
    np.testing.assert_allclose(lengths[:6], 0.8660, atol=5e-5)
    np.testing.assert_allclose(lengths[6:], 1.0330, atol=5e-5)


def test_numbers_of_members(prism):
    assert (len(prism.bars), len(prism.strings), prism.nodes.shape) == (3, 9, (3, 6))
    assert len(prism.string_nodes) == 0


@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize("sides", SIDES)
def test_a_vertical_string_spans_the_turn_of_equilibrium_and_a_bar_its_supplement(sides, hand):
    structure = tc.prism(sides, handedness=hand)
    angles = azimuth(structure.nodes)
    turn = 90 - 180 / sides
    vertical = structure.strings[structure.strings_in("vertical")]
    sign = 1 if hand == "left" else -1
    for pairs, spanned in ((vertical, turn), (structure.bars, 180 - turn)):
        found = apart(angles[pairs[:, 0]], angles[pairs[:, 1]])
        np.testing.assert_allclose(found, sign * spanned, atol=1e-10)


@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize("sides", SIDES)
def test_a_turn_by_one_side_maps_the_prism_onto_itself(sides, hand):
    structure = tc.prism(sides, radius=0.6, height=1.1, top_radius=0.4, handedness=hand)
    step = 2 * np.pi / sides * (1 if hand == "left" else -1)
    turned = Rotation.from_euler("z", step).as_matrix() @ structure.nodes
    next_node = np.r_[np.roll(np.arange(sides), -1), sides + np.roll(np.arange(sides), -1)]
    np.testing.assert_allclose(turned, structure.nodes[:, next_node], atol=1e-14)


@pytest.mark.parametrize("sides", SIDES)
def test_radii_and_height_are_as_asked(sides):
    structure = tc.prism(sides, radius=0.7, height=1.3, top_radius=0.2)
    radius, height = np.hypot(*structure.nodes[:2]), structure.nodes[2]
    np.testing.assert_allclose(radius, np.repeat([0.2, 0.7], sides), rtol=1e-14)
    np.testing.assert_array_equal(height, np.repeat([1.3, 0.0], sides))


@pytest.mark.parametrize("sides", SIDES)
def test_right_is_the_mirror_image_of_left(sides):
    left, right = (tc.prism(sides, handedness=hand) for hand in HANDS)
    np.testing.assert_allclose(right.nodes, left.nodes * [[1], [-1], [1]], atol=1e-15)
    np.testing.assert_array_equal(right.strings, left.strings)


def test_bar_masses_go_to_their_bars():
    np.testing.assert_array_equal(tc.prism(bar_mass=[1.0, 2.0, 3.0]).bar_mass, [1, 2, 3])


@given(
    sides=st.integers(3, 12),
    radius=st.floats(0.05, 5.0),
    height=st.floats(0.05, 5.0),
)
def test_prism_radius_inverts_prism(sides, radius, height):
    length = tc.prism(sides, radius, height).bar_length[0]
    found = tc.structure.prism_radius(float(length), height, sides)
    # The radius is the root of a difference: its error grows where bars stand nearly upright.
    assert found == pytest.approx(radius, rel=1e-13 * (1 + (height / radius) ** 2))


@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize("sides", SIDES)
@pytest.mark.parametrize("share", [0.2, 0.7])
def test_with_diagonals_any_turn_up_to_a_quarter_balances(sides, hand, share):
    """Forces around the axis and along a radius at a top node, radii equal."""
    prism = tc.prism(sides, handedness=hand, diagonals=True)
    least, third = np.pi / 2 - np.pi / sides, 2 * np.pi / sides
    turn = least + share * (np.pi / 2 - least)
    further = (turn - least) * (-1 if hand == "left" else 1)
    c, s = np.cos(further), np.sin(further)
    nodes = prism.nodes.copy()
    nodes[:2, :sides] = [[c, -s], [s, c]] @ nodes[:2, :sides]
    vertical = 1.0
    # v sin φ + d sin(φ − θ) = (v + d) sin(φ + θ), and d ≥ 0.
    diagonal = (
        vertical
        * (np.sin(turn + third) - np.sin(turn))
        / (np.sin(turn - third) - np.sin(turn + third))
    )
    bar = vertical + diagonal
    pull = bar * (1 - np.cos(turn + third)) - vertical * (1 - np.cos(turn))
    around = (pull - diagonal * (1 - np.cos(turn - third))) / (2 * (1 - np.cos(third)))
    gamma = np.repeat([around, around, vertical, diagonal], sides)
    assert (gamma > 0).all()
    turned = tc.Structure(nodes, prism.bars, prism.strings, prism.bar_mass)
    assert tc.prestress(turned, gamma).residual < 1e-12
    assert prism.strings_in("diagonal").tolist() == list(range(3 * sides, 4 * sides))
