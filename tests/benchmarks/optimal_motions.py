"""Optimal motions against finer grids, and as optima of the simulator itself.

Run: ``python -m tests.benchmarks.optimal_motions``; ``--motions weight arm`` are two rows. The
motions: the arm in least time and at least effort, a weight that is raised at least effort, the
mast of the gallery at least work, a free prism that gets lower in least time and at least work. The
columns: status; intervals and iterations of the last mesh; cost; by how much the last mesh changed
it, in %, and a grid ``--finer`` times finer (1: none), or the finest below that has a motion, and
how many times finer that is; how far the plan is from an optimum of the simulator; processor time,
s.

The last but one is the slope of the Lagrangian of the simulator, over that of the cost: by the rest
lengths between the ends, and the duration if it is free. Places and velocities are those of the
replay, their derivatives those of :func:`tenscontrol.sensitivity`. Multipliers of the end and of
all limits are those of the plan. Of an optimum of the simulator it is zero, and the plan comes
nearer to one with order 4: by a factor of 16 as intervals are halved.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.interpolate import KroghInterpolator

import tenscontrol as tc
from tenscontrol.arrays import FloatArray
from tenscontrol.optimize.collocation import (
    EQUATION,
    STAGES,
    Collocation,
    DiscreteMotion,
    Solution,
    gauss_points,
)
from tenscontrol.optimize.optimal_motion import OptimalMotionWarning
from tests.benchmarks.command_line import options

# Tolerance of the replays; of a free duration, the change that its slope is taken by.
TOLERANCE, STRETCH = 1e-9, 1e-4

# Replays are read at so many times in an interval, and by a polynomial through them between.
POINTS = 6

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
        motion, mesh, solution = planned(ends, how)
        seconds, last, finer = process_time() - began, motion.meshes[-1], (np.nan, 1.0)
        if given.finer > 1:
            finer = finer_gain(motion, ends, how, given.finer)
        off = optimality(motion, mesh, solution.multipliers)
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


def planned(
    ends: tuple[Any, ...], how: dict[str, Any]
) -> tuple[tc.OptimalMotion, Collocation, Solution]:
    """Return a motion, and the program of its last mesh with its solution."""
    solved = []

    def solve(mesh: Collocation, *arguments: Any) -> Solution:
        solution = original(mesh, *arguments)
        solved.append((mesh, solution))
        return solution

    original = Collocation.solve
    with patch.object(Collocation, "solve", solve):
        motion = tc.optimal_motion(*ends, **how)
    count = motion.meshes[-1].intervals if motion.run is None else len(motion.time) - 1
    return motion, *[pair for pair in solved if pair[0].intervals == count][-1]


def optimality(
    motion: tc.OptimalMotion, mesh: Collocation, multipliers: tuple[FloatArray, FloatArray]
) -> float:
    """Return the slope of the Lagrangian of the simulator, as a part of that of the cost.

    With K intervals and m winches, slopes are by the m (K - 1) rest lengths between the ends,
    winches first, and by the duration if it is free, in the scales of the program.
    """
    K, program, f = mesh.intervals, mesh.program, len(mesh.program.start)
    width, height = mesh._width, mesh._parts[0].height
    shares = np.append((np.arange(K)[:, None] + gauss_points(STAGES)).ravel() / K, 1.0)
    states, by = replayed_states(motion, shares)
    if program.duration is not None:
        by = by[..., :-1]
    x = mesh._packed(of_states(motion, states))
    last = x[K * width :]
    x = x[: K * width].reshape(K, width).T

    # The cost, and what each limit adds by its multiplier; the simulator obeys the motion itself.
    of_bounds, of_rows = multipliers
    of_end = of_rows[K * height :][: mesh._parts[1].height]
    of_rows = of_rows[: K * height].reshape(K, height).T
    labels = np.array(mesh._rows.labels)
    of_cost = np.where(labels[:, None] == "energy", of_rows, 0.0)
    of_rows = np.where(labels[:, None] == EQUATION, 0.0, of_rows)
    first = np.array(mesh._parts[0].slope(x))
    cost, total = (first + by_rows(mesh._parts[0], x, rows) for rows in (of_cost, of_rows))
    total += of_bounds[: K * width].reshape(K, width).T
    end = by_rows(mesh._parts[1], last[:, None], of_end[:, None])[:, 0]

    # Unknowns of the program by rest lengths and duration; those of powers are stationary already.
    count = by.shape[-1]
    lengths = np.zeros((program.input_range.shape[1], K + 1, count))
    inner = np.arange(lengths.shape[0] * (K - 1))
    lengths[inner // (K - 1), inner % (K - 1) + 1, inner] = 1.0
    at = by[:, :, :-1].reshape(2, f, K, STAGES + 1, count)
    value = {
        "places": at[0, :, :, 0], "velocities": at[1, :, :, 0],
        "begin": lengths[:, :-1], "end": lengths[:, 1:],
        "stage_places": np.concatenate([at[0, :, :, i + 1] for i in range(STAGES)]),
        "stage_velocities": np.concatenate([at[1, :, :, i + 1] for i in range(STAGES)]),
    }  # fmt: skip
    unknowns = np.zeros((width, K, count))
    for name, slopes in value.items():
        unknowns[mesh._places[name]] = slopes / mesh._scales[name]
    if program.duration is None:
        unknowns[mesh._places["step"], :, -1] = 1 / K / mesh._scales["step"]
    scales = [mesh._scales["places"], mesh._scales["velocities"]]
    final = np.concatenate([rows / scale for rows, scale in zip(by[:, :, -1], scales, strict=True)])
    units = np.full(count, program.unit)
    if program.duration is None:
        units[-1] = program.time
    left = np.einsum("wk,wkp->p", total, unknowns) + end @ final
    slope = np.einsum("wk,wkp->p", cost, unknowns)
    return float(np.linalg.norm(left * units) / np.linalg.norm(slope * units))


def by_rows(part: Any, x: FloatArray, multipliers: FloatArray) -> FloatArray:
    """Return slopes of the sum of rows times multipliers, by the unknowns of blocks."""
    row, column = part.entries
    slope = np.zeros_like(x)
    np.add.at(slope, column, np.array(part.jacobian(x)) * multipliers[row])
    return slope


def replayed_states(motion: tc.OptimalMotion, shares: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return places and velocities of the replay, (2, f, T), and their derivatives.

    By the rest lengths between the ends, winches first, and by the duration, which stretches all.
    """
    K, structure = len(motion.time) - 1, motion.model.structure

    def states(stretch: float) -> FloatArray:
        run = replay(motion, stretch, stretch * motion.duration / (K * POINTS))
        both = np.array([run.nodes, run.velocities]).swapaxes(1, 2).reshape(2, -1, K * POINTS + 1)
        k = np.minimum((shares * K).astype(int), K - 1)
        points = np.linspace(0.0, 1.0, POINTS + 1)
        weights = KroghInterpolator(points, np.eye(POINTS + 1))(shares * K - k)
        inside = both[:, structure.free_rows][:, :, k[:, None] * POINTS + np.arange(POINTS + 1)]
        return np.einsum("sftp,tp->sft", inside, weights)

    tangent = tc.sensitivity(replay(motion), ["rest_length"], shares * motion.duration)
    G, slopes = motion.actuation.matrix.toarray(), []
    for by in (tangent.nodes["rest_length"], tangent.velocities["rest_length"]):
        by = np.einsum("dnTsj,sw->ndTwj", by[..., 1:-1], G)
        slopes.append(by.reshape(-1, len(shares), G.shape[1] * (K - 1))[structure.free_rows])
    by_duration = (states(1 + STRETCH) - states(1 - STRETCH)) / (2 * STRETCH * motion.duration)
    return states(1.0), np.concatenate([np.array(slopes), by_duration[..., None]], axis=3)


def of_states(motion: tc.OptimalMotion, states: FloatArray) -> DiscreteMotion:
    """Return the motion of a replay, from its states at the instants of the program."""
    K, lengths = len(motion.time) - 1, motion.rest_length[motion.actuation.lead]
    at = states[:, :, :-1].reshape(2, -1, K, STAGES + 1)
    nodes, velocities = np.concatenate([at[..., 0], states[:, :, -1:]], axis=2)
    stages = at[..., 1:].swapaxes(2, 3)
    return DiscreteMotion(
        motion.duration, nodes, velocities, lengths[:, :-1], lengths[:, 1:], *stages
    )


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
