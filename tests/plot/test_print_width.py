"""Figures in the width of a column, with their fonts; legends that are not repeated."""

import re

import numpy as np
import pytest
from matplotlib import pyplot as plt, rcParams
from matplotlib.text import Text

import tenscontrol as tc


@pytest.fixture(scope="module")
def run():
    ball = tc.library.six_bar_ball()
    model = tc.Model(ball, strings=tc.LinearStrings(stiffness=1000.0))
    rest = tc.prestress(ball, force_density=10.0)
    lengths = np.array(tc.to_rest_length(model, rest).rest_length)
    lengths[3] *= 0.99
    return tc.simulate(model, 0.05, rest_length=lengths, step=1e-3)


@pytest.mark.parametrize(("width", "wide"), [("page", 183.0)])
def test_a_pdf_has_the_width_and_its_fonts(run, tmp_path, width, wide):
    before = rcParams["pdf.fonttype"]
    for name, figure in (
        ("run", tc.plot.trajectory(run)["coordinates"].ax.figure),
        ("shape", tc.plot.structure(run).ax.figure),
    ):
        sizes = [text.get_fontsize() for text in figure.findobj(Text)]
        data = tc.plot.save_figure(figure, tmp_path / f"{name}.pdf", width=width).read_bytes()
        box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", data)
        assert float(box[1]) * 25.4 / 72 == pytest.approx(wide)
        assert b"/FontFile2" in data
        assert b"/Type3" not in data
        assert min(text.get_fontsize() for text in figure.findobj(Text)) >= 0.69 * min(sizes)
    assert rcParams["pdf.fonttype"] == before


@pytest.mark.parametrize("width", ["colum", 0.0, "89", [89]])
def test_other_widths_are_refused(tmp_path, width):
    figure = tc.plot.structure(tc.prism()).ax.figure
    with pytest.raises((TypeError, ValueError), match=r"^width is "):
        tc.plot.save_figure(figure, tmp_path / "a.pdf", width=width)
    plt.close(figure)


def test_strings_of_one_group_are_told_apart_and_named_once(run):
    panels = tc.plot.trajectory(run)
    lines = panels["force_density"].lines
    assert list(lines) == list(panels["rest_length"].lines)
    assert "string 3" in lines
    assert len(lines["other 20 of 24 strings"]) == 20
    assert len({line.get_color() for (line,) in list(lines.values())[:4]}) == 4
    legends = [panel.ax.get_legend() is not None for panel in panels.values()]
    assert legends == [True, True, False]
    plt.close(panels["coordinates"].ax.figure)


def test_the_poles_of_a_damped_plant_fill_their_axes():
    poles = np.array([-5 + 70j, -5 - 70j, -0.1 + 10j, -0.1 - 10j])
    drawn = tc.plot.poles(poles)
    left, right = drawn.ax.get_xlim()
    assert right - left < 1.5 * 5
    plt.close(drawn.ax.figure)
