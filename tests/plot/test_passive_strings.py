"""Driven and passive strings, told apart in figures and views."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.plot.style import DOTTED, PASSIVE_DASHES
from tests.plant.test_command_parents import massive_plant

WINCHES = {"lid": [0, 1, 2], "side": {6: 1.0, 7: -0.5}}
PASSIVE = [3, 4, 5, 8]


@pytest.fixture(scope="module")
def plant(prism, rest):
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0, damping=0.5))
    return tc.linearize(model, rest, input="rest_length", actuated=WINCHES)


@pytest.fixture(scope="module")
def run(plant):
    law = tc.LQR(plant, sample_time=0.02)
    start = plant.to_nodes(0.01 * np.ones(9))
    return tc.simulate(
        plant.model, 0.1, start, controller=law, rest_length=plant.rest_length, step=2e-3
    )


def dashed(lines):
    """Which lines have the dashes of passive strings; they are scaled by the width."""
    share = PASSIVE_DASHES[1][0] / PASSIVE_DASHES[1][1]
    marks = [dashes for _, dashes in lines.get_linestyle()]
    return [i for i, on in enumerate(marks) if on is not None and np.isclose(on[0] / on[1], share)]


def texts(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


@pytest.mark.parametrize("drawn", ["plant", "run", "structure"])
def test_passive_strings_are_dashed(request, drawn, prism):
    if drawn == "structure":
        drawing = tc.plot.structure(prism, actuated=["top", 6, 7])
    else:
        drawing = tc.plot.structure(request.getfixturevalue(drawn))
    assert dashed(drawing.strings) == PASSIVE
    assert {"driven string", "passive string"} <= set(texts(drawing.ax))
    assert drawing.passive.nonzero()[0].tolist() == PASSIVE
    width = np.array(drawing.strings.get_linewidth())
    assert width[PASSIVE].max() < width[[0, 1, 2, 6, 7]].min()  # in grey print too


def test_slack_strings_are_dotted_whether_driven_or_not(plant):
    drawing = tc.plot.structure(plant)
    gamma = np.where(np.isin(np.arange(9), [0, 3]), 0.0, 10.0)
    drawing.update(plant.nodes, gamma)
    assert dashed(drawing.strings) == [4, 5, 8]
    dots = [on for _, on in drawing.strings.get_linestyle()]
    assert dots[0][0] / dots[0][1] == pytest.approx(DOTTED[1][0] / DOTTED[1][1])


def test_strings_that_are_all_driven_look_as_ever(plant, prism):
    whole = tc.linearize(plant.model, tc.prestress(prism, 17.3205), input="rest_length")
    drawing = tc.plot.structure(whole)
    assert drawing.passive is None
    assert "string" in texts(drawing.ax)


def test_segments_of_a_passive_string_are_passive():
    plant = tc.plant.command_parents(massive_plant("rest_length"), actuated=["vertical"])
    drawing = tc.plot.structure(plant)
    parents = plant.model.structure.string_parent
    assert (drawing.passive == (parents < 6)).all()


def test_mode_shapes_show_them(plant):
    (shape,) = tc.plot.mode_shapes(plant, tc.modes(plant), which=[3])
    assert dashed(shape.displaced.strings) == PASSIVE
    assert dashed(shape.reference.strings) == []


def test_histories_tell_them_apart(run):
    panels = tc.plot.trajectory(run)
    names = ["top, driven", "bottom, passive", "vertical, driven", "vertical, passive"]
    assert list(panels["rest_length"].lines) == list(panels["force_density"].lines) == names
    assert [len(lines) for lines in panels["rest_length"].lines.values()] == [3, 3, 2, 1]
    assert np.ptp(panels["rest_length"].lines["vertical, passive"][0].get_ydata()) == 0
    plt.close("all")


def test_motors_are_those_of_driven_strings(rest, plant):
    driven = tc.linearize(plant.model, rest, input="rest_length", actuated=[8, 0, 1])
    winches = tc.Winches(ramp=True, motor=tc.Motor(drum_radius=0.01, gear_ratio=20.0))
    law = tc.LQR(driven, sample_time=0.02)
    run = tc.simulate(
        plant.model, 0.06, driven.to_nodes(0.01 * np.ones(9)), controller=law, winches=winches,
        rest_length=driven.rest_length, step=2e-3,
    )  # fmt: skip
    lines = tc.plot.motors(run)["angle"].lines
    assert {name: len(rows) for name, rows in lines.items()} == {"vertical": 1, "top": 2}
    np.testing.assert_array_equal(lines["vertical"][0].get_ydata(), run.control.motors.angle[0])


def test_a_saved_run_knows_what_was_driven(run, tmp_path):
    again = tc.load_run(run.save(tmp_path / "run.npz"))
    for name in ("input", "ratio", "offset", "lead"):
        kept, first = (getattr(each.control.actuation, name) for each in (again, run))
        np.testing.assert_array_equal(kept, first)
    assert again.control.actuation.names == ("lid", "side")
    assert dashed(tc.plot.structure(again).strings) == PASSIVE


def test_a_page_has_them_as_a_trace_of_their_own(plant, run, prism):
    for shown in (plant, run):
        data = tc.plot.view(shown).figure()["data"]
        named = {trace["name"]: trace for trace in data}
        assert named["passive strings"]["line"]["dash"] == "dash"
        ends = [
            sum(x is not None for x in named[name]["x"]) // 2
            for name in ("driven strings", "passive strings")
        ]
        assert ends == [5, 4]
        assert "strings" not in named
    assert tc.plot.view(prism).figure()["data"][0]["name"] == "strings"
