"""Rotational symmetry of a shape, in coordinates that keep it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.fields import Array, Field, converted
from tenscontrol.shape.demands import MOST_NODES, node_list
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.connectivity import member_images
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import held_directions, rotation_about

if TYPE_CHECKING:
    from collections.abc import Sequence


# A load or a length that differs by more than this fraction breaks the symmetry.
_TOLERANCE = 1e-8


@final
@dataclass(frozen=True, eq=False)
class RotationalSymmetry:
    """Symmetry demand: a rotation about an axis maps the shape onto itself.

    Parameters
    ----------
    cycles : sequence of sequences of int, q nodes each
        The turn takes each node of a cycle to the next, and the last to the
        first. Nodes on no cycle stay on the axis.
    axis : array_like, shape (3,)
        Direction of the axis; z in the plane.
    centre : array_like, shape (3,), or (2,) if the axis is z
        A point on the axis, m.
    turns : int
        The turn is ``2π turns / q``, counterclockwise about the axis; -1 where
        the cycles run clockwise.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> threefold = tc.RotationalSymmetry([[0, 1, 2], [3, 4, 5]])
    >>> threefold.order
    3
    """

    cycles: Field[Sequence[Sequence[int]], tuple[IntArray, ...]] = converted()
    axis: Array = converted((0.0, 0.0, 1.0))
    centre: Array = converted((0.0, 0.0, 0.0))
    turns: int = 1

    __repr__ = short_repr

    def __post_init__(self) -> None:
        put = object.__setattr__
        given = validation.items("cycles", self.cycles, "sequences of nodes")
        cycles = tuple(node_list(f"cycles[{i}]", cycle) for i, cycle in enumerate(given))
        if len(cycles) == 0:
            raise ValueError("cycles is empty, expected at least one sequence of nodes")
        for i, nodes in enumerate(cycles):
            if len(nodes) != len(cycles[0]) or len(nodes) < 2:
                raise ValueError(
                    f"cycles[{i}] has {len(nodes)} nodes and cycles[0] {len(cycles[0])}, "
                    "expected as many in each, two at least"
                )
        node_list("cycles", np.concatenate(cycles))
        put(self, "cycles", cycles)
        put(self, "axis", frozen(validation.direction("axis", self.axis)))
        centre = validation.float_array("centre", self.centre)
        if centre.shape == (2,) and not self.axis[:2].any():
            centre = np.append(centre, 0.0)
        put(self, "centre", frozen(validation.shaped("centre", centre, (3,), "a point")))
        put(self, "turns", validation.whole_number("turns", self.turns, least=1 - self.order))
        if self.turns % self.order == 0:
            raise ValueError(f"turns is {self.turns}, expected a turn that is not a whole one")

    @property
    def order(self) -> int:
        """Number q of nodes in a cycle."""
        return len(self.cycles[0])

    def rotation(self) -> FloatArray:
        """Return the turn as a matrix, shape (3, 3)."""
        return rotation_about(self.axis, 2 * np.pi * self.turns / self.order)

    def permutation(self, count: int) -> IntArray:
        """Return which node each node is taken to, shape (n,).

        Parameters
        ----------
        count : int
            Number n of nodes, all of those on cycles among them.

        Raises
        ------
        TypeError, ValueError
            If it is no whole number, or the cycles name other nodes.
        """
        largest = max(int(cycle.max()) for cycle in self.cycles)
        to = np.arange(validation.whole_number("count", count, largest + 1, MOST_NODES))
        for cycle in self.cycles:
            to[cycle] = np.roll(cycle, -1)
        return to


@dataclass(frozen=True, eq=False)
class Reduction:
    """Coordinates y of the shapes searched: the free coordinates are ``offset + basis y``, m."""

    basis: FloatArray  # (f, r)
    offset: FloatArray  # (f,)
    strings: FloatArray  # (α, ·): which of them share one unknown, a 1 in each row
    bars: FloatArray  # (β, ·)
    rigid: FloatArray  # translations and rotations about the centre that are allowed, a column each
    centre: FloatArray  # (d,)


def reduction(
    structure: Structure, load: FloatArray, symmetry: RotationalSymmetry | None
) -> Reduction:
    """Return the coordinates, or raise if structure or load, N, (d, n), have not the symmetry."""
    (d, count), rows = structure.nodes.shape, structure.free_rows
    if symmetry is None:
        nothing = np.zeros(len(rows))
        centre = structure.nodes.mean(axis=1)
        strings, bars = np.eye(len(structure.strings)), np.eye(len(structure.bars))
        rigid = np.eye(d * (d + 1) // 2)
        return Reduction(np.eye(len(rows)), nothing, strings, bars, rigid, centre)
    for i, cycle in enumerate(symmetry.cycles):
        if cycle.max() >= count:
            raise ValueError(
                f"symmetry.cycles[{i}] names node {cycle.max()}, expected 0 to {count - 1}"
            )
    if d == 2 and symmetry.axis[:2].any():
        raise ValueError(
            f"symmetry.axis is {symmetry.axis.tolist()}, expected [0, 0, 1]: a structure in the "
            "plane turns about z"
        )
    to, turn, centre = symmetry.permutation(count), symmetry.rotation()[:d, :d], symmetry.centre[:d]
    paths = structure.paths or structure.strings.tolist()
    strings = _orbits("string", paths, to, None)
    bars = _orbits("bar", structure.bars.tolist(), to, structure.bar_length)
    _refuse_other_supports(structure, to, turn, centre)
    if np.abs(turn @ load - load[:, to]).max() > _TOLERANCE * np.abs(load).max(initial=1e-300):
        raise ValueError("symmetry does not map the loads and weights onto themselves")
    # n_to(i) − c = R (n_i − c) for every node: a linear subspace.
    turned = np.kron(np.eye(count), turn)
    shift = np.kron(np.eye(count)[to], np.eye(d))
    _, sizes, Vt = np.linalg.svd((shift - turned)[:, rows])
    basis = Vt[np.count_nonzero(sizes > _TOLERANCE) :].T
    # What supports hold is taken to what they hold, so that the offset is the centre for the rest.
    offset = np.tile(centre, count)[rows]
    axis = symmetry.axis
    if d == 3:
        rigid = np.column_stack([np.r_[axis, np.zeros(3)], np.r_[np.zeros(3), axis]])
    else:
        rigid = np.array([[0.0], [0.0], [1.0]])
    return Reduction(basis, offset, strings, bars, rigid, centre)


def _refuse_other_supports(
    structure: Structure, to: IntArray, turn: FloatArray, centre: FloatArray
) -> None:
    """Raise if a support is not taken to one that holds the same, at its place."""
    held, size = held_directions(structure).astype(float), structure.size
    off = turn @ (structure.nodes - centre[:, None]) + centre[:, None] - structure.nodes[:, to]
    for node in np.flatnonzero(held.any(axis=1)).tolist():
        image = int(to[node])
        apart = turn @ np.diag(held[node]) @ turn.T - np.diag(held[image])
        miss = np.abs(held[image] * off[:, node]).max()
        if np.abs(apart).max() > _TOLERANCE or miss > _TOLERANCE * size:
            one, other = ("fixed node", "fixed node")
            if not held[node].all():
                one, other = "roller at node", "roller that holds the same"
            raise ValueError(f"symmetry does not take the {one} {node} to a {other}")


def _orbits(
    kind: str, paths: Sequence[Sequence[int]], to: IntArray, length: FloatArray | None
) -> FloatArray:
    """Return which members are mapped onto one another, a column for each orbit."""
    image = member_images(paths, to)
    for i, partner in enumerate(image):
        if partner < 0:
            path = list(paths[i])
            raise ValueError(
                f"symmetry takes {kind} {i}, nodes {path}, to nodes {to[path].tolist()}, where "
                f"there is no {kind}"
            )
        if length is not None and abs(length[partner] / length[i] - 1) > _TOLERANCE:
            raise ValueError(f"symmetry takes bar {i} to bar {partner}, which has another length")
    columns, seen = [], np.zeros(len(paths), bool)
    for i in range(len(paths)):
        if not seen[i]:
            column, member = np.zeros(len(paths)), i
            while not seen[member]:
                seen[member], column[member], member = True, 1.0, image[member]
            columns.append(column)
    return np.column_stack(columns) if columns else np.zeros((len(paths), 0))
