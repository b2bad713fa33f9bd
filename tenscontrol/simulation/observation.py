"""Measurement of a simulated motion, and its estimate for the controller."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tenscontrol.actuation.driven_strings import follows
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.controller import BaseController
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.dynamics.model import Model
from tenscontrol.estimation.kalman_filter import Estimate, FilterStatistics, KalmanFilter
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.short_repr import short_repr
from tenscontrol.status import Status
from tenscontrol.structure.segments import to_strings
from tenscontrol.structure.structure import different_members


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
    bias, bias_deviation : ndarray, shape (m, K)
        Estimated bias of each number of a reading, in its unit, and its standard deviation.
    actual_bias : ndarray, shape (m, K)
        The bias that the sensors had.
    measurement : ndarray, shape (m, K)
        What arrived at each sample, NaN where nothing did.
    under_way : ndarray, shape (m, delay)
        What had been measured by the end, and had not arrived.
    status : tuple of Status, length K
        What became of it; see :class:`Estimate`.
    statistics : FilterStatistics
    """

    time: FloatArray
    nodes: FloatArray
    velocities: FloatArray
    node_deviation: FloatArray
    length_deviation: FloatArray
    state: FloatArray
    bias: FloatArray
    bias_deviation: FloatArray
    actual_bias: FloatArray
    measurement: FloatArray
    under_way: FloatArray
    status: tuple[Status, ...]
    statistics: FilterStatistics

    __repr__ = short_repr

    @property
    def status_count(self) -> dict[Status, int]:
        """How often each status came."""
        return dict(Counter(self.status))


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
        _refuse_misfits(estimator, sensors, input, controller, sample, substeps)
        self._filter, self._sensors = estimator, sensors
        self._generator = np.random.default_rng(0 if seed is None else seed)
        # Of its own, so that sensors without a bias read the same.
        self._bias_generator = np.random.default_rng([0 if seed is None else seed, 1])
        self._biases = [sensors.draw_bias(self._bias_generator, sample)]
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
            self._drift()
        del self._biases[:-1]

    def _drift(self) -> None:
        """Let the biases walk for a sample."""
        generator, before = self._bias_generator, self._biases[-1]
        self._biases.append(self._sensors.draw_bias(generator, self._filter.sample_time, before))

    def estimate(
        self,
        nodes: FloatArray,
        velocities: FloatArray,
        acceleration: Callable[[FloatArray], FloatArray],
        lost: bool,
    ) -> Estimate:
        """Measure the motion, and return the estimate from what arrives at this sample.

        ``acceleration`` returns that of the nodes under an input of the strings. A measurement that
        is lost now is missing when it would have arrived.
        """
        seen = self._sensors.structure.nodes.shape[1]
        felt = None
        if self._sensors.needs("acceleration") and self._held is not None:
            felt = acceleration(self._held)[:, :seen]
        exact = self._sensors.measure(
            nodes[:, :seen],
            self._tension(nodes, velocities),
            velocities[:, :seen],
            felt,
            self._rest_length(),
        )
        noisy = self._sensors.disturb(exact + self._biases[-1], self._generator)
        self._drift()
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
        return self._of_strings("tension", tension)

    def _rest_length(self) -> FloatArray | None:
        """Return the rest lengths of the strings of the sensors' structure, if they are held."""
        if self._held is None or not self._sensors.needs("rest_length"):
            return None
        return self._of_strings("rest_length", self._held)

    def _of_strings(self, name: str, values: FloatArray) -> FloatArray:
        if len(values) == len(self._sensors.structure.strings):
            return values
        return to_strings(self._model.structure, name, values)

    def record(self, time: FloatArray) -> EstimateRecord:
        """Return measurements and estimates at these times."""
        # The last estimate may be of a sample that was interrupted.
        readings, estimates = zip(*self._rows[: len(time)], strict=True)
        delay = self._sensors.delay
        names = (
            "nodes", "velocities", "node_deviation", "length_deviation", "state", "bias",
            "bias_deviation",
        )  # fmt: skip
        series = {
            name: frozen(np.stack([getattr(estimate, name) for estimate in estimates], axis=-1))
            for name in names
        }
        return EstimateRecord(
            time=frozen(time),
            **series,
            actual_bias=frozen(np.column_stack(self._biases[: len(time)])),
            measurement=frozen(np.column_stack(readings)),
            under_way=frozen(
                np.reshape(self._taken[len(time) :][:delay], (delay, len(self._nothing))).T
            ),
            status=tuple(estimate.status for estimate in estimates),
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
            f"estimator was designed for the input {estimator.input}, but the actuators hold "
            f"{input} "
            f"between samples: design it on linearize(model, rest, input={input!r})"
        )
    if estimator.substeps != substeps:
        raise ValueError(
            f"estimator predicts winches with substeps={estimator.substeps}, but those of the run "
            f"have substeps={substeps}: give them to KalmanFilter(..., winches=...) as well"
        )
    seen, known = controller.structure, estimator.plant.model.structure
    feet = np.union1d(controller.feet, estimator.plant.feet).astype(int)
    different = different_members(known, seen, feet)
    if different:
        raise ValueError(
            f"estimator was designed on {known!r}, but the controller on {seen!r} with {different}"
        )
    if len(estimator.plant.commanded.strings) != len(controller.commanded.strings):
        raise ValueError(
            f"estimator has inputs for {len(estimator.plant.commanded.strings)} strings, but the "
            f"controller commands {len(controller.commanded.strings)}: use command_parents "
            "on both plants or on none"
        )
    if not follows(estimator.plant.actuation, controller.actuation):
        raise ValueError(
            f"estimator has a plant with {estimator.plant.actuation!r}, but the controller, with "
            f"{controller.actuation!r}, moves strings in other ways: give linearize the same "
            "actuated for both, or none for the estimator"
        )
    own = estimator.sensors
    different = different_members(sensors.structure, known, feet)
    if different or sensors.readings != own.readings:
        where = f", of a structure with {different}" if different else ""
        raise ValueError(
            f"sensors has the readings {sensors!r}{where}, but estimator expects those of {own!r}: "
            "the same kinds, of the same nodes, strings and bars"
        )
