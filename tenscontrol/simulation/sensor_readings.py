"""Readings that sensors on simulated structures hand out, sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays
from tenscontrol.dynamics.evaluator import ColumnEvaluator
from tenscontrol.dynamics.model import Model
from tenscontrol.estimation.sensors import Sensors, noisy_readings
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.segments import to_strings

# Samples whose random numbers are drawn at once.
_BLOCK = 64

# What random numbers are for: each has a stream of its own, so that the noise of sensors is the
# same whether they have a bias, or lose readings, or not.
_NOISE, _CHANCE, _FIRST_BIAS, _WALK = range(4)


class _RandomRows:
    """Random numbers of robots, one row a sample: those of a sample depend on no other's.

    ``draw`` returns numbers of a shape from a generator. Each block of samples has a generator of
    its own, so any sample can be had, whatever was drawn before.
    """

    def __init__(
        self, seeds: Sequence[int], purpose: int, size: int,
        draw: Callable[[np.random.Generator, tuple[int, int]], FloatArray],
    ) -> None:  # fmt: skip
        self._seeds, self._purpose, self._size, self._draw = seeds, purpose, size, draw
        self._blocks = np.empty((len(seeds), _BLOCK, size))
        self._block = np.full(len(seeds), -1)

    def at(self, robots: IntArray, samples: IntArray) -> FloatArray:
        """Return the numbers of some robots, each at a sample of its own, (robots, size)."""
        block, within = np.divmod(samples, _BLOCK)
        stale = self._block[robots] != block
        if stale.any():
            for robot, number in zip(robots[stale].tolist(), block[stale].tolist(), strict=True):
                generator = np.random.default_rng([self._seeds[robot], self._purpose, number])
                self._blocks[robot] = self._draw(generator, (_BLOCK, self._size))
                self._block[robot] = number
        return self._blocks[robots, within]


def _normal(generator: np.random.Generator, shape: tuple[int, int]) -> FloatArray:
    return generator.normal(size=shape)


def _uniform(generator: np.random.Generator, shape: tuple[int, int]) -> FloatArray:
    return generator.random(size=shape)


@dataclass(frozen=True, eq=False)
class ReadingsState:
    """What :class:`SensorReadings` go on from.

    Attributes
    ----------
    samples : ndarray of int, shape (count,)
        Readings that each robot has taken.
    bias : ndarray, shape (count, m)
        Of the next reading.
    under_way : ndarray, shape (delay, count, m)
        What was read and has not arrived.
    arrived : ndarray, shape (count, m)
        What arrived last.
    """

    samples: IntArray
    bias: FloatArray
    under_way: FloatArray
    arrived: FloatArray

    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze_arrays(self)


class SensorReadings:
    """Sensors on robots, alike but for their noise, with bias and delay.

    Parameters
    ----------
    sensors : Sensors
    seeds : sequence of int
        Of the noise, one a robot.
    input : {"rest_length", "force_density"}
    sample_time : float
        s.
    """

    def __init__(
        self, sensors: Sensors, seeds: Sequence[int], input: str, sample_time: float
    ) -> None:
        self.sensors, self._input, self._sample_time = sensors, input, sample_time
        m, count = len(sensors.noise), len(seeds)
        self._every = np.arange(count)
        self._noise = _RandomRows(seeds, _NOISE, m, _normal)
        self._first_bias = _RandomRows(seeds, _FIRST_BIAS, m, _normal)
        self._walk = _RandomRows(seeds, _WALK, m, _normal)
        self._chance = _RandomRows(seeds, _CHANCE, 1 + 3 * len(sensors.readings), _uniform)
        self._loses = sensors.drop_rate > 0 or sensors.outlier_rate > 0
        self._laws: list[ColumnEvaluator] = []
        self._samples = np.zeros(count, dtype=int)
        self._bias = np.zeros((count, m))
        self._under_way = np.full((sensors.delay, count, m), np.nan)
        self._arrived = np.full((count, m), np.nan)

    def begin_all(self, models: Sequence[Model]) -> None:
        """Begin runs of all robots with their first noise."""
        self._structure, self._samples = models[0].structure, np.zeros(len(models), dtype=int)
        if self._input == "rest_length" and self.sensors.string_tension is not None:
            laws: dict[int, ColumnEvaluator] = {}
            for model in models:
                if id(model) not in laws:
                    laws[id(model)] = ColumnEvaluator(model.string_force_density)
            self._laws = [laws[id(model)] for model in models]
        self._begin(self._every)

    def begin(self, robots: IntArray, models: Sequence[Model]) -> None:
        """Begin runs of some robots with another bias; their noise goes on."""
        if self._laws:
            for robot, model in zip(robots.tolist(), models, strict=True):
                self._laws[robot] = ColumnEvaluator(model.string_force_density)
        self._begin(robots)

    def _begin(self, robots: IntArray) -> None:
        if self.sensors.bias:
            drawn = self._first_bias.at(robots, self._samples[robots])
            self._bias[robots] = self.sensors.bias_deviation * drawn
        self._under_way[:, robots] = np.nan  # the first were before the run

    @property
    def state(self) -> ReadingsState:
        """Where they are; set it to go on from there."""
        return ReadingsState(
            self._samples.copy(), self._bias.copy(), self._under_way.copy(), self._arrived.copy()
        )

    @state.setter
    def state(self, state: ReadingsState) -> None:
        self._samples, self._bias = state.samples.copy(), state.bias.copy()
        self._under_way, self._arrived = state.under_way.copy(), state.arrived.copy()

    @property
    def bias(self) -> FloatArray:
        """Bias of the next reading, (count, m)."""
        return self._bias.copy()

    def skip(self, samples: int) -> None:
        """Let so many samples pass."""
        for _ in range(samples):
            self._pass(self._every)

    def take(
        self, robots: IntArray, nodes: FloatArray, velocities: FloatArray, held: FloatArray | None,
        accelerations: Callable[[FloatArray], FloatArray], lost: bool = False,
    ) -> None:  # fmt: skip
        """Measure the motion of some robots: what arrives now is in :attr:`arrived`.

        Parameters
        ----------
        robots : ndarray of int
        nodes, velocities : ndarray, shape (robots, n d)
            Of all nodes of the model, node by node, m and m/s.
        held : ndarray, shape (robots, α), optional
            What the strings have, if anything yet.
        accelerations : callable
            Returns those of the nodes, m/s², shape (robots, n d), under what is held.
        lost : bool
            Whether what is measured now is missing when it would have arrived.
        """
        sensors, seen = self.sensors, self.sensors.structure.nodes.size
        felt = tension = rest_length = None
        if held is not None:
            if sensors.needs("acceleration"):
                felt = accelerations(held)[:, :seen]
            if sensors.needs("tension"):
                tension = self._tension(robots, nodes, velocities, held)
            if sensors.needs("rest_length"):
                rest_length = self._of_strings("rest_length", held)
        exact = sensors.measure_rows(
            nodes[:, :seen], velocities[:, :seen], felt, tension, rest_length
        )
        now = self._samples[robots]
        chance = self._chance.at(robots, now) if self._loses else None
        noise = self._noise.at(robots, now)
        read = noisy_readings(sensors, exact + self._bias[robots], noise, chance)
        self._pass(robots)
        if lost:
            read = np.full_like(read, np.nan)
        if sensors.delay:
            self._arrived[robots] = self._under_way[0, robots]
            self._under_way[:-1, robots] = self._under_way[1:, robots]
            self._under_way[-1, robots] = read
        else:
            self._arrived[robots] = read

    @property
    def arrived(self) -> FloatArray:
        """What arrived last, (count, m), NaN where nothing did."""
        return self._arrived.copy()

    def _pass(self, robots: IntArray) -> None:
        """Let a sample pass, in which a bias walks."""
        if self.sensors.bias:
            walk = self.sensors.bias_walk * np.sqrt(self._sample_time)
            self._bias[robots] += walk * self._walk.at(robots, self._samples[robots])
        self._samples[robots] += 1

    def _tension(
        self, robots: IntArray, nodes: FloatArray, velocities: FloatArray, held: FloatArray
    ) -> FloatArray:
        """Return the tension of each string of the sensors' structure."""
        structure, gamma = self._structure, held
        if self._laws:
            free, laws = structure.free_rows, [self._laws[robot] for robot in robots.tolist()]
            states = np.hstack([nodes[:, free], velocities[:, free]])
            if all(law is laws[0] for law in laws):
                gamma = laws[0](states.T, held.T)[0].T
            else:
                gamma = np.hstack(
                    [
                        law(state[:, None], own[:, None])[0]
                        for law, state, own in zip(laws, states, held, strict=True)
                    ]
                ).T
        d, n = structure.nodes.shape
        motion = nodes.T.reshape(n, d, len(nodes)).swapaxes(0, 1)
        return self._of_strings("tension", gamma * structure.string_length(motion).T)

    def _of_strings(self, name: str, values: FloatArray) -> FloatArray:
        if values.shape[1] == len(self.sensors.structure.strings):
            return values
        return to_strings(self._structure, name, values)
