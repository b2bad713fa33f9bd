"""Linear plants along a way through equilibria."""

from __future__ import annotations

import numpy as np

from tenscontrol.dynamics import Model
from tenscontrol.plant import LinearPlant, OperatingPoint, linearize
from tenscontrol.validation import FloatArray, whole_number


def plants_along(
    model: Model,
    nodes: FloatArray,
    force_density: FloatArray,
    count: int,
    input: str,
) -> tuple[LinearPlant, ...]:
    """Return linear plants at some shapes of a way, evenly by the distance that nodes travel.

    Parameters
    ----------
    model : Model
    nodes : ndarray, shape (3, n, T)
        Equilibria, m.
    force_density : ndarray, shape (α, T)
        γ, N/m.
    count : int
        How many, at least 1. One alone is in the middle.
    input : {"force_density", "rest_length"}

    Returns
    -------
    tuple of LinearPlant
        In internal coordinates.

    Raises
    ------
    TypeError, ValueError
        If ``count`` is not a whole number of at least 1, or a shape cannot be linearized.
    """
    count = whole_number("count", count, least=1)
    travel = np.linalg.norm(np.diff(nodes, axis=2), axis=(0, 1))
    gone = np.concatenate([[0.0], np.cumsum(travel)])
    shares = np.linspace(0.0, 1.0, count) if count > 1 else np.array([0.5])
    places = [int(np.argmin(np.abs(gone - share * gone[-1]))) for share in shares]
    load = model.constant_force
    return tuple(
        linearize(model, OperatingPoint(nodes[:, :, k], force_density[:, k], load), input=input)
        for k in places
    )
