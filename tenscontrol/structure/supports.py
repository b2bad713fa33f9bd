"""Supports: the coordinates that they fix, and the rigid-body motions that remain.

Coordinates are counted as in ``vec(N)``: x, y, z of node 0, then of node 1, and so on.
``Structure.fixed_rows`` says which of them are held; the rest follows from it.
"""

from __future__ import annotations

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.structure.structure import Structure

# Directions whose singular value is below this fraction of the largest do not exist.
_RANK_TOLERANCE = 1e-9

# How far, relative to the size of the structure, a support may be off in a shape given by the user.
_TOLERANCE = 1e-8


def free_coordinates(structure: Structure, nodes: FloatArray) -> FloatArray:
    """Return the free coordinates, shape (f,), of positions, velocities or forces, shape (d, n)."""
    free: FloatArray = nodes.ravel(order="F")[structure.free_rows]
    return free


def held_directions(structure: Structure) -> np.ndarray:
    """Return which coordinates of each node supports hold, shape (n, d)."""
    held = np.isin(np.arange(structure.nodes.size), structure.fixed_rows)
    return held.reshape(-1, structure.dimension)


def random_moves(structure: Structure, random: np.random.Generator) -> FloatArray:
    """Return normal random moves of nodes, shape (d, n), none where supports hold."""
    moves = np.zeros_like(structure.nodes)
    moves[:, structure.free] = random.normal(size=(structure.dimension, len(structure.free)))
    return np.where(held_directions(structure).T, 0.0, moves)


def is_movable(structure: Structure, pairs: IntArray) -> np.ndarray:
    """Return which members have a free end, shape (k,); those that have none are support."""
    return np.asarray(~np.isin(pairs, structure.fixed).all(axis=1))


def moving_mass(structure: Structure) -> float:
    """Return the mass of all bars and of the nodes that are not fixed, kg."""
    return float(moving_masses(structure, structure.bar_mass, structure.point_mass))


def moving_masses(structure: Structure, bars: FloatArray, points: FloatArray) -> FloatArray:
    """Return the same for masses of bars (…, bars) and nodes (…, n), kg."""
    of_free = np.ascontiguousarray(points[..., structure.free])
    return np.asarray(np.ascontiguousarray(bars).sum(axis=-1) + of_free.sum(axis=-1))


def rigid_motions(nodes: FloatArray) -> FloatArray:
    """Return the displacement fields of d translations, then d (d − 1)/2 rotations, shape (d n, ·).

    In space the rotations are about x, y and z.
    """
    d, n = nodes.shape
    centred = nodes - nodes.mean(axis=1, keepdims=True)
    planes = [(1, 2), (2, 0), (0, 1)] if d == 3 else [(0, 1)]
    turns = np.zeros((len(planes), n, d))
    for turn, (i, j) in zip(turns, planes, strict=True):
        turn[:, i], turn[:, j] = -centred[j], centred[i]
    shifts = [np.tile(axis, n) for axis in np.eye(d)]
    return np.column_stack([*shifts, *turns.reshape(len(planes), -1)])


def rotation_between(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the rotation that fits best from one shape to another, shape (d, d) (Kabsch 1976)."""
    before, after = (nodes - nodes.mean(axis=1, keepdims=True) for nodes in (before, after))
    U, _, Vt = np.linalg.svd(after @ before.T)
    U[:, -1] *= np.linalg.det(U @ Vt)
    return np.asarray(U @ Vt)


def rotation_about(axis: FloatArray, angle: float) -> FloatArray:
    """Return the rotation by an angle, rad, about a unit vector, shape (3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def affine_motions(nodes: FloatArray) -> FloatArray:
    """Return the displacement fields δn = G n + c, shape (d n, d + d²)."""
    d, n = nodes.shape
    centred = nodes - nodes.mean(axis=1, keepdims=True)
    shifts = [np.tile(axis, n) for axis in np.eye(d)]
    fields = [np.outer(centred[j], axis).ravel() for axis in np.eye(d) for j in range(d)]
    return np.column_stack([*shifts, *fields])


def left_by_supports(structure: Structure, fields: FloatArray) -> FloatArray:
    """Return the combinations of fields, shape (d n, k), that leave the supports in place."""
    if len(structure.fixed_rows) == 0:
        return fields
    _, sizes, Vt = np.linalg.svd(fields[structure.fixed_rows])
    scale = np.linalg.norm(fields, 2)
    rank = int(np.count_nonzero(sizes > _RANK_TOLERANCE * scale))
    return np.asarray(fields @ Vt[rank:].T)


def rigid_basis(structure: Structure) -> FloatArray:
    """Return an orthonormal basis of the rigid-body motions that the supports leave."""
    motions = rigid_motions(structure.nodes)
    U, sizes, _ = np.linalg.svd(left_by_supports(structure, motions), full_matrices=False)
    largest = np.linalg.norm(motions, 2)
    return np.asarray(U[:, sizes > _RANK_TOLERANCE * largest])


def carried_by_supports(structure: Structure) -> IntArray:
    """Return for each node the fixed node that it moves with, shape (n,), or -1.

    A node moves with a fixed node if bars lead from one to the other.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = structure.nodes.shape[1]
    start, end = structure.bars.T
    joined = coo_array((np.ones(len(start)), (start, end)), shape=(n, n))
    _, group = connected_components(joined, directed=False)
    first = np.full(n, -1)
    first[group[structure.fixed[::-1]]] = structure.fixed[::-1]
    return np.asarray(first[group])


def refuse_moved_supports(
    name: str, structure: Structure, nodes: FloatArray, tolerance: float = _TOLERANCE
) -> None:
    """Raise if a fixed node is not where the structure has it."""
    if not len(structure.fixed_rows):
        return
    off = (nodes - structure.nodes).ravel(order="F")[structure.fixed_rows]
    size = structure.size
    if np.abs(off).max() <= tolerance * size:
        return
    node, axis = divmod(int(structure.fixed_rows[np.abs(off).argmax()]), structure.dimension)
    place = structure.nodes[:, node]
    if node in structure.fixed:
        moved = float(np.linalg.norm(nodes[:, node] - place))
        held = f"the fixed node {node} is {moved:.3g} m from its place {place} m"
    else:
        held = (
            f"node {node} is {np.abs(off).max():.3g} m off its roller, which holds its "
            f"{'xyz'[axis]} at {place[axis]:g} m"
        )
    raise ValueError(f"in {name}, {held}")


def refuse_load_without_support(structure: Structure, load: FloatArray) -> None:
    """Raise if nothing holds the structure against the resultant of a load, N, shape (d, n)."""
    resultant = load.sum(axis=1)
    resultant[np.unique(structure.fixed_rows % structure.dimension)] = 0.0  # something holds it
    if np.abs(resultant).max() > 1e-9 * np.abs(load).sum():
        raise ValueError(
            f"no equilibrium: the structure has no support, and its weights and external_force "
            f"add up to {load.sum(axis=1)} N. Fix some nodes, Structure(..., fixed=[...])"
        )
