"""A step of NMPC at two states of the source tree: whole, its feedback, and without a compiler.

Run: ``python -m tests.benchmarks.nmpc_commits --old COMMIT``, from the root of the repository, for
a comparison with the tree as it is; ``--new`` names another one. Both are folders with the package,
or commits, which are checked out for the run. Each has a process of its own, and they take turns:
one closed loop of the problem of ``nmpc_step``, from the same start. Times are those of the
processor; the command is timed where the caller prepared before. Printed are medians, their ratios,
and the largest relative difference of the closed-loop costs.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median

from tests.benchmarks.command_line import options

STARTS = 8
KINDS = {"compiled": True, "interpreted": False}

# Runs in either tree: only what both have.
LOOPS = """
import json, sys
from time import process_time
import numpy as np, tenscontrol as tc
from tenscontrol.demo import tour as demo

prism = tc.prism()
plant = tc.linearize(tc.Model(prism), tc.prestress(prism, demo.TOP_FORCE_DENSITY))
nmpc = tc.NMPC(plant, horizon=20, sample_time=demo.SAMPLE, max_force_density=33.0,
               machine_code=json.loads(sys.argv[1]))
Q, R, _ = nmpc.weights
print(nmpc.back_end, flush=True)
for line in sys.stdin:
    rng = np.random.default_rng(int(line))
    off = 0.04 * rng.normal(size=(3, 6)), 0.2 * rng.normal(size=(3, 6))
    z, cost, times = plant.measure(prism.nodes + off[0], off[1]), 0.0, []
    nmpc.reset()
    for k in range(25):
        motion = plant.to_nodes(z[:9]), plant.to_velocities(z[:9], z[9:])
        began = process_time()
        nmpc.prepare()
        prepared = process_time()
        u = nmpc.command(k * demo.SAMPLE, *motion).value
        times.append((process_time() - began, process_time() - prepared))
        off = u - plant.equilibrium_input
        cost += z @ Q @ z + off @ R @ off
        z = np.array(nmpc.sampled(z, u)).ravel()
    feedback = nmpc.statistics.feedback_time[1:].tolist()
    print(json.dumps([cost, times[1:], feedback]), flush=True)
"""


class Tree:
    """The loops at one state of the tree, one after the other on demand."""

    def __init__(self, folder: Path, machine_code: bool) -> None:
        environment = os.environ | {"PYTHONPATH": str(folder)}
        command = [sys.executable, "-c", LOOPS, "true" if machine_code else "false"]
        self._process = subprocess.Popen(
            command, cwd=folder, env=environment, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        self.back_end = self._answer()
        self.costs: list[float] = []
        self.whole: list[float] = []
        self.feedback: list[float] = []  # of the whole command, the program being prepared
        self.told: list[float] = []  # by the statistics of NMPC, by the clock

    def _answer(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"the loop ended with exit status {self._process.wait()}")
        return line.strip()

    def run(self, seed: int) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{seed}\n")
        self._process.stdin.flush()
        cost, times, told = json.loads(self._answer())
        self.costs.append(cost)
        self.whole += [each[0] for each in times]
        self.feedback += [each[1] for each in times]
        self.told += told

    def end(self) -> None:
        self._process.communicate()


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, old="766c567", new=".", starts=STARTS, back_ends=tuple(KINDS)
    )
    with checked_out(given.old) as old, checked_out(given.new) as new:
        for kind in given.back_ends:
            trees = [Tree(folder, KINDS[kind]) for folder in (old, new)]
            for seed in range(given.starts):
                for tree in trees if seed % 2 else reversed(trees):
                    tree.run(seed)
            for tree in trees:
                tree.end()
            report(kind, *trees)


def report(kind: str, old: Tree, new: Tree) -> None:
    print(f"{kind}: {old.back_end} and {new.back_end}, {len(old.whole)} samples each")
    print(f"  {'median of':36s}{'old':>8s}    {'new':>8s}         new / old")
    for name, what in (
        ("whole step, processor", "whole"),
        ("command after prepare(), processor", "feedback"),
        ("feedback by the statistics, clock", "told"),
    ):
        before, after = (1e3 * median(getattr(tree, what)) for tree in (old, new))
        print(f"  {name:36s}{before:8.3f} ms {after:8.3f} ms {after / before:14.3f}")
    worst = max(abs(b / a - 1) for a, b in zip(old.costs, new.costs, strict=True))
    print(f"  closed-loop costs agree to {worst:.1e}")


@contextmanager
def checked_out(where: str) -> Iterator[Path]:
    """Yield a folder with the package: the given one, or a checkout of a commit."""
    if (Path(where) / "tenscontrol").is_dir():
        yield Path(where).resolve()
        return
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "tree"
        git = ["git", "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(folder), where], check=True)
        try:
            yield folder
        finally:
            subprocess.run([*git, "remove", "--force", str(folder)], check=True)


if __name__ == "__main__":
    main()
