"""What the README shows runs, and its commands exist."""

import re
import webbrowser
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from tests.code_blocks import blocks
from tests.pictures import rolling_ball

DOCS = Path(__file__).parent.parent / "docs"
README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


def test_the_session_bends_the_tower(monkeypatch):
    pytest.importorskip("plotly", reason="the session says how to install it")
    (session,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda *page, **_: opened.append(page))
    names: dict = {}
    exec(session, names)
    plt.close("all")
    run, tower = names["run"], names["tower"]
    moved = run.nodes[:, 9:, -1] - tower.nodes[:, 9:]
    np.testing.assert_allclose(moved, np.tile([[0.4], [0.0], [-0.1]], 3), atol=5e-3)
    assert run.control.status_count == {"ok": 150}
    assert run.force_density.min() > 0
    assert len(opened) == 1
    assert [block.code.strip() for block in blocks("index")] == [session.strip()]
    assert len([line for line in session.splitlines() if line]) == 12


@pytest.mark.parametrize("page", ["README.md", "docs/benchmarks.rst"])
def test_commands_of_the_tables_are_there(page):
    text = DOCS.parent.joinpath(page).read_text(encoding="utf-8")
    commands = re.findall(r"`python -m ([\w.]+)", text)
    commands += [each.replace("/", ".")[:-3] for each in re.findall(r"`p\w+ (\w+/\S+\.py)`", text)]
    assert len(commands) > 4
    for command in commands:
        place = DOCS.parent.joinpath(*command.split("."))
        assert place.with_suffix(".py").exists() or (place / "__main__.py").exists()


def test_pages_that_it_links_are_there():
    links = re.findall(r"\]\(([^)#:]+)\)", README)
    assert len(links) > 15
    assert [link for link in links if not DOCS.parent.joinpath(link).exists()] == []


def test_the_figures_of_the_readme_are_among_the_benchmarks():
    """Each number of the six, with the command that prints it."""
    page = DOCS.joinpath("benchmarks.rst").read_text(encoding="utf-8")
    section = README.partition("## Six figures")[2].partition("## ")[0]
    rows = [line.split("|")[2:4] for line in section.splitlines() if line.startswith("| ")][1:]
    assert len(rows) == 6
    for figure, command in rows:
        assert command.strip(" `") in page
        for number in re.findall(r"\d+\.?\d*", figure.replace("0.04 %", "1.0004")):
            assert re.search(rf"\b{re.escape(number)}\b", page), number


def test_a_moving_picture_of_a_part_of_a_second(tmp_path):
    assert rolling_ball(tmp_path / "ball.gif", duration=0.2) == 3
    assert (tmp_path / "ball.gif").read_bytes()[:4] == b"GIF8"
    assert (DOCS / "images" / "rolling_ball.gif").stat().st_size < 1.5e6


def test_set_up_is_two_commands_and_the_figure_is_there():
    (first, second, *_) = re.findall(r"```sh\n(.*?)\n```", README, flags=re.DOTALL)
    assert first.endswith("tenscontrol demo")
    assert second.endswith("python -m pytest -n auto --dist loadfile")
    assert "\n" not in first + second
    (figure,) = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert Path(__file__).parent.parent.joinpath(figure).exists()
