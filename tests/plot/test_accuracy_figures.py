"""Figures of accuracy: what is drawn where."""

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tests.accuracy.scenes import paper_case


@pytest.fixture(scope="module")
def compared():
    settings = {"rk4": [0.02, 0.01, 0.005], "dop853": [1e-3, 1e-6, 1e-9]}
    return tc.work_precision(paper_case(0.4), list(settings), settings, repeats=1, outputs=20)


@pytest.fixture(scope="module")
def with_peer(compared):
    rows = [replace(row, method="other", is_peer=True) for row in compared.of("rk4")]
    return replace(compared, rows=(*compared.rows, *rows))


def test_every_run_is_a_marker(compared):
    drawn = tc.plot.work_precision(compared)
    for method in compared.methods:
        line, hollow = drawn.lines[method]
        np.testing.assert_array_equal(line.get_xdata(), [r.error for r in compared.of(method)])
        np.testing.assert_array_equal(line.get_ydata(), [r.time for r in compared.of(method)])
        assert not len(hollow.get_xdata())
    assert (drawn.ax.get_xscale(), drawn.ax.get_yscale()) == ("log", "log")
    assert (drawn.ax.get_xlabel(), drawn.ax.get_ylabel()) == (
        "largest error of a node, m",
        "run time, s",
    )
    left, right = drawn.ax.get_xlim()
    assert left > right  # small errors on the right


def test_curves_are_named_at_their_ends_and_names_do_not_touch(with_peer):
    ax = tc.plot.work_precision(with_peer).ax
    ax.figure.canvas.draw()
    names = {"rk4", "dop853", "other"}
    boxes = [text.get_window_extent() for text in ax.texts if text.get_text() in names]
    assert len(boxes) == 3
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:i])


def test_peers_are_dashed_and_grey(with_peer):
    lines = tc.plot.work_precision(with_peer).lines
    (own, _), (other, _) = lines["rk4"], lines["other"]
    assert own.get_linestyle() == "-"
    assert other.get_linestyle() != "-"
    assert other.get_color() in ("0.30", "0.45", "0.58", "0.68")
    assert own.get_marker() != other.get_marker()


def test_errors_of_the_reference_are_hollow_and_failures_are_counted(compared):
    fine = replace(compared.rows[0], error=1e-3 * compared.reference.error)
    failed = replace(compared.rows[0], error=np.nan, relative_error=np.nan, failure="no")
    drawn = tc.plot.work_precision(replace(compared, rows=(*compared.rows, fine, failed)))
    _, hollow = drawn.lines["rk4"]
    np.testing.assert_array_equal(hollow.get_xdata(), [compared.reference.error])
    assert "1 of 8 runs failed" in drawn.ax.get_title(loc="left")


def test_nothing_to_draw_is_told(compared):
    far = tuple(replace(row, relative_error=2.0) for row in compared.rows)
    with pytest.raises(ValueError, match="no run with an error below the size"):
        tc.plot.work_precision(replace(compared, rows=far))


def test_order_with_its_line_and_triangle():
    found = tc.convergence_order(paper_case(0.4), "rk4", [0.01, 0.005, 0.0025, 1e-1], outputs=4)
    drawn = tc.plot.convergence_order(found)
    line = drawn.references["fit"]
    slope = np.diff(np.log(line.get_ydata())) / np.diff(np.log(line.get_xdata()))
    assert slope[0] == pytest.approx(found.order)
    fitted, hollow = drawn.lines["rk4"]
    assert len(fitted.get_xdata()) == found.is_clean.sum()
    assert len(hollow.get_xdata()) == (~found.is_clean).sum()
    assert {"4", "1"} <= {text.get_text() for text in drawn.ax.texts}
    # The axis fits the errors, not the reference far below them.
    assert found.reference_error < 1e-3 * found.error.min()
    assert drawn.ax.get_ylim()[0] > 0.02 * found.error.min()


def test_an_order_that_could_not_be_fitted_has_no_line():
    found = tc.convergence_order(paper_case(0.2), "rk4", [0.01, 0.005], outputs=4)
    assert set(tc.plot.convergence_order(found).references) == {"reference"}


def test_stable_steps_beside_their_bound():
    found = tc.stability_map("rk4", [1e2, 1e3], [0.1, 0.01], steps=100)
    drawn = tc.plot.stability_map(found)
    assert list(drawn.lines) == ["mass ratio 0.01", "mass ratio 0.1"]
    for j, name in enumerate(drawn.lines):
        np.testing.assert_array_equal(drawn.lines[name][0].get_ydata(), found.step[:, j])
        np.testing.assert_array_equal(drawn.references[name].get_ydata(), found.bound[:, j])
    unknown = replace(found, limit=np.nan)
    assert tc.plot.stability_map(unknown).references == {}


def test_energy_over_a_long_run_and_bars_where_there_is_none():
    found = tc.long_run(paper_case(1.0), "rk4", 2e-3, steps=200, outputs=50)
    drawn = tc.plot.long_run(found)
    np.testing.assert_allclose(
        drawn.lines["energy"][0].get_ydata(), found.drifts[0].error / found.energy_scale
    )
    damped = tc.long_run(paper_case(1.0, damping=1.0), "rk4", 2e-3, steps=200, outputs=50)
    assert tc.plot.long_run(damped).ax.get_ylabel() == "change of momentum, kg m/s"


@pytest.mark.parametrize(
    "draw",
    [tc.plot.work_precision, tc.plot.convergence_order, tc.plot.stability_map, tc.plot.long_run],
)
def test_other_things_are_refused(draw):
    with pytest.raises(TypeError, match="result is a int, expected"):
        draw(3)


def test_space_axes_are_refused(compared, space):
    with pytest.raises(TypeError, match="ax is three-dimensional, expected flat"):
        tc.plot.work_precision(compared, ax=space)
