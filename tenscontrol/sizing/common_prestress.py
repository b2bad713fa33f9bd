"""Least mass of a structure whose strings are wound once, before any load comes."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.sizing.area_program import AreaProgram
from tenscontrol.statics.equilibrium_matrix import matrix_rank

# Areas are at least this part of the largest, so that each member has a flexibility.
_THIN = 1e-9

# Tolerance of the nonlinear program, the part by which areas make up for it, and the pull, part of
# the largest, that may lack.
_TOLERANCE, _MADE_UP, _LACK = 1e-9, 1e-5, 1e-7


class Wound(NamedTuple):
    """Forces of loads, on top of a prestress if there is a common one, and areas for both."""

    mass: float  # kg
    prestress: FloatArray | None  # (m,), forces without load, in the unit
    forces: FloatArray  # (K, m), with each load
    area: FloatArray  # (m,), m²


class _ForceMethod(NamedTuple):
    """Forces x = own + states @ c of each load, before it is known how members share them."""

    own: FloatArray  # (K, m), in balance with the loads
    states: FloatArray  # (m, s), orthonormal states of self-stress

    def response(self, flexibility: FloatArray) -> FloatArray:
        """Return the forces of each load in elastic members, l / EA each, shape (K, m)."""
        weighted = self.states * flexibility[:, None]
        shares = np.linalg.solve(self.states.T @ weighted, -weighted.T @ self.own.T)
        return self.own + (self.states @ shares).T


def wound_once(
    program: AreaProgram, per_stiffness: FloatArray, starts: list[FloatArray]
) -> list[Wound]:
    """Return designs with one prestress, the lightest first, from areas, shape (m,), each.

    ``per_stiffness`` is l/E of each member: its flexibility times its area, in any unit.
    """
    method = _force_method(program)
    if not method.states.shape[1]:
        raise ValueError(
            "common_prestress is True, yet the structure has no state of self-stress, so that "
            "strings cannot be wound before loads come; leave it out, or add members"
        )
    none = np.zeros(len(program.per_push))
    if replace(program, loads=np.zeros((1, program.balance.shape[0]))).solve(none, none) is None:
        raise ValueError(
            "common_prestress is True, yet no self-stress has every string at min_force_density "
            "without loads; leave it out, or let strings go slack by min_force_density=0"
        )
    minima = [_descent(program, method, per_stiffness, area) for area in starts]
    ended = [wound for wound in minima if wound is not None]
    if not ended:
        raise ArithmeticError(
            "no prestress was found with which every string stays at min_force_density under each "
            "load; lower min_force_density, or leave out common_prestress"
        )
    return sorted(ended, key=lambda wound: wound.mass)


def _force_method(program: AreaProgram) -> _ForceMethod:
    B = program.balance
    validation.refuse_memory(
        f"structure has {B.shape[1]} members and common_prestress is True",
        float(B.shape[1]) ** 2, "numbers in singular vectors", 8,
    )  # fmt: skip
    U, sizes, Vt = np.linalg.svd(B.toarray())
    rank = matrix_rank(sizes)
    own = (program.loads @ U[:, :rank] / sizes[:rank]) @ Vt[:rank]
    return _ForceMethod(own, Vt[rank:].T)


def _descent(
    program: AreaProgram, method: _ForceMethod, per_stiffness: FloatArray, start: FloatArray
) -> Wound | None:
    """Return a local minimum by an interior point, or None where it finds no feasible one."""
    import casadi as ca

    alpha, group = len(program.least_pull), program.group
    cases, states = len(program.loads), method.states.shape[1]
    groups = int(group.max()) + 1
    # Areas of groups are in parts of those to start from.
    start_area = np.zeros(groups)
    np.maximum.at(start_area, group, np.maximum(start, _THIN * start.max()))
    size = start_area[group]
    weight = np.bincount(group, program.per_area * size, groups)
    a, s = ca.SX.sym("a", groups), ca.SX.sym("s", states)
    shares = [ca.SX.sym(f"c{k}", states) for k in range(cases)]
    area = a[group.tolist()]
    S = ca.DM(method.states)
    soft = per_stiffness / size
    flexibility = ca.DM(soft / soft.max()) / area
    prestress = ca.mtimes(S, s)
    added = [ca.DM(own) + ca.mtimes(S, c) for own, c in zip(method.own, shares, strict=True)]
    compatible = [ca.mtimes(S.T, flexibility * force) for force in added]
    limits = []
    for x in [prestress, *(prestress + force for force in added)]:
        pull, push = x[:alpha], x[alpha:]
        limits += [
            pull - ca.DM(program.least_pull),
            area[:alpha] - ca.DM(program.per_pull[:alpha] / size[:alpha]) * pull,
            area[alpha:] + ca.DM(program.per_pull[alpha:] / size[alpha:]) * push,
            area[alpha:] - ca.DM(program.per_push / size[alpha:]) * push,
            area[alpha:] ** 2 - ca.DM((program.per_root / size[alpha:]) ** 2) * push,
        ]
    equal, above = ca.vertcat(*compatible), ca.vertcat(*limits)
    unknowns = ca.vertcat(a, s, *shares)
    solver = ca.nlpsol(
        "least_mass", "ipopt",
        {"x": unknowns, "g": ca.vertcat(equal, above),
         "f": ca.dot(ca.DM(weight / weight.sum()), a)},
        {"print_time": 0, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": _TOLERANCE,
         "ipopt.bound_relax_factor": 0.0, "ipopt.max_iter": 500, "error_on_fail": False},
    )  # fmt: skip
    least = np.zeros(groups)
    np.maximum.at(least, group, program.least_area / size)
    low = np.r_[np.maximum(least, _THIN), np.full((cases + 1) * states, -np.inf)]
    response = method.response(soft) - method.own
    begin = np.r_[np.ones(groups), np.zeros(states), (response @ method.states).ravel()]
    answer = solver(
        x0=begin, lbx=low, ubx=np.inf, lbg=0.0,
        ubg=np.r_[np.zeros(equal.numel()), np.full(above.numel(), np.inf)],
    )  # fmt: skip
    z = np.asarray(answer["x"]).ravel()
    if not np.isfinite(z).all():
        return None
    return _exact(program, method, per_stiffness, z[:groups][group] * size,
                  method.states @ z[groups : groups + states])  # fmt: skip


def _exact(
    program: AreaProgram, method: _ForceMethod, per_stiffness: FloatArray, area: FloatArray,
    prestress: FloatArray,
) -> Wound | None:  # fmt: skip
    """Return the design with the exact response of these areas, or None if it breaks a limit."""
    forces = prestress + method.response(per_stiffness / area)
    loaded = np.vstack([prestress, forces])
    alpha = len(program.least_pull)
    lack = (program.least_pull - loaded[:, :alpha]).max(initial=0.0)
    # As many times the area in all members leaves the response as it is.
    factor = max(float((program.shared(loaded) / area).max()), 1.0)
    if lack > _LACK or factor > 1 + _MADE_UP:
        return None
    area = area * factor
    return Wound(float(program.per_area @ area), prestress, forces, area)
