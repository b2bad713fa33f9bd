"""The reduced state of a measured motion, as a CasADi function."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics.evaluator import Function
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.structure.supports import left_by_supports, rigid_basis, rigid_motions

# Sweeps of Jacobi's method. It converges quadratically: four give all digits of a 4 x 4 matrix,
# and two more cost little.
_SWEEPS = 6

# Steps of the method of Gauss and Newton. An error shrinks by the size of the deformation, relative
# to that of the structure, in each.
_STEPS = 20

# Rigid-body motions that move a support by less than this fraction of what they move leave it.
_RANK = 1e-9

# Shapes next to the operating point are aside by this part of the size.
_ASIDE = 1e-3


def measurement(plant: LinearPlant) -> ca.Function:
    """Return ``(vec N, vec V) -> z``: what :meth:`LinearPlant.measure` does, without a branch.

    In internal coordinates the shape is laid over the reference by the rotation of
    Horn (1987), doi:10.1364/JOSAA.4.000629: that of the unit quaternion that
    belongs to the largest eigenvalue of a 4 x 4 matrix. Unlike a singular value
    decomposition, that can be written as C code by CasADi. On rollers, by steps of Gauss and Newton
    along them. Dense vectors of d n, d n and 2r entries.
    """
    structure, (d, count) = plant.model.structure, plant.nodes.shape
    positions, rates = ca.MX.sym("N", d * count), ca.MX.sym("V", d * count)
    N, V = (ca.reshape(array, d, count) for array in (positions, rates))
    is_internal = plant.coordinates.kind == "internal"
    by_coordinate = len(structure.rollers) > 0 or len(structure.fixed) > 1
    if is_internal and by_coordinate and rigid_basis(structure).shape[1]:
        both = ca.horzcat(N, ca.MX(np.eye(d)))
        for nearest in (True, False):
            both = _along_supports(plant, nearest).fold(_STEPS)(both)
        N, V = both[:, :count], ca.mtimes(both[:, count:], V)
    elif is_internal and not by_coordinate:
        mass = plant.model.mass_matrix().toarray()
        weights = mass.sum(axis=1) / mass.sum()
        if len(structure.fixed):
            weights = np.zeros(count)
            weights[structure.fixed[0]] = 1.0
        reference = plant.nodes @ weights
        from_centre = N - ca.repmat(ca.mtimes(N, ca.DM(weights)), 1, count)
        spread = ca.mtimes(ca.DM(mass @ (plant.nodes - reference[:, None]).T).T, from_centre.T)
        turn = (_alignment() if d == 3 else _planar_alignment())(spread)
        N = ca.mtimes(turn, from_centre) + ca.DM(np.tile(reference[:, None], count))
        V = ca.mtimes(turn, V)
    project = ca.DM(plant.coordinates.project(np.eye(plant.nodes.size)))
    displacement = ca.vec(N) - ca.DM(plant.nodes.ravel(order="F"))
    z = ca.vertcat(ca.mtimes(project, displacement), ca.mtimes(project, ca.vec(V)))
    return Function("measure", [positions, rates], [ca.densify(z)], ["N", "V"], ["z"])


def _along_supports(plant: LinearPlant, nearest: bool) -> ca.Function:
    """Return ``[N, R] -> [N', R']``: a step of a shape along the supports towards the reference.

    The displacement is then M-orthogonal to the rigid-body motions that the supports leave: those
    of the shape, for the nearest shape, or those of the reference. What the supports hold is at its
    place. R is the turn up to here.
    """
    structure, (d, count) = plant.model.structure, plant.nodes.shape
    mass = plant.model.mass_matrix().toarray()
    both = ca.SX.sym("both", d, count + d)
    N, turn = both[:, :count], both[:, count:]
    planes = [(1, 2), (2, 0), (0, 1)] if d == 3 else [(0, 1)]
    centre = ca.sum2(N) / count
    arms = N - ca.repmat(centre, 1, count)
    fields = [ca.repmat(axis, 1, count) for axis in ca.horzsplit(ca.SX.eye(d))]
    for i, j in planes:
        field = ca.SX.zeros(d, count)
        field[i, :], field[j, :] = -arms[j, :], arms[i, :]
        fields.append(field)
    off = N - ca.DM(plant.nodes)
    held = structure.fixed_rows[_independent_rows(plant)].tolist()
    moved = ca.horzcat(*(ca.vec(field) for field in fields))
    momenta = ca.horzcat(*(ca.vec(ca.mtimes(field, ca.DM(mass))) for field in fields))
    by_supports = moved[held, :]
    corner = ca.SX(len(held), len(held))
    if nearest:
        matrix = ca.blockcat([[ca.mtimes(momenta.T, moved), by_supports.T], [by_supports, corner]])
    else:
        left = left_by_supports(structure, rigid_motions(plant.nodes))
        momenta = ca.DM((mass @ left.reshape(count, -1)).reshape(left.shape))
        matrix = ca.vertcat(ca.mtimes(momenta.T, moved), by_supports)
    right = -ca.vertcat(ca.mtimes(momenta.T, ca.vec(off)), ca.vec(off)[held])
    move = ca.solve(matrix, right)[: len(fields)]
    by_turn = _rotation(move[d:])
    back = ca.mtimes(by_turn, arms) + ca.repmat(centre + move[:d], 1, count)
    moved_shape = ca.horzcat(back, ca.mtimes(by_turn, turn))
    return Function("along_supports", [both], [ca.densify(moved_shape)])


def _independent_rows(plant: LinearPlant) -> list[int]:
    """Return which held coordinates determine the others, or refuse where that depends on shape."""
    from scipy.linalg import qr

    nodes, held = plant.nodes, plant.model.structure.fixed_rows
    aside = _ASIDE * np.ptp(nodes, axis=1).max() * np.random.default_rng(0).normal(size=nodes.shape)
    rows = []
    for shape in (nodes, nodes + aside):
        R, order = qr(rigid_motions(shape)[held].T, mode="r", pivoting=True)
        sizes = np.abs(np.diagonal(R))
        rows.append(sorted(order[: np.count_nonzero(sizes > _RANK * sizes[0])]))
    if len(rows[0]) < len(rows[1]):
        raise ValueError(
            "controller is for a structure whose supports allow other rigid-body motions at its "
            "operating point than in neighbouring shapes, so that its measurement cannot be "
            "written as C code: move a roller, or fix another coordinate"
        )
    return rows[0]


def _rotation(turn: Any) -> Any:
    """Return the rotation about a vector by its length, or by an angle in the plane."""
    if turn.numel() == 1:
        return ca.blockcat([[ca.cos(turn), -ca.sin(turn)], [ca.sin(turn), ca.cos(turn)]])
    angle = ca.norm_2(turn) + np.finfo(float).tiny
    cross = ca.skew(turn / angle)
    return ca.SX.eye(3) + ca.sin(angle) * cross + (1 - ca.cos(angle)) * ca.mtimes(cross, cross)


def _planar_alignment() -> ca.Function:
    """Return ``S -> R``: the rotation in the plane that makes ``trace(Rᵀ S)`` largest."""
    S = ca.SX.sym("S", 2, 2)
    turn = _rotation(ca.atan2(S[1, 0] - S[0, 1], S[0, 0] + S[1, 1]))
    return Function("alignment", [S], [turn])


def _alignment() -> ca.Function:
    """Return ``S -> R``: the rotation that makes ``trace(Rᵀ S)`` largest."""
    S = ca.MX.sym("S", 3, 3)
    matrix = ca.MX(4, 4)
    matrix[0, 0] = S[0, 0] + S[1, 1] + S[2, 2]
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        matrix[0, 1 + i] = matrix[1 + i, 0] = S[k, j] - S[j, k]
        matrix[1 + i, 1 + i] = S[i, i] - S[j, j] - S[k, k]
        matrix[1 + j, 1 + k] = matrix[1 + k, 1 + j] = S[j, k] + S[k, j]
    both = ca.vertcat(ca.densify(matrix), ca.MX(np.eye(4)))
    turn = _largest()(_sweep().fold(_SWEEPS)(both))
    return Function("alignment", [S], [turn])


def _sweep() -> ca.Function:
    """Return ``[M; X] -> [M'; X']``: each two axes of a symmetric 4 x 4 matrix turned once."""
    both = ca.SX.sym("both", 8, 4)
    matrix, vectors = both[:4, :], both[4:, :]
    for i in range(4):
        for j in range(i + 1, 4):
            gap, twice = matrix[j, j] - matrix[i, i], 2 * matrix[i, j]
            # The smallest number keeps 0 / 0 away where both vanish.
            whole = ca.fabs(gap) + ca.sqrt(gap**2 + twice**2) + np.finfo(float).tiny
            tangent = ca.if_else(gap < 0, -twice, twice) / whole
            cosine = 1 / ca.sqrt(1 + tangent**2)
            turn = ca.SX(np.eye(4))
            turn[i, i] = turn[j, j] = cosine
            turn[i, j], turn[j, i] = tangent * cosine, -tangent * cosine
            matrix, vectors = ca.mtimes([turn.T, matrix, turn]), ca.mtimes(vectors, turn)
    return Function("sweep", [both], [ca.densify(ca.vertcat(matrix, vectors))])


def _largest() -> ca.Function:
    """Return the rotation of the quaternion that belongs to the largest eigenvalue."""
    both = ca.SX.sym("both", 8, 4)
    largest, q = both[0, 0], both[4:, 0]
    for i in range(1, 4):
        is_larger = both[i, i] > largest
        largest = ca.if_else(is_larger, both[i, i], largest)
        q = ca.if_else(is_larger, both[4:, i], q)
    cross = ca.skew(q[1:])
    turn = ca.SX.eye(3) + 2 * (q[0] * cross + ca.mtimes(cross, cross)) / ca.sumsqr(q)
    return Function("largest", [both], [ca.densify(turn)])
