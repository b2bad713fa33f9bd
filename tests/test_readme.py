"""What the README shows runs, and its commands exist."""

import re
import textwrap
import webbrowser
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from tenscontrol.control import ControlWarning
from tenscontrol.dynamics.machine_code import compiler
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


def ran(page, count):
    """Run the code of a page, so many blocks, one after the other; return all names."""
    text = (DOCS / f"{page}.rst").read_text(encoding="utf-8")
    blocks = re.findall(r".. code-block:: python\n\n((?:   .*\n|\n)+)", text)
    assert len(blocks) == count
    names: dict = {}
    exec(textwrap.dedent("".join(blocks)), names)
    plt.close("all")
    return names


def test_the_way_from_a_shape_to_winch_commands_runs(capsys, monkeypatch):
    monkeypatch.syspath_prepend(DOCS.parent / "examples")  # the study is a file to copy
    with pytest.warns(RuntimeWarning, match=r"no string reaches 1 mode of .*at 2\.013 Hz"):
        names = ran("control", 11)
    limits = [names["report"].limit("MPC", held) for held in ("force_density", "rest_length")]
    assert limits == [1e2, 1e4]
    assert "winch 6 stuck from 0.3 s to 0.5 s" in capsys.readouterr().out
    assert names["jump"].nodes[1].min(axis=0)[300:].max() > 0.1
    run = names["run"]
    assert np.abs(run.control.winch_rate).max() < 0.15 + 1e-9
    assert set(run.control.status) == {"ok"}
    heights = run.nodes[2, :3].mean(axis=0) - run.nodes[2, 3:].mean(axis=0)
    assert heights[0] == pytest.approx(1.0)
    assert heights[-1] == pytest.approx(0.85, abs=5e-3)


def test_the_page_on_ground_runs():
    names = ran("ground", 5)
    run = names["run"]
    assert -0.95 < run.nodes[2].min() < -0.9  # it has landed, and not sunk
    assert names["bounced"].nodes[0].max() < 1.05  # in front of the wall
    assert -0.96 < names["landed"].nodes[2].min() < -0.9
    assert names["stance"].contacts.normal_force.sum() == pytest.approx(6 * 9.81, rel=1e-9)
    held = names["held"]
    assert np.abs(held.velocities[:, :, -1]).max() < 0.2 * np.abs(held.velocities[:, :, 0]).max()


def test_the_page_on_own_controllers_runs():
    run = ran("own_controllers", 2)["run"]
    assert run.control.controller.startswith("FunctionController(policy, input 'force_density'")
    assert run.control.status_count == {"ok": 25}


def test_the_page_on_files_runs(tmp_path, monkeypatch):
    pytest.importorskip("xarray", reason="the extra tenscontrol[xarray] is not installed")
    monkeypatch.chdir(tmp_path)
    names = ran("files", 3)
    assert names["more"].time[0] == names["run"].time[-1] == 0.2
    assert {path.name for path in tmp_path.iterdir()} == {"ball.toml", "run.npz", "run.csv"}


def test_the_page_on_estimation_runs():
    names = ran("estimation", 4)
    assert names["y"].shape == (12,)
    assert names["rocking"].sensors.readings[-1] == "bar_rate 3"
    off = names["run"].nodes[:, :, -1] - names["prism"].nodes
    assert np.abs(off).max() < 5e-3  # from 15 mm


def test_the_page_on_figures_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = ran("figures", 1)["run"]
    assert np.abs(run.nodes - run.nodes[:, :, :1]).max() > 0.01
    assert {path.name for path in tmp_path.iterdir()} == {"tower.pdf", "tower.gif"}


def test_the_page_on_faults_runs(capsys):
    with pytest.warns(ControlWarning, match="comes no nearer"):  # without the string it is lost
        control = ran("faults", 1)["run"].control
    assert "string 6 cut from 0.9 s" in capsys.readouterr().out
    assert control.status_count["measurement not finite"] == 5
    assert control.fallback_count == {"plan continued": 5}
    assert sum(control.status_count.values()) == 60


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
def test_the_page_on_deployment_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert ran("deployment", 2)["run"].control.status_count == {"ok": 150}
    assert (tmp_path / "prism_mpc" / "controller.h").exists()


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
    """Each number of the five, with the command that prints it."""
    page = DOCS.joinpath("benchmarks.rst").read_text(encoding="utf-8")
    section = README.partition("## Five figures")[2].partition("## ")[0]
    rows = [line.split("|")[2:4] for line in section.splitlines() if line.startswith("| ")][1:]
    assert len(rows) == 5
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
    assert second.endswith("pytest")
    assert "\n" not in first + second
    (figure,) = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert Path(__file__).parent.parent.joinpath(figure).exists()
