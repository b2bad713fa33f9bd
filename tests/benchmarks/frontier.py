"""Which method needs the least work for an error: random scenes, library structures, long runs.

Run: ``python -m tests.benchmarks.frontier [--count 20] [--seed 0] [--cells]``. Each
motion is run by each method at settings from coarse to fine, without an estimate of the error,
until a run takes more than ``--limit`` s of processor time. Errors are the largest distance of a
node at 20 times from a reference, as part of the size. References of the random scenes come from
the oracle and are kept in ``--cache``; those of the library structures from
``accuracy.converged_motion``. In the long runs, 300 periods of the fastest vibration without loss,
the error is that of the energy as part of what the motion exchanges.

A cell is a motion and an error of 1e-2 to 1e-8. The method that reaches the error with the least
work is best in the cell. For each kind of motion, and for processor time and evaluations apart, the
table prints for each method in how many cells it is best, and there the work of the best other
method over its own: the median and the largest. ``--cells`` prints every cell.
"""

from __future__ import annotations

import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import process_time

import numpy as np

import tenscontrol as tc
from tenscontrol.accuracy.converged_motion import converged_motion
from tenscontrol.accuracy.open_loop import fastest_rate
from tenscontrol.integrate.methods import METHODS
from tenscontrol.simulation import AccuracyWarning, SimulationError
from tests.benchmarks import error_against_time
from tests.benchmarks.command_line import options
from tests.random_scenes import Scene, random_scene
from tests.references import (
    TIMES,
    TimeLimitError,
    default_folder,
    error_between,
    places,
    reference,
    time_limit,
)

ERRORS = tuple(10.0**-k for k in range(2, 9))

# Settings from coarse to fine: angles that the fastest vibration turns through in a step, rad, and
# tolerances.
ANGLES = tuple(2.0**-k for k in range(-1, 9))
TOLERANCES = tuple(10.0**-k for k in range(3, 13))

# An error below so many times that of the reference is not resolved.
RESOLVED = 3.0

# Runs are repeated for so long, s: clocks of processor time are coarse.
SHORT = 0.05

# Processor time after which a run is given up, s.
LONGEST = 3.0

PERIODS = 300

LIMITS = tc.HealthLimits(penetration=None, crossings=None)


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion to be measured: ``run(**options)`` simulates it, ``error(run)`` judges that.

    ``rate`` is the fastest, rad/s; ``floor`` the least error that is resolved.
    """

    name: str
    kind: str
    rate: float
    run: Callable[..., tc.Trajectory]
    error: Callable[[tc.Trajectory], float]
    floor: float


@dataclass(frozen=True)
class Point:
    """What a method needs for an error at one setting."""

    error: float
    seconds: float
    evaluations: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    given = options(
        __doc__, arguments, count=20, seed=0, library=20, cache=str(default_folder()), limit=0.2,
        cells=False, methods=tuple(METHODS),
    )  # fmt: skip
    cells: dict[str, dict[str, list[dict[str, float]]]] = defaultdict(lambda: defaultdict(list))
    for motion in motions(given):
        points = {
            label: measured(motion, name, setting, given.limit)
            for label, name, setting in ways(given.methods)
        }
        for error in ERRORS:
            if error < RESOLVED * motion.floor:
                continue
            for work in ("seconds", "evaluations"):
                cell = {name: least(some, error, work) for name, some in points.items()}
                cell = {name: value for name, value in cell.items() if np.isfinite(value)}
                cells[work][motion.kind].append(cell)
                if given.cells and work == "seconds":
                    print_cell(motion, error, cell)
    for work, kinds in cells.items():
        print(f"least {work}")
        for kind, some in kinds.items():
            print_kind(kind, some)


def ways(methods: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield each method with each of its settings: a label, its name and the setting."""
    for name in methods:
        for setting in METHODS[name].settings:
            several = len(METHODS[name].settings) > 1
            yield f"{name}, {setting}" if several else name, name, setting


# ---- motions ----


def motions(given) -> Iterator[Motion]:
    """Yield the random scenes that have a reference, the library structures and the long runs."""
    for seed in range(given.seed, given.seed + given.count):
        scene = random_scene(seed)
        known = reference(scene, given.cache)
        if known.status == "ok" and known.is_certain_to_the_end:
            yield random_motion(scene, known)
    for case, kind in list(library_cases())[: given.library]:
        yield library_motion(case, kind)
    for case, _ in list(conservative_cases())[: given.library]:
        yield long_motion(case)


def random_motion(scene: Scene, known) -> Motion:
    """Return the motion of a random scene, of which the reference is known to the end."""
    case = tc.Scene(
        scene.model, scene.duration, velocities=scene.velocities, **{scene.input: scene.value}
    )  # fmt: skip
    where = "on ground" if scene.ground else "in the air"
    damped = "damped" if case.equation().velocity_dependent else "no loss"

    def error(run: tc.Trajectory) -> float:
        nodes = run.nodes[:, :, places(run.time, known.times)]
        return float(error_between(scene, nodes, known.nodes).max())

    step = scene.duration / TIMES
    return Motion(
        f"scene {scene.seed}", f"random {where}, {damped}", fastest_rate(case),
        partial(scene.simulate, output_step=step, limits=LIMITS), error, known.certain_to.max(),
    )  # fmt: skip


def library_motion(case: tc.Scene, kind: str) -> Motion:
    """Return a motion with a reference from SciPy."""
    known = converged_motion(case, TIMES)

    def error(run: tc.Trajectory) -> float:
        apart = np.linalg.norm(run.nodes[:, :, 1:] - known.nodes, axis=0)
        return float(apart.max() / case.size)

    run = partial(simulated, case, output_step=case.duration / TIMES)
    return Motion(case.name, kind, fastest_rate(case), run, error, known.error / case.size)


def long_motion(case: tc.Scene) -> Motion:
    """Return some hundred periods, judged by the energy."""
    rate = fastest_rate(case)
    case = replace(case, duration=2 * np.pi * PERIODS / rate)

    def error(run: tc.Trajectory) -> float:
        return float(run.health.energy_error or 0.0)

    run = partial(simulated, case, output_step=case.duration / PERIODS)
    return Motion(case.name, "long run, energy", rate, run, error, 0.0)


def simulated(case: tc.Scene, **options) -> tc.Trajectory:
    """Simulate a case."""
    options[case.input] = case.input_value
    return tc.simulate(
        case.model, case.duration, case.nodes, case.velocities, limits=LIMITS, **options
    )


def library_cases() -> Iterator[tuple[tc.Scene, str]]:
    """Yield cases in the air and on ground, with strings that are soft, stiff and damped."""
    yield from conservative_cases()
    for stiffness in (1e5, 1e7):
        yield prism(stiffness, 0.3), "library in the air, stiff"
    for stiffness, damping in ((1e6, 100.0), (1e4, 1e4)):
        yield prism(stiffness, 2.0, damping), "library in the air, stiff and damped"
    for ground, loss in ((5e3, 0.3), (5e3, 0.0), (1e6, 0.3)):
        kind = "library on ground" + (", stiff" if ground > 1e4 else "")
        yield drop(ground, loss), kind


def conservative_cases() -> Iterator[tuple[tc.Scene, str]]:
    """Yield cases without loss, whose energy is a constant."""
    kind = "library in the air"
    yield error_against_time.prism(5.0), kind
    yield error_against_time.prism(2.0, 4), kind
    for stiffness in (100.0, 1e4):
        yield tumbling_ball(stiffness), kind
    yield tower(), kind


def prism(stiffness: float, duration: float, damping: float = 0.0) -> tc.Scene:
    """A prism let go with a tenth too little force in its vertical strings, turning."""
    structure = tc.prism()
    gamma = 10.0 * np.repeat([1.0, 1.0, 0.9 * np.sqrt(3)], 3)
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness, damping))
    lengths = tc.to_rest_length(model, structure.nodes, gamma).rest_length
    spin = np.cross([0.0, 0.0, 1.0], structure.nodes.T).T
    name = f"prism, {stiffness:g} N/m, {damping:g} N s/m"
    return tc.Scene(
        model, duration, velocities=spin, rest_length=lengths, name=name
    )  # fmt: skip


def tumbling_ball(stiffness: float) -> tc.Scene:
    """A six-bar ball of which a third of the strings are wound in."""
    ball = tc.library.six_bar_ball()
    lengths = ball.string_length()
    lengths[::3] *= 0.9
    model = tc.Model(ball, strings=tc.LinearStrings(stiffness))
    name = f"ball, {stiffness:g} N/m"
    return tc.Scene(model, 2.0, rest_length=lengths, name=name)


def tower() -> tc.Scene:
    """A tower of prisms that share nodes, let go from its shape with strings wound in."""
    structure = tc.library.class2_tower()
    lengths = structure.string_length()
    lengths[::2] *= 0.95
    model = tc.Model(structure, strings=tc.LinearStrings(100.0))
    return tc.Scene(model, 2.0, rest_length=lengths, name="class-2 tower")


def drop(stiffness: float, loss: float) -> tc.Scene:
    """A six-bar ball dropped from 0.1 m; with loss the ground is damped and rough."""
    ball = tc.library.six_bar_ball()
    ground = tc.Ground(
        stiffness, damping=loss, friction=0.5 if loss else 0.0, slip_speed=0.01,
        height=ball.nodes[2].min() - 0.1,
    )  # fmt: skip
    model = tc.Model(ball, strings=tc.LinearStrings(1e3), gravity=[0, 0, -9.81], ground=ground)
    name = f"drop, {stiffness:g} N/m, damping {loss:g}"
    return tc.Scene(model, 0.5, rest_length=0.95 * ball.string_length(), name=name)


# ---- measurement ----


def measured(motion: Motion, method: str, setting: str, limit: float) -> list[Point]:
    """Return points of a method from coarse to fine, until a run takes longer than the limit."""
    fixed = setting == "step"
    values = [angle / motion.rate for angle in ANGLES] if fixed else TOLERANCES
    points = []
    is_first = True
    for value in values:
        options = {"method": method, setting: value, "error": "none"}
        begin = process_time()
        with warnings.catch_warnings(), time_limit(LONGEST):
            warnings.simplefilter("ignore", AccuracyWarning)
            try:
                if is_first:  # builds functions
                    motion.run(**options)
                    is_first, begin = False, process_time()
                run, seconds = timed(partial(motion.run, **options))
            except (SimulationError, ValueError):  # the setting is too coarse
                if process_time() - begin > LONGEST / 2:
                    break
                continue
            except (TimeLimitError, SystemError, RuntimeError):  # CasADi hides the first
                break
        points.append(Point(motion.error(run), seconds, float(run.evaluations)))
        if seconds > limit:
            break
    return points


def timed(call: Callable[[], tc.Trajectory]) -> tuple[tc.Trajectory, float]:
    """Return a run and its mean processor time, s."""
    count, begin = 0, process_time()
    while not count or process_time() - begin < SHORT:
        run = call()
        count += 1
    return run, (process_time() - begin) / count


def least(points: Sequence[Point], error: float, work: str) -> float:
    """Return the least work of a run with no more than this error; infinite where there is none."""
    return min((getattr(p, work) for p in points if p.error <= error), default=np.inf)


# ---- tables ----


def print_cell(motion: Motion, error: float, cell: dict[str, float]) -> None:
    """Print the work of each method that reaches an error, least first."""
    order = sorted(cell, key=cell.__getitem__)
    text = ", ".join(f"{name} {1e3 * cell[name]:.3g}" for name in order)
    print(f"{motion.kind}: {motion.name}, {error:.0e}: ms {text}")


def print_kind(kind: str, cells: Sequence[dict[str, float]]) -> None:
    """Print in how many cells each method is best, and by how much."""
    print(f"  {kind}: {len(cells)} cells, {sum(not cell for cell in cells)} reached by none")
    gains: dict[str, list[float]] = defaultdict(list)
    for cell in filter(None, cells):
        best, *others = sorted(cell, key=cell.__getitem__)
        gains[best].append(cell[others[0]] / cell[best] if others else np.inf)
    for name, some in sorted(gains.items(), key=lambda item: -len(item[1])):
        print(f"    {name:26s} best in {len(some):4d}, the next takes "
              f"{np.median(some):6.2f} times as much, at most {max(some):6.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
