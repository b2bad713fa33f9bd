"""NMPC of larger structures with winches: time of a step against the sample time, and building.

Run: ``python -m tests.benchmarks.nmpc_large``. The six-bar ball (24 strings, 48 states) and a tower
of five stages (15 bars, 93 strings, 138 states), horizon 20, 0.02 s samples, linear strings of
1e3 N/m with winches that hold rest lengths. Each starts with a push and is pushed again in every
sample. A step is preparation and feedback, by the processor. The first of a start has no plan, and
is told apart, as "reset". "Found anew" is how many of the samples of a plan were linearized in a
later step; the cost of the closed loop is told beside that with all found anew
(``linearization_tolerance=0``). Building is from linearizing the plant to the controller, by the
clock, with an empty cache of compiled libraries; of it, compiling is the processor time of the
compiler. Memory is the most that the process had so far. ``--stages`` takes other towers.
"""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter, process_time
from unittest import mock

import numpy as np

import tenscontrol as tc
from tenscontrol.control import NMPC, ControlWarning, Status
from tests.benchmarks.command_line import options
from tests.benchmarks.mpc_step import peak

SAMPLE, HORIZON, STARTS, SAMPLES = 0.02, 20, 3, 20
STIFFNESS, FORCE_DENSITY, RATE = 1e3, 20.0, 1.0  # N/m, N/m, m/s

# Speeds of nodes at the start, and of each coordinate in each sample, m/s.
PUSH, SHAKEN = 0.3, 0.02

KINDS = {
    "compiled": {"machine_code": True},
    "compiled, all anew": {"machine_code": True, "linearization_tolerance": 0.0},
    "no compiler": {},
}


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, starts=STARTS, samples=SAMPLES, horizon=HORIZON, stages=(5,), kinds=3
    )
    structures = {"six-bar ball": tc.library.six_bar_ball(bar_length=1.0)}
    structures |= {f"tower, {count} stages": tc.prism_tower(count) for count in given.stages}
    print(
        "                         step / sample time            found   cost /  building compiling "
        "memory"
    )
    print(
        "                       median      p99  worst  reset    anew   all anew       s         s "
        "    MB"
    )
    for name, structure in structures.items():
        print(f"{name}: {len(structure.bars)} bars, {len(structure.strings)} winches")
        loops = {}
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of a mode that no string reaches
            warnings.simplefilter("ignore", ControlWarning)
            with mock.patch.dict(os.environ, XDG_CACHE_HOME=str(Path(folder))):
                for kind in list(KINDS)[: given.kinds]:
                    began, compiling = perf_counter(), children_time()
                    nmpc = built(structure, given.horizon, **KINDS[kind])
                    spent = perf_counter() - began, children_time() - compiling
                    loops[kind] = Loop(nmpc, *spent)
        for seed in range(given.starts):
            for loop in loops.values():
                loop.run(seed, given.samples)
        exact = loops.get("compiled, all anew", next(iter(loops.values())))
        for kind, loop in loops.items():
            times = np.array(loop.times) / SAMPLE
            print(
                f"{kind:20s} {np.median(times):8.3f} {np.percentile(times, 99):8.3f} "
                f"{times.max():6.3f} {np.median(loop.first) / SAMPLE:6.3f} "
                f"{np.mean(loop.anew):7.1f} {loop.cost / exact.cost:10.6f} "
                f"{loop.building:7.1f} {loop.compiling:9.1f} {peak():6.0f}"
            )
        print(f"  derivatives: {loops['compiled'].nmpc.back_end}")


def children_time():
    """Return the processor time of processes that this one started and that have ended, s."""
    times = os.times()
    return times.children_user + times.children_system


def built(structure, horizon, **arguments):
    """Return an NMPC of a structure whose winches hold rest lengths."""
    model = tc.Model(structure, strings=tc.LinearStrings(STIFFNESS))
    at = tc.prestress(structure, force_density=FORCE_DENSITY)
    plant = tc.linearize(model, at, input="rest_length")
    return NMPC(
        plant, sample_time=SAMPLE, horizon=horizon, winches=tc.Winches(rate=RATE), **arguments
    )


class Loop:
    """An NMPC in closed loops with its prediction model, pushed in every sample."""

    def __init__(self, nmpc: NMPC, building: float, compiling: float) -> None:
        self.nmpc, self.building, self.compiling = nmpc, building, compiling
        self.times: list[float] = []
        self.first: list[float] = []  # of each start
        self.anew: list[int] = []
        self.cost = 0.0

    def run(self, seed: int, count: int) -> None:
        """Start from rest with a push."""
        nmpc, plant, rng = self.nmpc, self.nmpc.plant, np.random.default_rng(seed)
        Q, R, _ = nmpc.weights
        r = plant.degrees_of_freedom
        state = plant.measure(plant.nodes, PUSH * rng.normal(size=plant.nodes.shape))
        nmpc.reset()
        for k in range(count):
            measured = plant.to_nodes(state[:r]), plant.to_velocities(state[:r], state[r:])
            began = process_time()
            command = nmpc.command(k * SAMPLE, *measured)
            spent = process_time() - began
            assert command.status is Status.OK
            (self.times if k else self.first).append(spent)
            off = command.value - plant.equilibrium_input
            state, _ = nmpc.law.model.discretization.advance(state, command.value, command.value)
            self.cost += state @ Q @ state + off @ R @ off
            state[r:] += SHAKEN * rng.normal(size=r)
        self.anew += nmpc.statistics.linearized[1:].tolist()


if __name__ == "__main__":
    main()
