"""Pictures of a shape as arrays of pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tenscontrol.arrays import FloatArray
from tenscontrol.plot.structure_drawing import structure as drawn_structure
from tenscontrol.structure.structure import Structure

# Inches, and dots per inch.
_SIZE, _DOTS = 3.2, 100


def picture(structure: Structure, nodes: FloatArray) -> np.ndarray:
    """Return a picture of a structure in a shape, shape (height, width, 3), bytes."""
    figure = Figure(figsize=(_SIZE, _SIZE), dpi=_DOTS)
    canvas: Any = FigureCanvasAgg(figure)
    projection = "3d" if structure.dimension == 3 else None
    ax: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection=projection)
    drawn_structure(structure, nodes, ax=ax, legend=False)
    ax.set_axis_off()
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
