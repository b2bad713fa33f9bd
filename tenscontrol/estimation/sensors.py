"""Sensors: measured quantities, noise, delay, lost readings and outliers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.evaluator import Function, SharedEvaluator, builds
from tenscontrol.fields import Field, OptionalArray, converted
from tenscontrol.properties import cached_property
from tenscontrol.structure.structure import Structure

# Kind of reading: its unit, the argument that chooses which ones, and its numbers in the plane and
# in space.
KINDS = (
    ("node_position", "m", "nodes", (2, 3)),
    ("string_length", "m", "strings", (1, 1)),
    ("bar_direction", "no unit", "bars", (2, 3)),
    ("string_tension", "N", "tension_strings", (1, 1)),
    ("bar_rate", "rad/s", "rate_bars", (1, 3)),
)

_Chosen = Field[Sequence[int] | IntArray | None, IntArray | None]

# A corrupt reading is off by so many standard deviations.
_OFF = (20.0, 200.0)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Sensors:
    """Sensors: what is measured at each sample, with Gaussian noise on each number.

    A quantity is measured if its standard deviation is given. The readings of a sample are one
    vector y, shape (m,): positions ``x, y, z`` node by node, string lengths, bar directions
    ``x, y, z`` bar by bar, tensions, bar rates ``x, y, z`` bar by bar. A direction d is the unit
    vector from start to end of the bar. A bar rate is the angular velocity ``d × ḋ``, as a gyro on
    the bar measures it; thin bars have no spin about their axis. In the plane it is one number,
    positive counterclockwise. All are in the frame of the structure.

    Parameters
    ----------
    structure : Structure
        Of a subdivided one the parent, if the plant of the filter is that of the parent.
    node_position : float or array_like, shape (nodes,), optional
        Standard deviation of each coordinate of a node, m.
    string_length : float or array_like, shape (strings,), optional
        Standard deviation of the length of a string, m: of a clustered one, of all its segments.
    bar_direction : float or array_like, shape (bars,), optional
        Standard deviation of each entry of a direction, about that of an angle in rad.
    string_tension : float or array_like, shape (tension_strings,), optional
        Standard deviation of a tension, N.
    bar_rate : float or array_like, shape (rate_bars,), optional
        Standard deviation of each entry of an angular velocity, rad/s.
    nodes : sequence or set of int, or mask, optional
        Nodes that are measured; all if not given. A mask has True or False for each of them. A set
        is taken in ascending order.
    strings : sequence or set of int, or mask, optional
        Strings whose length is measured; all if not given.
    bars : sequence or set of int, or mask, optional
        Bars whose direction is measured; all if not given.
    tension_strings : sequence or set of int, or mask, optional
        Strings whose tension is measured; all if not given.
    rate_bars : sequence or set of int, or mask, optional
        Bars whose angular velocity is measured; all if not given.
    delay : int
        Samples between a measurement and its arrival.
    drop_rate : float
        Probability that all readings of a sample are lost, at least 0 and below 1.
    outlier_rate : float
        Probability that a reading is off by 20 to 200 standard deviations, at least 0
        and below 1.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, nothing is measured, or
        what is to be measured is chosen for a kind that is not measured.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> sensors = tc.Sensors(
    ...     structure=prism, string_length=0.001, bar_direction=0.01, bars=[0, 1], delay=2)
    >>> len(sensors.noise), sensors.readings[0], sensors.readings[-1]
    (15, 'string_length 0', 'bar_direction 1')
    >>> sensors.measure(prism.nodes)[:3].round(3)
    array([0.866, 0.866, 0.866])
    """

    structure: Structure
    node_position: OptionalArray = converted(None)
    string_length: OptionalArray = converted(None)
    bar_direction: OptionalArray = converted(None)
    string_tension: OptionalArray = converted(None)
    bar_rate: OptionalArray = converted(None)
    nodes: _Chosen = converted(None)
    strings: _Chosen = converted(None)
    bars: _Chosen = converted(None)
    tension_strings: _Chosen = converted(None)
    rate_bars: _Chosen = converted(None)
    delay: int = 0
    drop_rate: float = 0.0
    outlier_rate: float = 0.0

    def __post_init__(self) -> None:
        validation.instance(
            "structure", self.structure, Structure, "make one by Structure(...) or prism()"
        )
        for kind, unit, chooser, _ in KINDS:
            noise, chosen = getattr(self, kind), getattr(self, chooser)
            if noise is None:
                if chosen is not None and len(validation.index_array(chooser, chosen)):
                    raise ValueError(f"{chooser} is given, but {kind} is not: give its noise")
                continue
            which = _chosen(chooser, chosen, self.count_of(chooser))
            deviation = validation.positive(
                kind,
                validation.per_member(kind, noise, len(which), f"entry of {chooser}"),
                f"standard deviation, {unit}",
            )
            object.__setattr__(self, kind, frozen(deviation))
            object.__setattr__(self, chooser, frozen(which))
        if not self._taken:
            names = ", ".join(kind for kind, *_ in KINDS)
            raise ValueError(f"nothing is measured: give the noise of one of {names}")
        object.__setattr__(
            self, "delay", validation.whole_number("delay", self.delay, 0, validation.MOST_SAMPLES)
        )
        for name in ("drop_rate", "outlier_rate"):
            object.__setattr__(self, name, _rate(name, getattr(self, name)))

    def count_of(self, chooser: str) -> int:
        """Return how many there are of what an argument chooses from.

        Parameters
        ----------
        chooser : {"nodes", "strings", "bars", "tension_strings", "rate_bars"}

        Returns
        -------
        int
        """
        if validation.choice("chooser", chooser, [name for _, _, name, _ in KINDS]) == "nodes":
            return int(self.structure.nodes.shape[1])
        of_bars = chooser in ("bars", "rate_bars")
        return len(self.structure.bars if of_bars else self.structure.strings)

    @cached_property
    def _taken(self) -> tuple[tuple[FloatArray, IntArray, str, int], ...]:
        """Noise, indices, kind and numbers in a reading, of each kind that is measured."""
        return tuple(
            (
                getattr(self, kind),
                getattr(self, chooser),
                kind,
                sizes[self.structure.dimension - 2],
            )
            for kind, _, chooser, sizes in KINDS
            if getattr(self, kind) is not None
        )

    @cached_property
    def readings(self) -> tuple[str, ...]:
        """Names of the readings in the order of y, like ``"string_length 3"``."""
        return tuple(f"{kind} {index}" for _, which, kind, _ in self._taken for index in which)

    @cached_property
    def reading_of(self) -> IntArray:
        """For each entry of y the index of its reading, shape (m,)."""
        sizes = np.concatenate([np.full(len(which), size) for _, which, _, size in self._taken])
        return frozen(np.repeat(np.arange(len(sizes)), sizes))

    @cached_property
    def noise(self) -> FloatArray:
        """Standard deviation of each entry of y, shape (m,), in its unit."""
        parts = [np.repeat(noise, size) for noise, _, _, size in self._taken]
        return frozen(np.concatenate([np.zeros(0), *parts]))

    @property
    def measured(self) -> tuple[bytes | None, ...]:
        """Key of what is measured: equal for sensors of other noise, delay and losses."""
        chosen = (getattr(self, chooser) for _, _, chooser, _ in KINDS)
        return tuple(None if which is None else which.tobytes() for which in chosen)

    def measure(
        self, nodes: object, tension: object = None, velocities: object = None
    ) -> FloatArray:
        """Return y without noise.

        Parameters
        ----------
        nodes : array_like, shape (d, n)
            Node positions, m.
        tension : array_like, shape (α,), optional
            Tension of each string of the structure, N. Where it is not given, measured
            tensions are NaN, which is to say lost.
        velocities : array_like, shape (d, n), optional
            Node velocities, m/s. Where they are not given, measured rates are NaN.

        Returns
        -------
        ndarray, shape (m,)

        Raises
        ------
        TypeError, ValueError
            If an argument does not fit or is not finite, or a bar has no length.
        """
        structure, N = self.structure, self.structure.checked_nodes("nodes", nodes)
        length = np.linalg.norm(structure.bar_vectors(N), axis=0)
        for kind, which in (("bar_direction", self.bars), ("bar_rate", self.rate_bars)):
            if getattr(self, kind) is not None and not length[which].all():
                bar = int(length[which].argmin())
                raise ValueError(f"nodes: bar {bar} of those measured has no length")
        pulls, V = np.full(len(structure.strings), np.nan), np.full(N.shape, np.nan)
        if self.string_tension is not None and tension is not None:
            pulls = validation.shaped("tension", tension, pulls.shape, "one per string, N")
        if self.bar_rate is not None and velocities is not None:
            V = structure.checked_nodes("velocities", velocities)
        return self._read(N, V, pulls)[0]

    @cached_property
    @builds
    def _read(self) -> SharedEvaluator:
        """Function ``(N, V, tension) -> y``."""
        shape, count = self.structure.nodes.shape, len(self.structure.strings)
        given = ca.SX.sym("N", *shape), ca.SX.sym("V", *shape), ca.SX.sym("tension", count)
        y = ca.densify(symbolic_readings(self, *given))
        return SharedEvaluator(Function("readings", given, [ca.cse(y)]))

    def disturb(self, exact: object, generator: np.random.Generator) -> FloatArray:
        """Return y with noise, corrupt readings and losses; what is lost is NaN.

        Each call draws as many random numbers, whatever comes of them.

        Parameters
        ----------
        exact : array_like, shape (m,)
            From :meth:`measure`.
        generator : numpy.random.Generator

        Returns
        -------
        ndarray, shape (m,)

        Raises
        ------
        TypeError, ValueError
            If ``generator`` is none, or ``exact`` has another shape or an infinite entry.
        """
        exact = validation.measured("exact", exact, self.noise.shape, "one entry per number read")
        validation.float_array("exact", np.nan_to_num(exact, posinf=np.inf, neginf=-np.inf))
        validation.instance(
            "generator", generator, np.random.Generator, "np.random.default_rng(seed)"
        )
        count = len(self.readings)
        noise = generator.normal(size=len(self.noise))
        lost = generator.random() < self.drop_rate
        corrupt = generator.random(count) < self.outlier_rate
        off = generator.uniform(*_OFF, size=count) * generator.choice([-1.0, 1.0], size=count)
        if lost:
            return np.full(len(noise), np.nan)
        return np.asarray(exact + self.noise * (noise + (corrupt * off)[self.reading_of]))

    def __repr__(self) -> str:
        kinds = ", ".join(kind for _, _, kind, _ in self._taken)
        return f"Sensors({kinds}; {len(self.readings)} readings, delay {self.delay})"


def symbolic_readings(sensors: Sensors, N: Any, V: Any, tension: Any) -> Any:
    """Return y, shape (m,), of node positions and velocities, (d, n), and tensions, (α,)."""
    structure = sensors.structure

    def direction(which: IntArray) -> Any:
        b = kernel.differences(N, structure.bars[which])
        return kernel.scale_columns(b, 1 / kernel.length(b))

    def rate(which: IntArray) -> Any:
        b, moved = (kernel.differences(motion, structure.bars[which]) for motion in (N, V))
        planes = [(1, 2), (2, 0), (0, 1)][-1 if structure.dimension == 2 else 0 :]
        turned = [b[i, :] * moved[j, :] - b[j, :] * moved[i, :] for i, j in planes]
        return kernel.scale_columns(ca.vertcat(*turned), 1 / kernel.dots(b, b))

    readings: dict[str, Callable[[IntArray], Any]] = {
        "node_position": lambda which: N[:, which.tolist()],
        "string_length": lambda which: kernel.string_lengths(structure, N)[which.tolist()],
        "bar_direction": direction,
        "string_tension": lambda which: tension[which.tolist()],
        "bar_rate": rate,
    }
    parts = [
        readings[kind](getattr(sensors, chooser))
        for kind, _, chooser, _ in KINDS
        if getattr(sensors, kind) is not None
    ]
    return ca.vertcat(*map(ca.vec, parts))


def _chosen(name: str, chosen: Any, count: int) -> IntArray:
    """Return indices of what is measured, each once."""
    if chosen is None:
        return np.arange(count)
    return validation.index_list(name, chosen, count, f"there are {count}")


def _rate(name: str, value: object) -> float:
    rate = validation.number(name, value, "no unit")
    if not 0 <= rate < 1:
        raise ValueError(f"{name} is {rate:g}, expected a probability of at least 0 and below 1")
    return rate
