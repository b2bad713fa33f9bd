"""Supports: which coordinates they hold, and which motions of the whole structure they leave.

Coordinates are counted as in ``vec(N)``: x, y, z of node 0, then of node 1, and so on.
``Structure.fixed_rows`` says which of them are held; the rest follows from it.
"""

from __future__ import annotations

import numpy as np

from tenscontrol.structure.structure import Structure
from tenscontrol.validation import FloatArray, IntArray

# Directions whose singular value is below this fraction of the largest do not exist.
_RANK_TOLERANCE = 1e-9

# How far, relative to the size of the structure, a support may be off in a shape given by the user.
_TOLERANCE = 1e-8


def free_coordinates(structure: Structure, nodes: FloatArray) -> FloatArray:
    """Return the free coordinates, shape (f,), of positions, velocities or forces, shape (3, n)."""
    return np.asarray(nodes.ravel(order="F")[structure.free_rows])


def is_movable(structure: Structure, pairs: IntArray) -> np.ndarray:
    """Return which members have a free end, shape (k,); those that have none are support."""
    held = np.bincount(structure.fixed_rows // 3, minlength=structure.nodes.shape[1])
    return np.asarray(~(held[pairs] == 3).all(axis=1))


def rigid_motions(nodes: FloatArray) -> FloatArray:
    """Return the displacement fields of 3 translations and 3 rotations, shape (3n, 6)."""
    centred = nodes - nodes.mean(axis=1, keepdims=True)
    turns = [np.cross(axis, centred.T).ravel() for axis in np.eye(3)]
    shifts = [np.tile(axis, nodes.shape[1]) for axis in np.eye(3)]
    return np.column_stack([*shifts, *turns])


def affine_motions(nodes: FloatArray) -> FloatArray:
    """Return the displacement fields δn = G n + c, shape (3n, 12)."""
    centred = nodes - nodes.mean(axis=1, keepdims=True)
    shifts = [np.tile(axis, nodes.shape[1]) for axis in np.eye(3)]
    fields = [np.outer(centred[j], axis).ravel() for axis in np.eye(3) for j in range(3)]
    return np.column_stack([*shifts, *fields])


def left_by_supports(structure: Structure, fields: FloatArray) -> FloatArray:
    """Return the combinations of fields, shape (3n, k), that leave the supports in place."""
    if len(structure.fixed_rows) == 0:
        return fields
    _, sizes, Vt = np.linalg.svd(fields[structure.fixed_rows])
    scale = np.linalg.norm(fields, 2)
    rank = int(np.count_nonzero(sizes > _RANK_TOLERANCE * scale))
    return np.asarray(fields @ Vt[rank:].T)


def rigid_basis(structure: Structure) -> FloatArray:
    """Return an orthonormal basis of the motions as one body that the supports leave."""
    fields = left_by_supports(structure, rigid_motions(structure.nodes))
    U, sizes, _ = np.linalg.svd(fields, full_matrices=False)
    largest = np.linalg.norm(rigid_motions(structure.nodes), 2)
    return np.asarray(U[:, sizes > _RANK_TOLERANCE * largest])


def refuse_moved_supports(
    name: str, structure: Structure, nodes: FloatArray, tolerance: float = _TOLERANCE
) -> None:
    """Raise if a fixed node is not where the structure has it."""
    off = np.linalg.norm(nodes - structure.nodes, axis=0)[structure.fixed]
    size = float(np.ptp(structure.nodes, axis=1).max())
    if off.size and off.max() > tolerance * size:
        node = int(structure.fixed[off.argmax()])
        raise ValueError(
            f"in {name}, the fixed node {node} is {off.max():.3g} m from its place "
            f"{structure.nodes[:, node]} m"
        )


def refuse_load_without_support(structure: Structure, load: FloatArray) -> None:
    """Raise if nothing holds the structure against the resultant of a load, N, shape (3, n)."""
    resultant = load.sum(axis=1)
    if len(structure.fixed_rows) == 0 and np.abs(resultant).max() > 1e-9 * np.abs(load).sum():
        raise ValueError(
            f"no equilibrium: nothing holds the structure, and its weights and loads add up to "
            f"{resultant} N. Fix some nodes, Structure(..., fixed=[...])"
        )
