"""Processor time and memory of each stage from structure to control, from 12 members to 240,000.

Run: ``python -m tests.benchmarks.growth``. Towers of prisms, 24 members a stage. A routine is left
out of larger towers where smaller ones predict more time or memory than the budget. The second
table compares sparse routines of statics and modes with whole decompositions: the largest
difference, and the time of both.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np

import tenscontrol as tc
from tests.benchmarks.command_line import options

STAGES = (1, 3, 10, 30, 100, 300, 1000, 3000, 10_000)
WHOLE = (10, 20, 40)
COUNT = 20


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, stages=STAGES, whole=WHOLE, seconds=60.0, gigabytes=4.0, last="MPC step"
    )
    towers = [lambda stages=stages: tc.prism_tower(stages) for stages in given.stages]
    found = tc.accuracy.growth(
        towers, seconds=given.seconds, memory=1e9 * given.gigabytes, last=given.last
    )
    print(found.table())
    print("\nsparse ways against whole decompositions: largest difference, processor s of both")
    print(f"{'stages':>6s}  {'what':24s} {'difference':>10s} {'sparse':>8s} {'whole':>8s}")
    for stages in given.whole:
        for what, difference, *times in compared(stages):
            print(f"{stages:6d}  {what:24s} {difference:10.1e} {times[0]:8.2f} {times[1]:8.2f}")


def compared(stages: int) -> list[tuple[str, float, float, float]]:
    """Differences, relative to the largest entry, and times of the sparse and the whole way."""
    tower = tc.prism_tower(stages)
    rest = tc.prestress(tower, 10.0)
    k = 100.0 * float(rest.force_density.max())
    plant = tc.linearize(tc.Model(tower, strings=tc.LinearStrings(k)), rest, input="rest_length")

    def counts() -> list[float]:
        found = tc.statics.Prestress(*(getattr(rest, name) for name in FIELDS)).stability
        states = rest.self_stress_states, rest.mechanisms, found.stress_matrix_rank_defect
        return [*states, found.is_stable, found.is_super_stable]

    asked: dict[str, Callable[[], Any]] = {
        "prestress at a level": lambda: tc.prestress(tower, 10.0).force_density,
        "prestress, all taut": lambda: tc.prestress(tower, min_force_density=3).force_density,
        "bars of a given γ": lambda: tc.prestress(tower, rest.force_density).bar_force_density,
        "counts and verdicts": counts,
        f"{COUNT} lowest stiffnesses": lambda: rest.tangent_stiffness(k, COUNT).eigenvalues,
    }
    rows = []
    for what, ask in asked.items():
        answers, times = zip(*(timed(ask, few) for few in (-1, 10**9)), strict=True)
        rows.append((what, relative(*answers), *times))
    start = process_time()
    some = tc.modes(plant, COUNT).frequency
    middle = process_time()
    every = tc.modes(plant).frequency[:COUNT]
    rows.append((f"{COUNT} lowest modes", relative(some, every), middle - start,
                 process_time() - middle))  # fmt: skip
    return rows


FIELDS = (
    "structure", "force_density", "bar_force_density", "external_force", "residual",
    "self_stress_states", "mechanisms",
)  # fmt: skip


def timed(ask: Callable[[], Any], few: int) -> tuple[np.ndarray, float]:
    """The answer with matrices of no more entries decomposed whole, and its processor time."""
    module = sys.modules["tenscontrol.statics.equilibrium_matrix"]
    with patch.object(module, "_FEW", few):
        start = process_time()
        answer = np.asarray(ask(), dtype=float)
        return answer, process_time() - start


def relative(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(one - other).max() / np.abs(other).max())


if __name__ == "__main__":
    main()
