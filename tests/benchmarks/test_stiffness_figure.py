"""Errors over the stiffness: what is drawn is the report, and failed runs cannot be missed."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

import tenscontrol as tc
from examples import stiffness_study
from examples.stiffness_study import StiffnessReport, StiffnessRow, StiffnessRun, draw

LOOPS = [(c, i) for i in ("force_density", "rest_length") for c in ("LQR", "MPC")]


def row(stiffness, radius, errors, slack=()):
    """A row with these errors, m, of the four loops; None for a run that failed."""
    runs = tuple(
        StiffnessRun(*loop, error, "ran away" if error is None else None, 1.0, k in slack, 0)
        for k, (loop, error) in enumerate(zip(LOOPS, errors, strict=True))
    )
    return StiffnessRow(stiffness, 0.0, tc.control.HeldLoop(radius, 0.99), 0.995, None, runs)


@pytest.fixture(scope="module")
def report():
    return StiffnessReport(
        0.02,
        2.0,
        1e-3,
        (
            row(1e2, 0.991, [3e-4, 4e-4, 3e-4, 1e-4]),
            row(1e3, 0.9999, [3e-4, 2e-2, 3e-4, 1e-4], slack=(3,)),
            row(1e4, 1.01, [5e-4, None, 3e-4, 2e-4]),
        ),
    )


def test_errors_are_those_of_the_runs(report):
    drawn = draw(report)
    assert list(drawn.errors) == [str(run) for run in report.rows[0].runs]
    for loop, line in zip(LOOPS, drawn.errors.values(), strict=True):
        found = [run.error for run in report.runs(*loop)]
        assert np.array_equal(line.get_xdata(), [1e2, 1e3, 1e4])
        wanted = [np.nan if error is None else 1e3 * error for error in found]
        assert np.array_equal(line.get_ydata(), wanted, equal_nan=True)
    looks = {(line.get_marker(), str(line.get_linestyle())) for line in drawn.errors.values()}
    assert len({marker for marker, _ in looks}) == 4  # also without colour
    upper, lower = drawn.axes
    assert (upper.get_xscale(), upper.get_yscale(), lower.get_xscale()) == ("log", "log", "log")
    assert upper.get_ylabel() == "farthest node off at the end, mm"
    assert lower.get_xlabel() == "stiffness of the strings, N/m"


def test_failed_runs_are_marked_at_the_top_and_named(report):
    drawn = draw(report)
    assert list(drawn.failed) == ["MPC in γ"]
    mark = drawn.failed["MPC in γ"]
    assert np.array_equal(mark.get_xdata(), [1e4])
    drawn.axes[0].figure.canvas.draw()
    place = (
        drawn.axes[0].transAxes.inverted().transform(mark.get_transform().transform([1e4, 0.92]))
    )
    assert place[1] == pytest.approx(0.92)
    texts = [text.get_text() for text in drawn.axes[0].get_legend().get_texts()]
    assert "failed: MPC in γ" in texts
    assert "a string was slack" in texts


def test_shaded_is_where_the_linear_loop_does_not_hold(report):
    drawn = draw(report)
    assert [row.held.holds for row in report.rows] == [True, False, False]
    edges = [area.get_extents().x0 for area in drawn.shaded]
    assert len(edges) == 2
    upper = drawn.axes[0]
    found = upper.transData.inverted().transform([[edge, 0] for edge in edges])[:, 0]
    assert found == pytest.approx(10 ** np.array([2.5, 3.5]))  # halfway on the axis


def test_rates_are_those_of_the_linear_loop(report):
    drawn = draw(report)
    ratios = [row.held.rate_ratio for row in report.rows]
    assert np.array_equal(drawn.rate.get_ydata(), [*ratios[:2], np.nan], equal_nan=True)
    unstable = drawn.axes[1].get_lines()[1]
    assert np.array_equal(unstable.get_xdata(), [1e4])
    assert drawn.axes[1].get_legend().get_texts()[0].get_text() == "unstable"


def test_one_row_and_given_axes_are_drawn(report):
    _, axes = plt.subplots(2)
    one = StiffnessReport(0.02, 2.0, 1e-3, report.rows[1:2])
    drawn = draw(one, axes=axes)
    assert list(drawn.axes) == list(axes)
    assert len(drawn.shaded) == 1
    low, high = axes[0].get_xlim()
    assert low < 1e3 < high


def test_what_is_no_report_is_refused():
    with pytest.raises(TypeError, match=r"report is a int, expected StiffnessReport: make one by"):
        draw(3)


def test_the_line_of_the_lower_axes_is_where_a_law_holds():
    assert tc.control.HeldLoop(np.exp(-stiffness_study.SLOWEST), np.exp(-1.0 + 1e-9)).holds
    assert not tc.control.HeldLoop(np.exp(-stiffness_study.SLOWEST), np.exp(-1.0 - 1e-9)).holds
