"""Ground near a motion, as a view draws it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics import ContactLaw
from tenscontrol.simulation.contacts import ContactRecord
from tenscontrol.validation import FloatArray

# Points along each side of a curved ground that is drawn; and how far it is drawn beyond the nodes,
# as a part of the size.
_GRID, _BEYOND = 33, 0.15


def drawn_ground(
    laws: Sequence[ContactLaw], record: ContactRecord | None, nodes: FloatArray
) -> dict[str, Any]:
    """Return the ground of a motion (d, n, T) as ``View`` takes it: what is near, who presses."""
    pressed = None if record is None else np.zeros(nodes.shape[1:], dtype=bool)
    if record is not None and pressed is not None:
        for node, force in zip(record.node, record.normal_force, strict=True):
            pressed[node] |= force > 0
    surfaces = [_surface(law, nodes.reshape(len(nodes), -1)) for law in laws]
    return {"ground": tuple(each for each in surfaces if each is not None), "pressed": pressed}


def _surface(law: ContactLaw, points: FloatArray) -> FloatArray | None:
    """Return a grid (d, a, b) on a ground, b = 1 in the plane; None if it is a size away."""
    d, size = len(points), float(np.ptp(points, axis=1).max())
    curved = law.height if isinstance(law.height, ca.Function) else None
    up = np.eye(d)[-1] if curved else law.up(d)
    along = np.linalg.svd(up[None])[2][1:]  # the directions in the ground
    places, count = along @ points, _GRID if curved else 2
    lower, upper = places.min(axis=1) - _BEYOND * size, places.max(axis=1) + _BEYOND * size
    mesh = np.meshgrid(*np.linspace(lower, upper, count).T, indexing="ij")
    across = along.T @ np.stack([each.ravel() for each in mesh])
    height = np.array(curved(*(ca.DM(row[None]) for row in across[:-1]))) if curved else law.height
    gap = up @ points
    if gap.min() - np.max(height) > size or np.min(height) - gap.max() > size:
        return None
    return np.asarray((across + up[:, None] * height).reshape(d, count, -1))
