"""Pages and notebook figures of views: what they hold, how large they are, what they refuse."""

import base64
import json
import pickle
import re
import sys

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.plot.web_page import View


def held(page):
    """What the script of a page is given."""
    text = re.search(r'<script type="application/json" id="spec">(.*?)</script>', page, re.S)[1]
    return json.loads(text)


def numbers(text, *shape):
    return np.frombuffer(base64.b64decode(text), dtype="<f4").reshape(shape)


def moving(structure, count, end=1.0):
    """A view of a structure that is lifted, with a γ that grows to 1."""
    time = np.linspace(0.0, end, count)
    nodes = np.repeat(structure.nodes[:, :, None], count, axis=2)
    nodes[-1] += time
    gamma = np.outer(np.ones(len(structure.strings)), time / end)
    return View("run", structure, nodes, time, gamma)


@pytest.fixture(scope="module")
def ball():
    return tc.library.six_bar_ball()


def test_a_page_holds_the_motion_and_needs_nothing_from_elsewhere(ball):
    view = moving(ball, 11)
    page = view.html()
    spec = held(page)
    np.testing.assert_allclose(
        numbers(spec["nodes"], 11, 12, 3), view.nodes.transpose(2, 1, 0), atol=1e-6
    )
    np.testing.assert_allclose(numbers(spec["gamma"], 11, 24), view.force_density.T, atol=1e-6)
    assert spec["time"] == view.time.tolist()
    own = re.sub(r"<script>/\*\*?\s*\* plotly\.js.*?</script>", "", page, count=1, flags=re.S)
    assert len(own) < 100_000 < len(page)
    assert not re.search(r"(src|href)\s*=|https?://|@import|url\(", own)
    assert page.count("<title>run: 12 nodes, 6 bars, 24 strings</title>") == 1


def test_the_scale_of_colours_ends_at_the_largest_value(ball):
    view = moving(ball, 5)
    colors = held(view.html())["colors"]
    assert colors["force density γ, N/m"] == 1.0
    np.testing.assert_allclose(colors["tension, N"], ball.string_length().max())


def test_the_tension_of_a_clustered_string_is_that_of_its_whole_length():
    line = tc.Structure(
        [[0, 1, 2, 0], [0, 0, 0, 1], [0, 0, 0, 0]],
        bars=[[0, 3]],
        strings=[[0, 1, 2]],
        bar_mass=1.0,
        string_node_mass=1.0,
    )
    gamma = np.array([3.0])
    found = held(tc.plot.view(line, force_density=gamma).html())
    np.testing.assert_allclose(found["colors"]["tension, N"], 6.0)
    assert found["segmentString"] == [0, 0]


def test_a_long_run_is_thinned_out_to_600_states_with_both_ends(ball):
    spec = held(moving(ball, 5001, end=10.0).html())
    assert len(spec["time"]) == 600
    assert (spec["time"][0], spec["time"][-1]) == (0.0, 10.0)
    assert np.ptp(np.diff(spec["time"])) < 5e-3
    assert len(spec["nodes"]) == 4 * 600 * 36 * 4 // 3


def test_a_page_of_a_large_structure_holds_3_million_numbers():
    tower = tc.prism_tower(stages=290)
    assert len(tower.bars) + len(tower.strings) > 6_900
    view = moving(tower, 700)
    spec = held(view.html())
    kept = len(spec["time"])
    each = tower.nodes.size + len(tower.strings)
    assert 2.9e6 < kept * each <= 3e6
    assert len(spec["figure"]["data"]) == 6  # a trace for each kind, not for each member


def test_text_of_the_user_stays_text(ball):
    name = "</script><b>@SCRIPT@ & co"
    page = View(name, ball, ball.nodes[:, :, None], labels=(name,)).html()
    assert "<title>&lt;/script&gt;&lt;b&gt;@SCRIPT@ &amp; co: 12 nodes" in page
    assert held(page)["labels"] == [name]


def test_a_notebook_gets_data_alone(ball):
    bundle = ball._repr_mimebundle_()
    assert bundle["text/plain"] == repr(ball)
    figure = bundle["application/vnd.plotly.v1+json"]
    assert len(json.dumps(figure, allow_nan=False)) < 10_000
    assert [trace["name"] for trace in figure["data"]][:4] == [
        "strings",
        "slack strings",
        "bars",
        "nodes",
    ]
    import plotly.graph_objects as go

    go.Figure(figure)  # refuses what plotly does not know


def test_a_notebook_plays_a_run_of_at_most_60_states(ball):
    view = moving(ball, 501)
    figure = view.figure()
    frames = figure["frames"]
    assert len(frames) == 60
    assert len(json.dumps(figure, allow_nan=False)) < 1_000_000
    last = frames[-1]["data"][frames[-1]["traces"].index(3)]
    np.testing.assert_allclose([last["x"], last["y"], last["z"]], view.nodes[..., -1], atol=1e-5)
    assert figure["layout"]["sliders"][0]["steps"][-1]["label"] == "1"
    import plotly.graph_objects as go

    go.Figure(figure)
    large = moving(tc.prism_tower(stages=290), 100).figure()
    assert len(large["frames"]) == 2


def test_a_notebook_chooses_among_modes():
    bar = tc.library.d_bar_3d()
    modes = tc.modes(tc.linearize(tc.Model(bar), tc.prestress(bar, 20.0), coordinates="minimal"))
    figure = modes._repr_mimebundle_()["application/vnd.plotly.v1+json"]
    assert len(figure["frames"]) == len(modes)
    size = np.ptp(bar.nodes, axis=1).max()
    for frame in figure["frames"]:
        dots = frame["data"][3]
        moved = np.array([dots["x"], dots["y"], dots["z"]]) - bar.nodes
        np.testing.assert_allclose(np.linalg.norm(moved, axis=0).max(), 0.1 * size, rtol=1e-4)


def test_damped_modes_are_turned_to_the_phase_of_their_largest_real_part():
    tower = tc.library.class2_tower(stages=2)
    model = tc.Model(tower, strings=tc.LinearStrings(stiffness=1e3, damping=5.0))
    rest = tc.prestress(tower, min_force_density=20.0)
    modes = tc.modes(tc.linearize(model, rest, input="rest_length"))
    assert np.iscomplexobj(modes.shape)
    spec = held(tc.plot.view(modes).html())
    shape = (len(modes), tower.nodes.shape[1], 3)
    real, imaginary = (numbers(spec[part], *shape) for part in ("real", "imaginary"))
    np.testing.assert_allclose(np.linalg.norm(real, axis=2).max(axis=1), 1.0, rtol=1e-5)
    assert (np.linalg.norm(imaginary, axis=(1, 2)) < np.linalg.norm(real, axis=(1, 2)) + 1e-6).all()
    assert np.abs(imaginary).max() > 1e-3


def test_a_page_of_many_modes_holds_the_first_of_them(ball, monkeypatch):
    monkeypatch.setattr("tenscontrol.plot.web_page._MOST_NUMBERS", 3 * 2 * 36)
    modes = tc.modes(tc.linearize(tc.Model(ball), tc.prestress(ball, 20.0)))
    spec = held(tc.plot.view(modes).html())
    assert len(modes) > 3
    assert spec["labels"] == list(tc.plot.view(modes).labels[:3])
    np.testing.assert_allclose(
        np.abs(numbers(spec["real"], 3, 12, 3)),
        np.abs(modes.shape[..., :3].transpose(2, 1, 0)),
        atol=1e-6,
    )


def test_a_motion_that_is_not_finite_is_refused(ball):
    nodes = ball.nodes[:, :, None].copy()
    nodes[0, 3, 0] = np.nan
    with pytest.raises(ValueError, match=r"nodes\[0, 3, 0\] is nan"):
        View("run", ball, nodes)


def test_modes_know_their_structure_and_place(ball):
    plant = tc.linearize(tc.Model(ball), tc.prestress(ball, 20.0))
    few = tc.modes(plant, 3)
    assert few.structure is ball
    np.testing.assert_array_equal(few.nodes, plant.nodes)
    assert len(tc.plot.view(pickle.loads(pickle.dumps(few))).labels) == 3


def test_without_plotly_the_error_names_the_extra(ball, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(ImportError, match=r"pip install 'tenscontrol\[view\]'"):
        ball.to_html(tmp_path / "ball.html")
    assert not list(tmp_path.iterdir())
    assert ball._repr_mimebundle_()["text/plain"] == repr(ball)


@pytest.mark.parametrize("path", ["ball.png", "ball"])
def test_a_page_ends_in_html(ball, path):
    with pytest.raises(ValueError, match=r"path is '.*', expected a name ending in \.html"):
        ball.to_html(path)


def test_nothing_is_loaded_before_a_page_is_written(monkeypatch):
    loaded = [name for name in sys.modules if name.startswith("plotly.")]
    for name in ("plotly", "plotly.offline", *loaded):
        monkeypatch.setitem(sys.modules, name, None)  # whoever imports it fails
    view = tc.plot.view(tc.prism())
    view.figure()
    with pytest.raises(ImportError, match="plotly"):
        view.html()


def test_open_shows_the_page_in_the_browser(ball, monkeypatch):
    shown = []
    monkeypatch.setattr("webbrowser.open", shown.append)
    path = tc.plot.view(ball).open()
    assert shown == [path.as_uri()]
    assert path.read_text("utf-8").startswith("<!DOCTYPE html>")
