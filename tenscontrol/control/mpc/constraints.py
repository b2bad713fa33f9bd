"""Output limits: bounds on linear combinations of node positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.mpc.problem import RowBlock
from tenscontrol.fields import Array, Field, converted
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.reference import ReferencePreview
from tenscontrol.plant.string_outputs import string_map
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.bar_clearance import bar_distances

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


# Limits of strings by their quantity, and its unit.
_STRING_LIMITS = {
    "force_density": (("min_force_density", "max_force_density"), "N/m"),
    "tension": (("min_tension", "max_tension"), "N"),
}

# A limit is broken by more than this, in units of a row: of strings, whose forces along a
# reference are known as well as they balance it, and of positions.
_HELD, _ROUND_OFF = 1e-2, 1e-4

# Unit of positions inside a program, as a share of the size of the structure.
_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class OutputLimit:
    """Bounds on linear combinations of node positions at the end of each predicted sample.

    In internal coordinates, positions are those of the shape aligned with the operating point.
    Do not bound combinations that change in a rigid-body motion.

    Parameters
    ----------
    matrix : array_like, shape (p, d n) or (d n,)
        C of ``y = C vec(N)``, node by node.
    low : float or array_like, shape (p,), optional
        Lower bound of y, m; none if infinite or not given.
    high : float or array_like, shape (p,), optional
        Upper bound of y, m; none if infinite or not given.
    penalty : float, optional
        Price π of a violation, 1/m: one of y by e, m, adds ``π (2 e + e²/u)`` to the cost in each
        sample, with u of 1 % of the size of the structure times the norm of the row of C. The cost
        is ``Σ zᵀ Q z + vᵀ R v``. A hard limit if infinite or not given.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, ``low`` exceeds ``high`` or the penalty is
        not positive.

    Examples
    --------
    The height of a prism's first node above its fourth, at least 0.9 m:

    >>> import numpy as np, tenscontrol as tc
    >>> from tenscontrol.control import OutputLimit
    >>> row = np.zeros((3, 6))
    >>> row[2, [0, 3]] = 1, -1
    >>> OutputLimit(row.ravel(order="F")[None], low=0.9).matrix.shape
    (1, 18)
    """

    matrix: Array = converted()
    low: Field[ArrayLike | None, FloatArray] = converted(None)
    high: Field[ArrayLike | None, FloatArray] = converted(None)
    penalty: float | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        matrix = np.atleast_2d(validation.float_array("matrix", self.matrix))
        if matrix.ndim != 2:
            raise ValueError(f"matrix has shape {matrix.shape}, expected (p, d n)")
        if not np.abs(matrix).sum(axis=1).all():
            raise ValueError("matrix has a row of zeros, which limits nothing")
        object.__setattr__(self, "matrix", frozen(matrix))
        for name, none in (("low", -np.inf), ("high", np.inf)):
            given = getattr(self, name)
            bound = validation.limit_per_member(name, given, len(matrix), "row of matrix", none)
            object.__setattr__(self, name, frozen(bound))
        if np.any(self.low > self.high):
            raise ValueError(f"low {self.low} m exceeds high {self.high} m")
        if validation.is_unlimited(self.penalty):
            object.__setattr__(self, "penalty", None)
        else:
            penalty = validation.positive_number("penalty", self.penalty, "costs per m")
            object.__setattr__(self, "penalty", penalty)


def clearance(plant: LinearPlant, clearance: float, penalty: float | None = None) -> OutputLimit:
    """Return an output limit that keeps bars apart, for MPC and NMPC.

    The distance between the axes of two bars is ``u · (p − q)``, with p and q their nearest points
    and u the unit vector between them. To first order it changes as if u, and the places of p and
    q along the bars, stayed as at the operating point. This linear distance is limited, which is
    accurate near that shape. Pairs whose nearest point is an end of a bar are left out: these
    bars can pass around each other.

    Parameters
    ----------
    plant : LinearPlant
    clearance : float
        Least distance of the axes, m.
    penalty : float, optional
        Price of a violation, as in :class:`OutputLimit`. A hard limit if not given: a disturbance
        can then make a program infeasible.

    Returns
    -------
    OutputLimit
        One row for each pair; none for less than two bars.

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
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    clearance = validation.positive_number("clearance", clearance, "m")
    structure, nodes = plant.model.structure, plant.nodes
    found = bar_distances(structure, nodes)
    passing = np.flatnonzero(found.side)
    if len(found.pairs) and not len(passing):
        raise ValueError(
            "plant has no two bars that pass one another: each pair is nearest at an end of a bar"
        )
    too_near = passing[found.distance[passing] < clearance]
    if len(too_near):
        near = too_near[found.distance[too_near].argmin()]
        i, j = found.pairs[near]
        raise ValueError(
            f"clearance is {clearance:g} m, but bars {i} and {j} are {found.distance[near]:g} m "
            "apart at the operating point; expected at most that"
        )
    rows = np.zeros((len(passing), *nodes.shape))
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
        rows.transpose(0, 2, 1).reshape(len(passing), nodes.size), low=clearance, penalty=penalty
    )


def broken_limits(
    plant: LinearPlant, blocks: Sequence[RowBlock], path: ReferencePreview
) -> list[str]:
    """Return a sentence for each soft limit that a given reference breaks.

    Raise where the operating point or a reference breaks a hard one.
    """
    found = []
    times, outputs = path.times, 0
    preview, shapes = path.at(times), path.nodes_at(times).transpose(2, 1, 0)
    strings = string_map(plant, plant.input) if any(block.quantity for block in blocks) else None
    for block in blocks:
        if block.quantity:
            names, unit = _STRING_LIMITS[block.quantity]
            here, there = (getattr(of, block.quantity) for of in (strings, preview))
            close, which = _HELD * block.scale, "string"
        else:
            names, unit = (f"outputs[{outputs}].low", f"outputs[{outputs}].high"), "m"
            here, there = block.offset, shapes.reshape(len(shapes), -1) @ block.on_nodes.T
            close, which, outputs = _ROUND_OFF * block.scale, "row", outputs + 1
        for at, values in ((None, here[None]), (times, there)):
            for name, bound, over in zip(
                names,
                (block.low, block.high),
                (block.low - values, values - block.high),
                strict=True,
            ):
                if not over.size:
                    continue
                k, i = np.unravel_index(int((over - close).argmax()), over.shape)
                if over[k, i] <= close[i]:
                    continue
                where = "the operating point" if at is None else f"the reference at {at[k]:g} s"
                text = (
                    f"{name} is {bound[i]:.6g} {unit} for {which} {i}, but {where} has "
                    f"{values[k, i]:.6g} {unit}, {over[k, i]:.2g} {unit} beyond"
                )
                if np.isinf(block.penalty[i]):
                    raise ValueError(
                        f"{text}: there programs with this hard limit have no solution. Move the "
                        "limit or the shape, or give a finite penalty"
                    )
                if at is not None and path.given:
                    found.append(f"{text}: the loop will settle between the two")
    return found


def output_block(plant: LinearPlant, limit: OutputLimit) -> RowBlock:
    """Return limits on node positions at the end of each sample."""
    from scipy.sparse import csr_array

    assert limit.low is not None  # filled in by the limit itself
    assert limit.high is not None  # filled in by the limit itself
    count, size = limit.matrix.shape
    if size != plant.nodes.size:
        raise ValueError(
            f"outputs: matrix has shape {limit.matrix.shape}, expected (p, {plant.nodes.size}): "
            "one column per coordinate of a node"
        )
    by_q = limit.matrix @ plant.basis
    sizes = np.linalg.norm(limit.matrix, axis=1)
    return RowBlock(
        by_state=np.zeros((count, len(plant.A))),
        by_next_state=np.hstack([by_q, np.zeros_like(by_q)]),
        by_input=csr_array((count, plant.B.shape[1])),
        low=limit.low,
        high=limit.high,
        scale=_SHARE * sizes * float(np.ptp(plant.nodes, axis=1).max()),
        penalty=np.full(count, np.inf if limit.penalty is None else limit.penalty),
        quantity="",
        offset=limit.matrix @ plant.nodes.ravel(order="F"),
        on_nodes=limit.matrix,
    )
