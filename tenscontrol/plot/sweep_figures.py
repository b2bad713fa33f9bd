"""Figures of a sweep: the runs that succeed, the spread of a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.plot.style import (
    CURVE_WIDTH,
    DOTTED,
    PALETTE,
    REFERENCE_COLOR,
    REFERENCE_WIDTH,
    closes_on_error,
    dress,
    legend_above,
    marker_style,
    panel_axes,
)
from tenscontrol.robustness.sweep_report import SweepReport
from tenscontrol.short_repr import short_repr

# Inches; both panels side by side.
_SIZE = (8.0, 3.4)

# Runs by what became of them: colour, marker and its size, points. Filled is a success.
_KINDS = {
    "success": (PALETTE[0], "o", 4.5, PALETTE[0]),
    "no success": (PALETTE[1], "o", 5.0, "none"),
    "raised an error": (PALETTE[4], "x", 5.5, "none"),
}


@dataclass(frozen=True, eq=False)
class SweepDrawing:
    """What was drawn of a sweep. Made by :func:`sweep`.

    Attributes
    ----------
    axes : tuple of Axes
        Of the runs and of the figure.
    markers : dict of str to Line2D
        The runs, by what became of them.
    curve : Line2D
        Share of the completed runs up to each value of the figure.
    limit : Line2D or None
        The limit, if one was given.
    """

    axes: tuple[Axes, Axes]
    markers: dict[str, Line2D]
    curve: Line2D
    limit: Line2D | None

    __repr__ = short_repr


@closes_on_error
def sweep(
    report: SweepReport,
    figure: str,
    *,
    over: tuple[str, str] | None = None,
    limit: float | None = None,
    unit: str = "",
    logarithmic: bool = False,
    axes: Sequence[Axes] | None = None,
) -> SweepDrawing:
    """Draw which runs succeed over two parameters, and how a figure spreads.

    The title has the rate of success with its 95 % confidence interval.

    Parameters
    ----------
    report : SweepReport
    figure : str
        The figure whose distribution is drawn.
    over : pair of str, optional
        Numbers drawn, by their names in ``report.columns``; the two that go with
        the figure most, by rank, if not given.
    limit : float, optional
        A value of the figure to mark.
    unit : str
        Unit of the figure, for its label.
    logarithmic : bool
        Whether the figure's axis is logarithmic.
    axes : sequence of two Axes, optional
        Where to draw; a new figure if not given.

    Returns
    -------
    SweepDrawing

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, there is no such figure or parameter,
        or fewer than two numbers were drawn.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> prism, strings = tc.prism(), tc.LinearStrings(100.0, damping=0.5)
    >>> rest = tc.prestress(prism, force_density=10.0)
    >>> plant = tc.linearize(tc.Model(prism, strings=strings), rest, input="rest_length")
    >>> scene = tc.Scene(
    ...     tc.Model(prism, strings), 0.3, controller=tc.LQR(plant, sample_time=0.02),
    ...     integration=tc.Integration(step=5e-3))
    >>> case = tc.ClosedLoopCase(scene, 0.02)
    >>> with ThreadPoolExecutor(1) as executor:
    ...     report = tc.sweep(
    ...         case, {"stiffness": tc.Uniform(0.7, 1.3, size=9)}, 5, seed=0, executor=executor)
    >>> drawn = tc.plot.sweep(report, "final_error", unit="m", limit=0.02)
    >>> len(drawn.curve.get_xdata()), drawn.axes[1].get_xlabel()
    (5, 'final_error, m')
    >>> plt.close(drawn.axes[0].figure)
    """
    validation.instance("report", report, SweepReport, "make one by sweep(case, parameters, count)")
    values = np.sort(report.figure(validation.choice("figure", figure, report.figures)))
    validation.truth("logarithmic", logarithmic, "whether the figure's axis is logarithmic")
    pair = _strongest(report, figure) if over is None else _checked_pair(report, over)
    level = None if limit is None else validation.float_array("limit", limit)
    if level is not None and level.ndim:
        raise ValueError(f"limit has shape {level.shape}, expected one number")
    validation.truth("logarithmic", logarithmic, "whether the axis of the figure is")
    validation.text("unit", unit, "like 'm'")
    if axes is None:
        _, axes = plt.subplots(1, 2, figsize=_SIZE, layout="constrained")
    left, right = panel_axes(axes, ["runs", "figure"])
    markers = _runs(left, report, pair)
    curve, mark = _spread(right, values, level)
    if logarithmic:
        if not values[0] > 0:
            raise ValueError(f"figure {figure!r} is {values[0]:g} in a run: no logarithm")
        right.set_xscale("log")
    dress(right, f"{figure}, {unit}" if unit else figure, "share of the completed runs")
    low, high = report.confidence_interval()
    right.set_title(
        f"success {100 * report.success_rate:.1f} %, 95 % interval {100 * low:.1f} to "
        f"{100 * high:.1f} %",
        fontsize="small",
    )
    return SweepDrawing((left, right), markers, curve, mark)


def _runs(ax: Axes, report: SweepReport, pair: tuple[str, str]) -> dict[str, Line2D]:
    """Draw one marker a run, in the style of what became of it."""
    x, y = (report.columns[name] for name in pair)
    success, completed = report.success, report.completed
    kinds = dict(zip(_KINDS, (success, completed & ~success, ~completed), strict=True))
    markers = {}
    for name, chosen in kinds.items():
        if not chosen.any():
            continue
        color, marker, size, face = _KINDS[name]
        (markers[name],) = ax.plot(
            x[chosen],
            y[chosen],
            label=f"{name} (×{chosen.sum()})",
            **marker_style(marker, size, color, mfc=face),
        )
    dress(ax, pair[0], pair[1])
    legend_above(ax)
    return markers


def _spread(ax: Axes, values: FloatArray, limit: FloatArray | None) -> tuple[Line2D, Line2D | None]:
    """Draw the share of the runs up to each value."""
    share = np.arange(1, len(values) + 1) / len(values)
    (curve,) = ax.plot(
        values, share, drawstyle="steps-post", color=PALETTE[0], linewidth=CURVE_WIDTH
    )
    ax.set_ylim(0.0, 1.03)
    if ax.get_xscale() == "linear":
        ax.locator_params(axis="x", nbins=5)  # more small numbers would touch
    if limit is None:
        return curve, None
    line = ax.axvline(
        float(limit), color=REFERENCE_COLOR, linewidth=REFERENCE_WIDTH, linestyle=DOTTED
    )
    beyond = bool(limit > values[-1])  # then there is room inside on the left alone
    ax.annotate("limit", (float(limit), 0.03), xytext=(-3 if beyond else 3, 0),
                textcoords="offset points", horizontalalignment="right" if beyond else "left",
                fontsize="small", color=REFERENCE_COLOR)  # fmt: skip
    return curve, line


def _strongest(report: SweepReport, figure: str) -> tuple[str, str]:
    """Return the two numbers that go with the figure most."""
    names = list(report.rank_correlation(figure))
    if len(names) < 2:
        raise ValueError(
            f"report has {len(names)} numbers that vary, expected at least 2 to draw runs over"
        )
    return names[0], names[1]


def _checked_pair(report: SweepReport, over: object) -> tuple[str, str]:
    pair = tuple(over) if isinstance(over, tuple | list) else ()
    if len(pair) != 2:
        raise TypeError(f"over is {over!r}, expected a pair of names from report.columns")
    return validation.choice("over[0]", pair[0], report.columns), validation.choice(
        "over[1]", pair[1], report.columns
    )
