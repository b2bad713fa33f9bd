"""What a second simulation of the same model saves: time outside the steps, first and second call.

Run: ``python -m tests.benchmarks.repeated_runs``. A prism of 9 bars and 27 strings moves for 0.1 s,
then again from another start; a state is kept every millisecond.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from time import perf_counter
from unittest.mock import patch

import numpy as np

import tenscontrol as tc
from tenscontrol.integrate.methods import METHODS
from tests.benchmarks.command_line import options

RUNS = {
    "rk4": {"method": "rk4", "step": 1e-3},
    "dop853": {"method": "dop853", "tolerance": 1e-6},
    "cvodes": {"method": "cvodes", "tolerance": 1e-6},
    "energy_momentum": {"method": "energy_momentum", "step": 2e-3},
}


def main(arguments: Sequence[str] | None = None) -> None:
    repeats = options(__doc__, arguments, repeats=3).repeats
    print("0.1 s of a prism with 36 members   outside the steps      second/first   in the steps")
    for name, settings in RUNS.items():
        run("warm-up", settings)
        runs = [run(name, settings) for _ in range(repeats)]
        first, second, steps = np.median(runs, axis=0)
        print(
            f"{name:32s} {1e3 * first:9.1f} {1e3 * second:7.2f} ms {second / first:14.3f} "
            f"{1e3 * steps:12.2f} ms"
        )


def run(name: str, settings: dict[str, object]) -> tuple[float, float, float]:
    """Return the time outside the steps of a first and a second call, and that of the steps, s."""
    prism = tc.prism(9)
    model = tc.Model(prism, strings=tc.LinearStrings(1000.0))
    lengths = 0.98 * prism.string_length(prism.nodes)
    outside = []
    for push in (0.0, 0.1):
        velocities = push * np.ones((3, 18))
        with timed_steps() as steps:
            began = perf_counter()
            tc.simulate(
                model, 0.1, rest_length=lengths, velocities=velocities, output_step=1e-3, **settings
            )
            outside.append(perf_counter() - began - sum(steps))
    return outside[0], outside[1], sum(steps)


@contextmanager
def timed_steps() -> Iterator[list[float]]:
    """Yield the times that integrators take for their steps, s, one a span."""
    taken: list[float] = []

    def timed(advance):
        def wrapped(*arguments, **keywords):
            began = perf_counter()
            try:
                return advance(*arguments, **keywords)
            finally:
                taken.append(perf_counter() - began)

        return wrapped

    owners = {
        next(c for c in method.make.__mro__ if "advance" in vars(c)) for method in METHODS.values()
    }
    patches = [patch.object(owner, "advance", timed(owner.advance)) for owner in owners]
    for each in patches:
        each.start()
    try:
        yield taken
    finally:
        for each in patches:
            each.stop()


if __name__ == "__main__":
    main()
