"""Figures of the margins of strength along a run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from tenscontrol import validation
from tenscontrol.plot.histories import Curves, draw_curves
from tenscontrol.plot.structure_drawing import (
    Drawing,
    add_scale,
    color_by,
    string_dashes,
    structure,
)
from tenscontrol.plot.style import FORCE_WIDTH, closes_on_error, flat_axes, legend_above
from tenscontrol.simulation.strength import Strength

# Margins beyond are drawn there: members that bear nothing have infinite ones. The axis ends above
# the curves, or at so many times the least margin, or 1.
_FAR, _SHOWN = 1e4, 4.0


@closes_on_error
def strength(found: Strength, *, members: int = 4, ax: Axes | None = None) -> Curves:
    """Draw how many times its force each of the worst members could carry, over time.

    Below the grey line at 1 it yields or buckles.

    Parameters
    ----------
    found : Strength
        Made by :func:`tenscontrol.strength`.
    members : int
        How many members are drawn, those of the least margin.
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Returns
    -------
    Curves

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> metal = tc.sizing.materials["aluminium"]
    >>> sized = tc.sections(tc.prism(), bars=metal, bar_radius=0.02, strings=metal,
    ...                     string_radius=0.002)
    >>> rest = tc.prestress(sized.structure, force_density=1000.0)
    >>> run = tc.simulate(tc.Model(sized.structure), 0.1, force_density=rest.force_density)
    >>> curves = tc.plot.strength(tc.strength(run, sized), members=2)
    >>> len(curves.lines), curves.ax.get_ylabel()
    (2, 'strength over force')
    >>> plt.close(curves.ax.figure)
    """
    validation.instance("found", found, Strength, "make one by strength(run, sections)")
    count = validation.whole_number("members", members, 1)
    alpha = len(found.string_margin)
    margins = np.vstack([found.string_margin, found.bar_margin])
    rows = {}
    for i in np.argsort(found.least, kind="stable")[:count]:
        member = f"string {i}" if i < alpha else f"bar {i - alpha}"
        rows[f"{member} ({found.limit[i]})"] = np.minimum(margins[i], _FAR)[None]
    ax = flat_axes(ax)
    one = {"yields or buckles": np.array(1.0)}
    curves = draw_curves(
        ax, found.run.time, rows, "strength over force", references=one, xlabel="time, s"
    )
    drawn = max((float(values.max()) for values in rows.values()), default=1.0)
    ax.set_ylim(0, min(_SHOWN * max(1.0, found.margin), 1.1 * max(1.0, drawn)))
    legend_above(ax)
    return curves


@closes_on_error
def utilization(found: Strength, *, time: float | None = None, ax: Any = None) -> Drawing:
    """Draw a structure with its members coloured by force over strength: 1 where they just fail.

    Parameters
    ----------
    found : Strength
        Made by :func:`tenscontrol.strength`.
    time : float, optional
        When, s: the state kept nearest to it is drawn; that of the least margin if not given.
    ax : Axes3D or Axes, optional
        Where to draw, flat for a structure in the plane; a new figure if not given.

    Returns
    -------
    Drawing

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, ``time`` is not within the run, or there is no member.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> metal = tc.sizing.materials["aluminium"]
    >>> sized = tc.sections(tc.prism(), bars=metal, bar_radius=0.02, strings=metal,
    ...                     string_radius=0.002)
    >>> rest = tc.prestress(sized.structure, force_density=1000.0)
    >>> run = tc.simulate(tc.Model(sized.structure), 0.1, force_density=rest.force_density)
    >>> drawing = tc.plot.utilization(tc.strength(run, sized))
    >>> drawing.colorbar.ax.get_ylabel(), drawing.ax.get_title()
    ('force over strength', '0 s')
    >>> plt.close(drawing.ax.figure)
    """
    validation.instance("found", found, Strength, "make one by strength(run, sections)")
    run = found.run
    if not len(found.least):
        raise ValueError("found has no members, so there is nothing to draw")
    moment = float(found.when[found.least.argmin()])
    if time is not None:
        moment = validation.number("time", time, "s")
        if not run.time[0] <= moment <= run.time[-1]:
            raise ValueError(
                f"time is {moment:g} s, expected {run.time[0]:g} to {run.time[-1]:g} s, as the run"
            )
    k = int(np.abs(run.time - moment).argmin())
    pull, push = 1 / found.string_margin, 1 / found.bar_margin
    most = max(1.0, float(pull.max(initial=0.0)), float(push.max(initial=0.0)))
    drawing = structure(run.structure, run.nodes[:, :, k], ax=ax, legend=False)
    strings = drawing.strings
    strings.set_linewidth(FORCE_WIDTH * np.asarray(strings.get_linewidth()))
    strings.set_linestyle(string_dashes(run.force_density[:, k]))
    for members, shares in ((strings, pull), (drawing.bars, push)):
        color_by(members, shares[:, k], most)
    drawing.ax.set_title(f"{run.time[k]:.4g} s", fontsize="medium")
    return replace(drawing, colorbar=add_scale(drawing, ax is None, "force over strength"))
