"""What a scene pays for: instructions and inputs of the right-hand side, feature by feature.

Run: ``python -m tests.benchmarks.model_cost``. The counts do not depend on the machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics.evaluator import Evaluator
from tests.benchmarks.command_line import options
from tests.known_structures import d_bar


def main(arguments: Sequence[str] | None = None) -> None:
    calls = options(__doc__, arguments, calls=20_000).calls
    prism = tc.prism()
    plain, damped = tc.LinearStrings(100.0), tc.LinearStrings(100.0, damping=1.0)
    scenes = {
        "γ held": tc.Model(prism).dynamics,
        "γ held, load as an input": tc.Model(prism, external_force=True).dynamics,
        "rest length held": tc.Model(prism, plain).rest_length_dynamics,
        "rest length held, damped": tc.Model(prism, damped).rest_length_dynamics,
        "γ held, a string node more": tc.Model(with_string_node(prism)).dynamics,
    }
    shared = d_bar()
    in_space = tc.Structure(
        np.vstack([shared.nodes, np.zeros(4)]), shared.bars, shared.strings, shared.bar_mass
    )
    scenes["a D-bar in the plane, γ held"] = tc.Model(shared).dynamics
    scenes["the same in space, γ held"] = tc.Model(in_space).dynamics
    print("right-hand side of the prism      instructions  inputs")
    for label, function in scenes.items():
        print(f"{label:33s} {function.n_instructions():12d}  {function.n_in():6d}")

    function = scenes["γ held"]
    state, gamma = np.random.default_rng(0).normal(size=36), np.ones(9)
    evaluator = Evaluator(function)
    fast = seconds(lambda: evaluator(state, gamma), calls)
    slow = seconds(lambda: function(state, gamma), calls)
    print(
        f"\none call: {1e6 * fast:.2f} µs through the buffer, {slow / fast:.0f} times that without"
    )


def with_string_node(prism: tc.Structure) -> tc.Structure:
    """Return the prism with a point mass in the middle of its first string."""
    start, end = prism.strings[0]
    middle = 0.5 * (prism.nodes[:, start] + prism.nodes[:, end])
    strings = [[start, 6], [6, end], *prism.strings[1:].tolist()]
    nodes = np.column_stack([prism.nodes, middle])
    return tc.Structure(nodes, prism.bars, strings, prism.bar_mass, string_node_mass=0.01)


def seconds(call, calls: int) -> float:
    began = perf_counter()
    for _ in range(calls):
        call()
    return (perf_counter() - began) / calls


if __name__ == "__main__":
    main()
