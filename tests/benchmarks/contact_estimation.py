"""Errors of filters on the ground, with a known contact law and without, and their covariance.

Run: ``python -m tests.benchmarks.contact_estimation``. The six-bar ball, Snelson's X and a class-2
tower are dropped from 10 cm, moving sideways and turning, with other noise and turns for each seed.
Errors are means over all nodes from 0.2 s on: of a filter that has the ground in its model, and of
one that takes it for an unknown load. Normalized errors are squares over their covariance, by
degree of freedom, of motions disturbed as the filter supposes; innovations likewise. They are 1
where the covariance is right.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.benchmarks.command_line import options
from tests.estimation.ground_scenes import SCENES, dropped, errors, normalized_errors

LATE = slice(20, None)


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, seeds=10, structures=len(SCENES))
    print("          contact known      unknown load       normalized")
    print("           mm      mm/s       mm      mm/s    errors  innovations")
    for name in list(SCENES)[: given.structures]:
        rows, told = [], []
        for seed in range(given.seeds):
            run = dropped(name, seed, 0.6)
            known = errors(name, "sharp", run, seed)[0]
            load = errors(name, "none", run, seed, load=True)[0]
            rows.append([part[LATE].mean() for each in (known, load) for part in each])
            told.append(normalized_errors(name, seed, 30))
        means = 1e3 * np.mean(rows, axis=0)
        shares = np.mean(told, axis=0)
        print(
            f"{name:6s}{means[0]:8.2f} {means[1]:9.1f} {means[2]:8.2f} {means[3]:9.1f}"
            f"{shares[0]:10.3f} {shares[1]:9.3f}"
        )
    print(f"{given.seeds} seeds")


if __name__ == "__main__":
    main()
