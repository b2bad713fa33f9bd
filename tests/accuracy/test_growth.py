"""Growth: what is reported, foretold, left out, and drawn."""

import math
import sys

import matplotlib.pyplot as plt
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy import Growth, StopCost
from tenscontrol.cli import main


@pytest.fixture(scope="module")
def measured():
    return tc.accuracy.growth([tc.prism, lambda: tc.prism_tower(2)], last="LQR step")


def costs(power, sizes=(12, 120, 1200), memory=3e7):
    return tuple(
        StopCost("linearize", size, (size / 12) ** power, memory * size / 12, "") for size in sizes
    )


def test_every_stop_is_measured_at_every_size(measured):
    assert measured.members.tolist() == [12, 36]
    assert len(measured.rows) == 2 * len(measured.stops)
    for row in measured.rows:
        assert row.note == ""
        assert row.seconds > 0
        assert row.memory >= 0 or math.isnan(row.memory)


@pytest.mark.parametrize("power", [1.0, 1.25, 3.0])
def test_the_exponent_is_that_of_a_power(power):
    found = Growth(costs(power))
    assert found.exponent("linearize") == pytest.approx(power)
    assert found.exponent("linearize", "memory") == pytest.approx(1.0)
    assert f"{power:.2f}" in found.table()


def test_what_is_too_short_is_not_fitted():
    assert math.isnan(Growth(costs(1.0)[:1]).exponent("linearize"))


def test_a_stop_ends_where_the_budget_would():
    found = tc.accuracy.growth([tc.prism(), tc.prism_tower(4)], seconds=0.01, last="linearize")
    notes = {row.stop: row.note for row in found.rows if row.members == 84}
    assert "beyond the budget of 0.01 s" in notes["prestress search"]
    assert notes["linearize"] == "needs an earlier stop"
    assert not found.of("linearize")[1:]
    less = tc.accuracy.growth([tc.prism(), tc.prism_tower(4)], memory=1.0, last="stability")
    assert "beyond the budget of 1 bytes" in less.rows[-1].note or less.rows[-1].note[:5] == "needs"


def test_a_stop_that_fails_says_why_and_ends_those_that_need_it():
    line = tc.Structure(
        [[0, 1, 2, 3], [0, 0, 0, 0], [0, 0, 0, 0]], [[1, 2]], [[0, 1], [2, 3]], 1.0, 0.1
    )
    notes = {row.stop: row.note for row in tc.accuracy.growth([line]).rows}
    assert notes["prestress search"].startswith("failed: the structure has no state of self-stress")
    assert notes["MPC step"] == "needs an earlier stop"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"structures": []}, "structures is empty"),
        ({"structures": [3]}, "structures is a int, expected Structure"),
        ({"seconds": 0}, "seconds is 0"),
        ({"last": "lunch"}, "last is 'lunch'"),
        ({"memory": -1.0}, "memory is -1"),
    ],
)
def test_bad_input_is_refused(given, message):
    with pytest.raises((TypeError, ValueError), match=message):
        tc.accuracy.growth(**given)


def test_the_table_is_saved(measured, tmp_path):
    lines = measured.to_csv(tmp_path / "growth.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "stop,members,seconds,memory,note"
    assert len(lines) == 1 + len(measured.rows)


@pytest.mark.parametrize("quantity", ["seconds", "memory"])
def test_growth_is_drawn(quantity):
    drawn = tc.plot.growth(Growth(costs(1.25)), quantity)
    (line,) = drawn.lines["linearize"]
    np.testing.assert_array_equal(line.get_xdata(), [12, 120, 1200])
    assert "linearize, 1." in line.get_label()
    plt.close(drawn.ax.figure)


def test_the_command_reports_the_scene_and_towers(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys.modules["tenscontrol.accuracy.growth"], "_STAGES", (1,))
    monkeypatch.setattr(sys.modules["tenscontrol.accuracy.growth"], "_HORIZON", 2)
    scene = "examples/scenes/prism_free.toml"
    assert main(["accuracy", scene, "--growth", "--output", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert text.count("processor s") == 2
    names = {"growth.csv", "growth.png", "growth_memory.png"}
    assert {path.name for path in tmp_path.iterdir()} == names
