"""What figures of fits say of marks."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

import tenscontrol as tc


@pytest.mark.parametrize("is_told", [True, False])
def test_the_legend_of_intervals_has_the_mark_that_is_drawn(is_told):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    lengths = 0.9 * prism.string_length()
    run = tc.simulate(model, 0.2, rest_length=lengths, step=1e-3, error="none")
    sensors = tc.Sensors(structure=prism, node_position=0.001)
    log = tc.Log.of_run(run, sensors, np.linspace(0.02, 0.2, 10), seed=0)
    found = tc.fit(model, log, ["stiffness"], groups={"stiffness": "all"})
    if not is_told:
        found = replace(found, interval=np.full((1, 2), np.nan))
    drawing = tc.plot.intervals(found)
    (mark,) = drawing.ax.get_legend().get_lines()
    assert (mark.get_markerfacecolor() == "none") != is_told
    assert [text.get_text() for text in drawing.ax.get_legend().get_texts()] == ["stiffness"]
    plt.close("all")
