"""The figures of the demo."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tenscontrol import plot
from tenscontrol.arrays import FloatArray
from tenscontrol.demo.tour import TARGET, Found, Morph
from tenscontrol.plot.structure_drawing import new_space
from tenscontrol.plot.style import save_figure


def save_figures(output: Path, results: Found) -> Iterator[Path]:
    """Draw and save what is found, one figure after the other, and yield where each is."""
    rest, regulator, morph = results.rest, results.regulator, results.morph
    if rest is not None:
        prism = plot.structure(rest.structure, force_density=rest.force_density)
        yield save_figure(_figure(prism.ax), output / "prism.png")
    for name, (plant, shapes) in results.plants.items():
        drawn = plot.mode_shapes(plant, shapes)
        yield save_figure(_figure(drawn[0].ax), output / f"modes_{name}.png")
    if regulator is not None:
        open_loop = np.linalg.eigvals(regulator.plant.A)
        poles = plot.poles({"open loop": open_loop, "LQR": regulator.poles})
        yield save_figure(_figure(poles.ax), output / "poles.png")
    if morph is not None:
        yield save_figure(morph_figure(morph), output / "closed_loop.png")
        yield save_figure(_figure(plot.health(morph.run)["energy"].ax), output / "health.png")
    if morph is not None and morph.run.stopped is None:
        yield plot.animate(morph.run, output / "closed_loop.gif", target=_laid_over(morph), fps=12)


def morph_figure(morph: Morph) -> Figure:
    """Return start and end in space, beside height, γ and rest lengths over time."""
    figure = plt.figure(figsize=(10.5, 6.0))
    space = new_space(figure, 1, 2, 1)
    space.set_position((0.0, 0.04, 0.46, 0.9))
    grid = figure.add_gridspec(3, 1, left=0.58, right=0.98, bottom=0.08, top=0.95, hspace=0.55)
    run = morph.run
    plot.structure(run.structure, run.nodes[:, :, 0], ax=space, faint=True, legend=False)
    plot.structure(run.structure, run.nodes[:, :, -1], ax=space)
    space.set_title("start (faint) and end", fontsize="medium")
    rows = [figure.add_subplot(grid[i]) for i in range(3)]
    plot.history(
        run.time, {"height": morph.height}, "height, m", ax=rows[0], references={"target": TARGET}
    )
    assert run.rest_length is not None  # the winches hold it
    groups = dict.fromkeys(run.structure.string_groups)
    for ax, values, label in (
        (rows[1], run.force_density, "γ, N/m"),
        (rows[2], run.rest_length, "rest length, m"),
    ):
        by_group = {name: values[run.structure.strings_in(name)] for name in groups}
        plot.history(run.time, by_group, label, ax=ax)
    return figure


def _laid_over(morph: Morph) -> FloatArray:
    """Return the target with its centre where the prism ends: the free prism may drift."""
    end, target = morph.run.nodes[:, :, -1], morph.target.nodes
    return np.asarray(target + (end - target).mean(axis=1, keepdims=True))


def _figure(ax: Axes) -> Figure:
    assert isinstance(ax.figure, Figure)  # not a figure within a figure: it was just made
    return ax.figure
