"""A structure drawn in space, which can be moved to other node positions."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from tenscontrol.plot.style import (
    DOTTED,
    FAINT,
    FORCE_MAP,
    FORCE_WIDTH,
    NORMAL,
    MemberStyle,
    marker_style,
)
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, IntArray, instance, non_negative, per_member

# A string below this fraction of the largest force density carries nothing.
_SLACK = 1e-9

# Distance of a node's number from the node, relative to the size of the structure.
_LABEL_DISTANCE = 0.08

# Room for the colour scale, inches.
_SCALE_WIDTH = 0.9

# White behind a number, so that it can be read on top of a member.
_CARD = {"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}

SIZE = (5.0, 4.5)  # inches

# Room for the axes in the figure: what they hold keeps away from their edges by itself.
FILLED = MappingProxyType({"left": 0.0, "right": 0.97, "bottom": 0.0, "top": 1.0})

_MARGIN = 0.05  # around the nodes, relative to the largest extent
_THINNEST = 0.25  # least extent of the box in a direction, relative to the largest
_TICKS = 4  # along the longest edge
_CORNER = 0.04  # of an edge, without ticks

# Points; the offsets are what Matplotlib adds itself.
_LABEL_PAD = {"x": 2.0, "y": 6.0, "z": 5.0}
_LABEL_OFFSET, _TICK_OFFSET = 21.0, 8.0

_PAPER: Any = {"grid.color": "0.88", "grid.linewidth": 0.6} | {
    f"axes3d.{axis}axis.panecolor": (1.0, 1.0, 1.0, 0.0) for axis in "xyz"
}


class _InnerTicks(MaxNLocator):
    """Round numbers, but none in the corners, where those of two axes would meet."""

    def tick_values(self, vmin: float, vmax: float) -> Any:
        ticks = np.asarray(super().tick_values(vmin, vmax))
        corner = _CORNER * (vmax - vmin)
        return ticks[(ticks > vmin + corner) & (ticks < vmax - corner)]


def space_axes(ax: object, beside: float) -> Any:
    """Return ``ax`` if it is three-dimensional; new axes with room beside, inches, if None."""
    if ax is None:
        figure = plt.figure(figsize=(SIZE[0] + beside, SIZE[1]))
        figure.subplots_adjust(**FILLED)
        return new_space(figure)
    return checked_space("ax", ax)


def checked_space(name: str, ax: object) -> Any:
    """Return ``ax`` if it is three-dimensional, or raise naming the argument."""
    if not isinstance(ax, Axes) or ax.name != "3d":
        found = "flat" if isinstance(ax, Axes) else f"a {type(ax).__name__}"
        raise TypeError(
            f"{name} is {found}, expected three-dimensional axes: make them by "
            'plt.figure().add_subplot(projection="3d")'
        )
    return ax


def new_space(figure: Figure, rows: int = 1, columns: int = 1, index: int = 1) -> Any:
    """Return new three-dimensional axes at a place in the figure's grid, without grey walls."""
    with mpl.rc_context(_PAPER):
        ax: Any = figure.add_subplot(rows, columns, index, projection="3d", computed_zorder=False)
    ax.view_init(elev=20, azim=-60)
    return ax


def frame(ax: Any, points: Iterable[FloatArray], grow: bool, fill: float = 0.77) -> None:
    """Set limits that hold all points (3, ·), with ``grow`` the former; ``fill`` of the axes."""
    corners = np.hstack(list(points))
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    largest = max(float((upper - lower).max()), 1e-9)
    centre, half = (lower + upper) / 2, (upper - lower) / 2
    half = np.maximum(half + _MARGIN * largest, _THINNEST * largest / 2)
    lower, upper = centre - half, centre + half
    if grow:
        before = np.array([ax.get_xlim3d(), ax.get_ylim3d(), ax.get_zlim3d()])
        lower, upper = np.minimum(lower, before[:, 0]), np.maximum(upper, before[:, 1])
    ax.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    extent = upper - lower
    ax.set_box_aspect(extent, zoom=fill / _seen(ax, extent / np.linalg.norm(extent)))
    for axis, share in zip((ax.xaxis, ax.yaxis, ax.zaxis), extent / extent.max(), strict=True):
        axis.set_major_locator(_InnerTicks(max(2, round(_TICKS * share)), min_n_ticks=1))


def label_space(ax: Any) -> None:
    """Label the three axes with their unit. To be called after :func:`frame`."""
    ax.set(xlabel="x, m", ylabel="y, m", zlabel="z, m")
    extent = np.ptp([ax.get_xlim3d(), ax.get_ylim3d(), ax.get_zlim3d()], axis=1)
    # Matplotlib moves numbers and labels outward by shares of the box's other
    # two edges, not by points: over short edges they need more.
    for i, (name, pad) in enumerate(_LABEL_PAD.items()):
        others = np.linalg.norm(np.delete(extent, i)) / np.linalg.norm(extent)
        more = np.sqrt(2 / 3) / others
        ax.tick_params(axis=name, labelsize="small", pad=(_TICK_OFFSET + 1) * more - _TICK_OFFSET)
        axis = getattr(ax, f"{name}axis")
        axis.labelpad = (_LABEL_OFFSET + pad) * more - _LABEL_OFFSET


def _seen(ax: Any, edges: FloatArray) -> float:
    """Return the larger of height and width of a box as it is seen, without perspective."""
    x, y, z = edges
    elevation, azimuth = np.deg2rad([ax.elev, ax.azim])
    width = x * abs(np.sin(azimuth)) + y * abs(np.cos(azimuth))
    depth = x * abs(np.cos(azimuth)) + y * abs(np.sin(azimuth))
    height = z * abs(np.cos(elevation)) + depth * abs(np.sin(elevation))
    return float(max(width, height))


@dataclass(frozen=True, eq=False)
class Drawing:
    """What was drawn of a structure. Made by :func:`tenscontrol.plot.structure`.

    Attributes
    ----------
    structure : Structure
    ax : Axes3D
        Where it was drawn.
    bars, strings : Line3DCollection
        One segment for each member, in the order of the structure.
    nodes : Line3D
        One marker for each node.
    node_labels, bar_labels, string_labels : tuple of Text3D
        The numbers, empty where there are none.
    colorbar : Colorbar or None
        The scale of the force densities.
    """

    structure: Structure
    ax: Any
    bars: Any
    strings: Any
    nodes: Any
    node_labels: tuple[Any, ...]
    bar_labels: tuple[Any, ...]
    string_labels: tuple[Any, ...]
    colorbar: Any

    def update(self, nodes: object, force_density: object = None) -> None:
        """Move the drawing to other node positions. The limits of the axes stay.

        Parameters
        ----------
        nodes : array_like, shape (3, n)
            Node positions, m.
        force_density : float or array_like, shape (α,), optional
            γ, N/m: slack strings become dotted, and the colours follow where
            the drawing has a colour scale. Strings look as before if not given.

        Raises
        ------
        TypeError, ValueError
            If an argument does not fit or is not finite, or γ is negative.
        """
        positions = self.structure.checked_nodes("nodes", nodes)
        if force_density is not None:
            gamma = checked_force_density(self.structure, force_density)
            self.strings.set_linestyle(string_dashes(gamma))
            if self.colorbar is not None:
                self.strings.set_array(gamma)
        self.bars.set_segments(segments(positions, self.structure.bars))
        self.strings.set_segments(segments(positions, self.structure.strings))
        self.nodes.set_data_3d(*positions)
        places = label_places(self.structure, positions)
        for texts, where in zip(
            (self.node_labels, self.bar_labels, self.string_labels), places, strict=True
        ):
            for text, place in zip(texts, where, strict=False):
                text.set_position_3d(place)


def draw(ax: Any, structure: Structure, nodes: FloatArray, style: MemberStyle) -> Drawing:
    """Draw bars, strings and nodes in one style, without numbers or colour scale."""
    style = style.fitted(len(structure.bars) + len(structure.strings))
    strings = Line3DCollection(
        segments(nodes, structure.strings),
        colors=style.string_color,
        linewidths=style.string_width,
        zorder=style.layer,
    )
    bars = Line3DCollection(
        segments(nodes, structure.bars),
        colors=style.bar_color,
        linewidths=style.bar_width,
        capstyle="round",
        zorder=style.layer + 0.3,
    )
    for members, pairs in ((strings, structure.strings), (bars, structure.bars)):
        if len(pairs):  # Matplotlib cannot find the limits of nothing
            ax.add_collection3d(members)
    dot = marker_style("o", style.node_size, style.node_color)
    (dots,) = ax.plot(*nodes, zorder=style.layer + 0.6, **dot)
    if len(structure.fixed):  # they stay where they are, so nothing updates them
        triangle = marker_style("^", 2.2 * style.node_size, style.node_color, mfc="white")
        ax.plot(*nodes[:, structure.fixed], zorder=style.layer + 0.5, **triangle)
    return Drawing(structure, ax, bars, strings, dots, (), (), (), None)


def color_by_force(strings: Any, gamma: FloatArray) -> None:
    """Colour the strings by force density, from 0 to the largest. Slack ones are dotted."""
    strings.set_edgecolor(None)  # the colour given before would win over the map
    strings.set_linewidth(FORCE_WIDTH * np.asarray(strings.get_linewidth()))
    strings.set_cmap(FORCE_MAP)
    strings.set_array(gamma)
    strings.set_clim(0.0, float(gamma.max(initial=0.0)) or 1.0)
    strings.set_linestyle(string_dashes(gamma))


def checked_force_density(structure: Structure, force_density: object) -> FloatArray:
    """Return γ, one for each string, at least 0; or raise naming the argument."""
    gamma = per_member("force_density", force_density, len(structure.strings), "string")
    return non_negative("force_density", gamma, "a string can only pull")


def is_slack(gamma: FloatArray) -> np.ndarray:
    """Return which strings carry nothing, bool, shape (α,)."""
    return np.asarray(gamma <= _SLACK * gamma.max(initial=0.0))


def string_dashes(gamma: FloatArray) -> list[Any]:
    """Return the dashes of each string: solid where it is taut, dotted where it is slack."""
    return [DOTTED if slack else "solid" for slack in is_slack(gamma)] or ["solid"]


def segments(nodes: FloatArray, members: IntArray) -> FloatArray:
    """Return the ends of each member, shape (count, 2, 3), m."""
    return np.asarray(nodes.T[members])


def label_places(
    structure: Structure, nodes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return where the numbers of nodes, bars and strings go, shape (count, 3) each, m."""
    points = nodes.T
    outward = points - points.mean(axis=0)
    distance = np.linalg.norm(outward, axis=1, keepdims=True)
    outward = outward / np.maximum(distance, 1e-300)
    shift = _LABEL_DISTANCE * float(np.ptp(nodes, axis=1).max())
    # A third along a bar, not half: bars that cross in the middle keep their numbers apart.
    bars = points[structure.bars[:, 0]] * (2 / 3) + points[structure.bars[:, 1]] / 3
    return points + shift * outward, bars, segments(nodes, structure.strings).mean(axis=1)


def legend_samples(structure: Structure, slack: bool, colored: bool = False) -> list[Line2D]:
    """Return the samples of members that a legend shows, of those kinds that there are."""
    bar = {"color": NORMAL.bar_color, "linewidth": NORMAL.bar_width, "solid_capstyle": "round"}
    # Where the colours of strings have a scale of their own, the sample has none of them.
    color = "0.4" if colored else NORMAL.string_color
    string = {"color": color, "linewidth": NORMAL.string_width}
    samples = {
        "bar": (bar, len(structure.bars) > 0),
        "string": (string, len(structure.strings) > 0),
        "slack string": ({"linestyle": DOTTED, **string}, slack),
    }
    return [sample(label, **style) for label, (style, shown) in samples.items() if shown]


def sample(label: str, **style: Any) -> Line2D:
    """Return a line that is drawn in a legend only."""
    return Line2D([], [], label=label, **style)


def structure(
    structure: Structure,
    nodes: object = None,
    *,
    ax: Any = None,
    force_density: object = None,
    labels: bool = False,
    member_labels: bool = False,
    faint: bool = False,
    legend: bool = True,
) -> Drawing:
    """Draw a structure in space: thick dark bars, thin strings, one scale in all directions.

    Fixed nodes stand on triangles. Drawn into axes that hold a drawing
    already, the limits grow to hold both.

    Parameters
    ----------
    structure : Structure
    nodes : array_like, shape (3, n), optional
        Node positions, m; the reference shape if not given.
    ax : Axes3D, optional
        Where to draw; a new figure if not given.
    force_density : float or array_like, shape (α,), optional
        γ, N/m. Colours the strings, with a colour scale from 0 to the largest,
        and draws slack strings (γ = 0) dotted.
    labels : bool
        Whether to number the nodes.
    member_labels : bool
        Whether to number the bars (b0, b1, …) and the strings (s0, s1, …).
    faint : bool
        Whether to draw in light grey, without legend: a target or reference
        shape behind another drawing.
    legend : bool
        Whether to show a legend.

    Returns
    -------
    Drawing
        The artists, and ``update(nodes)`` to move them.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, does not fit or is not finite, γ
        is negative, or ``ax`` is flat.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> prism = tc.prism()
    >>> rest = tc.prestress(prism, force_density=17.3205)
    >>> drawing = tc.plot.structure(prism, force_density=rest.force_density, labels=True)
    >>> drawing.ax.get_zlabel(), drawing.colorbar.ax.get_ylabel()
    ('z, m', 'γ, N/m')
    >>> plt.close(drawing.ax.figure)
    """
    instance("structure", structure, Structure, "make one by Structure(...) or prism(...)")
    shape = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    gamma = None
    if force_density is not None:
        gamma = checked_force_density(structure, force_density)
    own = ax is None
    ax = space_axes(ax, beside=0.0 if gamma is None else _SCALE_WIDTH)
    grow = ax.has_data()
    drawing = draw(ax, structure, shape, FAINT if faint else NORMAL)
    frame(ax, [shape], grow=grow)
    label_space(ax)
    drawing = _numbered(drawing, shape, labels, member_labels)
    if gamma is not None:
        color_by_force(drawing.strings, gamma)
        gap = 0.02 if own else 0.14  # new axes have room of their own
        bar = ax.figure.colorbar(
            drawing.strings, ax=ax, shrink=0.6, pad=gap, aspect=18, label="γ, N/m"
        )
        drawing = replace(drawing, colorbar=bar)
    if legend and not faint:
        slack = gamma is not None and bool(is_slack(gamma).any())
        samples = legend_samples(structure, slack, colored=gamma is not None)
        ax.legend(handles=samples, loc="upper left", frameon=False, fontsize="small")
    return drawing


def _numbered(drawing: Drawing, shape: FloatArray, nodes: bool, members: bool) -> Drawing:
    of_nodes, of_bars, of_strings = label_places(drawing.structure, shape)

    def write(places: FloatArray, sign: str, shown: bool, color: str) -> tuple[Any, ...]:
        style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": "small", "bbox": _CARD}
        return tuple(
            drawing.ax.text(*place, f"{sign}{i}", color=color, zorder=6, **style)
            for i, place in enumerate(places if shown else [])
        )

    return replace(
        drawing,
        node_labels=write(of_nodes, "", nodes, "black"),
        bar_labels=write(of_bars, "b", members, NORMAL.bar_color),
        string_labels=write(of_strings, "s", members, NORMAL.string_color),
    )
