"""Figure of a structure deflected by a load."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.plant.deflections import Deflections
from tenscontrol.plot.structure_drawing import Drawing, draw, draw_arrows, frame, structure
from tenscontrol.plot.style import FAINT, closes_on_error

# Length of the arrow of the largest force, and of the largest displacement that is drawn unless it
# is larger itself, parts of the size of the structure.
_FORCE, _SEEN = 0.25, 0.1
_ABOVE_LEGEND = 6.0  # points, for the title of a flat drawing
_ROUND_OFF = 1e-9  # a displacement below this part of the size is not magnified


@closes_on_error
def deflections(
    found: Deflections, load: int = 0, *, magnify: float | None = None, ax: Any = None
) -> Drawing:
    """Draw a structure as a load deflects it, coloured by its forces, over its rest in grey.

    Arrows are the forces of the load, the longest a quarter of the structure. Strings that are
    slack under it are dotted.

    Parameters
    ----------
    found : Deflections
        Made by :func:`tenscontrol.deflections`.
    load : int
        Which of its loads.
    magnify : float, optional
        How many times as large the displacements are drawn; so that the largest is a tenth of the
        structure if not given, but not smaller than it is. Along straight lines, so that bars look
        longer than they are.
    ax : Axes3D or Axes, optional
        Where to draw, flat for a structure in the plane; a new figure if not given.

    Returns
    -------
    Drawing
        Of the deflected shape.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, or there is no such load.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=2e4))
    >>> stretch = np.zeros((3, 6))
    >>> stretch[2] = [1, 1, 1, -1, -1, -1]
    >>> found = tc.deflections(model, tc.prestress(prism, force_density=100.0), [stretch])
    >>> drawing = tc.plot.deflections(found, magnify=200)
    >>> print(drawing.ax.get_title())
    load 0, displacements × 200
    >>> plt.close(drawing.ax.figure)
    """
    validation.instance("found", found, Deflections, "make one by deflections(model, rest, loads)")
    count = found.loads.shape[2]
    if not count:
        raise ValueError("found has no loads, so there is nothing to draw")
    k = validation.whole_number("load", load, 0, count - 1)
    rest = found.rest.structure
    size = float(np.ptp(rest.nodes, axis=1).max())
    moved, force = found.displacement[:, :, k], found.loads[:, :, k]
    if magnify is None:
        seen = max(float(found.largest[k]), _ROUND_OFF * size)
        factor = _SEEN * size / seen if _ROUND_OFF * size < seen < _SEEN * size else 1.0
    else:
        factor = validation.positive_number("magnify", magnify, "times")
    gamma = found.string_force[:, k] / rest.string_length(rest.nodes + moved)
    nodes = rest.nodes + factor * moved
    drawing = structure(rest, nodes, ax=ax, force_density=gamma)
    draw(drawing.ax, rest, rest.nodes, FAINT)
    tips = nodes
    if force.any():
        vectors = _FORCE * size / float(np.linalg.norm(force, axis=0).max()) * force
        draw_arrows(drawing.ax, nodes, vectors, 0.0)
        tips = nodes + vectors
    frame(drawing.ax, [rest.nodes, nodes, tips], grow=ax is not None)
    title = f"load {k}, displacements × {factor:.3g}"
    pad = None
    if rest.dimension == 2:  # above the legend
        figure = drawing.ax.figure
        legend = drawing.ax.get_legend().get_window_extent()
        pad = legend.height * 72 / figure.dpi + _ABOVE_LEGEND
    drawing.ax.set_title(title, fontsize="medium", pad=pad)
    return drawing
