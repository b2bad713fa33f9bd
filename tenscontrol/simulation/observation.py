"""What a controller is shown of a simulated motion, and the record of what it did."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tenscontrol.actuation import MotorRecord
from tenscontrol.control import UNSOLVED, BaseController, Fallback, Status
from tenscontrol.dynamics import Evaluator, Model, pack_state
from tenscontrol.estimation import Estimate, FilterStatistics, KalmanFilter, Sensors
from tenscontrol.structure import same_members, to_strings
from tenscontrol.validation import LARGEST_SEED, FloatArray, frozen, instance, whole_number

# A run ends away from its reference: by this part of the size, with errors in the last third above
# this part of those before, if it lasts so many radians of the slowest vibration. Or
# by the fourth, and so many times the error at the start.
_AWAY, _FALLING, _TURNED, _LOST, _WORSE = 0.02, 0.9, 4 * np.pi, 0.2, 1.2

# More programs not solved than this are worth a warning.
_UNSOLVED_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class EstimateRecord:
    """Measurements and estimates, sample by sample; the last part of a control record.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Start of each sample, s.
    nodes, velocities : ndarray, shape (d, n, K)
        Estimated motion that the controller was given, m and m/s.
    node_deviation : ndarray, shape (d, n, K)
        Standard deviation of each coordinate, m, as the filter has it.
    length_deviation : ndarray, shape (α, K)
        That of the length of each string of the filter's structure, m.
    state : ndarray, shape (s, K)
        In the coordinates of the filter.
    measurement : ndarray, shape (m, K)
        What arrived at each sample, NaN where nothing did.
    under_way : ndarray, shape (m, delay)
        What had been measured by the end, and had not arrived.
    status : tuple of str, length K
        What became of it; see :class:`Estimate`.
    statistics : FilterStatistics
    """

    time: FloatArray
    nodes: FloatArray
    velocities: FloatArray
    node_deviation: FloatArray
    length_deviation: FloatArray
    state: FloatArray
    measurement: FloatArray
    under_way: FloatArray
    status: tuple[str, ...]
    statistics: FilterStatistics

    @property
    def status_count(self) -> dict[str, int]:
        """How often each status came."""
        return dict(Counter(self.status))


@dataclass(frozen=True)
class Unsaved:
    """A value that a file names and does not hold: where it belongs, and what it was."""

    place: str
    what: str

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
        of the plant by what supports leave of motion as one body. None where the controller has
        no reference.
    at_bound : ndarray of int, shape (K,), or None
        Number of strings commanded at a bound of the controller, or of its change.
    controller : str
        What it was.
    sample_time : float or None
        s.
    settings : Given
        Kind and settings of the controller by name.
    size : float or None
        Largest extent of the structure, m.
    slowest_vibration : float or None
        Of the controller's plant, 1/s.
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
        """Return how the controller did, as text.

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


class Observation:
    """Sensors of a simulated motion and the filter that estimates it, checked to go together.

    ``sensors`` are those of the estimator if None; ``start`` are the rest lengths at the start, m,
    shape (α,), if they are known; ``substeps`` those of the winches; ``goes_on`` whether the
    estimator is as another run left it.
    """

    def __init__(
        self,
        estimator: KalmanFilter,
        sensors: Sensors | None,
        seed: int | None,
        model: Model,
        input: str,
        controller: BaseController,
        sample: float,
        start: FloatArray | None,
        substeps: int,
        goes_on: bool,
    ) -> None:
        sensors = estimator.sensors if sensors is None else sensors
        instance("sensors", sensors, Sensors, "make them by Sensors(structure=..., ...)")
        _refuse_misfits(estimator, sensors, input, controller, sample, substeps)
        self._filter, self._sensors = estimator, sensors
        self._generator = np.random.default_rng(
            0 if seed is None else whole_number("seed", seed, 0, LARGEST_SEED)
        )
        self._model = model
        self._law = None
        if input == "rest_length" and sensors.string_tension is not None:
            self._law = Evaluator(model.string_force_density)
        self._held: FloatArray | None = None
        self._nothing = np.full(len(sensors.noise), np.nan)
        # Readings taken, each to arrive so many samples later: the first were before the run.
        self._taken = [self._nothing] * sensors.delay
        self._rows: list[tuple[FloatArray, Estimate]] = []
        if not goes_on or not len(estimator.statistics.degrees_of_freedom):
            estimator.reset(held=start)

    def go_on(self, earlier: EstimateRecord | None, held: FloatArray, samples: int) -> None:
        """Take over readings under way, the input held, and the noise after so many samples."""
        if earlier is not None and earlier.under_way.shape[1] == len(self._taken):
            self._taken = list(earlier.under_way.T)
        self._held = held
        for _ in range(samples):
            self._sensors.disturb(np.zeros(len(self._nothing)), self._generator)

    def estimate(self, nodes: FloatArray, velocities: FloatArray, lost: bool) -> Estimate:
        """Measure the motion, and return the estimate from what arrives at this sample.

        A measurement that is lost now is missing when it would have arrived.
        """
        seen = self._sensors.structure.nodes.shape[1]
        exact = self._sensors.measure(
            nodes[:, :seen], self._tension(nodes, velocities), velocities[:, :seen]
        )
        noisy = self._sensors.disturb(exact, self._generator)
        self._taken.append(self._nothing if lost else noisy)
        reading = self._taken[len(self._rows)]
        estimate = self._filter.update(reading)
        self._rows.append((reading, estimate))
        return estimate

    def predict(self, applied: FloatArray, held: FloatArray) -> None:
        """Predict under the input of the winches, shape (α,), and of the strings, (α',)."""
        self._filter.predict(applied)
        self._held = held

    def _tension(self, nodes: FloatArray, velocities: FloatArray) -> FloatArray | None:
        """Return the tension of each string of the sensors' structure; None before any input."""
        if self._sensors.string_tension is None or self._held is None:
            return None
        structure = self._model.structure
        gamma = self._held
        if self._law is not None:
            (gamma,) = self._law(pack_state(structure, nodes, velocities), self._held)
        tension = np.atleast_1d(gamma) * structure.string_length(nodes)
        if len(tension) == len(self._sensors.structure.strings):
            return tension
        return to_strings(structure, "tension", tension)

    def record(self, time: FloatArray) -> EstimateRecord:
        """Return measurements and estimates at these times."""
        # The last estimate may be of a sample that was interrupted.
        readings, estimates = zip(*self._rows[: len(time)], strict=True)
        delay = self._sensors.delay
        names = "nodes", "velocities", "node_deviation", "length_deviation", "state"
        series = {
            name: frozen(np.stack([getattr(each, name) for each in estimates], axis=-1))
            for name in names
        }
        return EstimateRecord(
            time=frozen(time),
            **series,
            measurement=frozen(np.column_stack(readings)),
            under_way=frozen(
                np.reshape(self._taken[len(time) :][:delay], (delay, len(self._nothing))).T
            ),
            status=tuple(each.status for each in estimates),
            statistics=self._filter.statistics,
        )


def _refuse_misfits(
    estimator: KalmanFilter,
    sensors: Sensors,
    input: str,
    controller: BaseController,
    sample: float,
    substeps: int,
) -> None:
    if not np.isclose(estimator.sample_time, sample, rtol=1e-12, atol=0):
        raise ValueError(
            f"estimator has the sample time {estimator.sample_time:g} s, expected that of the "
            f"loop, {sample:g} s"
        )
    if estimator.input != input:
        raise ValueError(
            f"estimator knows the effect of {estimator.input}, but the actuators hold {input} "
            f"between samples: design it on linearize(model, rest, input={input!r})"
        )
    if estimator.substeps != substeps:
        raise ValueError(
            f"estimator predicts winches with substeps={estimator.substeps}, but those of the run "
            f"have substeps={substeps}: give them to KalmanFilter(..., winches=...) as well"
        )
    seen, known = controller.structure, estimator.plant.model.structure
    if not same_members(known, seen):
        raise ValueError(
            f"estimator was designed on {known!r}, but the controller on {seen!r} with other "
            "nodes, bars or strings"
        )
    if len(estimator.plant.commanded.strings) != len(controller.commanded.strings):
        raise ValueError(
            f"estimator is told {len(estimator.plant.commanded.strings)} strings, but the "
            f"controller commands {len(controller.commanded.strings)}: use command_parents "
            "on both plants or on none"
        )
    own = estimator.sensors
    if not same_members(sensors.structure, known) or sensors.readings != own.readings:
        raise ValueError(
            f"sensors has the readings {sensors!r}, but estimator expects those of {own!r}: "
            "the same kinds, of the same nodes, strings and bars"
        )
