"""Drawings in the plane, and marks: joints, pulleys, point masses and rollers."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image

import tenscontrol as tc
from tenscontrol.plot.structure_drawing import marked_nodes


@pytest.fixture(scope="module")
def planar():
    """An arm with a string over a node, a payload at its tip, and rollers."""
    arm = tc.library.arm(sections=2)
    mass = np.zeros(6)
    mass[5] = 2.0
    return tc.Structure(
        arm.nodes, arm.bars, [(0, 2), (1, 3, 5), (2, 4, 5, 3, 2)], 1.0, point_mass=mass,
        fixed=[0, (1, "x"), (4, "y")],
    )  # fmt: skip


@pytest.fixture(scope="module")
def planar_run(free_run):
    """A D-bar on rails that is stretched, as a record of a motion."""
    rails = replace(tc.library.d_bar(), fixed=[0, (2, "y")])
    time = np.linspace(0.0, 0.1, 11)
    spread = 1 + time
    corners = rails.nodes - rails.nodes[:, :1]
    nodes = np.stack([rails.nodes[0, 0] + corners[0][:, None] * spread,
                      corners[1][:, None] * np.sqrt(2 - spread**2)])  # fmt: skip
    still = np.zeros((2, len(time)))
    run = replace(
        free_run, structure=rails, time=time, nodes=nodes, velocities=np.zeros_like(nodes),
        released_energy=still[0], error=still[0],
    )  # fmt: skip
    # What a run evaluates when it is read.
    vars(run).update(
        force_density=np.outer([6.0, 3.0], np.ones(11)), kinetic_energy=still[0],
        potential_energy=still[0], _momenta=[still, still[:1]], bar_length_error=np.zeros((4, 11)),
    )  # fmt: skip
    return run


def lines(collection):
    return [np.asarray(each) for each in collection.get_segments()]


def test_marks_are_at_their_nodes(planar):
    marks = {name: nodes.tolist() for name, nodes in marked_nodes(planar).items()}
    assert marks == {
        "joint": [2, 3], "pulley": [2, 3, 4, 5], "point mass": [5], "roller x": [1],
        "roller y": [4],
    }  # fmt: skip
    assert marked_nodes(tc.prism()) == {}
    drawing = tc.plot.structure(planar)
    for name, points, nodes in drawing.marks:
        assert nodes.tolist() == marks[name]
        np.testing.assert_array_equal(points.get_data(), planar.nodes[:, nodes])


def test_planar_structures_are_drawn_in_flat_axes_of_one_scale(planar):
    drawing = tc.plot.structure(planar, labels=True)
    ax = drawing.ax
    ax.figure.canvas.draw()
    assert ax.name == "rectilinear"
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_aspect()) == ("x, m", "y, m", 1.0)
    for (low, high), row in zip((ax.get_xlim(), ax.get_ylim()), planar.nodes, strict=True):
        assert low < row.min() < row.max() < high
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == ["bar", "string", "joint", "pulley", "point mass", "roller"]
    np.testing.assert_array_equal(lines(drawing.bars)[0], planar.nodes.T[planar.bars[0]])


def test_a_cluster_is_one_line_along_its_path(planar):
    drawing = tc.plot.structure(planar, force_density=[1.0, 2.0, 0.0], member_labels=True)
    assert len(lines(drawing.strings)) == 3
    for line, path in zip(lines(drawing.strings), planar.paths, strict=True):
        np.testing.assert_array_equal(line[: len(path)], planar.nodes.T[list(path)])
        assert (line[len(path) :] == line[-1]).all()  # shorter ones stay at their end
    assert len(drawing.string_labels) == 3
    places = [text.get_position() for text in drawing.string_labels]
    np.testing.assert_allclose(places[1], planar.nodes[:, [1, 3]].mean(axis=1))
    dotted = [pattern is not None for _, pattern in drawing.strings.get_linestyle()]
    assert dotted == [False, False, True]


def test_update_moves_the_marks(planar):
    drawing = tc.plot.structure(planar, labels=True)
    moved = planar.nodes + np.array([[0.3], [0.1]])
    drawing.update(moved, [1.0, 0.0, 1.0])
    np.testing.assert_array_equal(drawing.nodes.get_data(), moved)
    for _, points, nodes in drawing.marks:
        np.testing.assert_array_equal(points.get_data(), moved[:, nodes])
    np.testing.assert_array_equal(lines(drawing.strings)[1][:3], moved.T[[1, 3, 5]])


def test_axes_of_the_other_kind_are_refused(planar, prism, flat, space):
    with pytest.raises(TypeError, match="ax is three-dimensional, expected flat"):
        tc.plot.structure(planar, ax=space)
    with pytest.raises(TypeError, match="ax is flat, expected three-dimensional"):
        tc.plot.structure(prism, ax=flat)
    with pytest.raises(ValueError, match=r"nodes has shape \(3, 6\), expected \(2, 6\)"):
        tc.plot.structure(planar, np.zeros((3, 6)))


def test_two_planar_shapes_share_axes(planar, flat):
    tc.plot.structure(planar, planar.nodes + 5.0, ax=flat, faint=True)
    tc.plot.structure(planar, ax=flat)
    assert flat.get_xlim()[0] < 0 < 7 < flat.get_xlim()[1]


def test_marks_in_space_are_drawn_and_move():
    spine = tc.library.spine(2)
    mass = np.zeros(10)
    mass[5] = 1.0
    rolling = replace(spine, fixed=[0, 1, 2, 3, 4, (5, "x"), (5, "y")], point_mass=mass)
    drawing = tc.plot.structure(rolling)
    drawing.ax.figure.canvas.draw()
    assert {name for name, _, _ in drawing.marks} == {
        "joint", "point mass", "roller x", "roller y"
    }  # fmt: skip
    drawing.update(rolling.nodes + 0.1)
    for _, points, nodes in drawing.marks:
        np.testing.assert_array_equal(points.get_data_3d(), rolling.nodes[:, nodes] + 0.1)


def test_every_structure_of_the_library_is_drawn():
    for name in tc.library.__all__:
        if name in ("net", "prism_tower"):
            continue
        drawing = tc.plot.structure(getattr(tc.library, name)(), legend=False)
        drawing.ax.figure.canvas.draw()
        plt.close(drawing.ax.figure)


def test_a_planar_motion_has_histories_and_an_animation(planar_run, tmp_path):
    panels = tc.plot.trajectory(planar_run, nodes=[1, 2], relative_to="origin")
    assert list(panels["coordinates"].lines) == ["x[1]", "y[1]", "x[2]", "y[2]"]
    with pytest.raises(ValueError, match="directions is 'z', expected letters out of 'xy'"):
        tc.plot.trajectory(planar_run, directions="z")
    health = tc.plot.health(planar_run)
    assert list(health) == ["error", "energy", "momentum", "bar_length_error"]
    rails = planar_run.structure
    path = tc.plot.animate(planar_run, tmp_path / "run.gif", fps=20, target=rails.nodes, dpi=50)
    with Image.open(path) as gif:
        assert gif.n_frames == 2
        first, last = [], []
        for i, pictures in ((0, first), (1, last)):
            gif.seek(i)
            pictures.append(np.asarray(gif.convert("L")))
    assert (first[0] != last[0]).any()


def test_the_title_of_a_deflection_is_above_the_legend_and_round_off_is_not_magnified():
    mass = np.zeros(6)
    mass[5] = 2.0
    arm = replace(tc.library.arm(), point_mass=mass)
    model = tc.Model(arm, strings=tc.LinearStrings(stiffness=500.0))
    rest = tc.prestress(arm, min_force_density=50.0)
    on_support, on_tip = np.zeros((2, 2, 6))
    on_support[0, 0], on_tip[0, 5] = 1.0, 1.0
    found = tc.deflections(model, rest, [on_support, on_tip])
    still, bent = (tc.plot.deflections(found, load).ax for load in (0, 1))
    assert still.get_title() == "load 0, displacements × 1"
    bent.figure.canvas.draw()
    title, legend = bent.title.get_window_extent(), bent.get_legend().get_window_extent()
    assert title.y0 > legend.y1
    assert title.y1 < bent.figure.bbox.y1
    label = bent.yaxis.label.get_window_extent()
    assert label.x0 > 0  # not cut
    plt.close("all")
