"""Output limits: bounds on linear combinations of node positions, or of forces of bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.mpc.problem import RowBlock
from tenscontrol.fields import Array, Field, converted
from tenscontrol.plant.bar_outputs import bar_map
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.reference import ReferencePreview
from tenscontrol.plant.string_outputs import string_map
from tenscontrol.short_repr import short_repr
from tenscontrol.sizing.sections import Sections
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

    It can also bound axial forces of bars, positive in compression. These are limited at the start
    of each sample, with the input that acts from there, and at its end:
    :func:`~tenscontrol.control.buckling` makes such limits.

    In internal coordinates, positions are those of the shape aligned with the operating point.
    Do not bound combinations that change in a rigid-body motion.

    Parameters
    ----------
    matrix : array_like, shape (p, d n) or (d n,)
        C of ``y = C vec(N)``, node by node; of forces of bars, shape (p, β).
    low : float or array_like, shape (p,), optional
        Lower bound of y, m or N; none if infinite or not given.
    high : float or array_like, shape (p,), optional
        Upper bound of y, m or N; none if infinite or not given.
    penalty : float, optional
        Price π of a violation, 1/m or 1/N: one of y by e adds ``π (2 e + e²/u)`` to the cost in
        each sample, with u of 1 % of the size of the structure times the norm of the row of C; of
        forces, the largest force of a bar at the operating point in place of that 1 %. The cost
        is ``Σ zᵀ Q z + vᵀ R v``. A hard limit if infinite or not given.
    of : {"nodes", "bars"}
        Whether it is of node positions or of the forces of bars; the latter in linear MPC alone.

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
    of: str = "nodes"

    __repr__ = short_repr

    def __post_init__(self) -> None:
        validation.choice("of", self.of, ("nodes", "bars"))
        matrix = np.atleast_2d(validation.float_array("matrix", self.matrix))
        if matrix.ndim != 2:
            expected = "(p, d n)" if self.of == "nodes" else "(p, β)"
            raise ValueError(f"matrix has shape {matrix.shape}, expected {expected}")
        if not np.abs(matrix).sum(axis=1).all():
            raise ValueError("matrix has a row of zeros, which limits nothing")
        object.__setattr__(self, "matrix", frozen(matrix))
        for name, none in (("low", -np.inf), ("high", np.inf)):
            given = getattr(self, name)
            bound = validation.limit_per_member(name, given, len(matrix), "row of matrix", none)
            object.__setattr__(self, name, frozen(bound))
        if np.any(self.low > self.high):
            unit = "m" if self.of == "nodes" else "N"
            raise ValueError(f"low {self.low} {unit} exceeds high {self.high} {unit}")
        if validation.is_unlimited(self.penalty):
            object.__setattr__(self, "penalty", None)
        else:
            unit = "costs per m" if self.of == "nodes" else "costs per N"
            penalty = validation.positive_number("penalty", self.penalty, unit)
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
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> limit = tc.clearance(plant, clearance=0.2, penalty=1e4)
    >>> limit.matrix.shape, limit.low
    ((3, 18), array([0.2, 0.2, 0.2]))
    >>> mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=80.0, outputs=[limit])
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    clearance = validation.positive_number("clearance", clearance, "m")
    structure, nodes = plant.model.structure, plant.nodes
    gaps = bar_distances(structure, nodes)
    passing = np.flatnonzero(gaps.side)
    if len(gaps.pairs) and not len(passing):
        raise ValueError(
            "plant has no two bars that pass one another: each pair is nearest at an end of a bar"
        )
    too_near = passing[gaps.distance[passing] < clearance]
    if len(too_near):
        near = too_near[gaps.distance[too_near].argmin()]
        i, j = gaps.pairs[near]
        raise ValueError(
            f"clearance is {clearance:g} m, but bars {i} and {j} are {gaps.distance[near]:g} m "
            "apart at the operating point; expected at most that"
        )
    rows = np.zeros((len(passing), *nodes.shape))
    starts, vectors = nodes[:, structure.bars[:, 0]], structure.bar_vectors(nodes)
    for row, pair in zip(rows, passing, strict=True):
        (i, j), (s, t) = gaps.pairs[pair], gaps.nearest[pair]
        between = starts[:, i] + s * vectors[:, i] - starts[:, j] - t * vectors[:, j]
        u = between / np.linalg.norm(between)
        for bar, share, sign in ((i, s, 1.0), (j, t, -1.0)):
            start, end = structure.bars[bar]
            row[:, start] += sign * (1 - share) * u
            row[:, end] += sign * share * u
    return OutputLimit(
        rows.transpose(0, 2, 1).reshape(len(passing), nodes.size), low=clearance, penalty=penalty
    )


def buckling(sections: Sections, safety: float = 1.5, penalty: float | None = None) -> OutputLimit:
    """Return an output limit that keeps bars from yield and buckling, for MPC.

    Forces of bars are linear in state and input about the operating point. They are bounded at the
    start of each sample, with the input that acts from there, and at its end: of strings that
    vibrate faster, not in between.

    Parameters
    ----------
    sections : Sections
        Of the bars of the plant.
    safety : float
        How many times its force each bar is to carry.
    penalty : float, optional
        Price of a violation, 1/N, as in :class:`OutputLimit`. A hard limit if not given: a
        disturbance can then make a program infeasible.

    Returns
    -------
    OutputLimit
        One row for each bar.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or not positive, or there are no bars.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> metal = tc.sizing.materials["aluminium"]
    >>> sized = tc.sections(tc.prism(), bars=metal, bar_radius=0.004, strings=metal,
    ...                     string_radius=0.001)
    >>> limit = tc.control.buckling(sized, safety=2.0)
    >>> limit.high.round(1)
    array([35.4, 35.4, 35.4])
    """
    validation.instance("sections", sections, Sections, "make them by sections(...) or design(...)")
    safety = validation.positive_number("safety", safety, "times the force")
    if not len(sections.bar_area):
        raise ValueError("sections have no bars")
    pull = sections.bars.yield_stress * sections.bar_area
    push = np.minimum(sections.bar_stress * sections.bar_area, sections.buckling_force)
    rows = np.eye(len(push))
    return OutputLimit(rows, low=-pull / safety, high=push / safety, penalty=penalty, of="bars")


def broken_limits(
    plant: LinearPlant, blocks: Sequence[RowBlock], path: ReferencePreview
) -> list[str]:
    """Return a sentence for each soft limit that a given reference breaks.

    Raise where the operating point or a reference breaks a hard one.
    """
    sentences = []
    times, outputs = path.times, 0
    preview, shapes = path.at(times), path.nodes_at(times).transpose(2, 1, 0)
    of_strings = any(block.quantity in _STRING_LIMITS for block in blocks)
    strings = string_map(plant, plant.input) if of_strings else None
    for block in blocks:
        rows = len(block.low)
        if block.quantity == "bar_force":
            rows //= 2  # at starts and ends of samples
            names, unit = (f"outputs[{outputs}].low", f"outputs[{outputs}].high"), "N"
            here, on_path = block.offset, block.along(preview)
            close, which, outputs = _HELD * block.scale, "row", outputs + 1
        elif block.quantity:
            names, unit = _STRING_LIMITS[block.quantity]
            here, on_path = (getattr(of, block.quantity) for of in (strings, preview))
            close, which = _HELD * block.scale, "string"
        else:
            names, unit = (f"outputs[{outputs}].low", f"outputs[{outputs}].high"), "m"
            here, on_path = block.offset, shapes.reshape(len(shapes), -1) @ block.on_nodes.T
            close, which, outputs = _ROUND_OFF * block.scale, "row", outputs + 1
        for instants, values in ((None, here[None]), (times, on_path)):
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
                where = (
                    "the operating point"
                    if instants is None
                    else f"the reference at {instants[k]:g} s"
                )
                text = (
                    f"{name} is {bound[i]:.6g} {unit} for {which} {i % rows}, but {where} has "
                    f"{values[k, i]:.6g} {unit}, {over[k, i]:.2g} {unit} beyond"
                )
                if np.isinf(block.penalty[i]):
                    raise ValueError(
                        f"{text}: there programs with this hard limit have no solution. Move the "
                        "limit or the shape, or give a finite penalty"
                    )
                if instants is not None and path.given:
                    sentences.append(f"{text}: the loop will settle between the two")
    return sentences


def output_block(plant: LinearPlant, limit: OutputLimit) -> RowBlock:
    """Return limits on node positions at the end of each sample, or on forces of bars."""
    from scipy.sparse import csr_array

    if limit.of == "bars":
        return _bar_block(plant, limit)
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


def _bar_block(plant: LinearPlant, limit: OutputLimit) -> RowBlock:
    """Return limits on the forces of bars at the start, then at the end of each sample."""
    from scipy.sparse import csr_array

    bars, size = len(plant.model.structure.bars), limit.matrix.shape[1]
    if size != bars:
        raise ValueError(
            f"outputs: matrix has shape {limit.matrix.shape}, expected (p, {bars}): one column per "
            "bar"
        )
    forces, C = bar_map(plant), np.vstack([limit.matrix, limit.matrix])
    by_state, none = limit.matrix @ forces.by_state, np.zeros((len(limit.matrix), len(plant.A)))
    level = float(np.abs(forces.force).max()) or 1.0
    return RowBlock(
        by_state=np.vstack([by_state, none]),
        by_next_state=np.vstack([none, by_state]),
        by_input=csr_array(C @ forces.by_input),
        low=np.tile(limit.low, 2),
        high=np.tile(limit.high, 2),
        scale=level * np.linalg.norm(C, axis=1),
        penalty=np.full(len(C), np.inf if limit.penalty is None else limit.penalty),
        quantity="bar_force",
        offset=C @ forces.force,
        on_nodes=C,
        at_rest=(
            forces.string_force_density, C @ forces.by_force_density, C @ forces.by_state_at_rest,
        ),
    )  # fmt: skip
