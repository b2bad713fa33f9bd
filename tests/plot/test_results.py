"""Results drawn by name: runs, prestresses, shapes that were found, and how a controller did."""

from functools import cache

import matplotlib.pyplot as plt
import numpy as np
import pytest

import tenscontrol as tc


@cache
def loop():
    """Return a prestress, a target and a run of the prism on its way to it."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    rest = tc.prestress(prism, force_density=17.3205)
    target = tc.shape_target(
        model, tc.Height(0.9, top=[0, 1, 2], bottom=[3, 4, 5]), force_density=17.3205
    )
    plant = tc.linearize(model, rest, input="rest_length")
    mpc = tc.MPC(plant, horizon=6, sample_time=0.02, reference=target.nodes)
    faults = [tc.LostMeasurement(0.1, 0.15)]
    run = tc.simulate(model, 0.3, controller=mpc, step=2e-3, faults=faults)
    return rest, target, run


def drawn(result, **settings):
    """Return the ends of bars and the colours of strings of a drawing, its figure closed."""
    drawing = tc.plot.structure(result, **settings)
    drawing.ax.figure.canvas.draw()
    bars, colours = np.array(drawing.bars._segments3d), drawing.strings.get_array()
    plt.close(drawing.ax.figure)
    return bars, colours


def test_a_prestress_and_a_target_are_drawn_with_their_forces():
    rest, target, _ = loop()
    for result, structure in ((rest, rest.structure), (target, target.prestress.structure)):
        bars, colours = drawn(result)
        np.testing.assert_allclose(bars, structure.nodes.T[structure.bars])
        np.testing.assert_allclose(colours, result.force_density)
    assert drawn(rest, faint=True)[1] is None


def test_a_run_is_drawn_in_its_last_shape_or_at_a_time():
    run = loop()[2]
    for settings, k in (({}, -1), ({"time": 0.0}, 0), ({"time": 0.1503}, 75)):
        bars, colours = drawn(run, **settings)
        np.testing.assert_allclose(bars, run.nodes[:, :, k].T[run.structure.bars])
        np.testing.assert_allclose(colours, run.force_density[:, k])
    assert run.time[75] == pytest.approx(0.15)
    shown = drawn(run, nodes=run.structure.nodes)[0]
    np.testing.assert_allclose(shown, run.structure.nodes.T[run.structure.bars])


def test_times_that_do_not_fit_are_refused():
    rest, _, run = loop()
    with pytest.raises(ValueError, match=r"time is 3 s, expected 0 to 0\.3 s"):
        tc.plot.structure(run, time=3.0)
    with pytest.raises(TypeError, match=r"structure is a Prestress, .*time goes with a run"):
        tc.plot.structure(rest, time=0.1)
    with pytest.raises(
        TypeError, match=r"structure is .*Prestress, a ShapeTarget, a plant, a Trajectory"
    ):
        tc.plot.structure(run.nodes)


def test_tracking_draws_what_the_record_has():
    run = loop()[2]
    panels = tc.plot.tracking(run)
    assert list(panels) == ["tracking_error", "prediction_error", "computing_time"]
    (line,) = panels["tracking_error"].lines["farthest node"]
    np.testing.assert_array_equal(line.get_ydata(), run.control.tracking_error)
    assert line.get_xdata()[-1] == run.time[-1]
    (line,) = panels["prediction_error"].lines["farthest node"]
    np.testing.assert_array_equal(line.get_ydata(), run.control.prediction_error)
    assert list(panels["computing_time"].references) == ["sample time"]
    high = panels["tracking_error"].ax.get_ylim()[1]
    assert panels["tracking_error"].ax.get_ylim()[0] > 1e-11 * high  # not down to round-off
    assert list(panels["computing_time"].marks) == ["measurement not finite: plan continued"]
    plt.close(panels["tracking_error"].ax.figure)


def test_tracking_needs_a_controller():
    prism = tc.prism()
    free = tc.simulate(tc.Model(prism), 0.1, force_density=np.full(9, 17.0), step=1e-2)
    with pytest.raises(ValueError, match="run has no controller"):
        tc.plot.tracking(free)
