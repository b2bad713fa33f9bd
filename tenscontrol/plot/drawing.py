"""A drawn structure, which can be moved to other node positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from tenscontrol.plot.style import DOTTED, FORCE_MAP, FORCE_WIDTH, NORMAL, MemberStyle
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, IntArray, non_negative, per_member

# A string below this fraction of the largest force density carries nothing.
_SLACK = 1e-9

# Distance of a node's number from the node, relative to the size of the structure.
_LABEL_DISTANCE = 0.08


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
            self._show_force(checked_force_density(self.structure, force_density))
        self.bars.set_segments(segments(positions, self.structure.bars))
        self.strings.set_segments(segments(positions, self.structure.strings))
        self.nodes.set_data_3d(*positions)
        places = label_places(self.structure, positions)
        for texts, where in zip(
            (self.node_labels, self.bar_labels, self.string_labels), places, strict=True
        ):
            for text, place in zip(texts, where, strict=False):
                text.set_position_3d(place)

    def _show_force(self, gamma: FloatArray) -> None:
        self.strings.set_linestyle(string_dashes(gamma))
        if self.colorbar is not None:
            self.strings.set_array(gamma)


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
    (dots,) = ax.plot(
        *nodes,
        linestyle="none",
        marker="o",
        markersize=style.node_size,
        color=style.node_color,
        zorder=style.layer + 0.6,
    )
    if len(structure.fixed):  # they stay where they are, so nothing updates them
        ax.plot(
            *nodes[:, structure.fixed],
            linestyle="none",
            marker="^",
            markersize=2.2 * style.node_size,
            markerfacecolor="white",
            markeredgecolor=style.node_color,
            zorder=style.layer + 0.5,
        )
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
    string = {
        "color": "0.4" if colored else NORMAL.string_color,
        "linewidth": NORMAL.string_width,
    }
    samples = []
    if len(structure.bars):
        samples.append(sample("bar", **bar))
    if len(structure.strings):
        samples.append(sample("string", **string))
    if slack:
        samples.append(sample("slack string", linestyle=DOTTED, **string))
    return samples


def sample(label: str, **style: Any) -> Line2D:
    """Return a line that is drawn in a legend only."""
    return Line2D([], [], label=label, **style)
