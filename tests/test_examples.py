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
    tested = {
        "plot_control_string_mass.py",
        "plot_paper_skin.py",
        "plot_paper_string_mass.py",
        "plot_prism_modes.py",
        "plot_prism_new_height.py",
        "plot_prism_shape_path.py",
    }
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


def test_prism_shape_path():
    found = run("plot_prism_shape_path.py")
    path = found["path"]
    assert found["missed"] == pytest.approx(5.0, abs=1e-6)
    assert np.abs(path.rest_length_rate).max() <= 0.1
    assert path.residual < 1e-12
    assert found["left"] < 1e-3


def test_paper_string_mass():
    found = run("plot_paper_string_mass.py")
    assert found["massive"].nodes.shape == (3, 33)
    assert 0.05 < found["mass_effect"] < 0.1
    assert found["half_speed_error"] < 1e-6


def test_paper_skin():
    travel = run("plot_paper_skin.py")["travel"]
    shares = {v: travel[v, "with skin"] / travel[v, "without skin"] for v in (9.0, 45.0)}
    assert shares[9.0] > 0.9  # slack: hardly an effect
    assert shares[45.0] < 0.55  # taut: half the travel


def test_control_string_mass():
    found = run("plot_control_string_mass.py")
    for values in found["left"].values():
        assert len(values) == 13
        assert max(values) < 1e-4
        assert values[0] < max(values)  # mass is noticed
    assert found["left_with_full"] < 1e-3
