"""The first hour of a user: the pages from coordinates to MuJoCo, run in order as written."""

import numpy as np
import pytest

from tests.code_blocks import PAGES as DOCUMENTS, blocks, run

PAGES = ["first_structure", "modes", "lqr", "first_hour"]
LIBRARIES = {"Turn it and play it": "plotly", "Run it in MuJoCo": "mujoco"}


@pytest.fixture(scope="module")
def hour():
    """What each section defines and warns of, up to the sections that need a library or a file."""
    names, warned = {}, []
    for page in PAGES:
        for block in blocks(page):
            if block.language == "python" and (page != "first_hour" or "limits" in block.section):
                warned += [(page, block.section, message) for message in run(block, names)]
    return names, warned


def follow(hour, section):
    """Run a section of the last page."""
    if section in LIBRARIES:
        pytest.importorskip(LIBRARIES[section], reason="the page says how to install it")
    found = [block for block in blocks("first_hour") if block.section == section]
    names = dict(hour[0])
    assert found
    assert [run(block, names) for block in found] == [[]] * len(found)
    return names


def test_an_own_ball_is_controlled(hour):
    names, _ = hour
    away = np.linalg.norm(names["run"].nodes - names["ball"].nodes[:, :, None], axis=0).max(axis=0)
    assert away.max() > 0.01
    assert away[-1] < 1e-3
    assert np.abs(names["run"].control.winch_rate).max() <= 0.3 + 1e-9
    assert names["run"].force_density.min() > 0


def test_the_only_warning_is_that_of_the_page(hour):
    told = "no string reaches 1 mode of the plant, at 3.676 Hz (mechanism)"
    places = [("lqr", "Design"), ("first_hour", "Predict within limits")]
    assert [(*place, message[: len(told)]) for *place, message in hour[1]] == [
        (*place, told) for place in places
    ]


def test_it_is_viewed(hour, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    follow(hour, "Turn it and play it")
    assert "<html" in (tmp_path / "ball.html").read_text(encoding="utf-8")


def test_it_is_saved_and_loaded(hour, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    again = follow(hour, "Save and load")["again"]
    assert again.control.status_count == hour[0]["run"].control.status_count


def test_it_runs_in_mujoco(hour):
    names = follow(hour, "Run it in MuJoCo")
    moved = np.abs(names["ours"] - names["ball"].nodes).max()
    assert moved > 5e-3  # so that agreement within 0.1 mm says something


def test_the_pages_are_linked_in_this_order():
    for page, following in zip(["install", *PAGES[:-1]], PAGES, strict=True):
        text = DOCUMENTS[page].read_text(encoding="utf-8")
        assert f"Next: :doc:`{following}`" in text
