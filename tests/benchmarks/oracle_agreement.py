"""How near accelerations and λ are to the dense oracle on random structures, in all three forms.

Run: ``python -m tests.benchmarks.oracle_agreement``. Structures of class 1 to 6 in space and in the
plane. Printed are the largest differences, as parts of the largest acceleration and λ. Loops in C
are compiled for one structure in ten. Then the largest difference of nodes over motions of 2 s, in
which strings go slack and taut. With ``--library`` also those of the library, each by name.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.dynamics.machine_code import compiler
from tests.benchmarks.command_line import options
from tests.dynamics.test_any_motion import both
from tests.library.structures import STRUCTURES
from tests.oracle import node_acceleration
from tests.random_structures import any_motion_of, any_structure


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, structures=200, motions=12, library=False)
    count = given.structures
    worst = dict.fromkeys(("λ", "flat", "mapped", "loops"), 0.0)
    for seed in range(count):
        for name, error in differences(seed, seed % 10 == 0 and compiler() is not None).items():
            worst[name] = max(worst[name], error)
    print(f"largest relative difference on {count} random structures")
    for name, error in worst.items():
        print(f"{name:8s} {error:.1e}")
    far, switched = 0.0, 0
    for seed in range(given.motions):
        structure = any_structure(seed)
        found, expected, switches = both(structure, 0.3 * any_motion_of(structure, seed)[1])
        far, switched = max(far, np.abs(found - expected).max()), switched + switches
    print(f"motions  {far:.1e} m, {switched} switches")
    for name, make in STRUCTURES.items() if given.library else ():
        structure = make()
        found, expected, switches = both(structure, 0.3 * any_motion_of(structure, 0)[1])
        print(f"{name:24s} {np.abs(found - expected).max():.1e} m, {switches} switches", flush=True)


def differences(seed: int, compiles: bool) -> dict[str, float]:
    """Return the difference of λ, and of the accelerations in each form."""
    structure, random = any_structure(seed), np.random.default_rng(seed)
    N, V = any_motion_of(structure, seed)
    gamma, W = random.uniform(0, 10, len(structure.strings)), random.normal(size=N.shape)
    acceleration, lam = node_acceleration(structure, N, V, gamma, W)
    model = tc.Model(structure, external_force=W)
    free = structure.free
    found = np.array(model.bar_force_density(N[:, free], V[:, free], gamma)).ravel()
    errors = {"λ": off(found, lam)}
    expected = acceleration.T.ravel()[structure.free_rows]
    for form in ("flat", "mapped", "loops")[: 3 if compiles else 2]:
        slope = Evaluator(model.equation("force_density", form=form).slope)
        xdot = slope(pack_state(structure, N, V), gamma, np.zeros(0))[0]
        errors[form] = off(xdot[len(expected) :], expected)
    return errors


def off(found: np.ndarray, expected: np.ndarray) -> float:
    size = np.abs(expected).max(initial=0)
    return float(np.abs(found - expected).max(initial=0) / size) if size > 1e-12 else 0.0


if __name__ == "__main__":
    main()
