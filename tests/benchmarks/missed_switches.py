"""Does a run say how many switches it missed? A tower in which hundreds fall into one step.

Run: ``python -m tests.benchmarks.missed_switches``. A tower of 100 stages, every seventh string
wound in by 3 %, for 0.1 s. For each method and step: switches at which a step ended, those that are
counted as missed, both over the converged count (``dop853`` at two tolerances), the error, and its
estimate, as parts of the size.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

import tenscontrol as tc
from tests.benchmarks.command_line import options

METHODS = ("rk4",)
STEPS = (4e-3, 1e-3, 2.5e-4)


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, stages=100, methods=METHODS, steps=STEPS)
    tower = tc.prism_tower(given.stages)
    rest = tc.prestress(tower, min_force_density=5.0)
    model = tc.Model(tower, strings=tc.LinearStrings(100 * rest.force_density.max()))
    lengths = tc.to_rest_length(model, tower.nodes, rest.force_density).rest_length.copy()
    lengths[::7] *= 0.97
    size = np.ptp(tower.nodes, axis=1).max()

    def run(**how) -> tc.simulation.Trajectory:
        with warnings.catch_warnings(action="ignore", category=tc.simulation.AccuracyWarning):
            return tc.simulate(model, 0.1, rest_length=lengths, output_step=0.05, **how)

    exact, coarse = (run(method="dop853", tolerance=tolerance) for tolerance in (1e-10, 1e-7))
    true = exact.work.switches
    print(f"converged: {true} switches; at a thousand times the tolerance {coarse.work.switches}")
    print(
        f"{'method':8s} {'step':>8s} {'found':>6s} {'missed':>7s} {'of all':>7s}  error, estimate"
    )
    for method in given.methods:
        for step in given.steps:
            each = run(method=method, step=step)
            found, missed = each.work.switches, each.work.missed
            off = np.linalg.norm(each.nodes[:, :, -1] - exact.nodes[:, :, -1], axis=0).max() / size
            print(
                f"{method:8s} {step:8g} {found:6d} {missed:7d} {(found + missed) / true:7.3f}  "
                f"{off:.1e}, {each.error[-1]:.1e}",
                flush=True,
            )


if __name__ == "__main__":
    main()
