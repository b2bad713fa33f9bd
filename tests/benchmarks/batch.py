"""A thousand runs at once beside JAX, NumPy and MuJoCo, and loops closed by an MPC.

``python -m tests.benchmarks.batch [--structures prism ball] [--scenes taut slack ground]``: prisms
of 12 members and six-bar balls of 30 start in one shape with velocities of their own, with strings
that stay taut, with strings that go slack, and dropped on the ground. A program reaches an error if
99 % of the runs end within it of a motion at a tolerance of 1e-10; MuJoCo, whose contact has a law
of its own, on the ground of its own motion in steps 8 times finer than its finest.

Of ours the processor time of a second ``tc.simulate_many`` is told, whole, as it is typed first:
with its defaults, its tolerance, its checks, start and end of a run and the estimate of the error
of a sample of the runs; in a second row without the estimate; in a third by ``rk4`` in
steps of one size, cut at switches; in a fourth by ``rk4_plain``, which steps across switches as the
peers do, with the estimate, and in a fifth without it. JAX (in double and single precision,
by blocks), NumPy and MuJoCo's rollout return the end alone. Not told: what compiling takes (JAX 1
to 3 s), and that the others locate no switch. Needs the extra ``bench``.

``--only tenscontrol JAX`` prints the programs whose names contain one of these: on the ground
MuJoCo takes most of the time, as its own motion is found in much finer steps.

``--scenes controlled``: the prisms with an MPC in each loop, as compiled code at once and one by
one, and in Python.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.measured_run import FINER
from tenscontrol.accuracy.peers.rigid_bodies import NodeReader
from tenscontrol.dynamics.equation import pack_state, unpack_states
from tenscontrol.integrate import Projector
from tenscontrol.simulation import AccuracyWarning
from tests.benchmarks.cheapest import Program, grid, reported, seconds_of, tolerances
from tests.benchmarks.command_line import options
from tests.benchmarks.rk4_peers import is_missing, jax_many, numpy_many

STIFFNESS, FALL = 100.0, 0.05  # N/m, m
FORCE_DENSITY = {"taut": 30.0, "slack": 0.5, "ground": 0.5}  # N/m
SPEED = {"taut": 0.05, "slack": 0.5, "ground": 0.2}  # m/s
PART = 0.99
BLOCKS = (250, 500, 1000)
PRECISIONS = (np.float64, np.float32)  # of JAX
KEPT = 50  # states that MuJoCo keeps at a time
SINGLE = 50  # loops that are run one by one


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table a scene."""
    given = options(
        __doc__, arguments, runs=1000, duration=1.0, repeats=7, longest=60.0, errors=(1e-3, 1e-5),
        structures=("prism", "ball"), scenes=("taut", "slack", "ground", "controlled"),
        only=("",),
    )  # fmt: skip
    if "controlled" in given.scenes:
        controlled(given.runs, given.duration, given.repeats)
    for structure in given.structures:
        for name in (scene for scene in given.scenes if scene != "controlled"):
            case = scene(structure, name, given.duration)
            velocities = thrown(case.structure, given.runs, SPEED[name])
            truth = many(case, velocities, method="dop853", tolerance=1e-10)
            switches = truth.switches.mean()
            print(f"\n{structure}, {name}: {given.runs} runs, {given.duration:g} s, "
                  f"{switches:.1f} switches a run", flush=True)  # fmt: skip
            judge = farthest_of_most(truth.nodes[..., -1])
            made = [*ours(case, velocities), *peers(case, velocities)]
            if is_asked("MuJoCo rollout RK4 implicitfast", given.only) and not is_missing("mujoco"):
                made += rollouts(case, velocities)
            programs = [program for program in made if is_asked(program.name, given.only)]
            reported(programs, judge, given.errors, given.repeats, given.longest)


def is_asked(name: str, only: Sequence[str]) -> bool:
    """Return whether the name of a program contains one of some texts."""
    return any(text in name for text in only)


def scene(structure: str, name: str, duration: float) -> tc.Scene:
    """Return what all runs have in common."""
    body = {"prism": tc.prism, "ball": tc.library.six_bar_ball}[structure]()
    rest = tc.prestress(body, FORCE_DENSITY[name])
    model = tc.Model(body, strings=tc.LinearStrings(STIFFNESS))
    lengths = tc.to_rest_length(model, body.nodes, rest.force_density).rest_length
    if name == "ground":
        height = float(body.nodes[2].min()) - FALL
        ground = tc.Ground(2e3, damping=0.3, friction=0.5, slip_speed=0.05, height=height)
        model = tc.Model(body, strings=model.strings, gravity=9.81, ground=ground)
    return tc.Scene(model, duration, rest_length=lengths, name=f"{structure}, {name}")


def thrown(structure: tc.Structure, runs: int, speed: float) -> np.ndarray:
    """Return velocities that bars can have, shape (runs, 3, n), m/s."""
    state = pack_state(structure, structure.nodes, np.zeros_like(structure.nodes))
    states, half = np.tile(state[:, None], runs), len(state) // 2
    states[half:] = speed * np.random.default_rng(0).standard_normal((half, runs))
    exact = Projector(tc.Model(structure).equation("force_density"), True)(states)
    return np.moveaxis(unpack_states(structure, exact)[1], 2, 0)


def farthest_of_most(ends: np.ndarray) -> Callable[[np.ndarray], float]:
    """Return what judges ends, shape (runs, 3, n): the distance within which 99 % are, m."""

    def judge(nodes: np.ndarray) -> float:
        off = np.linalg.norm(nodes - ends, axis=1).max(axis=1)
        return float(np.quantile(np.nan_to_num(off, nan=np.inf), PART, method="higher"))

    return judge


# ---- ours ----


def many(
    case: tc.Scene, velocities: np.ndarray, error: str = "sample", **how: Any
) -> tc.Batch:  # fmt: skip
    """Return the runs of :func:`tc.simulate_many`."""
    with warnings.catch_warnings(action="ignore", category=AccuracyWarning):
        scene = replace(case, integration=tc.Integration(**how))
        return tc.simulate_many(scene, {"velocities": velocities}, error=error)


def ours(case: tc.Scene, velocities: np.ndarray) -> list[Program]:
    """Return the default call, one that returns what the others do, and those in steps."""
    lean = {"error": "none", "output_step": case.duration}

    def program(name: str, settings: Sequence[float], kind: str, more: dict[str, Any]) -> Program:
        return Program(
            name, settings,
            lambda setting: lambda: many(case, velocities, **{kind: setting}, **more),
            lambda batch: batch.nodes[..., -1],
        )  # fmt: skip

    finest, steps = tolerances(finest=1e-10), grid(0.1, 1e-4)
    plain = {"method": "rk4_plain"}
    return [
        program("tenscontrol, default call", finest, "tolerance", {}),
        program("tenscontrol, ends, no estimate", finest, "tolerance", lean),
        program("tenscontrol, rk4, ends", steps, "step", {"method": "rk4", **lean}),
        program("tenscontrol, rk4_plain", steps, "step", plain),
        program("tenscontrol, rk4_plain, ends", steps, "step", plain | lean),
    ]


def controlled(runs: int, duration: float, repeats: int) -> None:
    """Print what loops closed by an MPC take, at once and one by one, in turns."""
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=60.0)
    with TemporaryDirectory() as folder:
        code = tc.generate_c(mpc, Path(folder) / "mpc").compile()
    offsets = np.random.default_rng(0).normal(size=(runs, 9))
    starts = np.array([plant.to_nodes(0.02 * q) for q in offsets])
    settings = {"step": 5e-3, "output_step": 0.02}

    def at_once() -> np.ndarray:
        how = tc.Integration(**settings)
        scene = tc.Scene(plant.model, duration, controller=code, integration=how)
        return tc.simulate_many(scene, {"nodes": starts}).nodes

    def one_by_one(controller: Any) -> np.ndarray:
        loops = (
            tc.simulate(plant.model, duration, start, controller=controller, **settings)
            for start in starts[:SINGLE]
        )
        return np.array([loop.nodes for loop in loops])

    print(f"controlled: {runs} prisms, {duration:g} s, MPC of {mpc.horizon} samples of 0.02 s")
    print("loops                      ms a loop  over the first  farthest node, m")
    ways = {
        "compiled, at once": (at_once, runs),
        "compiled, one by one": (lambda: one_by_one(code), len(starts[:SINGLE])),
        "Python, one by one": (lambda: one_by_one(mpc), len(starts[:SINGLE])),
    }
    nodes = {label: run() for label, (run, _) in ways.items()}
    turns = [
        {label: seconds_of(run) / count for label, (run, count) in ways.items()}
        for _ in range(repeats)
    ]
    first, *_ = ways
    for label in ways:
        apart = np.abs(nodes[first][:SINGLE] - nodes[label][:SINGLE]).max()
        typical = median(turn[label] for turn in turns)
        ratio = median(turn[label] / turn[first] for turn in turns)
        print(f"{label:25s} {1e3 * typical:10.3g} {ratio:15.1f} {apart:17.1e}")


# ---- peers ----


def peers(case: tc.Scene, velocities: np.ndarray) -> list[Program]:
    """Return RK4 in JAX and NumPy."""
    steps = grid(0.1, 1e-4)
    programs = [numpy_many(case, velocities, BLOCKS[0], steps)]
    if not is_missing("jax"):
        programs += [
            jax_many(case, velocities, kind, block, steps)
            for kind in PRECISIONS
            for block in sorted({min(block, len(velocities)) for block in BLOCKS})
            if len(velocities) % block == 0
        ]
    return programs


def rollouts(case: tc.Scene, velocities: np.ndarray) -> list[Program]:
    """Return MuJoCo's rollout in one thread, a few steps at a time: it keeps the state of each."""
    import mujoco
    from mujoco import rollout

    texts = [
        tc.exchange.to_mujoco(case.model, rest_length=case.input_value, velocities=rates)
        for rates in velocities
    ]
    model = mujoco.MjModel.from_xml_string(texts[0])
    if case.model.contacts is None:
        flags = mujoco.mjtDisableBit
        model.opt.disableflags |= flags.mjDSBL_CONSTRAINT | flags.mjDSBL_CONTACT
    data, reader = mujoco.MjData(model), NodeReader(model, case.structure)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    starts = np.empty((len(velocities), mujoco.mj_stateSize(model, kind)))
    for row, text in zip(starts, texts, strict=True):
        mujoco.mj_resetDataKeyframe(mujoco.MjModel.from_xml_string(text), data, 0)
        mujoco.mj_getState(model, data, row, kind)

    def nodes(states: np.ndarray) -> np.ndarray:
        read = []
        for state in states:
            mujoco.mj_setState(model, data, state, kind)
            read.append(reader.read(data))
        return reader.motion(read)[0].transpose(2, 0, 1)

    def program(name: str) -> Program:
        def prepare(step: float) -> Callable[[], np.ndarray]:
            steps = max(1, round(case.duration / step))

            def run() -> np.ndarray:
                model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}")
                model.opt.timestep = case.duration / steps
                states = starts
                for first in range(0, steps, KEPT):
                    count = min(KEPT, steps - first)
                    states = rollout.rollout(model, data, states, nstep=count)[0][:, -1]
                return states

            return run

        settings = grid(0.02, 2e-4)
        judge = None
        if case.model.contacts is not None:
            judge = farthest_of_most(nodes(prepare(settings[-1] / FINER)()))
        return Program(f"MuJoCo rollout {name}", settings, prepare, nodes, judge)

    return [program("RK4"), program("implicitfast")]


if __name__ == "__main__":
    main()
