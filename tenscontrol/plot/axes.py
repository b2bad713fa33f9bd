"""Flat axes: made or checked, with the legend above the data."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from tenscontrol.plot.style import GRID

# Inches.
_WIDTH, _ROW_HEIGHT, _SINGLE_HEIGHT = 6.4, 2.2, 3.2

# Width of a legend entry, points: of its sample with the gaps, and of a letter.
_SAMPLE_WIDTH, _LETTER_WIDTH = 44.0, 5.0


def flat_axes(ax: object) -> Axes:
    """Return ``ax`` if it is a pair of flat axes, new ones if it is None; else raise."""
    if ax is None:
        _, new = plt.subplots(figsize=(_WIDTH, _SINGLE_HEIGHT), layout="constrained")
        return new
    return _checked("ax", ax)


def panel_axes(axes: Sequence[Axes] | None, names: Sequence[str]) -> list[Axes]:
    """Return one pair of axes for each panel, one below the other if they are new."""
    if axes is None:
        size = (_WIDTH, _ROW_HEIGHT * len(names) + 0.4)
        figure, grid = plt.subplots(
            len(names), 1, sharex=True, squeeze=False, figsize=size, layout="constrained"
        )
        column = list(grid[:, 0])
        figure.align_ylabels(column)
        return column
    given = list(np.ravel(np.array(axes, dtype=object)))
    if len(given) != len(names):
        raise ValueError(
            f"axes has {len(given)} entries, expected {len(names)}: one for each of "
            f"{', '.join(names)}; leave it out for a new figure"
        )
    return [_checked(f"axes[{i}]", ax) for i, ax in enumerate(given)]


def dress(ax: Axes, xlabel: str | None, ylabel: str) -> None:
    """Label the axes, and take away what is not needed."""
    if xlabel is not None:
        ax.set_xlabel(xlabel)
    ax.set_ylabel(ylabel)
    ax.grid(visible=True, **GRID)  # type: ignore[arg-type]
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def legend_above(ax: Axes) -> None:
    """Put the legend above the axes, where no curve can be, or none if nothing has a name."""
    handles, names = ax.get_legend_handles_labels()
    if not handles:
        return
    columns = _legend_columns(names, ax.bbox.width * 72 / ax.figure.dpi)
    # The legend is filled column by column, but read row by row.
    order = [i for first in range(columns) for i in range(first, len(handles), columns)]
    ax.legend(
        handles=[handles[i] for i in order],
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        frameon=False,
        fontsize="small",
        handlelength=2.6,
        columnspacing=1.4,
        borderaxespad=0.2,
        borderpad=0.2,
    )


def _legend_columns(names: Sequence[str], room: float) -> int:
    """Return how many columns fit into a legend of this width, points."""
    width = [_SAMPLE_WIDTH + _LETTER_WIDTH * len(name) for name in names]
    count = len(names)
    for columns in range(count, 1, -1):
        if sum(max(width[first::columns]) for first in range(columns)) <= room:
            return ceil(count / ceil(count / columns))
    return 1


def _checked(name: str, ax: object) -> Axes:
    if not isinstance(ax, Axes) or ax.name == "3d":
        found = "three-dimensional" if isinstance(ax, Axes) else f"a {type(ax).__name__}"
        raise TypeError(
            f"{name} is {found}, expected flat matplotlib Axes: make them by plt.subplots()"
        )
    return ax
