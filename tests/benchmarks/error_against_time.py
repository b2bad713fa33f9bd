"""Error against what a call costs, on single motions, beside JAX, Diffrax, MuJoCo and SciPy.

``python -m tests.benchmarks.error_against_time [--scenes switching]``. Six-bar balls of 24 strings
are thrown and fall for 5 s: in one strings go slack and taut hundreds of times, in one they stay
taut, in one they are stiff. A prism moves with slack strings, massless or cut into four segments
with mass (example 1 of the paper). A ball drops on the ground.

Of our calls the processor time of a second ``tc.simulate`` is told, whole, as it is typed first:
with its defaults, its tolerance, its checks, its trajectory of 1,001 states and its estimate of the
error; in a second row without the estimate. Of the others that of their integration alone, compiled
before, with 50 outputs. Errors are the largest distance of a node at these, against a motion by two
methods that agree. MuJoCo has a law of its own on the ground: there its errors are against its own
motion in steps 8 times finer than its finest. Needs the extra ``bench``.

Not told: what a first call takes (see ``overhead``), what compiling takes (JAX 1 s, Diffrax 1 s),
and that the others locate no switch, estimate no error and check nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.peers import CasADiCVODES, MuJoCo, SciPy
from tests.benchmarks import rk4_peers
from tests.benchmarks.cheapest import Program, farthest, grid, ours, peer, reported, tolerances
from tests.benchmarks.command_line import options

OUTPUTS = 50


@dataclass(frozen=True)
class Motion:
    """A scene by its duration, s, with the coarsest and the finest step of peers, s."""

    make: Callable[[float], tc.Scene]
    duration: float
    coarsest: float
    finest: float
    is_class_1: bool = True


def thrown(duration: float, spin: float, stiffness: float, force_density: float) -> tc.Scene:
    """A six-bar ball that is thrown up, turning: rad/s, N/m and N/m."""
    ball = tc.library.six_bar_ball(bar_length=1.0)
    model = tc.Model(ball, strings=tc.LinearStrings(stiffness), gravity=9.81)
    rest = tc.prestress(ball, force_density)
    lengths = tc.to_rest_length(model, ball.nodes, rest.force_density).rest_length
    axis = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    from_centre = ball.nodes - ball.nodes.mean(axis=1, keepdims=True)
    velocities = np.cross(spin * axis, from_centre.T).T + np.array([[1.0], [0.0], [4.0]])
    return tc.Scene(
        model, duration, velocities=velocities, rest_length=lengths,
        name=f"six-bar ball, thrown, {stiffness:g} N/m",
    )  # fmt: skip


def prism(duration: float, segments: int = 1) -> tc.Scene:
    """The paper's example 1: γ = 17.3205 N/m, but 9 N/m in the vertical strings."""
    whole = tc.prism()
    gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    stiffness = 100.0
    model = tc.Model(whole, strings=tc.LinearStrings(stiffness))
    lengths = tc.to_rest_length(model, whole.nodes, gamma).rest_length
    if segments == 1:
        return tc.Scene(model, duration, rest_length=lengths, name="prism, massless strings")
    # The paper's node mass: a string of 0.04 kg on a bar of 1 kg.
    cut = tc.subdivide(whole, segments=segments, node_mass=0.04 / segments)
    massive = tc.Model(cut, strings=tc.LinearStrings(stiffness * segments))
    value = tc.structure.spread_rest_length(cut, lengths)
    return tc.Scene(massive, duration, rest_length=value, name=f"prism, {segments} segments")


def drop(duration: float, height: float = 0.3) -> tc.Scene:
    """A ball above rough ground; its strings are not damped, as MuJoCo's would push when slack."""
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


ERRORS = (1e-3, 1e-5, 1e-7)  # m
DIFFRAX = ("Dopri5", "Tsit5", "Dopri8")

MOTIONS = {
    "switching": Motion(lambda t: thrown(t, 3.0, 500.0, 0.5), 5.0, 0.02, 1e-5),
    "taut": Motion(lambda t: thrown(t, 1.5, 2000.0, 40.0), 5.0, 0.02, 1e-5),
    "stiff": Motion(lambda t: thrown(t, 1.5, 1e5, 40.0), 5.0, 5e-3, 1e-5),
    "prism": Motion(prism, 5.0, 0.05, 1e-5),
    "massive": Motion(lambda t: prism(t, 4), 5.0, 0.0125, 1e-5, is_class_1=False),
    "ground": Motion(drop, 1.0, 0.01, 5e-5),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table a scene."""
    given = options(
        __doc__, arguments, scenes=tuple(MOTIONS), duration=0.0, errors=ERRORS, repeats=15,
        longest=2.0,
    )  # fmt: skip
    for name in given.scenes:
        motion = MOTIONS[name]
        case = motion.make(given.duration or motion.duration)
        outputs = max(2, round(OUTPUTS * case.duration / 5))
        reference = tc.accuracy.converged_motion(case, outputs)
        print(f"\n{case.name}, {case.duration:g} s\n{reference.summary()}", flush=True)
        make = partial(motion.make, case.duration)
        programs = ours(make, reference.time, tolerances())
        programs += others(motion, case, reference.time)
        reported(programs, farthest(reference.nodes), given.errors, given.repeats, given.longest)


def others(motion: Motion, case: tc.Scene, times: np.ndarray) -> list[Program]:
    """Return the peers of a motion."""
    steps = grid(motion.coarsest, motion.finest)
    programs = []
    if motion.is_class_1 and not rk4_peers.is_missing("jax"):
        programs.append(rk4_peers.jax_rk4(case, times, steps))
    if motion.is_class_1 and not rk4_peers.is_missing("diffrax"):
        programs += [rk4_peers.diffrax(method, case, times, tolerances()) for method in DIFFRAX]
    rivals = [SciPy("DOP853", tolerances()), CasADiCVODES(tolerances(finest=1e-11))]
    rivals += [MuJoCo(kind, steps) for kind in ("rk4", "euler", "implicitfast")]
    programs += [peer(rival, case, times) for rival in rivals]
    return programs


if __name__ == "__main__":
    main()
