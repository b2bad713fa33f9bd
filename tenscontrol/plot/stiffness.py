"""Errors of laws in γ and in rest lengths over the stiffness of the strings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle

from tenscontrol.control.held_loop import SLOWEST
from tenscontrol.plot.style import (
    DOTTED,
    PALETTE,
    REFERENCE_COLOR,
    REFERENCE_WIDTH,
    curve_style,
    dress,
    legend_above,
    panel_axes,
)
from tenscontrol.robustness import StiffnessReport
from tenscontrol.validation import FloatArray, instance

# Inches.
_SIZE, _HEIGHTS = (6.4, 5.6), (2.2, 1.0)

# Markers of the four loops, in the order of a row.
_MARKERS = ("o", "s", "^", "D")

# Where failed runs are marked: so far below the top, one row of marks a loop, parts of the height.
_TOP, _NEXT = 0.97, 0.05


@dataclass(frozen=True, eq=False)
class StiffnessDrawing:
    """What was drawn of a stiffness report. Made by :func:`stiffness`.

    Attributes
    ----------
    axes : tuple of Axes
        Of the errors, and of the settling rate of the law in γ.
    errors : dict of str to Line2D
        The runs that came to their end, by loop: ``"MPC in γ"``.
    failed : dict of str to Line2D
        The others, by loop; a loop without any is not there.
    rate : Line2D
        Settling rate where the linear loop is stable.
    shaded : tuple
        The areas in the upper axes where the linear loop of the law in γ does not hold.
    """

    axes: tuple[Axes, Axes]
    errors: dict[str, Line2D]
    failed: dict[str, Line2D]
    rate: Line2D
    shaded: tuple[Rectangle | Polygon, ...]


def stiffness(report: StiffnessReport, axes: Sequence[Axes] | None = None) -> StiffnessDrawing:
    """Draw the errors of the four loops, and how the law in γ settles, over the stiffness.

    Hollow marks: a string was slack. Crosses at the top: the run failed. Grey areas: the
    linear loop of the law in γ is unstable or settles too slowly (:attr:`HeldLoop.holds`).

    Parameters
    ----------
    report : StiffnessReport
    axes : sequence of two Axes, optional
        Where to draw; a new figure if not given.

    Returns
    -------
    StiffnessDrawing

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> rest = tc.prestress(tc.prism(), force_density=17.3205)
    >>> report = tc.robustness.stiffness_report(
    ...     rest, [1e2, 1e3], sample_time=0.02, damping=0.5, duration=0.2)
    >>> drawn = tc.plot.stiffness(report)
    >>> sorted(drawn.errors)
    ['LQR in rest lengths', 'LQR in γ', 'MPC in rest lengths', 'MPC in γ']
    >>> plt.close(drawn.axes[0].figure)
    """
    instance("report", report, StiffnessReport, "make one by stiffness_report(...)")
    if axes is None:
        _, axes = plt.subplots(
            2, 1, sharex=True, figsize=_SIZE, height_ratios=_HEIGHTS, layout="constrained"
        )
    upper, lower = panel_axes(axes, ["errors", "rate"])
    k = report.stiffness
    for ax in (upper, lower):
        ax.set_xscale("log")
    upper.set_yscale("log")
    shaded = _shade(upper, report)
    _shade(lower, report)
    errors, failed = _errors(upper, report, k)
    upper.axhline(1e3 * report.tolerance, color=REFERENCE_COLOR, linewidth=REFERENCE_WIDTH,
                  linestyle=DOTTED, label="tolerance")  # fmt: skip
    dress(upper, None, "farthest node off at the end, mm")
    legend_above(upper)
    rate = _rates(lower, report, k)
    dress(lower, "stiffness of the strings, N/m", "rate / design,\nlaw in γ")
    return StiffnessDrawing((upper, lower), errors, failed, rate, shaded)


def _shade(ax: Axes, report: StiffnessReport) -> tuple[Rectangle | Polygon, ...]:
    """Shade each row whose linear loop does not hold, halfway to its neighbours."""
    k = np.log10(report.stiffness)
    between = (k[1:] + k[:-1]) / 2
    # Rows at the ends, and one alone, reach as far beyond as their neighbour is, or a decade.
    first, last = (between[0], between[-1]) if len(between) else (k[0] + 0.5, k[0] - 0.5)
    edges = 10 ** np.r_[2 * k[0] - first, between, 2 * k[-1] - last]
    ax.set_xlim(edges[0], edges[-1])
    label = "γ: linear loop does not hold"
    areas: list[Polygon | Rectangle] = []
    for i, row in enumerate(report.rows):
        if not row.held.holds:
            area = ax.axvspan(edges[i], edges[i + 1], color="0.92", linewidth=0, zorder=0,
                              label=None if areas else label)  # fmt: skip
            areas.append(area)
    return tuple(areas)


def _errors(
    ax: Axes, report: StiffnessReport, k: FloatArray
) -> tuple[dict[str, Line2D], dict[str, Line2D]]:
    """Draw a curve a loop, hollow where a string was slack, and crosses where runs failed."""
    errors, failed = {}, {}
    for i, loop in enumerate(report.rows[0].runs):
        name, style = str(loop), curve_style(i)
        runs = report.runs(loop.controller, loop.input)
        found = np.array([np.nan if run.error is None else 1e3 * run.error for run in runs])
        (errors[name],) = ax.plot(k, found, marker=_MARKERS[i], markersize=5, label=name, **style)
        slack = np.array([run.slackened for run in runs])
        ax.plot(k[slack], found[slack], marker=_MARKERS[i], markersize=5, linestyle="none",
                color=style["color"], markerfacecolor="white", zorder=3)  # fmt: skip
        lost = np.array([run.error is None for run in runs])
        if lost.any():
            (failed[name],) = ax.plot(
                k[lost], np.full(lost.sum(), _TOP - i * _NEXT), transform=ax.get_xaxis_transform(),
                marker="X", markersize=9, linestyle="none", color=style["color"],
                markeredgecolor="black", label=f"failed: {name}", clip_on=False,
            )  # fmt: skip
    if any(run.slackened and run.error is not None for row in report.rows for run in row.runs):
        ax.plot([], [], marker="o", markersize=5, linestyle="none", color=REFERENCE_COLOR,
                markerfacecolor="white", label="a string was slack")  # fmt: skip
    return errors, failed


def _rates(ax: Axes, report: StiffnessReport, k: FloatArray) -> Line2D:
    """Draw the settling rate of the law in γ over that of its design."""
    ratio = np.array([row.held.rate_ratio for row in report.rows])
    stable = ratio > 0
    (rate,) = ax.plot(
        k, np.where(stable, ratio, np.nan), color=PALETTE[4], marker=".", linewidth=1.0
    )
    ax.plot(k[~stable], np.zeros((~stable).sum()), marker="X", markersize=8, linestyle="none",
            color=PALETTE[1], markeredgecolor="black", label="unstable")  # fmt: skip
    ax.axhline(SLOWEST, color=REFERENCE_COLOR, linewidth=REFERENCE_WIDTH, linestyle=DOTTED)
    ax.set_ylim(-0.08, max(1.08, 1.05 * float(ratio.max())))
    if not stable.all():
        ax.legend(handles=ax.lines[1:2], loc="upper right", frameon=False, fontsize="small")
    return rate
