"""Design of a Kalman filter."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import inputs_of, member_rows
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.estimation.extra_states import ExtraStates
from tenscontrol.estimation.observability import (
    observed_plant,
    output_derivative,
    output_function,
    refuse_unseen_constants,
    refuse_unseen_loads,
    unseen,
    unseen_with_biases,
)
from tenscontrol.estimation.rolling_frame import RollingFrame, RollingPose, rolling_frame
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.fields import check_fields, checked, optional
from tenscontrol.plant.driven_lengths import known_at_rest, lengths_of
from tenscontrol.plant.linear_plant import (
    NO_JUMP,
    LinearPlant,
    Sampled,
    acceleration_response,
    member_lengths,
    sampled,
)
from tenscontrol.plant.modes import Modes
from tenscontrol.plant.reduced_dynamics import refuse_lost_place, sampled_dynamics
from tenscontrol.plant.reference import reduced_shape, refuse_passive_bars
from tenscontrol.plant.riccati import filter_riccati
from tenscontrol.structure.bar_geometry import bar_lengths, rigid_shape
from tenscontrol.structure.structure import different_members

PREDICTIONS = ("linear", "nonlinear")

# Part of the size by which string lengths at the start may be off in the coordinates.
_START_TOLERANCE = 1e-3

# A plant at rest drifts by less than this part of the pull of the strings.
_FALLS = 0.01

# Standard deviation of the load at the start, as a part of the pull of the strings.
_LOAD_START = 0.3

#: Readings are taken to be no better than this part of the variance that is predicted: where they
#: are, round-off makes the covariance of the innovation singular, and leaves the Riccati equation
#: without a solution.
LEAST_NOISE = 1e-12


def _probability(name: str, value: object) -> float:
    number = validation.positive_number(name, value, "no unit, below 1")
    if number >= 1:
        raise ValueError(f"{name} is {number:g}, expected a probability above 0 and below 1")
    return number


def _random_walk(name: str, value: object, meaning: str) -> tuple[float, float]:
    pair = validation.shaped(name, value, (2,), "at the start, and of the walk in a second")
    validation.positive(name, pair, meaning)
    return float(pair[0]), float(pair[1])


_NOISE = checked(validation.positive_number, "accelerations of the strings")


@dataclass(frozen=True, eq=False)
class FilterSettings:
    """Settings of a filter, checked; their meanings are those of :class:`KalmanFilter`."""

    sample_time: float = field(metadata=checked(validation.positive_number, "s"))
    process_noise: float = field(metadata=_NOISE)
    load: bool = field(metadata=checked(validation.truth, "whether to estimate an unknown load"))
    load_noise: float = field(metadata=_NOISE)
    prediction: str = field(metadata=checked(validation.choice, PREDICTIONS))
    rolling: bool = field(metadata=checked(validation.truth, "whether the structure rolls"))
    gate: float = field(metadata=checked(_probability))
    patience: int = field(metadata=checked(validation.whole_number, 1))
    start_spread: float = field(
        metadata=checked(validation.positive_number, "sizes of the structure")
    )
    winches: Winches | None = field(
        metadata=optional(validation.instance, Winches, "make them by Winches(substeps=...)")
    )
    rest_length_error: tuple[float, float] | None = field(
        metadata=optional(_random_walk, "standard deviations, m and m/√s")
    )

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def substeps(self) -> int:
        """Parts of the ramp of the winches in a sample; 1 without a ramp."""
        return 1 if self.winches is None else self.winches.substeps


@dataclass(frozen=True, eq=False)
class FilterDesign:
    """What a filter computes with, in the coordinates of ``plant``.

    States are those of the plant and ``extra``, s in all. Covariances have the shape (s, s),
    ``outputs`` is ``(z, u) -> (y, ∂y/∂z)``, and ``motion`` is ``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)``
    over a substep, None for a linear prediction. ``u`` are inputs, or what :func:`known_size` says
    of lengths of bars.
    """

    plant: LinearPlant
    sensors: Sensors
    settings: FilterSettings
    extra: ExtraStates
    sampled: Sampled
    process_covariance: FloatArray
    start_covariance: FloatArray
    start: FloatArray
    start_input: FloatArray | None  # what inputs do at the start; None if that is not known
    outputs: ca.Function
    motion: ca.Function | None
    frame: RollingFrame | None  # where the structure rolls
    unseen: FloatArray  # all states that are left alone, orthonormal columns
    left_alone: Modes

    def nodes(self, z: FloatArray, held: FloatArray | None) -> FloatArray:
        """Return the nodes of a state, or raise where it is no shape of the structure."""
        lengths, _ = lengths_of(self.plant, held)
        return self.plant.to_nodes(z[: self.plant.degrees_of_freedom], lengths)

    def motion_of(self, z: FloatArray, held: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities of a state, or raise as :meth:`nodes`."""
        q, rates = np.split(z[: self.extra.states], 2)
        return self.plant.coordinates.to_motion(q, rates, *lengths_of(self.plant, held))


def filter_design(
    plant: LinearPlant, sensors: Sensors, settings: FilterSettings, start: object
) -> tuple[FilterDesign, FloatArray, tuple[FloatArray, FloatArray, np.ndarray, float]]:
    """Return the design of a filter, the derivative C of its readings, and the Riccati solution."""
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    validation.instance("sensors", sensors, Sensors, "make them by Sensors(structure=..., ...)")
    sample_time, substeps = settings.sample_time, settings.substeps
    plant.refuse_long_sample_time(sample_time)
    if plant.drives_bars:
        _refuse_bars(plant, sensors, settings)
    elif settings.winches is not None and plant.input != "rest_length":
        raise ValueError(
            f"winches set rest lengths, but plant has input={plant.input!r}; linearize with "
            "input='rest_length'"
        )
    if plant.coordinates.kind == "nodes":
        raise ValueError(
            "plant has 'nodes' coordinates, in which bars may stretch; linearize with "
            "coordinates='internal' or 'minimal'"
        )
    # Feet are fixed nodes to a plant on the ground; sensors may be those of the structure itself.
    different = different_members(sensors.structure, plant.model.structure, plant.feet)
    if different:
        raise ValueError(
            f"sensors are those of {sensors.structure!r}, but plant is that of "
            f"{plant.model.structure!r} with {different}: give Sensors(structure=...) that of the "
            "plant, plant.model.structure"
        )
    if settings.prediction == "nonlinear":
        refuse_lost_place(plant)
    _refuse_other_gravity(plant, sensors)
    plant = observed_plant(plant, sensors)
    if not len(plant.A):
        raise ValueError("plant has no states, so there is nothing to estimate")
    C = output_derivative(plant, sensors)
    apart = unseen(plant, sensors, C)
    if settings.load:
        refuse_unseen_loads(plant, sensors, C)
    pull = _pull(plant)
    if settings.prediction == "linear":
        _refuse_fall(plant, pull)
    extra = _extra_states(plant, sensors, settings)
    frame = rolling_frame(plant, sensors, extra, start) if settings.rolling else None
    C = output_derivative(plant, sensors, extra)
    directions = unseen_with_biases(plant, sensors, extra, C, apart)
    refuse_unseen_constants(plant, sensors, extra, C, directions)
    # No noise drives modes that are left alone: nothing would ever correct that.
    by_load = acceleration_response(plant, sample_time)
    pushed = by_load - apart.modes @ (apart.modes.T @ by_load)
    moved = sampled(plant, sample_time, substeps > 1)
    motion: ca.Function | None = None
    if settings.prediction == "nonlinear":
        motion = sampled_dynamics(plant, sample_time / substeps)[1]
        if extra.size > extra.states:
            step = sample_time / substeps
            key, of_plant = ("with extra states", extra, step), motion
            motion = plant.prepared.get(
                key, lambda: extra.motion(of_plant, acceleration_response(plant, step))
            )
    drive = _drive(extra, sensors, settings, pushed, pull)
    more = extra.size - extra.states
    none = np.zeros((more, plant.B.shape[1]))
    lost = np.hstack([directions, np.pad(apart.modes, ((0, more), (0, 0)))])
    shape = start if frame is None else RollingPose(frame).turn.T @ frame.start
    first, start_input = _start_state(plant, shape)
    design = FilterDesign(
        plant=plant,
        sensors=sensors,
        settings=settings,
        extra=extra,
        sampled=replace(
            moved,
            transition=extra.joined(moved.transition, pushed, moved.by_previous + moved.by_input),
            by_previous=np.vstack([moved.by_previous, none]),
            by_input=np.vstack([moved.by_input, none]),
            drift=np.r_[moved.drift, np.zeros(more)],
        ),
        process_covariance=drive @ drive.T,
        start_covariance=_start(plant, sensors, settings, extra, pull),
        start=np.r_[first, np.zeros(more)],
        start_input=start_input,
        outputs=output_function(plant, sensors, extra),
        motion=motion,
        frame=frame,
        unseen=frozen(np.linalg.qr(lost)[0]),
        left_alone=apart.left_alone,
    )
    # Where a load is estimated, nothing is unseen.
    split = None
    if not settings.load:
        count = lost.shape[1]
        split = np.roll(np.linalg.qr(lost, mode="complete")[0], -count, axis=1), extra.size - count
    # What process noise adds over a sample is the least that a prediction errs by.
    noise = np.maximum(sensors.noise, LEAST_NOISE**0.5 * np.linalg.norm(C @ drive, axis=1))
    solution = filter_riccati(design.sampled.transition, drive, C, noise, split)
    return design, frozen(C), solution


def _refuse_other_gravity(plant: LinearPlant, sensors: Sensors) -> None:
    """Refuse sensors that feel another gravity than the structure; a model may have none."""
    of_model, felt = plant.model.gravity, sensors.free_fall
    if not of_model.any():
        return
    if sensors.bar_inclination is not None:
        of_model, felt = (g / np.linalg.norm(g) for g in (of_model, felt))
    elif sensors.accelerometer is None:
        return
    if sensors.accelerometer is not None:
        of_model, felt = plant.model.gravity, sensors.free_fall
    if not np.allclose(of_model, felt, rtol=0, atol=1e-9 * float(np.linalg.norm(of_model))):
        raise ValueError(
            f"sensors feel the gravity {sensors.free_fall}, but the model of plant has "
            f"{plant.model.gravity}, m/s²: give Sensors(gravity=model.gravity)"
        )


def _extra_states(plant: LinearPlant, sensors: Sensors, settings: FilterSettings) -> ExtraStates:
    """Return what a filter estimates beside the state of the plant."""
    r = plant.degrees_of_freedom
    strings = member_rows(plant.input, plant.commanded)[0]
    wound = tuple(np.flatnonzero(plant.actuation.lead < strings.stop).tolist())
    if sensors.encoder is not None:
        if settings.rest_length_error is None:
            raise ValueError(
                "sensors read encoders, which say how far rest lengths are from those that "
                "KalmanFilter.predict is told: give rest_length_error, their standard deviation "
                "at the start, m, and that of their walk, m/√s"
            )
        if plant.commanded is not plant.model.structure:
            raise ValueError(
                "sensors read encoders of strings that the plant does not command: it is one of "
                "command_parents; leave encoder out"
            )
        read = np.asarray(sensors.encoder_strings)
        inputs = plant.actuation.input[read]
        if (inputs < 0).any():
            raise ValueError(
                f"sensors read the encoder of string {read[inputs < 0][0]}, but no input of the "
                "plant drives this string: choose encoder_strings among the driven ones"
            )
        wound = tuple(np.unique(inputs).tolist())
    if settings.rest_length_error is None:
        wound = ()
    elif not plant.winds_strings:
        raise ValueError(
            f"rest_length_error is given, but plant has input={plant.input!r}; linearize with "
            "input='rest_length'"
        )
    return ExtraStates(
        states=len(plant.A),
        load=r if settings.load else 0,
        disturbance=r if sensors.needs("acceleration") else 0,
        rest_lengths=wound,
        biased=tuple(np.flatnonzero(sensors.bias_deviation).tolist()),
    )


def _drive(
    extra: ExtraStates,
    sensors: Sensors,
    settings: FilterSettings,
    pushed: FloatArray,
    pull: float,
) -> FloatArray:
    """Return what independent noises of variance 1 add to all states over a sample.

    ``pushed``, shape (2r, r), is the response of the plant to unit accelerations.
    """
    r, root = pushed.shape[1], float(np.sqrt(settings.sample_time))
    steps = np.zeros(extra.size)
    steps[extra.of_load] = settings.load_noise * pull
    if settings.rest_length_error is not None:
        steps[extra.of_rest_length] = settings.rest_length_error[1] * root
    steps[extra.of_bias] = sensors.bias_walk[list(extra.biased)] * root
    drive = np.hstack([np.zeros((extra.size, r)), np.diag(steps)[:, extra.states :]])
    drive[: extra.states, :r] = settings.process_noise * pull * pushed
    if extra.disturbance:
        drive[extra.of_disturbance, :r] = settings.process_noise * pull * np.eye(r)
    return np.asarray(drive[:, :r] if extra.size == extra.states else drive)


def _refuse_fall(plant: LinearPlant, pull: float) -> None:
    """Refuse to predict by a linear plant in the air that the ground ends its fall."""
    drift = float(np.abs(plant.drift).max(initial=0.0))
    if plant.model.contacts is not None and drift > _FALLS * pull:
        raise ValueError(
            f"plant is not at rest: it drifts by {drift:.3g} m √kg/s², and a linear prediction "
            "does not include contact with the ground. Give prediction='nonlinear', or linearize "
            "about a shape that stands"
        )


def _pull(plant: LinearPlant) -> float:
    """Return the root mean square acceleration q̈ that strings give, with signs at random.

    The squares of what each string gives alone are summed over the strings, and their mean is taken
    over the coordinates.
    """
    structure, commanded = plant.model.structure, plant.commanded
    ends = plant.nodes[:, : commanded.nodes.shape[1]]
    forces = np.zeros((len(commanded.strings), *structure.nodes.shape[::-1]))
    of, segments = commanded.segment_string, commanded.segments
    vectors, gamma = commanded.string_vectors(ends), plant.force_density[of]
    if commanded.has_clusters:  # T/l of each segment
        gamma = gamma * commanded.string_length(ends)[of] / np.linalg.norm(vectors, axis=0)
    pulls = gamma[:, None] * vectors.T
    np.add.at(forces, (of, segments[:, 0]), pulls)
    np.add.at(forces, (of, segments[:, 1]), -pulls)
    # Tᵀ M T = I, so that a force f gives q̈ = Tᵀ f.
    given = forces.reshape(len(forces), -1) @ plant.basis
    pull = float(np.linalg.norm(given) / np.sqrt(plant.degrees_of_freedom))
    if not pull > 0:
        raise ValueError(
            "no string of the plant pulls at the operating point, so that process_noise has no "
            "measure; linearize about a shape with some prestress"
        )
    return pull


def _refuse_bars(plant: LinearPlant, sensors: Sensors, settings: FilterSettings) -> None:
    """Refuse what does not go with bars that are driven."""
    if settings.prediction == "nonlinear":
        raise ValueError(
            "prediction is 'nonlinear', which takes bars of constant length, but lengths of bars "
            "are the input of plant: give prediction='linear', and linearize near the motion"
        )
    if settings.winches is None or not settings.winches.ramp:
        raise ValueError(NO_JUMP)
    if sensors.needs("acceleration"):
        raise ValueError(
            "sensors have an accelerometer, which feels the jerks of drives of bars as their rates "
            f"jump from sample to sample, but plant has input={plant.input!r}: leave accelerometer "
            "out"
        )


def _start_state(plant: LinearPlant, nodes: object) -> tuple[FloatArray, FloatArray | None]:
    """Return z at the start, and what inputs do; None where that is not known."""
    is_driven, structure = plant.drives_bars, plant.model.structure
    if nodes is None:
        known = known_at_rest(plant, plant.equilibrium_input) if is_driven else None
        return np.zeros(len(plant.A)), known
    shape, known = structure.checked_nodes("start", nodes), None
    if is_driven:
        refuse_passive_bars(plant, "start", shape)
        length = bar_lengths(structure, shape)
        assert plant.rest_length is not None  # bars are driven
        members = member_lengths(plant, plant.rest_length, length)
        known = known_at_rest(plant, inputs_of(plant.actuation, members))
    else:
        shape = rigid_shape("start", structure, shape)
    q = reduced_shape(plant, "start", shape, _START_TOLERANCE)
    return np.concatenate([q, np.zeros_like(q)]), known


def _start(
    plant: LinearPlant,
    sensors: Sensors,
    settings: FilterSettings,
    extra: ExtraStates,
    pull: float,
) -> FloatArray:
    """Return the covariance at the start, shape (s, s)."""
    r, n = plant.degrees_of_freedom, plant.nodes.shape[1]
    size = float(np.ptp(plant.nodes, axis=1).max())
    shift = settings.start_spread * size * np.sqrt(n) / float(np.linalg.norm(plant.basis))
    deviation = np.zeros(extra.size)
    deviation[extra.of_load] = _LOAD_START * pull
    deviation[extra.of_disturbance] = settings.process_noise * pull
    if settings.rest_length_error is not None:
        deviation[extra.of_rest_length] = settings.rest_length_error[0]
    deviation[extra.of_bias] = sensors.bias_deviation[list(extra.biased)]
    return np.diag(
        np.r_[np.full(r, shift**2), np.full(r, 2 * pull * shift), deviation[extra.states :] ** 2]
    )
