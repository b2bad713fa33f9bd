"""Measurement of a simulated motion, and its estimate for the controller."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tenscontrol.actuation.driven_strings import BAR_INPUTS, follows
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.controller import BaseController
from tenscontrol.dynamics.model import Model
from tenscontrol.estimation.kalman_filter import Estimate, FilterStatistics, KalmanFilter
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.short_repr import short_repr
from tenscontrol.simulation.sensor_readings import SensorReadings
from tenscontrol.status import Status
from tenscontrol.structure.structure import different_members

# The only robot of a run.
_ALONE = np.zeros(1, dtype=int)


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

    ``sensors`` are those of the estimator if None; ``input`` is that of the strings; ``start`` are
    the lengths at the start of what is commanded, m, if they are known;
    ``substeps`` those of the winches; ``goes_on`` whether the estimator is as another run left it.
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
        moved = controller.input if controller.input in BAR_INPUTS else input
        _refuse_misfits(estimator, sensors, moved, controller, sample, substeps)
        self._filter = estimator
        seeds = [0 if seed is None else seed]
        self._readings = SensorReadings(sensors, seeds, input, estimator.sample_time)
        self._readings.begin_all([model])
        self._biases: list[FloatArray] = []
        self._held: FloatArray | None = None
        self._rows: list[tuple[FloatArray, Estimate]] = []
        if not goes_on or not len(estimator.statistics.degrees_of_freedom):
            estimator.reset(held=start)

    def go_on(self, earlier: EstimateRecord | None, held: FloatArray, samples: int) -> None:
        """Take over readings under way, the input held, and the noise after so many samples."""
        self._readings.skip(samples)
        state = self._readings.state
        if earlier is not None and earlier.under_way.shape[1] == len(state.under_way):
            self._readings.state = replace(state, under_way=earlier.under_way.T[:, None])
        self._held = held

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
        self._biases.append(self._readings.bias[0])
        nodes, velocities = (columns.ravel(order="F")[None] for columns in (nodes, velocities))
        self._readings.take(
            _ALONE, nodes, velocities, None if self._held is None else self._held[None],
            lambda held: acceleration(held[0]).ravel(order="F")[None], lost,
        )  # fmt: skip
        (reading,) = self._readings.arrived
        estimate = self._filter.update(reading)
        self._rows.append((reading, estimate))
        return estimate

    def predict(self, applied: FloatArray, held: FloatArray) -> None:
        """Predict under the input of the winches, shape (α,), and of the strings, (α',)."""
        self._filter.predict(applied)
        self._held = held

    def record(self, time: FloatArray) -> EstimateRecord:
        """Return measurements and estimates at these times."""
        # The last estimate may be of a sample that was interrupted.
        readings, estimates = zip(*self._rows[: len(time)], strict=True)
        later = [reading for reading, _ in self._rows[len(time) :]]
        under_way = self._readings.state.under_way[:, 0]
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
            under_way=frozen(np.reshape([*later, *under_way][: len(under_way)], under_way.shape).T),
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
            f"{input} between samples: design it on linearize(model, rest, input={input!r})"
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
