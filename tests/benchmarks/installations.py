"""Simulations and commands of MPC by two installations of the package, in turns.

Run: ``python -m tests.benchmarks.installations --old PYTHON``, with the interpreter of the other
installation: another commit, or one without the core. Each case has a process in either, and they
take turns. Printed are the times of the processor here, and their ratios to those there.

Of simulations, the shortest of several calls counts, the first of all left out, and it is told how
far the nodes are from one another in the end. Of MPC and NMPC, the same closed loops with their own
prediction are pushed at the start and in every sample. Each loop is repeated, the shortest time of
each sample counts, and ratios are those of percentiles over samples: of ``prepare()``, of the
command after it, and of both. "Making" is the time from the plant to the controller. Costs are
those of all loops, here over there.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from itertools import product

import numpy as np

from tests.benchmarks.command_line import options

PERCENTILES = (5, 25, 50, 75, 95, 99)
STRUCTURES = {
    "prism": "tc.prism()",
    "ball": "tc.library.six_bar_ball(bar_length=1.0)",
    "tower": "tc.prism_tower(5)",
}

# Run in either installation: names that both have.
THROWN = "thrown, 5.0, velocities=spin, rest_length=loose"
SHORT = "thrown, 1.0, velocities=spin, rest_length=loose, error='none'"
SIMULATIONS = {
    "ball, thrown for 5 s": f"{THROWN}, error='none'",
    "with its estimate": THROWN,
    "tolerance 1e-4": f"{THROWN}, error='none', tolerance=1e-4",
    "tolerance 1e-9": f"{THROWN}, error='none', tolerance=1e-9",
    "rk4, 2.5 ms": f"{THROWN}, error='none', method='rk4', step=2.5e-3",
    "energy_momentum, 5 ms, 1 s": f"{SHORT}, method='energy_momentum', step=5e-3",
    "cvodes, 1 s": f"{SHORT}, method='cvodes'",
    "ball, dropped for 1 s": "dropped, 1.0, raised, rest_length=loose, error='none'",
    "tower, 10 stages, 0.1 s": "tower, 0.1, rest_length=wound, error='none'",
    "prism under LQR, 1 s": "prism, 1.0, velocities=pushed, controller=lqr, error='none'",
}
CALLS = """
import json, sys, warnings
from time import process_time
import numpy as np, tenscontrol as tc

warnings.simplefilter("ignore")
rng, strings = np.random.default_rng(0), tc.LinearStrings(500.0)
ball = tc.library.six_bar_ball(bar_length=1.0)
thrown = tc.Model(ball, strings=strings, gravity=9.81)
loose = tc.to_rest_length(thrown, ball.nodes, tc.prestress(ball, 0.5).force_density).rest_length
dropped = tc.Model(ball, strings=strings, gravity=9.81, ground=tc.Ground(1e4, damping=50.0))
raised = ball.nodes - [[0.0], [0.0], [ball.nodes[2].min() - 0.2]]
turning = np.cross([0.8, 1.6, 2.4], ball.nodes.T).T
spin = turning - turning.mean(axis=1, keepdims=True) + [[1.0], [0.0], [4.0]]
tall = tc.prism_tower(10)
tower = tc.Model(tall, strings=strings)
wound = tc.to_rest_length(tower, tall.nodes, tc.prestress(tall, 20.0).force_density).rest_length
wound = wound * np.where(np.arange(len(wound)) % 7, 1.0, 0.97)
prism = tc.Model(tc.prism(), strings=strings)
plant = tc.linearize(prism, tc.prestress(tc.prism(), 20.0), input="rest_length")
lqr = tc.LQR(plant, sample_time=0.02)
pushed = plant.to_velocities(np.zeros(9), 0.1 * rng.normal(size=9))
print(json.dumps(["", 0, 0]), flush=True)
for line in sys.stdin:
    began = process_time()
    run = eval(f"tc.simulate({json.loads(line)})")
    spent = process_time() - began
    print(json.dumps([spent, run.nodes[:, :, -1].tolist()]), flush=True)
"""
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
    """A program that runs in an installation, and answers what it is asked."""

    def __init__(self, python: str, program: str, *given: object) -> None:
        self._process = subprocess.Popen(
            [python, "-c", program, json.dumps(given)], cwd="/", text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        self.first = self._answer()

    def _answer(self) -> list:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"the program ended with exit status {self._process.wait()}")
        return json.loads(line)

    def ask(self, question: object) -> list:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(question) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def end(self) -> None:
        self._process.communicate()


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, old=sys.executable, kinds=("simulate", "MPC", "NMPC"),
        simulations=tuple(SIMULATIONS), structures=tuple(STRUCTURES),
        inputs=("forces", "winches"), horizons=(10, 20, 40), starts=3, samples=40, repeats=4,
        interpreted=False,
    )  # fmt: skip
    if "simulate" in given.kinds:
        simulations(given)
    for kind, name, held, horizon in product(
        [kind for kind in given.kinds if kind != "simulate"],
        given.structures, given.inputs, given.horizons,
    ):  # fmt: skip
        case = STRUCTURES[name], held == "winches", kind, horizon, not given.interpreted
        compare(f"{kind}, {name}, {held}, {horizon} samples", case, given)


def simulations(given) -> None:
    """Print what calls of ``simulate`` take here, and over those of the other installation."""
    both = [Installation(python, CALLS) for python in (sys.executable, given.old)]
    print("simulation                        ms  over the other's  farthest node, m")
    for name in given.simulations:
        times: list[list[float]] = [[], []]
        ends = [np.zeros(0)] * 2
        for turn in range(given.repeats + 1):
            for which in (0, 1) if turn % 2 else (1, 0):
                spent, end = both[which].ask(SIMULATIONS[name])
                times[which].append(spent)
                ends[which] = np.array(end)
        here, there = (1e3 * min(spent[1:]) for spent in times)
        apart = np.abs(ends[0] - ends[1]).max()
        print(f"{name:28s} {here:8.2f} {here / there:17.2f} {apart:17.1e}", flush=True)
    for installation in both:
        installation.end()


def compare(label: str, case: Sequence[object], given) -> None:
    """Print the times of a controller here, and over those of the other installation."""
    both = [Installation(python, LOOPS, *case) for python in (sys.executable, given.old)]
    costs = np.zeros((2, given.starts))
    times = np.full((2, given.starts, given.samples - 1, 2), np.inf)
    for turn, seed in product(range(given.repeats), range(given.starts)):
        for which in (0, 1) if turn % 2 else (1, 0):
            costs[which, seed], spent = both[which].ask([seed, given.samples])
            times[which, seed] = np.minimum(times[which, seed], spent)
    for installation in both:
        installation.end()
    (making, states, inputs), (other, *_) = (installation.first for installation in both)
    here, there = costs.sum(axis=1)
    print(
        f"{label}: {states} states, {inputs} inputs; cost {here / there:.6f}; "
        f"making {making:.2f} s, {making / other:.2f}"
    )
    prepared, commands = np.moveaxis(1e3 * times.reshape(2, -1, 2), 2, 0)
    rows = {"command": commands}
    if case[2] == "NMPC":
        rows |= {"prepare()": prepared, "both": prepared + commands}
    for row, columns in rows.items():
        ours, theirs = (np.percentile(column, PERCENTILES) for column in columns)
        ratios = zip(PERCENTILES, ours / theirs, strict=True)
        print(f"  {row:10s} median {ours[2]:8.3f} ms; over the other's at "
              + ", ".join(f"{p} % {ratio:.2f}" for p, ratio in ratios), flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
