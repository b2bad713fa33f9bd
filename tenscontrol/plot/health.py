"""What tells whether to trust a motion: energy, momentum, bar lengths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from tenscontrol.plot.axes import panel_axes
from tenscontrol.plot.history import Curves, draw_curves
from tenscontrol.simulation import Trajectory
from tenscontrol.validation import FloatArray, instance

_ROUND_OFF = float(np.finfo(float).eps)

# Round-off fills the foot of a panel, not the whole of it.
_LEAST_SPAN = 1e4


def health(run: Trajectory, *, axes: Sequence[Axes] | None = None) -> dict[str, Curves]:
    """Draw what tells whether to trust a motion.

    The panels are ``"energy"``; ``"momentum"``, the change since the start; and
    ``"bar_length_error"``, the largest of all bars, if there are bars. The
    last two have logarithmic scales: a straight rise is a drift. What is below
    round-off is drawn at round-off.

    Parameters
    ----------
    run : Trajectory
    axes : sequence of Axes, optional
        Where to draw, one for each panel; a new figure if not given.

    Returns
    -------
    dict of str to Curves
        What was drawn, by panel.

    Raises
    ------
    TypeError, ValueError
        If ``run`` is not a trajectory or ``axes`` does not fit.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> model = tc.Model(tc.prism())
    >>> run = tc.simulate(model, 0.2, force_density=[17.3205] * 6 + [9.0] * 3, step=1e-3)
    >>> panels = tc.plot.health(run)
    >>> list(panels), panels["bar_length_error"].ax.get_yscale()
    (['energy', 'momentum', 'bar_length_error'], 'log')
    >>> plt.close(panels["energy"].ax.figure)
    """
    instance("run", run, Trajectory, "make one by simulate(model, ...)")
    names = ["energy", "momentum"] + ["bar_length_error"] * bool(len(run.structure.bars))
    places = dict(zip(names, panel_axes(axes, names), strict=True))

    def label(name: str) -> str | None:
        return "time, s" if axes is not None or name == names[-1] else None

    panels = {
        "energy": draw_curves(
            places["energy"], run.time, _energies(run), "energy, J", xlabel=label("energy")
        ),
        "momentum": _momenta(places["momentum"], run, label("momentum")),
    }
    if "bar_length_error" in places:
        panels["bar_length_error"] = _bar_lengths(
            places["bar_length_error"], run, label("bar_length_error")
        )
    return panels


def _energies(run: Trajectory) -> dict[str, FloatArray]:
    change = float(run.energy[-1] - run.energy[0])
    rows = {
        "kinetic": run.kinetic_energy[None],
        "potential": run.potential_energy[None],
        f"total (change {change:+.2g} J)": run.energy[None],
    }
    if run.released_energy.any():
        rows["lost with cut strings"] = run.released_energy[None]
    return rows


def _momenta(ax: Axes, run: Trajectory, xlabel: str | None) -> Curves:
    structure = run.structure
    mass = float(structure.bar_mass.sum() + structure.string_node_mass.sum())
    speed = float(np.linalg.norm(run.velocities, axis=0).max())
    arm = float(np.linalg.norm(run.nodes, axis=0).max())
    changes = {
        "linear, kg m/s": _change(run.momentum),
        "angular, kg m²/s": _change(run.angular_momentum),
    }
    label = "momentum change,\nkg m/s, kg m²/s"
    return _logarithmic(ax, run.time, changes, label, mass * speed * max(arm, 1.0), xlabel)


def _bar_lengths(ax: Axes, run: Trajectory, xlabel: str | None) -> Curves:
    errors = {"largest of all bars": np.abs(run.bar_length_error).max(axis=0)}
    longest = float(run.structure.bar_length.max())
    return _logarithmic(ax, run.time, errors, "bar-length error, m", longest, xlabel)


def _change(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors - vectors[:, :1], axis=0))


def _logarithmic(
    ax: Axes,
    time: FloatArray,
    errors: dict[str, FloatArray],
    ylabel: str,
    size: float,
    xlabel: str | None,
) -> Curves:
    """Draw errors of a quantity of this size; none is drawn below its round-off."""
    floor = _ROUND_OFF * (size if size > 0 else 1.0)
    curves = draw_curves(
        ax,
        time,
        {name: np.maximum(values, floor)[None] for name, values in errors.items()},
        ylabel,
        references={"round-off": np.array(floor)},
        xlabel=xlabel,
    )
    largest = max(float(values.max()) for values in errors.values())
    ax.set_yscale("log")
    ax.yaxis.set_minor_locator(NullLocator())
    ax.set_ylim(floor / 5, max(_LEAST_SPAN * floor, 5 * largest))
    return curves
