"""Roughness of the ground that a structure is to roll on."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.model import Model

# The square that is looked at has a side of so many sizes, with so many points along it.
_SIDE, _POINTS = 4.0, 21


def roughness(model: Model, nodes: FloatArray, size: float) -> float:
    """Return the root mean square of the height of curved ground from a plane, m.

    The plane is the one that fits best, over a square of four sizes about the nodes; in the plane a
    line, over as much of it. It is 0 where all ground is plane.

    Parameters
    ----------
    model : Model
    nodes : ndarray, shape (d, n)
        m.
    size : float
        Of the structure, m.
    """
    centre = nodes.mean(axis=1)[:-1]
    line = _SIDE * size * np.linspace(-0.5, 0.5, _POINTS)
    across = np.stack(np.meshgrid(*[line] * len(centre)), axis=-1).reshape(-1, len(centre))
    plane = np.column_stack([np.ones(len(across)), across])
    deviations = [0.0]
    for law in model.ground:
        if isinstance(law.height, ca.Function):
            columns = (centre + across).T
            heights = np.array(law.height.map(len(across))(*columns[:, None]).full()).ravel()
            off = heights - plane @ np.linalg.lstsq(plane, heights)[0]
            deviations.append(float(np.sqrt(np.mean(off**2))))
    return max(deviations)
