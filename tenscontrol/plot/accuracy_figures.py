"""Error against run time, order of convergence, stable steps, drift over long runs."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation
from matplotlib.ticker import FuncFormatter

from tenscontrol import validation
from tenscontrol.accuracy.convergence import ConvergenceOrder
from tenscontrol.accuracy.long_run import LongRun
from tenscontrol.accuracy.stability_map import StabilityMap
from tenscontrol.accuracy.work_precision import WorkPrecision
from tenscontrol.arrays import FloatArray
from tenscontrol.plot.histories import Curves
from tenscontrol.plot.style import (
    DASHES,
    PALETTE,
    REFERENCE_COLOR,
    REFERENCE_WIDTH,
    closes_on_error,
    decade_ticks,
    dress,
    flat_axes,
    legend_above,
)

_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">")
_PEER_GREYS = ("0.30", "0.45", "0.58", "0.68")

# Room for a name beside the end of a curve, as part of the width of the axes.
_NAME_ROOM = 0.22

# Least distance of two names and width of a letter, points; how far a name may be moved up or down.
_NAME_HEIGHT, _LETTER_WIDTH = 11.0, 5.5
_NAME_MOVES = (0.0, 6.0, -6.0, 11.0, -11.0, 22.0, -22.0, 33.0)

# Inches.
_SIZE = (6.8, 4.4)

# The error of the reference is drawn if it is not less than that part of the least error; else the
# axis ends below the errors.
_IN_VIEW, _ROOM_BELOW = 1e3, 30.0


@closes_on_error
def work_precision(result: WorkPrecision, *, ax: Axes | None = None) -> Curves:
    """Draw run time over error, one marker for each run: down and to the right is better.

    Our own methods are drawn in colour, others in grey and dashed. Hollow markers are errors that
    the reference does not resolve; within the grey band errors are below its own. Failed runs and
    errors beyond the size of the structure are not drawn.

    Parameters
    ----------
    result : WorkPrecision
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Returns
    -------
    Curves

    Raises
    ------
    TypeError, ValueError
        If ``result`` is of another kind, holds no run that succeeded, or
        ``ax`` is not a pair of flat axes.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, numpy as np, tenscontrol as tc
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> case = tc.Scene(tc.Model(tc.prism()), 0.2, force_density=gamma)
    >>> found = tc.work_precision(case, ["rk4"], {"rk4": [0.02, 0.01]}, repeats=1, outputs=10)
    >>> drawn = tc.plot.work_precision(found)
    >>> drawn.ax.get_xscale(), list(drawn.lines)
    ('log', ['rk4'])
    >>> plt.close(drawn.ax.figure)
    """
    validation.instance("result", result, WorkPrecision, "make one by work_precision(scene)")
    ax = flat_axes(ax, _SIZE)
    lines: dict[str, tuple[Line2D, ...]] = {}
    ends: dict[str, tuple[float, float, Any]] = {}
    names = (*result.methods, *result.peers)
    for position, name in enumerate(names):
        peer = position - len(result.methods)
        style = _method_style(position) if peer < 0 else _peer_style(peer)
        # An error beyond the structure's size says nothing any more.
        rows = [row for row in result.of(name) if row.relative_error < 1]
        if not rows:
            continue
        error = np.array([max(row.error, result.reference.error) for row in rows])
        time = np.array([row.time for row in rows])
        clear = np.array([result.is_resolved(row) for row in rows])
        (line,) = ax.plot(error, time, label=name, **style)
        own = {"marker": style["marker"], "color": style["color"], "markerfacecolor": "white"}
        (hollow,) = ax.plot(
            error[~clear], time[~clear], ls="none", markersize=6.5, label="_", zorder=4, **own
        )
        lines[name] = (line, hollow)
        ends[name] = (float(error[-1]), float(time[-1]), style["color"])
    if not ends:
        raise ValueError("result has no run with an error below the size of the structure")
    title = f"{result.case.name or 'error against run time'}, {result.case.duration:g} s"
    if result.failures:
        title += f"; {len(result.failures)} of {len(result.rows)} runs failed"
    _logarithmic(ax, "largest error of a node, m", "run time, s", title)
    ax.invert_xaxis()
    reference = _reference_band(ax, result.reference.error)
    _name_ends(ax, ends)
    decade_ticks(ax.xaxis, ax.yaxis)
    return Curves(ax, lines, {"reference": reference}, {})


@closes_on_error
def convergence_order(result: ConvergenceOrder, *, ax: Axes | None = None) -> Curves:
    """Draw error over step with the fitted line and a triangle of its slope.

    Hollow markers are runs that are not fitted.

    Parameters
    ----------
    result : ConvergenceOrder
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Returns
    -------
    Curves

    Raises
    ------
    TypeError
        If ``result`` is of another kind, or ``ax`` is not a pair of flat axes.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, numpy as np, tenscontrol as tc
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> case = tc.Scene(tc.Model(tc.prism()), 0.2, force_density=gamma)
    >>> found = tc.convergence_order(case, "rk4", [0.01, 0.005, 0.0025], outputs=5)
    >>> list(tc.plot.convergence_order(found).lines)
    ['rk4']
    >>> plt.close("all")
    """
    validation.instance(
        "result", result, ConvergenceOrder, "make one by convergence_order(scene, method)"
    )
    ax = flat_axes(ax)
    style = _method_style(0) | {"linestyle": "none"}
    clean = result.is_clean
    (fitted,) = ax.plot(result.step[clean], result.error[clean], label=result.method, **style)
    # The legend names them only where there are some.
    left_out = "_not fitted" if clean.all() else "not fitted"
    (others,) = ax.plot(result.step[~clean], result.error[~clean], label=left_out, **style)
    others.set_markerfacecolor("white")
    _logarithmic(ax, "step, s", "largest error of a node, m")
    references = {}
    if np.isfinite(result.order):
        ends = np.array([result.step[clean].min(), result.step[clean].max()])
        (references["fit"],) = ax.plot(
            ends,
            result.constant * ends**result.order,
            color=style["color"],
            linewidth=REFERENCE_WIDTH,
            label=f"fit, order {result.order:.2f} ± {result.deviation:.2f}",
        )
        _slope_triangle(ax, ends, result)
    references["reference"] = ax.axhline(
        result.reference_error, color=REFERENCE_COLOR, linestyle=DASHES[2], linewidth=1.0
    )
    references["reference"].set_label(f"error of the reference, {result.reference_error:.1g} m")
    least = float(result.error.min())
    if result.reference_error < least / _IN_VIEW:
        ax.set_ylim(bottom=least / _ROOM_BELOW)
    legend_above(ax)
    decade_ticks(ax.xaxis, ax.yaxis)
    return Curves(ax, {result.method: (fitted, others)}, references, {})


@closes_on_error
def stability_map(result: StabilityMap, *, ax: Axes | None = None) -> Curves:
    """Draw the largest stable step over stiffness, a curve for each mass ratio.

    Lines without markers are the bound by theory, where one is known.

    Parameters
    ----------
    result : StabilityMap
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Returns
    -------
    Curves

    Raises
    ------
    TypeError
        If ``result`` is of another kind, or ``ax`` is not a pair of flat axes.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> found = tc.stability_map("rk4", [1e2, 1e3], [0.1], steps=200)
    >>> list(tc.plot.stability_map(found).lines)
    ['mass ratio 0.1']
    >>> plt.close("all")
    """
    validation.instance("result", result, StabilityMap, "make one by stability_map(method)")
    ax = flat_axes(ax)
    lines, references, ends = {}, {}, {}
    has_bound = bool(np.isfinite(result.limit))
    for j, ratio in enumerate(result.mass_ratio):
        name = f"mass ratio {ratio:.3g}"
        style = _method_style(j) | {"linestyle": "none"}
        step = np.where(np.isfinite(result.step[:, j]), result.step[:, j], np.nan)
        lines[name] = tuple(ax.plot(result.stiffness, step, label="_", **style))
        if has_bound:
            (references[name],) = ax.plot(
                result.stiffness,
                result.bound[:, j],
                color=style["color"],
                linestyle=DASHES[j % len(DASHES)],
                linewidth=1.2,
                zorder=1.8,
            )
        if np.isfinite(step[-1]):
            ends[name] = (float(result.stiffness[-1]), float(step[-1]), style["color"])
    text = f"{result.method}: markers measured"
    if has_bound:
        text += f", lines h ω = {result.limit:.3f}"
    _logarithmic(ax, "stiffness of a string, N/m", "largest stable step, s", text)
    _name_ends(ax, ends)
    decade_ticks(ax.xaxis, ax.yaxis)
    return Curves(ax, lines, references, {})


@closes_on_error
def long_run(result: LongRun, *, ax: Axes | None = None) -> Curves:
    """Draw the error of the energy over a long run, with its slope.

    Where the motion conserves no energy, how far bars are off their length is drawn instead.

    Parameters
    ----------
    result : LongRun
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Returns
    -------
    Curves

    Raises
    ------
    TypeError
        If ``result`` is of another kind, or ``ax`` is not a pair of flat axes.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, numpy as np, tenscontrol as tc
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> case = tc.Scene(tc.Model(tc.prism()), 1.0, force_density=gamma)
    >>> found = tc.long_run(case, "rk4", 2e-3, steps=2000, outputs=100)
    >>> drawn = tc.plot.long_run(found)
    >>> list(drawn.lines), list(drawn.references)
    (['energy'], ['slope'])
    >>> plt.close("all")
    """
    validation.instance("result", result, LongRun, "make one by long_run(scene, method, setting)")
    ax = flat_axes(ax)
    drift, scale, label = result.drifts[0], 1.0, f"change of {result.drifts[0].name}"
    if drift.name == "energy" and result.energy_scale > 0:
        scale, label = result.energy_scale, f"{label},\npart of what is exchanged"
    else:
        label = f"{label}, {drift.unit}".replace("^2", "²")
    (line,) = ax.plot(result.time, drift.error / scale, color=PALETTE[0], linewidth=0.7)
    line.set_label(f"{result.method} at {result.setting:g}, {result.work.steps} steps")
    middle, level = float(result.time.mean()), float(drift.error.mean())
    (slope,) = ax.plot(
        result.time,
        (level + drift.slope * (result.time - middle)) / scale,
        color=PALETTE[1],
        linestyle=DASHES[1],
        linewidth=1.4,
    )
    sign = "no slope found" if drift.is_zero else "slope"
    slope.set_label(f"{sign}: {drift.slope / scale:+.1e} ± {drift.half_width / scale:.0e} per s")
    dress(ax, "time, s", label)
    ax.set_xlim(0, result.time[-1])
    # Without a common factor above the axis, where the legend is.
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
    legend_above(ax)
    return Curves(ax, {drift.name: (line,)}, {"slope": slope}, {})


def _logarithmic(ax: Axes, xlabel: str, ylabel: str, title: str = "") -> None:
    ax.set(xscale="log", yscale="log")
    dress(ax, xlabel, ylabel)
    if title:
        ax.set_title(title, loc="left", fontsize="medium")


def _note(
    ax: Axes, text: str, at: tuple[float, float], offset: tuple[float, float], **style: Any
) -> Annotation:
    """Write a text at a place of the data, moved by an offset in points."""
    return ax.annotate(text, at, xytext=offset, textcoords="offset points", **style)


def _method_style(position: int) -> dict[str, Any]:
    color, marker = PALETTE[position % len(PALETTE)], _MARKERS[position % len(_MARKERS)]
    line = {"linestyle": "solid", "linewidth": 1.5, "zorder": 3}
    return {"color": color, "marker": marker, "markersize": 5.5, **line}


def _peer_style(position: int) -> dict[str, Any]:
    color = _PEER_GREYS[position % len(_PEER_GREYS)]
    marker = _MARKERS[(position + 4) % len(_MARKERS)]
    line = {"linestyle": DASHES[1 + position % (len(DASHES) - 1)], "linewidth": 1.1, "zorder": 2}
    return {"color": color, "marker": marker, "markersize": 4.5, **line}


def _reference_band(ax: Axes, error: float) -> Line2D:
    """Shade what the reference does not resolve, if errors come near it."""
    low = ax.get_xlim()[1]
    line = ax.axvline(error, color=REFERENCE_COLOR, linewidth=0.8, linestyle=DASHES[2], zorder=1)
    # Far beyond the limits, so that the shade stays when a user zooms out.
    ax.axvspan(1e-30, error, color="0.95", linewidth=0, zorder=0)
    if error < low / _IN_VIEW:
        ax.set_xlim(right=low)
        return line
    ax.set_xlim(right=min(low, error / 1.5))
    style = {"ha": "left", "va": "bottom", "fontsize": "x-small", "color": REFERENCE_COLOR}
    share = ("data", "axes fraction")
    _note(ax, "error of the reference", (error, 0.02), (4, 0), xycoords=share, **style)
    return line


def _name_ends(ax: Axes, ends: dict[str, tuple[float, float, Any]]) -> None:
    """Write each name beside the end of its curve; names that would touch are moved apart."""
    left, right = np.log10(ax.get_xlim())
    ax.set_xlim(10**left, 10 ** (right + _NAME_ROOM * (right - left)))
    points = 72 / ax.figure.dpi
    taken: list[tuple[float, float, float]] = []
    for name, (x, y, color) in sorted(ends.items(), key=lambda end: end[1][1]):
        across, up = np.asarray(ax.transData.transform((x, y))) * points
        width = _LETTER_WIDTH * len(name)
        moves = [
            move
            for move in _NAME_MOVES
            if not any(
                abs(up + move - other_up) < _NAME_HEIGHT
                and across < other + other_width
                and other < across + width
                for other, other_up, other_width in taken
            )
        ]
        move = moves[0] if moves else 0.0
        taken.append((across, up + move, width))
        style = {"va": "center", "fontsize": "small", "color": color, "zorder": 5}
        text = _note(ax, name, (x, y), (7, move), **style)
        text.set_path_effects([withStroke(linewidth=2.5, foreground="white")])


def _slope_triangle(ax: Axes, ends: FloatArray, result: ConvergenceOrder) -> None:
    """Draw the triangle of the nearest whole order below the fitted line."""
    order = round(result.order)
    middle = float(np.sqrt(ends.prod()))
    width = float((ends[1] / ends[0]) ** 0.25)
    x = np.array([middle, middle * width, middle * width, middle])
    foot = result.constant * middle**result.order / 6
    y = foot * np.array([1.0, 1.0, width**order, 1.0])
    ax.plot(x, y, color="0.35", linewidth=0.9, label="_")
    beside = (float(x[1]), float(foot * width ** (order / 2)))
    below = (float(np.sqrt(x[0] * x[1])), foot)
    _note(ax, str(order), beside, (4, 0), va="center", color="0.35")
    _note(ax, "1", below, (0, -4), va="top", ha="center", color="0.35")
