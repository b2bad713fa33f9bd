"""The cheapest run of each program that reaches an error, timed in turns.

Each program is run at settings of a fine grid, from coarse to fine; finer ones cost more. For each
error the coarsest run that reaches it is taken, so a lucky one counts for its program. These runs
are then repeated in turns, so that a machine that slows down does so for all, and the processor
time of all threads is taken around each. What a program builds or compiles it has built before.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from statistics import median
from time import process_time
from typing import Any

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.measured_run import FINER
from tenscontrol.accuracy.peers import Peer, Solution
from tenscontrol.simulation import AccuracyWarning
from tenscontrol.tables import aligned
from tests.without_core import without_core

# By how much finer the next setting is: fine enough that a better one gains little.
FINER_STEP, FINER_TOLERANCE = 1.25, 10**0.25


@dataclass(frozen=True, eq=False)
class Program:
    """What integrates the motion, at settings from coarse to fine.

    ``prepare(setting)`` builds all that is built once and returns what is timed; ``nodes`` finds
    the nodes in what that returns, ``judge`` their error; the one that all have if not given.
    """

    name: str
    settings: Sequence[float]
    prepare: Callable[[float], Callable[[], Any]]
    nodes: Callable[[Any], np.ndarray] = np.asarray
    judge: Callable[[np.ndarray], float] | None = None


@dataclass(frozen=True, eq=False)
class Row:
    """The cheapest run of a program that reaches ``error``, m.

    ``ratio`` is its time over that of the first program: the median of those of each turn.
    """

    error: float
    name: str
    setting: float
    reached: float
    seconds: float
    ratio: float


def grid(coarsest: float, finest: float, factor: float = FINER_STEP) -> tuple[float, ...]:
    """Return settings from the coarsest to one that is no coarser than the finest."""
    count = int(np.ceil(np.log(coarsest / finest) / np.log(factor) - 1e-9))
    return tuple(float(coarsest / factor**k) for k in range(count + 1))


def tolerances(coarsest: float = 0.1, finest: float = 1e-12) -> tuple[float, ...]:
    """Return tolerances, four a power of ten."""
    return grid(coarsest, finest, FINER_TOLERANCE)


def reported(
    programs: Sequence[Program],
    judge: Callable[[np.ndarray], float],
    errors: Sequence[float],
    repeats: int,
    longest: float = np.inf,
) -> list[Row]:
    """Print and return the cheapest run of each program for each error, over the first program."""
    rows = list(cheapest(programs, judge, errors, repeats, longest))
    cells = [
        [f"{r.error:.0e}", r.name, f"{r.setting:.3g}", f"{r.reached:.1e}", f"{1e3 * r.seconds:.4g}",
         f"{r.ratio:.3g}"]
        if np.isfinite(r.seconds)
        else [f"{r.error:.0e}", r.name, "-", "not reached", "-", "-"]
        for r in rows
    ]  # fmt: skip
    print(aligned(["error", "program", "setting", "has", "ms", "over the first"], cells, left=2))
    return rows


def cheapest(
    programs: Sequence[Program],
    judge: Callable[[np.ndarray], float],
    errors: Sequence[float],
    repeats: int,
    longest: float = np.inf,
) -> Iterator[Row]:
    """Yield the cheapest run of each program for each error; ``judge`` tells the error of nodes.

    A program whose run takes longer than ``longest``, s of processor time, gets no finer settings.
    """
    points = {program.name: _points(program, judge, min(errors), longest) for program in programs}
    chosen = {
        (error, name): next((point for point in some if point[1] <= error), None)
        for error in errors
        for name, some in points.items()
    }
    runs = {id(point): point[2] for point in chosen.values() if point is not None}
    taken: dict[int, list[float]] = {key: [] for key in runs}
    for _ in range(repeats):
        for key, run in runs.items():
            taken[key].append(seconds_of(run))
    for (error, name), point in chosen.items():
        first = chosen[error, programs[0].name]
        if point is None:
            yield Row(error, name, np.nan, np.nan, np.nan, np.nan)
            continue
        ratio = np.nan
        if first is not None:
            pairs = zip(taken[id(point)], taken[id(first)], strict=True)
            ratio = median(other / own for other, own in pairs)
        yield Row(error, name, point[0], point[1], median(taken[id(point)]), ratio)


def _points(
    program: Program, judge: Callable[[np.ndarray], float], finest: float, longest: float
) -> list[tuple[float, float, Callable[[], Any]]]:
    """Return setting, error and run of a program, until the finest error is reached."""
    points = []
    for setting in program.settings:
        run = program.prepare(setting)
        began = process_time()
        # A peer, and a run that diverges, say by an error that the setting is too coarse.
        with suppress(ArithmeticError, ValueError, RuntimeError):
            error = (program.judge or judge)(program.nodes(run()))
            if not np.isfinite(error):
                continue
            points.append((setting, error, run))
            is_long = process_time() - began > longest and seconds_of(run) > longest
            if error <= finest or is_long:
                break
    return points


def seconds_of(run: Callable[[], Any]) -> float:
    """Return the processor time of a call, s."""
    began = process_time()
    run()
    return process_time() - began


# ---- programs ----


def farthest(true: np.ndarray) -> Callable[[np.ndarray], float]:
    """Return what judges nodes, shape (d, n, T): their largest distance from the true ones, m."""
    return lambda nodes: float(np.linalg.norm(nodes - true, axis=0).max())


def ours(
    make: Callable[[], tc.Scene], times: np.ndarray, settings: Sequence[float], **options: Any
) -> list[Program]:
    """Return the default call, the same without an estimate of the error, and without the core.

    All is given that says what is simulated, and beside it the tolerance alone. So a run returns
    1,001 states, of which those at ``times`` are judged.
    """
    return [
        default_call("tenscontrol, default call", make, times, settings, **options),
        default_call("tenscontrol, no estimate", make, times, settings, error="none", **options),
        default_call(
            "tenscontrol, without the core", make, times, settings, without_core, **options
        ),
    ]


def default_call(
    name: str,
    make: Callable[[], tc.Scene],
    times: np.ndarray,
    settings: Sequence[float],
    around: Callable[[], AbstractContextManager[object]] = nullcontext,
    **options: Any,
) -> Program:
    """Return ``tc.simulate`` of a scene by its tolerance; ``around`` it another environment."""

    def prepare(tolerance: float) -> Callable[[], tc.Trajectory]:
        def run() -> tc.Trajectory:
            with around(), warnings.catch_warnings(action="ignore", category=AccuracyWarning):
                return tc.simulate(
                    scene.model, scene.duration, velocities=scene.velocities,
                    rest_length=scene.input_value, tolerance=tolerance, **options,
                )  # fmt: skip

        return run

    def nodes(run: tc.Trajectory) -> np.ndarray:
        return run.nodes[:, :, np.searchsorted(run.time, times - 1e-9 * scene.duration)]

    with around():
        scene = make()
    return Program(name, settings, prepare, nodes)


def peer(rival: Peer, case: tc.Scene, times: np.ndarray) -> Program:
    """Return a peer of the package; one with a law of its own is judged by its own motion."""

    def prepare(setting: float) -> Callable[[], Solution]:
        return rival.prepare(case, setting, times)

    judge = None
    if rival.own_law(case) is not None:
        judge = farthest(prepare(min(rival.settings) / FINER)().nodes)
    return Program(rival.name, rival.settings, prepare, lambda motion: motion.nodes, judge)
