"""The reduced state of a measured motion, as a CasADi function."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscontrol.plant import LinearPlant

# Sweeps of Jacobi's method. It converges quadratically: four give all digits of a 4 x 4 matrix,
# and two more cost little.
_SWEEPS = 6


def measurement(plant: LinearPlant) -> ca.Function:
    """Return ``(vec N, vec V) -> z``: what :meth:`LinearPlant.measure` does, without a branch.

    In internal coordinates the shape is laid over the reference by the rotation of
    Horn (1987), doi:10.1364/JOSAA.4.000629: that of the unit quaternion that
    belongs to the largest eigenvalue of a 4 x 4 matrix. Unlike a singular value
    decomposition, that can be written as C code by CasADi. Dense vectors of 3n, 3n and 2r entries.
    """
    structure, count = plant.model.structure, plant.nodes.shape[1]
    positions, rates = ca.MX.sym("N", 3 * count), ca.MX.sym("V", 3 * count)
    N, V = (ca.reshape(part, 3, count) for part in (positions, rates))
    if plant.coordinates.kind == "internal" and len(structure.fixed) < 2:
        mass = plant.model.mass_matrix().toarray()
        weights = mass.sum(axis=1) / mass.sum()
        if len(structure.fixed):
            weights = np.zeros(count)
            weights[structure.fixed[0]] = 1.0
        reference = plant.nodes @ weights
        from_centre = N - ca.repmat(ca.mtimes(N, ca.DM(weights)), 1, count)
        spread = ca.mtimes(ca.DM(mass @ (plant.nodes - reference[:, None]).T).T, from_centre.T)
        turn = _alignment()(spread)
        N = ca.mtimes(turn, from_centre) + ca.DM(np.tile(reference[:, None], count))
        V = ca.mtimes(turn, V)
    project = ca.DM(plant.coordinates.project(np.eye(plant.nodes.size)))
    displacement = ca.vec(N) - ca.DM(plant.nodes.ravel(order="F"))
    z = ca.vertcat(ca.mtimes(project, displacement), ca.mtimes(project, ca.vec(V)))
    return ca.Function("measure", [positions, rates], [ca.densify(z)], ["N", "V"], ["z"])


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
    return ca.Function("alignment", [S], [turn])


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
    return ca.Function("sweep", [both], [ca.densify(ca.vertcat(matrix, vectors))])


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
    return ca.Function("largest", [both], [ca.densify(turn)])
