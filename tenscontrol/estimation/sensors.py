"""Sensors of a structure, with their faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple, final

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from tenscontrol import validation
from tenscontrol.actuation.motors import Motor, each_motor
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.equation import gravity_vector
from tenscontrol.dynamics.evaluator import built, evaluate_columns
from tenscontrol.fields import Field, OptionalArray, converted
from tenscontrol.properties import cached_property
from tenscontrol.structure.bar_geometry import bar_lengths
from tenscontrol.structure.structure import Structure

_Chosen = Field[Sequence[int] | IntArray | None, IntArray | None]
_Bias = Field[Mapping[str, Sequence[float]] | None, tuple[tuple[str, tuple[float, float]], ...]]

# A corrupt reading is off by so many standard deviations.
_OFF = (20.0, 200.0)

# Part of a bar, and length in m, below which what is horizontal, or a range, counts as none: roots
# have no slope at 0.
_UPRIGHT, _AT_ANCHOR = 1e-9, 1e-9

# A bar that is less inclined than this to the vertical has its first axis along x.
_NO_LEVEL = 1e-6


# ---- kinds of readings ----


class Moment(NamedTuple):
    """What sensors read at a moment, as expressions; motions (d, n), the rest one per string."""

    nodes: Any
    velocities: Any
    acceleration: Any
    tension: Any
    rest_length: Any


@dataclass(frozen=True)
class SensorKind:
    """A kind of reading: the argument of :class:`Sensors` that it is, and what it reads.

    ``chooser`` is the argument that says of which ``members``; ``sizes`` are the numbers in a
    reading in the plane and in space. ``read`` returns them, one column a reading, or one column
    a member. ``needs`` are the entries of :class:`Moment` beside the nodes; ``sees_place`` says
    whether a motion as one body changes the reading; ``also`` is a further argument that it needs.
    """

    name: str
    unit: str
    chooser: str
    members: str
    sizes: tuple[int, int]
    read: Callable[[Sensors, Moment, IntArray], Any]
    needs: tuple[str, ...] = ()
    sees_place: bool = True
    also: str | None = None

    @property
    def needs_input(self) -> bool:
        """Whether it depends on what actuators hold."""
        return not {"tension", "acceleration", "rest_length"}.isdisjoint(self.needs)


def _node_position(sensors: Sensors, moment: Moment, which: IntArray) -> Any:
    return moment.nodes[:, which.tolist()]


def _string_length(sensors: Sensors, moment: Moment, which: IntArray) -> Any:
    return kernel.string_lengths(sensors.structure, moment.nodes)[which.tolist()]


def _bar_direction(sensors: Sensors, moment: Moment, which: IntArray) -> Any:
    b = kernel.differences(moment.nodes, sensors.structure.bars[which])
    return kernel.scale_columns(b, 1 / kernel.length(b))


def _string_tension(sensors: Sensors, moment: Moment, which: IntArray) -> Any:
    return moment.tension[which.tolist()]


def _bar_rate(sensors: Sensors, moment: Moment, which: IntArray) -> Any:
    pairs = sensors.structure.bars[which]
    b, moved = (kernel.differences(motion, pairs) for motion in (moment.nodes, moment.velocities))
    planes = [(1, 2), (2, 0), (0, 1)][-1 if sensors.structure.dimension == 2 else 0 :]
    turned = [b[i, :] * moved[j, :] - b[j, :] * moved[i, :] for i, j in planes]
    return kernel.scale_columns(ca.vertcat(*turned), 1 / kernel.dots(b, b))


def _bar_inclination(sensors: Sensors, moment: Moment, which: IntArray) -> Any:
    b, up = kernel.differences(moment.nodes, sensors.structure.bars[which]), ca.DM(sensors.up)
    rise = ca.mtimes(up.T, b)
    level = b - ca.mtimes(up, rise)
    return ca.atan2(rise, ca.sqrt(kernel.dots(level, level) + _UPRIGHT**2 * kernel.dots(b, b)))


def _gyroscope(sensors: Sensors, moment: Moment, which: IntArray) -> Any:
    if sensors.structure.dimension == 2:
        return _bar_rate(sensors, moment, which)
    pairs = sensors.structure.bars[which]
    moved = kernel.differences(moment.velocities, pairs)
    size = kernel.length(kernel.differences(moment.nodes, pairs))
    _, first, second = _axes(sensors, moment, which)
    # (d × ḋ)·e, with e₂ = d × e₁.
    turned = ca.vertcat(-kernel.dots(moved, second), kernel.dots(moved, first))
    return kernel.scale_columns(turned, 1 / size)


def _accelerometer(sensors: Sensors, moment: Moment, which: IntArray) -> Any:
    gravity = ca.DM(np.tile(sensors.free_fall[:, None], len(which)))
    felt = moment.acceleration[:, which.tolist()] - gravity
    axes = _axes(sensors, moment, sensors.bar_at[which])
    return ca.vertcat(*(kernel.dots(felt, axis) for axis in axes))


def _node_range(sensors: Sensors, moment: Moment, which: IntArray) -> Any:
    assert sensors.anchors is not None  # ranges need them
    ranges = []
    for anchor in sensors.anchors.T:
        away = moment.nodes[:, which.tolist()] - ca.DM(np.tile(anchor[:, None], len(which)))
        ranges.append(ca.sqrt(kernel.dots(away, away) + _AT_ANCHOR**2))
    return ca.vertcat(*ranges)


def _encoder(sensors: Sensors, moment: Moment, which: IntArray) -> Any:
    assert sensors.motor is not None  # encoders need it
    motor = each_motor(sensors.motor, len(sensors.structure.strings))
    wound = ca.DM(motor.zero[which]) - moment.rest_length[which.tolist()]
    return wound / ca.DM(motor.lever[which])


def _axes(sensors: Sensors, moment: Moment, which: IntArray) -> list[Any]:
    """Return the axes of bars, (d, bars) each: along the bar, and those across it.

    They are those of the structure's own shape, turned with the bar the shortest way, by
    ``e − (e·d)/(1 + d₀·d) (d₀ + d)``.
    """
    d = _bar_direction(sensors, moment, which)
    if sensors.structure.dimension == 2:
        return [d, ca.vertcat(-d[1, :], d[0, :])]
    along, *across = (ca.DM(axis) for axis in sensors.bar_axes[:, :, which])
    both = along + d
    scale = 1 / (1 + kernel.dots(along, d))
    return [d, *(e - kernel.scale_columns(both, scale * kernel.dots(e, d)) for e in across)]


# Each is an argument of Sensors, and so is its chooser; readings come in this order.
KINDS = (
    SensorKind("node_position", "m", "nodes", "nodes", (2, 3), _node_position),
    SensorKind("string_length", "m", "strings", "strings", (1, 1), _string_length, (), False),
    SensorKind("bar_direction", "no unit", "bars", "bars", (2, 3), _bar_direction),
    SensorKind(
        "string_tension", "N", "tension_strings", "strings", (1, 1), _string_tension,
        ("tension",), False,
    ),
    SensorKind("bar_rate", "rad/s", "rate_bars", "bars", (1, 3), _bar_rate, ("velocities",)),
    SensorKind("bar_inclination", "rad", "inclination_bars", "bars", (1, 1), _bar_inclination),
    SensorKind("gyroscope", "rad/s", "gyroscope_bars", "bars", (1, 2), _gyroscope, ("velocities",)),
    SensorKind(
        "accelerometer", "m/s²", "accelerometer_nodes", "nodes", (2, 3), _accelerometer,
        ("acceleration",),
    ),
    SensorKind("node_range", "m", "range_nodes", "nodes", (1, 1), _node_range, also="anchors"),
    SensorKind(
        "encoder", "rad", "encoder_strings", "strings", (1, 1), _encoder, ("rest_length",),
        False, "motor",
    ),
)  # fmt: skip


class _Taken(NamedTuple):
    """A kind that is measured, the noise of each member, their indices, and their readings each."""

    kind: SensorKind
    noise: FloatArray
    which: IntArray
    each: int
    size: int


# ---- sensors ----


@final
@dataclass(frozen=True, eq=False)
class Sensors:
    """Sensors: what is measured at each sample, with Gaussian noise on each number.

    A quantity is measured if its standard deviation is given. The readings of a sample are one
    vector y, shape (m,), kind after kind in the order below. Vectors are in the frame of the
    structure, unless they are said to be in the axes of a bar; their x, y and z come together.

    Parameters
    ----------
    structure : Structure
        Of a subdivided one the parent, if the plant of the filter is that of the parent.
    node_position : float or array_like, shape (nodes,), optional
        Standard deviation of each coordinate of a node, m.
    string_length : float or array_like, shape (strings,), optional
        Standard deviation of the length of a string, m: of a clustered one, of all its segments.
    bar_direction : float or array_like, shape (bars,), optional
        Standard deviation of each entry of a direction, about that of an angle in rad. A direction
        is the unit vector d from start to end of the bar.
    string_tension : float or array_like, shape (tension_strings,), optional
        Standard deviation of a tension, N.
    bar_rate : float or array_like, shape (rate_bars,), optional
        Standard deviation of each entry of an angular velocity ``d × ḋ``, rad/s. Thin bars have no
        spin about their axis. In the plane it is one number, positive counterclockwise.
    bar_inclination : float or array_like, shape (inclination_bars,), optional
        Standard deviation of the angle of a bar above the horizontal, rad: positive where its end
        is above its start. It needs no compass, and does not say where a bar points.
    gyroscope : float or array_like, shape (gyroscope_bars,), optional
        Standard deviation of each entry of an angular velocity, rad/s, in the axes of the bar: two
        numbers, about the axes across the bar. In the plane it is that of ``bar_rate``.
    accelerometer : float or array_like, shape (accelerometer_nodes,), optional
        Standard deviation of each entry of the specific force ``N̈ − g`` of a node, m/s², in the
        axes of the first bar at it: a node at rest reads 9.81 m/s² upwards, one that falls 0.
    node_range : float or array_like, shape (range_nodes,), optional
        Standard deviation of the distance of a node from each of ``anchors``, m.
    encoder : float or array_like, shape (encoder_strings,), optional
        Standard deviation of the angle of a motor, rad, that winds a string by ``motor``.
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
    inclination_bars : sequence or set of int, or mask, optional
        Bars whose inclination is measured; all if not given.
    gyroscope_bars : sequence or set of int, or mask, optional
        Bars with a gyroscope; all if not given.
    accelerometer_nodes : sequence or set of int, or mask, optional
        Nodes with an accelerometer, at ends of bars; all of these if not given.
    range_nodes : sequence or set of int, or mask, optional
        Nodes whose range is measured; all if not given.
    encoder_strings : sequence or set of int, or mask, optional
        Strings whose motor has an encoder; all if not given.
    anchors : array_like, shape (d, anchors), optional
        Known places from which ranges are measured, m.
    motor : Motor, optional
        Drum radius, gear ratio and rest length at angle zero of the motors with encoders.
    gravity : float or array_like, shape (d,)
        Acceleration of free fall, m/s², for inclinations and accelerometers; as in :class:`Model`.
    bias : mapping of str to (float, float), optional
        Kinds with an unknown bias on each number: its standard deviation at the start, and that of
        its random walk in a second, in units of the reading and of that per √s. A filter estimates
        it.
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

    A gyroscope whose bias is within 0.05 rad/s, and wanders by 0.001 rad/s in a second:

    >>> tc.Sensors(structure=prism, string_length=0.001, bar_inclination=0.01, gyroscope=0.01,
    ...            gyroscope_bars=[0], bias={"gyroscope": (0.05, 1e-3)})
    Sensors(string_length, bar_inclination, gyroscope with bias; 13 readings, delay 0)
    """

    structure: Structure
    _: KW_ONLY
    node_position: OptionalArray = converted(None)
    string_length: OptionalArray = converted(None)
    bar_direction: OptionalArray = converted(None)
    string_tension: OptionalArray = converted(None)
    bar_rate: OptionalArray = converted(None)
    bar_inclination: OptionalArray = converted(None)
    gyroscope: OptionalArray = converted(None)
    accelerometer: OptionalArray = converted(None)
    node_range: OptionalArray = converted(None)
    encoder: OptionalArray = converted(None)
    nodes: _Chosen = converted(None)
    strings: _Chosen = converted(None)
    bars: _Chosen = converted(None)
    tension_strings: _Chosen = converted(None)
    rate_bars: _Chosen = converted(None)
    inclination_bars: _Chosen = converted(None)
    gyroscope_bars: _Chosen = converted(None)
    accelerometer_nodes: _Chosen = converted(None)
    range_nodes: _Chosen = converted(None)
    encoder_strings: _Chosen = converted(None)
    anchors: OptionalArray = converted(None)
    motor: Motor | None = None
    gravity: Field[ArrayLike, FloatArray] = converted(9.81)
    bias: _Bias = converted(None)
    delay: int = 0
    drop_rate: float = 0.0
    outlier_rate: float = 0.0

    def __post_init__(self) -> None:
        validation.instance(
            "structure", self.structure, Structure, "make one by Structure(...) or prism()"
        )
        for kind in KINDS:
            self._take(kind)
        if all(getattr(self, kind.name) is None for kind in KINDS):
            names = ", ".join(kind.name for kind in KINDS)
            raise ValueError(f"nothing is measured: give the noise of one of {names}")
        free_fall = gravity_vector(self.gravity, self.structure.dimension)
        object.__setattr__(self, "gravity", frozen(free_fall))
        self._check_places()
        self._check_motor()
        object.__setattr__(self, "bias", _checked_bias(self.bias, self._taken))
        object.__setattr__(
            self, "delay", validation.whole_number("delay", self.delay, 0, validation.MOST_SAMPLES)
        )
        for name in ("drop_rate", "outlier_rate"):
            object.__setattr__(self, name, _rate(name, getattr(self, name)))

    def _take(self, kind: SensorKind) -> None:
        """Check the noise of a kind, and of which members it is."""
        noise, chosen = getattr(self, kind.name), getattr(self, kind.chooser)
        if noise is None:
            if chosen is not None and len(validation.index_array(kind.chooser, chosen)):
                raise ValueError(f"{kind.chooser} is given, but {kind.name} is not: give its noise")
            return
        count = self.count_of(kind.chooser)
        which = self._available(kind)
        if chosen is not None:
            which = validation.index_list(kind.chooser, chosen, count, f"there are {count}")
        deviation = validation.positive(
            kind.name,
            validation.per_member(kind.name, noise, len(which), f"entry of {kind.chooser}"),
            f"standard deviation, {kind.unit}",
        )
        object.__setattr__(self, kind.name, frozen(deviation))
        object.__setattr__(self, kind.chooser, frozen(which))

    def _available(self, kind: SensorKind) -> IntArray:
        """Return all members of which a kind can be measured."""
        if kind.name == "accelerometer":  # it has the axes of a bar
            return np.flatnonzero(self.bar_at >= 0)
        return np.arange(self.count_of(kind.chooser))

    def _check_places(self) -> None:
        """Check what gravity and anchors are needed for."""
        d = self.structure.dimension
        if self.bar_inclination is not None and not self.free_fall.any():
            raise ValueError(
                "gravity is 0, but bar_inclination is measured against it: give gravity=9.81, or "
                "its vector"
            )
        chosen = () if self.accelerometer_nodes is None else self.accelerometer_nodes
        loose = [] if self.accelerometer is None else [i for i in chosen if self.bar_at[i] < 0]
        if loose:
            raise ValueError(
                f"accelerometer_nodes has node {loose[0]}, which is at no bar, so that an "
                "accelerometer there has no axes: choose nodes at ends of bars"
            )
        if (self.anchors is None) != (self.node_range is None):
            given, missing = ("anchors", "node_range")[:: 1 if self.node_range is None else -1]
            how = "give its noise" if missing == "node_range" else f"give them, shape ({d}, count)"
            raise ValueError(f"{given} is given, but {missing} is not: {how}")
        if self.anchors is None:
            return
        anchors = validation.float_array("anchors", self.anchors)
        if anchors.ndim != 2 or anchors.shape[0] != d or not anchors.shape[1]:
            raise ValueError(
                f"anchors has shape {anchors.shape}, expected ({d}, count): one column an anchor, m"
            )
        object.__setattr__(self, "anchors", frozen(anchors))

    def _check_motor(self) -> None:
        """Check what encoders need."""
        if self.motor is not None:
            validation.instance("motor", self.motor, Motor, "make one by Motor(drum_radius=...)")
            each_motor(self.motor, len(self.structure.strings))
        if self.encoder is not None and (self.motor is None or self.motor.zero is None):
            missing = "motor" if self.motor is None else "motor.zero"
            raise ValueError(
                f"encoder is given, but {missing} is not: give Motor(drum_radius=..., "
                "gear_ratio=..., zero=...) with the rest lengths at angle zero"
            )

    @property
    def free_fall(self) -> FloatArray:
        """Acceleration of free fall, m/s², shape (d,)."""
        return np.asarray(self.gravity)

    @property
    def up(self) -> FloatArray:
        """Unit vector against gravity, shape (d,)."""
        return -validation.direction("gravity", self.free_fall, self.structure.dimension)

    @cached_property
    def bar_at(self) -> IntArray:
        """The first bar at each node, shape (n,), -1 where there is none."""
        first = np.full(self.structure.nodes.shape[1], -1)
        for bar in range(len(self.structure.bars) - 1, -1, -1):
            first[self.structure.bars[bar]] = bar
        return frozen(first)

    @cached_property
    def bar_axes(self) -> FloatArray:
        """Axes of each bar in space, in the shape of the structure, shape (3, 3, β).

        Along the first index the axes: from start to end of the bar; level, ``d × up`` scaled to 1,
        or across x for an upright bar; and across both. Sensors on a bar read in them, as the bar
        carries them: it turns them the shortest way from there.
        """
        along = self.structure.bar_vectors(self.structure.nodes)
        along = along / np.linalg.norm(along, axis=0)
        up = self.up if self.free_fall.any() else np.array([0.0, 0.0, 1.0])
        level = np.cross(along, up[:, None], axis=0)
        other = np.cross(along, np.array([[1.0], [0.0], [0.0]]), axis=0)
        upright = np.linalg.norm(level, axis=0) < _NO_LEVEL
        level = np.where(upright, other, level)
        level = level / np.linalg.norm(level, axis=0)
        return frozen(np.stack([along, level, np.cross(along, level, axis=0)]))

    def count_of(self, chooser: str) -> int:
        """Return how many there are of what an argument chooses from.

        Parameters
        ----------
        chooser : str
            Of the arguments of the class one that chooses, like ``"nodes"`` or ``"rate_bars"``.

        Returns
        -------
        int
        """
        validation.choice("chooser", chooser, [kind.chooser for kind in KINDS])
        members = next(kind.members for kind in KINDS if kind.chooser == chooser)
        structure = self.structure
        counts = {"nodes": structure.nodes.shape[1], "bars": len(structure.bars)}
        return int((counts | {"strings": len(structure.strings)})[members])

    @cached_property
    def _taken(self) -> tuple[_Taken, ...]:
        """The kinds that are measured."""
        return tuple(
            _Taken(
                kind,
                getattr(self, kind.name),
                getattr(self, kind.chooser),
                self.anchors.shape[1] if kind.also == "anchors" and self.anchors is not None else 1,
                kind.sizes[self.structure.dimension - 2],
            )
            for kind in KINDS
            if getattr(self, kind.name) is not None
        )

    @property
    def kinds(self) -> tuple[SensorKind, ...]:
        """The kinds that are measured."""
        return tuple(taken.kind for taken in self._taken)

    def needs(self, part: str) -> bool:
        """Return whether a reading depends on a part of a moment.

        Parameters
        ----------
        part : {"nodes", "velocities", "acceleration", "tension", "rest_length"}

        Returns
        -------
        bool
        """
        return validation.choice("part", part, Moment._fields) in self._needed

    @cached_property
    def _needed(self) -> frozenset[str]:
        """The parts of a moment beside the nodes that readings depend on."""
        return frozenset(name for kind in self.kinds for name in kind.needs)

    @cached_property
    def _parts(self) -> tuple[str, ...]:
        """The parts of a moment that readings depend on, in its order."""
        return tuple(name for name in Moment._fields if name == "nodes" or name in self._needed)

    @cached_property
    def readings(self) -> tuple[str, ...]:
        """Names of the readings in the order of y, like ``"string_length 3"``."""
        return tuple(
            f"{taken.kind.name} {index}" + (f" to anchor {anchor}" if taken.each > 1 else "")
            for taken in self._taken
            for index in taken.which
            for anchor in range(taken.each)
        )

    @cached_property
    def reading_of(self) -> IntArray:
        """For each entry of y the index of its reading, shape (m,)."""
        sizes = np.concatenate([np.full(len(t.which) * t.each, t.size) for t in self._taken])
        return frozen(np.repeat(np.arange(len(sizes)), sizes))

    @cached_property
    def noise(self) -> FloatArray:
        """Standard deviation of each entry of y, shape (m,), in its unit."""
        deviations = [np.repeat(taken.noise, taken.each * taken.size) for taken in self._taken]
        return frozen(np.concatenate([np.zeros(0), *deviations]))

    @cached_property
    def needs_input(self) -> np.ndarray:
        """Which readings depend on what actuators hold, shape (readings,)."""
        needed = [np.full(len(t.which) * t.each, t.kind.needs_input) for t in self._taken]
        return frozen(np.concatenate(needed))

    @cached_property
    def bias_deviation(self) -> FloatArray:
        """Standard deviation of the bias of each entry of y at the start, shape (m,); 0: none."""
        return frozen(self._bias_of(0))

    @cached_property
    def bias_walk(self) -> FloatArray:
        """Standard deviation of its random walk in a second, shape (m,), per √s."""
        return frozen(self._bias_of(1))

    def _bias_of(self, number: int) -> FloatArray:
        sizes = dict(self.bias)
        none = (0.0, 0.0)
        biases = [
            np.full(len(t.which) * t.each * t.size, sizes.get(t.kind.name, none)[number])
            for t in self._taken
        ]
        return np.concatenate(biases)

    @property
    def measured(self) -> tuple[object, ...]:
        """Key of what is measured: equal for sensors of other noise, delay and losses."""
        chosen = (getattr(self, kind.chooser) for kind in KINDS)
        numbers = [*chosen, self.gravity, self.anchors]
        if self.motor is not None and self.encoder is not None:
            numbers += [self.motor.lever, self.motor.zero]
        return (
            tuple(None if number is None else np.asarray(number).tobytes() for number in numbers),
            tuple(kind for kind, _ in self.bias),
        )

    def measure(
        self,
        nodes: object,
        tension: object = None,
        velocities: object = None,
        acceleration: object = None,
        rest_length: object = None,
    ) -> FloatArray:
        """Return y without noise and bias.

        What is not given is not known: readings that depend on it are NaN, which is to say lost.

        Parameters
        ----------
        nodes : array_like, shape (d, n)
            Node positions, m.
        tension : array_like, shape (α,), optional
            Tension of each string of the structure, N.
        velocities : array_like, shape (d, n), optional
            Node velocities, m/s.
        acceleration : array_like, shape (d, n), optional
            Node accelerations, m/s².
        rest_length : array_like, shape (α,), optional
            Rest length of each string of the structure, m.

        Returns
        -------
        ndarray, shape (m,)

        Raises
        ------
        TypeError, ValueError
            If an argument does not fit or is not finite, or a bar has no length.
        """
        structure, N = self.structure, self.structure.checked_nodes("nodes", nodes)
        length = bar_lengths(structure, N)
        for taken in self._taken:
            which = taken.which if taken.kind.members == "bars" else self.bar_at[:0]
            if not length[which].all():
                bar = int(which[length[which].argmin()])
                raise ValueError(f"nodes: bar {bar} of those measured has no length")
        strings, motion = np.full(len(structure.strings), np.nan), np.full(N.shape, np.nan)
        given: dict[str, FloatArray] = {"velocities": motion, "acceleration": motion}
        given |= {"tension": strings, "rest_length": strings}
        if self.needs("tension") and tension is not None:
            given["tension"] = validation.shaped(
                "tension", tension, strings.shape, "one per string, N"
            )
        if self.needs("rest_length") and rest_length is not None:
            given["rest_length"] = validation.shaped(
                "rest_length", rest_length, strings.shape, "one per string, m"
            )
        if self.needs("velocities") and velocities is not None:
            given["velocities"] = structure.checked_nodes("velocities", velocities)
        if self.needs("acceleration") and acceleration is not None:
            given["acceleration"] = structure.checked_nodes("acceleration", acceleration)
        rows = {name: value.ravel(order="F")[None] for name, value in given.items()}
        return np.asarray(self.measure_rows(N.ravel(order="F")[None], **rows)[0])

    def measure_rows(
        self,
        nodes: FloatArray,
        velocities: FloatArray | None = None,
        acceleration: FloatArray | None = None,
        tension: FloatArray | None = None,
        rest_length: FloatArray | None = None,
    ) -> FloatArray:
        """Return y without noise and bias of several moments, trusted to fit; see :meth:`measure`.

        Parameters
        ----------
        nodes : ndarray, shape (moments, n d)
            Node positions, m, node by node.
        velocities, acceleration : ndarray, shape (moments, n d), optional
            m/s and m/s².
        tension, rest_length : ndarray, shape (moments, α), optional
            N and m.

        Returns
        -------
        ndarray, shape (moments, m)
        """
        moment, columns = Moment(nodes, velocities, acceleration, tension, rest_length), []
        for i, name in enumerate(self._parts):
            rows = getattr(moment, name)
            if rows is None:
                rows = np.full((len(nodes), self._function.size1_in(i)), np.nan)
            columns.append(rows.T)
        return np.asarray(evaluate_columns(self._function, *columns)[0].T)

    @built
    def _function(self) -> ca.Function:
        """Return the function of the parts of a moment that are needed, one column each, to y."""
        shape, strings = self.structure.nodes.shape, (len(self.structure.strings), 1)
        sizes = Moment(shape, shape, shape, strings, strings)
        moment = Moment(*(ca.SX.sym(name, *sizes[i]) for i, name in enumerate(Moment._fields)))
        y = ca.densify(symbolic_readings(self, moment))
        inputs = [ca.vec(getattr(moment, name)) for name in self._parts]
        return ca.Function("readings", inputs, [ca.cse(y)])

    def draw_bias(
        self,
        generator: np.random.Generator,
        sample_time: float,
        before: FloatArray | None = None,
    ) -> FloatArray:
        """Return the bias of each entry of y, drawn at random.

        Parameters
        ----------
        generator : numpy.random.Generator
        sample_time : float
            Sample time, s.
        before : ndarray, shape (m,), optional
            The bias a sample before; at the start of a run there is none.

        Returns
        -------
        ndarray, shape (m,)

        Raises
        ------
        TypeError, ValueError
            If an argument is of the wrong kind or does not fit.
        """
        validation.instance(
            "generator", generator, np.random.Generator, "np.random.default_rng(seed)"
        )
        validation.positive_number("sample_time", sample_time, "s")
        if before is not None:
            validation.shaped("before", before, self.noise.shape, "one entry per number read")
        normal = generator.normal(size=len(self.noise))
        if before is None:
            return self.bias_deviation * normal
        return np.asarray(before + self.bias_walk * np.sqrt(sample_time) * normal)

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
        if np.abs(exact).max(initial=0.0, where=~np.isnan(exact)) > validation.LARGEST:
            validation.float_array("exact", np.nan_to_num(exact, posinf=np.inf, neginf=-np.inf))
        validation.instance(
            "generator", generator, np.random.Generator, "np.random.default_rng(seed)"
        )
        count = len(self.readings)
        noise = generator.normal(size=len(self.noise))
        chance = generator.random(1 + 2 * count), generator.integers(2, size=count)
        return noisy_readings(self, exact, noise, np.concatenate(chance))

    def __repr__(self) -> str:
        biased = dict(self.bias)
        kinds = ", ".join(
            f"{kind.name} with bias" if kind.name in biased else kind.name for kind in self.kinds
        )
        return f"Sensors({kinds}; {len(self.readings)} readings, delay {self.delay})"


def symbolic_readings(sensors: Sensors, moment: Moment) -> Any:
    """Return the expression of y, shape (m,), without bias."""
    readings = [
        kind.read(sensors, moment, getattr(sensors, kind.chooser)) for kind in sensors.kinds
    ]
    return ca.vertcat(*map(ca.vec, readings))


def noisy_readings(
    sensors: Sensors, exact: FloatArray, normal: FloatArray, chance: FloatArray | None
) -> FloatArray:
    """Return y with noise, corrupt readings and losses, shape (…, m); what is lost is NaN.

    ``normal`` are standard normal numbers, one an entry; ``chance`` are uniform from 0 to 1, shape
    (…, 1 + 3 readings): whether all is lost, which readings are corrupt, by how much, and to which
    side. None: nothing is lost or corrupt.
    """
    if chance is None:
        return np.asarray(exact + sensors.noise * normal)
    lost, corrupt, size, side = np.split(
        chance, [1, *(1 + len(sensors.readings) * k for k in (1, 2))], axis=-1
    )
    least, most = _OFF
    off = (least + (most - least) * size) * np.where(side < 0.5, -1.0, 1.0)
    off *= corrupt < sensors.outlier_rate
    noisy = exact + sensors.noise * (normal + off[..., sensors.reading_of])
    return np.where(lost < sensors.drop_rate, np.nan, noisy)


def _checked_bias(
    value: Any, taken: tuple[_Taken, ...]
) -> tuple[tuple[str, tuple[float, float]], ...]:
    """Return the deviation at the start and the walk of each kind with a bias, by name."""
    if value is None:
        return ()
    try:
        given = dict(value)
    except (TypeError, ValueError):
        raise validation.wrong_kind(
            "bias", value, 'a mapping, like {"gyroscope": (0.05, 1e-3)}'
        ) from None
    names = [of_kind.kind.name for of_kind in taken]
    for name, sizes in given.items():
        validation.choice("a key of bias", name, names)
        pair = validation.shaped(
            f"bias of {name}", sizes, (2,), "deviation at the start, and of the walk in a second"
        )
        validation.positive(f"bias of {name}", pair, "standard deviation")
        given[name] = (float(pair[0]), float(pair[1]))
    return tuple(given.items())


def _rate(name: str, value: object) -> float:
    rate = validation.number(name, value, "no unit")
    if not 0 <= rate < 1:
        raise ValueError(f"{name} is {rate:g}, expected a probability of at least 0 and below 1")
    return rate
