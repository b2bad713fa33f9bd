"""What a run pays to see bars that cross, as part of the call, and the crossings of a prism.

Processor time, the least of several calls, with ``HealthLimits(crossings=0)`` and ``None`` in turn.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from time import process_time

import numpy as np

import tenscontrol as tc
from tenscontrol.simulation import BarCrossingWarning
from tests.benchmarks.command_line import options


def scenes(stages):
    """Return model, duration and inputs by name."""
    strings = tc.LinearStrings(stiffness=100.0)
    ball, tower, prism = tc.library.six_bar_ball(), tc.prism_tower(stages), tc.prism()
    rest = tc.prestress(ball, force_density=20.0).force_density
    held = tc.to_rest_length(tc.Model(ball, strings=strings), ball.nodes, rest).rest_length
    crossing = tc.Model(prism, strings=tc.LinearStrings(stiffness=200.0, damping=0.5))
    wound = prism.string_length() * np.repeat([1.6, 0.8], [6, 3])
    return {
        "ball, 5 s": (tc.Model(ball, strings=strings), 5.0, 0.9 * held, {}),
        f"tower of {stages}, 0.1 s": (
            tc.Model(tower, strings=strings), 0.1, 0.9 * tower.string_length(), {},
        ),
        "prism, 1.5 s": (crossing, 1.5, wound, {}),
        "prism, ends alone": (crossing, 1.5, wound, {"output_step": 1.5}),
    }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, stages=100, repeats=7)
    for name, (model, duration, lengths, more) in scenes(given.stages).items():
        least = {0: np.inf, None: np.inf}
        for _ in range(given.repeats + 1):  # the first builds the model
            for count in least:
                limits, began = tc.HealthLimits(crossings=count), process_time()
                with warnings.catch_warnings(action="ignore", category=BarCrossingWarning):
                    run = tc.simulate(model, duration, rest_length=lengths, limits=limits, **more)
                least[count] = min(least[count], process_time() - began)
                if count == 0:
                    seen = run
        found = seen.health.crossings
        first = f", first at {found[0].time:.4f} s" if found else ""
        print(
            f"{name:22}{1e3 * least[None]:9.2f} ms without, ratio {least[0] / least[None]:5.3f}, "
            f"{len(found)} crossings{first}"
        )


if __name__ == "__main__":
    main()
