"""Error against what a call costs on a thrown ball, beside JAX, Diffrax, MuJoCo and SciPy.

``python -m tests.benchmarks.thrown_ball``: the six-bar ball of 24 strings, thrown with a spin of
3 rad/s, falls freely for 5 s while its strings go slack and taut hundreds of times. Of our methods
the processor time of a second ``tc.simulate`` is told, whole, with its checks and its trajectory;
of the others that of their integration, compiled beforehand. The tables are their time over that of
our fastest, at errors that both reach; errors are against a motion by two methods that agree. Peers
have their best settings: between two runs, times are interpolated, and lucky errors count for them.
Needs the extra ``bench``, and JAX and Diffrax for theirs (``pip install jax diffrax``).
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.peers import MuJoCo, Peer, SciPy
from tests.benchmarks.command_line import options
from tests.benchmarks.jax_peers import Diffrax, JaxRK4

SPIN, STIFFNESS, FORCE_DENSITY = 3.0, 500.0, 0.5  # rad/s, N/m, N/m
SETTINGS = {
    "rk4": (0.01, 0.005, 0.0025, 0.001),
    "dop853": tuple(10.0**-k for k in range(5, 13)),
}


def example(duration: float = 5.0) -> tc.Scene:
    """The ball as it is thrown."""
    ball = tc.library.six_bar_ball(bar_length=1.0)
    model = tc.Model(ball, strings=tc.LinearStrings(STIFFNESS), gravity=9.81)
    rest = tc.prestress(ball, FORCE_DENSITY)
    lengths = tc.to_rest_length(model, ball.nodes, rest.force_density).rest_length
    axis = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    from_centre = ball.nodes - ball.nodes.mean(axis=1, keepdims=True)
    velocities = np.cross(SPIN * axis, from_centre.T).T + np.array([[1.0], [0.0], [4.0]])
    return tc.Scene(
        model, duration, velocities=velocities, rest_length=lengths,
        name="six-bar ball, thrown",
    )  # fmt: skip


def peers(settings: int) -> list[Peer]:
    """The peers that are installed."""
    steps = tuple(0.1 / k for k in (20, 30, 40, 50, 64, 80, 128, 200, 320, 640, 1280, 2560, 5120))
    tolerances = tuple(10.0**-k for k in range(5, 13))
    found: list[Peer] = []
    if importlib.util.find_spec("jax") is not None:
        found.append(JaxRK4(steps[:settings]))
    if importlib.util.find_spec("diffrax") is not None:
        methods = ("Dopri5", "Tsit5", "Dopri8")
        found += [Diffrax(method, tolerances[:settings]) for method in methods]
    mujoco = (1e-2, 5e-3, 2.5e-3, 1e-3, 5e-4, 2.5e-4)
    found += [MuJoCo(kind, settings=mujoco[:settings]) for kind in ("rk4", "implicitfast")]
    return [*found, SciPy("DOP853", tolerances[:settings])]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    given = options(__doc__, arguments, duration=5.0, settings=13, repeats=15, all=False)
    case = example(given.duration)
    settings = {name: values[: given.settings] for name, values in SETTINGS.items()}
    found = tc.work_precision(
        case, list(settings), settings, peers(given.settings), repeats=given.repeats,
        outputs=max(1, round(10 * given.duration)), progress=True,
    )  # fmt: skip
    print(case.name)
    print(found.summary())
    if given.all:
        print(found.table())
    print(found.ratios([1e-3, 1e-5, 1e-7]).table())


if __name__ == "__main__":
    main()
