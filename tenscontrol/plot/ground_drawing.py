"""Drawings of the ground: beneath a structure, and its contacts over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.dynamics.contact_laws import ContactLaw
from tenscontrol.plot.histories import Curves, draw_curves
from tenscontrol.plot.style import (
    GROUND,
    NORMAL,
    PALETTE,
    closes_on_error,
    curve_style,
    dress,
    marker_style,
    timed_panels,
)
from tenscontrol.simulation.contacts import ContactRecord
from tenscontrol.simulation.trajectory import Trajectory

# Points along each side of a curved ground, and how far beyond the nodes a surface reaches, as a
# part of the size.
_POINTS, _BEYOND = 33, 0.15

# Contacts with a curve of their own name: those with the largest impulse.
_NAMED = 6


def near_ground(laws: Sequence[ContactLaw], points: FloatArray) -> FloatArray:
    """Return the points of the ground beneath points (d, k), if they are within their size."""
    feet = [np.zeros((len(points), 0))]
    size = float(np.ptp(points, axis=1).max())
    for law in laws:
        x = ca.DM(points)
        depth, _, away = (np.array(output) for output in law.sinking(x, 0 * x))
        beneath = points + depth * away / (away**2).sum(axis=0)
        feet.append(beneath[:, np.abs(depth[0]) <= size])
    return np.hstack(feet)


def _draw(ax: Any, laws: Sequence[ContactLaw]) -> tuple[Any, ...]:
    """Draw grounds within the limits of axes; patches in space, in the plane what is beneath."""
    limits = [ax.get_xlim(), ax.get_ylim(), *([ax.get_zlim()] if ax.name == "3d" else [])]
    box = np.array(limits)
    one = _patch if ax.name == "3d" else _below
    return tuple(patch for law in laws for patch in one(ax, law, box))


def _patch(ax: Any, law: ContactLaw, box: FloatArray) -> list[Any]:
    look = {"color": GROUND, "alpha": 0.45, "zorder": 0.4}
    if isinstance(law.height, ca.Function):
        x, y = np.meshgrid(*(np.linspace(low, high, _POINTS) for low, high in box[:2]))
        z = _heights(law.height, x, y)
        z[(z < box[2, 0]) | (z > box[2, 1])] = np.nan
        return [ax.plot_surface(x, y, z, rstride=1, cstride=1, shade=True, linewidth=0.0, **look)]
    border = plane_border(law, box)
    if not len(border):
        return []
    patch = Poly3DCollection([border], edgecolor="0.45", linewidth=0.8, **look)
    ax.add_collection(patch, autolim=False)  # as add_collection3d of new matplotlib
    return [patch]


def plane_border(law: ContactLaw, box: FloatArray) -> FloatArray:
    """Return the corners, shape (k, 3), of the part of a plane in a box, shape (3, 2)."""
    normal = law.up(3)
    steep = int(np.abs(normal).argmax())
    along = [axis for axis in range(3) if axis != steep]
    corners = np.zeros((4, 3))
    corners[:, along[0]] = box[along[0]][[0, 1, 1, 0]]
    corners[:, along[1]] = box[along[1]][[0, 0, 1, 1]]
    corners[:, steep] = (law.height - corners @ normal) / normal[steep]
    for bound, sign in ((box[steep, 0], 1.0), (box[steep, 1], -1.0)):
        corners = _clipped(corners, sign * (corners[:, steep] - bound))
    return corners


def _clipped(corners: FloatArray, inside: FloatArray) -> FloatArray:
    """Return the part of a polygon where a linear function of its corners is not negative."""
    clipped = []
    for i, value in enumerate(inside):
        before = inside[i - 1]
        if (value >= 0) != (before >= 0):
            share = before / (before - value)
            clipped.append((1 - share) * corners[i - 1] + share * corners[i])
        if value >= 0:
            clipped.append(corners[i])
    return np.array(clipped).reshape(-1, corners.shape[1])


def _below(ax: Any, law: ContactLaw, box: FloatArray) -> list[Any]:
    if isinstance(law.height, ca.Function):
        x = np.linspace(box[0, 0], box[0, 1], 8 * _POINTS)
        line = np.column_stack([x, _heights(law.height, x)])
        down = np.array([0.0, -1.0])
    else:
        normal, reach = law.up(2), float(np.ptp(box, axis=1).sum())
        foot = box.mean(axis=1)
        foot += (law.height - normal @ foot) * normal
        line = foot + reach * np.outer([-1.0, 1.0], [normal[1], -normal[0]])
        down = -normal
    depth = float(np.ptp(box, axis=1).sum())
    filled = Polygon(
        np.vstack([line, (line + depth * down)[::-1]]), facecolor=GROUND, alpha=0.45, zorder=0.4
    )
    ax.add_patch(filled)
    (edge,) = ax.plot(*line.T, color="0.45", linewidth=1.2, zorder=0.5, scalex=False, scaley=False)
    return [filled, edge]


def ground_surface(law: ContactLaw, points: FloatArray) -> FloatArray | None:
    """Return a grid (d, a, b) on the ground near points (d, k), b = 1 in the plane.

    None if the ground is farther away than the size of the points.
    """
    d, size = len(points), float(np.ptp(points, axis=1).max())
    is_curved = isinstance(law.height, ca.Function)
    up = np.eye(d)[-1] if is_curved else law.up(d)
    along = np.linalg.svd(up[None])[2][1:]  # the directions in the ground
    extent, count = along @ points, _POINTS if is_curved else 2
    lower, upper = extent.min(axis=1) - _BEYOND * size, extent.max(axis=1) + _BEYOND * size
    mesh = np.meshgrid(*np.linspace(lower, upper, count).T, indexing="ij")
    across = along.T @ np.stack([coordinate.ravel() for coordinate in mesh])
    height = _heights(law.height, *across[:-1]) if is_curved else np.array(law.height)
    gap = up @ points
    if gap.min() - height.max() > size or height.min() - gap.max() > size:
        return None
    return np.asarray((across + up[:, None] * height).reshape(d, count, -1))


def _heights(height: ca.Function, *across: FloatArray) -> FloatArray:
    """Return the height over places, arrays of one shape."""
    rows = [ca.DM(coordinate.reshape(1, -1)) for coordinate in across]
    return np.array(height(*rows)).reshape(across[0].shape)


def add_ground(
    ax: Any, laws: Sequence[ContactLaw], pressed: FloatArray, bars: int
) -> tuple[tuple[Any, ...], Any]:
    """Draw grounds within the limits of axes, and nodes that press on them, shape (d, k)."""
    look = _pressed(1.9 * NORMAL.fitted(bars).node_size)
    (marks,) = ax.plot(*pressed, zorder=5.0, **look)
    return _draw(ax, laws), marks


def ground_samples(laws: Sequence[ContactLaw]) -> list[Line2D]:
    """Return the samples of the ground and of nodes that press on it, for a legend."""
    if not laws:
        return []
    pressed = _pressed(1.4 * NORMAL.node_size)
    looks = {"ground": {"color": GROUND, "linewidth": 6}, "on the ground": pressed}
    return [Line2D([], [], label=label, **look) for label, look in looks.items()]


def _pressed(size: float) -> dict[str, Any]:
    return marker_style("s", size, PALETTE[1], mec="0.15", mew=0.8)


def touching(record: ContactRecord | None, k: int) -> IntArray:
    """Return the nodes that the ground presses on in a state of a run."""
    if record is None:
        return np.zeros(0, dtype=np.int64)
    return np.unique(record.node[record.normal_force[:, k] > 0])


@closes_on_error
def contacts(run: Trajectory, *, axes: Sequence[Axes] | None = None) -> dict[str, Curves]:
    """Draw what touched the ground, the forces there, and what was lost.

    The panels are ``"normal_force"`` and ``"depth"`` of each contact; ``"touch"``, a bar for each
    time in which it was pressed; ``"work"``, the energy lost by damping and by friction, and stored
    in the ground; and ``"balance"``, the change of all energy with what was lost, if that is
    conserved. The six contacts with the largest impulse have names.

    Parameters
    ----------
    run : Trajectory
        Of a model with a ground.
    axes : sequence of Axes, optional
        Where to draw, one for each panel; a new figure if not given.

    Returns
    -------
    dict of str to Curves
        What was drawn, by panel.

    Raises
    ------
    TypeError, ValueError
        If ``run`` is no run, or its model has no ground, or ``axes`` does not fit.

    Examples
    --------
    >>> import matplotlib.pyplot as plt, tenscontrol as tc
    >>> prism = tc.prism()
    >>> ground = tc.Ground(stiffness=5e3, damping=0.3, friction=0.5, height=-0.1)
    >>> model = tc.Model(prism, gravity=9.81, ground=ground)
    >>> rest = tc.prestress(prism, force_density=500.0)
    >>> run = tc.simulate(model, 0.3, force_density=rest.force_density, step=1e-3)
    >>> panels = tc.plot.contacts(run)
    >>> list(panels), list(panels["depth"].lines)[:2]
    (['normal_force', 'depth', 'touch', 'work', 'balance'], ['node 3', 'node 4'])
    >>> plt.close(panels["depth"].ax.figure)
    """
    validation.instance("run", run, Trajectory, "make one by simulate(model, ...)")
    record = run.contacts
    if record is None:
        raise ValueError("run has no ground: make its model by Model(..., ground=Ground(...))")
    names = ["normal_force", "depth", "touch", "work"] + ["balance"] * run.conserves_energy
    labels = _labels(record, len(run.ground) > 1)
    work = {
        "lost by damping": record.damping_work.sum(axis=0)[None],
        "lost by friction": record.friction_work.sum(axis=0)[None],
        "stored in the ground": record.stored_energy.sum(axis=0)[None],
    }
    content = {
        "normal_force": (_by_name(labels, record.normal_force), "normal force, N"),
        "depth": (_by_name(labels, record.depth), "depth, m"),
        "work": (work, "energy, J"),
    }
    if run.conserves_energy:
        balance = run.energy + run.released_energy + run.lost_energy
        content["balance"] = (
            {"all energy": (balance - balance[0])[None]}, "change of energy\nwith the lost, J"
        )  # fmt: skip
    panels = {}
    for ax, name, xlabel in timed_panels(axes, names):
        if name == "touch":
            panels[name] = _bars(ax, run, record, labels, xlabel)
        else:
            rows, label = content[name]
            panels[name] = draw_curves(ax, run.time, rows, label, xlabel=xlabel)
    if "balance" in panels:
        panels["balance"].ax.legend([]).remove()
    if len(record.node):
        panels["depth"].ax.set_ylim(
            bottom=-0.15 * record.penetration
        )  # not how high the others are
    return panels


def _labels(record: ContactRecord, several: bool) -> list[str]:
    """Return the name of each contact; those with small impulses share one."""
    impulse = np.linalg.norm(record.impulse[:, :, -1], axis=0)
    named = set(np.argsort(-impulse, kind="stable")[:_NAMED])
    return [
        (f"node {node}" + f" on ground {law}" * several) if i in named else "others"
        for i, (node, law) in enumerate(zip(record.node, record.law, strict=True))
    ]


def _by_name(labels: list[str], values: FloatArray) -> dict[str, FloatArray]:
    of = np.array(labels)
    return {name: values[of == name] for name in sorted(set(labels), key=labels.index)}


def _bars(
    ax: Axes, run: Trajectory, record: ContactRecord, labels: list[str], xlabel: str | None
) -> Curves:
    """Draw a bar for each time of contact, one row a name."""
    lines, names = {}, sorted(set(labels), key=labels.index)
    for row, name in enumerate(names):
        mine = np.flatnonzero(np.array(labels)[record.touch] == name)
        ends = np.column_stack([record.begin[mine], record.end[mine], np.full(len(mine), np.nan)])
        look = curve_style(row) | {"linestyle": "solid", "linewidth": 5.0}
        # The mark shows a contact that is too short to see.
        (lines[name],) = ax.plot(
            ends.ravel(), np.full(ends.size, row), solid_capstyle="butt", marker="|", **look
        )
    dress(ax, xlabel, "pressed")
    ax.set_yticks(range(len(names)), names, fontsize="small")
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xlim(run.time[0], run.time[-1])
    return Curves(ax, {name: (line,) for name, line in lines.items()}, {}, {})
