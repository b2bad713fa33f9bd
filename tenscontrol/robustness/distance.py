"""How far a structure is from a shape."""

from __future__ import annotations

import numpy as np

from tenscontrol.plant import LinearPlant
from tenscontrol.validation import FloatArray


def farthest_node(plant: LinearPlant, nodes: FloatArray, target: FloatArray) -> float:
    """Return the largest distance of a node from its place, m, over all moments.

    Motions that the coordinates of the plant leave out do not count: in internal coordinates,
    those of the structure as one body.

    Parameters
    ----------
    plant : LinearPlant
    nodes : ndarray, shape (3, n, T)
        m.
    target : ndarray, shape (3, n)
        m.
    """
    r, still = plant.degrees_of_freedom, np.zeros_like(plant.nodes)
    # Both are seen by the coordinates, which leave out what they do not know.
    wanted = plant.to_nodes(plant.measure(target, still)[:r])
    farthest = 0.0
    for k in range(nodes.shape[2]):
        q = plant.measure(nodes[:, :, k], still)[:r]
        off = np.linalg.norm(plant.to_nodes(q) - wanted, axis=0)
        farthest = max(farthest, float(off.max()))
    return farthest
