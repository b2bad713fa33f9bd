"""Three-dimensional axes: made or checked, one scale in all directions, limits that hold all."""

from __future__ import annotations

from collections.abc import Iterable
from types import MappingProxyType
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tenscontrol.validation import FloatArray

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

_PAPER: Any = {
    "axes3d.xaxis.panecolor": (1.0, 1.0, 1.0, 0.0),
    "axes3d.yaxis.panecolor": (1.0, 1.0, 1.0, 0.0),
    "axes3d.zaxis.panecolor": (1.0, 1.0, 1.0, 0.0),
    "grid.color": "0.88",
    "grid.linewidth": 0.6,
}


class _InnerTicks(MaxNLocator):
    """Round numbers, but none in the corners, where those of two axes would meet."""

    def tick_values(self, vmin: float, vmax: float) -> Any:
        ticks = np.asarray(super().tick_values(vmin, vmax))
        corner = _CORNER * (vmax - vmin)
        return ticks[(ticks > vmin + corner) & (ticks < vmax - corner)]


def space_axes(ax: object, beside: float = 0.0) -> Any:
    """Return ``ax`` if it is three-dimensional, new axes in a new figure if it is None.

    The new figure has room ``beside`` the axes, inches.
    """
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
    """Set limits that hold all points (3, ·), with one scale in all directions.

    With ``grow`` the limits hold what they held before, too. As it is seen, the
    box takes about the share ``fill`` of the axes, whatever its proportions;
    the default leaves room for the labels.
    """
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
