"""What one member costs in one evaluation where bars share nodes: towers of 1 to 1,000 stages.

Run: ``python -m tests.benchmarks.coupled_cost``. Class-2 towers of prisms that share their nodes:
three chains of bars, each one block. A figure is the nanoseconds per bar or string of the fastest
turn, in the forms that a compiler and its absence lead to; beside it, what that is of the least.
The same for prisms beside one another in the same number: class 1, closed forms.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter, process_time

import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import Evaluator
from tests.benchmarks.command_line import options
from tests.known_structures import class2_tower

STAGES = (1, 10, 100, 1_000)
TURNS = 15
MEMBERS = 100_000  # evaluated in one turn, so that a clock can measure it


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, stages=STAGES, turns=TURNS, members=MEMBERS)
    for label, structure in (("class 2", class2_tower), ("class 1", tc.prism_tower)):
        print(f"\n{label}, rest lengths held: ns per member and evaluation, build")
        columns: dict[str, list[float]] = {"flat": [], "mapped": [], "loops": []}
        for stages in given.stages:
            tower = structure(stages)
            members = len(tower.bars) + len(tower.strings)
            line = f"{stages:6d} stages {members:6d} members"
            for form, costs in columns.items():
                if form == "flat" and members > 2_000:
                    continue
                cost, built = member_cost(tower, form, given.turns, given.members)
                costs.append(cost)
                line += f"   {form} {cost:7.1f} ({built:6.2f} s)"
            print(line, flush=True)
        for form, costs in columns.items():
            print(f"largest over smallest, {form}: {max(costs) / min(costs):.2f}")


def member_cost(tower: tc.Structure, form: str, turns: int, evaluated: int) -> tuple[float, float]:
    """Return nanoseconds per member of one evaluation of a form, and seconds to build it."""
    members = len(tower.bars) + len(tower.strings)
    model = tc.Model(tower, tc.LinearStrings(100.0))
    began = perf_counter()
    slope = model.equation("rest_length", form=form).slope
    built = perf_counter() - began
    velocities = np.random.default_rng(0).normal(size=tower.nodes.shape)
    x = pack_state(tower, tower.nodes, velocities)
    at = x, 0.9 * tower.string_length(), np.ones(len(tower.strings))
    count = max(1, evaluated // members)
    evaluate = Evaluator(slope.map(count))
    evaluate(*(np.tile(part[:, None], count) if count > 1 else part for part in at))
    times = []
    for _ in range(turns):
        began = process_time()  # of this program alone
        evaluate._run()
        times.append(process_time() - began)
    return 1e9 * min(times) / count / members, built


if __name__ == "__main__":
    main()
