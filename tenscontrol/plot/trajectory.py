"""Time histories of a motion: coordinates, force densities, rest lengths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes

from tenscontrol.control import Status
from tenscontrol.plot.axes import legend_above, panel_axes
from tenscontrol.plot.faults import with_faults, wound
from tenscontrol.plot.history import Curves, checked_references, draw_curves, mark_statuses
from tenscontrol.simulation import ControlRecord, Trajectory
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, instance, whole_number

# Marks for statuses, told apart by their form.
_MARKERS = ("v", "x", "s", "d", "P", "^")


def trajectory(
    run: Trajectory,
    *,
    nodes: Sequence[int] = (0,),
    directions: str = "xyz",
    references: Mapping[str, object] | None = None,
    axes: Sequence[Axes] | None = None,
) -> dict[str, Curves]:
    """Draw the time histories of a motion, one panel for each kind of quantity.

    The panels are ``"coordinates"``; ``"force_density"``, with one style for
    each string group, if there are strings; and ``"rest_length"`` if rest
    lengths were held. What was held is drawn in steps. Samples at which a
    controller's status was not ``"ok"`` are marked on the lowest time axis, faults
    in the panels of force densities and rest lengths; a cut string has no rest length.

    Parameters
    ----------
    run : Trajectory
    nodes : sequence of int
        The nodes whose coordinates are drawn.
    directions : str
        Which coordinates: letters out of ``"xyz"``.
    references : mapping of str to float or array_like, shape (T,), optional
        Lines to compare the coordinates with, m: a target height, say.
    axes : sequence of Axes, optional
        Where to draw, one for each panel; a new figure if not given.

    Returns
    -------
    dict of str to Curves
        What was drawn, by panel.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, or there is no such node.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> start = tc.to_rest_length(model, prism.nodes, [17.3205] * 6 + [9.0] * 3).rest_length
    >>> run = tc.simulate(model, 0.2, rest_length=start, step=1e-3)
    >>> panels = tc.plot.trajectory(run, directions="z", references={"at start": 1.0})
    >>> list(panels), list(panels["force_density"].lines)
    (['coordinates', 'force_density', 'rest_length'], ['top', 'bottom', 'vertical'])
    >>> plt.close(panels["coordinates"].ax.figure)
    """
    instance("run", run, Trajectory, "make one by simulate(model, ...)")
    coordinates = _coordinates(run, nodes, directions)
    levels = checked_references(references, len(run.time))
    # Panel: curves, label, and whether the quantity was held from sample to sample.
    content: dict[str, tuple[dict[str, FloatArray], str, bool]] = {
        "coordinates": (coordinates, "node position, m", False)
    }
    if len(run.structure.strings):
        by_group = _by_group(run.structure, run.force_density)
        content["force_density"] = (by_group, "γ, N/m", run.rest_length is None)
    if run.rest_length is not None and len(run.structure.strings):
        content["rest_length"] = (_by_group(run.structure, wound(run)), "rest length, m", True)
    places = panel_axes(axes, list(content))
    panels = {}
    for ax, (name, (rows, label, held)) in zip(places, content.items(), strict=True):
        last = axes is not None or name == list(content)[-1]
        panels[name] = draw_curves(
            ax,
            run.time,
            rows,
            label,
            held=held,
            xlabel="time, s" if last else None,
            references=levels if name == "coordinates" else None,
        )
        if name != "coordinates":
            panels[name] = with_faults(panels[name], run)
    if run.control is not None:
        panels[name] = _with_statuses(panels[name], run.control)
    return panels


def _coordinates(run: Trajectory, nodes: object, directions: object) -> dict[str, FloatArray]:
    """Return the chosen coordinates by name: ``"x[0]"`` as in the names of a plant's states."""
    if not isinstance(directions, str) or not directions or set(directions) - set("xyz"):
        raise ValueError(f"directions is {directions!r}, expected letters out of 'xyz'")
    if isinstance(nodes, str) or not isinstance(nodes, Sequence | np.ndarray) or len(nodes) == 0:
        raise TypeError(f"nodes is {nodes!r}, expected a sequence of node indices, like (0, 1)")
    count = run.nodes.shape[1]
    rows = {}
    for i, entry in enumerate(nodes):
        node = whole_number(f"nodes[{i}]", entry, least=0)
        if node >= count:
            raise ValueError(
                f"nodes[{i}] is {node}, expected 0 to {count - 1}: "
                f"there are {count} nodes, counted from 0"
            )
        for direction in directions:
            rows[f"{direction}[{node}]"] = run.nodes["xyz".index(direction), node][None]
    return rows


def _by_group(structure: Structure, values: FloatArray) -> dict[str, FloatArray]:
    groups = dict.fromkeys(structure.string_groups)
    return {group: values[structure.strings_in(group)] for group in groups}


def _with_statuses(panel: Curves, control: ControlRecord) -> Curves:
    """Mark the samples whose status is not ok on the time axis of a panel."""
    told = [
        ": ".join(filter(None, pair)) for pair in zip(control.status, control.fallback, strict=True)
    ]
    statuses = [each for each in dict.fromkeys(told) if each != Status.OK]
    markers = dict(zip(statuses, cycle(_MARKERS), strict=False))
    panel = mark_statuses(panel, control.time, told, markers)
    if statuses:
        legend_above(panel.ax)
    return panel
