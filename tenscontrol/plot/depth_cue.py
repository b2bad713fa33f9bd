"""Lines in space that show depth: near ones are drawn over far ones, which are paler."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import LineCollection
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from tenscontrol.arrays import FloatArray

# Depth at which lines are palest, at least, as part of the size of what is drawn: a flat structure
# seen from the front has no far side.
_DEEP = 0.5

# Elevation of the eye, degrees, up to which depth is measured along the horizon.
_LEVEL = 60.0


class DepthLines(Line3DCollection):  # type: ignore[misc]  # mpl_toolkits has no types
    """Lines of one kind, far to near; ``fade`` is how much of its colour the farthest loses.

    Colours that show a quantity do not fade.
    """

    def __init__(self, lines: FloatArray, fade: float, **style: Any) -> None:
        self._fade = fade
        super().__init__(lines, **style)

    def draw(self, renderer: Any) -> None:
        """Draw the projected lines in the order of their depth."""
        lines = self.get_segments()
        if not self.get_visible() or not len(lines):
            return
        self.update_scalarmappable()
        order, depth = self._by_depth()
        share = 0.0 if self.get_array() is not None else self._fade * depth[:, None]
        count = len(lines)
        color = np.resize(self.get_edgecolor(), (count, 4)).copy()
        color[:, :3] += share * (1 - color[:, :3])
        width = np.resize(self.get_linewidth(), count)
        dashes = self.get_linestyle()
        drawn = LineCollection(
            [lines[i] for i in order],
            colors=color[order],
            linewidths=width[order],
            linestyles=[dashes[i % len(dashes)] for i in order],
            capstyle=self.get_capstyle(),
        )
        Artist.update_from(drawn, self)  # transform, clipping, path effects
        drawn.set_figure(self.get_figure())
        drawn.draw(renderer)
        self.stale = False

    def _by_depth(self) -> tuple[Any, FloatArray]:
        """Return the order from far to near, and the depth of each line, 0 near to 1 far."""
        middle = np.asarray(self._segments3d).mean(axis=1)
        elevation, azimuth = np.deg2rad([self.axes.elev, self.axes.azim])
        eye = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        level = abs(self.axes.elev) <= _LEVEL
        if not level:
            eye = np.r_[np.cos(elevation) * eye[:2], np.sin(elevation)]
        away = -middle @ eye
        # The foot of a tower is no farther away than its top: heights count from above only.
        size = np.ptp(middle[:, : 2 if level else 3], axis=0).max(initial=0.0)
        far = max(float(np.ptp(away)), _DEEP * float(size), 1e-300)
        return np.argsort(-away, kind="stable"), (away - away.min()) / far
