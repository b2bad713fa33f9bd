"""Distances of bars as expressions."""

from __future__ import annotations

from typing import Any

import casadi as ca

from tenscontrol.structure import Structure, bar_distances
from tenscontrol.validation import FloatArray


def signed_distances(structure: Structure, nodes: FloatArray, N: Any) -> Any:
    """Return expressions of the distance of bars that pass one another in a shape, m, signed.

    Positive on the side where they are in that shape: a smooth function, unlike the
    distance itself. Pairs that are nearest at an end are left out.

    Parameters
    ----------
    structure : Structure
    nodes : ndarray, shape (3, n)
        The shape, m.
    N : casadi.SX, shape (3, n)
    """
    found = bar_distances(structure, nodes)
    rows = []
    for (i, j), side in zip(found.pairs.tolist(), found.side.tolist(), strict=True):
        if side:
            u, v = (N[:, end] - N[:, start] for start, end in structure.bars[[i, j]].tolist())
            across = ca.cross(u, v)
            gap = N[:, int(structure.bars[i, 0])] - N[:, int(structure.bars[j, 0])]
            rows.append(side * ca.dot(across, gap) / ca.norm_2(across))
    return ca.vertcat(*rows) if rows else ca.SX(0, 1)
