"""The nonlinear equations of motion in reduced coordinates, one sample at a time."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.analysis import LinearPlant
from tenscontrol.structure import spread_force_density, spread_rest_length
from tenscontrol.validation import FloatArray

# Radians of the fastest vibration in a step of RK4: its error is then about 1e-4 of it.
_RADIANS = 0.35


def reduced_acceleration(plant: LinearPlant) -> ca.Function:
    """Return ``(z, u) -> q̈``, exact while nothing moves as one body.

    Bars keep their lengths in every shape of q, so that no state stands for them. Since q is
    linear in the node positions, ``q̈ = Tᵀ M vec(N̈)``.

    Parameters
    ----------
    plant : LinearPlant
        In internal or minimal coordinates; its operating point is the reference shape.
    """
    z = ca.SX.sym("z", 2 * plant.degrees_of_freedom)
    u = ca.SX.sym("u", plant.B.shape[1])
    moved = _motion(plant, z, u)[2]
    rows = plant.model.structure.free_rows
    project = plant.coordinates.project(np.eye(plant.nodes.size))[:, rows]
    project = np.where(np.abs(project) > 1e-14 * np.abs(project).max(), project, 0.0)
    acceleration = ca.mtimes(ca.sparsify(ca.DM(project)), moved)
    return ca.Function("reduced", [z, u], [ca.densify(acceleration)], ["z", "u"], ["qdd"])


def tracked_motion(plant: LinearPlant, matrix: FloatArray) -> ca.Function:
    """Return ``z -> (y, ẏ, ÿ at zero γ, ∂ÿ/∂γ)`` of combinations ``y = C vec(N)``.

    Exact as :func:`reduced_acceleration` is. ÿ is affine in γ, so that the last two say
    all of it.

    Parameters
    ----------
    plant : LinearPlant
        In internal or minimal coordinates, with γ as the input.
    matrix : ndarray, shape (p, 3n)
        C, node by node.
    """
    z = ca.SX.sym("z", 2 * plant.degrees_of_freedom)
    gamma = ca.SX.sym("gamma", plant.B.shape[1])
    N, V, moved = _motion(plant, z, gamma)
    C = ca.sparsify(ca.DM(matrix))
    acceleration = ca.mtimes(C[:, plant.model.structure.free_rows.tolist()], moved)
    outputs = [
        ca.mtimes(C, ca.vec(N)),
        ca.mtimes(C, ca.vec(V)),
        ca.substitute(acceleration, gamma, ca.SX.zeros(gamma.shape)),
        ca.jacobian(acceleration, gamma),
    ]
    return ca.Function("tracked", [z], ca.cse([ca.densify(each) for each in outputs]))


def _motion(plant: LinearPlant, z: Any, u: Any) -> tuple[Any, Any, Any]:
    """Return all nodes and velocities, and the accelerations of the free nodes, node by node."""
    model, structure = plant.model, plant.model.structure
    r, n = plant.degrees_of_freedom, structure.nodes.shape[1]
    T = ca.sparsify(ca.DM(np.where(np.abs(plant.basis) > 1e-14, plant.basis, 0.0)))
    N = ca.DM(plant.nodes) + ca.reshape(ca.mtimes(T, z[:r]), 3, n)
    V = ca.reshape(ca.mtimes(T, z[r:]), 3, n)
    N, V = _with_bar_lengths(plant, N, V)
    free = structure.free.tolist()
    x = ca.vertcat(ca.vec(N[:, free]), ca.vec(V[:, free]))
    loads = []
    if model.has_external_force:
        loads.append(ca.DM((plant.external_force - model.constant_force)[:, free]))
    slope = model.state_equation(plant.input)(x, _spread(plant, u), *loads)
    return N, V, slope[slope.shape[0] // 2 :]


def sampled_dynamics(plant: LinearPlant, step: float) -> tuple[ca.Function, ca.Function]:
    """Return the motion over a sample, and the same with its derivatives.

    By RK4 in steps that resolve the fastest vibration. The derivatives are those of the
    RK4 steps themselves: differences of motions and of inputs are carried along.

    Parameters
    ----------
    plant : LinearPlant
    step : float
        Sample time, s.

    Returns
    -------
    motion : casadi.Function
        ``(z, u) -> z⁺``.
    linearized : casadi.Function
        ``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)``, dense.
    """
    acceleration, r = reduced_acceleration(plant), plant.degrees_of_freedom
    a = plant.B.shape[1]
    z, u = ca.SX.sym("z", 2 * r), ca.SX.sym("u", a)
    qdd = acceleration(z, u)
    parts = [qdd, *(ca.densify(ca.jacobian(qdd, by)) for by in (z, u))]
    derivatives = ca.Function("derivatives", [z, u], ca.cse(parts))
    fastest = float(np.abs(np.linalg.eigvals(plant.A)).max(initial=0.0))
    count = max(1, ceil(step * fastest / _RADIANS))

    def plain(state: Any, u: Any) -> Any:
        return ca.vertcat(state[r:], acceleration(state, u))

    # Columns of the carried matrix: the state, and its derivatives by z and by u.
    def carried(matrix: Any, u: Any) -> Any:
        qdd, by_z, by_u = derivatives(matrix[:, 0], u)
        none = ca.DM.zeros(r, 1 + 2 * r)
        inner = ca.horzcat(qdd, ca.mtimes(by_z, matrix[:, 1:]))
        return ca.vertcat(matrix[r:, :], inner + ca.horzcat(none, by_u))

    z, u = ca.MX.sym("z", 2 * r), ca.MX.sym("u", a)
    motion = ca.Function("motion", [z, u], [_rk4(plain, z, u, step / count, count)])
    start = ca.horzcat(z, ca.DM.eye(2 * r), ca.DM.zeros(2 * r, a))
    end = _rk4(carried, ca.densify(start), u, step / count, count)
    columns = end[:, 0], end[:, 1 : 1 + 2 * r], end[:, 1 + 2 * r :]
    return motion, ca.Function("linearized", [z, u], list(columns))


def _rk4(slope: Callable[[Any, Any], Any], start: Any, u: Any, h: float, count: int) -> Any:
    """Return the expression of the state after some steps of the classic Runge-Kutta method."""
    at, held = ca.MX.sym("at", *start.shape), ca.MX.sym("held", u.shape[0])
    k1 = slope(at, held)
    k2 = slope(at + 0.5 * h * k1, held)
    k3 = slope(at + 0.5 * h * k2, held)
    k4 = slope(at + h * k3, held)
    one = ca.Function("one", [at, held], [at + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    return one(start, u) if count == 1 else one.fold(count)(start, ca.repmat(u, 1, count))


def _with_bar_lengths(plant: LinearPlant, N: Any, V: Any) -> tuple[Any, Any]:
    """Return nodes and velocities moved along the bars of the reference until lengths are kept."""
    structure = plant.model.structure
    axes = structure.bar_vectors(plant.nodes)
    axes = axes / np.linalg.norm(axes, axis=0)
    share = structure.end_share
    N, V = ca.SX(N), ca.SX(V)
    for bar, (start, end) in enumerate(structure.bars.tolist()):
        axis = ca.DM(axes[:, bar])
        vector, change = N[:, end] - N[:, start], V[:, end] - V[:, start]
        along = ca.dot(vector, axis)
        across = vector - along * axis
        reach = ca.sqrt(structure.bar_length[bar] ** 2 - ca.dot(across, across))
        whole = across + reach * axis
        stretch, rate = reach - along, -ca.dot(whole, change) / reach
        for node, part in ((start, -share[bar, 0]), (end, share[bar, 1])):
            N[:, node] += part * stretch * axis
            V[:, node] += part * rate * axis
    return N, V


def _spread(plant: LinearPlant, u: Any) -> Any:
    """Return the input of the model's strings from that of the commanded ones."""
    structure = plant.model.structure
    if plant.commanded is structure:
        return u
    spread = spread_force_density if plant.input == "force_density" else spread_rest_length
    columns = [spread(structure, row) for row in np.eye(plant.B.shape[1])]
    return ca.mtimes(ca.sparsify(ca.DM(np.column_stack(columns))), u)
