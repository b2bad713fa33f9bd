"""Derivatives of runs against central differences of the simulator, on random scenes.

Run: ``python -m tests.benchmarks.sensitivities --count 100 [--seed 0] [--steps 3000]
[--implicit]``.

Each scene is run at a tolerance of 1e-12 and differentiated along one random direction of all that
it depends on: input, laws of strings and ground, masses, gravity and load. ``--implicit`` takes 200
steps of the energy-momentum method in its place, and differences of the same steps. Beside it are
central differences of order 4 at several sizes of the change, of runs with as many switches. Of two
sizes that follow one another, those that differ least are the reference, and their difference is
what it is certain to. Scenes of more steps are left out. The columns:

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
from tests.random_scenes import Scene, random_scene

TOLERANCE = 1e-12
STEPS = 200
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


def run_of(scene: Scene, implicit: bool = False) -> tc.Trajectory:
    """Return the motion of a scene, tight, or in so many implicit steps."""
    limits = tc.HealthLimits(crossings=None)
    how = {"method": "dop853", "tolerance": TOLERANCE}
    if implicit:
        how = {"method": "energy_momentum", "step": scene.duration / STEPS}
    return scene.simulate(**how, error="none", limits=limits)


def random_direction(scene: Scene, random: np.random.Generator) -> Direction:
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
    return found


def changed(scene: Scene, direction: Direction, by: float) -> Scene:
    """Return a scene a part of a direction away."""
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
    scene: Scene, direction: Direction, run: tc.Trajectory, implicit: bool
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
    return (run.steps, run.work.rejections) if implicit else (run.work.switches,)


def comparison(seed: int, most_steps: int, implicit: bool = False) -> Comparison | None:
    """Return how a random scene does; None if it has too many steps."""
    scene, random = random_scene(seed), np.random.default_rng([31, seed])
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
    given = options(__doc__, arguments, count=100, seed=0, steps=3000, implicit=False)
    found, left_out = [], 0
    print(" seed  steps switches    error  certain  adjoint   s, of which run")
    for seed in range(given.seed, given.seed + given.count):
        each = comparison(seed, given.steps, given.implicit)
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
