"""Figure of the least mass over a family of structures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import BarContainer

from tenscontrol import validation
from tenscontrol.plot.style import PALETTE, closes_on_error, dress, flat_axes, legend_above
from tenscontrol.sizing.complexity import Complexity


@dataclass(frozen=True, eq=False)
class MassDrawing:
    """What was drawn of a family. Made by :func:`least_mass`.

    Attributes
    ----------
    ax : Axes
    bars, strings : BarContainer
        The mass of bars, and of strings on top, one column each.
    """

    ax: Axes
    bars: BarContainer
    strings: BarContainer


@closes_on_error
def least_mass(found: Complexity, *, xlabel: str = "", ax: Axes | None = None) -> MassDrawing:
    """Draw the least mass of each structure of a family, bars below and strings on top.

    Parameters
    ----------
    found : Complexity
        Made by :func:`tenscontrol.sizing.complexity`.
    xlabel : str, optional
        What tells the structures apart, such as "stages".
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Returns
    -------
    MassDrawing

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> metal = tc.sizing.materials["aluminium"]
    >>> towers = {q: tc.prism_tower(q) for q in (2, 3)}
    >>> found = tc.sizing.complexity(towers, lambda tower: tc.design(
    ...     tower, bars=metal, strings=metal, min_force_density=100.0, restarts=1))
    >>> drawing = tc.plot.least_mass(found, xlabel="stages")
    >>> len(drawing.bars), drawing.ax.get_ylabel()
    (2, 'mass, kg')
    >>> plt.close(drawing.ax.figure)
    """
    validation.instance("found", found, Complexity, "make one by sizing.complexity(...)")
    validation.text("xlabel", xlabel, "what tells the structures apart")
    ax = flat_axes(ax)
    place = np.arange(len(found.designs))
    of_bars = np.array([sized.bar_mass.sum() for sized in found.designs])
    of_strings = np.array([sized.string_mass.sum() for sized in found.designs])
    bars = ax.bar(place, of_bars, 0.6, color=PALETTE[0], label="bars")
    strings = ax.bar(
        place, of_strings, 0.6, of_bars, color="none", edgecolor=PALETTE[1], hatch="////",
        label="strings",
    )  # fmt: skip
    ax.set_xticks(place, [str(label) for label in found.labels])
    dress(ax, xlabel or None, "mass, kg")
    legend_above(ax)
    return MassDrawing(ax, bars, strings)
