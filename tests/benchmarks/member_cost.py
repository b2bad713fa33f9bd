"""What one member costs in one evaluation of the state equation, from 3 bars to 30,000.

Run: ``python -m tests.benchmarks.member_cost``. Towers of prisms, timed beside a hand-written
loop in C (yardstick.c, -O3), in turns. A figure is the nanoseconds per bar or string of the
fastest turn, which other programs have disturbed least; in brackets, what that is of the
yardstick's. Needs a C compiler.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.dynamics.machine_code import compiler
from tenscontrol.dynamics.model import LARGEST_FLAT
from tenscontrol.integrate.core_scene import core_scene
from tests.benchmarks.command_line import options

BARS = (3, 30, 300, 3_000, 30_000)
TURNS = 25
# Members evaluated in one turn, so that a clock can measure it.
MEMBERS = 200_000
STIFFNESS = 100.0


class Scene(ctypes.Structure):
    """The struct of yardstick.c."""

    _fields_ = (
        *[(name, ctypes.c_int) for name in ("nodes", "strings", "bars")],
        *[(name, ctypes.c_void_p) for name in ("string", "bar", "mass")],
        ("stiffness", ctypes.c_double),
        ("force", ctypes.c_void_p),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, bars=BARS, turns=TURNS, members=MEMBERS)
    with tempfile.TemporaryDirectory() as folder:
        yardstick = build_yardstick(Path(folder))
        for held in ("force_density", "rest_length"):
            print(f"\n{held.replace('_', ' ')} held: ns per member and evaluation, (ratio), build")
            print(
                f"{'bars':>7s} {'members':>8s} {'yardstick':>10s} {'core':>24s} "
                f"{'without':>24s}  form without"
            )
            rows = [cost(yardstick, bars, held, given.turns, given.members) for bars in given.bars]
            for name, column in zip(
                ("yardstick", "core", "without"), zip(*rows, strict=True), strict=True
            ):
                print(f"largest over smallest, {name}: {max(column) / min(column):.1f}")


def cost(
    yardstick: ctypes.CDLL, bars: int, held: str, turns: int, evaluated: int
) -> tuple[float, ...]:
    """Print one line of the table, and return its ns per member."""
    tower = tc.prism_tower(bars // 3)
    members = len(tower.bars) + len(tower.strings)
    model = tc.Model(tower, tc.LinearStrings(STIFFNESS))
    random = np.random.default_rng(0)
    x = np.concatenate([tower.nodes.ravel(order="F"), random.normal(size=tower.nodes.size)])
    gamma = random.uniform(5.0, 10.0, len(tower.strings))
    if held == "force_density":
        u, taut, law = gamma, np.zeros(0), None
    else:
        law = model.strings
        u, taut = law.rest_length(tower.string_length(), gamma), np.ones(len(gamma))

    repeats = max(3, evaluated // members)
    by_hand, expected = time_by_hand(yardstick, tower, law, (x, u, taut), repeats)
    began = perf_counter()
    core = core_scene(model.equation(held, form="mapped"))
    if core is None:
        raise SystemExit("tenscontrol was installed without its core")
    built = [perf_counter() - began]
    compiled, found = time_core(yardstick, core, (x, u, taut), repeats)
    assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()
    form = "flat" if members <= LARGEST_FLAT else "mapped"
    began = perf_counter()
    slope = model.equation(held, form=form).slope
    built.append(perf_counter() - began)
    graph, found = time_graph(slope, (x, u, taut), repeats)
    assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()

    times = np.array([[run() for run in (by_hand, compiled, graph)] for _ in range(turns)])
    figures = 1e9 * times.min(axis=0) / members
    ratios = figures / figures[0]
    ours = [f"{figures[i]:7.1f} ({ratios[i]:4.1f}) {built[i - 1]:6.2f} s" for i in (1, 2)]
    print(f"{bars:7d} {members:8d} {figures[0]:10.1f} {ours[0]:>24s} {ours[1]:>24s}  {form}")
    return tuple(figures)


def build_yardstick(folder: Path) -> ctypes.CDLL:
    source, library = Path(__file__).with_name("yardstick.c"), folder / "yardstick.so"
    found = compiler()
    if found is None:
        raise SystemExit("no C compiler: none of $CC, cc, gcc and clang is on the path")
    command = [*found, "-O3", "-fPIC", "-shared", str(source), "-o", str(library), "-lm"]
    subprocess.run(command, check=True)
    loaded = ctypes.CDLL(str(library))
    for name in ("time_yardstick", "time_core"):
        getattr(loaded, name).restype = ctypes.c_double
    return loaded


def time_by_hand(yardstick, tower, law, at, repeats):
    """Return what times the yardstick, and its result."""
    string, bar = (np.ascontiguousarray(part, np.int32) for part in (tower.strings, tower.bars))
    mass, force = tower.bar_mass.copy(), np.zeros(tower.nodes.size)
    scene = Scene(
        tower.nodes.shape[1], len(string), len(bar), pointer(string), pointer(bar), pointer(mass),
        0.0 if law is None else STIFFNESS, pointer(force),
    )  # fmt: skip
    kept = string, bar, mass, force
    out = np.zeros(len(at[0]))

    def run(count=repeats):
        assert kept  # the scene holds addresses only
        arrays = (pointer(array) for array in (*at, out))
        return yardstick.time_yardstick(ctypes.byref(scene), *arrays, count)

    run(1)
    return run, out


def time_core(yardstick, core, at, repeats):
    """Return what times the slope of the core, called from C, and its result."""
    x, u, taut = at
    out, work, drive = np.zeros(len(x)), np.zeros(core.work_size), core.drive(u)

    def run(count=repeats):
        arrays = (pointer(array) for array in (x, taut, out, work))
        scene = ctypes.byref(core.scene), ctypes.byref(drive)
        return yardstick.time_core(core.core.tc_slope, *scene, *arrays, count)

    run(1)
    return run, out


def time_graph(slope, at, repeats):
    """Return what times a function in CasADi's virtual machine, looped inside it, and its result.

    The virtual machine is slow enough for a tenth of the evaluations.
    """
    count = max(1, repeats // 10)
    evaluate = Evaluator(slope.map(count) if count > 1 else slope)
    columns = [np.tile(array[:, None], count) if count > 1 else array for array in at]
    out = evaluate(*columns)[0]

    def run():
        began = perf_counter()
        evaluate._run()
        return (perf_counter() - began) / count

    return run, out[:, 0] if count > 1 else out


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


if __name__ == "__main__":
    main()
