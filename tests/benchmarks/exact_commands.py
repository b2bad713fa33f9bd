"""Are commands of linear MPC the optimum of their programs? Random programs in long double.

Run: ``python -m tests.benchmarks.exact_commands --count 350 [--seed 0] [--jobs 2]
[--only d_bar]``.

A plant of the library, or of a random structure of class 1 to 4, whole or of a few modes, driven by
force densities, rest lengths, lengths of bars or both, by all members, some or one, has an MPC of 1
to 60 samples: weights over 8 decades, bounds on inputs (some equal, some met at rest), changes,
force densities, tensions, node positions, soft or hard, a reference, ramps, weights of its own. Its
state is put so far out that inputs of the LQR would be 0.01 to 1,000 times their unit, runs on, and
is put out again: four commands. Each is compared with the optimum of the same program in long
double, whose conditions are checked; errors are those of planned inputs in their unit. It prints
how many are off by more than 1e-9, each command that was not solved, with the feasibility of its
hard limits by linear programming, and each whose optimum is not known. ``--scene 7`` prints one
scene.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np

import tenscontrol as tc
from tenscontrol.control.mpc import OutputLimit
from tenscontrol.control.mpc.sparse import QuadraticProgram, Sparse
from tenscontrol.plant import natural_weights
from tenscontrol.plant.linear_plant import state_units
from tests.benchmarks.command_line import options
from tests.benchmarks.trust import mapped
from tests.control.mpc.optimum import UncertainError, certain_inputs, is_feasible_program
from tests.control.reached import stable_plant

EXACT, COMMANDS = 1e-9, 4
_STREAM = 20261130

_LIBRARY = {
    "prism": lambda random: tc.prism(sides=int(random.integers(3, 6))),
    "tower": lambda random: tc.prism_tower(2),
    "ball": lambda random: tc.library.six_bar_ball(bar_length=1.0),
    "class-2 tower": lambda random: tc.library.class2_tower(2),
    **{
        name: lambda random, name=name: getattr(tc.library, name)()
        for name in ("kite", "d_bar", "d_bar_3d", "snelson_x", "t_bar", "arm")
    },
}
_STRUCTURES = *_LIBRARY, "random", "random", "random"

_TOLD = "Q", "N", "terminal_weight", "winches", "max_change", "max_tension", "reference"
_INPUTS = "force_density", "rest_length", "rest_length", "bar_length", "length"


@dataclass(frozen=True)
class Command:
    """How a program ended: its status, and what its planned inputs are off by."""

    seed: int
    k: int
    status: str
    error: float  # in units of an input; NaN: not known
    changes: int  # of the active set
    note: str = ""


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, count=350, seed=0, jobs=1, scene=(-1,), only="")
    if given.scene[0] >= 0:
        for seed in given.scene:
            print(f"{seed}: {about(random_mpc(seed, given.only))}")
            print(*commands(seed, given.only), sep="\n  ")
        return
    results: list[Command] = []
    for some in mapped(
        partial(commands, only=given.only),
        range(given.seed, given.seed + given.count),
        given.jobs,
        "programs",
    ):
        results += some
    errors = np.array([one.error for one in results if one.error == one.error])
    print(
        f"{len(results)} commands, {len(errors)} compared, "
        f"{np.mean([one.changes > 0 for one in results]):.0%} with limits active: "
        f"{(errors > EXACT).sum()} off by more than {EXACT:g}, worst {errors.max(initial=0):.1e}"
    )
    print("status:", dict(Counter(one.status for one in results)))
    for one in results:
        if one.status != "ok" or not one.error <= EXACT:
            print(f"  {one.seed}.{one.k}: {one.status}, error {one.error:.1e}, "
                  f"{one.changes} changes {one.note}")  # fmt: skip


def random_mpc(seed: int, only: str = "") -> tc.MPC:
    """Return the controller of this seed."""
    random = np.random.default_rng([_STREAM, seed])
    with warnings.catch_warnings(action="ignore"):  # of motions that no input holds
        mpc = None
        while mpc is None:
            # No input may reach what drifts, or rest may break a limit.
            with suppress(ValueError):
                plant = _plant(random, only)
                mpc = tc.MPC(plant, **_settings(random, plant))
    return mpc


def _plant(random: np.random.Generator, only: str) -> tc.LinearPlant:
    kind = only or _STRUCTURES[random.integers(len(_STRUCTURES))]
    if kind == "random":
        plant = None
        while plant is None:
            plant = stable_plant(int(random.integers(10**6)))
    else:
        rest = tc.prestress(_LIBRARY[kind](random), min_force_density=10 ** random.uniform(0, 2))
        density = rest.force_density
        stiffness = density * 10 ** random.uniform(0.3, 3)
        damping = random.choice([0.0, 0.01]) * np.sqrt(stiffness)
        model = tc.Model(rest.structure, tc.LinearStrings(stiffness, damping))
        input_ = random.choice(_INPUTS)
        if input_ == "force_density":
            model = tc.Model(rest.structure)
        count = len(rest.structure.bars if input_ == "bar_length" else density)
        actuated = None
        if random.random() < 0.3:  # some members, often one
            some = max(1, int(random.integers(-2, count + 1)))
            actuated = np.sort(random.choice(count, some, replace=False))
        plant = tc.linearize(model, rest, str(input_), actuated=actuated)
    r = plant.degrees_of_freedom
    return tc.reduce(plant, int(random.integers(1, r + 1))) if random.random() < 0.3 else plant


def _settings(random: np.random.Generator, plant: tc.LinearPlant) -> dict[str, object]:
    """Return settings of an MPC of a plant."""

    def chance(share: float) -> bool:
        return bool(random.random() < share)

    Q, R = natural_weights(plant)
    s, a = plant.B.shape
    frequency = plant.spectral_radius or 1.0
    given: dict[str, object] = {
        "horizon": max(1, min(int(60 ** random.uniform(0, 1)), 1200 // a)),
        "sample_time": 10 ** random.uniform(-1.5, 0.5) / frequency,
        "R": R * 10 ** random.uniform(-6, 2) * 10 ** random.uniform(-1, 1, a),
    }
    if chance(0.3):
        given["Q"] = np.diag(Q) * 10 ** random.uniform(-2, 2, s)
        Q = np.diag(given["Q"])
    if chance(0.2):
        root = np.linalg.cholesky(Q) * 0.9 / np.sqrt(s * a)
        given["N"] = root @ random.uniform(-1, 1, (s, a)) * np.sqrt(given["R"])
    if chance(0.15):
        given["terminal_weight"] = 10 ** random.uniform(-1, 1) * Q
    if chance(0.15):
        half = random.normal(size=(a, a)) * np.sqrt(given["R"] / a)
        given["R"] = half.T @ half + 0.1 * np.diag(given["R"])
    gamma = plant.force_density
    low = gamma * random.choice([0.0, 0.5, 1.0], len(gamma), p=[0.4, 0.5, 0.1])
    high = gamma * random.choice([1.0, 1.01, 1.5], len(gamma), p=[0.05, 0.45, 0.5])
    if plant.input == "force_density":
        given |= {"min_force_density": low} if chance(0.7) else {}
        given |= {"max_force_density": high} if chance(0.7) else {}
        given |= {"max_change": gamma.max() * 10 ** random.uniform(-2, 0)} if chance(0.5) else {}
    else:
        stretch = 10 ** random.uniform(-2, 0) * np.ptp(plant.nodes) * 1e-2
        limits: dict[str, object] = {}
        limits |= {"rate": stretch / given["sample_time"]} if chance(0.6) else {}
        if chance(0.3):
            rest = plant.equilibrium_input
            whole = plant.actuation.is_whole
            limits |= {"shortest": rest - stretch * random.integers(0, 3)} if whole else {}
            limits |= {"longest": rest + stretch * random.integers(1, 3, a)} if whole else {}
        limits |= {"substeps": 4} if chance(0.3) else {}
        given |= {"winches": tc.Winches(**limits)} if limits else {}
        given |= {"min_force_density": float(low.min())} if chance(0.5) else {}
        given |= {"max_force_density": 1.01 * float(gamma.max())} if chance(0.3) else {}
        given |= {"string_penalty": float(10 ** random.uniform(-2, 5))} if chance(0.6) else {}
        given |= {"string_penalty": np.inf} if chance(0.1) else {}
    if chance(0.2):
        tension = gamma * plant.model.structure.string_length(plant.nodes)
        given["max_tension"] = 10 ** random.uniform(0.001, 0.3) * tension.max()
    if chance(0.2) and not plant.drives_bars:
        rows = random.normal(size=(int(random.integers(1, 3)), plant.nodes.size))
        each = rows.reshape(len(rows), -1, len(plant.nodes))
        rows = (each - each.mean(axis=1, keepdims=True)).reshape(rows.shape)
        here, off = rows @ plant.nodes.ravel(order="F"), 10 ** random.uniform(-5, -2)
        penalty = np.inf if chance(0.2) else 10 ** random.uniform(0, 6)
        given["outputs"] = [OutputLimit(rows, here - off, here + off, penalty)]
    if chance(0.2) and not plant.drives_bars:
        q = 1e-3 * random.normal(size=plant.degrees_of_freedom)
        shapes = [plant.to_nodes(share * q) for share in np.linspace(0, 1, 6)]
        times = np.linspace(0, 3 * given["sample_time"], 6)
        given["reference"] = tc.Reference(times, np.stack(shapes, axis=-1))
    return given


def commands(seed: int, only: str = "") -> list[Command]:
    """Return how the commands of a scene end."""
    return pushed(random_mpc(seed, only), np.random.default_rng([_STREAM, seed, 1]), seed)


def pushed(
    mpc: tc.MPC, random: np.random.Generator, seed: int = 0, count: int = COMMANDS
) -> list[Command]:
    """Return how the commands of a loop end that is pushed at every other sample."""
    law, designed, results = mpc.law, mpc.law.design, []
    problem, form, program = designed.problem, Sparse(designed.problem), mpc.law.program()
    units = state_units(mpc.plant)[0]
    state, previous = np.zeros_like(units), None
    for k in range(count):
        data = law.stage_data(law.preview(k * law.settings.sample_time), None)
        previous = data.previous_origin if previous is None else previous
        if k % 2 == 0:
            push = units * random.normal(size=len(units))
            wanted = float(np.abs(problem.feedback[:, : len(units)] @ push).max())
            state = state + push * problem.level * 10 ** random.uniform(-2, 3) / max(wanted, 1e-300)
        first = law.first_state(data, state, previous)
        answer = program.solve(first, data, previous, np.inf)
        whole = form.program(first, data, previous)
        planned = None if answer.input is None else program.plan.T
        error, note = _judged(whole, planned)
        results.append(Command(seed, k, str(answer.status), error, answer.iterations, note))
        if answer.input is None:
            break
        value = np.clip(answer.input, designed.low, designed.high)
        state = law.free_response(data, state, previous) + designed.sampled.by_input @ value
        previous = value
    return results


def _judged(whole: QuadraticProgram, planned: np.ndarray | None) -> tuple[float, str]:
    """Return what planned inputs are off by, in their unit, NaN if unknown, and a note."""
    try:
        if planned is None:
            return np.nan, "feasible" if is_feasible_program(whole) else "no point keeps all rows"
        return float(np.abs(certain_inputs(whole, planned) - planned).max()) / whole.unit, ""
    except UncertainError as cause:
        return np.nan, f"optimum not known: {cause}"


def about(mpc: tc.MPC) -> str:
    """Return one line on a scene."""
    problem, plant = mpc.law.design.problem, mpc.plant
    settings = vars(mpc.law.settings)
    given = ", ".join(name for name in _TOLD if settings[name] is not None)
    return (
        f"{plant}, {len(plant.model.structure.bars)} bars, horizon {problem.length}, level "
        f"{problem.level:.2g}, penalty {mpc.law.settings.string_penalty:.2g}, "
        f"{0 if problem.rows is None else len(problem.rows.scale)} rows, steady {problem.steady}, "
        f"{given}"
    )


if __name__ == "__main__":
    main()
