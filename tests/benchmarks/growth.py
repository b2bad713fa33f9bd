"""Processor time and memory of each stage from structure to control, of 10 stages to 3,000.

Run: ``python -m tests.benchmarks.growth``. Towers of prisms, 24 members a stage, towers of class 2,
9 members a stage, towers of fewer prisms with skins on their polygons, 12 members a stage, and
square nets with held edges, 7 strings a stage, which no string controls where they are flat. A
routine is left out of larger towers where smaller ones predict more time or memory than the budget.

All sizes are measured alike. The road is taken ``--repeats`` times at each, anew from the structure
on, so that nothing is remembered from the time before; a routine's least time counts, and its
largest memory. What the process imports and builds once, whatever the structure, is left out. Time
is that of the program. The time of the system, which mainly hands out memory and differs up to
fivefold from turn to turn, is printed apart. Memory is the largest of the process while the routine
runs, less that before it; Linux alone says it. Threads of linear algebra cost processor time where
other programs run: ``OPENBLAS_NUM_THREADS=1`` keeps it to one. The last table compares sparse
routines of statics and modes with whole decompositions: the largest difference, and the time of
both.

Strings are linear, a hundred times as stiff as their γ. The plant has rest lengths as its input; it
is reduced to 20 modes for LQR and for MPC with a horizon of 20 samples of 0.02 s. Their first
command is part of the design, since it finds what all later ones use; a later one is timed apart.
The simulation lasts 0.02 s, from rest. The equilibrium starts in the shape at rest, the
controllability is that of 20 modes, and pages are those of the structure and of the run.
"""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np

import tenscontrol as tc
from tenscontrol.tables import aligned, shown
from tests.benchmarks.command_line import options

if sys.platform != "win32":
    import resource


def square_net(stages: int) -> tc.Structure:
    """Return a net with some 3.5 nodes a stage: 102 by 102 of 3,000."""
    side = max(4, round((3.5 * stages) ** 0.5))
    return tc.net(side, side, spacing=0.1, node_mass=0.01, fixed="edges")


def skinned_tower(stages: int) -> tc.Structure:
    """Return a tower of prisms with skins of strings, some 3.5 nodes a stage: 10,500 of 3,000."""
    tower = tc.prism_tower(max(1, stages // 4))
    return tc.skin(tower, ("top", "bottom"), iterations=2, node_mass=0.01)


# With the last routine that they have.
STRUCTURES = {
    "tower": (tc.prism_tower, "MPC step"),
    "class-2 tower": (tc.library.class2_tower, "MPC step"),
    "skinned tower": (skinned_tower, "MPC step"),
    "net": (square_net, "reduce"),
}
STAGES = (10, 30, 100, 300, 1000, 3000)
WHOLE = (10, 20, 40)
LEVEL, SAMPLE_TIME, COUNT, HORIZON = 10.0, 0.02, 20, 20

# What an exponent is not fitted to.
MEASURABLE = {"seconds": 0.02, "system": 0.02, "memory": 2e7}

# Least and largest exponent by which the next size is predicted, and sizes it is fitted to.
EXPONENTS, FITTED = (1.0, 3.0), 4


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, structures=tuple(STRUCTURES), stages=STAGES, whole=WHOLE,
        seconds=60.0, gigabytes=2.0, last="MPC step", repeats=3,
    )  # fmt: skip
    budget = {"seconds": given.seconds, "memory": 1e9 * given.gigabytes}
    every = list(ROUTINES)
    for what in given.structures:
        generate, last = STRUCTURES[what]
        names = every[: min(every.index(given.last), every.index(last)) + 1]
        print(f"{what}, members:")
        print(table(growth(generate, given.stages, names, budget, given.repeats)) + "\n")
    print("sparse ways against whole decompositions: largest difference, processor s of both")
    print(f"{'stages':>6s}  {'what':24s} {'difference':>10s} {'sparse':>8s} {'whole':>8s}")
    for stages in given.whole:
        for what, difference, *times in compared(stages):
            print(f"{stages:6d}  {what:24s} {difference:10.1e} {times[0]:8.2f} {times[1]:8.2f}")


# ---- what is measured ----


@dataclass(frozen=True)
class Cost:
    """Time, s, and memory, bytes, that one routine takes at one size; or why it was not run."""

    routine: str
    members: int = 0
    seconds: float = np.nan
    system: float = np.nan
    memory: float = np.nan
    note: str = ""


def linearized(results: dict[str, Any]) -> tc.LinearPlant:
    rest = results["prestress search"]
    strings = tc.LinearStrings(100.0 * float(rest.force_density.max()))
    return tc.linearize(tc.Model(rest.structure, strings=strings), rest, input="rest_length")


def designed(controller: type[Any], results: dict[str, Any], **how: Any) -> Any:
    plant = replace(results["reduce"])  # without what it remembers
    law = controller(plant, sample_time=SAMPLE_TIME, **how)
    command(law, results)
    return law


def command(law: Any, results: dict[str, Any]) -> None:
    plant = results["linearize"]
    law.reset()
    law.command(0.0, plant.nodes, 0 * plant.nodes)


def simulated(results: dict[str, Any]) -> tc.Trajectory:
    plant = results["linearize"]
    return tc.simulate(
        plant.model, SAMPLE_TIME, plant.nodes, rest_length=plant.rest_length, error="none"
    )  # fmt: skip


def balanced(results: dict[str, Any]) -> tc.statics.Prestress:
    plant = results["linearize"]
    return tc.equilibrium(plant.model, rest_length=plant.rest_length)


def written(results: dict[str, Any], what: str, form: str) -> None:
    """Save or show one of the results in a file that is removed."""
    with TemporaryDirectory() as folder:
        getattr(results[what], form)(Path(folder) / ("page.html" if form == "to_html" else "x.npz"))


def loaded(results: dict[str, Any]) -> tc.Trajectory:
    with TemporaryDirectory() as folder:
        return tc.load_run(results["simulate"].save(Path(folder) / "run.npz"))


# Each takes the results of those before it.
ROUTINES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "structure": lambda results: results["generate"](results["stages"]),
    "view": partial(written, what="structure", form="to_html"),
    "prestress search": lambda results: tc.prestress(
        results["structure"], LEVEL, min_force_density=0.1 * LEVEL
    ),
    "prestress check": lambda results: tc.prestress(
        results["structure"], results["prestress search"].force_density
    ),
    "stability": lambda results: results["prestress search"].stability,
    "linearize": linearized,
    "equilibrium": balanced,
    "20 modes": lambda results: tc.modes(results["linearize"], few(results["linearize"])),
    "simulate": simulated,
    "summary": lambda results: results["simulate"].summary(),
    "save": partial(written, what="simulate", form="save"),
    "save and load": loaded,
    "view of the run": partial(written, what="simulate", form="to_html"),
    "controllability": lambda results: tc.controllability(
        results["linearize"], few(results["linearize"])
    ),
    "reduce": lambda results: tc.reduce(results["linearize"], few(results["linearize"])),
    "LQR": lambda results: designed(tc.LQR, results),
    "LQR step": lambda results: command(results["LQR"], results),
    "MPC": lambda results: designed(tc.MPC, results, horizon=HORIZON),
    "MPC step": lambda results: command(results["MPC"], results),
}


def few(plant: tc.LinearPlant) -> int:
    return min(COUNT, plant.degrees_of_freedom)


def growth(
    generate: Callable[[int], tc.Structure], stages: Sequence[int], routines: Sequence[str],
    budget: dict[str, float], repeats: int,
) -> list[Cost]:  # fmt: skip
    """Return the cost of each routine on each tower, as far as the budget goes."""
    road(generate, 2, routines)  # some import what they need
    costs: list[Cost] = []
    for count in stages:
        structure = generate(count)
        members = len(structure.strings) + len(structure.bars)
        notes = {
            name: beyond([cost for cost in costs if cost.routine == name], members, budget)
            for name in routines
        }
        within = [name for name in routines if not notes[name]]
        turns = [road(generate, count, within) for _ in range(repeats)]
        for name in routines:
            if notes[name]:
                costs.append(Cost(name, members, note=notes[name]))
                continue
            least = min((turn[name] for turn in turns), key=lambda cost: cost.seconds)
            most = max(turn[name].memory for turn in turns)
            costs.append(replace(least, members=members, memory=most))
    return costs


def road(
    generate: Callable[[int], tc.Structure], stages: int, routines: Sequence[str]
) -> dict[str, Cost]:
    """Run routines one after the other, each with the results of those before it."""
    results: dict[str, Any] = {"stages": stages, "generate": generate}
    costs = {}
    for name in routines:
        forget_peak()
        base, start = memory("VmRSS"), spent()
        try:
            results[name] = ROUTINES[name](results)
        except KeyError as error:
            costs[name] = Cost(name, note=f"needs {error}")
        except (ValueError, ArithmeticError, MemoryError) as error:
            costs[name] = Cost(name, note=f"failed: {error}")
        else:
            seconds, system = spent() - start
            costs[name] = Cost(name, 0, seconds, system, max(0.0, memory("VmHWM") - base))
    return costs


def spent() -> np.ndarray:
    """Return the time of the program in this process and of the system for it, s."""
    if sys.platform == "win32":
        return np.array(os.times()[:2])
    usage = resource.getrusage(resource.RUSAGE_SELF)  # finer than os.times
    return np.array([usage.ru_utime, usage.ru_stime])


def beyond(costs: Sequence[Cost], members: int, budget: dict[str, float]) -> str:
    """Return why a routine is not run at a size, predicted from smaller ones, or nothing."""
    for quantity, most in budget.items():
        values = [(cost.members, getattr(cost, quantity)) for cost in costs]
        values = [(x, max(y, MEASURABLE[quantity])) for x, y in values if not np.isnan(y)]
        if values:
            power = float(np.clip(fitted(values[-2:]), *EXPONENTS)) if len(values) > 1 else 1.0
            predicted = values[-1][1] * (members / values[-1][0]) ** power
            if predicted > most:
                return f"some {predicted:.2g} predicted, beyond the budget of {most:g} ({quantity})"
    return ""


def fitted(pairs: Sequence[tuple[float, float]]) -> float:
    """Return p of y ∝ xᵖ by least squares, NaN if there is but one x."""
    if len({x for x, _ in pairs}) < 2:
        return np.nan
    x, y = np.log(np.array(pairs)).T
    return float(np.polyfit(x, y, 1)[0])


def table(costs: Sequence[Cost]) -> str:
    """Return time and memory, one routine a line, with exponents fitted to the largest sizes."""
    sizes = sorted({cost.members for cost in costs})
    names = list(dict.fromkeys(cost.routine for cost in costs))
    parts = []
    for quantity, title, unit, form in (
        ("seconds", "processor s", 1.0, ".2g"), ("system", "system s", 1.0, ".2g"),
        ("memory", "peak memory MB", 1e6, ".0f"),
    ):  # fmt: skip
        lines = []
        for name in names:
            values = {c.members: getattr(c, quantity) for c in costs if c.routine == name}
            pairs = [(x, y) for x, y in values.items() if y >= MEASURABLE[quantity]]
            cells = [shown(float(values[size]) / unit, form) for size in sizes]
            lines.append([name, *cells, shown(fitted(pairs[-FITTED:]), ".2f")])
        parts.append(aligned([title, *map(str, sizes), "exponent"], lines))
    notes = [f"{cost.routine}, {cost.members} members: {cost.note}" for cost in costs if cost.note]
    return "\n\n".join([*parts, "\n".join(notes)])


def memory(name: str) -> float:
    """Return an entry of Linux's table of this process, bytes; NaN elsewhere."""
    status = Path("/proc/self/status")
    lines = status.read_text(encoding="ascii").splitlines() if status.exists() else []
    values = [float(line.split()[1]) for line in lines if line.startswith(f"{name}:")]
    return 1024.0 * values[0] if values else np.nan


def forget_peak() -> None:
    """Let Linux count the largest memory anew."""
    gc.collect()
    if sys.platform == "linux":
        with suppress(AttributeError):  # musl has none
            ctypes.CDLL(None).malloc_trim(0)  # what is freed is given back
        with suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


# ---- sparse and whole ----


def compared(stages: int) -> list[tuple[str, float, float, float]]:
    """Differences, relative to the largest entry, and times of the sparse and the whole way."""
    tower = tc.prism_tower(stages)
    rest = tc.prestress(tower, 10.0)
    k = 100.0 * float(rest.force_density.max())
    plant = tc.linearize(tc.Model(tower, strings=tc.LinearStrings(k)), rest, input="rest_length")

    def counts() -> list[float]:
        found = replace(rest).stability
        states = rest.self_stress_states, rest.mechanisms, found.stress_matrix_rank_defect
        return [*states, found.is_stable, found.is_super_stable]

    asked: dict[str, Callable[[], Any]] = {
        "prestress at a level": lambda: tc.prestress(tower, 10.0).force_density,
        "prestress, all taut": lambda: tc.prestress(tower, min_force_density=3).force_density,
        "bars of a given γ": lambda: tc.prestress(tower, rest.force_density).bar_force_density,
        "counts and verdicts": counts,
        f"{COUNT} lowest stiffnesses": lambda: rest.tangent_stiffness(k, COUNT).eigenvalues,
    }
    rows = []
    for what, ask in asked.items():
        answers, times = zip(*(timed(ask, few) for few in (-1, 10**9)), strict=True)
        rows.append((what, relative(*answers), *times))
    start = process_time()
    some = tc.modes(plant, COUNT).frequency
    middle = process_time()
    every = tc.modes(plant).frequency[:COUNT]
    rows.append((f"{COUNT} lowest modes", relative(some, every), middle - start,
                 process_time() - middle))  # fmt: skip
    return rows


def timed(ask: Callable[[], Any], few: int) -> tuple[np.ndarray, float]:
    """The answer with matrices of no more entries decomposed whole, and its processor time."""
    module = sys.modules["tenscontrol.statics.equilibrium_matrix"]
    with patch.object(module, "_FEW", few):
        start = process_time()
        answer = np.asarray(ask(), dtype=float)
        return answer, process_time() - start


def relative(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(one - other).max() / np.abs(other).max())


if __name__ == "__main__":
    main()
