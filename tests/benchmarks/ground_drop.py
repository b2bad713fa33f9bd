"""Error against run time of a ball that drops on the ground, beside MuJoCo with its own contact.

``python -m tests.benchmarks.ground_drop [--duration 1.0] [--settings 7]``: a six-bar
ball dropped from 0.3 m with 0.5 m/s sideways on ground of 5e3 N/m, 0.3 s/m and friction 0.5. The
laws differ: MuJoCo's damping is linear and its friction viscous below that of Coulomb; its
stiffness is that of the ground, by a negative solref at the least impedance. So each is measured
against a converged motion of its own law: ours against ``converged_motion``, MuJoCo against itself
in steps 8 times finer than its finest. How far apart the laws are is printed. Needs the
extra ``bench``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.peers import MuJoCo
from tests.benchmarks.command_line import options

STEPS = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1e-4, 5e-5)
SETTINGS = {
    "rk4": STEPS[1:],
    "dop853": tuple(10.0**-k for k in range(3, 10)),
    "energy_momentum": tuple(10.0**-k for k in range(2, 5)),
}
METHODS = ("euler", "implicitfast", "rk4")


def drop(duration: float, height: float = 0.3) -> tc.Scene:
    """The ball above the ground; its strings are not damped, as MuJoCo's would push when slack."""
    ball = tc.library.six_bar_ball()
    strings = tc.LinearStrings(500.0)
    rest = tc.prestress(ball, force_density=30.0)
    lengths = tc.to_rest_length(tc.Model(ball, strings=strings), ball.nodes, rest.force_density)
    below = float(ball.nodes[2].min()) - height
    ground = tc.Ground(5e3, damping=0.3, friction=0.5, slip_speed=0.01, height=below)
    velocities = np.zeros_like(ball.nodes)
    velocities[0] = 0.5
    return tc.Scene(
        tc.Model(ball, strings=strings, gravity=9.81, ground=ground),
        duration,
        velocities=velocities,
        rest_length=lengths.rest_length,
        name="six-bar ball on the ground",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    given = options(__doc__, arguments, duration=1.0, settings=len(STEPS), repeats=5)
    case = drop(given.duration)
    settings = {name: values[: given.settings] for name, values in SETTINGS.items()}
    peers = [MuJoCo(kind, settings=STEPS[: given.settings]) for kind in METHODS]
    outputs = max(2, round(50 * given.duration))
    reference = tc.accuracy.converged_motion(case, outputs)
    found = tc.work_precision(
        case, list(settings), settings, peers, reference=reference, repeats=given.repeats,
        progress=True,
    )  # fmt: skip
    print(found.table())
    if found.own_laws:
        finest = MuJoCo("rk4").prepare(case, min(peers[-1].settings), reference.time)().nodes
        apart = np.linalg.norm(finest - reference.nodes, axis=0).max(axis=0)
        print(f"the laws are {apart[-1]:.2g} m apart at the end, by what they lose in impacts")


if __name__ == "__main__":
    main()
