"""Bars kept apart, as limits on node positions."""

from __future__ import annotations

import numpy as np

from tenscontrol.control.mpc.constraints import OutputLimit
from tenscontrol.plant import LinearPlant
from tenscontrol.structure import bar_distances
from tenscontrol.validation import instance, positive_number


def clearance(plant: LinearPlant, clearance: float, penalty: float | None = None) -> OutputLimit:
    """Return the limit that keeps the axes of bars apart, for MPC and NMPC.

    The distance of two bars that pass one another is ``u · (p − q)``, with p and q the
    points where they are nearest and u the unit vector between them. Its first-order
    change is that with u, and the places of p and q along the bars, as at the operating
    point. That is what is limited: it is good near this shape. Pairs that are nearest at an
    end of a bar can go around each other, and are left out.

    Parameters
    ----------
    plant : LinearPlant
    clearance : float
        Least distance of the axes, m.
    penalty : float, optional
        Cost of a violation, per m and sample (L1), as in :class:`OutputLimit`. A hard
        limit if not given: a disturbance can then make a program infeasible.

    Returns
    -------
    OutputLimit
        One row for each pair.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, no two bars pass one another, or bars are nearer than
        ``clearance`` at the operating point.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> limit = tc.clearance(plant, clearance=0.2, penalty=1e4)
    >>> limit.matrix.shape, limit.low
    ((3, 18), array([0.2, 0.2, 0.2]))
    >>> mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=80.0, outputs=[limit])
    """
    instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    clearance = positive_number("clearance", clearance, "m")
    structure, nodes = plant.model.structure, plant.nodes
    found = bar_distances(structure, nodes)
    passing = np.flatnonzero(found.side)
    if not len(passing):
        raise ValueError(
            "plant has no two bars that pass one another: each pair is nearest at an end of a bar"
        )
    near = passing[found.distance[passing].argmin()]
    if found.distance[near] < clearance:
        i, j = found.pairs[near]
        raise ValueError(
            f"clearance is {clearance:g} m, but bars {i} and {j} are {found.distance[near]:g} m "
            "apart at the operating point; expected at most that"
        )
    rows = np.zeros((len(passing), 3, nodes.shape[1]))
    starts, vectors = nodes[:, structure.bars[:, 0]], structure.bar_vectors(nodes)
    for row, pair in zip(rows, passing, strict=True):
        (i, j), (s, t) = found.pairs[pair], found.nearest[pair]
        between = starts[:, i] + s * vectors[:, i] - starts[:, j] - t * vectors[:, j]
        u = between / np.linalg.norm(between)
        for bar, place, sign in ((i, s, 1.0), (j, t, -1.0)):
            start, end = structure.bars[bar]
            row[:, start] += sign * (1 - place) * u
            row[:, end] += sign * place * u
    return OutputLimit(
        rows.transpose(0, 2, 1).reshape(len(passing), -1), low=clearance, penalty=penalty
    )
