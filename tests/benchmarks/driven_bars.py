"""How exact runs with driven bars are, by method.

    python -m tests.benchmarks.driven_bars

A rod that hangs from a hinge while its length changes is compared with its own equation, θ̈ = −2
L̇/L θ̇ − 3 g/(2 L) sin θ, integrated by SciPy. The free rod spins: ω L² is to be constant.
Last, structures whose bars all swell: how far the compiled core is from CasADi's virtual machine,
and processor time of the one over that of the other.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.integrate import solve_ivp

import tenscontrol as tc
from tests.benchmarks.command_line import options
from tests.known_structures import class2_tower
from tests.without_core import without_core

GRAVITY, SPIN = 9.81, 3.0
HOW = {
    "rk4": [{"step": step} for step in (0.02, 0.01, 0.005)],
    "dop853": [{"tolerance": tolerance} for tolerance in (1e-6, 1e-9, 1e-12)],
    "cvodes": [{"tolerance": tolerance} for tolerance in (1e-6, 1e-9)],
}

STRUCTURES = {
    "prism": tc.prism, "ball": tc.library.six_bar_ball, "tower": lambda: class2_tower(4)
}  # fmt: skip


def hoist(time):
    """Return the length of the hanging rod, m."""
    return 1.2 + 0.3 * np.sin(1.7 * time) ** 2


def swinging(duration):
    """Return the hanging rod and its true angle over time."""

    def slope(time, y):
        length, rate = hoist(time), 0.3 * 1.7 * np.sin(2 * 1.7 * time)
        return [y[1], -2 * rate / length * y[1] - 1.5 * GRAVITY / length * np.sin(y[0])]

    true = solve_ivp(
        slope, (0, duration), [0.7, 0], "DOP853", rtol=1e-13, atol=1e-14, dense_output=True
    )
    place = [[0, 1.2 * np.sin(0.7)], [0, -1.2 * np.cos(0.7)]]
    rod = tc.Structure(place, [(0, 1)], [], 2.0, fixed=[0])
    return tc.Model(rod, gravity=GRAVITY), true.sol


def compared(structure, duration):
    """Return differences of nodes and work between core and virtual machine, and ratio of times."""
    model = tc.Model(structure, tc.LinearStrings(stiffness=500.0, damping=1.0))
    times = np.linspace(0, duration, 9)
    share = 1 + 0.02 * np.sin(np.pi * times / duration) ** 2
    lengths = tc.Profile(times, structure.bar_length[:, None] * share, "cubic")

    def run():
        for _ in range(2):  # the first builds what is kept
            begin = time.process_time()
            motion = tc.simulate(
                model, duration, rest_length=0.97 * structure.string_length(), bar_length=lengths,
                tolerance=1e-9, limits=tc.HealthLimits(crossings=None),
            )  # fmt: skip
            spent = time.process_time() - begin
        return motion, spent

    with without_core():
        slow, long = run()
    fast, short = run()
    nodes = np.abs(fast.nodes - slow.nodes).max() / np.ptp(structure.nodes)
    work = np.abs(fast.struts.work - slow.struts.work).max() / np.abs(slow.struts.work).max()
    return nodes, work, short / long


def main(arguments=None):
    """Print errors of angle, work, length and spin for each method and setting."""
    given = options(__doc__, arguments, duration=2.0)
    model, true = swinging(given.duration)
    free = tc.Model(tc.Structure([[-0.5, 0.5], [0, 0], [0, 0]], [(0, 1)], [], 2.0))
    spin = np.cross([0, 0, SPIN], free.structure.nodes.T).T
    print("method  setting     steps  angle, rad   order    work, J  length, m   spin, part")
    for method, settings in HOW.items():
        before = None
        for how in settings:
            run = tc.simulate(
                model, given.duration, bar_length=lambda t: [hoist(t)], method=method, **how
            )
            angle = np.arctan2(run.nodes[0, 1], -run.nodes[1, 1])
            off = np.abs(angle - true(run.time)[0]).max()
            work = np.abs(run.struts.work[0] - run.energy + run.energy[0]).max()
            spun = tc.simulate(
                free, given.duration, velocities=spin, method=method, error="none", **how,
                bar_length=lambda t: [1 + 0.3 * (1 - np.cos(2 * t))],
            )  # fmt: skip
            b, rate = (array[:, 1] - array[:, 0] for array in (spun.nodes, spun.velocities))
            turning = np.cross(b.T, rate.T)[:, 2] / (b**2).sum(axis=0)
            turned = np.abs(turning * spun.struts.length[0] ** 2 / SPIN - 1).max()
            order = ""
            if method == "rk4" and before is not None:
                order = f"{np.log(before[1] / off) / np.log(run.steps / before[0]):.2f}"
            before = run.steps, off
            length = run.health.bar_length_error
            print(
                f"{method:7s} {next(iter(how.values())):7g} {run.steps:9d} {off:11.1e} {order:>7s} "
                f"{work:10.1e} {length:10.1e} {turned:12.1e}",
                flush=True,
            )
    print("structure       nodes, part  work, part  time of core over virtual machine")
    for name, structure in STRUCTURES.items():
        nodes, work, ratio = compared(structure(), given.duration)
        print(f"{name:15s} {nodes:11.1e} {work:11.1e} {ratio:10.2f}", flush=True)


if __name__ == "__main__":
    main()
