"""Structures dropped on the ground: against an independent oracle, with orders and growth.

``python -m tests.benchmarks.ground_motions [--duration 2] [--rest 60]``: a six-bar ball dropped
from 0.3 m with 0.5 m/s sideways, a prism dropped on an edge with a spin, and a class-2 tower set
down on a slope. Each motion against rigid bodies, or multipliers, in NumPy, integrated by SciPy
with every switch located; how a change of the start by 1e-12 m grows; and the orders of the methods
with fixed steps through all impacts. Then what so many seconds of rest take on the ground, of six
prisms side by side, and on supports. Some minutes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tenscontrol.integrate.methods import METHODS
from tests.benchmarks.command_line import options
from tests.integrate.ground_scenes import SCENES, Scene, nudged, resting
from tests.integrate.stepping import fitted_order

STEPS = {"rk4": [7e-5, 5e-5, 3.5e-5, 2.5e-5]}
TOLERANCE = 1e-13


def against_the_oracle(name: str, scene: Scene, duration: float) -> None:
    """Print how far the motion is from the oracle's, and what a small change grows to."""
    times = np.linspace(0.0, duration, 5)
    integrator = METHODS["dop853"].integrator(scene.model.equation("rest_length"), TOLERANCE)
    exact, _ = scene.exact(times)
    nodes, work = scene.run(integrator, times)
    errors = np.abs(nodes - exact).max(axis=(0, 1))[1:]
    print(f"{name}: {work.switches} switches, {work.missed} not located")
    print("  time, s                      " + " ".join(f"{time:7.2f}" for time in times[1:]))
    print("  farthest node, m             " + " ".join(f"{error:7.1e}" for error in errors))
    others = [nudged(scene, 1e-12, seed).run(integrator, times)[0] for seed in range(4)]
    growth = max(np.abs(other - nodes).max(axis=(0, 1))[-1] for other in others) / 1e-12
    print(f"  a change of 1e-12 m at the start grows by {growth:.0f}")


def orders(name: str, scene: Scene, duration: float) -> None:
    """Print errors at the end by step, and the order fitted to them."""
    equation, times = scene.model.equation("rest_length"), np.array([0.0, duration])
    exact, _ = scene.run(METHODS["dop853"].integrator(equation, TOLERANCE), times)
    print(f"{name}, {duration:g} s: errors at the end by step")
    for method, steps in STEPS.items():
        integrators = [METHODS[method].integrator(equation, h) for h in steps]
        runs = [scene.run(integrator, times)[0] for integrator in integrators]
        errors = [np.abs(nodes - exact).max() for nodes in runs]
        text = " ".join(f"{error:.1e}" for error in errors)
        print(f"  {method:10s} order {fitted_order(steps, errors):4.1f}   {text}")


def rest(duration: float) -> None:
    """Print the steps and evaluations of rest on the ground and on supports."""
    print(f"18 nodes that settle and rest, {duration:g} s: steps and evaluations")
    for method, value, setting in (
        ("energy_momentum", 2e-2, "step"), ("energy_momentum", 1e-6, "tolerance"),
        ("dop853", 1e-6, "tolerance"), ("rk4", 5e-4, "step"),
    ):  # fmt: skip
        print(f"  {method:16s} {setting} {value:.0e}")
        for name, on_ground in (("ground", True), ("supports", False)):
            equation, state, lengths = resting(on_ground, 6)
            integrator = METHODS[method].integrator(equation, value, setting)
            work = integrator.advance(state, lengths, duration, 1).work
            print(f"    {name:8s} {work.steps:7d} {work.evaluations:8d}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print all tables."""
    given = options(__doc__, arguments, duration=2.0, rest=60.0)
    for name, make in SCENES.items():
        against_the_oracle(name, make(), given.duration)
    orders("ball", SCENES["ball"](), given.duration)
    rest(given.rest)


if __name__ == "__main__":
    main()
