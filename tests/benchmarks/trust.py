"""Is a run ever wrong without a warning? Random scenes against an independent oracle.

Run: ``python -m tests.benchmarks.trust --count 1000 [--seed 0] [--jobs 2]``. Needs a C compiler.

Each scene is run by the default call, by dop853 and cvodes, and by each method with fixed steps at
three steps, with outputs None, T/5 and T/2 in turn (``--every`` takes all three of each,
``--settings`` prints a line for each). Its
reference is the oracle's motion at 20 times, judged where oracle and tight run agree to 1e-3 of the
size; references are kept in ``--cache``. A run is wrong if it is off by more than 1 % of the size
where ``run.trusted_until`` trusts it, or at the last time that can be judged. The columns:

- runs: judged; stopped: ended by an error, with a message
- silent: wrong without a warning; early: wrong before ``trusted_until``, though it warns
- caught: wrong, and warns; false: warns, of those right to 1e-3
- low: error above 3 × estimate, of those with an error above round-off; no estimate counts as 0
- estimate / error at 5, 50 and 95 %, of the same

Then ``--auto`` compares the processor time of the default call with that of the best right method,
``--implicit 500`` counts where energy_momentum fails and cvodes is right, and ``--cost`` measures
what the estimate costs. ``--scene 7`` prints every run of one scene.
"""

from __future__ import annotations

import inspect
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from time import process_time

import numpy as np

import tenscontrol as tc
from tenscontrol.interrupt import InterruptionWarning
from tenscontrol.progress import progress_bar
from tenscontrol.simulation import AccuracyWarning, SimulationError
from tests.benchmarks.command_line import options
from tests.random_scenes import Scene, random_scene
from tests.references import (
    TIMES,
    Reference,
    TimeLimitError,
    default_folder,
    error_between,
    places,
    reference,
    time_limit,
)

WRONG, RIGHT = 1e-2, 1e-3

#: Above the lines of :func:`row`.
HEADER = (
    "method                       runs stopped        silent early caught"
    "         false           low  estimate / error at 5, 50, 95 %  s a run"
)

# Errors are compared with estimates where they are above this, as part of the size, and so many
# times above what the reference is certain to.
_ROUND_OFF, _ABOVE = 1e-9, 10.0

_DEFAULT, _ADAPTIVE = "default call", ("dop853", "cvodes")
_FIXED = ("rk4", "rk4_plain", "energy_momentum")
_STEPS, _OUTPUTS = (200, 800, 3200), (None, 5, 2)

# Sinking deep into soft ground is no error of the integration.
_LIMITS = tc.HealthLimits(penetration=None, crossings=None)

# Processor time of one run, s.
_SECONDS = 60.0


@dataclass(frozen=True)
class Run:
    """A run, as judged: errors and estimates at the judged times, as part of the size."""

    seed: int
    method: str
    setting: str
    status: str
    warned: bool = False
    seconds: float = 0.0
    whole: bool = False  # judged to the end
    error: tuple[float, ...] = ()
    estimate: tuple[float, ...] = ()  # of each judged time, or of the last alone; empty if None
    clear: tuple[bool, ...] = ()  # errors above round-off and what the reference is certain to
    trusted: tuple[bool, ...] = ()
    note: str = ""

    @property
    def is_judged(self) -> bool:
        """Whether it ended, and there is a time at which it can be judged."""
        return self.status == "ok" and len(self.error) > 0

    @property
    def is_wrong(self) -> bool:
        """Whether it is off where it must not be."""
        return self.is_judged and (self.is_off_where_trusted or self.error[-1] > WRONG)

    @property
    def is_off_where_trusted(self) -> bool:
        """Whether it is off at a time at which the run says that it is right."""
        return any(e > WRONG and t for e, t in zip(self.error, self.trusted, strict=True))

    @property
    def ratios(self) -> list[float]:
        """Estimates over errors at the judged times, where both are meant."""
        if not self.estimate:  # none is as good as zero
            return [0.0] if self.whole and self.clear[-1] else []
        first = len(self.error) - len(self.estimate)
        pairs = zip(self.estimate, self.error[first:], self.clear[first:], strict=True)
        return [estimate / error for estimate, error, clear in pairs if clear]


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, count=1000, seed=0, jobs=1, cache=str(default_folder()),
        methods=(_DEFAULT, *_ADAPTIVE, *_FIXED), every=False, limit=_SECONDS, scene=(-1,),
        settings=False, auto=False, implicit=0, cost=False,
    )  # fmt: skip
    if given.scene[0] >= 0:
        for seed in given.scene:
            print_scene(seed, given.cache, given.methods, given.limit)
        return
    seeds = range(given.seed, given.seed + given.count)
    if given.auto:
        print_auto(seeds, given)
    elif given.implicit:
        print_implicit(range(given.seed, given.seed + given.implicit), given)
    elif given.cost:
        print_cost(seeds, given)
    else:
        print_trust(seeds, given)


# ---- the campaign ----


def print_trust(seeds: Sequence[int], given) -> None:
    """Print the table of all methods, and what failed."""
    tasks = [(seed, given.cache, tuple(given.methods), given.every, given.limit) for seed in seeds]
    runs: list[Run] = []
    states: dict[int, str] = {}
    for seed, state, found in mapped(judged_scene, tasks, given.jobs, "scenes"):
        states[seed] = state
        runs += found
    kinds = Counter(state.split(":")[0] for state in states.values())
    print(f"{len(states)} scenes: " + ", ".join(f"{n} {kind}" for kind, n in kinds.most_common()))
    print(HEADER)
    groups = [(m, [run for run in runs if run.method == m]) for m in given.methods]
    fixed = [run for run in runs if run.method in _FIXED]
    for name, some in [*groups, ("all with fixed steps", fixed)]:
        if some:
            print(row(name, some))
    for _, some in groups if given.settings else ():
        for setting in sorted({run.setting for run in some}):
            same = [run for run in some if run.setting == setting]
            print(row(f"{same[0].method} {setting}", same))
    print_failures(runs, given.methods, states)


def print_failures(runs: Sequence[Run], methods: Sequence[str], states: dict[int, str]) -> None:
    """Print the seeds of what is wrong, stopped or failed."""
    for title, chosen in (
        ("wrong without a warning", lambda run: run.is_wrong and not run.warned),
        (
            "wrong before trusted_until, though warned",
            lambda r: r.warned and r.is_off_where_trusted,
        ),
        ("ended by an error that says so", lambda run: run.status == "stopped"),
        ("failed otherwise, or took too long", lambda run: run.status in ("failed", "too long")),
    ):
        print(f"{title}:")
        for method in methods:
            seeds_of = sorted({r.seed for r in runs if r.method == method and chosen(r)})
            if seeds_of:
                print(f"  {method}: {' '.join(map(str, seeds_of))}")
    print("scenes without a reference:")
    for seed, state in states.items():
        if state != "ok":
            print(f"  {seed} {state}")
    for run in runs:
        if run.status == "failed" or (run.status == "stopped" and run.method not in _FIXED):
            print(f"{run.seed} {run.method} {run.setting}: {run.note}")


def row(name: str, runs: Sequence[Run]) -> str:
    """Return a line of the table."""
    judged = [run for run in runs if run.is_judged]
    stopped = sum(run.status != "ok" for run in runs)
    silent = sum(run.is_wrong and not run.warned for run in judged)
    early = sum(run.is_off_where_trusted and run.warned for run in judged)
    caught = sum(max(run.error) > WRONG and run.warned for run in judged)
    right = [run for run in judged if run.whole and max(run.error) < RIGHT]
    false = sum(run.warned for run in right)
    compared = [run.ratios for run in judged if run.ratios]
    low = sum(min(ratios) < 1 / 3 for ratios in compared)
    known = [ratios[-1] for ratios in compared if ratios[-1] > 0]
    spread = np.quantile(known, [0.05, 0.5, 0.95]) if known else [np.nan] * 3
    return (
        f"{name:27s} {len(judged):5d} {stopped:7d} {of(silent, len(judged))} {early:5d} "
        f"{caught:6d} {of(false, len(right))} {of(low, len(compared))} "
        + " ".join(f"{value:10.2g}" for value in spread)
        + f" {np.mean([run.seconds for run in runs]):8.2f}"
    )


def of(part: int, whole: int) -> str:
    """Return a count and its share."""
    return f"{part:5d} {100 * part / max(whole, 1):6.2f} %"


def judged_scene(
    task: tuple[int, str, Sequence[str], bool, float],
) -> tuple[int, str, list[Run]]:
    """Return the state of a scene's reference, and its runs."""
    seed, cache, methods, every, limit = task
    scene = random_scene(seed)
    found = reference(scene, cache)
    if found.status != "ok" or not len(found.judged):
        return seed, found.status if found.status != "ok" else "uncertain at once", []
    return seed, "ok", [
        judged_run(scene, found, method, setting, options, limit)
        for method in methods
        for setting, options in settings(scene, method, every)
    ]  # fmt: skip


def settings(scene: Scene, method: str, every: bool) -> Iterator[tuple[str, dict]]:
    """Yield the settings of a method and their names."""
    if method == _DEFAULT:
        yield "", {}
    elif method not in _FIXED:
        yield "1e-6", {"method": method, "tolerance": 1e-6}
    else:
        for i, count in enumerate(_STEPS):
            turn = (scene.seed + i) % len(_OUTPUTS)
            for parts in _OUTPUTS if every else _OUTPUTS[turn : turn + 1]:
                options = {"method": method, "step": scene.duration / count}
                if parts is not None:
                    options["output_step"] = scene.duration / parts
                yield f"T/{count}, outputs {'all' if parts is None else f'T/{parts}'}", options


def judged_run(
    scene: Scene, found: Reference, method: str, setting: str, given: dict, limit: float
) -> Run:
    """Run a scene and judge it."""
    begin = process_time()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            with time_limit(limit):
                run = scene.simulate(limits=_LIMITS, **given)
        except SimulationError as error:
            spent = process_time() - begin
            return Run(scene.seed, method, setting, "stopped", True, spent, note=str(error))
        except TimeLimitError:
            return Run(scene.seed, method, setting, "too long", False, process_time() - begin)
        except (ValueError, TypeError, ArithmeticError, RuntimeError) as error:
            note = f"{type(error).__name__}: {error}"
            spent = process_time() - begin
            return Run(scene.seed, method, setting, "failed", False, spent, note=note)
    if any(issubclass(each.category, InterruptionWarning) for each in told):
        raise KeyboardInterrupt
    spent = process_time() - begin
    warned = any(issubclass(each.category, AccuracyWarning) for each in told)
    kept = [
        k for k in found.judged if np.abs(run.time - found.times[k]).min() < 1e-9 * run.time[-1]
    ]
    if not kept:
        return Run(scene.seed, method, setting, "ok", warned, spent)
    at = places(run.time, found.times[kept])
    error = error_between(scene, run.nodes[:, :, at], found.nodes[:, :, kept])
    until = getattr(run, "trusted_until", None)
    by_time = getattr(run, "error", None)
    whole = kept[-1] == TIMES
    if by_time is not None:
        estimate = np.asarray(by_time)[at]
    elif whole and run.position_error is not None:
        estimate = np.array([run.position_error])
    else:
        estimate = np.array([])
    clear = error > np.maximum(_ROUND_OFF, _ABOVE * found.certain_to[kept])
    trusted = found.times[kept] <= (-1.0 if until is None else until)
    note = "; ".join(str(each.message) for each in told)
    return Run(
        scene.seed, method, setting, "ok", warned, spent, whole, tuple(error.tolist()),
        tuple(estimate.tolist()), tuple(clear.tolist()), tuple(trusted.tolist()), note,
    )  # fmt: skip


def print_scene(seed: int, cache: str, methods: Sequence[str], limit: float) -> None:
    """Print every run of one scene."""
    scene = random_scene(seed)
    found = reference(scene, cache)
    print(f"{seed}: {scene.about()}")
    print(
        f"  reference {found.status}, {found.switches} switches, {len(found.judged)} of {TIMES} "
        f"times judged, certain to {found.certain_to[1]:.1e} … {found.certain_to[-1]:.1e}"
    )
    for run in judged_scene((seed, cache, methods, True, limit))[2]:
        last = f"off by {run.error[-1]:.1e} (largest {max(run.error):.1e})" if run.error else ""
        says = f"says {run.estimate[-1]:.1e}" if run.estimate else "no estimate"
        print(
            f"  {run.method:16s} {run.setting:20s} {run.status:8s} {run.seconds:6.2f} s  {last}, "
            f"{says}{', warned' if run.warned else ''} {run.note}"
        )


# ---- processor time ----


def print_auto(seeds: Sequence[int], given) -> None:
    """Print the processor time of the default call over that of the best right method."""
    tasks = [(seed, given.cache, given.limit) for seed in seeds]
    results = [each for each in mapped(timed_scene, tasks, given.jobs, "scenes") if each]
    slow = [each for each in results if each[1].status != "ok"]
    judged = [each for each in results if each[1].status == "ok" and np.isfinite(each[2])]
    print(f"{len(results)} scenes with a reference; default call over the best right method")
    ratios = np.array([first.seconds / best for _, first, best, _ in judged])
    if len(ratios):
        quantiles = np.quantile(ratios, [0.05, 0.5, 0.95, 1.0])
        print("ratio at 5, 50, 95 and 100 %: " + " ".join(f"{q:.2f}" for q in quantiles))
    worst = sorted(judged, key=lambda each: -each[1].seconds / each[2])[:10]
    for seed, first, best, name in worst:
        print(f"  {seed}: {first.seconds:.3f} s over {best:.3f} s of {name}")
    print(f"more than 3 times, and by more than 0.1 s: "
          f"{sum(f.seconds > max(3 * b, b + 0.1) for _, f, b, _ in judged)}")  # fmt: skip
    print(f"stopped, failed or too long: {len(slow)}")
    for seed, first, best, name in slow:
        print(f"  {seed}: {first.status} after {first.seconds:.1f} s, {name} {best:.3f} s")


def timed_scene(task: tuple[int, str, float]) -> tuple[int, Run, float, str] | None:
    """Return the default run, and the time and name of the best right method (inf if none)."""
    seed, cache, limit = task
    scene = random_scene(seed)
    found = reference(scene, cache)
    if found.status != "ok" or not len(found.judged):
        return None

    def timed(method: str, given: dict) -> Run:
        run = judged_run(scene, found, method, "", given, limit)
        # The first call builds functions; short ones are timed again.
        if run.status == "ok" and run.seconds < 2.0:
            run = judged_run(scene, found, method, "", given, limit)
        return run

    first = timed(_DEFAULT, {})
    others = [timed(name, {"method": name, "tolerance": 1e-6})
              for name in ("dop853", "cvodes", "energy_momentum")]  # fmt: skip
    right = [run for run in others if run.is_judged and run.error[-1] <= WRONG]
    best = min(right, key=lambda run: run.seconds, default=None)
    return (seed, first, *((np.inf, "none right") if best is None else (best.seconds, best.method)))


def print_implicit(seeds: Sequence[int], given) -> None:
    """Print where energy_momentum fails although cvodes is right."""
    tasks = [(seed, given.cache, given.limit) for seed in seeds]
    done = list(mapped(implicit_scene, tasks, given.jobs, "scenes"))
    results = [each for each in done if each]
    print(f"cvodes is right on {len(results)} of {len(done)} scenes")
    for setting in ("T/400", "1e-6"):
        some = [run for runs in results for run in runs if run.setting == setting]
        failed = [run for run in some if run.status != "ok"]
        print(f"energy_momentum, {setting}: {len(failed)} of {len(some)} do not end")
        for run in failed:
            print(f"  {run.seed}: {run.status} after {run.seconds:.1f} s: {run.note}")


def implicit_scene(task: tuple[int, str, float]) -> list[Run] | None:
    """Return two runs of energy_momentum, or None where cvodes is not right."""
    seed, cache, limit = task
    scene = random_scene(seed)
    found = reference(scene, cache)
    if found.status != "ok" or not len(found.judged):
        return None
    by_cvodes = {"method": "cvodes", "tolerance": 1e-6}
    known = judged_run(scene, found, "cvodes", "", by_cvodes, limit)
    if not known.is_judged or known.error[-1] > WRONG:
        return None
    return [
        judged_run(scene, found, name, setting, {"method": name, **options}, limit)
        for name in ("energy_momentum",)
        for setting, options in (
            ("T/400", {"step": scene.duration / 400}), ("1e-6", {"tolerance": 1e-6}),
        )
    ]  # fmt: skip


def print_cost(seeds: Sequence[int], given) -> None:
    """Print the processor time of runs over that of the same without an estimate."""
    if "error" not in inspect.signature(tc.simulate).parameters:
        print("simulate cannot leave its estimate out")
        return
    tasks = [(seed, tuple(given.methods), given.limit) for seed in seeds]
    ratios: dict[str, list[float]] = {}
    for found in mapped(costs, tasks, given.jobs, "scenes"):
        for method, ratio in found:
            ratios.setdefault(method, []).append(ratio)
    print("processor time over that without an estimate, at 5, 50, 95 %")
    for method, some in ratios.items():
        spread = np.quantile(some, [0.05, 0.5, 0.95])
        print(f"{method:16s} {len(some):5d} runs  " + " ".join(f"{q:.2f}" for q in spread))


def costs(task: tuple[int, Sequence[str], float]) -> list[tuple[str, float]]:
    """Return the ratio of each method at its middle step, or its tolerance."""
    seed, methods, limit = task
    scene, found = random_scene(seed), []
    for method in methods:
        given = {} if method == _DEFAULT else {"method": method}
        if method in _FIXED:
            given["step"] = scene.duration / _STEPS[1]
        times = [spent(scene, given | more, limit) for more in ({}, {"error": "none"})]
        if np.isfinite(times).all() and times[1] > 0.01:
            found.append((method, times[0] / times[1]))
    return found


def spent(scene: Scene, given: dict, limit: float) -> float:
    """Return the processor time of a run, the smallest of three, after one that builds."""
    times = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(4):
            begin = process_time()
            try:
                with time_limit(limit):
                    scene.simulate(**given)
            except (SimulationError, ValueError, TimeLimitError):
                return np.inf
            times.append(process_time() - begin)
    return min(times[1:])


def mapped(function: Callable, tasks: Sequence, jobs: int, label: str) -> Iterable:
    """Yield the results of the tasks in their order, from so many processes, with a bar.

    Ctrl-C ends it, so that a long campaign ends with the table of what is done.
    """
    pool = ProcessPoolExecutor(jobs) if jobs > 1 else None
    shown = progress_bar(len(tasks), shown=True, label=label, unit="scenes")
    try:
        with shown as report, suppress(KeyboardInterrupt):
            results = map(function, tasks) if pool is None else pool.map(function, tasks)
            for done, result in enumerate(results, 1):
                yield result
                report(done)
    finally:
        if pool is not None:
            pool.shutdown(cancel_futures=True)


if __name__ == "__main__":
    main()
