"""Time of one MPC step: along the stages and by OSQP, updated in place and built anew.

Run: ``python -m tests.benchmarks.mpc_step``. Prints ratios measured in one run, of processor time;
the prism is moved to a new height (no bound active) and recovers from a push (bounds active).
Then MPC by winches on a tower of prisms, along the stages: processor time and growth of memory of
its making, and times of commands: the first, those until 0.2 s after pushes that make
limits active, and the others.
"""

from __future__ import annotations

import resource
from collections.abc import Sequence
from time import process_time

import numpy as np

import tenscontrol as tc
from tenscontrol.demo import tour as demo
from tests.benchmarks.command_line import options

SOLVERS = ("stages", "osqp")
LENGTHS = (10, 20, 40, 80)
LIMIT = 34.0  # N/m, little above the prestress, so that bounds are met


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__,
        arguments,
        duration=4.0,
        lengths=LENGTHS,
        tower=5,
        horizon=20,
        push=0.002,
    )
    scenes = {
        "ramp": scene(push=0.01, target=0.85, duration=given.duration),
        "push": scene(push=0.1, target=1.0, duration=given.duration),
    }
    print("MPC on the prism, 18 states, 9 inputs, 0.02 s samples; median of a whole command")
    for name, (plant, reference, measured) in scenes.items():
        print(f"\n{name}: horizon 20, {len(measured)} samples")
        rows = {}
        for solver in SOLVERS:
            for rebuilt in (False, True):
                mpc = controller(plant, reference, solver, 20)
                times = run(mpc, measured, rebuilt)
                rows[f"{solver}, {'built anew' if rebuilt else 'updated'}"] = times
                bounds = sum(touches(mpc, moment) for moment in measured) if not rebuilt else None
                if bounds is not None and solver == "stages":
                    print(f"  samples with a bound active: {bounds}")
        best = min(np.median(times) for times in rows.values())
        print("  program                  median   / best  p99 / median")
        for label, times in rows.items():
            median, late = np.median(times), np.percentile(times, 99)
            print(f"  {label:24s} {1e3 * median:6.3f} ms {median / best:6.2f} {late / median:9.2f}")
        updated = min(np.median(times) for label, times in rows.items() if "updated" in label)
        anew = min(np.median(times) for label, times in rows.items() if "anew" in label)
        print(f"  fastest updated / fastest built anew: {updated / anew:.3f}")
    print("\nOSQP against stages, both updated, push")
    print("  horizon  inputs  OSQP / stages")
    plant, reference, measured = scenes["push"]
    for length in given.lengths:
        medians = [
            np.median(run(controller(plant, reference, solver, length), measured, rebuilt=False))
            for solver in SOLVERS
        ]
        print(f"  {length:7d}  {9 * length:6d}  {medians[1] / medians[0]:8.0f}")
    on_tower(given.tower, given.horizon, given.push)


def on_tower(stages, horizon, push):
    """Print what MPC on a tower takes along the stages."""
    rest = tc.prestress(tc.prism_tower(stages), min_force_density=5.0)
    model = tc.Model(rest.structure, strings=tc.LinearStrings(stiffness=1e3))
    plant = tc.linearize(model, rest, input="rest_length")
    states, inputs = plant.B.shape
    print(f"\ntower of {stages} stages, {states} states, {inputs} inputs, horizon {horizon}")
    print("  build s     MB    first ms  pushed ms: median  99 %  changes  "
          "others ms: median  99 %")  # fmt: skip
    before, began = peak(), process_time()
    mpc = tc.MPC(
        plant, horizon=horizon, sample_time=demo.SAMPLE, winches=tc.Winches(rate=0.3),
        solver="stages",
    )  # fmt: skip
    took, memory = process_time() - began, peak() - before
    moments, times = recovery(plant, mpc, push), []
    mpc.reset()
    for moment in moments:
        began = process_time()
        mpc.command(*moment)
        times.append(1e3 * (process_time() - began))
    work = mpc.statistics.iterations
    after = (np.arange(len(times)) % 30 < 10) & (np.arange(len(times)) > 0)
    hurried, calm = np.array(times)[after], np.array(times)[~after][1:]
    print(f"  {took:7.2f} {memory:6.0f} {times[0]:11.1f} {np.median(hurried):18.2f} "
          f"{np.quantile(hurried, 0.99):5.2f} {work[after].max():8d} {np.median(calm):18.2f} "
          f"{np.quantile(calm, 0.99):5.2f}", flush=True)  # fmt: skip


def peak():
    """Return the peak of memory so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def recovery(plant, mpc, push):
    """Return times and measurements of a linear loop that is pushed every 30 samples."""
    transition, by_input, _ = plant.discretize(demo.SAMPLE)
    r, rng, state, found = plant.degrees_of_freedom, np.random.default_rng(0), 0.0, []
    for k in range(120):
        if k % 30 == 0:
            state = state + push * rng.normal(size=2 * r)
        nodes = plant.to_nodes(state[:r])
        speeds = (plant.basis @ state[r:]).reshape(nodes.shape, order="F")
        found.append((demo.SAMPLE * k, nodes, speeds))
        off = mpc.command(*found[-1]).value - plant.equilibrium_input
        state = transition @ state + by_input @ off
    return found


def scene(push, target, duration):
    """Return a plant, a reference, and the motion of a closed loop at its samples."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(demo.STIFFNESS))
    shape = demo.prism_of_height(prism, target)
    plant = tc.linearize(model, tc.prestress(shape, demo.TOP_FORCE_DENSITY))
    start = tc.linearize(model, tc.prestress(prism, demo.TOP_FORCE_DENSITY))
    reference = demo.ramp(prism, 1.0, target, 2.0)
    nodes = start.to_nodes(push * np.random.default_rng(0).normal(size=9))
    mpc = controller(plant, reference, "stages", 20)
    loop = tc.simulate(model, duration, nodes, controller=mpc, step=2e-3)
    at = np.searchsorted(loop.time, loop.control.time - 1e-9)
    return (
        plant,
        reference,
        [(loop.time[i], loop.nodes[:, :, i].copy(), loop.velocities[:, :, i].copy()) for i in at],
    )


def controller(plant, reference, solver, length):
    return tc.MPC(
        plant,
        horizon=length,
        sample_time=demo.SAMPLE,
        max_force_density=LIMIT,
        R=1e-3,
        reference=reference,
        solver=solver,
    )


def run(mpc, measured, rebuilt):
    """Return the time of each command, s, of a second pass over the samples."""
    for moment in measured if not rebuilt else ():
        mpc.command(*moment)
    mpc.reset()
    times = []
    for moment in measured:
        began = process_time()
        if rebuilt:
            mpc._program = mpc.law.program()
        command = mpc.command(*moment)
        times.append(process_time() - began)
        if command.status != "ok":
            raise SystemExit(f"a program was not solved: {command.status}")
    return np.array(times)


def touches(mpc, moment):
    """Return whether a bound is active in the plan at this sample."""
    mpc.command(*moment)
    return bool((mpc.plan <= 1e-6).any() or (mpc.plan >= LIMIT - 1e-6).any())


if __name__ == "__main__":
    main()
