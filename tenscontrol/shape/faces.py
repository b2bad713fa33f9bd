"""Faces of the convex hull of a structure, on which it may stand."""

from __future__ import annotations

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray


def lowest_face(nodes: FloatArray, down: FloatArray, near: float) -> tuple[IntArray, float]:
    """Return the nodes of the face of the hull that looks most downward; none of a flat shape.

    Nodes that are no farther than ``near``, m, from its plane belong to it. The second is the
    cosine of the angle between the face and level ground.
    """
    outward, offsets = _planes(nodes)
    if not len(offsets):
        return np.zeros(0, dtype=int), 0.0
    sinks = outward @ down
    lowest = int(np.argmax(sinks))
    feet = np.flatnonzero(outward[lowest] @ nodes + offsets[lowest] > -near)
    return feet, float(sinks[lowest])


def faces(nodes: FloatArray, near: float) -> list[tuple[IntArray, FloatArray]]:
    """Return the nodes of all faces of the hull, as :func:`lowest_face` does, and their normals."""
    known: dict[tuple[int, ...], FloatArray] = {}
    for normal, offset in zip(*_planes(nodes), strict=True):
        feet = np.flatnonzero(normal @ nodes + offset > -near)
        known.setdefault(tuple(feet.tolist()), normal)
    return [(np.array(feet), normal) for feet, normal in sorted(known.items())]


def _planes(nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return outward normals, shape (f, d), and offsets of the faces; none of a flat shape."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        equations = ConvexHull(nodes.T).equations
    except QhullError:
        equations = np.zeros((0, len(nodes) + 1))
    return equations[:, :-1], equations[:, -1]
