"""The library: sizes, classes, states of self-stress and mechanisms as each docstring says."""

import numpy as np
import pytest
from scipy.optimize import linprog

import tenscontrol as tc
from tenscontrol import library
from tests.refused import NAN, assert_refused, refused

# Arguments, class, states of self-stress, mechanisms without those of the whole as one body.
CASES = [
    ("six_bar_ball", {}, 1, 1, 1),
    ("truncated_tetrahedron", {}, 1, 1, 7),
    ("twelve_bar_ball", {}, 1, 1, 19),
    ("thirty_bar_ball", {}, 1, 1, 55),
    ("snelson_x", {}, 1, 1, 0),
    ("snelson_x", {"dimension": 3, "width": 2.0}, 1, 1, 1),
    ("kite", {}, 1, 1, 0),
    ("kite", {"dimension": 3}, 1, 1, 1),
    ("d_bar", {}, 2, 1, 0),
    ("d_bar", {"dimension": 3, "height": 1.0}, 2, 1, 1),
    ("d_bar_3d", {}, 3, 1, 0),
    ("d_bar_3d", {"sides": 5}, 5, 1, 0),
    ("t_bar", {}, 4, 1, 0),
    ("t_bar", {"dimension": 3}, 4, 1, 2),
    ("t_bar", {"continuous": True}, 2, 2, 0),
    ("t_bar", {"continuous": True, "dimension": 3}, 2, 2, 2),
    ("class2_tower", {}, 2, 2, 2),
    ("class2_tower", {"stages": 3, "floating": True}, 2, 3, 3),
    ("class2_tower", {"stages": 2, "sides": 5, "floating": True}, 2, 2, 6),
    ("class2_tower", {"stages": 1, "sides": 4, "handedness": "right"}, 1, 1, 1),
    ("arm", {}, 2, 2, 0),
    ("arm", {"sections": 5, "height": 0.3}, 2, 5, 0),
    ("stedy_arm", {}, 6, 6, 0),
    ("spine", {}, 4, 3, 0),
    ("spine", {"vertebrae": 6}, 4, 15, 0),
    ("geiger_dome", {}, 1, 4, 9),
    ("geiger_dome", {"sides": 8, "hoops": 3}, 1, 1, 38),
    ("levy_dome", {}, 1, 7, 1),
    ("levy_dome", {"sides": 12}, 1, 13, 1),
    ("levy_dome", {"sides": 5, "hoops": 1}, 1, 5, 0),
    ("cable_net", {}, 0, 1, 4),
    ("cable_net", {"rows": 4, "columns": 6, "sag": -0.2}, 0, 1, 3),
    ("wheel", {}, 2, 1, 0),
    ("wheel", {"spokes": 3}, 2, 1, 0),
    ("prism", {}, 1, 1, 1),
    ("prism_tower", {"stages": 2}, 1, 6, 0),
]
each = pytest.mark.parametrize(
    ("name", "sizes", "structure_class", "states", "mechanisms"),
    CASES,
    ids=[f"{case[0]}{i}" for i, case in enumerate(CASES)],
)


def member_directions(structure):
    """The equilibrium matrix by lengths, transposed: a row for each bar and string that moves."""
    members = np.vstack([structure.bars, structure.strings])
    d = structure.dimension
    vectors = structure.nodes[:, members[:, 1]] - structure.nodes[:, members[:, 0]]
    rows = np.zeros((len(members), structure.nodes.size))
    for row, ends, vector in zip(rows, members, vectors.T, strict=True):
        unit = vector / np.linalg.norm(vector)
        for end, sign in zip(ends, (-1, 1), strict=True):
            rows_of_node = slice(d * end, d * end + d)
            row[rows_of_node] = sign * unit
    moves = ~np.isin(members, structure.fixed).all(axis=1)
    bars = np.count_nonzero(moves[: len(structure.bars)])
    return rows[moves][:, structure.free_rows], bars


@each
def test_counts_are_those_of_the_docstring(name, sizes, structure_class, states, mechanisms):
    structure = getattr(library, name)(**sizes)
    rows, _ = member_directions(structure)
    rank = np.linalg.matrix_rank(rows, tol=1e-9 * np.linalg.norm(rows, 2))
    bodily = tc.structure.supports.rigid_basis(structure).shape[1]
    assert structure.structure_class == structure_class
    assert len(rows) - rank == states
    assert rows.shape[1] - rank - bodily == mechanisms


@each
def test_all_strings_can_be_taut_at_rest(name, sizes, structure_class, states, mechanisms):
    structure = getattr(library, name)(**sizes)
    rows, bars = member_directions(structure)
    # Only bars that make a body rigid may be pulled.
    most = None if name == "spine" else 0.0
    bounds = [(None, most)] * bars + [(1.0, None)] * (len(rows) - bars)
    found = linprog(np.zeros(len(rows)), A_eq=rows.T, b_eq=np.zeros(rows.shape[1]), bounds=bounds)
    assert found.status == 0


def test_every_structure_of_the_library_is_tested():
    assert {case[0] for case in CASES} | {"net"} == set(library.__all__)
    assert tc.library is library


def test_names_of_the_top_level_are_listed():
    assert (library.prism, library.prism_tower, library.net) == (tc.prism, tc.prism_tower, tc.net)


@pytest.mark.parametrize(
    "name", ["six_bar_ball", "truncated_tetrahedron", "twelve_bar_ball", "thirty_bar_ball"]
)
def test_balls_have_equal_bars_apart_from_one_another_and_alike_nodes(name):
    ball = getattr(library, name)(bar_length=0.7, bar_mass=2.0)
    np.testing.assert_allclose(ball.bar_length, 0.7, rtol=1e-12)
    radius = np.linalg.norm(ball.nodes, axis=0)
    np.testing.assert_allclose(radius, radius[0], rtol=1e-12)
    assert tc.structure.bar_clearance.bar_distances(ball, ball.nodes).least > 0.07
    count = np.bincount(ball.strings.ravel())
    assert set(count) == {4 if name == "six_bar_ball" else 3}
    for group in dict.fromkeys(ball.string_groups):
        length = ball.string_length()[ball.strings_in(group)]
        np.testing.assert_allclose(length, length[0], rtol=1e-12)
    assert (ball.bar_mass == 2.0).all()


@pytest.mark.parametrize(
    "name", ["six_bar_ball", "truncated_tetrahedron", "twelve_bar_ball", "thirty_bar_ball"]
)
def test_balls_balance_under_one_force_density_and_no_shape_has_less_energy(name):
    ball = getattr(library, name)()
    C_s, C_b = ball.C_s.toarray(), (ball.C_b @ ball.C_nb).toarray()
    strings, bars = C_s.T @ C_s, C_b.T @ C_b
    pull, push = ball.nodes @ strings, ball.nodes @ bars
    stress = strings - (pull * push).sum() / (push * push).sum() * bars
    np.testing.assert_allclose(ball.nodes @ stress, 0.0, atol=1e-12)
    values = np.linalg.eigvalsh(stress)  # super-stable: nothing below 0, affine motions at 0
    assert np.abs(values[:4]).max() < 1e-12 < 1e-2 < values[4]


def test_the_six_bar_ball_has_the_size_of_superball():
    ball = library.six_bar_ball()
    np.testing.assert_allclose(ball.bar_length, 1.7)
    np.testing.assert_allclose(ball.string_length(), np.sqrt(3 / 8) * 1.7)


def test_towers_have_the_sizes_of_their_arguments():
    tower = library.class2_tower(stages=2, radius=10.0, height=30.0, handedness="right")
    angle = np.degrees(np.arctan2(tower.nodes[1], tower.nodes[0]))[[0, 3, 6]]
    np.testing.assert_allclose(angle, [0.0, 30.0, 60.0], atol=1e-12)
    np.testing.assert_allclose(tower.nodes[2, ::3], [0.0, 30.0, 60.0])
    np.testing.assert_allclose(np.hypot(*tower.nodes[:2]), 10.0)
    assert tower.bars[[0, 3]].tolist() == [[0, 4], [3, 7]]


def test_one_stage_of_the_class_2_tower_is_the_prism():
    one, prism = library.class2_tower(stages=1, floating=True), tc.prism()
    np.testing.assert_allclose(one.bar_length, prism.bar_length, rtol=1e-14)
    lengths = [np.sort(each.string_length()) for each in (one, prism)]
    np.testing.assert_allclose(*lengths, rtol=1e-14)
    up = one.bar_vectors(one.nodes), -prism.bar_vectors(prism.nodes)  # one from below, one above
    low = one.nodes[:, one.bars[:, 0]], prism.nodes[:, prism.bars[:, 1]]
    screw = [x[0] * v[1] - x[1] * v[0] for x, v in zip(low, up, strict=True)]
    assert (np.sign(screw[0]) == np.sign(screw[1])).all()


def test_domes_are_held_at_the_rim_and_stand_on_a_sphere():
    for dome in (library.geiger_dome(sides=7, hoops=2), library.levy_dome(sides=7, hoops=2)):
        rim = dome.nodes[:, dome.fixed]
        assert len(dome.fixed) == 7
        np.testing.assert_allclose(rim[2], 0.0, atol=1e-12)
        heads = np.hstack([rim, dome.nodes[:, dome.bars[:, 0]]])
        middle = np.linalg.lstsq(
            np.vstack([2 * heads, np.ones(heads.shape[1])]).T, (heads**2).sum(0), rcond=None
        )[0]
        np.testing.assert_allclose(middle[:2], 0.0, atol=1e-9)
        bars = dome.bar_vectors(dome.nodes)
        np.testing.assert_allclose(bars[:2], 0.0, atol=1e-12)
        assert (bars[2] < 0).all()


def test_the_levy_dome_has_the_coordinates_of_its_source():
    dome = library.levy_dome(sides=6)
    heights = np.unique(dome.nodes[2].round(6))
    expected = [-9.622504, -0.959783, 0.0, 8.662722, 13.457857]
    np.testing.assert_allclose(heights, expected, atol=2e-6)


def test_the_cable_net_balances_under_one_force_density():
    saddle = library.cable_net(rows=6, columns=7, sag=0.4)
    pull = saddle.string_vectors(saddle.nodes) @ saddle.C_s
    np.testing.assert_allclose(pull[:, saddle.free], 0.0, atol=1e-12)
    x = saddle.nodes[0]
    row = saddle.nodes[2, np.abs(saddle.nodes[1]) < 0.3]
    assert np.ptp(row) == pytest.approx(0.4)
    assert np.ptp(x) == pytest.approx(3.0)


def test_the_spine_hangs_in_its_saddle_strings():
    back = library.spine(vertebrae=4)
    assert len(back.blocks) == 3
    assert all(block.is_redundant for block in back.blocks)
    np.testing.assert_allclose(back.bar_length[:4], 0.15)
    saddle = back.string_vectors(back.nodes)[2, back.strings_in("saddle")]
    assert (saddle < 0).all()  # the lower legs of the next are below


# fmt: off
REFUSED = [
    refused("ball without length", lambda: library.six_bar_ball(0.0), ValueError,
            r"bar_length is 0\.0, expected a positive"),
    refused("ball length not a number", lambda: library.thirty_bar_ball(NAN), ValueError,
            r"bar_length is nan"),
    refused("ball masses of another count", lambda: library.twelve_bar_ball(bar_mass=[1.0, 2.0]),
            ValueError, r"bar_mass has shape \(2,\), expected \(\) or \(12,\)"),
    refused("cross of four dimensions", lambda: library.snelson_x(dimension=4), ValueError,
            r"dimension is 4, expected .*at most 3"),
    refused("cross on a line", lambda: library.kite(dimension=1), ValueError,
            r"dimension is 1, expected .*at least 2"),
    refused("kite beside its bar", lambda: library.kite(across=1.0), ValueError,
            r"across is 1, expected a share of the width, below 1"),
    refused("d-bar of two sides", lambda: library.d_bar_3d(sides=2), ValueError, r"sides is 2"),
    refused("d-bar of text", lambda: library.d_bar(width="wide"), TypeError, r"width is 'wide'"),
    refused("t-bar too low", lambda: library.t_bar(height=-1), ValueError, r"height is -1"),
    refused("tower without stages", lambda: library.class2_tower(0), ValueError, r"stages is 0"),
    refused("tower with another screw", lambda: library.class2_tower(handedness="up"), ValueError,
            r"handedness is 'up', expected one of 'left', 'right'"),
    refused("tower floating by a number", lambda: library.class2_tower(floating=0), TypeError,
            r"floating is 0.*, expected True or False"),
    refused("tower too high", lambda: library.class2_tower(10**9), ValueError,
            r"stages is 1000000000 and sides is 3, which makes .* GB"),
    refused("arm without sections", lambda: library.arm(0), ValueError, r"sections is 0"),
    refused("spine of one vertebra", lambda: library.spine(1), ValueError, r"vertebrae is 1"),
    refused("spine with level legs", lambda: library.spine(spread=2.0), ValueError,
            r"spread is 2 rad, expected below π/2"),
    refused("spine as flat as can be", lambda: library.spine(spread=1e-15), ValueError,
            r"spread = 1e-15, .*make no structure: bars\[4\] has no length"),
    refused("D-bar as flat as can be", lambda: library.d_bar(height=1e-15), ValueError,
            r"height = 1e-15, .*make no structure: .*dead centre"),
    refused("spine too far apart", lambda: library.spine(spacing=0.2), ValueError,
            r"spacing is 0\.2 m, expected below 0\.15 m, twice the height of a leg"),
    refused("dome higher than wide", lambda: library.levy_dome(rise=50.0), ValueError,
            r"rise is 50 m, expected less than the radius, 50 m"),
    refused("dome of three sides", lambda: library.levy_dome(sides=3), ValueError,
            r"sides is 3, .*at least 4"),
    refused("dome with upright diagonals", lambda: library.geiger_dome(slope=1.6), ValueError,
            r"slope is 1\.6 rad, expected below π/2"),
    refused("cable net of two rows", lambda: library.cable_net(rows=2), ValueError, r"rows is 2"),
    refused("cable net without mass", lambda: library.cable_net(node_mass=0), ValueError,
            r"node_mass is 0"),
    refused("wheel of two spokes", lambda: library.wheel(2), ValueError, r"spokes is 2"),
]
# fmt: on


@pytest.mark.parametrize(("call", "exception", "message"), REFUSED)
def test_bad_sizes_are_refused_by_name(call, exception, message):
    assert_refused(call, exception, message)
