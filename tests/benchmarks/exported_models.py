"""Models that are written for MuJoCo: how far its motion is from ours, by its step.

Run: ``python -m tests.benchmarks.exported_models`` (MuJoCo comes with the extra ``bench``).
Structures of the library with strings of 1 kN/m, a tenth shorter than they are, under gravity;
those that nothing holds are thrown. Errors are the largest of a node at the end, against
``dop853`` at a tolerance of 1e-11. The order is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.peers import MuJoCo
from tests.benchmarks.command_line import options
from tests.exchange.structures import library, thrown

NAMES = (
    "six_bar_ball", "class2_tower", "arm", "geiger_dome", "d_bar", "d_bar_3d", "spine", "stedy_arm",
)  # fmt: skip
STEPS, DURATION = (2e-3, 1e-3, 5e-4), 0.2


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, names=NAMES, steps=STEPS, duration=DURATION)
    print("structure      loops " + "".join(f"{step:11g} s" for step in given.steps) + "   order")
    for name in given.names:
        structure = library()[name]
        model = tc.Model(structure, strings=tc.LinearStrings(1e3), gravity=9.81)
        case = tc.Scene(
            model,
            given.duration,
            velocities=thrown(structure),
            rest_length=0.9 * structure.string_length(),
        )
        run = tc.simulate(
            model, case.duration, velocities=case.velocities, rest_length=case.input_value,
            method="dop853", tolerance=1e-11, output_step=case.duration,
        )  # fmt: skip
        errors, end = [], np.array([case.duration])
        for step in given.steps:
            found = MuJoCo("rk4").prepare(case, step, end)().nodes
            errors.append(np.abs(found[..., -1] - run.nodes[..., -1]).max())
        loops = tc.exchange.to_mujoco(model, rest_length=case.input_value).count("<connect")
        order = np.polyfit(np.log(given.steps), np.log(errors), 1)[0]
        row = "".join(f"{error:13.1e}" for error in errors)
        print(f"{name:14s} {loops:5d} {row} {order:7.1f}")


if __name__ == "__main__":
    main()
