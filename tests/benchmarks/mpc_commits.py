"""Commands of linear and nonlinear MPC by two installations of the package, in turns.

Run: ``python -m tests.benchmarks.mpc_commits --old PYTHON``, with the interpreter of the other
installation: another commit, or one without the core. Each case has a process in either, and they
take turns: the same closed loops with their own prediction, pushed at the start and in every
sample. Each loop is repeated, and of each sample the shortest time counts. Printed are the times
of the processor here, and their ratios to those there, by percentiles over samples: of
``prepare()``, of the command after it, and of both. "Making" is the time from the plant to the
controller. Costs are those of all loops, here over there.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence

import numpy as np

from tests.benchmarks.command_line import options

PERCENTILES = (5, 25, 50, 75, 95, 99)
STRUCTURES = {
    "prism": "tc.prism()",
    "ball": "tc.library.six_bar_ball(bar_length=1.0)",
    "tower": "tc.prism_tower(5)",
}

# Runs in either installation: names that both have.
LOOPS = """
import json, sys, warnings
from time import process_time
import numpy as np, tenscontrol as tc
from scipy.linalg import expm

structure, winches, kind, horizon, machine_code = json.loads(sys.argv[1])
warnings.simplefilter("ignore")
rest = tc.prestress(eval(structure), force_density=20.0)
model = tc.Model(rest.structure, strings=tc.LinearStrings(1e3))
if winches:
    plant = tc.linearize(model, rest, input="rest_length")
    limits = {"winches": tc.Winches(rate=0.3)}
else:
    plant = tc.linearize(model, rest)
    limits = {"max_force_density": 1.1 * float(plant.force_density.max()), "R": 1e-3}
if kind == "NMPC":
    limits["machine_code"] = machine_code
began = process_time()
mpc = getattr(tc, kind)(plant, horizon=horizon, sample_time=0.02, **limits)
made = process_time() - began
r, inputs = plant.degrees_of_freedom, plant.B.shape[1]
held = expm(0.02 * np.block([[plant.A, plant.B], [np.zeros((inputs, 2 * r + inputs))]]))[:2 * r]
size = 0.003 if winches else 0.01

def follows(z, u):
    if kind == "NMPC":
        return mpc.law.model.discretization.advance(z, u, u)[0]
    return held @ np.concatenate([z, u - plant.equilibrium_input])

print(json.dumps([made, 2 * r, inputs]), flush=True)
for line in sys.stdin:
    seed, samples = json.loads(line)
    rng, cost, times = np.random.default_rng(seed), 0.0, []
    z = size * rng.normal(size=2 * r)
    mpc.reset()
    for k in range(samples):
        motion = plant.to_nodes(z[:r]), plant.to_velocities(z[:r], z[r:])
        began = process_time()
        if kind == "NMPC":
            mpc.prepare()
        prepared = process_time()
        u = mpc.command(k * 0.02, *motion).value
        times.append((prepared - began, process_time() - prepared))
        off = u - plant.equilibrium_input
        cost += z @ z + off @ off
        z = follows(z, u)
        z[r:] += 0.1 * size * rng.normal(size=r)
    print(json.dumps([cost, times[1:]]), flush=True)
"""


class Installation:
    """The loops of a case in one installation, one after the other on demand."""

    def __init__(self, python: str, case: Sequence[object]) -> None:
        self._process = subprocess.Popen(
            [python, "-c", LOOPS, json.dumps(case)], cwd="/", text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        self.making, self.states, self.inputs = self._answer()
        self.costs: dict[int, float] = {}
        self.times: dict[int, np.ndarray] = {}

    def _answer(self) -> list:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"the loop ended with exit status {self._process.wait()}")
        return json.loads(line)

    def run(self, seed: int, samples: int) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([seed, samples]) + "\n")
        self._process.stdin.flush()
        cost, times = self._answer()
        self.costs[seed] = cost
        self.times[seed] = np.minimum(times, self.times.get(seed, np.inf))

    def end(self) -> None:
        self._process.communicate()


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, old=sys.executable, kinds=("MPC", "NMPC"),
        structures=tuple(STRUCTURES), inputs=("forces", "winches"), horizons=(10, 20, 40),
        starts=3, samples=40, repeats=4, interpreted=False,
    )  # fmt: skip
    for kind in given.kinds:
        for name in given.structures:
            for held in given.inputs:
                for horizon in given.horizons:
                    compiled = not given.interpreted
                    case = STRUCTURES[name], held == "winches", kind, horizon, compiled
                    compare(f"{kind}, {name}, {held}, {horizon} samples", case, given)


def compare(label: str, case: Sequence[object], given) -> None:
    """Print the times of a case here, and over those of the other installation."""
    here, there = both = Installation(sys.executable, case), Installation(given.old, case)
    for turn in range(given.repeats):
        for seed in range(given.starts):
            for installation in both if turn % 2 else both[::-1]:
                installation.run(seed, given.samples)
    for installation in both:
        installation.end()
    cost, other_cost = (sum(installation.costs.values()) for installation in both)
    print(
        f"{label}: {here.states} states, {here.inputs} inputs; "
        f"cost {cost / other_cost:.6f}; "
        f"making {here.making:.2f} s, {here.making / there.making:.2f}"
    )
    found, other = (1e3 * np.vstack([*installation.times.values()]) for installation in both)
    rows = {"command": (found[:, 1], other[:, 1])}
    if case[2] == "NMPC":
        rows["prepare()"] = found[:, 0], other[:, 0]
        rows["both"] = found.sum(axis=1), other.sum(axis=1)
    for row, columns in rows.items():
        ours, theirs = (np.percentile(column, PERCENTILES) for column in columns)
        ratios = zip(PERCENTILES, ours / theirs, strict=True)
        print(f"  {row:10s} median {ours[2]:8.3f} ms; over the other's at "
              + ", ".join(f"{p} % {ratio:.2f}" for p, ratio in ratios), flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
