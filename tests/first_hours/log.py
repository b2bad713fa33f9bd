"""The log of the robot: a shell of other strings than its builder believes, seen by a camera.

``python -m tests.first_hours.log`` writes it beside this file.
"""

from pathlib import Path

import numpy as np

import tenscontrol as tc

FILE = Path(__file__).with_name("robot.csv")
STIFFNESS, DAMPING = 1180.0, 4.0  # N/m and N s/m


def log():
    """Return 25 readings of half a second, in which twelve strings are wound."""
    shell = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
    model = tc.Model(shell, strings=tc.LinearStrings(STIFFNESS, damping=DAMPING))
    cut = np.full(24, 0.5)
    wound = cut - 0.06 * (np.arange(24) % 2 == 0)
    run = tc.simulate(
        model,
        0.5,
        nodes=tc.equilibrium(model, rest_length=cut).structure.nodes,
        rest_length=tc.Profile([0.0, 0.1], np.column_stack([cut, wound])),
        output_step=0.02,
    )
    camera = tc.Sensors(structure=shell, node_position=0.0005)
    return tc.Log.of_run(run, camera, 0.02 * np.arange(1, 26), seed=0)


if __name__ == "__main__":
    print(log().save(FILE))
