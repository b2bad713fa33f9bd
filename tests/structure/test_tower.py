"""The tower: a tensegrity at any number of stages, with the prism as its first stage."""

import numpy as np
import pytest

import tenscontrol as tc

SIDES = (3, 4, 5, 9)


def force_densities(tower, rest):
    """γ, one row a group: smallest and largest."""
    groups = np.array(tower.string_groups)
    of = {name: rest.force_density[groups == name] for name in dict.fromkeys(groups)}
    return {name: (gamma.min(), gamma.max()) for name, gamma in of.items()}


def joint_force_density(stages, sides, overlap):
    """A self-stress with the symmetry of the tower, from the balance of one node a polygon.

    γ of top, bottom, vertical, saddle and diagonal strings, and λ, of each stage: closed form
    for a pull of 1 N/m in all diagonal strings, written for unit radius and height.
    """
    q, up = sides, 1 - overlap
    side = np.pi / q
    twist = np.pi / 2 - side + 2 / 3 * overlap * side
    lean = twist + 2 * side  # the angle a bar spans
    across = twist + side - 2 * side * np.ceil(q / 4)  # a diagonal string
    saddle = up / overlap
    above = np.arange(stages) < stages - 1  # joints of each stage
    below = np.arange(stages) > 0
    joints = above * 1.0 + below
    # Vertical balance of the top: λ − γ_v; torque about the axis: γ_v sin(twist) − λ sin(lean).
    excess = up * joints
    torque = np.sin(across) * joints
    vertical = (excess * np.sin(lean) - torque) / (np.sin(twist) - np.sin(lean))
    bar = vertical + excess
    inward = vertical * (1 - np.cos(twist)) - bar * (1 - np.cos(lean))
    diagonal = (1 - np.cos(across)) * joints
    at_saddle = 2 * saddle * (1 - np.cos(side))
    polygon = 2 * (1 - np.cos(2 * side))
    top = -(inward + diagonal + at_saddle * above) / polygon
    bottom = -(inward + diagonal + at_saddle * below) / polygon
    return top, bottom, vertical, np.full(stages, saddle), np.ones(stages), bar


def spread(stages, sides, parts):
    """The densities in the order of the strings of a tower."""
    strings = np.stack([parts[i] for i in (0, 1, 2, 3, 3, 4, 4)], axis=1)
    return np.repeat(strings.ravel(), sides)[: (7 * stages - 4) * sides]


@pytest.mark.parametrize("hand", ["left", "right"])
@pytest.mark.parametrize("sides", SIDES)
def test_one_stage_is_the_prism(sides, hand):
    tower = tc.prism_tower(1, sides, radius=0.4, height=1.2, bar_mass=2.0, handedness=hand)
    prism = tc.prism(sides, radius=0.4, height=1.2, bar_mass=2.0, handedness=hand)
    np.testing.assert_allclose(tower.nodes, prism.nodes, rtol=0, atol=1e-15)
    for part in ("bars", "strings", "bar_mass", "string_groups"):
        np.testing.assert_array_equal(getattr(tower, part), getattr(prism, part))


@pytest.mark.parametrize(("stages", "sides"), [(2, 3), (3, 4), (5, 3), (4, 7)])
def test_numbers_of_members(stages, sides):
    tower = tc.prism_tower(stages, sides)
    assert tower.nodes.shape == (3, 2 * stages * sides)
    assert len(tower.bars) == stages * sides
    joints = stages - 1
    for group, count in [
        *[(name, stages * sides) for name in ("top", "bottom", "vertical")],
        *[(name, 2 * joints * sides) for name in ("saddle", "diagonal")],
    ]:
        assert len(tower.strings_in(group)) == count
    assert len(tower.string_nodes) == 0


@pytest.mark.parametrize("sides", SIDES)
@pytest.mark.parametrize("overlap", [0.05, 0.25, 0.4])
@pytest.mark.parametrize("stages", [2, 3])
def test_every_tower_has_a_prestress_that_pulls_on_all_strings(stages, sides, overlap):
    """Two stages have all kinds of ends, three a stage between two joints."""
    tower = tc.prism_tower(stages, sides, radius=0.3, height=0.7, overlap=overlap)
    parts = joint_force_density(stages, sides, overlap)
    rest = tc.prestress(tower, spread(stages, sides, parts))
    assert rest.force_density.min() > 0
    np.testing.assert_allclose(rest.bar_force_density, np.repeat(parts[-1], sides), rtol=1e-9)
    assert rest.bar_force_density.min() > 0
    assert rest.residual < 1e-12 * rest.force_density.max()
    assert rest.mechanisms == 0
    assert rest.is_super_stable


@pytest.mark.parametrize("sides", [3, 5])
def test_a_hundred_stages_balance_as_three_do(sides):
    stages = 100
    tower = tc.prism_tower(stages, sides)
    *strings, bar = joint_force_density(stages, sides, 0.25)
    gamma, lam = spread(stages, sides, strings), np.repeat(bar, sides)
    force = np.zeros_like(tower.nodes)
    for pairs, density in ((tower.strings, gamma), (tower.bars, -lam)):
        pull = density * (tower.nodes[:, pairs[:, 1]] - tower.nodes[:, pairs[:, 0]])
        np.add.at(force, (slice(None), pairs[:, 0]), pull)
        np.add.at(force, (slice(None), pairs[:, 1]), -pull)
    # The height of the tower is in the difference of two nodes, so round-off grows with it.
    np.testing.assert_allclose(force, 0, atol=1e-15 * stages * gamma.max())


def test_the_pull_is_shared_between_all_groups():
    """The default tower has no string near slack, and none that carries all."""
    tower = tc.prism_tower(4)
    found = force_densities(tower, tc.prestress(tower, 10.0, reference="vertical"))
    assert min(low for low, _ in found.values()) > 2.0
    assert max(high for _, high in found.values()) < 12.0


def test_height_radius_and_overlap_are_as_asked():
    tower = tc.prism_tower(5, 4, radius=0.7, height=1.5, overlap=0.2)
    np.testing.assert_allclose(np.hypot(*tower.nodes[:2]), 0.7, rtol=1e-14)
    levels = tower.nodes[2].reshape(5, 2, 4)
    np.testing.assert_allclose(levels[:, 0] - levels[:, 1], 1.5, rtol=1e-14)
    np.testing.assert_allclose(levels[:-1, 0] - levels[1:, 1], 0.3, rtol=1e-13)
    assert np.ptp(tower.bar_length) < 1e-14


@pytest.mark.parametrize("sides", SIDES)
def test_right_is_the_mirror_image_of_left(sides):
    left, right = (tc.prism_tower(3, sides, handedness=hand) for hand in ("left", "right"))
    np.testing.assert_allclose(right.nodes, left.nodes * [[1], [-1], [1]], atol=1e-14)
    np.testing.assert_array_equal(right.strings, left.strings)


@pytest.mark.parametrize("sides", SIDES)
def test_strings_of_a_joint_have_one_length_a_group(sides):
    tower = tc.prism_tower(4, sides)
    for group in ("saddle", "diagonal"):
        assert np.ptp(tower.string_length()[tower.strings_in(group)]) < 1e-13


@pytest.mark.parametrize("sides", [3, 4, 6])
def test_bars_keep_clear_of_each_other(sides):
    tower = tc.prism_tower(3, sides)
    start, end = (tower.nodes[:, tower.bars[:, i]] for i in (0, 1))
    along = np.linspace(0, 1, 101)
    points = start[..., None] + along * (end - start)[..., None]
    gaps = [
        np.linalg.norm(points[:, i, :, None] - points[:, j, None, :], axis=0).min()
        for i in range(len(tower.bars))
        for j in range(i)
    ]
    assert min(gaps) > 0.05


def test_thirty_thousand_bars_are_stages_like_the_first_ones():
    tower, short = tc.prism_tower(10_000), tc.prism_tower(4)
    assert len(tower.bars) == 30_000
    # All but the last stage of the short one, and the strings within it.
    np.testing.assert_array_equal(tower.strings[:72], short.strings)
    np.testing.assert_allclose(tower.nodes[:, :24], short.nodes, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(tower.bars[:12], short.bars)
    # Two stages on, all is the same, turned by two half sides and lifted.
    lift = tower.nodes[2, 12:] - tower.nodes[2, :-12]
    np.testing.assert_allclose(lift, 1.5, rtol=1e-8)
    np.testing.assert_array_equal(tower.strings[42:], tower.strings[:-42] + 12)


@pytest.mark.parametrize(
    ("bad", "error", "words"),
    [
        ({"stages": 0}, ValueError, "stages is 0, expected a whole number of at least 1"),
        ({"stages": 2.5}, TypeError, "stages is 2.5"),
        ({"sides": 2}, ValueError, "sides is 2"),
        ({"radius": 0.0}, ValueError, "radius is 0.0"),
        ({"height": -1.0}, ValueError, "height is -1.0"),
        ({"overlap": 0.0}, ValueError, "overlap is 0.0"),
        ({"overlap": 0.5}, ValueError, "overlap is 0.5, expected at most 0.4"),
        ({"handedness": "both"}, ValueError, "handedness is 'both'"),
        ({"bar_mass": [1.0, 2.0]}, ValueError, "bar_mass has shape"),
    ],
)
def test_bad_arguments_are_named(bad, error, words):
    with pytest.raises(error, match=words.replace("(", r"\(")):
        tc.prism_tower(**{"stages": 2, **bad})
