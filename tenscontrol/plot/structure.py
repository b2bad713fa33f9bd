"""The drawing of a structure in space."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tenscontrol.plot.drawing import (
    Drawing,
    checked_force_density,
    color_by_force,
    draw,
    is_slack,
    label_places,
    legend_samples,
)
from tenscontrol.plot.space import frame, label_space, space_axes
from tenscontrol.plot.style import FAINT, NORMAL
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, instance

# Room for the colour scale, inches.
_SCALE_WIDTH = 0.9

# White behind a number, so that it can be read on top of a member.
_CARD = {"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}


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
    >>> import matplotlib
    >>> matplotlib.use("Agg")
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
        _add_legend(ax, structure, gamma)
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


def _add_legend(ax: Any, structure: Structure, gamma: FloatArray | None) -> None:
    slack = gamma is not None and bool(is_slack(gamma).any())
    samples = legend_samples(structure, slack, colored=gamma is not None)
    ax.legend(handles=samples, loc="upper left", frameon=False, fontsize="small")
