"""Every example is in the gallery, which runs it and checks its numbers; quick ones run here too.

``sphinx-build docs docs/_build`` runs all of them, see ``docs/_ext/example_numbers.py``.
"""

import re
import runpy
import sys
from importlib.util import find_spec
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from tests.examples import NUMBERS
from tests.learning_libraries import learning_libraries

EXAMPLES = Path(__file__).parent.parent / "examples"
# One is imported by examples, and tests/benchmarks/ tests it. The other runs with stand-ins below.
STUDIES = {"stiffness_study.py", "learn_to_roll.py"}


def test_every_example_has_numbers():
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(NUMBERS) | STUDIES


@pytest.mark.parametrize("name", NUMBERS)
def test_every_example_is_in_the_gallery_once(name):
    index = (EXAMPLES / "index.rst").read_text("utf-8").split()
    assert index.count(f"../examples/{name}") == 1  # its thumbnail
    assert index.count(name.removesuffix(".py")) == 1  # its place in the sidebar


@pytest.mark.parametrize(
    "example",
    ["control_lqr", "control_profiles", "modes", "paper_skin"],  # the gallery runs all
)
def test_quick_examples_run(example, monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)  # as it is when Python runs the file
    path = EXAMPLES / f"plot_{example}.py"
    names = runpy.run_path(str(path))
    # Else the gallery has no picture of it in its index.
    thumbnail = re.search(r"# sphinx_gallery_thumbnail_number = (\d+)", path.read_text("utf-8"))
    assert len(plt.get_fignums()) >= (int(thumbnail[1]) if thumbnail else 1)
    plt.close("all")
    NUMBERS[path.name](names)


def test_a_few_samples_of_learning_to_roll(monkeypatch, capsys):
    if find_spec("stable_baselines3") is None:
        for name, module in learning_libraries().items():
            monkeypatch.setitem(sys.modules, name, module)
    main = runpy.run_path(str(EXAMPLES / "learn_to_roll.py"))["main"]
    monkeypatch.setitem(main.__globals__, "EPISODE", 0.5)
    main(["--samples", "20", "--robots", "2"])
    assert "in 0.5 s of simulate the ball goes" in capsys.readouterr().out
