"""Displacement fields of a structure: as one body, and affine ones."""

from __future__ import annotations

import numpy as np

from tenscontrol.structure.structure import Structure
from tenscontrol.validation import FloatArray

# Directions whose singular value is below this fraction of the largest do not exist.
_RANK_TOLERANCE = 1e-9


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
    """Return the combinations of fields, shape (3n, k), that leave the fixed nodes in place."""
    if len(structure.fixed) == 0:
        return fields
    held = fields.reshape(-1, 3, fields.shape[1])[structure.fixed].reshape(-1, fields.shape[1])
    _, sizes, Vt = np.linalg.svd(held)
    scale = np.linalg.norm(fields, 2)
    rank = int(np.count_nonzero(sizes > _RANK_TOLERANCE * scale))
    return np.asarray(fields @ Vt[rank:].T)


def rigid_basis(structure: Structure) -> FloatArray:
    """Return an orthonormal basis of the motions as one body that the supports leave."""
    fields = left_by_supports(structure, rigid_motions(structure.nodes))
    U, sizes, _ = np.linalg.svd(fields, full_matrices=False)
    largest = np.linalg.norm(rigid_motions(structure.nodes), 2)
    return np.asarray(U[:, sizes > _RANK_TOLERANCE * largest])
