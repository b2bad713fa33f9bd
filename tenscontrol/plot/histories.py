"""Curves over time, with reference lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.plot.style import (
    PALETTE,
    closes_on_error,
    curve_style,
    dress,
    flat_axes,
    legend_above,
    marker_style,
    reference_style,
)
from tenscontrol.short_repr import short_repr

# Up to so many curves of one name have full width; many more at least this share of it.
_FEW, _THINNEST = 4, 0.35


@dataclass(frozen=True, eq=False)
class Curves:
    """What was drawn into one pair of flat axes. Made by :func:`history` and its kin.

    Attributes
    ----------
    ax : Axes
        Where it was drawn.
    lines : dict of str to tuple of Line2D
        The curves of each name.
    references : dict of str to Line2D
        The reference lines.
    marks : dict of str to Line2D
        The marks on the time axis.
    """

    ax: Axes
    lines: dict[str, tuple[Line2D, ...]]
    references: dict[str, Line2D]
    marks: dict[str, Line2D]

    __repr__ = short_repr


@closes_on_error
def history(
    time: object,
    series: Mapping[str, object],
    ylabel: str,
    *,
    ax: Axes | None = None,
    references: Mapping[str, object] | None = None,
) -> Curves:
    """Draw quantities over time, one colour and dash style for each name.

    Parameters
    ----------
    time : array_like, shape (T,)
        s, ascending.
    series : mapping of str to array_like, shape (T,) or (k, T)
        The quantities by the name that the legend shows. Several rows share
        the name and the style: the strings of one group, say.
    ylabel : str
        What the quantities are, with their unit: ``"height, m"``.
    ax : Axes, optional
        Where to draw; a new figure if not given.
    references : mapping of str to float or array_like, shape (T,), optional
        Grey lines to compare with, by name: a target, a limit.

    Returns
    -------
    Curves

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, does not fit or is not finite,
        ``time`` does not ascend, or ``ax`` is not a pair of flat axes.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, numpy as np, tenscontrol as tc
    >>> time = np.linspace(0, 1, 50)
    >>> curves = tc.plot.history(
    ...     time, {"top": np.cos(time)}, "height, m", references={"target": 0.85})
    >>> curves.ax.get_xlabel(), curves.ax.get_ylabel(), list(curves.references)
    ('time, s', 'height, m', ['target'])
    >>> plt.close(curves.ax.figure)
    """
    times = _checked_time(time)
    rows = {
        name: _checked_rows(name, values, len(times))
        for name, values in _checked_mapping("series", series).items()
    }
    levels = checked_references(references, len(times))
    validation.text("ylabel", ylabel, "the quantity with its unit, like 'height, m'")
    return draw_curves(flat_axes(ax), times, rows, ylabel, references=levels)


def draw_curves(
    ax: Axes,
    time: FloatArray,
    rows: Mapping[str, FloatArray],
    ylabel: str,
    *,
    references: Mapping[str, FloatArray] | None = None,
    held: bool = False,
    xlabel: str | None = "time, s",
) -> Curves:
    """Draw checked curves, rows of shape (k, T); a held quantity is drawn in steps."""
    lines = {}
    for position, (name, values) in enumerate(rows.items()):
        style = curve_style(position)
        style["linewidth"] *= min(1.0, max(_THINNEST, (_FEW / max(len(values), 1)) ** 0.5))
        drawn = ax.plot(
            time,
            values.T,
            label=_entry(name),
            drawstyle="steps-pre" if held else "default",
            **style,
        )
        for line in drawn[1:]:
            line.set_label("_")  # one entry in the legend for all rows
        lines[name] = tuple(drawn)
    levels = {}
    for position, (name, level) in enumerate((references or {}).items()):
        (levels[name],) = ax.plot(
            time,
            np.broadcast_to(level, time.shape),
            label=_entry(name),
            zorder=1.8,
            **reference_style(position),
        )
    dress(ax, xlabel, ylabel)
    if time[-1] > time[0]:
        ax.set_xlim(time[0], time[-1])
    legend_above(ax)
    return Curves(ax, lines, levels, {})


def drop_repeated_legends(panels: Mapping[str, Curves]) -> None:
    """Leave one legend of those that say the same, in a figure of panels below each other."""
    seen: list[list[str]] = []
    for panel in panels.values():
        names = panel.ax.get_legend_handles_labels()[1]
        legend = panel.ax.get_legend()
        if names in seen and legend is not None:
            legend.remove()
        seen.append(names)


def checked_references(references: object, count: int) -> dict[str, FloatArray]:
    """Return the reference lines as arrays of shape () or (T,)."""
    levels = {}
    for name, value in _checked_mapping(
        "references", {} if references is None else references
    ).items():
        array = validation.float_array(f"references[{name!r}]", value)
        if array.shape not in ((), (count,)):
            raise ValueError(
                f"references[{name!r}] has shape {array.shape}, expected () or ({count},): "
                "one number, or one per time"
            )
        levels[name] = array
    return levels


def _checked_time(time: object) -> FloatArray:
    times = validation.float_array("time", time)
    if times.ndim != 1 or len(times) == 0:
        raise ValueError(f"time has shape {times.shape}, expected (T,) with at least one time in s")
    back = np.flatnonzero(np.diff(times) < 0)
    if len(back):
        raise ValueError(
            f"time[{back[0] + 1}] is {times[back[0] + 1]:g}, expected at least "
            f"time[{back[0]}] = {times[back[0]]:g}: times in s, ascending"
        )
    return times


def _checked_rows(name: str, values: object, count: int) -> FloatArray:
    array = validation.float_array(f"series[{name!r}]", values)
    if array.ndim not in (1, 2) or array.shape[-1] != count:
        raise ValueError(
            f"series[{name!r}] has shape {array.shape}, expected ({count},) or (k, {count}): "
            "one number per time in a row"
        )
    return np.atleast_2d(array)


def _checked_mapping(name: str, mapping: object) -> Mapping[str, object]:
    if not isinstance(mapping, Mapping):
        raise validation.wrong_kind(name, mapping, "a dict from names to numbers")
    for key in mapping:
        if not isinstance(key, str):
            raise TypeError(f"{name} has the key {key!r}, expected text for the legend")
    return mapping


def _entry(name: str) -> str:
    """Return a name as the legend shows it: matplotlib hides names that begin with _."""
    return name if not name.startswith("_") else f"\u200b{name}"


def mark_statuses(
    panel: Curves,
    time: FloatArray,
    statuses: Sequence[str],
    markers: Mapping[str, str],
    height: float = 0.0,
) -> Curves:
    """Mark the samples (K,), s, whose status has a marker; the legend is left as it is."""
    marks: dict[str, Line2D] = {}
    for position, (status, marker) in enumerate(markers.items()):
        marked = np.array([other == status for other in statuses])
        if not marked.any():
            continue
        color = PALETTE[(position + 1) % len(PALETTE)]
        (marks[status],) = panel.ax.plot(
            time[marked],
            np.full(int(marked.sum()), height),
            transform=panel.ax.get_xaxis_transform(),
            label=f"{status} (×{int(marked.sum())})",
            **marker_style(marker, 5.0, color, clip_on=False, zorder=4),
        )
    return replace(panel, marks=panel.marks | marks)
