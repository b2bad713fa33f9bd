"""Figures that stay open: those that a user has, and no others."""

import gc
import weakref

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

import tenscontrol as tc


def test_a_new_figure_is_shown_by_pyplot(slack_run):
    drawn = tc.plot.health(slack_run)
    assert plt.get_fignums() == [drawn["energy"].ax.figure.number]


def test_a_saved_figure_is_closed(slack_run, tmp_path):
    for k in range(2):
        figure = tc.plot.trajectory(slack_run)["coordinates"].ax.figure
        tc.plot.save_figure(figure, tmp_path / f"{k}.png")
    assert plt.get_fignums() == []


def test_a_figure_of_the_user_goes_with_its_last_name(slack_run):
    def draw():
        figure = Figure()
        tc.plot.structure(slack_run, ax=figure.add_subplot(projection="3d"))
        return weakref.ref(figure)

    kept = [draw() for _ in range(3)]
    gc.collect()
    assert plt.get_fignums() == []
    assert [each() for each in kept] == [None] * 3
