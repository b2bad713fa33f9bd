"""Memory, mappings and time of a process that makes one model after the other.

Run: ``python -m tests.benchmarks.many_models``. Each model has a geometry and a stiffness of its
own. It is linearized, moves alone and under MPC, with ``--nonlinear`` also under NMPC, and is
forgotten. Printed are, after each tenth of the models, the memory of the process, its
mappings, its open files, and the processor time of a model. For Linux, which tells these.
"""

from __future__ import annotations

import gc
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from time import process_time

import numpy as np

import tenscontrol as tc
from tests.benchmarks.command_line import options
from tests.benchmarks.growth import memory


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, count=1000, nonlinear=False)
    rng = np.random.default_rng(0)
    warnings.simplefilter("ignore", RuntimeWarning)  # of modes that no string reaches
    print(" models  memory MB  mappings  open files  ms a model")
    every = max(1, given.count // 10)
    began = process_time()
    for k in range(1, given.count + 1):
        used(rng, given.nonlinear)
        if k % every == 0:
            spent = 1e3 * (process_time() - began) / every
            gc.collect()
            mappings = len(Path("/proc/self/maps").read_text().splitlines())
            files = len(os.listdir("/proc/self/fd"))
            print(f"{k:7d} {memory('VmRSS') / 1e6:10.1f} {mappings:9d} {files:11d} {spent:11.1f}",
                  flush=True)  # fmt: skip
            began = process_time()


def used(rng: np.random.Generator, nonlinear: bool) -> None:
    """Make a model of random geometry, and use it in each way."""
    kind, size = int(rng.integers(3)), float(rng.uniform(0.5, 2.0))
    if kind == 0:
        structure = tc.prism(int(rng.integers(3, 6)), height=size)
    elif kind == 1:
        structure = tc.library.six_bar_ball(bar_length=size)
    else:
        structure = tc.prism_tower(int(rng.integers(2, 4)), height=size)
    rest = tc.prestress(structure, force_density=20.0)
    model = tc.Model(rest.structure, strings=tc.LinearStrings(float(rng.uniform(5e2, 2e3))))
    plant = tc.linearize(model, rest, input="rest_length")
    tc.simulate(model, 0.05, rest.nodes, rest_length=0.99 * plant.rest_length)
    for law in (tc.MPC, *([tc.NMPC] if nonlinear else [])):
        controller = law(plant, sample_time=0.02, horizon=5, winches=tc.Winches(rate=0.3))
        tc.simulate(model, 0.04, plant.nodes, controller=controller, error="none")


if __name__ == "__main__":
    main()
