"""Controller interface: check of measurements, bounds of commands, weights of quadratic costs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from tenscontrol.actuation import Winches
from tenscontrol.control.status import Fallback, Status
from tenscontrol.dynamics import Exclusive, exclusive
from tenscontrol.plant import LinearPlant, regulator_riccati, state_units
from tenscontrol.validation import (
    FloatArray,
    float_array,
    frozen,
    instance,
    measured,
    number,
    per_member,
    positive,
    positive_number,
    shaped,
    truth,
)

# A bar may be measured longer or shorter by this part of its length, and a fixed node off its
# place by this part of the size: far above sensor noise, far below a swapped or lost marker.
_BAR, _SUPPORT = 0.1, 0.1

# Largest distance of two nodes along an axis, and of a node from the origin (where too few digits
# of the shape are left), in sizes of the structure.
_SPREAD, _FAR = 10.0, 1e6

# Largest relative motion of two nodes, in sizes, in a sample and in the time constant of the
# fastest pole.
_SPEED = 10.0

# A rest length is kept above this fraction of its value at the operating point.
_SHORTEST = 0.01

# Relative size of what counts as round-off in a weight matrix.
_TOLERANCE = 1e-12

# Methods of controllers that use what they remember of the samples before.
_WITH_MEMORY = {"applied", "command", "fall_back", "follow", "prepare", "reset", "take_over"}


@dataclass(frozen=True, eq=False)
class Command:
    """Command of a controller for one sample.

    Attributes
    ----------
    value : ndarray, shape (α,)
        γ, N/m, or rest lengths, m, as the controller's ``input`` says. Finite
        and within the controller's bounds, always; where the change is limited,
        no farther than that from the previous input.
    status : Status
        ``Status.OK``, or why the command is not what the controller wanted.
    fallback : Fallback or None
        What was commanded instead; None if the command is the controller's decision.
    detail : str
        Figures that explain the status.
    """

    value: FloatArray
    status: Status = Status.OK
    fallback: Fallback | None = None
    detail: str = ""

    def __str__(self) -> str:
        """Return status, fallback and detail in one line."""
        return ": ".join(filter(None, (self.status, self.fallback, self.detail)))


class MeasurementCheck:
    """Which measurements a structure can have; a controller does not use any other."""

    def __init__(self, plant: LinearPlant, sample_time: float | None) -> None:
        structure = plant.model.structure
        size = float(np.ptp(plant.nodes, axis=1).max())
        rate = plant.spectral_radius
        if sample_time is not None:
            rate = max(rate, 1 / sample_time)
        # Largest difference of velocities of two nodes along an axis, m/s. A plant without
        # stiffness, run at any sample time, gives no limit.
        self.fastest = _SPEED * size * rate if rate > 0 else np.finfo(float).max / _FAR
        self.spread = _SPREAD * size  # the same of positions, m
        # Largest velocity, m/s, and coordinate, m, of a node along an axis.
        self.largest_velocity, self.farthest = _FAR * self.fastest, _FAR * size
        self.support_distance = _SUPPORT * size  # of a fixed node from its place, m
        self.fixed, self.places = structure.fixed, plant.nodes[:, structure.fixed]
        rolling = np.setdiff1d(structure.fixed_rows // len(plant.nodes), self.fixed)
        is_held = np.zeros(plant.nodes.size, bool)
        is_held[structure.fixed_rows] = True
        # Nodes on rollers, along which axes they are held, and where.
        self.rolling, self.held = rolling, is_held.reshape(plant.nodes.shape, order="F")[:, rolling]
        self.held_at = plant.nodes[:, rolling]
        self.bars = structure.bars.T
        # Least and largest square of the lengths of bars, m².
        self.squares = (
            ((1 - _BAR) * structure.bar_length) ** 2, ((1 + _BAR) * structure.bar_length) ** 2
        )  # fmt: skip

    def fault(self, nodes: FloatArray, velocities: FloatArray) -> Status | None:
        """Return a status for what is wrong with a measurement, shapes (d, n); None if nothing."""
        # Comparisons with what is not finite are false; no square overflows after the first.
        if not (
            np.abs(nodes).max() <= self.farthest
            and np.abs(velocities).max() <= self.largest_velocity
        ):
            finite = np.isfinite(nodes).all() and np.isfinite(velocities).all()
            return Status.MEASUREMENT_NOT_PLAUSIBLE if finite else Status.MEASUREMENT_NOT_FINITE
        start, end = self.bars
        bars = nodes[:, end] - nodes[:, start]
        square = (bars * bars).sum(axis=0)
        plausible = (
            np.ptp(nodes, axis=1).max() <= self.spread
            and np.ptp(velocities, axis=1).max() <= self.fastest
            and ((square >= self.squares[0]) & (square <= self.squares[1])).all()
        )
        if plausible and len(self.fixed):
            off = np.linalg.norm(nodes[:, self.fixed] - self.places, axis=0)
            plausible = bool(off.max() <= self.support_distance)
        if plausible and len(self.rolling):
            off = np.abs(nodes[:, self.rolling] - self.held_at)[self.held]
            plausible = bool(off.max() <= self.support_distance)
        return None if plausible else Status.MEASUREMENT_NOT_PLAUSIBLE


class Controller(ABC):
    """Turns measured motion into commands, one a sample.

    A controller of your own is a subclass with ``_decide``. Give it ``_fall_back`` if holding the
    previous input is not safe, and ``reset`` if it has a memory.

    Parameters
    ----------
    plant : LinearPlant
        The plant that it was designed on.
    sample_time : float or None
        Sample time, s. None for a law in continuous time, which is run at
        whatever sample time the simulation is given.
    low, high : ndarray, shape (α,)
        Least and largest command.
    change : ndarray, shape (α,), optional
        Largest change from the previous input; no limit if not given.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or no finite command is within the bounds.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> from tenscontrol.control import Command, Controller
    >>> class Damper(Controller):
    ...     def _decide(self, time, state):
    ...         rates = state[self.plant.degrees_of_freedom:]
    ...         return Command(self.plant.equilibrium_input - self.plant.B[len(rates):].T @ rates)
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> damper = Damper(plant, 0.02, np.zeros(9), np.full(9, 60.0))
    >>> str(damper.command(0.0, prism.nodes, np.zeros((3, 6))))
    'ok'
    """

    def __init__(
        self,
        plant: LinearPlant,
        sample_time: float | None,
        low: FloatArray,
        high: FloatArray,
        change: FloatArray | None = None,
    ) -> None:
        #: The thread that uses the controller: another one is refused meanwhile.
        self.in_use = Exclusive(f"this {type(self).__name__}")
        instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        if sample_time is not None:
            sample_time = positive_number("sample_time", sample_time, "s")
            plant.refuse_long_sample_time(sample_time)
        self._plant = plant
        self._sample_time = sample_time
        shape = plant.equilibrium_input.shape
        self._low = frozen(shaped("low", low, shape, "one per string"))
        self._high = frozen(measured("high", high, shape, "one per string"))
        wrong = np.flatnonzero(~(self._low <= self._high))
        if len(wrong):
            i = wrong[0]
            raise ValueError(
                f"high[{i}] is {self._high[i]:g}, expected at least low[{i}] = {self._low[i]:g}"
            )
        self._change = None
        if change is not None:
            change = shaped("change", change, shape, "one per string")
            self._change = frozen(positive("change", change, "change of the input"))
        self._measurement_check = MeasurementCheck(plant, sample_time)
        self._called = 0.0  # start of the last command, by perf_counter
        # Input over the last sample: as applied() says, else the last command; None before.
        self._previous_input: FloatArray | None = None
        # z that a subclass predicts for the next sample, and how far the last one was off, m.
        self._predicted: FloatArray | None = None
        self._prediction_error: float | None = None
        self._displacements, self._dimension = plant.basis, len(plant.nodes)
        self._status_count: Counter[Status] = Counter()
        self._fallback_count: Counter[Fallback] = Counter()

    @property
    def plant(self) -> LinearPlant:
        """The linear plant that the controller was designed on."""
        return self._plant

    @property
    def sample_time(self) -> float | None:
        """Sample time, s, or None."""
        return self._sample_time

    @property
    def input(self) -> str:
        """What it commands: ``"force_density"`` or ``"rest_length"``."""
        return self._plant.input

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest command, shape (α,) each."""
        return self._low, self._high

    @property
    def largest_change(self) -> FloatArray | None:
        """Largest change from the previous input, shape (α,); None for any."""
        return self._change

    @property
    def prediction_error(self) -> float | None:
        """How far the last measurement was off what was predicted a sample before, m.

        Of the node that is off most. None for a controller that predicts nothing, and where there
        was no measurement or no prediction.
        """
        return self._prediction_error

    def reference_nodes(self, times: FloatArray) -> FloatArray | None:
        """Return the shapes that it steers to at given times, shape (d, n, K), m; None if none.

        The tracking error of a run is measured from them. A controller of your own may say its.

        Parameters
        ----------
        times : ndarray, shape (K,)
            s.
        """
        return None

    @property
    def measurement_check(self) -> MeasurementCheck:
        """Which measurements are used."""
        return self._measurement_check

    def __init_subclass__(cls, **keywords: object) -> None:
        """Let one thread at a time call what uses the memory of a controller."""
        super().__init_subclass__(**keywords)
        for name in _WITH_MEMORY & vars(cls).keys():
            if callable(vars(cls)[name]):
                setattr(cls, name, exclusive(vars(cls)[name]))

    @exclusive
    def command(self, time: float, nodes: object, velocities: object) -> Command:
        """Return the command for the sample that starts now.

        A measurement that is not finite, or that the structure cannot have, is
        not used: the command is then the controller's fallback, and the status
        says so. The structure cannot have bars off their length by a tenth, fixed
        nodes off their places by a tenth of its size, nodes 10 sizes apart along an
        axis or a million from the origin, or nodes that move against each other by
        10 sizes in a sample and in the time constant of the fastest pole.

        Parameters
        ----------
        time : float
            s.
        nodes, velocities : array_like, shape (d, n)
            Measured motion, m and m/s.

        Returns
        -------
        Command

        Raises
        ------
        TypeError, ValueError
            If an array is not of numbers or has the wrong shape, or the time is
            not a finite number.
        """
        self._called = perf_counter()
        time = number("time", time, "s")
        shape = self._plant.coordinates.nodes.shape
        N, V = (measured(*pair, shape) for pair in (("nodes", nodes), ("velocities", velocities)))
        state, fault = self._measure(N, V)
        if fault is not None:
            return self.fall_back(fault)
        self._compare(state)
        # The previous input may be of any size: what overflows shows in the status.
        with np.errstate(over="ignore", invalid="ignore"):
            desired = self._decide(time, state)
        if not np.isfinite(desired.value).all():
            return self.fall_back(Status.INPUT_NOT_FINITE)
        return self._issue(desired)

    @exclusive
    def fall_back(self, status: Status) -> Command:
        """Return the fallback for a sample without a usable measurement or decision.

        Parameters
        ----------
        status : Status
            Why there is none.

        Returns
        -------
        Command

        Raises
        ------
        TypeError
            If it is no :class:`Status`.
        """
        instance("status", status, Status, "for example Status.MEASUREMENT_NOT_FINITE")
        self._compare(None)
        return self._issue(self._fall_back(status))

    def _compare(self, state: FloatArray | None) -> None:
        """Note how far a state is off the prediction, which is then used up."""
        predicted, self._predicted = self._predicted, None
        self._prediction_error = None
        if predicted is not None and state is not None:
            off = (state - predicted)[: self._displacements.shape[1]]
            nodes = (self._displacements @ off).reshape(-1, self._dimension)
            self._prediction_error = float(np.sqrt((nodes * nodes).sum(axis=1).max()))

    def _measure(
        self, nodes: FloatArray, velocities: FloatArray
    ) -> tuple[FloatArray, Status | None]:
        """Return the reduced state z for ``_decide``, and what is wrong with the measurement."""
        fault = self._measurement_check.fault(nodes, velocities)
        if fault is not None:
            return np.zeros(0), fault
        return self._plant.coordinates.measure(nodes, velocities), None

    def _issue(self, desired: Command) -> Command:
        """Return the nearest command within bounds; note it as the previous input and count it."""
        self._previous_input = frozen(self._within_bounds(desired.value))
        self._status_count[desired.status] += 1
        if desired.fallback is not None:
            self._fallback_count[desired.fallback] += 1
        return replace(desired, value=self._previous_input)

    @exclusive
    def applied(self, value: object) -> None:
        """Set the previous input, where it may differ from the last command.

        A winch may be slow, at the end of its range or stuck. Changes are limited
        from the input given here. A simulation calls this after each command, and
        before the first with the rest lengths at the start. Without it the last
        command is the previous input.

        Parameters
        ----------
        value : array_like, shape (α,)
            γ, N/m, or rest lengths, m, as the controller's ``input`` says.

        Raises
        ------
        TypeError, ValueError
            If it is not finite or has the wrong shape.
        """
        self._previous_input = self._checked_input("value", value)

    def _checked_input(self, name: str, value: object) -> FloatArray:
        return frozen(shaped(name, value, self._low.shape, "one per string"))

    @property
    def _previous_within_bounds(self) -> FloatArray:
        """The previous input within bounds: changes are limited from here."""
        previous = self._previous_input
        if previous is None:
            previous = self._plant.equilibrium_input
        # Bounds come before the limit of change, wherever the actuators are.
        return np.clip(previous, self._low, self._high)

    @property
    def _sample_bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest command of this sample, the limit of change included."""
        if self._change is None:
            return self._low, self._high
        previous = self._previous_within_bounds
        low, high = previous - self._change, previous + self._change
        return np.maximum(self._low, low), np.minimum(self._high, high)

    def _within_bounds(self, desired: FloatArray) -> FloatArray:
        """Return the nearest input within the bounds of this sample."""
        return np.clip(desired, *self._sample_bounds)

    @exclusive
    def reset(self) -> None:
        """Forget everything that was measured, planned or applied."""
        self._previous_input = self._predicted = None
        self._status_count, self._fallback_count = Counter(), Counter()

    @exclusive
    def take_over(self, command: object) -> None:
        """Take over from another controller: plans from this one's own commands are dropped.

        Parameters
        ----------
        command : array_like, shape (α,)
            The previous input.

        Raises
        ------
        TypeError, ValueError
            If it is not finite or has the wrong shape.
        """
        self._previous_input = self._checked_input("command", command)
        self._predicted = None

    @abstractmethod
    def _decide(self, time: float, state: FloatArray) -> Command:
        """Return the desired input at a reduced state; it need not be within bounds."""

    def _fall_back(self, status: Status) -> Command:
        """Return a safe input where there is no usable measurement or decision."""
        return self._hold(status)

    def _hold(self, status: Status) -> Command:
        """Return the previous rest lengths, or γ of the operating point."""
        if self.input == "rest_length" and self._previous_input is not None:
            return Command(self._previous_input, status, Fallback.PREVIOUS_INPUT_HELD)
        return Command(self._plant.equilibrium_input, status, Fallback.EQUILIBRIUM_HELD)

    @property
    def status_count(self) -> dict[Status, int]:
        """How often each status came since the last reset."""
        return dict(self._status_count)

    @property
    def fallback_count(self) -> dict[Fallback, int]:
        """How often each fallback was taken since the last reset."""
        return dict(self._fallback_count)


def input_bounds(
    plant: LinearPlant, max_force_density: object, winches: Winches | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return least and largest command, shape (α,) each, or raise naming what does not fit."""
    count = plant.B.shape[1]
    if plant.input == "rest_length":
        if max_force_density is not None:
            raise ValueError(
                "max_force_density limits plants with input='force_density'; this one has "
                "input='rest_length', and winches limit rest lengths"
            )
        least, most = _SHORTEST * plant.equilibrium_input, np.full(count, np.inf)
        if winches is not None:
            winches.refuse_out_of_range("plant.rest_length", plant.equilibrium_input)
            if winches.shortest is not None:
                least = np.maximum(least, winches.shortest)
            if winches.longest is not None:
                most = np.minimum(most, winches.longest)
        return least, most
    if winches is not None:
        raise ValueError(
            "winches limit rest lengths, but plant has input='force_density'; linearize with "
            "input='rest_length'"
        )
    if max_force_density is None:
        return np.zeros(count), np.full(count, np.inf)
    high = per_member("max_force_density", max_force_density, count, "string")
    positive("max_force_density", high, "force density in N/m")
    over = np.flatnonzero(plant.force_density > high)
    if len(over):
        i = over[0]
        raise ValueError(
            f"max_force_density[{i}] is {high[i]:g} N/m, but string {i} has "
            f"{plant.force_density[i]:g} N/m at the operating point; expected at least that"
        )
    return np.zeros(count), high


def largest_change(
    plant: LinearPlant, max_change: object, winches: Winches | None, sample_time: float | None
) -> FloatArray | None:
    """Return the largest change of a command in a sample, shape (α,), or None for any."""
    count = plant.B.shape[1]
    change = None
    if max_change is not None:
        change = per_member("max_change", max_change, count, "string")
        positive("max_change", change, f"change of {plant.input.replace('_', ' ')}")
    rate = None if winches is None else winches.rate
    if sample_time is None:
        if change is not None or rate is not None:
            name = "max_change" if change is not None else "winches.rate"
            raise ValueError(f"{name} limits changes from sample to sample: give sample_time, s")
        return None
    if rate is not None:
        reach = per_member("winches.rate", rate, count, "string") * sample_time
        change = reach if change is None else np.minimum(change, reach)
    return change


def weight_matrix(name: str, value: object, size: int, definite: bool) -> FloatArray:
    """Return a symmetric weight, shape (size, size), of a number, a diagonal or a matrix."""
    array = float_array(name, value)
    if array.shape not in ((), (size,), (size, size)):
        raise ValueError(
            f"{name} has shape {array.shape}, expected (), ({size},) or ({size}, {size}): "
            "a number, a diagonal or a matrix"
        )
    matrix = array if array.ndim == 2 else np.diag(np.broadcast_to(array, (size,)))
    largest = float(np.abs(matrix).max(initial=0.0))
    if np.abs(matrix - matrix.T).max(initial=0.0) > _TOLERANCE * largest:
        raise ValueError(f"{name} is not symmetric")
    least = float(np.linalg.eigvalsh(matrix).min()) if size else 0.0
    if least < -_TOLERANCE * largest or (definite and least <= 0):
        wanted = "positive" if definite else "at least 0"
        raise ValueError(f"{name} has the eigenvalue {least:.3g}, expected {wanted}")
    return np.array(matrix)


def energy_weights(plant: LinearPlant, by_mode: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return weights that make displacement, speed and input commensurate.

    With ω the highest frequency of the plant (1 rad/s if all are zero) and b
    the largest acceleration that a unit input gives: ω² for displacements and
    1 for rates, so that a free vibration costs the same at any moment, and
    b²/ω² for inputs: the cost of the displacement at which a constant input balances.

    Parameters
    ----------
    plant : LinearPlant
    by_mode : bool
        Whether each displacement costs its own energy, ``qᵀ K q`` with K the
        stiffness (unstable parts by absolute value), in place of ω² for all. If
        frequencies lie far apart, as with stiff strings of held rest length, ω² for all
        makes soft motions as fast as the stiffest one, which slackens the strings.

    Returns
    -------
    Q : ndarray, shape (2r, 2r)
    R : ndarray, shape (α, α)

    Raises
    ------
    TypeError
        If ``plant`` is not a linear plant, or ``by_mode`` is not a truth value.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> Q, R = tc.energy_weights(plant)
    >>> round(float(Q[0, 0]), 1), float(Q[9, 9]), round(float(R[0, 0]), 3)
    (235.7, 1.0, 0.048)
    """
    instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    r = plant.degrees_of_freedom
    highest = plant.spectral_radius or 1.0
    largest = float(np.linalg.norm(plant.B, 2))
    Q = np.diag(np.r_[np.full(r, highest**2), np.ones(r)])
    if truth("by_mode", by_mode, "whether each displacement costs its own energy"):
        sizes, modes = np.linalg.eigh(-0.5 * (plant.A[r:, :r] + plant.A[r:, :r].T))
        stiffness = (modes * np.abs(sizes)) @ modes.T
        Q[:r, :r] = 0.5 * (stiffness + stiffness.T)
    return Q, np.eye(plant.B.shape[1]) * (largest / highest) ** 2


def regulator(
    plant: LinearPlant, A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, discrete: bool
) -> tuple[FloatArray, tuple[FloatArray, np.ndarray, FloatArray, float]]:
    """Return the weight of ``z`` or ``[z; v_previous]``, and the Riccati solution."""
    units, level = state_units(plant)
    added = len(A) - len(Q)
    weight, units = np.pad(Q, (0, added)), np.concatenate([units, np.full(added, level)])
    return weight, regulator_riccati(A, B, weight, R, units, level, discrete=discrete)
