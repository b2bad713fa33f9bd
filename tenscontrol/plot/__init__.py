"""Figures and animations. The only folder that imports matplotlib.

Each function takes the axes to draw into (a new figure if not given), returns
what was drawn, and never shows a window.
"""

from tenscontrol.plot.accuracy_figures import (
    convergence_order,
    long_run,
    stability_map,
    work_precision,
)
from tenscontrol.plot.animation import animate
from tenscontrol.plot.deflected_shape import deflections
from tenscontrol.plot.estimation_error import estimate
from tenscontrol.plot.fit_figures import FitDrawing, intervals, residuals
from tenscontrol.plot.ground_drawing import contacts
from tenscontrol.plot.histories import Curves, history
from tenscontrol.plot.interactive_view import view
from tenscontrol.plot.least_mass import MassDrawing, least_mass
from tenscontrol.plot.mode_shapes import ModeShape, mode_shapes
from tenscontrol.plot.motion_histories import health, motors, struts, tracking, trajectory
from tenscontrol.plot.planned_motion import optimal_motion
from tenscontrol.plot.pole_map import PoleMap, poles
from tenscontrol.plot.strength_margins import strength, utilization
from tenscontrol.plot.structure_drawing import Drawing, structure
from tenscontrol.plot.style import save_figure
from tenscontrol.plot.sweep_figures import SweepDrawing, sweep
from tenscontrol.plot.web_page import View

__all__ = [
    "Curves",
    "Drawing",
    "FitDrawing",
    "MassDrawing",
    "ModeShape",
    "PoleMap",
    "SweepDrawing",
    "View",
    "animate",
    "contacts",
    "convergence_order",
    "deflections",
    "estimate",
    "health",
    "history",
    "intervals",
    "least_mass",
    "long_run",
    "mode_shapes",
    "motors",
    "optimal_motion",
    "poles",
    "residuals",
    "save_figure",
    "stability_map",
    "strength",
    "structure",
    "struts",
    "sweep",
    "tracking",
    "trajectory",
    "utilization",
    "view",
    "work_precision",
]
