"""NMPC of larger structures with winches: time of a step against the sample time, and building.

Run: ``python -m tests.benchmarks.nmpc_large``. The six-bar ball (24 strings, 48 states) and a tower
of five stages (15 bars, 93 strings, 138 states), horizon 20, 0.02 s samples, linear strings of
1e3 N/m with winches that hold rest lengths. Each starts with a push and is pushed again in every
sample. A step is preparation and feedback, by the processor. The first of a start has no plan, and
is told apart, as "reset". "Found anew" is how many of the samples of a plan were linearized in a
later step; the cost of the closed loop is told beside that with all found anew
(``linearization_tolerance=0``), and with derivatives of CasADi in its virtual machine, as with laws
of one's own. Building is from linearizing the plant to the controller, by the clock. Memory is the
most that the process had so far. ``--stages`` takes other towers.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import nullcontext
from time import perf_counter, process_time

import numpy as np

import tenscontrol as tc
from tenscontrol.control import NMPC, ControlWarning, Status
from tests.benchmarks.command_line import options
from tests.benchmarks.mpc_step import peak
from tests.without_core import without_core

SAMPLE, HORIZON, STARTS, SAMPLES = 0.02, 20, 3, 20
STIFFNESS, FORCE_DENSITY, RATE = 1e3, 20.0, 1.0  # N/m, N/m, m/s

# Speeds of nodes at the start, and of each coordinate in each sample, m/s.
PUSH, SHAKEN = 0.3, 0.02

KINDS = "core", "core, all anew", "own law"


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, starts=STARTS, samples=SAMPLES, horizon=HORIZON, stages=(5,), kinds=3
    )
    structures = {"six-bar ball": tc.library.six_bar_ball(bar_length=1.0)}
    structures |= {f"tower, {count} stages": tc.prism_tower(count) for count in given.stages}
    print("                         step / sample time            found   cost /  building memory")
    print("                       median      p99  worst  reset    anew   all anew       s     MB")
    for name, structure in structures.items():
        print(f"{name}: {len(structure.bars)} bars, {len(structure.strings)} winches")
        loops = {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of a mode that no string reaches
            warnings.simplefilter("ignore", ControlWarning)
            for kind in KINDS[: given.kinds]:
                began, tolerance = perf_counter(), 0.0 if kind == "core, all anew" else None
                with without_core() if kind == "own law" else nullcontext():
                    nmpc = built(structure, given.horizon, linearization_tolerance=tolerance)
                loops[kind] = Loop(nmpc, perf_counter() - began)
        for seed in range(given.starts):
            for loop in loops.values():
                loop.run(seed, given.samples)
        exact = loops.get("core, all anew", next(iter(loops.values())))
        for kind, loop in loops.items():
            times = np.array(loop.times) / SAMPLE
            print(
                f"{kind:20s} {np.median(times):8.3f} {np.percentile(times, 99):8.3f} "
                f"{times.max():6.3f} {np.median(loop.first) / SAMPLE:6.3f} "
                f"{np.mean(loop.anew):7.1f} {loop.cost / exact.cost:10.6f} "
                f"{loop.building:7.1f} {peak():6.0f}"
            )


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

    def __init__(self, nmpc: NMPC, building: float) -> None:
        self.nmpc, self.building = nmpc, building
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
