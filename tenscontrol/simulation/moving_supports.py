"""Motion of supports: the displacement of the nodes that they carry, and its inertia."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Pieces, as_pieces
from tenscontrol.structure.blocks import node_mass
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import carried_by_supports

# A support whose place changes by more than this part of the size at once jumps; supports whose
# motions differ by less than the second part of the largest move alike.
_JUMP, _ALIKE = 1e-9, 1e-12


class MovingSupports:
    """The displacement E of the nodes that move with supports, m, node by node.

    States are beside it: N - E and Ṅ - Ė. Bars keep their lengths so, strings see N, and the load
    is less by M Ë. A jump of Ė, at a kink of the motion, is an impulse of -M ΔĖ on the nodes: what
    bars let keep its velocity keeps it.
    """

    def __init__(self, model: Model, displacement: Pieces) -> None:
        from scipy.sparse import eye_array, kron

        self.displacement = displacement
        structure = model.structure
        #: Mass matrix of all nodes, node by node, sparse, kg.
        self.mass = kron(node_mass(structure), eye_array(structure.dimension)).tocsr()

    def inputs(self, load: FloatArray | Pieces) -> Pieces:
        """Return the load less M Ë, N, and E below it."""
        if not isinstance(load, Pieces):
            load = Pieces.constant(load.ravel(order="F"))
        inertia = self.displacement.derivative(2).mapped(-self.mass)
        return Pieces.stacked([Pieces.added([load, inertia]), self.displacement])

    def force(self, acceleration: FloatArray) -> FloatArray:
        """Return the force that gives the nodes an acceleration, N; of a jump, the impulse."""
        return np.asarray(self.mass @ acceleration)


def support_offset(model: Model, value: object, start: float, end: float) -> Pieces | None:
    """Return by how much each node moves with supports, m, node by node, after checking it can.

    None for the motion of no node where none is fixed.
    """
    structure = model.structure
    d = structure.dimension
    fixed, size = structure.fixed, structure.size
    numbers: Any = getattr(value, "values", value)  # of a profile
    if not len(fixed) and np.size(numbers) == 0:
        return None
    if not len(fixed):
        raise ValueError(
            "support_motion is given, but no node of the structure is fixed; fix some by "
            "Structure(..., fixed=[...])"
        )
    shape, meaning = (d, len(fixed)), "m, one column a fixed node, in the order of structure.fixed"
    given = as_pieces("support_motion", value, shape, meaning, start, end)
    jump, time = given.jumps(start, end)
    if jump > _JUMP * size:
        raise ValueError(
            f"support_motion jumps by {jump:.3g} m at {time:.6g} s, expected a continuous motion: "
            "interpolate by 'linear' or 'cubic'"
        )
    carried = carried_by_supports(structure)
    column = np.searchsorted(fixed, carried)
    motions = given.coefficients.reshape(len(given.start), len(fixed), d, -1)
    largest = np.abs(motions).max(initial=0.0)
    for i, node in enumerate(fixed):
        if np.abs(motions[:, i] - motions[:, column[node]]).max() > _ALIKE * largest:
            raise ValueError(
                f"support_motion moves the fixed nodes {carried[node]} and {node} differently, but "
                "bars lead from one to the other: give both the same displacement"
            )
    for node, axis in structure.rollers:
        if carried[node] >= 0 and motions[:, column[node], "xyz".index(axis)].any():
            raise ValueError(
                f"support_motion moves the fixed node {carried[node]} along {axis}, but bars lead "
                f"from it to node {node}, which a roller holds along {axis}"
            )
    return given.mapped(moved_by_supports(structure))


def moved_by_supports(structure: Structure) -> Any:
    """Return by what displacements of the fixed nodes move all nodes, node by node, sparse."""
    from scipy.sparse import csr_array, eye_array, kron

    carried, fixed = carried_by_supports(structure), structure.fixed
    nodes = np.flatnonzero(carried >= 0)
    shape = len(carried), len(fixed)
    column = np.searchsorted(fixed, carried[nodes])
    moves = csr_array((np.ones(len(nodes)), (nodes, column)), shape=shape)
    return kron(moves, eye_array(structure.dimension)).tocsr()
