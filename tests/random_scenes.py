"""Random scenes: a structure, its strings and ground, a start, an input and a duration.

They are what a user could build, and as various: point masses alone and bars of class 1 to 6, in
space and in the plane, with fixed nodes, rollers, payloads and clustered strings; both inputs and
laws of strings, with and without damping, gravity, loads and ground; taut or partly slack, at rest
or moving. Sizes run from 1 mm to 1 km; masses and stiffnesses over decades, also within a scene.
The same seed gives the same scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, pairwise

import numpy as np

import tenscontrol as tc
from tests.located_motion import Work, located_motion
from tests.oracle import (
    HeldForceDensity,
    HeldRestLength,
    Plane,
    consistent_mass,
    free_rows,
    independent_bars,
    segment_pairs,
)
from tests.random_structures import any_motion_of, any_structure, constraint_rows, quietly_made

# Its own stream of random numbers, whatever else is drawn from the same seed.
_STREAM = 26

_INPUTS = ("rest_length", "force_density")

# A scene lasts at most so many periods of its fastest vibration.
_MOST_PERIODS = 150

# Nothing but the start may move the centre of mass by more than so many sizes.
_FARTHEST = 10.0


@dataclass(frozen=True, eq=False)
class Scene:
    """What :func:`tenscontrol.simulate` takes, and the same for the oracle."""

    seed: int
    structure: tc.Structure
    strings: tc.LinearStrings | tc.ElasticStrings
    ground: tuple[tc.Ground, ...]
    gravity: np.ndarray | None
    external_force: np.ndarray | None
    velocities: np.ndarray
    input: str
    value: np.ndarray
    duration: float

    @property
    def size(self) -> float:
        """Largest extent of the nodes at the start, m."""
        return float(np.ptp(self.structure.nodes, axis=1).max())

    @cached_property
    def model(self) -> tc.Model:
        """The package's model."""
        load = False if self.external_force is None else self.external_force
        return tc.Model(self.structure, self.strings, load, self.gravity, self.ground or None)

    @property
    def load(self) -> np.ndarray:
        """Weights and loads on the nodes, N, for the oracle."""
        load = np.zeros(self.structure.nodes.shape)
        if self.external_force is not None:
            load += self.external_force
        if self.gravity is not None:
            load += np.outer(self.gravity, consistent_mass(self.structure).sum(axis=1))
        return load

    def simulate(self, **options) -> tc.Trajectory:
        """Run the scene by the package; bars may cross, of which the oracle knows nothing."""
        options[self.input] = self.value
        options.setdefault("limits", tc.HealthLimits(crossings=None))
        return tc.simulate(self.model, self.duration, velocities=self.velocities, **options)

    def located(
        self, times: np.ndarray, tolerance: float = 1e-12, most_evaluations: int = 10_000_000
    ) -> tuple[np.ndarray, Work]:
        """Return the oracle's nodes at the times, shape (d, n, T), and its work."""
        structure, law = self.structure, self.strings
        held: HeldForceDensity | HeldRestLength = HeldForceDensity(self.value)
        if self.input == "rest_length":
            held = HeldRestLength(self.value, stiffness_of(law, self.value), law.damping)
        ground = [(plane_of(each, self.structure), each.nodes) for each in self.ground]
        every = np.arange(structure.nodes.shape[1])
        ground = [(plane, every if nodes is None else nodes) for plane, nodes in ground]
        return located_motion(
            structure, held, self.velocities, times, self.load, ground, tolerance, most_evaluations
        )

    def about(self) -> str:
        """Return one line on the scene."""
        structure = self.structure
        words = [
            f"{structure.dimension}-D", f"{structure.nodes.shape[1]} nodes",
            f"{len(structure.bars)} bars", f"{len(structure.strings)} strings",
            f"size {self.size:.3g} m", f"{self.duration:.3g} s", type(self.strings).__name__,
            self.input,
        ]  # fmt: skip
        has = {
            "clustered": structure.paths, "fixed": len(structure.fixed),
            "rollers": structure.rollers, "damped": self.strings.damping.any(),
            "gravity": self.gravity is not None, "load": self.external_force is not None,
            "ground": self.ground, "moving": self.velocities.any(),
        }  # fmt: skip
        return ", ".join(words + [name for name, there in has.items() if there])


def random_scene(seed: int) -> Scene:
    """Return the scene of this seed."""
    random = np.random.default_rng([_STREAM, seed])
    structure = _scaled(random, _structure(random), 10 ** random.uniform(-3, 3))
    input_ = _INPUTS[int(random.random() < 0.25)]
    alpha = len(structure.strings)
    masses = consistent_mass(structure).sum(axis=1)
    movable = np.setdiff1d(np.arange(len(masses)), structure.fixed)
    mass = float(np.median(masses[movable]))
    rate = 10 ** random.uniform(-1, 3)  # rad/s: the scale of vibrations
    decades = random.choice([0.6, 2.0, 4.0], p=[0.6, 0.25, 0.15])
    stiffness = mass * rate**2 * 10 ** random.uniform(-decades / 2, decades / 2, alpha)
    squares = _squared_frequencies(structure, stiffness, input_)
    frequency = float(np.sqrt(squares.mean() if random.random() < 0.8 else np.median(squares)))
    fastest = float(np.sqrt(squares.max()))
    frequency = max(frequency, 0.02 * fastest)
    periods = 10 ** random.uniform(np.log10(0.3), np.log10(16))
    duration = 2 * np.pi * min(periods / frequency, _MOST_PERIODS / fastest)
    size = float(np.ptp(structure.nodes, axis=1).max())

    damping = np.zeros(alpha)
    if random.random() < 0.5:
        ratio = 10 ** random.uniform(-2.5, -0.3)
        typical = 2 * ratio * np.sqrt(stiffness * mass)
        damping += np.median(typical) if random.random() < 0.6 else typical
    length = structure.string_length()
    rest = length * _prestrain(random, alpha)
    value = rest
    strings: tc.LinearStrings | tc.ElasticStrings
    if random.random() < 0.5:
        strings = tc.LinearStrings(stiffness, damping)
    else:
        strings = tc.ElasticStrings(stiffness * rest, damping)
    if input_ == "force_density":
        value = np.where(random.random(alpha) < 0.1, 0.0, stiffness)

    velocities = np.zeros(structure.nodes.shape)
    if random.random() < 0.6:
        velocities = any_motion_of(structure, int(random.integers(2**31)))[1]
        fast = np.abs(velocities).max()
        speed = size * frequency * 10 ** random.uniform(-2.5, 0.3)
        velocities *= speed / fast if fast > 0 else 0.0

    ground = _ground(random, structure, size, mass, frequency) if random.random() < 0.35 else ()
    # What moves the centre of mass, as an acceleration.
    stopped = bool(ground) or len(structure.fixed) > 0
    most = size * frequency**2 * (0.3 if stopped else 1.0)
    if not stopped:
        most = min(most, 2 * _FARTHEST * size / duration**2)
    gravity = None
    if ground or random.random() < 0.4:
        gravity = np.zeros(structure.dimension)
        gravity[-1] = -min(
            most, 9.81 if random.random() < 0.4 else most * 10 ** random.uniform(-2, 0)
        )
    external_force = None
    if random.random() < 0.3:
        loaded = random.random(structure.nodes.shape[1]) < 0.5
        force = np.where(loaded, masses, 0.0) * random.normal(size=structure.nodes.shape)
        external_force = most * 10 ** random.uniform(-1.5, -0.3) * force
    return Scene(
        seed, structure, strings, ground, gravity, external_force, velocities, input_, value,
        duration,
    )  # fmt: skip


def stiffness_of(strings: tc.LinearStrings | tc.ElasticStrings, rest: np.ndarray) -> np.ndarray:
    """Return dT/dl of taut strings of these rest lengths, N/m."""
    if isinstance(strings, tc.LinearStrings):
        return np.broadcast_to(strings.stiffness, rest.shape)
    return strings.axial_rigidity / rest


def plane_of(ground: tc.Ground, structure: tc.Structure) -> Plane:
    """Return the same plane for the oracle."""
    normal = np.eye(structure.dimension)[-1] if ground.normal is None else ground.normal
    return Plane(
        ground.stiffness, ground.damping, ground.friction, ground.slip_speed, tuple(normal),
        ground.height,
    )  # fmt: skip


def _structure(random: np.random.Generator) -> tc.Structure:
    """Return a structure that strings can move."""
    k = int(random.integers(0, 7))
    d = 2 if random.random() < 0.3 else 3
    while True:
        seed = int(random.integers(2**31))
        has_clusters = bool(random.random() < 0.4)
        structure = any_structure(seed, k, d, has_clusters) if k else _points(random, d)
        if len(free_rows(structure)) > len(independent_bars(structure)):
            every = np.ones(len(structure.strings))
            if all(len(_squared_frequencies(structure, every, x)) for x in _INPUTS):
                return structure


def _points(random: np.random.Generator, d: int) -> tc.Structure:
    """Return point masses in a net of strings, some on supports."""
    count = int(random.integers(2, 7))
    nodes = random.uniform(-1.5, 1.5, (d, count))
    while _nearest(nodes) < 0.3:
        nodes = random.uniform(-1.5, 1.5, (d, count))
    pairs = list(combinations(range(count), 2))
    around = random.permutation(count).tolist()
    strings: list[tuple[int, ...]] = list(pairwise(around))
    strings += [pairs[i] for i in random.integers(0, len(pairs), int(random.integers(0, count)))]
    if count > 2 and random.random() < 0.4:
        for _ in range(random.integers(1, 4)):
            path = random.permutation(count)[:3].tolist()
            strings.append((*path, path[0]) if random.random() < 0.3 else tuple(path))
    fixed = random.permutation(count)[: random.integers(0, count)] if random.random() < 0.5 else ()
    mass = np.ones(count)
    mass[list(fixed)] = 0.0
    return quietly_made(nodes, np.zeros((0, 2), int), strings, [], fixed=fixed, point_mass=mass)


def _nearest(nodes: np.ndarray) -> float:
    apart = np.linalg.norm(nodes[:, :, None] - nodes[:, None, :], axis=0)
    return float(apart[np.triu_indices(nodes.shape[1], 1)].min())


def _scaled(random: np.random.Generator, structure: tc.Structure, size: float) -> tc.Structure:
    """Return the structure at this size, with masses over decades."""
    decades = random.choice([0.0, 0.6, 2.0, 5.0], p=[0.3, 0.4, 0.2, 0.1])
    mass = 10 ** random.uniform(-6, 3)
    bars, points = (
        part * mass * 10 ** random.uniform(-decades / 2, decades / 2, len(part))
        for part in (structure.bar_mass, structure.point_mass)
    )
    return quietly_made(
        structure.nodes * size / np.ptp(structure.nodes, axis=1).max(), structure.bars,
        structure.paths or structure.strings, bars, fixed=structure.fixed,
        rollers=structure.rollers, point_mass=points,
    )  # fmt: skip


def _squared_frequencies(structure: tc.Structure, stiffness: np.ndarray, input_: str) -> np.ndarray:
    """Return the squares of the frequencies of what strings move, (rad/s)².

    Of strings of this stiffness with all of them taut and no prestress; or of this force density.
    """
    d, count = structure.nodes.shape
    first, pairs = segment_pairs(structure)
    rows = free_rows(structure)
    S = structure.nodes[:, pairs[:, 1]] - structure.nodes[:, pairs[:, 0]]
    if input_ == "force_density":
        S = np.ones((1, len(pairs)))
    gradient = np.zeros((len(first) - 1, count, len(S)))
    for i, (low, high) in enumerate(pairwise(first)):
        for s in range(low, high):
            unit = S[:, s] / np.linalg.norm(S[:, s])
            gradient[i, pairs[s, 0]] -= unit
            gradient[i, pairs[s, 1]] += unit
    if input_ == "force_density":
        gradient = np.kron(gradient[:, :, 0], np.eye(d)).reshape(-1, d * count)
        stiffness = np.repeat(stiffness, d)
    gradient = gradient.reshape(len(gradient), d * count)[:, rows]
    L = np.linalg.cholesky(np.kron(consistent_mass(structure), np.eye(d))[np.ix_(rows, rows)])
    G = np.linalg.solve(L, (gradient * np.sqrt(stiffness)[:, None]).T)
    unhindered, few = (G * G).sum(), independent_bars(structure)
    if len(few):
        J = constraint_rows(structure, structure.nodes)[np.ix_(few, rows)]
        Q, _ = np.linalg.qr(np.linalg.solve(L, J.T / np.linalg.norm(J, axis=1)))
        G -= Q @ (Q.T @ G)
    squares = np.linalg.svd(G, compute_uv=False) ** 2
    return squares[squares > 1e-9 * unhindered]


def _prestrain(random: np.random.Generator, count: int) -> np.ndarray:
    """Return rest lengths as part of the lengths: all taut, partly slack, or far apart."""
    low, high = [(0.8, 0.99), (0.75, 1.15), (0.3, 1.3)][random.choice(3, p=[0.35, 0.45, 0.2])]
    return random.uniform(low, high, count)


def _ground(
    random: np.random.Generator, structure: tc.Structure, size: float, mass: float, frequency: float
) -> tuple[tc.Ground, ...]:
    """Return a plane below the nodes, or a little above the lowest."""
    d = structure.dimension
    normal = np.eye(d)[-1]
    if random.random() < 0.3:
        normal = normal + 0.3 * random.normal(size=d)
        normal /= np.linalg.norm(normal)
    lowest = (normal @ structure.nodes).min()
    damping = 10 ** random.uniform(-2, 0) / (size * frequency) if random.random() < 0.6 else 0.0
    return (
        tc.Ground(
            stiffness=mass * frequency**2 * 10 ** random.uniform(-1, 1.5),
            damping=damping,
            friction=float(random.choice([0.0, 0.3, 0.5, 1.0])),
            slip_speed=size * frequency * 10 ** random.uniform(-3, -1),
            normal=normal,
            height=lowest - size * random.uniform(-0.02, 0.25),
        ),
    )
