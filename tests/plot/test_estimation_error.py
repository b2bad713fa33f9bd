"""The figure of an estimate: true and estimated lengths, band, marks."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc


@pytest.fixture(scope="module")
def run(prism, rest):
    model = tc.Model(prism)
    plant = tc.linearize(model, rest)
    sensors = tc.Sensors(
        structure=prism, string_length=1e-3, bar_direction=0.01, delay=1, drop_rate=0.2
    )
    return tc.simulate(
        model,
        1.0,
        plant.to_nodes(0.005 * np.ones(9)),
        controller=tc.LQR(plant, Q=1.0, R=1e-2, sample_time=0.02),
        step=1e-3,
        estimator=tc.KalmanFilter(plant, sensors, sample_time=0.02),
        seed=2,
    )


def test_lengths_and_their_errors_are_drawn(run, prism):
    panels = tc.plot.estimate(run, strings=(0, 7))
    record = run.control.estimate
    for i, name in ((0, "string 0"), (7, "string 7")):
        true = np.array([prism.string_length(N)[i] for N in run.nodes.transpose(2, 0, 1)])
        found = np.array([prism.string_length(N)[i] for N in record.nodes.transpose(2, 0, 1)])
        np.testing.assert_allclose(panels["length"].lines[name][0].get_ydata(), true)
        off = panels["error"].lines[name][0].get_ydata()
        np.testing.assert_allclose(off, 1e3 * (found - true[:1000:20]), rtol=0, atol=1e-9)
    bands = panels["error"].ax.collections
    assert len(bands) == 2
    edges = np.abs(bands[0].get_paths()[0].vertices[:, 1]).max()
    assert edges == pytest.approx(2e3 * record.length_deviation[0].max())


def test_samples_that_were_not_used_are_marked(run):
    marks = tc.plot.estimate(run)["error"].marks
    counts = {name: len(line.get_xdata()) for name, line in marks.items()}
    expected = dict(run.control.estimate.status_count)
    del expected["ok"]
    assert counts == expected
    assert set(counts) == {"waiting", "lost"}


def test_an_estimate_is_drawn_into_axes_given(run):
    import matplotlib.pyplot as plt

    _, axes = plt.subplots(2)
    panels = tc.plot.estimate(run, axes=axes)
    assert [panel.ax for panel in panels.values()] == list(axes)
    with pytest.raises(ValueError, match="axes has 1 entries, expected 2"):
        tc.plot.estimate(run, axes=axes[:1])
    with pytest.raises(TypeError, match=r"strings is \[\], expected a sequence of string indices"):
        tc.plot.estimate(run, strings=[])
    with pytest.raises(TypeError, match="axes is a MX, expected a sequence of 2 matplotlib Axes"):
        tc.plot.estimate(run, axes=ca.MX.sym("x", 2))
