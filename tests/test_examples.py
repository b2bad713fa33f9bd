"""Every example runs, and one of its numbers is what it should be."""

import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


def run(name):
    result = runpy.run_path(str(EXAMPLES / name))
    plt.close("all")
    return result


def test_every_example_is_tested():
    tested = {"plot_prism_modes.py", "plot_prism_new_height.py"}
    assert {path.name for path in EXAMPLES.glob("*.py")} == tested


def test_prism_modes():
    held = run("plot_prism_modes.py")["held"]
    assert held.frequency[0] == pytest.approx(2.31873, abs=5e-6)
    assert held.label[0] == "mechanism"


def test_prism_new_height():
    found = run("plot_prism_new_height.py")
    assert abs(found["height_error"]) < 1e-3
    assert found["run"].force_density.min() > 0
    assert np.abs(found["run"].control.winch_rate).max() <= 0.5
