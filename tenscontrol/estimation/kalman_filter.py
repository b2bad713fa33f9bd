"""Kalman filter: correction, gate for outliers, delayed readings, prediction."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import inputs_of, moved_by
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics.evaluator import Evaluator, Exclusive, exclusive
from tenscontrol.estimation.correction import Correction
from tenscontrol.estimation.filter_design import FilterDesign, FilterSettings, filter_design
from tenscontrol.estimation.observability_report import Observability, observability
from tenscontrol.estimation.rolling_frame import RollingPose
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.estimation.smoother import Pass, SmoothedMotion, smoothed
from tenscontrol.plant.controllability import warn_of_left_alone
from tenscontrol.plant.driven_lengths import MOST_LENGTH, known_at_rest
from tenscontrol.plant.linear_plant import LinearPlant, acceleration_response
from tenscontrol.plant.modes import Modes
from tenscontrol.short_repr import short_repr
from tenscontrol.status import Status

# From one start anew to the next, without a good sample between, the variance grows by this, so
# many times at most: the spread then covers any structure.
WIDER, MOST_WIDER = 10.0, 9

# A variance so many times that of the start says nothing any more, and would overflow in the end.
NOTHING_KNOWN = 1e12


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated positions and velocities. Made by :meth:`KalmanFilter.update`.

    Attributes
    ----------
    nodes, velocities : ndarray, shape (d, n)
        m and m/s. Bars have their lengths. Motions as one body that no reading shows are left out.
    bias, bias_deviation : ndarray, shape (m,)
        Estimated bias of each number of a reading, in its unit, and its standard deviation; 0 where
        the sensors have none.
    rest_length_error, rest_length_deviation : ndarray, shape (α,)
        By how much the rest lengths are longer than :meth:`KalmanFilter.predict` was told, m, and
        the standard deviation of that; 0 where the filter estimates none.
    load : ndarray, shape (d, n), or None
        Unknown force on each node, N, that acts on the bars in proportion to their mass: of all
        loads that move the structure so, one. None if the filter estimates none.
    state : ndarray, shape (s,)
        z in the coordinates of the filter. After it, of what is estimated: the accelerations that a
        load gives; with accelerometers, those over the last sample that are unknown; errors of rest
        lengths; biases.
    covariance : ndarray, shape (s, s)
        Of the state, as the filter has it.
    node_deviation : ndarray, shape (d, n)
        Standard deviation of each coordinate of the nodes, m, to first order.
    length_deviation : ndarray, shape (α,)
        That of the length of each string, m.
    status : Status
        ``"ok"`` if all readings were used, ``"partly used"``, ``"lost"`` if none came,
        ``"refused"`` if those that came were, ``"waiting"`` for the first ones while delayed,
        ``"started anew"`` if the filter was taken to be wrong.
    """

    nodes: FloatArray
    velocities: FloatArray
    bias: FloatArray
    bias_deviation: FloatArray
    rest_length_error: FloatArray
    rest_length_deviation: FloatArray
    load: FloatArray | None
    state: FloatArray
    covariance: FloatArray
    node_deviation: FloatArray
    length_deviation: FloatArray
    status: Status

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class FilterStatistics:
    """Readings used and refused in K samples. Made by :attr:`KalmanFilter.statistics`.

    Attributes
    ----------
    status_count : dict of Status to int
        How often each status came.
    used, lost, not_finite, refused : ndarray of int, shape (readings,)
        How often each reading was used, did not come, was infinite, or was refused by the gate.
    normalized_innovation : ndarray, shape (K,)
        ``νᵀ S⁻¹ ν`` of the entries that were used, NaN if there were none. If the filter's
        noise is that of the plant, it is chi-square distributed.
    degrees_of_freedom : ndarray of int, shape (K,)
        Number of these entries.
    restarts : int
        How often the filter was taken to be wrong and started anew.
    """

    status_count: dict[Status, int]
    used: IntArray
    lost: IntArray
    not_finite: IntArray
    refused: IntArray
    normalized_innovation: FloatArray
    degrees_of_freedom: IntArray
    restarts: int

    __repr__ = short_repr


class Tally:
    """Counts of the use of so many readings."""

    def __init__(self, readings: int) -> None:
        self._counts = np.zeros((4, readings), dtype=np.int64)
        self._rows: list[tuple[Status, float, int]] = []
        self._restarts = 0
        self._fresh = False

    @property
    def restarts(self) -> int:
        """How often the filter was taken to be wrong."""
        return self._restarts

    @property
    def last(self) -> Status:
        """Status of the last sample."""
        return self._rows[-1][0]

    def wait(self) -> None:
        """Count a sample at which nothing can have arrived."""
        self._close(Status.WAITING, np.nan, 0)

    def start_over(self, after: bool = False) -> None:
        """Count a restart: at the sample to be counted next, or after the last one."""
        self._restarts += 1
        if after:
            self._rows[-1] = (Status.RESTARTED, *self._rows[-1][1:])
        else:
            self._fresh = True

    def add(
        self, lost: np.ndarray, usable: np.ndarray, passed: np.ndarray, nis: float, entries: int
    ) -> None:
        """Count a sample by which readings were lost, usable and used."""
        self._counts += np.array([passed, lost, ~usable & ~lost, usable & ~passed])
        if passed.all():
            status = Status.OK
        elif passed.any():
            status = Status.PARTLY_USED
        else:
            status = Status.LOST if lost.all() else Status.REFUSED
        self._close(status, nis, entries)

    def _close(self, status: Status, nis: float, entries: int) -> None:
        self._rows.append((Status.RESTARTED if self._fresh else status, nis, entries))
        self._fresh = False

    def statistics(self) -> FilterStatistics:
        """Return the counts so far."""
        used, lost, not_finite, refused = (frozen(row) for row in self._counts)
        return FilterStatistics(
            status_count=dict(Counter(status for status, _, _ in self._rows)),
            used=used,
            lost=lost,
            not_finite=not_finite,
            refused=refused,
            normalized_innovation=frozen(np.array([nis for _, nis, _ in self._rows], dtype=float)),
            degrees_of_freedom=frozen(
                np.array([count for _, _, count in self._rows], dtype=np.int64)
            ),
            restarts=self._restarts,
        )


@final
class KalmanFilter:
    """Kalman filter: estimates node positions and velocities from readings at each sample.

    At each sample call :meth:`update` with the readings, then :meth:`predict` with the input that
    is held over the sample. The covariance is updated at each sample, as readings may be lost or
    refused. Where all are used near the operating point, it converges to that of the steady filter.
    A filter restored from a pickle starts anew.

    The input of the plant must be what the actuators hold between samples: for winches linearize
    with ``input="rest_length"``, whatever the controller commands, for driven bars with
    ``input="bar_length"``, and for both with ``input="length"``. With internal coordinates, the
    filter adds the rigid-body motions that the readings observe. Undamped modes that are neither
    observed nor reached by strings are left out: see :attr:`left_alone`. Motions of the structure
    as one body are left out too, if readings show their rates alone. :meth:`observability` lists
    what is left out.

    Parameters
    ----------
    plant : LinearPlant
        In internal or minimal coordinates.
    sensors : Sensors
        Of the structure of the plant's model.
    sample_time : float
        Sample time, s; a reading is taken at the start of each sample.
    process_noise : float
        Unknown acceleration, as the part by which tensions may be off. It is the standard deviation
        in each coordinate, constant over a sample and independent from one sample to the next. Its
        unit is the root mean square over the coordinates of the acceleration that all strings give
        together, each with its tension at the operating point and a sign at random: 0.02 stands for
        tensions that are off by 2 %, independently.
    load : bool
        Whether to estimate an unknown load: an acceleration q̈ in each coordinate. Without it such
        a load, or strings of another stiffness, shift the estimate.
    load_noise : float
        Change of the load from one sample to the next, as ``process_noise``. It is the standard
        deviation of that acceleration, in the same unit. A larger one follows faster and filters
        less.
    prediction : {"linear", "nonlinear"}
        Prediction by the plant, near its operating point, or by the equations of motion. Of driven
        bars ``"linear"``.
    rolling : bool
        Whether the structure rolls on ground that the model does not have. It may then turn by any
        angle, and ``start`` may be turned too; its lowest node stands still, so that the estimate
        travels. The model has strings alone, no gravity or ground, and ``sensors`` read
        ``bar_direction`` of two bars at least.
    gate : float
        Probability that a good reading is refused, above 0 and below 1.
    patience : int
        Samples with most readings refused after which the filter restarts, at least 1. They are in
        a row; it restarts from the readings.
    start : array_like, shape (d, n), optional
        Expected shape at the start, m, at rest; the operating point if not given.
    start_spread : float
        Error of the shape at the start, as a part of the size of the structure. It is the standard
        deviation of the nodes; that of the speeds follows from the forces of the strings over this
        distance.
    winches : Winches, optional
        Winches with ramps, ``Winches(substeps=...)``, which the prediction follows. Their limits
        do not matter. Drives of bars need them, ``Winches(ramp=True)``.
    rest_length_error : (float, float), optional
        Rest lengths that differ from those that the filter is told, by an unknown error each:
        its standard deviation at the start, m, and that of its random walk in a second, m/√s. It
        is estimated for the strings that ``sensors`` have encoders of, or for all if they have
        none.

    Attributes
    ----------
    C : ndarray, shape (m, s)
        Derivative of the readings by the state at the operating point.
    gain : ndarray, shape (s, m)
        Steady gain K: ``z ← z + K (y − h(z))``.
    covariance : ndarray, shape (s, s)
        Steady covariance of the state before a correction.
    poles : ndarray of complex, shape (s,)
        Of the steady filter, in the z-plane.
    riccati_residual : float
        Residual of the Riccati equation relative to its largest term.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit; if an undamped motion that strings
        reach or that drifts, or the load, is not observable (the message says which readings in
        addition would do); if no string
        pulls at the operating point; if the Riccati solution fails its check.

    Warns
    -----
    RuntimeWarning
        If modes are left alone, naming them.

    Notes
    -----
    ``z⁺ = Φ z + Γ v + d + Ψ (w + a)``, ``y = h(z, u) + e``, with Φ, Γ and Ψ exact for what
    is held over a sample; a ramp adds ``Γ_p v_previous``. The acceleration a by the unknown load
    has ``a⁺ = a + w'`` where it is estimated, and is 0 otherwise. The steady gain for
    ``C = ∂h/∂z`` at the operating point is that of python-control's ``dlqr`` for the dual
    problem, solved with whitened readings, and checked.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> sensors = tc.Sensors(structure=prism, string_length=0.001, node_position=0.005)
    >>> estimator = tc.KalmanFilter(plant, sensors, sample_time=0.02)
    >>> estimator
    KalmanFilter(30 states, 15 readings, sample time 0.02 s, linear prediction)
    >>> bool(abs(estimator.poles).max() < 1)
    True

    The length of one string does not tell of all motions:

    >>> few = tc.Sensors(structure=prism, string_length=0.001, strings=[0])
    >>> tc.KalmanFilter(plant, few, sample_time=0.02)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    ValueError: 10 of the 18 states are not observable by ...
    """

    def __init__(
        self,
        plant: LinearPlant,
        sensors: Sensors,
        *,
        sample_time: float,
        process_noise: float = 0.02,
        load: bool = False,
        load_noise: float = 0.05,
        prediction: str = "linear",
        rolling: bool = False,
        gate: float = 1e-4,
        patience: int = 5,
        start: object = None,
        start_spread: float = 0.03,
        winches: Winches | None = None,
        rest_length_error: tuple[float, float] | None = None,
    ) -> None:
        settings = FilterSettings(
            sample_time=sample_time,
            process_noise=process_noise,
            load=load,
            load_noise=load_noise,
            prediction=prediction,
            rolling=rolling,
            gate=gate,
            patience=patience,
            start_spread=start_spread,
            winches=winches,
            rest_length_error=rest_length_error,
        )
        self._begin(*filter_design(plant, sensors, settings, start))
        if self.left_alone.frequency.any():
            warn_of_left_alone(
                self.left_alone,
                "no reading shows and no string reaches",
                "A vibration in these modes is predicted from the start, with its uncertainty.",
            )

    def _begin(
        self,
        design: FilterDesign,
        C: FloatArray,
        steady: tuple[FloatArray, FloatArray, np.ndarray, float],
    ) -> None:
        """Take a design, and be as after a reset."""
        self.C = C
        self.gain, self.covariance, self.poles, self.riccati_residual = steady
        #: The thread that uses the filter: another one is refused meanwhile.
        self.in_use = Exclusive("this KalmanFilter", sum(C.shape))
        self._design = design
        self._size = len(design.start)
        self._motion = None if design.motion is None else Evaluator(design.motion)
        self._correction = Correction(design)
        structure, T = design.plant.model.structure, design.plant.basis
        by_node = T.reshape(-1, structure.dimension, T.shape[1]).swapaxes(0, 1)
        ends = structure.segments
        self._string_rows = by_node[:, ends[:, 1]] - by_node[:, ends[:, 0]]
        # Tᵀ M T = I: forces M T q̈ on the nodes give the accelerations q̈.
        self._force = design.plant.coordinates.project(np.eye(design.plant.nodes.size)).T
        self.reset()

    @property
    def design(self) -> FilterDesign:
        """What the filter computes with; not for users."""
        return self._design

    @property
    def plant(self) -> LinearPlant:
        """The plant in the coordinates of the filter."""
        return self._design.plant

    @property
    def left_alone(self) -> Modes:
        """The undamped modes that no reading shows and no string reaches; empty if there are none.

        They are predicted from the start and never corrected; no process noise drives them, so
        that their covariance stays as it was at the start. At 0 Hz are directions of the structure
        as one body, like that about the vertical without a compass: the estimated rates move them
        on, and their covariance grows.
        """
        return self._design.left_alone

    def observability(self, duration: float = 1.0) -> Observability:
        """Return what each kind of reading tells of each direction, and what is left alone.

        At the operating point, by derivatives.

        Parameters
        ----------
        duration : float
            How long readings are taken, s; whole samples, at least one.

        Returns
        -------
        Observability

        Raises
        ------
        TypeError, ValueError
            If ``duration`` is not a positive number.

        Examples
        --------
        Inclinations and gyroscopes do not tell where a structure points, lengths its shape alone:

        >>> import tenscontrol as tc
        >>> prism = tc.prism()
        >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
        >>> imu = tc.Sensors(structure=prism, string_length=0.001, bar_inclination=0.01,
        ...                  gyroscope=0.02)
        >>> report = tc.KalmanFilter(plant, imu, sample_time=0.02).observability()
        >>> report.left_alone, report.told_by("rate of turn about z")
        (('turn about z',), ('gyroscope',))
        >>> report.left_out
        ('motion along x', 'motion along y', 'motion along z')
        """
        duration = validation.positive_number("duration", duration, "s", validation.LONGEST_WAIT)
        return observability(self._design, self.C, self.covariance, duration)

    @property
    def sensors(self) -> Sensors:
        """The sensors it was designed for."""
        return self._design.sensors

    @property
    def sample_time(self) -> float:
        """Sample time, s."""
        return self._design.settings.sample_time

    @property
    def input(self) -> str:
        """Kind of input, that of the plant: ``"rest_length"``, ``"length"`` and so on."""
        return self.plant.input

    @property
    def substeps(self) -> int:
        """Steps of the ramp of the input in a sample; 1 without a ramp."""
        return self._design.settings.substeps

    @property
    def statistics(self) -> FilterStatistics:
        """Use of the readings since the last reset."""
        return self._tally.statistics()

    @exclusive
    def reset(self, state: object = None, covariance: object = None, held: object = None) -> None:
        """Restart from the start shape, as if newly made.

        Parameters
        ----------
        state : array_like, shape (s,), optional
            z at the start; that of the constructor if not given.
        covariance : array_like, shape (s, s), optional
            Its covariance; by ``start_spread`` of the constructor if not given.
        held : array_like, shape (α,), optional
            Input at the start, as for :meth:`predict`. If not given, the first sample uses no
            tensions and has no ramp; lengths of bars are then those of the shape at the start.

        Raises
        ------
        TypeError, ValueError
            If an argument does not fit, or the covariance is not symmetric with
            eigenvalues of at least 0.
        """
        # Inputs since the moment of the state, each with what known forces add to the state in its
        # sample; the previous one acts on the tensions then.
        self._inputs: deque[tuple[FloatArray, FloatArray | None]] = deque()
        self._previous_input = self._design.start_input
        if held is not None:
            self._begin_after("held", held)
        z, P = self._design.start, self._design.start_covariance
        if state is not None:
            z = validation.shaped("state", state, (self._size,), "displacements, rates and load")
            try:
                self._design.nodes(z, self._previous_input)
            except ValueError as error:
                raise ValueError(
                    f"state is not a possible shape of the structure: {error}"
                ) from error
        if covariance is not None:
            P = _checked_covariance(covariance, self._size)
        self._z, self._P = z, P
        frame = self._design.frame
        self._pose = None if frame is None else RollingPose(frame)
        self._mostly_refused = 0
        self._anew: list[bool] = []  # of the samples of a log: whether it began again there
        self._tally = Tally(len(self.sensors.readings))

    @exclusive
    def update(self, measurement: object) -> Estimate:
        """Return the estimate for now, corrected by readings.

        A reading that is NaN is lost; one that is infinite, or beyond the gate, is refused.
        Neither is used.

        Parameters
        ----------
        measurement : array_like, shape (m,), or None
            y of ``sensors.delay`` samples ago; None if it is lost. Not used before then.

        Returns
        -------
        Estimate

        Raises
        ------
        TypeError, ValueError
            If it is no array of numbers or has the wrong shape.
        """
        count = len(self.sensors.noise)
        y = np.full(count, np.nan)
        if measurement is not None:
            y = validation.measured(
                "measurement", measurement, (count,), "one entry per number read"
            )
        if len(self._inputs) < self.sensors.delay:
            self._tally.wait()
        else:
            self._correct(y)
        z, P = self._z, self._P
        previous = self._previous_input
        for held, push in self._inputs:
            z, P, _ = self._advanced(z, P, previous, held, push)
            previous = held
        if not self._correction.reaches(z, previous):
            self._start_over(after=True)
            z, P, previous = self._z, self._P, self._previous_input
        return self._estimate(z, P, previous)

    @exclusive
    def predict(self, held: object, force: object = None) -> None:
        """Predict the state at the next sample.

        Parameters
        ----------
        held : array_like, shape (α,)
            γ, N/m, or rest lengths, m, that the actuators hold until the next sample, or reach
            by then: the applied input, not the command. Of driven bars their lengths, shape (β,).
        force : array_like, shape (d, n), optional
            Known forces on the nodes until then, N, on average: of contacts that are measured, for
            a plant whose model does not have them. To first order.

        Raises
        ------
        TypeError, ValueError
            If it does not fit or is not finite.
        """
        self._inputs.append((self._known(self._checked_input("held", held)), self._pushed(force)))
        if len(self._inputs) <= self.sensors.delay:
            return
        previous = self._previous_input
        self._previous_input, push = self._inputs.popleft()
        self._z, self._P, self._transition = self._advanced(
            self._z, self._P, previous, self._previous_input, push
        )
        spread = np.diag(self._P) / np.diag(self._design.start_covariance)
        reaches = self._correction.reaches(self._z, self._previous_input)
        if not reaches or spread.max() > NOTHING_KNOWN:
            self._start_over()

    def smooth(self, readings: object, held: object, *, previous: object = None) -> SmoothedMotion:
        """Return the motion over a log, each sample by all readings, before and after it.

        The smoother of Rauch, Tung and Striebel, about the estimates of the filter, which starts
        as newly made and stays as it is.

        Parameters
        ----------
        readings : array_like, shape (m, K)
            y as it arrived at each sample, as for :meth:`update`; NaN is lost. Of a simulation:
            ``run.control.estimate.measurement``.
        held : array_like, shape (α, K)
            What actuators held over each sample, as for :meth:`predict`. Of a simulation:
            ``run.control.applied``.
        previous : array_like, shape (α,), optional
            Input before the first sample, as ``held`` of :meth:`reset`.

        Returns
        -------
        SmoothedMotion

        Raises
        ------
        TypeError, ValueError
            If an argument does not fit, or a smoothed state is no shape of the structure.
        """
        count, inputs = len(self.sensors.noise), len(self.plant.actuation.input)
        if self._pose is not None:
            raise ValueError("a filter with rolling=True does not smooth: it turns as it goes")
        y = validation.real_array("readings", readings)
        if y.ndim != 2 or y.shape[0] != count or not y.shape[1]:
            raise ValueError(
                f"readings has shape {y.shape}, expected ({count}, K): one column per sample"
            )
        samples = y.shape[1]
        inputs_held = validation.shaped(
            "held", held, (inputs, samples), "one column per sample of readings"
        )
        # What arrives late was read before.
        delay = min(self.sensors.delay, samples)
        y = np.hstack([y[:, delay:], np.full((count, delay), np.nan)])
        forward = object.__new__(KalmanFilter)
        prompt = replace(self._design, sensors=replace(self.sensors, delay=0))
        forward._begin(prompt, self.C, self.__getstate__()[2])
        forward.reset()
        if previous is not None:
            forward._begin_after("previous", previous)
        passes = [forward._pass(*columns) for columns in zip(y.T, inputs_held.T, strict=True)]
        for i, started_anew in enumerate(forward._anew[1:]):
            if started_anew:
                passes[i] = replace(passes[i], transition=None)
        states = smoothed(passes)
        for k, ((z, _), sample) in enumerate(zip(states, passes, strict=True)):
            if not self._correction.reaches(z, sample.held):
                raise ValueError(
                    f"readings lead to a smoothed state at sample {k} that is no shape of the "
                    "structure: give prediction='nonlinear', or the shape at the start"
                )
        estimates_by_all = [
            forward._estimate(*state, sample.held)
            for state, sample in zip(states, passes, strict=True)
        ]
        T, shape = self.plant.basis, self.plant.nodes.shape
        filtered = [_deviation(T, sample.P).reshape(shape, order="F") for sample in passes]

        def series(name: str) -> FloatArray:
            values = [getattr(estimate, name) for estimate in estimates_by_all]
            return frozen(np.stack(values, axis=-1))

        names = (
            "nodes", "velocities", "node_deviation", "bias", "bias_deviation", "rest_length_error",
            "rest_length_deviation", "state",
        )  # fmt: skip
        return SmoothedMotion(
            time=frozen(self.sample_time * np.arange(samples)),
            filtered_node_deviation=frozen(np.stack(filtered, axis=-1)),
            load=series("load") if self._design.settings.load else None,
            filtered_state=frozen(np.stack([sample.z for sample in passes], axis=-1)),
            covariance=frozen(np.stack([P for _, P in states])),
            filtered_covariance=frozen(np.stack([sample.P for sample in passes])),
            **{name: series(name) for name in names},
        )

    def _pass(self, y: FloatArray, held: FloatArray) -> Pass:
        """Take the readings of a sample, predict the next, and return what a smoother needs."""
        before = self._tally.restarts
        self.update(y)
        corrected = self._tally.restarts
        z, P, previous = self._z, self._P, self._previous_input
        self.predict(held)
        self._anew.append(corrected > before)
        lost = self._tally.restarts > corrected
        return Pass(z, P, self._z, self._P, None if lost else self._transition, previous)

    def _begin_after(self, name: str, held: object) -> None:
        """Take the input before the first sample."""
        self._previous_input = known_at_rest(self.plant, self._checked_input(name, held))

    def _checked_input(self, name: str, held: object) -> FloatArray:
        shape = self.plant.actuation.input.shape
        if not self.plant.drives_bars:
            strings = validation.shaped(name, held, shape, "one per string")
            return inputs_of(self.plant.actuation, strings)
        lengths = inputs_of(
            self.plant.actuation, validation.shaped(name, held, shape, "one length per member")
        )
        most = MOST_LENGTH * self.plant.equilibrium_input
        wrong = np.flatnonzero((lengths <= 0) | (lengths > most))
        if len(wrong):
            i = wrong[0]
            raise ValueError(
                f"{name}[{i}] is {lengths[i]:.3g} m, expected a length above 0 and at most "
                f"{most[i]:.3g} m"
            )
        return lengths

    def _known(self, inputs: FloatArray) -> FloatArray:
        """Return what inputs do that are reached by the next sample, see :func:`known_size`."""
        if not self.plant.drives_bars:
            return inputs
        before = self._inputs[-1][0] if self._inputs else self._previous_input
        assert before is not None  # lengths of bars are always known
        return np.concatenate([inputs, (inputs - before[: len(inputs)]) / self.sample_time])

    def _pushed(self, force: object) -> FloatArray | None:
        """Return what known forces add to the state in a sample, shape (2r,)."""
        if force is None:
            return None
        if self._pose is not None:
            raise ValueError("force is given, but a filter with rolling=True takes none")
        shape = self.plant.nodes.shape
        forces = validation.shaped("force", force, shape, "one force per node, N")
        # Tᵀ M T = I: forces on the nodes give the accelerations Tᵀ f.
        given = self.plant.basis.T @ forces.ravel(order="F")
        return np.asarray(acceleration_response(self.plant, self.sample_time) @ given)

    def _correct(self, y: FloatArray) -> None:
        """Correct the state of the moment that was measured."""
        gate = self._correction.gate
        if self._pose is not None:
            y = self._pose.in_frame(y)
        usable = gate.finite(y)
        # Without the previous input, tensions and accelerations say nothing.
        if self._previous_input is None:
            usable &= ~gate.needs_input
            y = np.where(gate.needs_input[self.sensors.reading_of], np.nan, y)
        held = self._previous_input
        if held is None:
            held = self.plant.equilibrium_input
        correction = self._correction.fit(y, usable, self._z, self._P, held)
        if 2 * int(correction.passed.sum()) < int(usable.sum()):
            self._mostly_refused += 1
            late = self._mostly_refused - self._design.settings.patience
            if late >= 0:
                self._P = self._design.start_covariance * WIDER ** min(late, MOST_WIDER)
                self._tally.start_over()
                correction = self._correction.fit(y, usable, self._z, self._P, held)
        elif usable.any():
            self._mostly_refused = 0
        entries = int(correction.passed[self.sensors.reading_of].sum())
        self._z, self._P = correction.z, correction.P
        if self._pose is not None:
            shape = self._design.motion_of(self._z, held)
            self._z, self._P = self._pose.settle(self._z, self._P, *shape)
        self._tally.add(gate.lost(y), usable, correction.passed, correction.nis, entries)

    def _advanced(
        self, z: FloatArray, P: FloatArray, previous: FloatArray | None, held: FloatArray,
        push: FloatArray | None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
        """Return state, covariance and transition to a sample later.

        A ramp goes from the previous input.
        """
        design, start = self._design, held if previous is None else previous
        if self._motion is None:
            moved, rest = design.sampled, self.plant.equilibrium_input
            start, held = start[: len(rest)], held[: len(rest)]
            transition = moved.transition
            with np.errstate(over="ignore", invalid="ignore"):  # an input may be of any size
                z = transition @ z + moved.by_input @ (held - rest) + moved.drift
                if moved.ramp:
                    z = z + moved.by_previous @ (start - rest)
        else:
            transition, count = np.eye(len(z)), design.settings.substeps
            for left in range(count - 1, -1, -1):
                # A ramp is held at the middle of each substep.
                share = (left + 0.5) / count if count > 1 else 0.0
                end, along, _ = self._motion(z, held + share * (start - held))
                z, transition = end.copy(), along @ transition
        if push is not None:
            z = z + np.pad(push, (0, len(z) - len(push)))
        P = transition @ P @ transition.T + design.process_covariance
        return z, 0.5 * (P + P.T), transition

    def _start_over(self, after: bool = False) -> None:
        """Start from the operating point: the estimate is of no shape of the structure."""
        self._z, self._P = np.zeros_like(self._z), self._design.start_covariance
        if not self.plant.drives_bars:
            self._previous_input = None
        else:  # bars have the lengths that they have
            if self._inputs:
                self._previous_input, _ = self._inputs[-1]
            if not self._correction.reaches(self._z, self._previous_input):
                self._previous_input = known_at_rest(self.plant, self.plant.equilibrium_input)
        self._inputs.clear()
        self._tally.start_over(after)

    def _estimate(self, z: FloatArray, P: FloatArray, held: FloatArray | None) -> Estimate:
        r, T = self.plant.degrees_of_freedom, self.plant.basis
        nodes, velocities = self._design.motion_of(z, held)
        structure, shape = self.plant.model.structure, self.plant.nodes.shape
        strings = structure.string_vectors(nodes)
        along = strings / np.maximum(np.linalg.norm(strings, axis=0), np.finfo(float).tiny)
        stretch = (along[:, :, None] * self._string_rows).sum(axis=0)
        if structure.has_clusters:
            by_segment, stretch = stretch, np.zeros((len(structure.strings), r))
            np.add.at(stretch, structure.segment_string, by_segment)
        force = self._force @ z[self._design.extra.of_load] if self._design.settings.load else None
        if self._pose is not None:
            nodes, velocities = self._pose.place(nodes, velocities)
            T = self._pose.turned(T)
            if force is not None:
                force = self._pose.turned(force[:, None])
        by_node, by_length = (_deviation(D, P) for D in (T, stretch))
        extra, variance = self._design.extra, np.diag(P)
        bias, wound = np.zeros((2, len(self.sensors.noise))), np.zeros((2, self.plant.B.shape[1]))
        bias[:, list(extra.biased)] = z[extra.of_bias], np.sqrt(variance[extra.of_bias])
        wound[:, list(extra.rest_lengths)] = (
            z[extra.of_rest_length], np.sqrt(variance[extra.of_rest_length])
        )  # fmt: skip
        return Estimate(
            nodes=frozen(nodes),
            velocities=frozen(velocities),
            bias=frozen(bias[0]),
            bias_deviation=frozen(bias[1]),
            rest_length_error=frozen(moved_by(self.plant.actuation, wound[0])),
            rest_length_deviation=frozen(np.abs(moved_by(self.plant.actuation, wound[1]))),
            load=None if force is None else frozen(force.reshape(shape, order="F")),
            state=frozen(z),
            covariance=frozen(P),
            node_deviation=frozen(by_node.reshape(shape, order="F")),
            length_deviation=frozen(by_length),
            status=self._tally.last,
        )

    def __getstate__(self) -> tuple[Any, ...]:
        steady = self.gain, self.covariance, self.poles, self.riccati_residual
        return self._design, self.C, steady

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self._begin(*state)

    def __repr__(self) -> str:
        kind = "linear" if self._motion is None else "nonlinear"
        return (
            f"KalmanFilter({self._size} states, {len(self.sensors.readings)} readings, "
            f"sample time {self.sample_time:g} s, {kind} prediction)"
        )


def _deviation(by_motion: FloatArray, P: FloatArray) -> FloatArray:
    """Return standard deviations of numbers whose derivatives by the motion q are the rows."""
    r = by_motion.shape[1]
    return np.asarray(np.sqrt(((by_motion @ P[:r, :r]) * by_motion).sum(axis=1)))


def _checked_covariance(value: object, size: int) -> FloatArray:
    P = validation.shaped("covariance", value, (size, size), "one row per state")
    largest = float(np.abs(P).max(initial=0.0))
    if np.abs(P - P.T).max(initial=0.0) > 1e-9 * largest:
        raise ValueError("covariance is not symmetric")
    least = float(np.linalg.eigvalsh(P).min())
    if least < -1e-9 * largest:
        raise ValueError(f"covariance has the eigenvalue {least:.3g}, expected at least 0")
    return P
