"""Figures of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from tenscontrol import validation
from tenscontrol.plot.style import PALETTE, closes_on_error, dress, flat_axes, legend_above
from tenscontrol.short_repr import short_repr

if TYPE_CHECKING:  # who draws something else does not wait for fits
    from tenscontrol.optimize.fit import Fit, Validation

# Unknowns beyond are not told apart in a figure.
_MOST_UNKNOWNS = 80

# Inches: of a figure of intervals, and of each unknown in it.
_WIDTH, _ROW = 6.4, 0.16


@dataclass(frozen=True, eq=False)
class FitDrawing:
    """What was drawn of a fit. Made by :func:`residuals` and :func:`intervals`.

    Attributes
    ----------
    ax : Axes
    lines : dict of str to Line2D
        The points by the kind of readings, or the values by the name of the parameter.
    """

    ax: Axes
    lines: dict[str, Line2D]

    __repr__ = short_repr


@closes_on_error
def residuals(found: Validation, *, ax: Axes | None = None) -> FitDrawing:
    """Draw what a fitted model reads less what was read, in standard deviations, over time.

    Where the model explains the log they are noise: 95 % within the band, and no pattern.

    Parameters
    ----------
    found : Validation
        Of :attr:`Fit.residuals <tenscontrol.optimize.Fit.residuals>`, or made by
        :meth:`Fit.validate <tenscontrol.optimize.Fit.validate>`.
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Returns
    -------
    FitDrawing

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    >>> run = tc.simulate(model, 0.5, rest_length=0.9 * prism.string_length(), step=1e-3)
    >>> sensors = tc.Sensors(structure=prism, node_position=0.001, string_length=0.001)
    >>> log = tc.Log.of_run(run, sensors, np.linspace(0.02, 0.5, 25), seed=0)
    >>> found = tc.fit(model, log, ["stiffness"], groups={"stiffness": "all"})
    >>> list(tc.plot.residuals(found.residuals[0]).lines)
    ['node_position', 'string_length']
    >>> plt.close("all")
    """
    from tenscontrol.optimize.fit import Validation

    validation.instance("found", found, Validation, "give fit(...).residuals[0]")
    ax, log = flat_axes(ax), found.log
    kinds = [log.sensors.readings[i].split()[0] for i in log.sensors.reading_of]
    lines = {}
    ax.axhspan(-2, 2, color="0.5", alpha=0.15, linewidth=0, label="± 2 standard deviations")
    for place, kind in enumerate(dict.fromkeys(kinds)):
        own = found.residuals[:, [k == kind for k in kinds]]
        times = np.repeat(log.time[:, None], own.shape[1], axis=1)
        (lines[kind],) = ax.plot(
            times.ravel(), own.ravel(), linestyle="none", marker="o", markersize=2.0,
            color=PALETTE[place % len(PALETTE)], alpha=0.6, label=kind,
        )  # fmt: skip
    largest = float(np.nanmax(np.abs(found.residuals), initial=3.0))
    ax.set_ylim(-1.1 * largest, 1.1 * largest)
    dress(ax, "time, s", "residual, standard deviations")
    legend_above(ax)
    return FitDrawing(ax, lines)


@closes_on_error
def intervals(found: Fit, *, ax: Axes | None = None) -> FitDrawing:
    """Draw what a fit found of each unknown, with its interval of 95 %.

    Unknowns without an interval have a hollow mark: data does not tell them, or the fit did not
    converge or is far from the log.

    Parameters
    ----------
    found : Fit
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Returns
    -------
    FitDrawing

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, or there are too many unknowns to be told apart.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    >>> run = tc.simulate(model, 0.5, rest_length=0.9 * prism.string_length(), step=1e-3)
    >>> sensors = tc.Sensors(structure=prism, node_position=0.001)
    >>> log = tc.Log.of_run(run, sensors, np.linspace(0.02, 0.5, 25), seed=0)
    >>> found = tc.fit(model, log, ["stiffness"])
    >>> tc.plot.intervals(found).ax.get_xlabel()
    'factor of what was known before, or shift'
    >>> plt.close("all")
    """
    from tenscontrol.optimize.fit import Fit

    validation.instance("found", found, Fit, "make one by fit(model, log, ...)")
    count = len(found.labels)
    if count > _MOST_UNKNOWNS:
        raise ValueError(f"found has {count} unknowns, expected at most {_MOST_UNKNOWNS}")
    ax, lines = flat_axes(ax, (_WIDTH, max(2.4, _ROW * count + 1.0))), {}
    names = [label.split()[0] for label in found.labels]
    places = np.arange(count)
    for i, name in enumerate(dict.fromkeys(names)):
        own = np.array([other == name for other in names])
        identified = own & ~np.isnan(found.interval[:, 0])
        colour = PALETTE[i % len(PALETTE)]
        ax.hlines(places[identified], *found.interval[identified].T, color=colour, linewidth=2.0)
        (lines[name],) = ax.plot(
            found.value[own], places[own], linestyle="none", marker="o", markersize=4.0,
            color=colour, markerfacecolor="none", label=None if identified.any() else name,
        )  # fmt: skip
        ax.plot(
            found.value[identified], places[identified], linestyle="none", marker="o",
            markersize=4.0, color=colour, label=name if identified.any() else None,
        )  # fmt: skip
    ax.set_yticks(places, found.labels, fontsize=8)
    ax.invert_yaxis()
    dress(ax, "factor of what was known before, or shift", "")
    legend_above(ax)
    return FitDrawing(ax, lines)
