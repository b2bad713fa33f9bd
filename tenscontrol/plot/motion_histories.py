"""Time histories of a motion: its coordinates and strings, and what tells whether to trust it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.plot.histories import (
    Curves,
    checked_references,
    draw_curves,
    drop_repeated_legends,
    mark_statuses,
)
from tenscontrol.plot.structure_drawing import known_actuation, passive_strings
from tenscontrol.plot.style import (
    REFERENCE_COLOR,
    REFERENCE_WIDTH,
    checked_indices,
    closes_on_error,
    decade_ticks,
    legend_above,
    reference_style,
    timed_panels,
)
from tenscontrol.simulation.control_record import ControlRecord
from tenscontrol.simulation.faults import CutString
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.status import Status
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import moving_mass

# Curves of a panel by name, its label, and whether values are held between times.
_Content = tuple[dict[str, FloatArray], str, bool]

# Marks for statuses, told apart by their form.
_MARKERS = ("v", "x", "s", "d", "P", "^")

_ROUND_OFF = float(np.finfo(float).eps)

# Errors are drawn up to this: what is infinite too.
_LOST = 10.0

# Nodes drawn unless the user says which, and the grey of all others.
_MOVING, _OTHERS = 4, "0.8"

# Round-off fills the foot of a panel, not the whole of it.
_LEAST_SPAN = 1e4

# What is below this part of the largest error is round-off, and its axis does not reach there.
_RESOLVED = 1e-10


def _with_faults(panel: Curves, run: Trajectory) -> Curves:
    """Mark faults in a panel: a line where a string is cut, a bracket while something is broken."""
    if not run.faults:
        return panel
    marks, last = dict(panel.marks), float(run.time[-1])
    for position, fault in enumerate(fault for fault in run.faults if fault.start <= last):
        end = min(fault.end, last)
        for_good = isinstance(fault, CutString)
        times, heights = ([fault.start] * 2, [0, 1]) if for_good else (
            [fault.start, fault.start, end, end], [0, 1, 1, 0]
        )  # fmt: skip
        style = reference_style(position) | {"linewidth": REFERENCE_WIDTH * (1 if for_good else 2)}
        (marks[f"{fault.label} at {fault.start:g} s"],) = panel.ax.plot(
            times,
            heights,
            transform=panel.ax.get_xaxis_transform(),
            zorder=1.7,
            marker="x" if for_good else "none",
            markeredgecolor=REFERENCE_COLOR,
            label=f"{fault.label} at {fault.start:g} s",
            **style,
        )
    legend_above(panel.ax)
    return replace(panel, marks=marks)


def _rest_lengths(run: Trajectory) -> FloatArray:
    """Return the rest lengths of a run, those of cut strings left out, NaN, shape (α, T)."""
    assert run.rest_length is not None  # callers draw rest lengths
    shown = run.rest_length.copy()
    for fault in run.faults:
        if isinstance(fault, CutString):
            shown[fault.string, (run.time > fault.time) | (fault.time == 0)] = np.nan
    return shown


def _with_doubt(panel: Curves, run: Trajectory) -> Curves:
    """Shade the time from which on the motion is not to be trusted, if there is such a time."""
    if run.trusted_until is None or run.trusted_until >= run.time[-1]:
        return panel
    label = "not to be trusted"
    panel.ax.axvspan(
        run.trusted_until, run.time[-1], facecolor="0.93", edgecolor="0.8", hatch="//",
        linewidth=0.0, zorder=0.5, label=label,
    )  # fmt: skip
    legend_above(panel.ax)
    return panel


@closes_on_error
def trajectory(
    run: Trajectory,
    *,
    nodes: Sequence[int] | None = None,
    directions: str | None = None,
    relative_to: object = "start",
    references: Mapping[str, object] | None = None,
    axes: Sequence[Axes] | None = None,
) -> dict[str, Curves]:
    """Draw the time histories of a motion, one panel for each kind of quantity.

    The panels are ``"coordinates"``; ``"force_density"``, with one style for each string group, or
    of one group for each of the four strings that change most, if there are strings; and
    ``"rest_length"`` if rest lengths were held. The first shows how far the nodes that move most
    are from where they started, with all others in grey, and under a controller with a reference
    how far the farthest node is from that; the time in which the motion is not to be trusted is
    shaded. What was held is drawn in steps. Samples at which a controller's status was not ``"ok"``
    are marked on the lowest time axis, faults in the panels of force densities and rest lengths; a
    cut string has no rest length. Driven and passive strings of a group have styles of their own.

    Parameters
    ----------
    run : Trajectory
    nodes : sequence of int, optional
        The nodes drawn; if not given, up to four that move most.
    directions : str, optional
        Coordinates to draw, letters out of ``"xyz"``, in place of distances.
    relative_to : {"start", "origin"} or array_like, shape (d, n) or (d, n, T)
        What displacements are counted from: the start of the run, or a shape of reference, m,
        fixed or one for each time. ``"origin"`` draws absolute coordinates, in all directions if
        none are given.
    references : mapping of str to float or array_like, shape (T,), optional
        Lines to compare with, m: a target height, say.
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
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> start = tc.to_rest_length(model, prism.nodes, [17.3205] * 6 + [9.0] * 3).rest_length
    >>> run = tc.simulate(model, 0.2, rest_length=start, step=1e-3)
    >>> panels = tc.plot.trajectory(run)
    >>> list(panels), list(panels["force_density"].lines)
    (['coordinates', 'force_density', 'rest_length'], ['top', 'bottom', 'vertical'])
    >>> list(panels["coordinates"].lines)
    ['node 0', 'node 1', 'node 2', 'node 3', 'other 2 of 6 nodes']

    Heights above the ground, of two nodes:

    >>> heights = tc.plot.trajectory(run, nodes=[0, 3], directions="z", relative_to="origin")
    >>> list(heights["coordinates"].lines)
    ['z[0]', 'z[3]']
    >>> plt.close(heights["coordinates"].ax.figure)
    >>> plt.close(panels["coordinates"].ax.figure)
    """
    validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
    base, of = _base(run, relative_to)
    from_start, absolute = (
        isinstance(relative_to, str) and relative_to == choice for choice in ("start", "origin")
    )
    coordinates, others = _coordinates(run, nodes, directions, base, absolute)
    levels = checked_references(references, len(run.time))
    tracked = directions is None and from_start
    # Panel: curves, label, and whether the quantity was held from sample to sample.
    content: dict[str, tuple[dict[str, FloatArray], str, bool]] = {
        "coordinates": (coordinates, of, False)
    }
    passive = passive_strings(run.structure, known_actuation(run))
    if len(run.structure.strings):
        labels = _string_labels(run.structure, passive)
        by_group = _by_group(labels, run.force_density, run.force_density)
        content["force_density"] = (by_group, "γ, N/m", run.rest_length is None)
    if run.rest_length is not None and len(run.structure.strings):
        wound = _by_group(labels, _rest_lengths(run), run.force_density)
        content["rest_length"] = (wound, "rest length, m", True)
    panels = {}
    for ax, name, xlabel in timed_panels(axes, list(content)):
        rows, label, held = content[name]
        panels[name] = draw_curves(
            ax,
            run.time,
            rows,
            label,
            held=held,
            xlabel=xlabel,
            references=levels if name == "coordinates" else None,
        )
        if name == "coordinates":
            panels[name] = _with_distances(panels[name], run, others, tracked)
        else:
            panels[name] = _with_faults(_in_grey(panels[name]), run)
        panels[name] = _with_doubt(panels[name], run)
    if run.control is not None:
        panels[name] = _with_statuses(panels[name], run.control)
    if axes is None:
        drop_repeated_legends(panels)
    return panels


def _base(run: Trajectory, relative_to: object) -> tuple[FloatArray, str]:
    """Return what displacements are counted from, shape (d, n, 1) or (d, n, T), and their name."""
    start = run.nodes[:, :, :1]
    if isinstance(relative_to, str):
        if validation.choice("relative_to", relative_to, ("start", "origin")) == "start":
            return start, "displacement\nfrom the start, m"
        return 0 * start, "node position, m"
    base = validation.float_array("relative_to", relative_to)
    if base.shape not in (run.nodes.shape[:2], run.nodes.shape):
        raise ValueError(
            f"relative_to has shape {base.shape}, expected {run.nodes.shape[:2]} for one shape, or "
            f"{run.nodes.shape} for one at each time"
        )
    return base.reshape(*base.shape[:2], -1), "displacement from\nthe reference, m"


def _coordinates(
    run: Trajectory, nodes: object, directions: object, base: FloatArray, absolute: bool
) -> tuple[dict[str, FloatArray], FloatArray]:
    """Return curves by name, ``"node 0"`` or ``"x[0]"``, and the distances of all other nodes."""
    axes = "xyz"[: run.structure.dimension]
    if directions is None and absolute:
        directions = axes
    if directions is not None and (
        not isinstance(directions, str) or not directions or set(directions) - set(axes)
    ):
        raise ValueError(f"directions is {directions!r}, expected letters out of {axes!r}")
    moved, count = run.nodes - base, run.nodes.shape[1]
    if nodes is None:
        most = max(1, _MOVING // len(directions or "d"))
        away = np.linalg.norm(moved - moved[:, :, :1] if absolute else moved, axis=0)
        # Nodes of a symmetric structure move alike: round-off does not choose between them.
        far = np.round(away.max(axis=1) / max(float(away.max()), 1e-300), 6)
        most = max(1, min(most, int((far > 0).sum())))
        chosen = sorted(np.argsort(-far, kind="stable")[:most].tolist())
    else:
        chosen = checked_indices("nodes", nodes, count, "node indices", "(0, 1)")
    if directions is None:
        distance = np.linalg.norm(moved, axis=0)
        return (
            {f"node {node}": distance[node][None] for node in chosen},
            distance[np.setdiff1d(np.arange(count), chosen)],
        )
    return {
        f"{direction}[{node}]": moved["xyz".index(direction), node][None]
        for node in chosen
        for direction in directions
    }, np.zeros((0, len(run.time)))


def _with_distances(panel: Curves, run: Trajectory, others: FloatArray, tracked: bool) -> Curves:
    """Draw the distances of the other nodes in grey, and that from a controller's reference."""
    lines = dict(panel.lines)
    if len(others):
        label = f"other {len(others)} of {run.nodes.shape[1]} nodes"
        drawn = panel.ax.plot(run.time, others.T, color=_OTHERS, linewidth=0.6, zorder=1.6)
        for line in drawn:
            line.set_label(label if line is drawn[0] else "_")
        lines[label] = tuple(drawn)
    references = dict(panel.references)
    if tracked and run.control is not None and run.control.tracking_error is not None:
        label = "farthest from reference"
        times = np.append(run.control.time, run.time[-1])
        style = reference_style(len(references))
        (references[label],) = panel.ax.plot(
            times, run.control.tracking_error, label=label, **style
        )
    legend_above(panel.ax)
    return replace(panel, lines=lines, references=references)


def _by_group(
    groups: Sequence[str], values: FloatArray, first: FloatArray
) -> dict[str, FloatArray]:  # fmt: skip
    """Return curves by the group of each; of one group, of those that change most and others.

    Which change most, ``first`` says, the values of the first panel.
    """
    group_of, names, count = np.array(groups), list(dict.fromkeys(groups)), len(values)
    if len(names) > 1 or count == 1:
        return {name: values[group_of == name] for name in names}
    known = np.where(np.isfinite(first), first, 0.0)
    change = np.ptp(known, axis=1) / max(float(np.abs(known).max(initial=0.0)), 1e-300)
    # Strings of a symmetric structure change alike: round-off does not choose between them.
    chosen = np.sort(np.argsort(-change.round(6), kind="stable")[:_MOVING])
    others = np.setdiff1d(np.arange(count), chosen)
    rows = {f"string {i}": values[[i]] for i in chosen.tolist()}
    if len(others):
        rows[f"other {len(others)} of {count} strings"] = values[others]
    return rows


def _in_grey(panel: Curves) -> Curves:
    """Draw curves of other strings in grey, behind those with a name of their own."""
    for name, lines in panel.lines.items():
        if name.startswith("other ") and name.endswith(" strings"):
            for line in lines:
                line.set(color=_OTHERS, linewidth=0.6, linestyle="solid", zorder=1.6)
    legend_above(panel.ax)
    return panel


def _string_labels(structure: Structure, passive: np.ndarray | None) -> list[str]:
    """Return the group of each string, driven and passive ones apart."""
    groups = list(structure.string_groups)
    if passive is None:
        return groups
    kinds = np.where(passive, "passive", "driven")
    return [f"{group}, {kind}" for group, kind in zip(groups, kinds, strict=True)]


def _with_statuses(panel: Curves, control: ControlRecord) -> Curves:
    """Mark the samples whose status is not ok on the time axis of a panel."""
    labels = [
        ": ".join(filter(None, pair)) for pair in zip(control.status, control.fallback, strict=True)
    ]
    statuses = [label for label in dict.fromkeys(labels) if label != Status.OK]
    markers = dict(zip(statuses, cycle(_MARKERS), strict=False))
    panel = mark_statuses(panel, control.time, labels, markers)
    if statuses:
        legend_above(panel.ax)
    return panel


@closes_on_error
def motors(run: Trajectory, *, axes: Sequence[Axes] | None = None) -> dict[str, Curves]:
    """Draw what the motors of the winches, or of force-controlled cables, did.

    The panels are ``"angle"``, ``"speed"``, ``"torque"`` and ``"power"``, with one style for each
    string group, and ``"energy"``, of all motors together. Positive is winding in, and giving.

    Parameters
    ----------
    run : Trajectory
        Under a controller, with ``winches=Winches(motor=...)``.
    axes : sequence of Axes, optional
        Where to draw, one for each panel; a new figure if not given.

    Returns
    -------
    dict of str to Curves
        What was drawn, by panel.

    Raises
    ------
    TypeError, ValueError
        If ``run`` is no run, or has no motors, or ``axes`` does not fit.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> prism = tc.prism()
    >>> rest = tc.prestress(prism, force_density=10.0)
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0, damping=0.5))
    >>> plant = tc.linearize(model, rest, input="rest_length")
    >>> run = tc.simulate(
    ...     model, 0.2, plant.to_nodes([0.02] + 8 * [0.0]), step=1e-3,
    ...     controller=tc.LQR(plant, *tc.energy_weights(plant), sample_time=0.02),
    ...     rest_length=plant.rest_length,
    ...     winches=tc.Winches(ramp=True, motor=tc.Motor(drum_radius=0.01, gear_ratio=20.0)))
    >>> panels = tc.plot.motors(run)
    >>> list(panels), list(panels["torque"].lines)
    (['angle', 'speed', 'torque', 'power', 'energy'], ['top', 'bottom', 'vertical'])
    >>> plt.close(panels["angle"].ax.figure)
    """
    validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
    record = None if run.control is None else run.control.motors
    if record is None:
        raise ValueError("run has no motors: simulate it with winches=Winches(motor=Motor(...))")
    groups = _wound_groups(run, len(record.zero))
    units = {"angle": "rad", "speed": "rad/s", "torque": "N m", "power": "W"}
    content: dict[str, _Content] = {
        name: (
            _by_group(groups, getattr(record, name), record.angle),
            f"motor {name}, {unit}",
            name == "speed",
        )
        for name, unit in units.items()
    }
    energy = record.energy.sum(axis=0, keepdims=True)
    content["energy"] = {"all motors": energy}, "motor energy, J", False
    return _of_drives(run, record.time, content, axes)


@closes_on_error
def struts(run: Trajectory, *, axes: Sequence[Axes] | None = None) -> dict[str, Curves]:
    """Draw what the driven bars of a run did.

    The panels are ``"length"``, ``"rate"``, ``"force"``, positive in compression, and ``"power"``,
    with one style for each driven bar, and ``"work"``, of all drives together.

    Parameters
    ----------
    run : Trajectory
        Simulated with ``bar_length``, or under a controller of the lengths of bars.
    axes : sequence of Axes, optional
        Where to draw, one for each panel; a new figure if not given.

    Returns
    -------
    dict of str to Curves
        What was drawn, by panel.

    Raises
    ------
    TypeError, ValueError
        If ``run`` is no run, or drives no bar, or ``axes`` does not fit.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> rod = tc.Model(tc.Structure([[0, 0], [0, 1], [0, 0]], [(0, 1)], [], 2.0))
    >>> grow = tc.Profile([0.0, 0.5], [[1.0, 1.2]], "cubic")
    >>> panels = tc.plot.struts(tc.simulate(rod, 0.5, bar_length=grow))
    >>> list(panels), list(panels["length"].lines)
    (['length', 'rate', 'force', 'power', 'work'], ['bar 0'])
    >>> plt.close(panels["length"].ax.figure)
    """
    validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
    record = run.struts
    if record is None or not len(record.bar):
        raise ValueError("run drives no bar: simulate it with bar_length=Profile(...)")
    units = {"length": "m", "rate": "m/s", "force": "N", "power": "W"}
    content: dict[str, _Content] = {
        name: (
            {f"bar {bar}": getattr(record, name)[bar : bar + 1] for bar in record.bar},
            f"{name}, {unit}",
            False,
        )
        for name, unit in units.items()
    }
    content["work"] = {"all drives": record.work.sum(axis=0, keepdims=True)}, "work, J", False
    return _of_drives(run, run.time, content, axes)


def _of_drives(
    run: Trajectory,
    time: FloatArray,
    content: Mapping[str, _Content],
    axes: Sequence[Axes] | None,
) -> dict[str, Curves]:
    """Draw what drives of strings or bars did: curves, label and whether steps, by panel."""
    panels = {}
    for ax, name, xlabel in timed_panels(axes, list(content)):
        rows, label, held = content[name]
        panel = draw_curves(ax, time, rows, label, held=held, xlabel=xlabel)
        panels[name] = _with_faults(_in_grey(panel), run)
    if axes is None:
        drop_repeated_legends(panels)
    return panels


def _wound_groups(run: Trajectory, motors: int) -> list[str]:
    """Return the string group of each motor: that of its string, or of the lead of several."""
    structure, actuation = run.structure, known_actuation(run)
    winches = motors if actuation is None else len(actuation.input)
    if structure.parent is not None and len(structure.strings) != winches:
        structure = structure.parent
    if actuation is None:
        return list(structure.string_groups)
    return [structure.string_groups[lead] for lead in actuation.lead.tolist()]


@closes_on_error
def health(run: Trajectory, *, axes: Sequence[Axes] | None = None) -> dict[str, Curves]:
    """Draw what tells whether to trust a motion.

    The panels are ``"error"``, the estimated error of the nodes with its limit, if it was
    estimated; ``"energy"``; ``"momentum"``, the change since the start; and ``"bar_length_error"``,
    the largest of all bars, if there are bars. All but the energy have logarithmic scales: a
    straight rise of the error says that the motion magnifies errors. What is below round-off is
    drawn at round-off. The time in which the motion is not to be trusted is shaded. Times at which
    bars pass through each other are marked on the lowest time axis.

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
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> model = tc.Model(tc.prism())
    >>> run = tc.simulate(model, 0.15, force_density=[17.3205] * 6 + [9.0] * 3, step=1e-3)
    >>> panels = tc.plot.health(run)
    >>> list(panels), panels["bar_length_error"].ax.get_yscale()
    (['error', 'energy', 'momentum', 'bar_length_error'], 'log')
    >>> plt.close(panels["energy"].ax.figure)
    """
    validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
    mass = moving_mass(run.structure)
    speed = float(np.linalg.norm(run.velocities, axis=0).max())
    arm = float(np.linalg.norm(run.nodes, axis=0).max())
    # Panel: curves, label, and the size of the quantity where the scale is logarithmic.
    content: dict[str, tuple[dict[str, FloatArray], str, float | None]] = {
        "energy": (_energies(run), "energy, J", None),
        "momentum": (
            {
                "linear, kg m/s": _change(run.momentum),
                "angular, kg m²/s": _change(run.angular_momentum),
            },
            "momentum change,\nkg m/s, kg m²/s",
            mass * speed * max(arm, 1.0),
        ),
    }
    if len(run.structure.bars):
        worst = {"largest of all bars": np.abs(run.bar_length_error).max(axis=0)[None]}
        longest = float(run.structure.bar_length.max())
        content["bar_length_error"] = (worst, "bar-length error, m", longest)
    if run.error is not None:
        error = {"estimate": np.minimum(run.error, _LOST)[None]}
        content = {"error": (error, "error of nodes,\npart of the size", 1.0), **content}
    panels = {}
    for ax, name, xlabel in timed_panels(axes, list(content)):
        rows, label, size = content[name]
        if size is None:
            panels[name] = draw_curves(ax, run.time, rows, label, xlabel=xlabel)
        else:
            panels[name] = _logarithmic(ax, run.time, rows, label, size, xlabel)
        if name == "error":
            line = ax.axhline(run.error_limit, label="limit", **reference_style(1))
            references = {**panels[name].references, "limit": line}
            panels[name] = replace(panels[name], references=references)
            ax.set_ylim(top=max(ax.get_ylim()[1], 5 * run.error_limit))
            legend_above(ax)
        panels[name] = _with_doubt(panels[name], run)
    if run.bar_crossings:
        times = np.array([crossing.time for crossing in run.bar_crossings])
        crossed = ["bars cross"] * len(times)
        panels[name] = mark_statuses(panels[name], times, crossed, {"bars cross": "x"})
        legend_above(panels[name].ax)
    return panels


@closes_on_error
def tracking(run: Trajectory, *, axes: Sequence[Axes] | None = None) -> dict[str, Curves]:
    """Draw how well a controller did, sample by sample.

    The panels are ``"tracking_error"``, of the node farthest off the reference, if the controller
    has one; ``"prediction_error"``, of the node farthest off its prediction a sample before, if it
    predicts; and ``"computing_time"`` with the sample time. All have logarithmic scales. Samples
    at which the status was not ``"ok"`` are marked on the lowest time axis.

    Parameters
    ----------
    run : Trajectory
        Under a controller.
    axes : sequence of Axes, optional
        Where to draw, one for each panel; a new figure if not given.

    Returns
    -------
    dict of str to Curves
        What was drawn, by panel.

    Raises
    ------
    TypeError, ValueError
        If ``run`` is not a trajectory under a controller, or ``axes`` does not fit.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> plant = tc.linearize(model, tc.prestress(prism, 10.0), input="rest_length")
    >>> mpc = tc.MPC(plant, horizon=10, sample_time=0.02)
    >>> run = tc.simulate(model, 0.5, plant.to_nodes([0.02] * 9), controller=mpc, step=1e-3)
    >>> panels = tc.plot.tracking(run)
    >>> list(panels)
    ['tracking_error', 'prediction_error', 'computing_time']
    >>> plt.close(panels["tracking_error"].ax.figure)
    """
    validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
    record = run.control
    if record is None:
        raise ValueError("run has no controller: simulate(model, ..., controller=...) records one")
    # Panel: time, values, label and reference lines.
    content: dict[str, tuple[FloatArray, FloatArray, str, dict[str, FloatArray]]] = {}
    if record.tracking_error is not None:
        times = np.append(record.time, run.time[-1])
        content["tracking_error"] = (times, record.tracking_error, "tracking error, m", {})
    if record.prediction_error is not None and np.isfinite(record.prediction_error).any():
        missed = record.prediction_error
        content["prediction_error"] = (record.time, missed, "prediction error, m", {})
    whole = {} if record.sample_time is None else {"sample time": np.array(record.sample_time)}
    content["computing_time"] = (record.time, record.computing_time, "computing time, s", whole)
    panels = {}
    for ax, name, xlabel in timed_panels(axes, list(content)):
        times, values, label, levels = content[name]
        rows = {"farthest node" if label.endswith("m") else "controller": values[None]}
        panels[name] = draw_curves(ax, times, rows, label, references=levels, xlabel=xlabel)
        if (values > 0).any():  # NaN is not
            ax.set_yscale("log")
            largest = np.nanmax(values)
            ax.set_ylim(bottom=np.nanmin(values[values > _RESOLVED * largest]) / 1.5)
            decade_ticks(ax.yaxis)
    panels[name] = _with_statuses(panels[name], record)
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
    if run.contacts is not None:
        rows["lost at the ground"] = run.lost_energy[None]
    return rows


def _change(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors - vectors[:, :1], axis=0))[None]


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
    rows = {name: np.maximum(values, floor) for name, values in errors.items()}
    round_off = {"round-off": np.array(floor)}
    curves = draw_curves(ax, time, rows, ylabel, references=round_off, xlabel=xlabel)
    largest = max(float(values.max()) for values in errors.values())
    ax.set_yscale("log")
    ax.set_ylim(floor / 5, max(_LEAST_SPAN * floor, 5 * largest))
    decade_ticks(ax.yaxis)
    return curves
