"""Figure of an estimate: lengths beside the true ones, with their error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.plot.histories import Curves, draw_curves, mark_statuses
from tenscontrol.plot.style import (
    PALETTE,
    checked_indices,
    closes_on_error,
    curve_style,
    legend_above,
    panel_axes,
)
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.status import Status
from tenscontrol.structure.structure import Structure

# Marks for what became of readings, told apart by their form.
_MARKERS: dict[str, str] = {
    Status.PARTLY_USED: "|", Status.LOST: "x", Status.REFUSED: "v", Status.WAITING: ".",
    Status.RESTARTED: "s",
}  # fmt: skip


@closes_on_error
def estimate(
    run: Trajectory, *, strings: Sequence[int] = (0,), axes: Sequence[Axes] | None = None
) -> dict[str, Curves]:
    """Draw lengths of strings as they are and as estimated, and how far the estimate is off.

    The panels are ``"length"``, and ``"error"``: estimated less true length, with a band of two
    standard deviations as the filter has them. Lengths do not depend on where the structure
    is, which readings may not tell. Samples of which not all readings were used are marked on the
    lower time axis.

    Parameters
    ----------
    run : Trajectory
        Of a controller with an estimator.
    strings : sequence of int
        Which strings of the estimator's structure.
    axes : sequence of Axes, optional
        Where to draw, one for each panel; a new figure if not given.

    Returns
    -------
    dict of str to Curves
        What was drawn, by panel.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, there is no such string, or
        nothing was estimated.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> regulator = tc.LQR(plant, Q=1.0, R=1e-2, sample_time=0.02)
    >>> sensors = tc.Sensors(structure=prism, string_length=0.001)
    >>> estimator = tc.KalmanFilter(plant, sensors, sample_time=0.02)
    >>> run = tc.simulate(
    ...     tc.Model(prism), 0.2, controller=regulator, step=1e-3, estimator=estimator)
    >>> panels = tc.plot.estimate(run)
    >>> list(panels), panels["error"].ax.get_ylabel()
    (['length', 'error'], 'error of length, mm')
    >>> plt.close(panels["length"].ax.figure)
    """
    validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
    if run.control is None or run.control.estimate is None:
        raise ValueError("run has no estimate: give simulate a controller and an estimator")
    record = run.control.estimate
    structure = run.structure
    if structure.parent is not None and record.nodes.shape[1] < structure.nodes.shape[1]:
        structure = structure.parent
    which = checked_indices("strings", strings, len(structure.strings), "string indices", "(0, 1)")
    seen = run.nodes[:, : record.nodes.shape[1]]
    true, estimated = (_lengths(structure, which, nodes) for nodes in (seen, record.nodes))
    samples = np.searchsorted(run.time, record.time - 1e-9 * run.time[-1])
    places = panel_axes(axes, ["length", "error"])
    names = [f"string {i}" for i in which]
    length = draw_curves(
        places[0],
        run.time,
        {name: row[None] for name, row in zip(names, true, strict=True)},
        "length, m",
        xlabel=None if axes is None else "time, s",
    )
    for position, row in enumerate(estimated):
        style = curve_style(position) | {"linestyle": "none"}
        label = "estimated" if position == 0 else "_"
        places[0].plot(record.time, row, marker="o", markersize=2.0, label=label, **style)
    legend_above(places[0])
    off = 1e3 * (estimated - true[:, samples])
    error = draw_curves(
        places[1],
        record.time,
        {name: row[None] for name, row in zip(names, off, strict=True)},
        "error of length, mm",
    )
    # At the start the filter knows little: that band would hide all that follows.
    usual = 3e3 * float(np.median(record.length_deviation[which]))
    room = max(usual, 1.2 * float(np.abs(off).max()))
    places[1].set_ylim(-room, room)
    for position, i in enumerate(which):
        band = 2e3 * record.length_deviation[i]
        places[1].fill_between(
            record.time,
            -band,
            band,
            color=PALETTE[position % len(PALETTE)],
            alpha=0.15,
            linewidth=0,
            label="± 2 standard deviations" if position == 0 else "_",
        )
    error = mark_statuses(error, record.time, record.status, _MARKERS, height=0.03)
    legend_above(places[1])
    return {"length": length, "error": error}


def _lengths(structure: Structure, which: list[int], nodes: FloatArray) -> FloatArray:
    """Return lengths of some strings over time, shape (k, T)."""
    start, end = structure.segments.T
    segments = np.linalg.norm(nodes[:, end] - nodes[:, start], axis=0)
    return np.array([segments[structure.segment_string == i].sum(axis=0) for i in which])
