"""Runs of a sweep over two parameters, and the spread of a figure."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.robustness import cases
from tests.robustness.cases import PARAMETERS, Inline


@pytest.fixture(scope="module")
def report():
    return tc.sweep(cases.noisy, PARAMETERS, 60, seed=7, executor=Inline())


def test_every_run_is_drawn_by_what_became_of_it(report):
    drawn = tc.plot.sweep(report, "value", over=("mass[1]", "delay"))
    chosen = {
        "success": report.success,
        "no success": report.completed & ~report.success,
        "raised an error": ~report.completed,
    }
    assert set(drawn.markers) == set(chosen)
    for name, runs in chosen.items():
        line = drawn.markers[name]
        assert np.array_equal(line.get_xdata(), report.columns["mass[1]"][runs])
        assert np.array_equal(line.get_ydata(), report.columns["delay"][runs])
        assert line.get_label() == f"{name} (×{runs.sum()})"
    looks = {(line.get_marker(), line.get_markerfacecolor()) for line in drawn.markers.values()}
    assert len(looks) == 3  # also without colour
    assert drawn.axes[0].get_xlabel() == "mass[1]"


def test_the_curve_is_the_share_of_runs_up_to_a_value(report):
    drawn = tc.plot.sweep(report, "value", limit=3.0, unit="kg")
    values = report.figure("value")
    at, share = drawn.curve.get_data()
    for value, part in zip(at, share, strict=True):
        assert part == np.mean(values <= value)
    assert drawn.limit.get_xdata()[0] == 3.0
    low, high = report.confidence_interval()
    assert drawn.axes[1].get_xlabel() == "value, kg"
    assert f"95 % interval {100 * low:.1f} to {100 * high:.1f} %" in drawn.axes[1].get_title()


def test_the_strongest_numbers_are_the_axes(report):
    drawn = tc.plot.sweep(report, "value")
    strongest = list(report.rank_correlation("value"))[:2]
    assert [drawn.axes[0].get_xlabel(), drawn.axes[0].get_ylabel()] == strongest


def test_given_axes_are_used(report):
    import matplotlib.pyplot as plt

    _, axes = plt.subplots(2)
    drawn = tc.plot.sweep(report, "value", axes=axes, logarithmic=True)
    assert list(drawn.axes) == list(axes)
    assert axes[1].get_xscale() == "log"


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"figure": "speed"}, ValueError, "figure is 'speed', expected one of 'value'"),
        ({"over": "mass"}, TypeError, "over is 'mass', expected a pair of names"),
        ({"over": ("mass", "delay")}, ValueError, r"over\[0\] is 'mass', .*'mass\[0\]'"),
        ({"logarithmic": 1}, TypeError, "logarithmic is 1"),
        ({"limit": float("nan")}, ValueError, "limit is nan"),
        ({"limit": [1, 2]}, ValueError, r"limit has shape \(2,\)"),
        ({"unit": 3}, TypeError, "unit is 3"),
        ({"axes": []}, ValueError, "axes has 0 entries, expected 2"),
        ({"report": "report"}, TypeError, "report is a str, expected SweepReport"),
    ],
)
def test_wrong_arguments_are_named(report, arguments, error, message):
    with pytest.raises(error, match=message):
        tc.plot.sweep(**({"report": report, "figure": "value"} | arguments))


def test_a_single_number_drawn_is_not_enough():
    found = tc.sweep(
        cases.first_of_the_stream, {"x": tc.Uniform(0, 1)}, 4, seed=0, executor=Inline()
    )
    with pytest.raises(ValueError, match="report has 1 numbers that vary, expected at least 2"):
        tc.plot.sweep(found, "first")


def test_an_error_leaves_no_empty_figure(report, monkeypatch):
    import matplotlib.pyplot as plt

    below = -report.figure("value")
    monkeypatch.setattr(type(report), "figure", lambda *_: below)
    with pytest.raises(ValueError, match="no logarithm"):
        tc.plot.sweep(report, "value", logarithmic=True)
    assert plt.get_fignums() == []
