"""Figure of a planned motion beside its replay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.plot.histories import Curves, draw_curves, drop_repeated_legends
from tenscontrol.plot.style import closes_on_error, legend_above, marker_style, timed_panels

if TYPE_CHECKING:  # who draws something else does not wait for optimal motions
    from tenscontrol.optimize.optimal_motion import OptimalMotion

# Of markers of the plan, points.
_MARKER = 4.0

# What the panel of an input is called.
_LABELS = {"rest_length": "rest length, m", "force_density": "γ, N/m"}


@closes_on_error
def optimal_motion(
    motion: OptimalMotion, *, axes: Sequence[Axes] | None = None
) -> dict[str, Curves]:
    """Draw a planned motion, and what the simulator made of it.

    The panels are ``"distance"``, of the farthest node from the goal: a line for the replay, a mark
    for the plan at the end of each interval; ``"input"``, rest lengths or γ; ``"rate"`` of rest
    lengths; and ``"tension"`` in the replay. Strings have one style for each group.

    Parameters
    ----------
    motion : OptimalMotion
        One that was planned.
    axes : sequence of Axes, optional
        Where to draw, one for each panel; a new figure if not given.

    Returns
    -------
    dict of str to Curves
        What was drawn, by panel.

    Raises
    ------
    TypeError, ValueError
        If ``motion`` is none, or nothing was planned, or ``axes`` does not fit.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> arm = tc.library.arm()
    >>> model = tc.Model(arm, strings=tc.LinearStrings(stiffness=500.0, damping=2.0))
    >>> rest = tc.prestress(arm, min_force_density=50.0)
    >>> up = tc.NodesAt([5], arm.nodes[:, [5]] + [[0.0], [0.1]])
    >>> motion = tc.optimal_motion(
    ...     model, rest, up, winches=tc.Winches(rate=0.8), intervals=8, tolerance=1e-2)
    >>> panels = tc.plot.optimal_motion(motion)
    >>> list(panels)
    ['distance', 'input', 'rate', 'tension']
    >>> plt.close(panels["rate"].ax.figure)
    """
    from tenscontrol.optimize.optimal_motion import OptimalMotion

    validation.instance("motion", motion, OptimalMotion, "make one by optimal_motion(model, ...)")
    run = motion.run
    if run is None:
        raise ValueError(f"motion was not planned, so there is nothing to draw: {motion.message}")
    structure = motion.structure
    is_wound = motion.rest_length is not None
    names = ["distance", "input", *(["rate"] if is_wound else []), "tension"]
    profile, panels = motion.profile, dict[str, Curves]()
    for ax, name, xlabel in timed_panels(axes, names):
        if name == "distance":
            own = {"replay": motion.goal_distance(run.nodes)[None]}
            panel = draw_curves(ax, run.time, own, "distance from\ngoal, m", xlabel=xlabel)
            ax.plot(
                motion.time, motion.goal_distance(motion.nodes), label="plan",
                **marker_style("o", _MARKER, "0.2"),
            )  # fmt: skip
            legend_above(ax)
        elif name == "input":
            values = _by_group(motion, profile.at(run.time[:-1]))
            panel = draw_curves(ax, run.time[:-1], values, _LABELS[motion.input], xlabel=xlabel)
        elif name == "rate":
            time, rate = motion.time, np.column_stack([motion.rate[:, 0], motion.rate])
            held = profile.interpolation == "linear"
            if not held:
                time, rate = run.time[:-1], profile.rate(run.time[:-1])
            panel = draw_curves(
                ax, time, _by_group(motion, rate), "winch, m/s", held=held, xlabel=xlabel
            )
        else:
            lengths = [structure.string_length(nodes) for nodes in np.moveaxis(run.nodes, 2, 0)]
            tension = run.force_density * np.column_stack(lengths)
            panel = draw_curves(
                ax, run.time, _by_group(motion, tension), "tension, N", xlabel=xlabel
            )
        panels[name] = panel
    if axes is None:
        drop_repeated_legends(panels)
    return panels


def _by_group(motion: OptimalMotion, values: FloatArray) -> dict[str, FloatArray]:
    """Return the rows of the strings of each group."""
    structure = motion.structure
    groups = dict.fromkeys(structure.string_groups)
    return {group: values[structure.strings_in(group)] for group in groups}
