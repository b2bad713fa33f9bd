"""Towers of prisms whose strings go slack by hundreds in a step, beside plain NumPy and JAX.

``python -m tests.benchmarks.towers [--stages 100 1000]``. Every seventh string of a tower of 24
members a stage is wound in by 3 %, and it moves for 0.1 s. Three tables a tower:

- The cheapest run of each program that reaches an error, m, at the end: of ours a second
  ``tc.simulate`` with its defaults and its tolerance, of the others their integration alone,
  compiled before.
- Switches that each method locates, and that it says it missed, over the converged count; its error
  and the estimate of it, m, beside that of RK4 in NumPy, which locates none, in the same step; and
  the orders that are fitted to both. ``--switches`` prints this table alone.
- Processor time and the largest memory of a process of its own that makes the tower and runs it
  once, at the settings of the first table for 1e-6 m, and of one that only makes the tower.

``--only default JAX`` prints the first and the last table, of the programs whose names contain one
of these; ``--finer 2`` says by how much steps of peers differ.

Not told: what JAX takes to compile in the first table; the third tells it. Needs the extra
``bench``; Linux alone tells the memory.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Sequence

import numpy as np

import tenscontrol as tc
from tenscontrol.simulation import AccuracyWarning
from tenscontrol.tables import aligned
from tests.benchmarks.cheapest import (
    FINER_STEP,
    Program,
    Row,
    farthest,
    grid,
    ours,
    reported,
    tolerances,
)
from tests.benchmarks.command_line import options
from tests.benchmarks.rk4_peers import is_missing, jax_rk4, numpy_rk4

DURATION = 0.1  # s

# What a process of its own runs: a program by its name, and its setting.
_ALONE = r"""
import json, re, sys, time
from pathlib import Path
from tests.benchmarks.towers import programs, tower
stages, name, setting = json.loads(sys.argv[1])
if setting is None:
    tower(stages)
else:
    {program.name: program for program in programs(stages)}[name].prepare(setting)()
status = Path("/proc/self/status")  # getrusage tells the largest of the parent
size = re.search(r"VmHWM:\s+(\d+) kB", status.read_text())[1] if status.exists() else "nan"
print(json.dumps([time.process_time(), 1024 * float(size)]))
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    given = options(
        __doc__, arguments, stages=(100, 1000), errors=(1e-3, 1e-6), repeats=5,
        steps=(4e-3, 1e-3, 2.5e-4), tolerances=(1e-4, 1e-6, 1e-8), longest=30.0, switches=False,
        only=("",), finer=FINER_STEP,
    )  # fmt: skip
    for stages in given.stages:
        case = tower(stages)
        exact, coarse = (
            simulated(case, method="dop853", tolerance=tolerance) for tolerance in (1e-10, 1e-7)
        )
        members = len(case.structure.bars) + len(case.structure.strings)
        print(f"\ntower of {stages} stages, {members} members, {exact.work.switches} switches; at "
              f"a thousand times the tolerance {coarse.work.switches}", flush=True)  # fmt: skip
        judge = farthest(exact.nodes[:, :, -1:])
        if given.only == ("",):
            print_switches(case, exact, given.steps, given.tolerances, judge)
        if not given.switches:
            some = [
                program
                for program in programs(stages, given.finer)
                if any(text in program.name for text in given.only)
            ]
            rows = reported(some, judge, given.errors, given.repeats, given.longest)
            print_memory(stages, [row for row in rows if row.error == min(given.errors)])


def tower(stages: int) -> tc.Scene:
    """Return a tower with every seventh string wound in."""
    structure = tc.prism_tower(stages)
    rest = tc.prestress(structure, min_force_density=5.0)
    model = tc.Model(structure, strings=tc.LinearStrings(100 * rest.force_density.max()))
    lengths = tc.to_rest_length(model, structure.nodes, rest.force_density).rest_length.copy()
    lengths[::7] *= 0.97
    return tc.Scene(model, DURATION, rest_length=lengths, name=f"tower of {stages} stages")


def programs(stages: int, finer: float = FINER_STEP) -> list[Program]:
    """Return ours and the peers, whose steps differ by a factor."""
    case, times = tower(stages), np.array([DURATION])
    steps = grid(0.01, 1e-6, finer)
    found = ours(lambda: case, times, tolerances(), output_step=DURATION)
    found.append(numpy_rk4(case, times, steps))
    return found if is_missing("jax") else [*found, jax_rk4(case, times, steps)]


def simulated(case: tc.Scene, **how: object) -> tc.Trajectory:
    """Return a run of which the end alone is kept."""
    with warnings.catch_warnings(action="ignore", category=AccuracyWarning):
        return tc.simulate(
            case.model, case.duration, rest_length=case.input_value, output_step=case.duration,
            **how,
        )  # fmt: skip


def print_switches(
    case: tc.Scene,
    exact: tc.Trajectory,
    steps: Sequence[float],
    tolerances: Sequence[float],
    judge: Callable[[np.ndarray], float],
) -> None:
    """Print what methods find and miss, and their errors beside those of naive steps."""
    count = max(1, exact.work.switches)
    size = float(np.ptp(case.model.structure.nodes, axis=1).max())  # an estimate is a part of it
    naive = numpy_rk4(case, np.array([DURATION]), steps)
    settings = [{"method": "rk4", "step": step} for step in steps]
    settings += [{"tolerance": tolerance} for tolerance in tolerances]
    rows, errors = [], []
    for setting in settings:
        run = simulated(case, **setting)
        found, missed = run.work.switches, run.work.missed
        cells = [judge(run.nodes[:, :, -1:]), size * float(run.error[-1])]
        if "step" in setting:
            cells.append(judge(naive.prepare(setting["step"])()))
            errors.append((cells[0], cells[2]))
        label = ", ".join(map(str, setting.values()))
        rows.append([label, str(found), str(missed), f"{(found + missed) / count:.3f}",
                     *(f"{x:.1e}" for x in cells), *[""] * (3 - len(cells))])  # fmt: skip
    print(aligned(["", "found", "missed", "of all", "error", "estimate", "naive rk4"], rows))
    if len(steps) > 1:
        located, unlocated = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        print(f"fitted order: {located:.2f}, naive {unlocated:.2f}", flush=True)


def print_memory(stages: int, rows: Sequence[Row]) -> None:
    """Print the processor time and the largest memory of a process for each row."""
    table = []
    asked = [("the tower alone", None)]
    asked += [(row.name, row.setting) for row in rows if row.setting > 0]
    for name, setting in asked:
        finished = subprocess.run(
            [sys.executable, "-c", _ALONE, json.dumps([stages, name, setting])],
            check=True, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": "."},
        )  # fmt: skip
        seconds, size = json.loads(finished.stdout.splitlines()[-1])
        table.append([name, f"{seconds:.2f}", f"{1e-9 * size:.2f}"])
    print(aligned(["a process of its own", "s", "GB"], table))


if __name__ == "__main__":
    main()
