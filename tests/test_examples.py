"""Every example is in the gallery, which runs it and checks its numbers; quick ones run here too.

``sphinx-build docs docs/_build`` runs all of them, see ``docs/_ext/example_numbers.py``.
"""

import re
import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from tests.examples import NUMBERS

EXAMPLES = Path(__file__).parent.parent / "examples"
# One is imported by examples, and tests/benchmarks/ tests it. The other needs torch.
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
