"""Figures and animations. The only folder that imports matplotlib.

Each function takes the axes to draw into (a new figure if not given), returns
what was drawn, and never shows a window.
"""

from tenscontrol.plot.accuracy import (
    convergence_order,
    long_run,
    stability_map,
    work_precision,
)
from tenscontrol.plot.animation import animate
from tenscontrol.plot.drawing import Drawing
from tenscontrol.plot.estimate import estimate
from tenscontrol.plot.files import save_figure
from tenscontrol.plot.health import health
from tenscontrol.plot.history import Curves, history
from tenscontrol.plot.mode_shapes import ModeShape, mode_shapes
from tenscontrol.plot.poles import PoleMap, poles
from tenscontrol.plot.structure import structure
from tenscontrol.plot.sweep import SweepDrawing, sweep
from tenscontrol.plot.trajectory import trajectory

__all__ = [
    "Curves",
    "Drawing",
    "ModeShape",
    "PoleMap",
    "SweepDrawing",
    "animate",
    "convergence_order",
    "estimate",
    "health",
    "history",
    "long_run",
    "mode_shapes",
    "poles",
    "save_figure",
    "stability_map",
    "structure",
    "sweep",
    "trajectory",
    "work_precision",
]
