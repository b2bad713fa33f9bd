"""What the README shows runs, and its commands exist."""

import re
from pathlib import Path

import matplotlib.pyplot as plt

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


def test_first_session_runs_and_brings_the_prism_to_rest():
    (session,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names: dict = {}
    exec(session, names)
    plt.close("all")
    plant, run = names["plant"], names["run"]
    start, end = (plant.measure(run.nodes[..., k], run.velocities[..., k])[:9] for k in (0, -1))
    assert abs(start).max() > 0.019
    assert abs(end).max() < 1e-3


def test_commands_of_the_table_are_there():
    commands = re.findall(r"`python -m ([\w.]+)`", README)
    assert commands
    for command in commands:
        place = Path(__file__).parent.parent.joinpath(*command.split("."))
        assert place.with_suffix(".py").exists() or (place / "__main__.py").exists()


def test_set_up_is_two_commands_and_the_figure_is_there():
    (first, second, *_) = re.findall(r"```sh\n(.*?)\n```", README, flags=re.DOTALL)
    assert first.endswith("tenscontrol demo")
    assert second.endswith("pytest")
    assert "\n" not in first + second
    (figure,) = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert Path(__file__).parent.parent.joinpath(figure).exists()
