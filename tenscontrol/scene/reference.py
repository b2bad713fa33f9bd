"""What the controller of a scene follows, tracks and keeps within limits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.control import OutputLimit
from tenscontrol.dynamics import Model
from tenscontrol.plant import Reference
from tenscontrol.scene import keys
from tenscontrol.scene.document import Table
from tenscontrol.shape import Demand, Height, NodesAt, ShapeTarget, Twist, shape_path, shape_target
from tenscontrol.statics import Prestress
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, non_negative, positive_number


def build_reference(
    table: Table,
    model: Model,
    rest: Prestress,
    winches: Winches | None,
    step: float,
    bounds: dict[str, Any],
) -> Reference:
    """Return the way by the shapes of ``[[controller.reference]]``, through equilibria.

    Parameters
    ----------
    table : Table
        ``[controller]``.
    model : Model
        Of the whole strings.
    rest : Prestress
        Where the way begins.
    winches : Winches, optional
        What they allow, the way keeps to.
    step : float
        Of the controller, s.
    bounds : dict
        ``min_force_density`` and ``max_force_density``, N/m, as far as there are any.

    Returns
    -------
    Reference
    """
    groups = np.array(model.structure.string_groups)
    level = float(rest.force_density[groups == groups[0]].mean())
    here: Prestress | ShapeTarget = rest
    nodes, now = model.structure.nodes, 0.0
    times: list[FloatArray] = [np.zeros(1)]
    shapes, gammas = [nodes[:, :, None]], [rest.force_density[:, None]]
    for entry in _entries(table, "reference", keys.WAYPOINT):
        begin, end = _span(entry, now)
        demands = _demands(entry, table, model.structure)
        with entry.checked("time"):
            goal = shape_target(
                model,
                demands,
                force_density=entry.get("force_density", level),
                winches=winches,
                start=nodes,
                **bounds,
            )
            path = shape_path(
                model,
                here,
                goal,
                winches=winches,
                duration=end - begin,
                step=step,
                **bounds,
            )
        # Where the way stands still for a while, its last shape comes twice.
        first = 0 if begin > now else 1
        times.append(begin + path.time[first:])
        shapes.append(path.nodes[:, :, first:])
        gammas.append(path.force_density[:, first:])
        here, nodes, now = goal, goal.nodes, end
    return Reference(
        np.concatenate(times), np.concatenate(shapes, axis=2), np.concatenate(gammas, axis=1)
    )


def build_tracked(table: Table, structure: Structure) -> FloatArray:
    """Return the combinations of ``[[controller.tracked]]``, shape (p, 3n)."""
    return np.vstack([_row(e, structure) for e in _entries(table, "tracked", keys.TRACKED)])


def build_outputs(table: Table, structure: Structure) -> list[OutputLimit]:
    """Return the limits of ``[[controller.outputs]]``."""
    limits = []
    for entry in _entries(table, "outputs", keys.OUTPUT):
        if "low" not in entry and "high" not in entry:
            raise entry.error(None, f"{entry.title} limits nothing: give low or high, m")
        row = _row(entry, structure)
        with entry.checked():
            limits.append(OutputLimit(row[None], **entry.given("low", "high", "penalty")))
    return limits


def _entries(table: Table, key: str, known: keys.Keys) -> Iterator[Table]:
    given = table.need(key)
    if not given:
        raise table.error(key, f"in {table.title}, {key} is empty; leave it out, or give an entry")
    for i, values in enumerate(given):
        title = f"[[controller.{key}]] number {i + 1}"
        yield Table(table.document, (*table.path, key, i), title, values, known)


def _row(entry: Table, structure: Structure) -> FloatArray:
    """Return a node coordinate, or its difference from that of another node, as a row of C."""
    count = structure.nodes.shape[1]
    axis = entry.choice("axis", ("x", "y", "z"))
    row = np.zeros((count, 3))
    for key, sign in (("node", 1.0), ("relative_to", -1.0)):
        if key == "relative_to" and key not in entry:
            continue
        node = entry.need(key)
        if not 0 <= node < count:
            raise entry.error(
                key,
                f"in {entry.title}, {key} is {node}, expected 0 to {count - 1}: there are {count} "
                "nodes, counted from 0",
            )
        row[node, "xyz".index(axis)] += sign
    if not row.any():
        raise entry.error(
            "relative_to", f"in {entry.title}, relative_to is node itself, expected another"
        )
    return row.ravel()


def _span(entry: Table, now: float) -> tuple[float, float]:
    """Return when a move begins and ends, s."""
    with entry.checked("time"):
        end = positive_number("time", entry.need("time"), "s")
    begin = now
    if "start" in entry:
        with entry.checked("start"):
            begin = float(non_negative("start", np.array([entry.get("start")]), "s")[0])
            if not begin >= now:
                raise ValueError(f"start is {begin:g} s, expected at least {now:g} s")
    if not end > begin:
        raise entry.error(
            "time", f"in {entry.title}, time is {end:g} s, expected more than {begin:g} s"
        )
    return begin, end


def _demands(entry: Table, controller: Table, structure: Structure) -> list[Demand]:
    found: list[Demand] = []
    with entry.checked():
        if "height" in entry:
            found.append(Height(entry.get("height"), *_ends(entry, controller, structure)))
        if "twist" in entry:
            found.append(Twist(entry.get("twist"), *_ends(entry, controller, structure)))
        if "nodes" in entry or "positions" in entry:
            at = np.array(entry.need("positions"), dtype=float).reshape(-1, 3)
            found.append(NodesAt(entry.need("nodes"), at.T))
    if not found:
        raise entry.error(
            None, f"{entry.title} asks for no shape: give height, twist, or nodes and positions"
        )
    return found


def _ends(entry: Table, controller: Table, structure: Structure) -> tuple[list[int], list[int]]:
    """Return the nodes at the top and at the bottom: as given, or those of a prism."""
    if "top" in entry or "bottom" in entry:
        return entry.need("top"), entry.need("bottom")
    if controller.document.table("structure").get("generator") != "prism":
        raise entry.error(
            None, f"{entry.title} lacks the keys top and bottom: lists of node numbers"
        )
    sides = len(structure.bars)
    return list(range(sides)), list(range(sides, 2 * sides))
