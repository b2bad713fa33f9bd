"""The look that all figures share.

Nothing depends on colour alone. Curves differ in their dashes too, bars and strings in their width
and in how dark they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from io import BytesIO
from math import ceil
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, ParamSpec, TypeVar

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from tenscontrol import validation
from tenscontrol.files import write_file

_Arguments = ParamSpec("_Arguments")
_Value = TypeVar("_Value")

# Okabe & Ito (2008), without the yellow, which is lost on white paper.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00", "#56B4E9")

# Five dashes and seven colours: 35 curves before a pair comes again.
DASHES: tuple[Any, ...] = (
    "solid",
    (0, (6, 2)),
    (0, (1.5, 1.5)),
    (0, (6, 2, 1.5, 2)),
    (0, (6, 1.5, 1.5, 1.5, 1.5, 1.5)),
)
DOTTED: Any = (0, (1.0, 2.2))

# Strings that no winch drives: dashed, thinner and of another colour.
PASSIVE_DASHES: Any = (0, (4.0, 1.5))
STRUT_COLOR, STRUT_WIDTH = "0.5", 0.7  # of the usual width of bars
PASSIVE_COLOR, PASSIVE_WIDTH = PALETTE[2], 0.8  # of the usual width of strings

CURVE_WIDTH = 1.3
GROUND = "0.75"
REFERENCE_COLOR = "0.35"
REFERENCE_WIDTH = 1.0
GRID = MappingProxyType({"color": "0.9", "linewidth": 0.6})

# Force densities: light is little, dark is much, in grey print too. The lightest
# part of the map is left out: it is lost on white paper.
FORCE_MAP = ListedColormap(colormaps["cividis"](np.linspace(0.85, 0.0, 256)), name="force")
FORCE_WIDTH = 1.4  # of the usual width of strings

# Up to so many members are drawn at full width; many more at least at this share of it.
_FEW, _THINNEST = 30, 0.4

# Inches.
_WIDTH, _ROW_HEIGHT, _SINGLE_HEIGHT = 6.4, 2.2, 3.2

# Letters of a legend, points, and the least part of their size that letters of narrow figures have.
_LEGEND_SIZE, _LEAST_SIZE = 8.33, 0.7

# Widths of a figure in print, mm: one column of a journal, and two.
_WIDTHS = MappingProxyType({"column": 89.0, "page": 183.0})
_MM = 1 / 25.4  # inches

# Width of a legend entry, points: of its sample with the gaps, and of a letter.
_SAMPLE_WIDTH, _LETTER_WIDTH = 44.0, 5.0

_DPI = 200

# Decades below which an axis is marked between them too, and at each number.
_FEW_DECADES, _PART = 2.0, 0.5


@dataclass(frozen=True)
class MemberStyle:
    """How the members of a structure are drawn; widths and sizes in points."""

    bar_color: str
    bar_width: float
    string_color: str
    string_width: float
    node_color: str
    node_size: float
    layer: float
    fade: float = 0.0  # how much of its colour the farthest member loses

    def fitted(self, members: int) -> MemberStyle:
        """Return the style for a structure of so many members: thinner where there are many."""
        share = min(1.0, max(_THINNEST, (_FEW / max(members, 1)) ** 0.5))
        return replace(
            self,
            bar_width=share * self.bar_width,
            string_width=share * self.string_width,
            node_size=share * self.node_size,
        )


NORMAL = MemberStyle("0.15", 4.0, PALETTE[0], 1.2, "0.15", 3.8, 4.0, fade=0.5)
FAINT = MemberStyle("0.82", 3.5, "0.72", 0.9, "0.82", 4.0, 1.0)

# Beside one another, smaller.
SMALL = MemberStyle("0.15", 2.6, PALETTE[0], 0.9, "0.15", 2.4, 4.0, fade=0.6)
SMALL_FAINT = MemberStyle("0.82", 2.4, "0.72", 0.7, "0.82", 2.6, 1.0)


def curve_style(position: int) -> dict[str, Any]:
    """Return colour, dashes and width of the curve at this position in a figure."""
    color, dashes = PALETTE[position % len(PALETTE)], DASHES[position % len(DASHES)]
    return {"color": color, "linestyle": dashes, "linewidth": CURVE_WIDTH}


def marker_style(marker: str, size: float, color: str, **more: Any) -> dict[str, Any]:
    """Return the style of markers without a line; size in points."""
    return {"linestyle": "none", "marker": marker, "markersize": size, "color": color, **more}


def reference_style(position: int) -> dict[str, Any]:
    """Return colour, dashes and width of the reference line at this position."""
    dashes = DASHES[(position + 1) % len(DASHES)]
    return {"color": REFERENCE_COLOR, "linestyle": dashes, "linewidth": REFERENCE_WIDTH}


def closes_on_error(function: Callable[_Arguments, _Value]) -> Callable[_Arguments, _Value]:
    """Close the new figures of a call that raises: nobody else has them but pyplot."""

    @wraps(function)
    def drawing(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Value:
        before = set(plt.get_fignums())
        try:
            return function(*args, **kwargs)
        except BaseException:
            for number in set(plt.get_fignums()) - before:
                plt.close(number)
            raise

    return drawing


def flat_axes(ax: object, size: tuple[float, float] = (_WIDTH, _SINGLE_HEIGHT)) -> Axes:
    """Return ``ax`` if it is a pair of flat axes, new ones of a size, inches, if it is None."""
    if ax is None:
        _, ax = plt.subplots(figsize=size, layout="constrained")
    checked: Axes = checked_axes("ax", ax, "flat")
    return checked


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
    return given_axes(axes, len(names), f"one for each of {', '.join(names)}", "flat")


def timed_panels(
    axes: Sequence[Axes] | None, names: Sequence[str]
) -> Iterator[tuple[Axes, str, str | None]]:
    """Yield axes, name and time label of each panel; of new ones, only the lowest has a label."""
    for ax, name in zip(panel_axes(axes, names), names, strict=True):
        yield ax, name, "time, s" if axes is not None or name == names[-1] else None


def given_axes(axes: Sequence[Any], count: int, which: str, kind: str) -> list[Any]:
    """Return the axes that the user gives, or raise if their number or kind is wrong."""
    try:
        given = list(np.ravel(np.array(axes, dtype=object)))
    except (TypeError, ValueError):  # of what says that it is an array
        raise validation.wrong_kind(
            "axes", axes, f"a sequence of {count} matplotlib Axes: {which}"
        ) from None
    if len(given) != count:
        raise ValueError(
            f"axes has {len(given)} entries, expected {count}: {which}; "
            "leave it out for a new figure"
        )
    return [checked_axes(f"axes[{i}]", ax, kind) for i, ax in enumerate(given)]


def checked_axes(name: str, ax: object, kind: str) -> Any:
    """Return axes of a kind, flat or three-dimensional, or raise naming the argument."""
    actual = f"a {type(ax).__name__}"
    if isinstance(ax, Axes):
        actual = "three-dimensional" if ax.name == "3d" else "flat"
    if actual != kind:
        how = "subplots()" if kind == "flat" else 'figure().add_subplot(projection="3d")'
        raise TypeError(
            f"{name} is {actual}, expected {kind} matplotlib Axes: make them by plt.{how}"
        )
    return ax


def checked_indices(name: str, given: object, count: int, things: str, example: str) -> list[int]:
    """Return the numbers of some of ``count`` things, each checked to be there."""
    numbers = validation.index_list(name, given, count, f"there are {count} {things.split()[0]}s")
    if not len(numbers):
        raise TypeError(f"{name} is {given!r}, expected a sequence of {things}, like {example}")
    return numbers.tolist()  # type: ignore[no-any-return]


def dress(ax: Axes, xlabel: str | None, ylabel: str) -> None:
    """Label the axes, and take away what is not needed."""
    if xlabel is not None:
        ax.set_xlabel(xlabel)
    ax.set_ylabel(ylabel)
    ax.grid(visible=True, **GRID)  # type: ignore[arg-type]
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def decade_ticks(*axes: Axis) -> None:
    """Mark decades, no more of them than can be read; within two decades also 2 and 5."""
    for axis in axes:
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(numticks=10))
        axis.set_minor_formatter(NullFormatter())
        decades = abs(np.log10(high / low))
        if decades < _FEW_DECADES:
            subs = (1.0, 2.0, 5.0) if decades > _PART else range(1, 10)
            axis.set_major_locator(LogLocator(subs=subs))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
        axis.set_minor_locator(LogLocator(subs=(), numticks=10))


def legend_above(ax: Axes, size: float = 1.0) -> None:
    """Put the legend above the axes, where no curve can be, or none if nothing has a name.

    ``size`` is that of its letters, as part of the usual one.
    """
    handles, names = ax.get_legend_handles_labels()
    if not handles:
        return
    columns = _legend_columns(names, ax.bbox.width * 72 / ax.figure.dpi / size)
    # The legend is filled column by column, but read row by row.
    order = [i for first in range(columns) for i in range(first, len(handles), columns)]
    legend = ax.legend(
        handles=[handles[i] for i in order],
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        frameon=False,
        fontsize=size * _LEGEND_SIZE,
        handlelength=2.6,
        columnspacing=1.4,
        borderaxespad=0.2,
        borderpad=0.2,
    )
    for line in legend.get_lines():  # curves of many strings are thin, their sample is not
        line.set_linewidth(max(line.get_linewidth(), REFERENCE_WIDTH))


def _legend_columns(names: Sequence[str], room: float) -> int:
    """Return how many columns fit into a legend of this width, points."""
    width = [_SAMPLE_WIDTH + _LETTER_WIDTH * len(name) for name in names]
    count = len(names)
    for columns in range(count, 1, -1):
        if sum(max(width[first::columns]) for first in range(columns)) <= room:
            return ceil(count / ceil(count / columns))
    return 1


def save_figure(
    figure: Figure, path: str | PathLike[str], *, width: float | str | None = None
) -> Path:
    """Write a figure to a file, close it, and return where it is.

    Vector files have their fonts in them: as TrueType in ``.pdf``, as outlines in ``.svg``.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    path : str or path
        The ending says the format: ``.png``, ``.pdf``, ``.svg`` or another of matplotlib.
    width : {"column", "page"} or float, optional
        Width in print: 89 mm, one column of most journals, 183 mm, two, or a number, mm. Letters
        have at least 7 of 10 points then. As it is if not given.

    Returns
    -------
    Path

    Raises
    ------
    TypeError, ValueError
        If ``figure`` is no figure, ``path`` has no ending of a format, or ``width`` is no width.
    OSError
        If it cannot be written: a file that was there is as it was, and the figure stays open.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import tenscontrol as tc
    >>> figure = tc.plot.structure(tc.prism()).ax.figure
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     tc.plot.save_figure(figure, pathlib.Path(folder) / "prism.png").name
    'prism.png'
    """
    validation.instance("figure", figure, Figure, "take ax.figure of what was drawn")
    formats = sorted(f".{name}" for name in figure.canvas.get_supported_filetypes())
    file, buffer = validation.file_path("path", path, formats), BytesIO()
    if width is not None:
        _fit_width(figure, width)
    with rc_context({"pdf.fonttype": 42, "ps.fonttype": 42}):  # TrueType: journals take no Type 3
        figure.savefig(buffer, dpi=_DPI, format=file.suffix[1:].lower())
    write_file(file, buffer.getvalue())
    plt.close(figure)
    return file


def _fit_width(figure: Figure, width: object) -> None:
    """Give a figure a width, mm, with letters and lines that can be read."""
    if isinstance(width, str):
        width = _WIDTHS[validation.choice("width", width, _WIDTHS)]
    inches = _MM * validation.positive_number("width", width, "mm, or 'column' or 'page'", 1000.0)
    old_width, old_height = figure.get_size_inches()
    share = inches / old_width
    size = min(1.0, max(share, _LEAST_SIZE))
    is_flat = all(ax.name != "3d" for ax in figure.axes)
    # Flat axes may be lower than wide; drawings keep their form.
    figure.set_size_inches(inches, old_height * (max(share, size) if is_flat else share))
    for text in figure.findobj(Text):
        text.set_fontsize(size * text.get_fontsize())
    every: list[Any] = list(figure.axes)  # with a third axis or without
    for ax in every:
        for axis in (ax.xaxis, ax.yaxis, *([ax.zaxis] if ax.name == "3d" else [])):
            labels = axis.get_ticklabels()
            if labels:
                axis.set_tick_params(labelsize=labels[0].get_fontsize())
        for line in ax.lines:
            line.set_linewidth(size * line.get_linewidth())
        for collection in ax.collections:
            collection.set_linewidth(size * np.asarray(collection.get_linewidth()))
    if figure.get_layout_engine() is None or not is_flat:
        return
    figure.draw_without_rendering()
    for ax in figure.axes:
        if ax.get_legend() is not None:
            legend_above(ax, size)
