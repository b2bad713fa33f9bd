"""Laws on a few modes of a tower, with the whole nonlinear one in the loop.

Run: ``python -m tests.benchmarks.reduced_control``. Of prism towers of some stages: processor time
of ``linearize`` and of the 20 lowest ``modes``, and how far the frequencies
are from those of the dense way where that is quick. Then LQR and MPC on 20 modes of a tower of 100
stages that begins 2 cm off along its lowest mode: processor time of a command, and the rate at
which that mode decays in the simulation, over that of the linear loop as it is designed.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import process_time

import numpy as np

import tenscontrol as tc
from tests.benchmarks.command_line import options

STAGES = (10, 30, 100, 300, 1_000)
LOOP, DURATION, SAMPLE = 100, 60.0, 0.1
KEPT = 20
DENSE = 1_500  # coordinates up to which all modes are found as well


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, stages=STAGES, loop=LOOP, duration=DURATION)
    print("stages  members  linearize s  20 modes s  largest departure of a frequency")
    for stages in given.stages:
        began = process_time()
        plant = tower(stages)
        linearized = process_time()
        some = tc.modes(plant, count=KEPT)
        found = process_time()
        departure = "-"
        if plant.degrees_of_freedom <= DENSE:
            every = tc.modes(plant).frequency[:KEPT]
            departure = f"{np.abs(some.frequency / every - 1).max():.0e}"
        structure = plant.model.structure
        members = len(structure.bars) + len(structure.strings)
        print(f"{stages:6d} {members:8d} {linearized - began - rested(stages):12.2f} "
              f"{found - linearized:11.2f}  {departure}", flush=True)  # fmt: skip
    loops(given.loop, given.duration)


def rest(stages: int) -> tc.statics.Prestress:
    return tc.prestress(tc.prism_tower(stages), min_force_density=5.0)


def rested(stages: int) -> float:
    """Return the time that structure, prestress and model take alone, s."""
    began = process_time()
    tc.Model(rest(stages).structure, strings=tc.LinearStrings(stiffness=1e3))
    return process_time() - began


def tower(stages: int) -> tc.plant.LinearPlant:
    at = rest(stages)
    model = tc.Model(at.structure, strings=tc.LinearStrings(stiffness=1e3))
    return tc.linearize(model, at, input="rest_length")


def loops(stages: int, duration: float) -> None:
    """Print what LQR and MPC on a few modes take and do."""
    plant = tower(stages)
    small = tc.reduce(plant, KEPT)
    Q, R = tc.energy_weights(small, by_mode=True)
    R = 10 * R
    lqr = tc.LQR(small, Q, R, sample_time=SAMPLE)
    mpc = tc.MPC(small, horizon=10, sample_time=SAMPLE, Q=Q, R=R)
    w = 2 * np.pi * tc.modes(small).frequency[0]
    q = np.r_[0.02 / np.abs(small.basis[:, 0]).max(), np.zeros(KEPT - 1)]
    start = small.to_nodes(q)
    transition, by_input, _ = small.discretize(SAMPLE)
    state, linear = np.r_[q, 0 * q], []
    for _ in range(round(duration / SAMPLE)):
        linear.append(state)
        state = transition @ state - by_input @ (lqr.gain @ state)
    poles = np.log(lqr.poles) / SAMPLE
    near = poles[np.abs(np.abs(poles) - w).argmin()]
    print(f"\n{stages} stages, {KEPT} modes, lowest {w / 2 / np.pi:.4f} Hz, its closed-loop pole "
          f"{near.real:.4f} ± {abs(near.imag):.4f}i 1/s")  # fmt: skip
    print("law  command ms: median  99 %   decay simulated over designed   departure of the mode")
    for name, law in (("LQR", lqr), ("MPC", mpc)):
        run = tc.simulate(plant.model, duration, start, controller=law)
        at = np.searchsorted(run.time, SAMPLE * np.arange(len(linear)) - 1e-9)
        found = np.array([small.measure(run.nodes[:, :, i], run.velocities[:, :, i]) for i in at])
        rates = [decay(states, w) for states in (found, np.array(linear))]
        off = np.abs(found[:, 0] - np.array(linear)[:, 0]).max() / q[0]
        times = []
        for i in at[: 10 * (len(at) // 10) : max(1, len(at) // 200)]:
            began = process_time()
            law.command(0.0, run.nodes[:, :, i], run.velocities[:, :, i])
            times.append(1e3 * (process_time() - began))
        print(f"{name}  {np.median(times):18.2f} {np.quantile(times, 0.99):6.2f}"
              f"   {rates[0] / rates[1]:30.4f}   {off:.1e}", flush=True)  # fmt: skip


def decay(states: np.ndarray, frequency: float) -> float:
    """Return the rate at which the first mode decays, fitted to its amplitude, 1/s."""
    size = np.hypot(states[:, 0], states[:, KEPT] / frequency)
    return float(np.polyfit(SAMPLE * np.arange(len(size)), np.log(size), 1)[0])


if __name__ == "__main__":
    main()
