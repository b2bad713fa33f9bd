"""The drawing of a structure: every member where it is, bars unlike strings without colour."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from mpl_toolkits.mplot3d import proj3d

import tenscontrol as tc


def ends(collection):
    """Return what a collection draws, shape (members, 2, 3)."""
    return np.asarray(collection._segments3d)


def darkness(color):
    return 1 - to_rgb(color) @ np.array([0.299, 0.587, 0.114])


def is_dotted(collection):
    return [pattern is not None for _, pattern in collection.get_linestyle()]


def test_every_member_is_drawn_between_its_nodes(prism):
    drawing = tc.plot.structure(prism)
    assert ends(drawing.bars).shape == (3, 2, 3)
    assert ends(drawing.strings).shape == (9, 2, 3)
    assert np.array_equal(ends(drawing.bars), prism.nodes.T[prism.bars])
    assert np.array_equal(ends(drawing.strings), prism.nodes.T[prism.strings])
    assert np.array_equal(drawing.nodes.get_data_3d(), prism.nodes)


def test_other_node_positions_are_drawn_where_given(prism):
    moved = prism.nodes + np.array([[1.0], [2.0], [3.0]])
    drawing = tc.plot.structure(prism, moved)
    assert np.array_equal(ends(drawing.bars), moved.T[prism.bars])


def test_bars_and_strings_differ_in_grey_print(prism):
    drawing = tc.plot.structure(prism)
    (thick,), (thin,) = drawing.bars.get_linewidth(), drawing.strings.get_linewidth()
    assert thick > 3 * thin
    assert drawing.bars.get_capstyle() == "round"
    bar, string = (part.get_edgecolor()[0][:3] for part in (drawing.bars, drawing.strings))
    assert darkness(bar) > darkness(string) + 0.15


def test_many_members_are_drawn_thinner_but_still_apart():
    few, many = (tc.plot.structure(tc.prism(sides=sides)) for sides in (3, 40))
    assert many.bars.get_linewidth()[0] < few.bars.get_linewidth()[0]
    assert many.bars.get_linewidth()[0] > 3 * many.strings.get_linewidth()[0]


def test_axes_have_units_and_one_scale(prism):
    ax = tc.plot.structure(prism).ax
    assert [ax.get_xlabel(), ax.get_ylabel(), ax.get_zlabel()] == ["x, m", "y, m", "z, m"]
    extent = np.ptp([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()], axis=1)
    scale = ax._box_aspect / extent
    assert np.allclose(scale, scale[0])


def test_limits_hold_all_nodes(prism):
    ax = tc.plot.structure(prism, prism.nodes + 7).ax
    limits = (ax.get_xlim(), ax.get_ylim(), ax.get_zlim())
    for (low, high), row in zip(limits, prism.nodes + 7, strict=True):
        assert low < row.min() < row.max() < high


def test_no_numbers_in_the_corners_of_the_box(prism):
    ax = tc.plot.structure(prism, 1.16 * prism.nodes).ax
    for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
        ticks = axis.get_majorticklocs()
        assert len(ticks) >= 2
        assert ticks.min() > low + 0.03 * (high - low)
        assert ticks.max() < high - 0.03 * (high - low)


def test_flat_structure_has_a_box_with_depth():
    line = tc.Structure(
        nodes=[[0, 1, 2], [0, 0, 0], [0, 0, 0]],
        bars=[[0, 1]],
        strings=[[1, 2]],
        bar_mass=1.0,
        string_node_mass=0.1,
    )
    ax = tc.plot.structure(line).ax
    assert np.ptp(ax.get_zlim()) > 0.2 * np.ptp(ax.get_xlim())
    ax.figure.canvas.draw()


def test_legend_names_what_is_there(prism):
    texts = [text.get_text() for text in tc.plot.structure(prism).ax.get_legend().get_texts()]
    assert texts == ["bar", "string"]
    assert tc.plot.structure(prism, legend=False).ax.get_legend() is None


def test_two_shapes_share_axes_that_hold_both(prism, space):
    away = np.array([[5.0], [0.0], [0.0]])
    tc.plot.structure(prism, prism.nodes + away, ax=space, faint=True)
    second = tc.plot.structure(prism, ax=space)
    assert second.ax is space
    assert space.get_xlim()[0] < prism.nodes[0].min()
    assert space.get_xlim()[1] > prism.nodes[0].max() + 5


def test_faint_shape_is_lighter_lies_behind_and_has_no_legend(prism, space):
    faint = tc.plot.structure(prism, ax=space, faint=True)
    assert space.get_legend() is None
    plain = tc.plot.structure(prism, ax=space)
    assert faint.bars.get_zorder() < plain.strings.get_zorder()
    lighter, darker = (part.bars.get_edgecolor()[0][:3] for part in (faint, plain))
    assert darkness(lighter) < darkness(darker) - 0.4


def pixels(figure):
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)


@pytest.mark.parametrize("first", ["faint", "plain"])
def test_a_faint_shape_hides_nothing_in_axes_of_a_user(first, space):
    ball = tc.library.six_bar_ball()
    toward = 0.4 * np.array([[0.47], [-0.81], [0.34]])  # the eye
    tc.plot.structure(ball, ax=space, legend=False, faint=first == "faint")
    tc.plot.structure(ball, ball.nodes + (toward if first == "plain" else -toward), ax=space,
                      legend=False, faint=first == "plain")  # fmt: skip
    with_faint = pixels(space.figure)
    for each in [each for each in (*space.collections, *space.lines) if each.get_zorder() < 2]:
        each.set_visible(False)
    alone = pixels(space.figure)
    dark = alone.max(axis=2) < 140  # bars
    assert dark.sum() > 500
    seen = np.abs(with_faint - alone)[dark].max(axis=1) < 20  # all but the edges
    assert seen.mean() > 0.99


def test_near_members_are_drawn_over_far_ones_and_darker(space):
    nodes = np.array([[0, 0, 1, 1], [0, 1, 0, 1], [0, 0.5, 0.5, 0]], dtype=float)
    pair = tc.Structure(nodes, [[0, 2], [1, 3]], [[0, 1]], 1.0)
    bars = tc.plot.structure(pair, ax=space, legend=False).bars
    for azimuth, near in ((-90, 0), (90, 1)):  # from the side of y < 0, of y > 0
        space.view_init(elev=10, azim=azimuth)
        order, depth = bars._by_depth()
        assert order.tolist() == [1 - near, near]
        assert depth[near] == 0
        assert depth[1 - near] == 1
    assert darkness(bars.get_edgecolor()[0][:3]) > 0.8  # the colour asked for stays


@pytest.mark.parametrize("axes", ["own", "of a faint shape", "of two"])
def test_the_colour_scale_covers_nothing(axes, rest):
    for given in (rest, tc.prestress(tc.library.geiger_dome(8), min_force_density=10.0)):
        ax = None
        if axes == "of two":
            ax = plt.figure(figsize=(8.0, 4.0)).add_subplot(1, 2, 1, projection="3d")
        elif axes == "of a faint shape":
            ax = tc.plot.structure(given, faint=True).ax
        drawing = tc.plot.structure(given, ax=ax)
        drawing.ax.figure.canvas.draw()
        scale = drawing.colorbar.ax.get_tightbbox()
        assert not scale.overlaps(drawing.ax.zaxis.label.get_window_extent())
        assert scale.x1 <= drawing.ax.figure.bbox.x1


@pytest.mark.parametrize("name", ["six_bar_ball", "class2_tower", "d_bar", "arm", "snelson_x"])
def test_numbers_do_not_cover_one_another(name):
    drawing = tc.plot.structure(getattr(tc.library, name)(), labels=True, member_labels=True)
    drawing.ax.figure.canvas.draw()
    texts = (*drawing.node_labels, *drawing.bar_labels, *drawing.string_labels)
    ax = drawing.ax
    half = np.array([text.get_window_extent().size for text in texts]) / 2
    if ax.name == "3d":
        places = np.array([text.get_position_3d() for text in texts])
        places = np.column_stack(proj3d.proj_transform(*places.T, ax.get_proj())[:2])
    else:
        places = np.array([text.get_position() for text in texts])
    middle = ax.transData.transform(places)
    gap = np.abs(middle[:, None] - middle) - 0.8 * (half[:, None] + half)
    first, second = np.nonzero(np.triu((gap < 0).all(axis=2), 1))
    covered = [
        (texts[i].get_text(), texts[j].get_text()) for i, j in zip(first, second, strict=True)
    ]
    assert len(covered) <= len(texts) // 20, covered


def test_numbers_stand_outside_the_nodes(prism):
    drawing = tc.plot.structure(prism, labels=True, member_labels=True)
    assert [text.get_text() for text in drawing.node_labels] == list("012345")
    assert [text.get_text() for text in drawing.bar_labels] == ["b0", "b1", "b2"]
    assert [text.get_text() for text in drawing.string_labels] == [f"s{i}" for i in range(9)]
    centre = prism.nodes.mean(axis=1)
    for text, node in zip(drawing.node_labels, prism.nodes.T, strict=True):
        outside = np.linalg.norm(np.array(text.get_position_3d()) - centre)
        assert outside > np.linalg.norm(node - centre) + 0.04


def test_update_moves_members_and_numbers_but_not_the_limits(prism):
    drawing = tc.plot.structure(prism, labels=True, member_labels=True)
    limits = drawing.ax.get_xlim(), drawing.ax.get_zlim()
    numbers = [np.array(text.get_position_3d()) for text in drawing.node_labels]
    shift = np.array([0.1, 0.0, -0.2])
    moved = prism.nodes + shift[:, None]
    drawing.update(moved)
    assert np.array_equal(ends(drawing.bars), moved.T[prism.bars])
    assert np.array_equal(ends(drawing.strings), moved.T[prism.strings])
    assert np.array_equal(drawing.nodes.get_data_3d(), moved)
    for text, before in zip(drawing.node_labels, numbers, strict=True):
        assert np.allclose(text.get_position_3d(), before + shift)
    assert np.allclose(
        drawing.string_labels[0].get_position_3d(), moved[:, prism.strings[0]].mean(axis=1)
    )
    assert (drawing.ax.get_xlim(), drawing.ax.get_zlim()) == limits


def test_force_density_colours_the_strings_on_a_labelled_scale(prism, rest):
    drawing = tc.plot.structure(prism, force_density=rest.force_density)
    drawing.ax.figure.canvas.draw()
    assert drawing.colorbar.ax.get_ylabel() == "γ, N/m"
    assert drawing.strings.get_clim() == (0.0, rest.force_density.max())
    colors = drawing.strings.get_edgecolor()[:, :3]
    assert len(colors) == 9
    grey = [darkness(color) for color in colors]
    # More force is darker, so that grey print tells the same.
    assert min(grey[6:]) > max(grey[:6]) + 0.1
    assert not any(is_dotted(drawing.strings))


def test_colour_scale_stays_dark_enough_for_white_paper():
    from tenscontrol.plot.style import FORCE_MAP

    levels = [darkness(FORCE_MAP(share)[:3]) for share in np.linspace(0, 1, 20)]
    assert min(levels) > 0.2
    assert (np.diff(levels) > 0).all()


def test_slack_strings_are_dotted_and_named(prism, rest):
    gamma = rest.force_density.copy()
    gamma[[0, 4]] = 0.0
    drawing = tc.plot.structure(prism, force_density=gamma)
    assert is_dotted(drawing.strings) == [i in (0, 4) for i in range(9)]
    texts = [text.get_text() for text in drawing.ax.get_legend().get_texts()]
    assert texts == ["bar", "string", "slack string"]
    drawing.update(prism.nodes, rest.force_density)
    assert not any(is_dotted(drawing.strings))
    assert np.array_equal(drawing.strings.get_array(), rest.force_density)


def test_all_strings_slack_is_a_drawing_too(prism):
    drawing = tc.plot.structure(prism, force_density=0.0)
    drawing.ax.figure.canvas.draw()
    assert all(is_dotted(drawing.strings))


def test_plain_drawing_learns_which_strings_are_slack(prism):
    drawing = tc.plot.structure(prism)
    drawing.update(prism.nodes, np.arange(9.0))
    assert is_dotted(drawing.strings) == [True] + [False] * 8
    assert drawing.strings.get_array() is None


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"nodes": np.zeros((6, 3))}, ValueError, r"nodes has shape \(6, 3\), expected \(3, 6\)"),
        ({"nodes": np.full((3, 6), np.nan)}, ValueError, r"nodes\[0, 0\] is nan"),
        ({"force_density": [1.0]}, ValueError, r"force_density has shape \(1,\)"),
        ({"force_density": -1.0}, ValueError, r"force_density\[0\] is -1.*only pull"),
        ({"ax": "here"}, TypeError, "ax is a str, expected three-dimensional matplotlib Axes"),
        (
            {"nodes": np.full((3, 6), 1e308)},
            ValueError,
            r"nodes\[0, 0\] is 1e\+308, expected",
        ),
        ({"force_density": 1e308}, ValueError, "force_density is 1e.308, expected"),
        ({"labels": np.zeros(3)}, TypeError, r"labels is .*expected True or False"),
        ({"member_labels": "no"}, TypeError, "member_labels is 'no'"),
        ({"faint": None}, TypeError, "faint is None"),
        ({"legend": 1}, TypeError, "legend is 1"),
        ({"colour": "red"}, TypeError, "colour"),
    ],
)
def test_wrong_arguments_are_named(prism, arguments, error, message):
    with pytest.raises(error, match=message):
        tc.plot.structure(prism, **arguments)
    assert plt.get_fignums() == []


def test_flat_axes_and_other_objects_are_refused(prism, flat):
    with pytest.raises(TypeError, match="ax is flat, expected three-dimensional"):
        tc.plot.structure(prism, ax=flat)
    with pytest.raises(TypeError, match="structure is a ndarray"):
        tc.plot.structure(prism.nodes)
    with pytest.raises(ValueError, match=r"nodes has shape \(3, 2\)"):
        tc.plot.structure(prism).update(np.zeros((3, 2)))


def test_structures_of_bars_only_and_of_strings_only_are_drawn():
    bar = tc.Structure([[0, 1], [0, 0], [0, 0]], [[0, 1]], np.zeros((0, 2)), 2.0)
    net = tc.net(3, 3, 0.5, node_mass=0.1, fixed=None)
    for structure in (bar, net):
        drawing = tc.plot.structure(structure)
        drawing.ax.figure.canvas.draw()
        assert len(drawing.bars.get_segments()) == len(structure.bars)
        plt.close(drawing.ax.figure)


def test_fixed_nodes_stand_on_triangles():
    prism = tc.prism()
    standing = tc.Structure(prism.nodes, prism.bars, prism.strings, 1.0, fixed=[3, 4])
    drawing = tc.plot.structure(standing)
    triangles = [line for line in drawing.ax.lines if line.get_marker() == "^"]
    assert len(triangles) == 1
    np.testing.assert_array_equal(np.array(triangles[0].get_data_3d()), prism.nodes[:, [3, 4]])
    free = tc.plot.structure(prism)
    assert all(line.get_marker() != "^" for line in free.ax.lines)
    plt.close("all")


def test_marks_of_supports_move_with_them(prism):
    standing = replace(prism, fixed=[3, 4, 5])
    drawing = tc.plot.structure(standing)
    drawing.update(standing.nodes + 0.1)
    np.testing.assert_allclose(drawing.supports.get_data_3d(), standing.nodes[:, 3:] + 0.1)
    assert tc.plot.structure(prism).supports is None
    plt.close("all")
