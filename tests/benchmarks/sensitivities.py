"""Derivatives of runs against central differences of the simulator, on random scenes.

Run: ``python -m tests.benchmarks.sensitivities --count 100 [--seed 0] [--steps 3000]
[--implicit] [--motors]``.

Each scene is run at a tolerance of 1e-12 and differentiated along one random direction of all that
it depends on: input, laws of strings and ground, masses, gravity and load. ``--implicit`` takes 200
steps of the energy-momentum method in its place, and differences of the same steps. Beside it are
central differences of order 4 at several sizes of the change, of runs with as many switches. Of two
sizes that follow one another, those that differ least are the reference, and their difference is
what it is certain to. Scenes of more steps are left out. ``--motors`` winds the strings of the
scenes by motors under a command of the time: with limits of torque and speed, inertia, lag and
play, some with two strings on a drum, and strings that no motor drives. Their numbers are in the
direction, and runs whose motors meet limits in other samples are no neighbours. The columns:

- error: of the derivative of the nodes at the end, as part of the largest; certain: that of the
  differences; adjoint: of the slope of a cost of nodes and velocities, by both ways
- the last column names scenes whose number of switches changes at every size
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from time import perf_counter

import casadi as ca
import numpy as np

import tenscontrol as tc
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

_OF_GROUND = "stiffness", "damping", "friction", "height"

Direction = dict[str, np.ndarray | float]


@dataclass(frozen=True)
class Comparison:
    """How far a derivative is from differences, and a gradient from the derivative."""

    seed: int
    steps: int
    switches: int
    error: float
    certain: float
    adjoint: float
    seconds: float
    run_seconds: float

    @property
    def is_judged(self) -> bool:
        """Whether differences are certain enough to tell."""
        return self.certain < 1e-7

    @property
    def is_wrong(self) -> bool:
        """Whether the derivative is off by more than differences are."""
        return self.is_judged and self.error > 1e-7 + 3 * self.certain


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


def run_of(scene: Scene | Wound, implicit: bool = False) -> tc.Trajectory:
    """Return the motion of a scene, tight, or in so many implicit steps."""
    limits = tc.HealthLimits(crossings=None, rest_length_error=None)
    how = {"method": "dop853", "tolerance": TOLERANCE}
    if implicit:
        how = {"method": "energy_momentum", "step": scene.duration / STEPS}
    return scene.simulate(**how, error="none", limits=limits)


def random_direction(scene: Scene | Wound, random: np.random.Generator) -> Direction:
    """Return a direction of all that a scene depends on, each as part of its size."""
    law, structure = scene.strings, scene.structure
    found: Direction = {scene.input: scene.value * random.normal(size=len(scene.value))}
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


def changed(scene: Scene | Wound, direction: Direction, by: float) -> Scene | Wound:
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
    scene: Scene | Wound, direction: Direction, run: tc.Trajectory, implicit: bool
) -> tuple[np.ndarray, float]:
    """Return the derivative of the nodes at the end by differences, and what it is certain to."""
    found, best, certain = [], np.zeros(1), np.inf
    for size in SIZES:
        runs = [run_of(changed(scene, direction, k * size), implicit) for k in (1, -1, 2, -2)]
        if any(_pieces(other) != _pieces(run) for other in runs):
            found.clear()
            continue
        ends = [run.nodes[:, :, -1] for run in runs]
        found.append((8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * size))
        if len(found) > 1:
            apart = _relative(np.abs(found[-1] - found[-2]).max(), np.abs(found[-1]).max())
            if apart < certain:
                certain, best = apart, found[-1]
    return best, certain


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
) -> Comparison | None:
    """Return how a random scene does; None if it has too many steps."""
    scene, random = random_scene(seed), np.random.default_rng([31, seed])
    if motors:
        scene = wound(scene, random)
    began = perf_counter()
    run = run_of(scene, implicit)
    run_seconds = perf_counter() - began
    if run.steps > most_steps:
        return None
    direction = random_direction(scene, random)
    names = list(direction)
    began = perf_counter()
    tangent = tc.sensitivity(run, names)
    seconds = perf_counter() - began
    weights = [random.normal(size=scene.structure.nodes.shape) for _ in range(2)]
    pace = scene.size / scene.duration

    def cost(time, nodes, velocities):
        return ca.dot(ca.DM(weights[0]), nodes) + ca.dot(ca.DM(weights[1] / pace), velocities)

    slope = tc.gradient(run, cost, names).slope
    along, back = np.zeros(scene.structure.nodes.shape), 0.0
    size, forth = 0.0, 0.0
    for name, step in direction.items():
        by_nodes, by_velocities = (
            part[name][:, :, 0] for part in (tangent.nodes, tangent.velocities)
        )
        along += np.tensordot(by_nodes, step, np.ndim(step))
        costs = np.tensordot(weights[0], by_nodes, 2)
        costs = costs + np.tensordot(weights[1] / pace, by_velocities, 2)
        forth += np.sum(costs * step)
        back += np.sum(slope[name] * step)
        size += np.sum(np.abs(costs * step))
    reference, certain = differences(scene, direction, run, implicit)
    error = np.inf
    if np.isfinite(certain):
        error = _relative(np.abs(along - reference).max(), np.abs(reference).max())
    adjoint = _relative(abs(back - forth), size)
    return Comparison(
        seed, run.steps, run.work.switches, float(error), certain, float(adjoint), seconds,
        run_seconds,
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, count=100, seed=0, steps=3000, implicit=False, motors=False)
    found, left_out = [], 0
    print(" seed  steps switches    error  certain  adjoint   s, of which run")
    for seed in range(given.seed, given.seed + given.count):
        each = comparison(seed, given.steps, given.implicit, given.motors)
        if each is None:
            left_out += 1
            continue
        found.append(each)
        print(
            f"{each.seed:5d} {each.steps:6d} {each.switches:8d} {each.error:8.1e} "
            f"{each.certain:8.1e} {each.adjoint:8.1e} {each.seconds:6.2f} {each.run_seconds:6.2f}",
            flush=True,
        )
    judged = [each for each in found if each.is_judged]
    wrong = [each.seed for each in judged if each.is_wrong]
    far = [each.seed for each in judged if each.error > 1e-7]
    print(
        f"{len(found)} scenes, {left_out} of more than {given.steps} steps left out; "
        f"{len(judged)} judged, {sum(each.switches > 0 for each in judged)} with switches"
    )
    print(f"largest error {max((each.error for each in judged), default=0):.1e}")
    print(f"above 1e-7: {far}; beyond what differences are certain to: {wrong}")
    print(f"adjoint from forward: {max((each.adjoint for each in found), default=0):.1e}")
    print(f"not judged: {[each.seed for each in found if not each.is_judged]}")


if __name__ == "__main__":
    main()
