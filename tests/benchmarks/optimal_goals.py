"""Fastest motions of structures of the library to random goals: planned, or said why not.

Run: ``python -m tests.benchmarks.optimal_goals``, some minutes; ``--structures prism --goals 1`` is
one row, and larger structures take longer: ``--structures six_bar_ball``. A goal is a place for one
node, a tenth of the size of the structure away in a random direction, with strings of 500 N/m and
2 N s/m and winches of half the size a second. Each plan is replayed by the simulator. The columns:
status or error; duration, s, and what the path through equilibria takes; intervals and iterations
of the last mesh; by how much the replay misses the goal, as a part of the size; its speed at the
end, as a part of the largest; least γ, N/m; processor time, s; by how much the last mesh changed
the duration, in %, and with ``--finer 10`` a grid so many times finer, or the finest below that has
a motion, and how many times finer that is. The last lines count.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from time import process_time

import numpy as np

import tenscontrol as tc
from tenscontrol.optimize.optimal_motion import OptimalMotionWarning
from tenscontrol.status import Status
from tests.benchmarks.command_line import options
from tests.benchmarks.optimal_motions import finer_gain

STRUCTURES = ("prism", "arm", "class2_tower", "snelson_x", "kite")
WAY, RATE, LEVEL, STIFFNESS, DAMPING = 0.1, 0.5, 20.0, 500.0, 2.0


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, structures=STRUCTURES, goals=4, seed=0, finer=1)
    counts = {"planned": 0, "said why not": 0}
    print(f"{'structure':14s} {'status':24s} {'s':>8s} {'path':>8s} {'mesh':>5s} {'iter':>5s} "
          f"{'missed':>8s} {'speed':>8s} {'least γ':>8s} {'cpu':>6s} {'last %':>7s} "
          f"{'finer %':>7s} {'times':>5s}")  # fmt: skip
    for name in given.structures:
        random = np.random.default_rng(given.seed)
        for _ in range(given.goals):
            is_planned, text = one_goal(name, random, given.finer)
            counts["planned" if is_planned else "said why not"] += 1
            print(f"{name:14s} {text}", flush=True)
    for name, count in counts.items():
        print(f"{name}: {count}")


def one_goal(name: str, random: np.random.Generator, finer: int = 1) -> tuple[bool, str]:
    """Return whether a motion to a random goal was planned, and its row."""
    structure = getattr(tc.library, name)()
    size = float(np.ptp(structure.nodes, axis=1).max())
    strings = tc.LinearStrings(stiffness=STIFFNESS, damping=DAMPING)
    model, rest = tc.Model(structure, strings), tc.prestress(structure, min_force_density=LEVEL)
    node = int(random.choice(structure.free))
    way = random.normal(size=structure.dimension)
    place = structure.nodes[:, [node]] + WAY * size * (way / np.linalg.norm(way))[:, None]
    winches = tc.Winches(rate=RATE * size)
    began = process_time()
    try:
        goal = tc.shape_target(
            model, tc.NodesAt([node], place), start=structure.nodes, place="centre",
            min_force_density=LEVEL / 4, force_density=float(rest.force_density[0]),
        )  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OptimalMotionWarning)
            motion = tc.optimal_motion(model, rest, goal, winches=winches, min_force_density=1.0)
    except ValueError as error:
        return False, f"{type(error).__name__}: {str(error)[:160]}"
    seconds = process_time() - began
    try:
        path = tc.shape_path(model, rest, goal, winches=winches, place="centre").time[-1]
    except ValueError:
        path = np.nan
    last = motion.meshes[-1]
    if motion.run is None:
        return False, f"{motion.status}: {motion.message} ({seconds:.0f} s)"
    gain = np.nan, 1.0
    if finer > 1:
        how = {"winches": winches, "min_force_density": 1.0}
        gain = finer_gain(motion, (model, rest, goal), how, finer)
    fastest = np.linalg.norm(motion.run.velocities, axis=0).max()
    return motion.status is Status.OK, (
        f"{motion.status:24s} {motion.duration:8.4f} {path:8.4f} {last.intervals:5d} "
        f"{last.iterations:5d} {motion.goal_miss / size:8.1e} {motion.end_speed / fastest:8.1e} "
        f"{motion.least_force_density:8.3g} {seconds:6.1f} "
        f"{100 * motion.cost_change:7.3f} {gain[0]:7.3f} {gain[1]:5.1f}"
    )


if __name__ == "__main__":
    main()
