"""Poles in the complex plane."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb

import tenscontrol as tc


def drawn_at(line):
    return line.get_xdata() + 1j * np.asarray(line.get_ydata())


def test_poles_are_drawn_where_they_are():
    poles = np.array([-1 + 2j, -1 - 2j, 0.5])
    drawn = tc.plot.poles(poles)
    assert set(drawn_at(drawn.markers["poles"])) == set(poles)
    assert drawn.multiplicities["poles"] == ()


def test_axes_have_units():
    ax = tc.plot.poles([-1.0]).ax
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("Re s, 1/s", "Im s, 1/s")


def test_equal_poles_are_drawn_once_with_their_number(plant):
    drawn = tc.plot.poles(np.linalg.eigvals(plant.A))
    markers = drawn_at(drawn.markers["poles"])
    # 0 six times, then ±14.28j twice, ±14.68j once, ±15.35j three times.
    assert len(markers) == 7
    numbers = {
        round(float(text.xy[1]), 1): text.get_text() for text in drawn.multiplicities["poles"]
    }
    assert numbers == {
        15.4: "×3", 14.3: "×2", 0.0: "×6", -14.3: "×2", -15.4: "×3"
    }  # fmt: skip


def test_numbers_of_near_poles_do_not_cover_one_another(plant):
    poles = np.linalg.eigvals(plant.A)
    drawn = tc.plot.poles({"a": poles, "b": 1.02 * poles})
    drawn.ax.figure.canvas.draw()
    boxes = [text.get_window_extent() for texts in drawn.multiplicities.values() for text in texts]
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:i])


def test_sets_differ_in_marker_and_colour_and_are_named():
    drawn = tc.plot.poles({"open loop": [-1.0], "closed loop": [-2.0], "estimator": [-9.0]})
    markers = [line.get_marker() for line in drawn.markers.values()]
    colors = [to_rgb(line.get_color()) for line in drawn.markers.values()]
    assert len(set(markers)) == len(set(colors)) == 3
    texts = [text.get_text() for text in drawn.ax.get_legend().get_texts()]
    assert sorted(texts) == ["closed loop", "estimator", "open loop", "stable"]


@pytest.mark.parametrize("poles", [[-3.0, -1.0], [2.0, 5.0], [5j, -5j], [0.0]])
def test_both_axes_and_the_stable_half_are_in_view(poles):
    ax = tc.plot.poles(poles).ax
    for low, high in (ax.get_xlim(), ax.get_ylim()):
        assert low < 0 < high
    (shade,) = ax.patches
    box = shade.get_extents().transformed(ax.transData.inverted())
    assert box.x0 < ax.get_xlim()[0]
    assert np.isclose(box.x1, 0)


def test_second_map_in_the_same_axes_holds_both(flat):
    tc.plot.poles({"far": [-100.0]}, ax=flat)
    tc.plot.poles({"near": [-1.0]}, ax=flat)
    assert flat.get_xlim()[0] < -100
    texts = [text.get_text() for text in flat.get_legend().get_texts()]
    assert sorted(texts) == ["far", "near", "stable"]


@pytest.mark.parametrize(
    ("poles", "error", "message"),
    [
        ([], ValueError, r"poles has shape \(0,\), expected \(k,\)"),
        ({}, ValueError, "poles has no sets"),
        ({"a": [[1.0]]}, ValueError, r"poles\['a'\] has shape \(1, 1\)"),
        ([1.0, np.nan], ValueError, r"poles\[1\] is \(nan\+0j\), expected a finite number"),
        ([10**400], TypeError, "poles must be an array of complex numbers"),
        ([1e200j], ValueError, r"poles\[[0-9]+\] is 1e\+200, expected at most"),
        (
            "abc",
            TypeError,
            r"poles must be an array of complex numbers, as tc\.modes\(plant\)\.pole",
        ),
    ],
)
def test_wrong_poles_are_named(poles, error, message):
    with pytest.raises(error, match=message):
        tc.plot.poles(poles)


def test_space_axes_are_refused(space):
    with pytest.raises(TypeError, match="ax is three-dimensional, expected flat"):
        tc.plot.poles([1.0], ax=space)


def test_poles_beyond_double_precision_are_refused():
    with pytest.raises(ValueError, match=r"poles\[1\] is .*inf.*, expected a finite number"):
        tc.plot.poles(np.array([-1.0, np.longdouble("1e4000")]))
