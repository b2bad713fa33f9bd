"""Optimal motions against finer grids, and as optima of the simulator itself.

Run: ``python -m tests.benchmarks.optimal_motions``; ``--motions weight arm`` are two rows. The
motions: the arm in least time and at least effort, a weight that is raised at least effort, the
mast of the gallery at least work, a free prism that gets lower in least time and at least work. The
columns: status; intervals and iterations of the last mesh; cost; by how much the last mesh changed
it, in %, and a grid ``--finer`` times finer (1: none), or the finest below that has a motion, and
how many times finer that is; how far the plan is from an optimum of the simulator; processor time,
s.

The last but one is the part of the cost's slope that no multipliers balance, over that slope: by
the rest lengths between the ends, and the duration if it is free. The plan is replayed, and
derivatives of its end, and of the work on the way, are those of the replay. Multipliers of limits
have their sign. Where nearly all winches are at their limits, as those of the prism, multipliers
are as many as slopes, and a small part says less than elsewhere.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

import tenscontrol as tc
from tenscontrol.optimize.optimal_motion import OptimalMotionWarning
from tests.benchmarks.command_line import options

# Tolerance of the replays; of a free duration, the change that its slope is taken by.
TOLERANCE, STRETCH = 1e-9, 1e-4

# Limits that are met to this part of them are active; a motor that gives less than this part of the
# largest power is idle. Times in an interval, where work and force densities are seen. Strings keep
# this part of the force densities at the ends.
ACTIVE, IDLE, TIMES, TAUT = 1e-2, 1e-2, 20, 0.02

# Finer grids: how often they are halved on the way to the last, and iterations of IPOPT on each.
HALVINGS, MOST_ITERATIONS = 3, 1000


def arm(minimize: str) -> tuple[tuple[Any, ...], dict[str, Any]]:
    structure = tc.library.arm()
    model = tc.Model(structure, tc.LinearStrings(500.0, damping=2.0))
    rest = tc.prestress(structure, min_force_density=50.0)
    raised = tc.NodesAt([5], structure.nodes[:, [5]] + [[0.0], [0.1]])
    how: dict[str, Any] = {"winches": tc.Winches(rate=0.8, shortest=0.1), "minimize": minimize}
    if minimize == "effort":
        how["duration"] = 0.3
    return (model, rest, tc.shape_target(model, raised, force_density=50.0)), how


def weight() -> tuple[tuple[Any, ...], dict[str, Any]]:
    """1 kg on a string of 200 N/m, raised by 0.3 m."""
    hung = tc.Structure(
        [[0.0, 0.0], [0.0, -2.0]],
        bars=[], strings=[[0, 1]], bar_mass=None, fixed=[0, (1, "x")], point_mass=[0.0, 1.0],
    )  # fmt: skip
    model = tc.Model(hung, tc.LinearStrings(200.0, damping=1.0), gravity=9.81)
    ends = [
        tc.shape_target(model, tc.NodesAt([1], [[0.0], [y]]), start=hung.nodes, prestress="least")
        for y in (-2.0, -1.7)
    ]
    return (model, *ends), {"minimize": "effort", "duration": 0.8}


def mast() -> tuple[tuple[Any, ...], dict[str, Any]]:
    feet, top = [3, 4, 5], [0, 1, 2]
    structure = replace(tc.prism(), fixed=feet, point_mass=np.repeat([0.5, 0.0], 3))
    model = tc.Model(structure, tc.LinearStrings(500.0, damping=5.0), gravity=9.81)
    lids = [tc.Height(height, top=top, bottom=feet) for height in (0.5, 1.0)]
    raised = tc.shape_target(model, lids[1], prestress="least", min_force_density=60.0)
    winches = {"lid": ["top"], "verticals": ["vertical"]}
    plant = tc.linearize(model, raised.prestress, input="rest_length", actuated=winches)
    folded = tc.shape_target(model, lids[0], prestress="least", min_force_density=20.0, plant=plant)
    return (model, folded, raised), {
        "plant": plant, "minimize": "energy", "duration": 0.7, "winches": tc.Winches(rate=1.5),
        "min_force_density": 5.0, "tolerance": 2e-3, "intervals": 20,
    }  # fmt: skip


def prism(minimize: str) -> tuple[tuple[Any, ...], dict[str, Any]]:
    structure = tc.prism()
    model = tc.Model(structure, tc.LinearStrings(100.0, damping=0.5))
    rest = tc.prestress(structure, force_density=17.3205)
    low = tc.Height(0.9, top=[0, 1, 2], bottom=[3, 4, 5])
    how: dict[str, Any] = {"winches": tc.Winches(rate=0.2), "minimize": minimize, "tolerance": 2e-3}
    if minimize == "energy":
        how["duration"] = 0.6
    return (model, rest, low), how


MOTIONS = {
    "arm": lambda: arm("time"),
    "calm_arm": lambda: arm("effort"),
    "weight": weight,
    "mast": mast,
    "prism": lambda: prism("time"),
    "calm_prism": lambda: prism("energy"),
}


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, motions=tuple(MOTIONS), finer=10)
    print(f"{'motion':10s} {'status':18s} {'mesh':>5s} {'iter':>5s} {'cost':>10s} {'last %':>7s} "
          f"{'finer %':>8s} {'times':>5s} {'not optimal':>11s} {'cpu':>6s}")  # fmt: skip
    for name in given.motions:
        ends, how = MOTIONS[name]()
        began = process_time()
        motion = tc.optimal_motion(*ends, **how)
        seconds, last, finer = process_time() - began, motion.meshes[-1], (np.nan, 1.0)
        if given.finer > 1:
            finer = finer_gain(motion, ends, how, given.finer)
        off = optimality(motion, how)
        print(f"{name:10s} {motion.status:18s} {last.intervals:5d} {last.iterations:5d} "
              f"{motion.cost:10.6f} {100 * motion.cost_change:7.3f} {finer[0]:8.3f} "
              f"{finer[1]:5.1f} {off:11.1e} {seconds:6.1f}", flush=True)  # fmt: skip


def finer_gain(
    motion: tc.OptimalMotion, ends: tuple[Any, ...], how: dict[str, Any], finer: int
) -> tuple[float, float]:
    """Return by how much a motion costs more than one on a finer grid, %, and how much finer it is.

    That grid is so many times finer at least, or the finest below that has a motion: each is solved
    from what one of twice its step gave. NaN and 1 if none has.
    """
    last = motion.meshes[-1].intervals
    grids = {
        "intervals": -(-finer * last // 2**HALVINGS), "refinements": HALVINGS,
        "cost_tolerance": 1e-12, "most_iterations": MOST_ITERATIONS,
    }  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OptimalMotionWarning)
        meshes = tc.optimal_motion(*ends, **how | grids).meshes
    solved = [mesh for mesh in meshes if mesh.goal_miss >= 0 and mesh.intervals > last]
    if not solved:
        return np.nan, 1.0
    return 100 * (motion.cost / solved[-1].cost - 1), solved[-1].intervals / last


def optimality(motion: tc.OptimalMotion, how: dict[str, Any]) -> float:
    """Return the part of the slope of the cost that no multipliers balance.

    With K intervals and m winches, slopes are by the m (K - 1) rest lengths between the ends,
    winches first, and then by the duration.
    """
    K, winches = len(motion.time) - 1, motion.actuation.lead
    h, m = motion.duration / K, len(winches)
    rate = motion.rate[winches]
    by_value = (np.eye(K, K - 1) - np.eye(K, K - 1, -1)) / h
    rates = np.einsum("wv,kj->wkvj", np.eye(m), by_value).reshape(m, K, -1)
    rates = np.concatenate([rates, -rate[:, :, None] / motion.duration], axis=2)
    limit = np.full(m, how["winches"].rate if "winches" in how else np.inf)
    active = np.abs(rate) > (1 - ACTIVE) * limit[:, None]
    limits = (np.sign(rate)[:, :, None] * rates)[active]
    ends = end_slope(motion)
    rows, low = [ends, limits], [np.full(len(ends), -np.inf), np.zeros(len(limits))]
    high = [np.full(len(ends) + len(limits), np.inf)]
    if motion.minimize == "energy":
        slope, idle, slack = work_slope(motion, rates, how.get("min_force_density", 0.0))
        rows += [idle, -slack]
        low += [np.zeros(len(idle)), np.zeros(len(slack))]
        high += [np.ones(len(idle)), np.full(len(slack), np.inf)]
    else:
        is_fastest = motion.minimize == "time"  # and of those, that of least effort
        factor = 1e-3 / m / limit[0] ** 2 if is_fastest else 1.0
        slope = 2 * h * factor * np.einsum("wk,wkp->p", rate, rates)
        slope[-1] += is_fastest + factor * np.sum(rate**2) / K
    if motion.minimize != "time":
        slope, rows = slope[:-1], [row[:, :-1] for row in rows]
    A = np.vstack(rows).T
    scale = np.linalg.norm(A, axis=0)
    bounds = np.concatenate(low) * scale, np.concatenate(high) * scale
    left = lsq_linear(A / scale, -slope, bounds, tol=1e-14).fun
    return float(np.linalg.norm(left) / np.linalg.norm(slope))


def end_slope(motion: tc.OptimalMotion) -> np.ndarray:
    """Return derivatives of the end of the replay, in internal coordinates and their rates."""
    run = replay(motion)
    shape = run.nodes[:, :, -1]  # where a free structure may have turned as a whole
    frame = tc.dynamics.coordinates(motion.model, shape, "internal").projection

    def end(stretch: float) -> np.ndarray:
        other = replay(motion, stretch)
        last = (other.nodes[:, :, -1] - shape, other.velocities[:, :, -1])
        return np.concatenate([frame @ x.ravel(order="F") for x in last])

    by_duration = (end(1 + STRETCH) - end(1 - STRETCH)) / (2 * STRETCH * motion.duration)
    tangent = tc.sensitivity(run, ["rest_length"])
    by_values = []
    for by in (tangent.nodes, tangent.velocities):
        slope = by_winch(motion, by["rest_length"][:, :, 0])
        by_values.append(frame @ slope.swapaxes(0, 1).reshape(frame.shape[1], -1))
    return np.column_stack([np.vstack(by_values), by_duration])


def work_slope(
    motion: tc.OptimalMotion, rates: np.ndarray, least: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the slope of the work of the motors, and two sets of rows.

    Those of work where motors neither give nor take, of which any part from 0 to 1 may count; and
    those of force densities that are as low as they may be, or as taut strings may be.
    """
    model, K = motion.model, len(motion.time) - 1
    ends = np.minimum(motion.start.force_density, motion.goal.force_density)
    least = np.maximum(least, TAUT * ends)
    dt = motion.duration / (K * TIMES)
    run = replay(motion, output_step=dt / 2)
    times, nodes, velocities = run.time[1::2], run.nodes[:, :, 1::2], run.velocities[:, :, 1::2]
    tangent = tc.sensitivity(run, ["rest_length"], times)
    first, last = model.structure.strings.T
    along, fast = (array[:, last] - array[:, first] for array in (nodes, velocities))
    moved, quicker = (
        by_winch(motion, by["rest_length"][:, last] - by["rest_length"][:, first])
        for by in (tangent.nodes, tangent.velocities)
    )
    length = np.linalg.norm(along, axis=0)
    unit = along / length
    rate_of_length = (unit * fast).sum(axis=0)
    stretched = np.einsum("dst,dstp->stp", unit, moved)
    quickened = np.einsum("dst,dstp->stp", unit, quicker)
    quickened += np.einsum("dst,dstp->stp", (fast - unit * rate_of_length) / length, moved)
    # Rest lengths by their values: hats over the intervals.
    hat = np.array([np.interp(times, motion.time, row) for row in np.eye(K + 1)[1:-1]])
    G = motion.actuation.matrix.toarray()
    wound = np.einsum("sw,jt->stwj", G, hat).reshape(len(G), len(times), -1)
    k = np.broadcast_to(model.strings.stiffness, len(G))[:, None]
    pull = G.T @ (k * (length - motion.profile.at(times)))
    by_pull = np.einsum("sw,stp->wtp", k * G, stretched - wound)
    interval = np.arange(K).repeat(TIMES)
    rate = motion.rate[motion.actuation.lead][:, interval]
    power, slope = -pull * rate, -pull[:, :, None] * rates[:, interval]
    slope[:, :, :-1] -= by_pull * rate[:, :, None]
    idle = np.abs(power) < IDLE * power.max()
    # γ = (k (l - l0) + c l̇) / l.
    c = np.broadcast_to(model.strings.damping, len(G))[:, None]
    gamma = (k * (length - motion.profile.at(times)) + c * rate_of_length) / length
    by_gamma = k[:, :, None] * (stretched - wound) + c[:, :, None] * quickened
    by_gamma = (by_gamma - gamma[:, :, None] * stretched) / length[:, :, None]
    slack = np.zeros((*gamma.shape, len(slope[0, 0])))
    slack[:, :, :-1] = by_gamma
    return (
        dt * slope[(power > 0) & ~idle].sum(axis=0), dt * slope[idle],
        slack[gamma < (1 + ACTIVE) * least[:, None]],
    )  # fmt: skip


def by_winch(motion: tc.OptimalMotion, slope: np.ndarray) -> np.ndarray:
    """Return derivatives by rest lengths between the ends, winches first, from those by strings."""
    by = np.einsum("...sj,sw->...wj", slope[..., 1:-1], motion.actuation.matrix.toarray())
    return by.reshape(*by.shape[:-2], -1)


def replay(
    motion: tc.OptimalMotion, stretch: float = 1.0, output_step: float | None = None
) -> tc.Trajectory:
    """Return the run of the plan, so many times slower."""
    duration = stretch * motion.duration
    return tc.simulate(
        motion.model, duration, motion.start.structure.nodes,
        rest_length=tc.Profile(stretch * motion.time, motion.rest_length),
        method="dop853", tolerance=TOLERANCE, output_step=output_step, error="none",
    )  # fmt: skip


if __name__ == "__main__":
    main()
