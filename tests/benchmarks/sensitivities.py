"""Derivatives of runs against central differences of the simulator, on random scenes.

Run: ``python -m tests.benchmarks.sensitivities [--judged 100] [--count 300] [--seed 0]
[--steps 3000] [--implicit] [--motors] [--processes 2]``.

Scenes follow one another until so many are judged, or so many were tried. A third of them has
inputs that change: profiles that are held, straight or cubic. Each is run at a tolerance of 1e-12
and differentiated along one random direction of all that it depends on: input, laws of strings and
ground, masses, gravity and load. ``--implicit`` takes 200 steps of the energy-momentum method in
its place, and differences of the same steps. Beside it are central differences of order 4 at
smaller and smaller sizes of the change, of runs with as many switches. Of two sizes that follow one
another, those that differ least are the reference, and their difference is what it is certain to.
Sizes end where that is 1e-10, or below 1e-7 and growing. Where the derivative is off by more than
1e-7, differences of runs at ten times the tolerance are beside them, and of runs in shorter steps
where stability limits these: they are certain to how far any two are apart, too. A scene is judged
where that is below 1e-7. Scenes are left out whose run has
more steps, or that of a neighbour more than twice as many: the runs end there. ``--motors`` winds
the strings of the scenes by motors under a command of the time: with limits of torque and speed,
inertia, lag and play, some with two strings on a drum, and strings that no motor drives. Their
numbers are in the direction, and runs whose motors meet limits in other samples are no neighbours.
The columns:

- error: of the derivative of the nodes at the end, as part of the largest; certain: that of the
  differences; adjoint: of the slope of a cost of nodes and velocities, by both ways

Then the kinds of scenes that were judged, with counts, and what was left out, and why.
"""

from __future__ import annotations

import os
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import partial
from multiprocessing import get_context
from time import perf_counter
from unittest.mock import patch

import casadi as ca
import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics.machine_code import VARIABLE
from tenscontrol.integrate import dop853
from tenscontrol.integrate.integrator import IntegrationPause
from tenscontrol.simulation.health_check import AccuracyWarning
from tests.benchmarks.command_line import options
from tests.random_scenes import Scene, random_scene, stiffness_of

TOLERANCE = 1e-12
STEPS = 200
SAMPLES = 8
KINDS = (
    {"jumps"}, {"jumps", "rate"}, {"ramps"}, {"ramps", "speed", "play"}, {"ramps", "lag"},
    {"jumps", "lag", "inertia"}, {"ramps", "inertia"}, {"ramps", "inertia", "speed", "play"},
    {"ramps", "lag", "rate", "play"},
)  # fmt: skip
SIZES = 10.0 ** -np.arange(3.5, 8, 0.5)

# Differences that are certain to the first are good enough; beyond the second nothing is judged.
CERTAIN, JUDGED = 1e-10, 1e-7

# Where both ways differ by more than the first, what a change by the second makes of one of them
# says how much of that is round-off.
ADJOINT, ROUND_OFF = 1e-10, 1e-15

# Evaluations after which a run ends, for each step that it may have: 12 and those of rejected ones.
EVALUATIONS = 24

_OF_GROUND = "stiffness", "damping", "friction", "height"

Direction = dict[str, np.ndarray | float]


@dataclass(frozen=True)
class Comparison:
    """How far a derivative is from differences, and a gradient from the derivative."""

    seed: int
    kinds: tuple[str, ...]
    steps: int
    switches: int
    error: float
    certain: float
    adjoint: float
    round_off: float  # of the derivative of the cost; found where adjoint is large
    seconds: float
    run_seconds: float

    @property
    def is_judged(self) -> bool:
        """Whether differences are certain enough to tell."""
        return self.certain < JUDGED

    @property
    def is_wrong(self) -> bool:
        """Whether the derivative is off by more than differences are."""
        return self.is_judged and self.error > JUDGED + 3 * self.certain


@dataclass(frozen=True)
class Wound:
    """A scene whose strings are wound by motors."""

    scene: Scene
    winches: tc.Winches
    sway: np.ndarray  # of the command of each string, m
    phase: np.ndarray
    actuated: dict | None

    def __getattr__(self, name: str):
        return getattr(self.scene, name)

    def simulate(self, **options) -> tc.Trajectory:
        """Run the scene by the package; its value are rest lengths at the start."""
        scene, start, sample = self.scene, self.scene.value, self.scene.duration / SAMPLES

        def command(time, nodes, velocities):
            return law.actuation.inputs(start + self.sway * np.sin(2 * time / sample + self.phase))

        low = np.full(len(start), 1e-9 * scene.size)
        law = tc.FunctionController(
            scene.structure, command, input="rest_length", sample_time=sample, low=low,
            actuated=self.actuated, equilibrium_input=start,
        )  # fmt: skip
        return tc.simulate(
            scene.model, scene.duration, velocities=scene.velocities, controller=law,
            winches=self.winches, rest_length=start, **options,
        )  # fmt: skip


@dataclass(frozen=True)
class Driven:
    """A scene whose input changes in time."""

    scene: Scene
    profile: tc.Profile

    def __getattr__(self, name: str):
        return getattr(self.scene, name)

    @property
    def value(self) -> np.ndarray:
        """Values of the profile, (α, K)."""
        return self.profile.values

    def simulate(self, **options) -> tc.Trajectory:
        """Run the scene by the package."""
        return replace(self.scene, value=self.profile).simulate(**options)


AnyScene = Scene | Wound | Driven


def driven(scene: Scene, random: np.random.Generator) -> Driven:
    """Return a scene with a random profile."""
    kind = ("hold", "linear", "cubic")[int(random.integers(3))]
    times = np.linspace(0, scene.duration, int(random.integers(2, 7)), endpoint=kind != "hold")
    sway = 10 ** random.uniform(-2, -0.7, len(scene.value))
    parts = 1 + sway[:, None] * random.uniform(-1, 1, (len(sway), len(times)))
    return Driven(scene, tc.Profile(times, scene.value[:, None] * parts, kind))


def wound(scene: Scene, random: np.random.Generator) -> Wound:
    """Return a scene with random motors."""
    count, length = len(scene.structure.strings), scene.structure.string_length()
    if scene.input == "force_density":
        scene = replace(scene, input="rest_length", value=length * random.uniform(0.8, 1.02, count))
    start, sample = scene.value, scene.duration / SAMPLES
    actuated, several = None, count > 2 and random.random() < 0.4
    if several:
        first, second, *others = random.permutation(count).tolist()
        ratio = float(random.choice([-1.0, 1.0]) * random.uniform(0.5, 2.0))
        actuated = {"pair": {first: 1.0, second: ratio}}
        actuated |= {f"motor_{i}": [i] for i in others[: len(others) // 2 + 1]}

    def around(low: float, high: float) -> np.ndarray:
        return 10 ** random.uniform(low, high, count)

    # The most that a string moves by, and what pulls then.
    sway = start * around(-2, -1)
    pull = stiffness_of(scene.strings, start) * np.maximum(np.abs(length - start), sway)
    torque, radius, gear = pull * around(-0.5, 0.7), length * around(-3, -2), around(0, 2)
    lever = radius / gear
    kind = KINDS[int(random.integers(len(KINDS)))]
    numbers = {"torque": torque * lever}
    if "speed" in kind or random.random() < 0.3:
        numbers["speed"] = sway / sample * around(-0.3, 0.7) / lever
    if "lag" in kind:
        numbers["lag"] = sample * around(-1, 0)
    if "inertia" in kind:
        numbers["inertia"] = lever**2 * torque * sample**2 / sway * around(-1.5, 0.5)
    if "play" in kind:
        numbers["backlash"] = sway * around(-1.5, -0.5) / radius
    rate = sway / sample * around(-0.3, 0.7) if "rate" in kind and not several else None
    steps = None if "jumps" in kind else int(random.integers(2, 8))
    winches = tc.Winches(
        rate=rate, substeps=steps, motor=tc.Motor(drum_radius=radius, gear_ratio=gear, **numbers)
    )
    return Wound(scene, winches, sway, random.uniform(0, 2 * np.pi, count), actuated)


class TooLongError(Exception):
    """A run of a scene, or of a neighbour, that has more steps than it may."""

    def __init__(self, most_steps: int) -> None:
        super().__init__(f"a run of more than {most_steps} steps")


def run_of(
    scene: AnyScene, most_steps: int, implicit: bool = False, tolerance: float = TOLERANCE,
    is_shortened: bool = False,
) -> tc.Trajectory:  # fmt: skip
    """Return the motion of a scene, tight, or in so many implicit steps.

    Or in steps that are shorter where stability limits them.
    """
    limits = tc.HealthLimits(crossings=None, rest_length_error=None)
    how = {"method": "dop853", "tolerance": tolerance}
    if implicit:
        how = {"method": "energy_momentum", "step": scene.duration / STEPS}
    rules = dop853.STEP_RULES[1:] * 2 if is_shortened else dop853.STEP_RULES
    limit = patch.object(dop853.DOP853, "limit", EVALUATIONS * most_steps)
    with limit, patch.object(dop853, "STEP_RULES", rules):
        try:
            run = scene.simulate(**how, error="none", limits=limits)
        except IntegrationPause as pause:
            raise TooLongError(most_steps) from pause
    if run.steps > most_steps:
        raise TooLongError(most_steps)
    return run


def random_direction(scene: AnyScene, random: np.random.Generator) -> Direction:
    """Return a direction of all that a scene depends on, each as part of its size."""
    law, structure = scene.strings, scene.structure
    found: Direction = {scene.input: scene.value * random.normal(size=scene.value.shape)}
    if scene.input == "rest_length":
        for field in fields(law):
            found[field.name] = getattr(law, field.name) * random.normal(size=len(scene.value))
    for name in ("bar_mass", "point_mass"):
        mass = getattr(structure, name)
        if mass.any():
            found[name] = mass * random.normal(size=len(mass))
    if scene.gravity is not None:
        found["gravity"] = np.linalg.norm(scene.gravity) * random.normal(size=len(scene.gravity))
    if scene.external_force is not None:
        load = scene.external_force
        found["external_force"] = np.abs(load).max() * random.normal(size=load.shape)
    for ground in scene.ground:
        for name in _OF_GROUND:
            size = scene.size if name == "height" else getattr(ground, name)
            found[f"ground.{name}"] = size * random.normal() * (0.1 if name == "height" else 1.0)
    if isinstance(scene, Wound):
        # A string that is longer throughout, at the start and in commands.
        found["rest_length"] = np.repeat(found["rest_length"][:, None], SAMPLES, axis=1)
        for name, value in _numbers(scene.winches).items():
            found[name] = value * random.normal(size=len(scene.value))
    return found


def _numbers(winches: tc.Winches) -> dict[str, np.ndarray]:
    """Return the numbers of motors and winches that a run is differentiated by."""
    motor = {f"motor.{name}": value for name, value in vars(winches.motor).items()}
    numbers = motor | {"winches.rate": winches.rate}
    return {name: value for name, value in numbers.items() if value is not None and value.any()}


def changed(scene: AnyScene, direction: Direction, by: float) -> AnyScene:
    """Return a scene a part of a direction away."""
    if isinstance(scene, Wound):
        start = direction | {"rest_length": direction["rest_length"][:, 0]}
        values = {
            name: value + by * direction[name] for name, value in _numbers(scene.winches).items()
        }
        rate = values.pop("winches.rate", None)
        motor = tc.Motor(**{name.split(".")[1]: value for name, value in values.items()})
        winches = replace(scene.winches, motor=motor, rate=rate)
        return replace(scene, scene=changed(scene.scene, start, by), winches=winches)
    if isinstance(scene, Driven):
        others = {name: step for name, step in direction.items() if name != scene.input}
        values = scene.value + by * direction[scene.input]
        profile = replace(scene.profile, values=values)
        return Driven(changed(scene.scene, others, by), profile)
    law, s = scene.strings, scene.structure

    def moved(name: str, value):
        return value + by * direction[name] if name in direction else value

    values = {f.name: moved(f.name, getattr(law, f.name)) for f in fields(law)}
    structure = tc.Structure(
        s.nodes, s.bars, s.paths or s.strings, moved("bar_mass", s.bar_mass), fixed=s.fixed,
        rollers=s.rollers, point_mass=moved("point_mass", s.point_mass),
    )  # fmt: skip
    ground = tuple(
        replace(g, **{n: moved(f"ground.{n}", getattr(g, n)) for n in _OF_GROUND})
        for g in scene.ground
    )
    return replace(
        scene, structure=structure, strings=type(law)(**values), ground=ground,
        gravity=moved("gravity", scene.gravity),
        external_force=moved("external_force", scene.external_force),
        value=moved(scene.input, scene.value),
    )  # fmt: skip


def differences(
    scene: AnyScene, direction: Direction, run: tc.Trajectory, most_steps: int, implicit: bool,
    **how: float,
) -> tuple[np.ndarray, float]:  # fmt: skip
    """Return the derivative of the nodes at the end by differences, and what it is certain to."""
    before, best, certain = None, np.zeros(1), np.inf
    for size in SIZES:
        neighbour = partial(run_of, most_steps=most_steps, implicit=implicit, **how)
        found = _difference(scene, direction, run, size, neighbour)
        if found is not None and before is not None:
            apart = _relative(np.abs(found - before).max(), np.abs(found).max())
            is_over = certain < JUDGED and apart > certain
            if apart < certain:
                certain, best = apart, found
            if is_over or certain < CERTAIN:
                break
        before = found
    return best, certain


def _difference(
    scene: AnyScene, direction: Direction, run: tc.Trajectory, size: float,
    neighbour: Callable[[AnyScene], tc.Trajectory],
) -> np.ndarray | None:  # fmt: skip
    """Return the difference of order 4; None where a neighbour has other switches."""
    ends = []
    for k in (-2, 2, -1, 1):
        other = neighbour(changed(scene, direction, k * size))
        if _pieces(other) != _pieces(run):
            return None
        ends.append(other.nodes[:, :, -1])
    return (8 * (ends[3] - ends[2]) - (ends[1] - ends[0])) / (12 * size)


def _relative(error: float, size: float) -> float:
    """Return an error as part of a size; of a motion that does not depend on anything, itself."""
    return float(error / size if size else error)


def _pieces(run: tc.Trajectory) -> tuple[int, ...]:
    """Return counts that differ where the map from the start to the end is another one."""
    implicit = run.choice.method == "energy_momentum"
    pieces = (run.steps, run.work.rejections) if implicit else (run.work.switches,)
    if run.control is not None:
        limited = run.control.motors.torque_limited.tolist(), run.control.rate_limited.tolist()
        pieces = *pieces, *map(tuple, limited)
    return pieces


def comparison(
    seed: int, most_steps: int, implicit: bool = False, motors: bool = False
) -> Comparison:
    """Return how a random scene does.

    Raises
    ------
    TooLongError
        If its run has more steps, or that of a neighbour twice as many.
    """
    scene, random = random_scene(seed), np.random.default_rng([31, seed])
    if motors:
        scene = wound(scene, random)
    elif seed % 3 == 2 and not implicit:
        scene = driven(scene, random)
    began = perf_counter()
    run = run_of(scene, most_steps, implicit)
    run_seconds = perf_counter() - began
    direction = random_direction(scene, random)
    names = list(direction)
    began = perf_counter()
    tangent = tc.sensitivity(run, names)
    seconds = perf_counter() - began
    weights = [random.normal(size=scene.structure.nodes.shape) for _ in range(2)]
    weights[1] *= scene.duration / scene.size

    def cost(time, nodes, velocities):
        return ca.dot(ca.DM(weights[0]), nodes) + ca.dot(ca.DM(weights[1]), velocities)

    slope = tc.gradient(run, cost, names).slope
    back = sum(np.sum(slope[name] * step) for name, step in direction.items())
    forth, size = _along(tangent, weights, direction)
    adjoint, round_off = _relative(abs(back - forth), size), 0.0
    if adjoint > ADJOINT:
        beside = run_of(changed(scene, direction, ROUND_OFF), 2 * most_steps, implicit)
        other = _along(tc.sensitivity(beside, names), weights, direction)[0]
        round_off = _relative(abs(other - forth), size)
    along = sum(
        np.tensordot(tangent.nodes[name][:, :, 0], step, np.ndim(step))
        for name, step in direction.items()
    )
    reference, certain = differences(scene, direction, run, 2 * most_steps, implicit)
    error = np.inf
    if np.isfinite(certain):
        error = _relative(np.abs(along - reference).max(), np.abs(reference).max())
    if JUDGED < error < np.inf and not implicit:
        # Runs that pass switches slowly err by more than they differ from size to size; so do
        # those at the border of stability, as where friction holds what hardly slips.
        for how in ({"tolerance": 10 * TOLERANCE}, {"is_shortened": True}):
            beside = run_of(scene, 2 * most_steps, **how)
            again, apart = differences(scene, direction, beside, 2 * most_steps, implicit, **how)
            apart = max(apart, _relative(np.abs(again - reference).max(), np.abs(reference).max()))
            certain = max(certain, apart)
    return Comparison(
        seed, tuple(_kinds(scene, run)), run.steps, run.work.switches, float(error), certain,
        float(adjoint), float(round_off), seconds, run_seconds,
    )  # fmt: skip


def _along(
    tangent: tc.Sensitivity, weights: Sequence[np.ndarray], direction: Direction
) -> tuple[float, float]:
    """Return the derivative of a cost along a direction, and the sum of the sizes of its terms."""
    terms = [
        np.tensordot(weights[0], tangent.nodes[name][:, :, 0], 2) * step
        + np.tensordot(weights[1], tangent.velocities[name][:, :, 0], 2) * step
        for name, step in direction.items()
    ]
    return sum(float(term.sum()) for term in terms), sum(float(np.abs(t).sum()) for t in terms)


def _kinds(scene: AnyScene, run: tc.Trajectory) -> Iterable[str]:
    """Yield the kinds of a scene, and of its run."""
    s = scene.structure
    yield f"class {np.bincount(s.bars.ravel()).max(initial=0)}"
    yield f"in {'the plane' if s.dimension == 2 else 'space'}"
    yield scene.input.replace("_", " ")
    has = {
        "switches": run.work.switches, "damping": scene.strings.damping.any(),
        "clusters": s.paths, "ground": scene.ground, "fixed nodes": len(s.fixed),
        "rollers": s.rollers, "gravity": scene.gravity is not None,
        "loads": scene.external_force is not None, "motors": isinstance(scene, Wound),
    }  # fmt: skip
    yield from (name for name, there in has.items() if there)
    if isinstance(scene, Driven):
        yield f"{scene.profile.interpolation} profile"


def _quietly(most_steps: int, implicit: bool, motors: bool, seed: int) -> Comparison | str:
    """Return how a random scene does in a process of its own, or why it is left out."""
    # Each model is run a few times, by the core: what is compiled for one takes longer than that.
    with (
        patch.dict(os.environ, {VARIABLE: "none"}),
        warnings.catch_warnings(action="ignore", category=AccuracyWarning),
    ):
        try:
            return comparison(seed, most_steps, implicit, motors)
        except TooLongError as error:
            return str(error)


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(
        __doc__, arguments, judged=100, count=300, seed=0, steps=3000, implicit=False, motors=False,
        processes=os.cpu_count() or 1,
    )  # fmt: skip
    found, long = list[Comparison](), list[str]()
    print(" seed  steps switches    error  certain  adjoint   s, of which run")
    seeds = range(given.seed, given.seed + given.count)
    compare = partial(_quietly, given.steps, given.implicit, given.motors)
    with ProcessPoolExecutor(given.processes, get_context("spawn")) as executor:
        each_in_turn = map if given.processes == 1 else executor.map
        for seed, each in zip(seeds, each_in_turn(compare, seeds), strict=True):
            if isinstance(each, str):
                long.append(f"{seed} ({each})")
                continue
            found.append(each)
            print(
                f"{each.seed:5d} {each.steps:6d} {each.switches:8d} {each.error:8.1e} "
                f"{each.certain:8.1e} {each.adjoint:8.1e} {each.seconds:6.2f} "
                f"{each.run_seconds:6.2f}",
                flush=True,
            )
            if sum(each.is_judged for each in found) == given.judged:
                executor.shutdown(cancel_futures=True)
                break
    _report(found, long)


def _report(found: list[Comparison], long: list[str]) -> None:
    """Print what was found of all scenes, with those that were left out."""
    judged = [each for each in found if each.is_judged]
    print(
        f"{len(found) + len(long)} scenes, {len(judged)} judged: largest error "
        f"{max((each.error for each in judged), default=0):.1e}"
    )
    print(f"  above {JUDGED:g}: {[each.seed for each in judged if each.error > JUDGED]}")
    print(f"  beyond what differences are certain to: {[e.seed for e in judged if e.is_wrong]}")
    adjoint = max((each.adjoint for each in found), default=0)
    print(f"adjoint from forward: {adjoint:.1e}, judged or not; above {ADJOINT:g}: ")
    for each in found:
        if each.adjoint > ADJOINT:
            print(
                f"  {each.seed}: {each.adjoint:.1e}; a change of the scene by {ROUND_OFF:g} of it "
                f"makes {each.round_off:.1e}"
            )
    counts = Counter(kind for each in judged for kind in each.kinds)
    print(f"judged: {', '.join(f'{kind} {counts[kind]}' for kind in sorted(counts))}")
    others = [each for each in found if not each.is_judged]
    apart = [f"{each.seed} ({each.certain:.0e})" for each in others if np.isfinite(each.certain)]
    print(f"left out, {len(long)}: {', '.join(long)}")
    print(
        "left out, as switches of neighbours differ at every size: "
        f"{[each.seed for each in others if not np.isfinite(each.certain)]}"
    )
    print(f"left out, as differences are certain to less than {JUDGED:g}: {', '.join(apart)}")


if __name__ == "__main__":
    main()
