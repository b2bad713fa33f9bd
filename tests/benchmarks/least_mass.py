"""Least masses of random structures beside those of another statement from many starts.

Run: ``python -m tests.benchmarks.least_mass --first 3000 --count 150``, some minutes. Structures of
class 1 to 6 carry two loads. The forces of a design balance them, its margins hold, and its mass is
written again. Printed for each is the mass over the least one from ``--starts 50`` corners of the
balanced forces, met by random costs, and linear programs with tangents from there on (0 where one
set of forces alone balances a load); what the design says that may be saved at most; and, where
members yield but do not buckle, the mass over the optimum of an interior-point method.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from scipy.optimize import linprog
from scipy.sparse import block_diag, csr_array, eye_array, hstack, vstack

import tenscontrol as tc
from tests.benchmarks.command_line import options
from tests.random_structures import any_structure

SOFT = tc.Material(modulus=60e9, density=2700.0, yield_stress=110e6)
ROPE = tc.Material(modulus=2e9, density=1100.0, yield_stress=300e6)
HARD = tc.Material(modulus=1e20, density=2700.0, yield_stress=110e6)
LOW = 10.0  # N/m
RADIUS = 1e-6  # m


def random_case(seed):
    """A random structure, and two loads that it carries with every string at 10 N/m or more."""
    structure, random = any_structure(seed), np.random.default_rng(seed)
    alpha = len(structure.strings)
    E = tc.statics.equilibrium_matrix(structure)
    loads = []
    for _ in range(2):
        density = np.r_[
            random.uniform(10, 500, alpha), random.uniform(-300, 900, E.shape[1] - alpha)
        ]
        load = (E @ density).reshape(-1, structure.dimension).T
        load[:, structure.fixed] = 0
        loads.append(load)
    return structure, loads


def needed(structure, forces):
    """The mass of all members under forces (K, α + β), written again."""
    alpha = len(structure.strings)
    pull = np.maximum(forces[:, :alpha], 0) / ROPE.yield_stress
    push = forces[:, alpha:]
    column = 2 * structure.bar_length * np.sqrt(np.maximum(push, 0) / (np.pi * SOFT.modulus))
    area = np.maximum(np.abs(push) / SOFT.yield_stress, column)
    least = np.pi * RADIUS**2
    strings = ROPE.density * np.maximum(pull.max(axis=0), least) @ structure.string_length()
    return strings + SOFT.density * np.maximum(area.max(axis=0), least) @ structure.bar_length


def over_starts(seed, starts):
    """Check a design of a random structure; return its mass over the least of many starts, gap."""
    structure, loads = random_case(seed)
    found = tc.design(structure, bars=SOFT, strings=ROPE, loads=loads, min_force_density=LOW,
                      least_radius=RADIUS)  # fmt: skip
    E = tc.statics.equilibrium_matrix(structure)[structure.free_rows]
    densities = np.hstack([found.force_density, found.bar_force_density])
    assert (found.force_density >= LOW * (1 - 1e-5)).all()  # 1e-7 of the largest force
    for load, density in zip(loads, densities, strict=True):
        w = load.T.ravel()[structure.free_rows]
        np.testing.assert_allclose(E @ density, w, atol=1e-6 * np.abs(w).max(initial=0))
    length = np.r_[structure.string_length(), structure.bar_length]
    np.testing.assert_allclose(found.mass, needed(structure, densities * length), rtol=1e-4)
    pulls, pushes = found.margins(*np.split((densities * length).T, [len(structure.strings)]))
    assert min(pulls.min(), pushes.min()) > 1 - 1e-9
    if len(E) == 0 or np.linalg.matrix_rank(E) == E.shape[1]:
        return 0.0, found.gap  # nothing to balance, or one set of forces alone
    least = least_of_starts(structure, E, loads, seed, starts)
    assert found.bound <= least * (1 + 1e-6)
    return found.mass / least, found.gap


def least_of_starts(structure, E, loads, seed, count):
    """The least mass from corners of the balanced forces of each load, met by random costs."""
    random, alpha, beta = np.random.default_rng(seed), len(structure.strings), len(structure.bars)
    length = np.r_[structure.string_length(), structure.bar_length]
    unit = csr_array(np.hstack([E / length, -E[:, alpha:] / length[alpha:]]))  # bars push or pull
    bounds = [(LOW * size, None) for size in length[:alpha]] + [(0.0, None)] * (2 * beta)
    least = np.inf
    for _ in range(count):
        cost = 10 ** random.uniform(-2, 2, alpha + 2 * beta)
        x = np.array([
            linprog(cost, A_eq=unit, b_eq=load.T.ravel()[structure.free_rows], bounds=bounds).x
            for load in loads
        ])  # fmt: skip
        least = min(least, _lightened(structure, unit, loads, bounds, x))
    return least


def _lightened(structure, unit, loads, bounds, x):
    """The mass where programs in forces x (K, α + 2β) and areas end, with tangents at the last."""
    alpha, beta, cases = len(structure.strings), len(structure.bars), len(x)
    density = np.r_[np.full(alpha, ROPE.density), np.full(beta, SOFT.density)]
    cost = density * np.r_[structure.string_length(), structure.bar_length]
    per_yield = 1 / np.r_[np.full(alpha, ROPE.yield_stress), np.full(beta, SOFT.yield_stress)]
    split = hstack([eye_array(alpha + beta), vstack([csr_array((alpha, beta)), eye_array(beta)])])
    squared = 4 * structure.bar_length**2 / (np.pi * SOFT.modulus)  # area² per push
    equal = hstack([block_diag([unit] * cases), csr_array((cases * unit.shape[0],
                                                           alpha + beta))])  # fmt: skip
    w = np.concatenate([load.T.ravel()[structure.free_rows] for load in loads])
    forces = [*bounds * cases, *[(0.0, None)] * (alpha + beta)]

    def mass(x):
        signed = x[:, : alpha + beta].copy()
        signed[:, alpha:] -= x[:, alpha + beta :]
        return needed(structure, signed)

    least = mass(x)
    for _ in range(30):
        push = np.maximum(x[:, alpha : alpha + beta].max(axis=0), 1e-9 * x.max())
        area = np.sqrt(squared * push)
        bends = hstack([csr_array((beta, alpha)), csr_array(np.diag(0.5 * squared / area)),
                        csr_array((beta, beta))])  # fmt: skip
        asks = vstack([csr_array(np.diag(per_yield)) @ split, bends])
        serves = vstack([eye_array(alpha + beta), eye_array(alpha + beta).tocsr()[alpha:]])
        rows = hstack([block_diag([asks] * cases), -vstack([serves] * cases)])
        most = np.tile(np.r_[np.zeros(alpha + beta), -0.5 * area], cases)
        c = np.r_[np.zeros(x.size), cost] / cost.max()
        x = linprog(c, rows, most, equal, w, forces).x[: x.size].reshape(cases, -1)
        if mass(x) > least * (1 - 1e-9):
            break
        least = mass(x)
    return least


def over_interior_point(seed):
    """Return the mass by yield alone, under one load, over that of IPOPT."""
    structure, loads = random_case(seed)
    found = tc.design(structure, bars=HARD, strings=ROPE, loads=loads[:1], min_force_density=LOW,
                      least_radius=RADIUS)  # fmt: skip
    assert found.restarts_agree
    E = tc.statics.equilibrium_matrix(structure)[structure.free_rows]
    w = loads[0].T.ravel()[structure.free_rows]
    return found.mass / least_by_interior_point(structure, E, w)


def least_by_interior_point(structure, E, w):
    """Least mass by yield with bars as a push less a pull, by CasADi's IPOPT."""
    length = np.r_[structure.string_length(), structure.bar_length]
    alpha, beta = len(structure.strings), len(structure.bars)
    unit, size = E / length, np.abs(w).max()
    per = np.r_[
        ROPE.density / ROPE.yield_stress * length[:alpha], 2700 / 110e6 * length[alpha:]
    ]  # fmt: skip
    x = ca.SX.sym("x", alpha + 2 * beta)
    force = ca.vertcat(x[: alpha + beta])
    force[alpha:] -= x[alpha + beta :]
    cost = np.r_[per, per[alpha:]]
    solver = ca.nlpsol(
        "s", "ipopt", {"x": x, "f": ca.dot(cost / cost.max(), x), "g": unit @ force},
        {"print_time": 0, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10},
    )  # fmt: skip
    low = np.r_[LOW * length[:alpha] / size, np.zeros(2 * beta)]
    answer = solver(x0=low + 1, lbx=low, ubx=np.inf, lbg=w / size, ubg=w / size)
    return float(answer["f"]) * cost.max() * size


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, first=0, count=50, starts=50, yields=10)
    print("seed  over many starts  gap      over IPOPT, by yield")
    ratios = []
    for seed in range(given.first, given.first + given.count):
        by_yield = f"{over_interior_point(seed):21.6f}" if seed < given.first + given.yields else ""
        ratio, gap = over_starts(seed, given.starts)
        ratios.append(ratio)
        print(f"{seed:4d} {ratio:17.7f}  {gap:.1e} {by_yield}", flush=True)
    several = [ratio for ratio in ratios if ratio > 0]
    right = sum(ratio <= 1 + 1e-6 for ratio in several)
    print(f"{right} of {len(several)} with a choice of forces are right to 1e-6, "
          f"the worst to {max(several) - 1:.1e}")  # fmt: skip


if __name__ == "__main__":
    main()
