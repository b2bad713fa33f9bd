"""Accuracy of a motion and limits on it, the record of its controller, and its quantities."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from casadi import Function

from tenscontrol.actuation import MotorRecord
from tenscontrol.control import Fallback
from tenscontrol.dynamics import Model, evaluate_columns
from tenscontrol.integrate import Work
from tenscontrol.simulation.observation import EstimateRecord
from tenscontrol.status import UNSOLVED, Status
from tenscontrol.structure import BarClearance, BarCrossing
from tenscontrol.validation import (
    FloatArray,
    choice,
    frozen,
    instance,
    is_unlimited,
    positive_number,
    whole_number,
)

# The error, as part of the size, up to which a motion is trusted unless the user says otherwise.
ERROR_LIMIT = 0.01

# Limits on what is no error of the integration, and what to do.
_PHYSICAL = {
    "penetration": ", as part of the size: give the ground more stiffness",
    "fall": " sizes below z = 0: Model(..., ground=Ground(...)) would stop it",
    "rest_length_error": ", as part of the size: the motors are followed in too few parts of a "
    "sample. Give Winches(ramp=True, substeps=...) more",
}

# A run ends away from its reference: by this part of the size, with errors in the last third above
# this part of those before, if it lasts so many radians of the slowest vibration. Or
# by the fourth, and so many times the error at the start.
_AWAY, _FALLING, _TURNED, _LOST, _WORSE = 0.02, 0.9, 4 * np.pi, 0.2, 1.2

# More programs not solved than this are worth a warning.
_UNSOLVED_SHARE = 0.05


class AccuracyWarning(RuntimeWarning):
    """A motion that is not accurate, or probably not what was meant."""


class BarCrossingWarning(RuntimeWarning):
    """Bars pass through each other, which the model lets them do and real ones cannot."""


@dataclass(frozen=True)
class Health:
    """Accuracy figures of a simulated motion. Made by :attr:`Trajectory.health`.

    Attributes
    ----------
    energy_error : float or None
        Largest change of the energy since the start, as part of the largest
        kinetic energy; what cut strings stored and what was lost at the ground are allowed for.
        None where the energy may change: strings are damped, or a controller acts.
    momentum_change, angular_momentum_change : float or None
        Largest change, as part of the largest momentum that the kinetic energy
        could give; None where supports, loads or the ground may change it.
    bar_length_error : float
        Largest change of the length of a bar, as part of its length.
    position_error : float or None
        Largest estimate of the error of the nodes, as part of the size of the structure: see
        :attr:`Trajectory.error`.
    trusted_until : float or None
        Time up to which that stays below its limit, s.
    work : Work
        Steps, rejections, evaluations and switches.
    penetration : float or None
        Largest depth of a node in the ground, as part of the size; None without ground, as all
        that follows but the last.
    damping_work, friction_work : float or None
        Energy lost at the ground by damping and by friction, J.
    impulse, impulse_error : float or None
        Largest impulse of the ground on a node, N s; and by how much those of the ground and of
        loads miss the momentum, as part of the largest; None with supports or varying loads.
    fall : float or None
        Sizes that the mean of the nodes is below z = 0, y = 0 in the plane, at the end; None for
        less than one, or where ground or a support stops a fall.
    rest_length_error : float or None
        Estimate of the largest error of a rest length that motors set, as part of the size: see
        :class:`~tenscontrol.actuation.MotorRecord`. None without motors.
    crossings : tuple of BarCrossing, or None
        Bars that pass through each other, in order of time. None in the plane, and with less than
        two bars.
    clearance : BarClearance or None
        Least distance between the axes of two bars without a common node, m; None if there are
        none, and in the plane.
    unresolved_intervals : int
        Number of intervals between outputs in which bars may cross unseen: outputs are too far
        apart to tell, and the motion between them could not be integrated again.
    """

    energy_error: float | None
    momentum_change: float | None
    angular_momentum_change: float | None
    bar_length_error: float
    position_error: float | None
    trusted_until: float | None
    work: Work
    penetration: float | None = None
    damping_work: float | None = None
    friction_work: float | None = None
    impulse: float | None = None
    impulse_error: float | None = None
    fall: float | None = None
    rest_length_error: float | None = None
    crossings: tuple[BarCrossing, ...] | None = None
    clearance: BarClearance | None = None
    unresolved_intervals: int = 0


@dataclass(frozen=True)
class HealthLimits:
    """Limits on the accuracy figures of a run (:class:`Health`); None or inf for no limit.

    Parameters
    ----------
    energy_error : float, optional
        As part of the largest kinetic energy.
    momentum_change, angular_momentum_change, impulse_error : float, optional
        As part of the largest momentum that the kinetic energy could give.
    bar_length_error : float, optional
        As part of the length.
    position_error, penetration, fall, rest_length_error : float, optional
        As part of the size of the structure.
    steps, evaluations, switches : float, optional
        Counts.
    crossings : int, optional
        How many times bars may pass through each other, at least 0. With None it is not looked for
        at the end of a run, and from its outputs alone when :attr:`Trajectory.health` is asked.
    action : {"warn", "raise"}
        What happens where a limit is passed: an :class:`AccuracyWarning`, of crossings a
        :class:`BarCrossingWarning`, or a :class:`SimulationError` that carries the motion.

    Raises
    ------
    TypeError, ValueError
        If a limit is not positive, or ``action`` is another word.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> model = tc.Model(tc.prism())
    >>> limits = tc.HealthLimits(bar_length_error=1e-9, action="raise")
    >>> run = tc.simulate(model, 0.1, force_density=[17.3205] * 6 + [9.0] * 3, limits=limits)
    >>> run.health.bar_length_error < 1e-9
    True
    """

    energy_error: float | None = 0.05
    momentum_change: float | None = None
    angular_momentum_change: float | None = None
    bar_length_error: float | None = 1e-3
    position_error: float | None = ERROR_LIMIT
    steps: float | None = None
    evaluations: float | None = None
    switches: float | None = None
    action: str = "warn"
    penetration: float | None = 0.25
    fall: float | None = None
    impulse_error: float | None = None
    rest_length_error: float | None = 2e-3
    crossings: int | None = 0

    def __post_init__(self) -> None:
        choice("action", self.action, ("warn", "raise"))
        for each in fields(self):
            value = getattr(self, each.name)
            if each.name == "action":
                continue
            if is_unlimited(value):
                object.__setattr__(self, each.name, None)
            elif each.name == "crossings":
                whole_number(each.name, value, 0)
            else:
                positive_number(each.name, value, "a limit; None or inf for none")

    @property
    def names(self) -> list[str]:
        """Names of the figures that have a limit."""
        values = vars(self)
        return [name for name in values if name != "action" and values[name] is not None]

    def passed(self, health: Health) -> list[str]:
        """Return a sentence for each limit that is passed.

        Parameters
        ----------
        health : Health

        Returns
        -------
        list of str
        """
        instance("health", health, Health, "health of a trajectory")
        found: list[str] = []
        for each in fields(self):
            limit = getattr(self, each.name)
            if each.name == "action" or limit is None:
                continue
            if each.name == "crossings":
                if len(health.crossings or ()) > limit:
                    found.append(_passing(health.crossings or ()))
                continue
            source = health if hasattr(health, each.name) else health.work
            value = getattr(source, each.name)
            if value is not None and value > limit:
                what = each.name.replace("_", " ")
                why = _PHYSICAL.get(each.name, "")
                if each.name == "position_error":
                    why = f" of the size from {health.trusted_until:.4g} s on"
                found.append(f"{what} {value:.2g} is above its limit {limit:g}{why}")
        return found


def _passing(crossings: tuple[BarCrossing, ...]) -> str:
    """Return the sentence on bars that pass through each other."""
    (i, j), more = crossings[0].bars, len(crossings) - 1
    rest = f", and {more} more such crossing{'s' * (more > 1)} up to {crossings[-1].time:.4g} s"
    return (
        f"bars {i} and {j} pass through each other at {crossings[0].time:.4g} s"
        f"{rest * (more > 0)}, which real bars cannot. Hold other inputs, keep bars apart by "
        "clearance(...) in MPC, or accept it by HealthLimits(crossings=None)"
    )


@dataclass(frozen=True)
class Unsaved:
    """A value that a file names and does not hold: where it belongs, and what it was."""

    place: str
    what: str

    @classmethod
    def of(cls, place: str, value: object) -> Unsaved:
        """Return what is left of a value: the name of a function or class, or of its class."""
        is_named = hasattr(value, "__qualname__")
        named: Any = value if is_named else type(value)
        what = f"{named.__qualname__} of {named.__module__}"
        return cls(place, f"the function or class {what}" if is_named else f"a {what}")

    def __str__(self) -> str:
        return (
            f"{self.place} was {self.what}, which a file of a run does not hold: give it again "
            "where you need it"
        )


class Given(Mapping[str, Any]):
    """Arguments by name, as they were given; read-only.

    In a run from a file a function is named only: asking for it raises a ValueError that says so.
    """

    def __init__(self, values: Mapping[str, Any] | None = None) -> None:
        self._values = {
            name: frozen(value) if isinstance(value, np.ndarray) else value
            for name, value in (values or {}).items()
        }

    def __getitem__(self, name: str) -> Any:
        """Return the argument of this name."""
        value = self._values[name]
        if isinstance(value, Unsaved):
            raise ValueError(str(value))
        return value

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a file does: a function may be one that no other process can find."""
        left = {
            name: Unsaved.of(name, value) if callable(value) else value
            for name, value in self._values.items()
        }
        return Given, (left,)

    def __repr__(self) -> str:
        return f"Given({', '.join(self._values)})"

    @property
    def raw(self) -> dict[str, Any]:
        """All values, with :class:`Unsaved` for what a file did not hold; not for users."""
        return self._values


@dataclass(frozen=True, eq=False)
class ControlRecord:
    """Commands and moves of the winches, sample by sample.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Start of each sample, s.
    command : ndarray, shape (α, K)
        Desired input, in the unit of the controller.
    applied : ndarray, shape (α, K)
        Applied input: γ, N/m, or rest lengths, m, one a string of the controller;
        of a ramp, its end.
    status : tuple of Status, length K
        Status of each command; ``Status.OK`` where all went well.
    fallback : tuple, length K
        Fallback of each command, None where there was a decision.
    detail : tuple of str, length K
        Figures to the status.
    winch_rate : ndarray, shape (α, K)
        Change of the rest length in each sample over the sample time, m/s;
        zero where γ is held. The first counts from the start, if that is known.
    rate_limited, range_limited : ndarray of int, shape (K,)
        Number of winches that met a limit.
    computing_time : ndarray, shape (K,)
        Time the controller took, s.
    estimate : EstimateRecord or None
        Measurements and estimates; None without an estimator.
    motors : MotorRecord or None
        Angle, speed, torque, power and energy; None where the winches have no motor.
    prediction_error : ndarray, shape (K,), or None
        How far the node that was off most was from where the controller had predicted it a sample
        before, m. NaN where nothing was predicted, or nothing measured; None where that is so
        throughout.
    tracking_error : ndarray, shape (K + 1,), or None
        Distance of the node that is farthest off its place in the reference of the controller, at
        the start of each sample and at the end of the run, m. The shape is first laid over that
        of the plant by what supports leave of rigid-body motion. None where the controller has
        no reference.
    at_bound : ndarray of int, shape (K,), or None
        Number of strings commanded at a bound of the controller, or of its change.
    controller : str
        What it was.
    sample_time : float or None
        s.
    size : float or None
        Largest extent of the structure, m.
    slowest_vibration : float or None
        Of the controller's plant, 1/s.
    statistics : MPCStatistics, NMPCStatistics, FeedbackLinearizationStatistics or None
        Of the controller at the end of the run; None for other controllers.
    settings : Given
        Kind and settings of the controller by name.
    """

    time: FloatArray
    command: FloatArray
    applied: FloatArray
    status: tuple[Status, ...]
    fallback: tuple[Fallback | None, ...]
    detail: tuple[str, ...]
    winch_rate: FloatArray
    rate_limited: np.ndarray
    range_limited: np.ndarray
    computing_time: FloatArray
    estimate: EstimateRecord | None = None
    motors: MotorRecord | None = None
    prediction_error: FloatArray | None = None
    tracking_error: FloatArray | None = None
    at_bound: np.ndarray | None = None
    controller: str = ""
    sample_time: float | None = None
    size: float | None = None
    slowest_vibration: float | None = None
    statistics: object = None
    settings: Given = field(default_factory=Given)

    @property
    def unsolved(self) -> float:
        """Fraction of the samples whose program was not solved."""
        return sum(status in UNSOLVED for status in self.status) / len(self.status)

    @property
    def problems(self) -> list[str]:
        """A sentence for what went wrong; empty where the run did what was asked.

        The run ends away from the reference: by more than 2 % of the size in its last tenth, with
        errors in the last third of more than 0.9 of the largest of those in the second, after two
        turns of the slowest vibration of the plant. Or by more than a fifth of the size, and 1.2
        times as far as it began. Programs were not solved: more than one in twenty.
        """
        found, error = [], self.tracking_error
        if error is not None and self.size is not None and self.slowest_vibration is not None:
            off = error / self.size
            end = float(off[-max(1, len(off) // 10) :].max())
            third = max(1, len(off) // 3)
            long = float(self.time[-1] - self.time[0]) * self.slowest_vibration > _TURNED
            stays = long and off[-third:].max() > _FALLING * off[-2 * third :].max()
            if (end > _AWAY and stays) or end > max(_LOST, _WORSE * float(off[0])):
                found.append(
                    f"it ends up to {end * self.size:.2g} m from its reference, {100 * end:.2g} % "
                    "of the size, and comes no nearer"
                )
        if self.unsolved > _UNSOLVED_SHARE:
            worst = Counter(status for status in self.status if status in UNSOLVED).most_common(1)
            found.append(
                f"{100 * self.unsolved:.2g} % of the programs were not solved, most of them "
                f"{worst[0][0]}"
            )
        return found

    def summary(self) -> str:
        """Return a summary of the closed loop, as text: status, errors, computing time.

        Returns
        -------
        str

        Examples
        --------
        >>> import tenscontrol as tc
        >>> prism = tc.prism()
        >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
        >>> plant = tc.linearize(model, tc.prestress(prism, 17.3205), input="rest_length")
        >>> start = plant.to_nodes([0.02] * 9)
        >>> mpc = tc.MPC(plant, horizon=10, sample_time=0.02)
        >>> run = tc.simulate(model, 3.0, start, controller=mpc, step=1e-3)
        >>> print(run.control.summary())  # doctest: +ELLIPSIS
        controller        MPC(... horizon 10, sample time 0.02 s, condensed, daqp)
        samples           150 of 0.02 s: 150 ok
        tracking error    0.00... m at the end, 0.00... m rms (0.2... % and 0.9... % of the size)
        prediction error  ...e-05 m rms, 0.0005... m at most
        at a bound        0 % of the samples
        computing time    ... ms in the median, ... ms at most: ... % of a sample
        """
        counts = ", ".join(
            f"{count} {name}"
            for kind in (self.status_count, self.fallback_count)
            for name, count in kind.items()
        )
        lines = [f"samples           {len(self.time)}: {counts}"]
        if self.sample_time is not None:
            lines = [
                f"controller        {self.controller}",
                f"samples           {len(self.time)} of {self.sample_time:g} s: {counts}",
            ]
        if self.unsolved:
            lines.append(f"not solved        {100 * self.unsolved:.2g} % of the samples")
        if self.tracking_error is not None and self.size is not None:
            end, rms = float(self.tracking_error[-1]), _rms(self.tracking_error)
            lines.append(
                f"tracking error    {end:.2g} m at the end, {rms:.2g} m rms "
                f"({100 * end / self.size:.2g} % and {100 * rms / self.size:.2g} % of the size)"
            )
        if self.prediction_error is not None and np.isfinite(self.prediction_error).any():
            off = self.prediction_error[np.isfinite(self.prediction_error)]
            lines.append(f"prediction error  {_rms(off):.2g} m rms, {off.max():.2g} m at most")
        if self.at_bound is not None:
            share = np.count_nonzero(self.at_bound) / len(self.at_bound)
            lines.append(f"at a bound        {100 * share:.2g} % of the samples")
        slow, out = (int((each > 0).sum()) for each in (self.rate_limited, self.range_limited))
        if slow or out:
            lines.append(f"winches           too slow in {slow} samples, out of range in {out}")
        if self.motors is not None and self.motors.rest_length_error:
            lines.append(
                f"motors            rest lengths to {self.motors.rest_length_error:.2g} m; more "
                "substeps make that less"
            )
        typical, worst = float(np.median(self.computing_time)), float(self.computing_time.max())
        lines.append(
            f"computing time    {1e3 * typical:.2g} ms in the median, {1e3 * worst:.2g} ms"
        )
        lines[-1] += " at most"
        if self.sample_time is not None:
            lines[-1] += f": {100 * worst / self.sample_time:.2g} % of a sample"
        return "\n".join(lines)

    @property
    def status_count(self) -> dict[Status, int]:
        """How often each status came."""
        return dict(Counter(self.status))

    @property
    def fallback_count(self) -> dict[Fallback, int]:
        """How often each fallback was taken."""
        return dict(Counter(fallback for fallback in self.fallback if fallback is not None))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


# Times at which functions of the model are evaluated in one go: few enough that what they need of a
# large structure stays small.
BLOCK = 128


@dataclass(frozen=True, eq=False)
class Quantities:
    """What energies, momenta and force densities of a motion are evaluated from, when asked for.

    Attributes
    ----------
    model : Model
    moved : bool
        Whether supports move: functions are then those of all nodes.
    inputs : ndarray, shape (α, T)
        Rest lengths or force densities.
    load : ndarray, shape (d, n), or (d n, T) where it changes, node by node; or None
        N.
    stored : ndarray, shape (T,), or None
        What the ground stores, J.
    shared : callable, optional
        Of a run of a batch: ``name -> function, parameters``, the function of the model and the
        columns of its further inputs.
    """

    model: Model
    moved: bool
    inputs: FloatArray
    load: FloatArray | None = None
    stored: FloatArray | None = None
    shared: Callable[[str], tuple[Function, list[FloatArray]]] | None = None

    def of(
        self, name: str, nodes: FloatArray, velocities: FloatArray, *more: FloatArray
    ) -> list[FloatArray]:
        """Return a function of the model at all times, read-only: one array an output."""
        model, count = self.model, nodes.shape[2]
        every = self.moved or not len(model.structure.fixed_rows)
        rows = slice(None) if every else model.structure.free_rows
        if self.shared is not None:
            function, own = self.shared(name)
            more += tuple(np.broadcast_to(each[:, None], (len(each), count)) for each in own)
        else:
            function = model.of_all_nodes(name) if self.moved else getattr(model, name)

        def within(first: int) -> list[FloatArray]:
            some = slice(first, first + BLOCK)
            moving = [by_node(part[:, :, some])[rows] for part in (nodes, velocities)]
            return evaluate_columns(function, np.vstack(moving), *(each[:, some] for each in more))

        parts = zip(*(within(first) for first in range(0, count, BLOCK)), strict=True)
        return [read_only(np.hstack(part)) for part in parts]


def by_node(part: FloatArray) -> FloatArray:
    """Return shape (d n, T), node by node, of (d, n, T)."""
    return part.swapaxes(0, 1).reshape(-1, part.shape[2])


def read_only(array: FloatArray) -> FloatArray:
    """Return an array that is not to be written to."""
    array.setflags(write=False)
    return array
