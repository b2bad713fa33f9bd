"""A structure drawn in space or in the plane, which can be moved to other node positions."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.path import Path as Outline
from matplotlib.ticker import MaxNLocator

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    Actuation,
    actuation_of,
    member_rows,
    of_members,
)
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.string_outputs import to_model_strings
from tenscontrol.plot.depth_cue import DepthLines
from tenscontrol.plot.ground_drawing import add_ground, ground_samples, near_ground, touching
from tenscontrol.plot.number_labels import NumberPlaces, write_numbers
from tenscontrol.plot.style import (
    DOTTED,
    FAINT,
    FORCE_MAP,
    FORCE_WIDTH,
    NORMAL,
    PALETTE,
    PASSIVE_COLOR,
    PASSIVE_DASHES,
    PASSIVE_WIDTH,
    SMALL,
    STRUT_COLOR,
    STRUT_WIDTH,
    MemberStyle,
    checked_axes,
    closes_on_error,
    dress,
    marker_style,
)
from tenscontrol.shape.shape_path import ShapePath
from tenscontrol.shape.target import ShapeTarget
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.structure import Structure

# A string below this fraction of the largest force density carries nothing.
_SLACK = 1e-9

# Room for the colour scale beside the axes, width and share of the height of the scale; inches.
_SCALE_ROOM, _SCALE_WIDTH, _SCALE_SHARE = 0.9, 0.14, 0.6

SIZE = (5.0, 4.5)  # inches

# Room for the axes in the figure: what they hold keeps away from their edges by itself.
FILLED = MappingProxyType({"left": 0.0, "right": 0.97, "bottom": 0.0, "top": 1.0})
_FILLED_FLAT = MappingProxyType({"left": 0.16, "right": 0.97, "bottom": 0.11, "top": 0.88})

_MARGIN = 0.05  # around the nodes, relative to the largest extent
_FLAT_MARGIN = 0.12  # in the plane, where supports are drawn beside their nodes
_THINNEST = 0.25  # least extent of the box in a direction, relative to the largest
_TICKS = 4  # along the longest edge
_CORNER = 0.04  # of an edge, without ticks

# Of many arrows, so many are drawn.
_ARROW, _MOST_ARROWS = PALETTE[1], 24

# Points; the offsets are what Matplotlib adds itself.
_LABEL_PAD = {"x": 5.0, "y": 7.0, "z": 10.0}
_LABEL_OFFSET, _TICK_OFFSET = 21.0, 8.0

# A triangle that stands on a line and holds what is above its tip, of size 1.
_ROLLER = np.array(
    [(0, 0), (0.5, -0.75), (-0.5, -0.75), (0, 0), (-0.55, -1.0), (0.55, -1.0)], dtype=float
)
_STROKES = [Outline.MOVETO, *[Outline.LINETO] * 3, Outline.MOVETO, Outline.LINETO]

# Marks of nodes: size in node sizes, and layer above that of the members.
_MARKS = {"joint": (1.5, 0.65), "pulley": (2.4, 0.25), "point mass": (2.2, 0.62)}
_SUPPORT = 2.2

_PAPER: Any = {"grid.color": "0.88", "grid.linewidth": 0.6} | {
    f"axes3d.{axis}axis.panecolor": (1.0, 1.0, 1.0, 0.0) for axis in "xyz"
}


class _InnerTicks(MaxNLocator):
    """Round numbers, but none in the corners, where those of two axes would meet."""

    def tick_values(self, vmin: float, vmax: float) -> Any:
        ticks = np.asarray(super().tick_values(vmin, vmax))
        corner = _CORNER * (vmax - vmin)
        return ticks[(ticks > vmin + corner) & (ticks < vmax - corner)]


def new_space(figure: Figure, rows: int = 1, columns: int = 1, index: int = 1) -> Any:
    """Return new three-dimensional axes at a place in the figure's grid, without grey walls."""
    with mpl.rc_context(_PAPER):
        ax: Any = figure.add_subplot(rows, columns, index, projection="3d", computed_zorder=False)
    ax.view_init(elev=20, azim=-60)
    return ax


def new_view(
    figure: Figure, dimension: int, rows: int = 1, columns: int = 1, index: int = 1
) -> Any:
    """Return new axes for a structure in space, or flat ones for one in the plane."""
    if dimension == 3:
        return new_space(figure, rows, columns, index)
    return figure.add_subplot(rows, columns, index, aspect="equal")


def frame(ax: Any, points: Iterable[FloatArray], grow: bool, fill: float = 0.77) -> None:
    """Set limits that hold all points (d, ·), with ``grow`` the former; ``fill`` of the axes."""
    corners = np.hstack(list(points))
    names = "xyz"[: len(corners)]
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    largest = max(float((upper - lower).max()), 1e-9)
    centre, half = (lower + upper) / 2, (upper - lower) / 2
    margin = _MARGIN if len(names) == 3 else _FLAT_MARGIN
    half = np.maximum(half + margin * largest, _THINNEST * largest / 2)
    lower, upper = centre - half, centre + half
    if grow:
        before = np.array([getattr(ax, f"get_{name}lim")() for name in names])
        lower, upper = np.minimum(lower, before[:, 0]), np.maximum(upper, before[:, 1])
    for name, low, high in zip(names, lower, upper, strict=True):
        ax.set(**{f"{name}lim": (low, high)})
    if len(names) == 2:
        ax.set_aspect("equal")
        return
    extent = upper - lower
    ax.set_box_aspect(extent, zoom=fill / _seen(ax, extent / np.linalg.norm(extent)))
    for axis, share in zip((ax.xaxis, ax.yaxis, ax.zaxis), extent / extent.max(), strict=True):
        axis.set_major_locator(_InnerTicks(max(2, round(_TICKS * share)), min_n_ticks=1))


def label_view(ax: Any) -> None:
    """Label the axes with their unit. To be called after :func:`frame`."""
    if ax.name != "3d":
        dress(ax, "x, m", "y, m")
        return
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


def fill_figure(figure: Figure, dimension: int) -> None:
    """Give the axes of a structure nearly all room of the figure."""
    figure.subplots_adjust(**(FILLED if dimension == 3 else _FILLED_FLAT))


@dataclass(frozen=True, eq=False)
class Drawing:
    """What was drawn of a structure. Made by :func:`tenscontrol.plot.structure`.

    Attributes
    ----------
    structure : Structure
    ax : Axes3D or Axes
        Where it was drawn: flat axes for a structure in the plane.
    bars, strings : Line3DCollection or LineCollection
        One line for each member, in the order of the structure. A clustered string is one line
        along its path.
    nodes : Line3D or Line2D
        One marker for each node.
    node_labels, bar_labels, string_labels : tuple of Text3D or Text
        The numbers, empty where there are none.
    colorbar : Colorbar or None
        The scale of the force densities.
    marks : tuple of (str, Line3D or Line2D, ndarray of int)
        Marks of nodes that move with them: joints of bars, pulleys of clustered strings, point
        masses on bars, rollers. Each has its name and its nodes.
    supports : Line3D, Line2D or None
        The marks of the fixed nodes, which a simulation may move; None without any.
    ground : tuple of artists
        What was drawn of the ground of a run.
    touching : Line3D, Line2D or None
        The marks of nodes that press on the ground; None where there is none.
    passive : ndarray of bool, shape (α,), or None
        Whether a string is drawn as one that no winch drives; None where all look alike.
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
    marks: tuple[tuple[str, Any, IntArray], ...] = ()
    supports: Any = None
    ground: tuple[Any, ...] = ()
    touching: Any = None
    passive: np.ndarray | None = None
    _places: NumberPlaces | None = field(default=None, repr=False)

    __repr__ = short_repr

    def update(self, nodes: object, force_density: object = None, touching: object = None) -> None:
        """Move the drawing to other node positions. The limits of the axes stay.

        Parameters
        ----------
        nodes : array_like, shape (d, n)
            Node positions, m.
        force_density : float or array_like, shape (α,), optional
            γ, N/m: slack strings become dotted, and the colours follow where
            the drawing has a colour scale. Strings look as before if not given.
        touching : array_like of int, optional
            The nodes that press on the ground, if there is one; none if not given.

        Raises
        ------
        TypeError, ValueError
            If an argument does not fit or is not finite, or γ is negative.
        """
        positions = self.structure.checked_nodes("nodes", nodes)
        if force_density is not None:
            gamma = checked_force_density(self.structure, force_density)
            self.strings.set_linestyle(string_dashes(gamma, self.passive))
            if self.colorbar is not None:
                self.strings.set_array(gamma)
        self.bars.set_segments(segments(positions, self.structure.bars))
        self.strings.set_segments(segments(positions, _paths(self.structure)))
        moved = [(self.nodes, positions)]
        moved += [(points, positions[:, which]) for _, points, which in self.marks]
        if self.supports is not None:
            moved.append((self.supports, positions[:, self.structure.fixed]))
        if self.touching is not None:
            which = validation.float_array("touching", () if touching is None else touching)
            nodes_there = validation.indices("touching", which, positions.shape[1], "nodes")
            moved.append((self.touching, positions[:, nodes_there]))
        for points, where in moved:
            set_places = points.set_data_3d if self.structure.dimension == 3 else points.set_data
            set_places(*where)
        if self._places is None:
            return
        places = self._places.at(self.structure, positions)
        labels = (self.node_labels, self.bar_labels, self.string_labels)
        for texts, anchors in zip(labels, places, strict=True):
            for text, point in zip(texts, anchors, strict=False):
                if self.structure.dimension == 3:
                    text.set_position_3d(point)
                else:
                    text.set_position(point)


def draw(
    ax: Any,
    structure: Structure,
    nodes: FloatArray,
    style: MemberStyle,
    passive: np.ndarray | None = None,
    struts: np.ndarray | None = None,
) -> Drawing:
    """Draw bars, strings and nodes in one style, without numbers or colour scale.

    Strings that are ``passive``, bool, shape (α,), are dashed; all look alike if it is None. Bars
    that are ``struts``, bool, shape (β,), are slimmer and of another colour.
    """
    style = style.fitted(len(structure.bars) + len(structure.strings))
    lines: Any = LineCollection
    if structure.dimension == 3:
        lines = partial(DepthLines, fade=style.fade)
        ax.computed_zorder = False  # a faint shape stays behind, also in axes that a user made
    paths = _paths(structure)
    look: dict[str, Any] = {"colors": style.string_color, "linewidths": style.string_width}
    if passive is not None:
        look = {
            "colors": [
                PASSIVE_COLOR if is_passive else style.string_color for is_passive in passive
            ],
            "linewidths": style.string_width * np.where(passive, PASSIVE_WIDTH, 1.0),
            "linestyles": [PASSIVE_DASHES if is_passive else "solid" for is_passive in passive],
        }
    strings = lines(segments(nodes, paths), zorder=style.layer, **look)
    look = {"colors": style.bar_color, "linewidths": style.bar_width}
    if struts is not None:
        look = {
            "colors": [STRUT_COLOR if driven else style.bar_color for driven in struts],
            "linewidths": style.bar_width * np.where(struts, STRUT_WIDTH, 1.0),
        }
    bars = lines(
        segments(nodes, structure.bars), capstyle="round", zorder=style.layer + 0.3, **look
    )
    for members, pairs in ((strings, paths), (bars, structure.bars)):
        if len(pairs):  # Matplotlib cannot find the limits of nothing
            add = ax.add_collection3d if structure.dimension == 3 else ax.add_collection
            add(members)
    dot = marker_style("o", style.node_size, style.node_color)
    (dots,) = ax.plot(*nodes, zorder=style.layer + 0.2, **dot)
    supports = None
    if len(structure.fixed):
        triangle = marker_style("^", _SUPPORT * style.node_size, style.node_color, mfc="white")
        (supports,) = ax.plot(*nodes[:, structure.fixed], zorder=style.layer + 0.5, **triangle)
    marks = []
    for name, which in marked_nodes(structure).items():
        look, above = _mark_style(name, style)
        (line,) = ax.plot(*nodes[:, which], zorder=style.layer + above, **look)
        marks.append((name, line, which))
    return Drawing(
        structure, ax, bars, strings, dots, (), (), (), None, tuple(marks), supports,
        passive=passive,
    )  # fmt: skip


def draw_arrows(ax: Any, nodes: FloatArray, moved: FloatArray, least: float) -> Any:
    """Draw arrows at nodes, those longer than ``least``, m: all, or some of many."""
    seen = np.flatnonzero(np.linalg.norm(moved, axis=0) > least)
    seen = seen[np.linspace(0, len(seen) - 1, min(len(seen), _MOST_ARROWS)).round().astype(int)]
    ends = (*nodes[:, seen], *moved[:, seen])
    if len(nodes) == 3:
        return ax.quiver(
            *ends, color=_ARROW, linewidth=1.1, arrow_length_ratio=0.3, zorder=SMALL.layer + 1
        )
    look = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "units": "inches", "width": 0.02}
    return ax.quiver(*ends, color=_ARROW, zorder=SMALL.layer + 1, **look)


def marked_nodes(structure: Structure) -> dict[str, IntArray]:
    """Return the nodes of each mark that there is: joints, pulleys, point masses, rollers."""
    bars_at = np.bincount(structure.bars.ravel(), minlength=structure.nodes.shape[1])
    loops = [path[:-1] if path[0] == path[-1] else path[1:-1] for path in structure.paths]
    heavy = np.flatnonzero(structure.point_mass)
    marks = {
        "joint": np.setdiff1d(np.flatnonzero(bars_at > 1), structure.fixed),
        "pulley": np.unique([node for path in loops for node in path]).astype(int),
        "point mass": np.setdiff1d(heavy, structure.string_nodes),
    }
    for axis in "xyz":
        held = [node for node, along in structure.rollers if along == axis]
        marks[f"roller {axis}"] = np.array(held, dtype=int)
    return {name: which for name, which in marks.items() if len(which)}


def _mark_style(name: str, style: MemberStyle) -> tuple[dict[str, Any], float]:
    """Return how a mark is drawn, and its layer above that of the members."""
    color = style.node_color
    if name.startswith("roller"):
        turned = _ROLLER[:, ::-1] if name.endswith("x") else _ROLLER
        size = 2 * _SUPPORT * style.node_size  # half of a marker is beyond its node
        marker: Any = Outline(turned, _STROKES)
        return marker_style(marker, size, color, mfc="white"), 0.5
    share, above = _MARKS[name]
    look = marker_style("o", share * style.node_size, color, mfc="white")
    if name == "point mass":
        look["mfc"] = color
    if name == "pulley":
        look |= {"color": style.string_color, "mew": style.string_width}
    return look, above


def color_by_force(strings: Any, gamma: FloatArray, passive: np.ndarray | None = None) -> None:
    """Colour the strings by force density, from 0 to the largest. Slack ones are dotted."""
    strings.set_linewidth(FORCE_WIDTH * np.asarray(strings.get_linewidth()))
    color_by(strings, gamma, float(gamma.max(initial=0.0)) or 1.0)
    strings.set_linestyle(string_dashes(gamma, passive))


def color_by(members: Any, values: FloatArray, most: float) -> None:
    """Colour members by values, from 0 to ``most``."""
    members.set_edgecolor(None)  # the colour given before would win over the map
    members.set_cmap(FORCE_MAP)
    members.set_array(values)
    members.set_clim(0.0, most)


def checked_force_density(structure: Structure, force_density: object) -> FloatArray:
    """Return γ, one for each string, at least 0; or raise naming the argument."""
    gamma = validation.per_member("force_density", force_density, len(structure.strings), "string")
    return validation.non_negative("force_density", gamma, "a string can only pull")


def is_slack(gamma: FloatArray) -> np.ndarray:
    """Return which strings carry nothing, bool, shape (α,)."""
    return np.asarray(gamma <= _SLACK * gamma.max(initial=0.0))


def string_dashes(gamma: FloatArray, passive: np.ndarray | None = None) -> list[Any]:
    """Return the dashes of each string: dotted where it is slack, else solid, or those of springs.

    ``passive`` is bool, shape (α,), or None.
    """
    springs = np.zeros(len(gamma), dtype=bool) if passive is None else passive
    taut = [PASSIVE_DASHES if spring else "solid" for spring in springs]
    return [
        DOTTED if slack else dashes for slack, dashes in zip(is_slack(gamma), taut, strict=True)
    ] or ["solid"]


def passive_strings(structure: Structure, actuation: Actuation | None) -> np.ndarray | None:
    """Return which strings no input drives, bool, shape (α,); None where there are none.

    An actuation of whole strings counts for the segments of each.
    """
    if actuation is None or not len(actuation.passive):
        return None
    passive = np.asarray(actuation.input < 0)
    if len(passive) != len(structure.strings) and structure.string_parent is not None:
        passive = passive[structure.string_parent]
    return passive


def segments(nodes: FloatArray, members: IntArray) -> FloatArray:
    """Return the nodes of each member, shape (count, ·, d), m."""
    return np.asarray(nodes.T[members])


def _paths(structure: Structure) -> IntArray:
    """Return the nodes of each string, shape (α, ·); shorter paths stay at their last node."""
    if not structure.has_clusters:
        return structure.strings
    longest = max(map(len, structure.paths))
    return np.array([[*path, *[path[-1]] * (longest - len(path))] for path in structure.paths])


def legend_samples(
    structure: Structure,
    slack: bool,
    colored: bool = False,
    passive: np.ndarray | None = None,
    struts: np.ndarray | None = None,
) -> list[Line2D]:
    """Return the samples of members that a legend shows, of those kinds that there are."""
    bar = {"color": NORMAL.bar_color, "linewidth": NORMAL.bar_width, "solid_capstyle": "round"}
    # Where the colours of strings have a scale of their own, the sample has none of them.
    color = "0.4" if colored else NORMAL.string_color
    string = {"color": color, "linewidth": NORMAL.string_width}
    spring = {
        "linestyle": PASSIVE_DASHES,
        **string,
        "linewidth": PASSIVE_WIDTH * NORMAL.string_width,
    }
    spring["color"] = color if colored else PASSIVE_COLOR
    driven = len(structure.strings) > 0 if passive is None else not passive.all()
    strut = bar | {"color": STRUT_COLOR, "linewidth": STRUT_WIDTH * NORMAL.bar_width}
    samples = {
        "bar": (bar, len(structure.bars) > 0 and (struts is None or not struts.all())),
        "driven bar": (strut, struts is not None),
        "string" if passive is None else "driven string": (string, driven),
        "passive string": (spring, passive is not None),
        "slack string": ({"linestyle": DOTTED, **string}, slack),
    }
    handles = [sample(label, **style) for label, (style, shown) in samples.items() if shown]
    # Rollers along x, y and z look alike enough for one sample.
    marks = {
        "roller" if name.startswith("roller") else name: name for name in marked_nodes(structure)
    }
    handles += [sample(label, **_mark_style(name, NORMAL)[0]) for label, name in marks.items()]
    return handles


def legend_place(structure: Structure) -> dict[str, Any]:
    """Return where the legend is: in a corner of space, above flat axes."""
    look: dict[str, Any] = {"loc": "upper left", "frameon": False, "fontsize": "small"}
    if structure.dimension == 2:
        look |= {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": 3}
        look |= {"borderaxespad": 0.2, "columnspacing": 1.4}
    return look


def sample(label: str, **style: Any) -> Line2D:
    """Return a line that is drawn in a legend only."""
    return Line2D([], [], label=label, **style)


@closes_on_error
def structure(
    structure: Structure | Prestress | ShapeTarget | LinearPlant | Trajectory | ShapePath,
    nodes: object = None,
    *,
    time: float | None = None,
    ax: Any = None,
    force_density: object = None,
    labels: bool = False,
    member_labels: bool = False,
    faint: bool = False,
    legend: bool = True,
    actuated: object = None,
) -> Drawing:
    """Draw a structure: thick dark bars, thin strings, one scale in all directions.

    Fixed nodes stand on triangles, rollers on triangles with a line, beneath or, along x, beside
    the node. Nodes that bars share are white; a node that a clustered string runs over has a
    ring, and a point mass on a bar is a large dot. A structure in the plane is drawn in flat axes.
    Drawn into axes that hold a drawing already, the limits grow to hold both. In space, members far
    from the eye are paler, and the axes no longer sort what they hold by depth
    (``computed_zorder``), so that a faint shape stays behind.

    Parameters
    ----------
    structure : Structure, Prestress, ShapeTarget, LinearPlant, Trajectory or ShapePath
        A prestress, an equilibrium, a plant or a shape that was found are drawn with the colours of
        their force densities unless they are faint, and so is a run, in its last shape; with its
        ground, if there is one, and marks of the nodes that press on it. So is a path, in its last
        shape. The strings that no winch of a plant or of a controlled run drives are dashed and
        thinner.
    nodes : array_like, shape (d, n), optional
        Node positions, m; if not given, the reference shape, or that of the result.
    time : float, optional
        When in a run or path, s: the state kept nearest to it is drawn.
    ax : Axes3D or Axes, optional
        Where to draw, flat for a structure in the plane; a new figure if not given.
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
    actuated : sequence of int or str, dict, array_like or Actuation, optional
        The strings that are driven, as for :func:`linearize`; those of the plant or run if not
        given, else no difference is drawn.

    Returns
    -------
    Drawing
        The artists, and ``update(nodes)`` to move them.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, does not fit or is not finite, γ
        is negative, or ``ax`` is flat for a structure in space or the other way round.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> prism = tc.prism()
    >>> rest = tc.prestress(prism, force_density=10.0)
    >>> drawing = tc.plot.structure(prism, force_density=rest.force_density, labels=True)
    >>> drawing.ax.get_zlabel(), drawing.colorbar.ax.get_ylabel()
    ('z, m', 'γ, N/m')
    >>> plt.close(drawing.ax.figure)

    The same of a result, in one word:

    >>> plt.close(tc.plot.structure(rest).ax.figure)
    """
    for name, flag in {"labels": labels, "member_labels": member_labels, "faint": faint}.items():
        validation.truth(name, flag, "whether to draw so")
    validation.truth("legend", legend, "whether to show one")
    run = structure if isinstance(structure, Trajectory) and not faint else None
    laws = () if run is None else run.ground
    actuation, struts = known_actuation(structure), driven_bars(structure)
    structure, nodes, colours, state = _in_a_shape(structure, nodes, force_density, time)
    shape = structure.nodes if nodes is None else structure.checked_nodes("nodes", nodes)
    gamma = None
    if force_density is not None or (colours is not None and not faint):
        gamma = checked_force_density(structure, colours)
    if actuated is not None:
        actuation = actuation_of(structure, actuated, np.zeros(len(structure.strings)))
    passive = None if faint else passive_strings(structure, actuation)
    own = ax is None
    if own:
        figure = plt.figure(figsize=SIZE)
        fill_figure(figure, structure.dimension)
        ax = new_view(figure, structure.dimension)
    checked_axes("ax", ax, "three-dimensional" if structure.dimension == 3 else "flat")
    grow = ax.has_data()
    look = (FAINT, None, None) if faint else (NORMAL, passive, struts)
    drawing = draw(ax, structure, shape, *look)
    frame(ax, [shape, near_ground(laws, shape)], grow=grow)
    label_view(ax)
    if run is not None and laws:
        pressed = touching(run.contacts, state)
        ground, marks = add_ground(ax, laws, shape[:, pressed], len(structure.bars))
        drawing = replace(drawing, ground=ground, touching=marks)
    if labels or member_labels:
        places, texts = write_numbers(ax, structure, shape, labels, member_labels)
        drawing = replace(
            drawing, node_labels=texts[0], bar_labels=texts[1], string_labels=texts[2],
            _places=places,
        )  # fmt: skip
    if gamma is not None:
        color_by_force(drawing.strings, gamma, passive)
        drawing = replace(drawing, colorbar=add_scale(drawing, own, "γ, N/m"))
    if legend and not faint:
        slack = gamma is not None and bool(is_slack(gamma).any())
        samples = legend_samples(structure, slack, gamma is not None, passive, struts)
        samples += ground_samples(laws)
        ax.legend(handles=samples, **legend_place(structure))
    return drawing


def add_scale(drawing: Drawing, own: bool, label: str) -> Any:
    """Draw the colour scale beside the axes; in a figure of our own in room that is added."""
    figure = drawing.ax.figure
    axes: dict[str, Any] = {"ax": drawing.ax, "shrink": 0.6, "pad": 0.22, "aspect": 18}
    if own:
        width, height = figure.get_size_inches()
        wider = width + _SCALE_ROOM
        figure.set_size_inches(wider, height)
        room = drawing.ax.get_position().bounds
        drawing.ax.set_position(
            (room[0] * width / wider, room[1], room[2] * width / wider, room[3])
        )
        left, low = (width + 0.05) / wider, (1 - _SCALE_SHARE) / 2
        axes = {"cax": figure.add_axes((left, low, _SCALE_WIDTH / wider, _SCALE_SHARE))}
    return figure.colorbar(drawing.strings, label=label, **axes)


def known_actuation(drawn: object) -> Actuation | None:
    """Return which strings a plant drives, or the controller of a run; None of all else."""
    if isinstance(drawn, LinearPlant):
        return of_members(drawn.actuation, member_rows(drawn.input, drawn.commanded)[0])
    if isinstance(drawn, Trajectory) and drawn.control is not None and drawn.control.actuation:
        input = drawn.control.settings.raw.get("input", "rest_length")
        return of_members(drawn.control.actuation, member_rows(input, drawn.structure)[0])
    return None


def driven_bars(drawn: object) -> np.ndarray | None:
    """Return which bars a plant, a run or a path drives, bool, shape (β,); None where none are."""
    if isinstance(drawn, LinearPlant) and drawn.drives_bars:
        bars = member_rows(drawn.input, drawn.commanded)[1]
        return np.asarray(drawn.actuation.input[bars] >= 0)
    if isinstance(drawn, Trajectory) and drawn.struts is not None and len(drawn.struts.bar):
        return np.isin(np.arange(len(drawn.structure.bars)), drawn.struts.bar)
    if isinstance(drawn, ShapePath) and drawn.bar_length_rate.any():
        return np.asarray(drawn.bar_length_rate.any(axis=1))
    return None


def _in_a_shape(
    drawn: object, nodes: object, force_density: object, time: object
) -> tuple[Structure, object, object, int]:
    """Return a structure, nodes and force densities, those given or of a result, and its state."""
    if time is not None and not isinstance(drawn, ShapePath):
        advice = "time goes with a run, which simulate(model, ...) returns, or a path"
        validation.instance("structure", drawn, Trajectory, advice)
    shape, gamma, k = None, None, -1
    source = drawn.prestress if isinstance(drawn, ShapeTarget) else drawn
    if isinstance(source, Prestress):
        gamma, source = source.force_density, source.structure
    elif isinstance(source, LinearPlant):
        gamma = to_model_strings(source, "force_density", source.force_density)
        shape, source = source.nodes, source.model.structure
    elif isinstance(source, Trajectory | ShapePath):
        moment = float(source.time[-1]) if time is None else validation.number("time", time, "s")
        if not source.time[0] <= moment <= source.time[-1]:
            raise ValueError(
                f"time is {moment:g} s, expected {source.time[0]:g} to {source.time[-1]:g} s, "
                f"as the {'run' if isinstance(source, Trajectory) else 'path'}"
            )
        k = int(np.abs(source.time - moment).argmin())
        members = source.model.structure if isinstance(source, ShapePath) else source.structure
        shape, gamma, source = source.nodes[:, :, k], source.force_density[:, k], members
    how = (
        "or a Prestress, a ShapeTarget, a plant, a Trajectory, a ShapePath; make one by "
        "Structure(...) or prism(...)"
    )
    validation.instance("structure", source, Structure, how)
    assert isinstance(source, Structure)  # just checked
    chosen = shape if nodes is None else nodes, gamma if force_density is None else force_density
    return source, *chosen, k
