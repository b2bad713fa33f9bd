"""Design of a Kalman filter: observability, noise and steady gain, checked."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.estimation.observability import (
    observed_plant,
    output_function,
    output_matrix,
    refuse_unseen_loads,
    unseen,
)
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.fields import check_fields, checked
from tenscontrol.plant.linear_plant import LinearPlant, Sampled, acceleration_response, sampled
from tenscontrol.plant.modes import Modes
from tenscontrol.plant.reduced_dynamics import refuse_lost_place, sampled_dynamics
from tenscontrol.plant.reference import reduced_shape
from tenscontrol.plant.riccati import filter_riccati
from tenscontrol.structure.bar_geometry import refuse_wrong_bar_lengths
from tenscontrol.structure.structure import different_members

PREDICTIONS = ("linear", "nonlinear")

# Part of the size by which string lengths at the start may be off in the coordinates.
_START_TOLERANCE = 1e-3

# A plant at rest drifts by less than this part of the pull of the strings.
_FALLS = 0.01

# Standard deviation of the load at the start, as a part of the pull of the strings.
_LOAD_START = 0.3


def _probability(name: str, value: object) -> float:
    number = validation.positive_number(name, value, "no unit, below 1")
    if number >= 1:
        raise ValueError(f"{name} is {number:g}, expected a probability above 0 and below 1")
    return number


def _winches(name: str, value: object) -> object:
    if value is not None:
        validation.instance(name, value, Winches, "make them by Winches(substeps=...)")
    return value


_NOISE = checked(validation.positive_number, "accelerations of the strings")


@dataclass(frozen=True, eq=False)
class FilterSettings:
    """Settings of a filter, checked; their meanings are those of :class:`KalmanFilter`."""

    sample_time: float = field(metadata=checked(validation.positive_number, "s"))
    process_noise: float = field(metadata=_NOISE)
    load: bool = field(metadata=checked(validation.truth, "whether to estimate an unknown load"))
    load_noise: float = field(metadata=_NOISE)
    prediction: str = field(metadata=checked(validation.choice, PREDICTIONS))
    gate: float = field(metadata=checked(_probability))
    patience: int = field(metadata=checked(validation.whole_number, 1))
    start_spread: float = field(
        metadata=checked(validation.positive_number, "sizes of the structure")
    )
    winches: Winches | None = field(metadata=checked(_winches))

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def substeps(self) -> int:
        """Parts of the ramp of the winches in a sample; 1 without a ramp."""
        return 1 if self.winches is None else self.winches.substeps


@dataclass(frozen=True, eq=False)
class FilterDesign:
    """What a filter computes with, in the coordinates of ``plant``.

    Where a load is estimated, z has r more entries: the acceleration q̈ that it gives. Covariances
    have the shape (s, s), ``outputs`` is ``(z, u) -> (y, ∂y/∂z)``, and ``motion`` is ``(z, u) ->
    (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)`` over a substep, None for a linear prediction.
    """

    plant: LinearPlant
    sensors: Sensors
    settings: FilterSettings
    sampled: Sampled
    process_covariance: FloatArray
    start_covariance: FloatArray
    start: FloatArray
    outputs: ca.Function
    motion: ca.Function | None
    left_alone: Modes


def filter_design(
    plant: LinearPlant, sensors: Sensors, settings: FilterSettings, start: object
) -> tuple[FilterDesign, FloatArray, tuple[FloatArray, FloatArray, np.ndarray, float]]:
    """Return the design of a filter, the derivative C of its readings, and the Riccati solution."""
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    validation.instance("sensors", sensors, Sensors, "make them by Sensors(structure=..., ...)")
    sample_time, substeps = settings.sample_time, settings.substeps
    plant.refuse_long_sample_time(sample_time)
    if settings.winches is not None and plant.input != "rest_length":
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
    plant = observed_plant(plant, sensors)
    if not len(plant.A):
        raise ValueError("plant has no states, so there is nothing to estimate")
    C = output_matrix(plant, sensors)
    apart = unseen(plant, sensors, C)
    if settings.load:
        refuse_unseen_loads(plant, sensors, C)
    pull = _pull(plant)
    if settings.prediction == "linear":
        _refuse_fall(plant, pull)
    # No noise drives what is left alone: nothing would ever correct that.
    seen = apart.basis[:, : apart.count]
    by_load = acceleration_response(plant, sample_time)
    if apart.count < len(plant.A):
        by_load = seen @ (seen.T @ by_load)
    motion: ca.Function | None = None
    if settings.prediction == "nonlinear":
        motion = sampled_dynamics(plant, sample_time / substeps)[1]
    design = FilterDesign(
        plant=plant,
        sensors=sensors,
        settings=settings,
        sampled=sampled(plant, sample_time, substeps > 1),
        process_covariance=(settings.process_noise * pull) ** 2 * by_load @ by_load.T,
        start_covariance=_start(plant, settings.start_spread, pull),
        start=_start_state(plant, start),
        outputs=output_function(plant, sensors),
        motion=motion,
        left_alone=apart.left_alone,
    )
    push = settings.process_noise * pull * by_load
    if settings.load:
        walk = settings.load_noise * pull
        design = _with_load(design, pull, walk)
        r = plant.degrees_of_freedom
        none = np.zeros((2 * r, r))
        push = np.block([[push, none], [none[:r], walk * np.eye(r)]])
        C = np.hstack([C, np.zeros((len(C), r))])
    # Where a load is estimated, nothing is unseen.
    split = None if settings.load else (apart.basis, apart.count)
    solution = filter_riccati(design.sampled.transition, push, C, sensors.noise, split)
    return design, frozen(C), solution


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


def _start_state(plant: LinearPlant, nodes: object) -> FloatArray:
    if nodes is None:
        return np.zeros(len(plant.A))
    structure = plant.model.structure
    shape = structure.checked_nodes("start", nodes)
    refuse_wrong_bar_lengths("start", structure, shape)
    q = reduced_shape(plant, "start", shape, _START_TOLERANCE)
    return np.concatenate([q, np.zeros_like(q)])


def _start(plant: LinearPlant, spread: float, pull: float) -> FloatArray:
    """Return the covariance at the start, shape (2r, 2r)."""
    r, n = plant.degrees_of_freedom, plant.nodes.shape[1]
    size = float(np.ptp(plant.nodes, axis=1).max())
    shift = spread * size * np.sqrt(n) / float(np.linalg.norm(plant.basis))
    return np.diag(np.r_[np.full(r, shift**2), np.full(r, 2 * pull * shift)])


def _with_load(design: FilterDesign, pull: float, walk: float) -> FilterDesign:
    """Return the design with the acceleration a that a load gives as states after z.

    ``z⁺ = Φ z + … + Ψ a``, with Ψ what unit accelerations do in a sample, and ``a⁺ = a + w'``: a
    random walk, whose steps have the standard deviation ``walk``.
    """
    settings = design.settings
    by_load = acceleration_response(design.plant, settings.sample_time)
    size, r = by_load.shape
    eye, zero = np.eye(r), np.zeros((size, r))
    moved, none = design.sampled, np.zeros((r, design.plant.B.shape[1]))

    def joined(of_state: FloatArray, deviation: float) -> FloatArray:
        return np.block([[of_state, zero], [zero.T, deviation**2 * eye]])

    motion = design.motion
    if motion is not None:
        step = settings.sample_time / settings.substeps
        in_step = acceleration_response(design.plant, step)
        key, linear = ("under_load", step), motion
        motion = design.plant.prepared.get(key, lambda: _under_load(linear, in_step))
    return replace(
        design,
        sampled=replace(
            moved,
            transition=np.block([[moved.transition, by_load], [zero.T, eye]]),
            by_previous=np.vstack([moved.by_previous, none]),
            by_input=np.vstack([moved.by_input, none]),
            drift=np.r_[moved.drift, np.zeros(r)],
        ),
        process_covariance=joined(design.process_covariance, walk),
        start_covariance=joined(design.start_covariance, _LOAD_START * pull),
        start=np.r_[design.start, np.zeros(r)],
        outputs=output_function(design.plant, design.sensors, more=r),
        motion=motion,
    )


def _under_load(motion: ca.Function, by_load: FloatArray) -> ca.Function:
    """Return ``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)`` under a load, to first order in the load."""
    size, r = by_load.shape
    z, u = ca.MX.sym("z", size + r), ca.MX.sym("u", motion.size1_in(1))
    end, of_state, of_input = motion(z[:size], u)
    end = ca.vertcat(end + ca.DM(by_load) @ z[size:], z[size:])
    rows = ca.blockcat([[of_state, ca.DM(by_load)], [ca.DM(r, size), ca.DM.eye(r)]])
    below = ca.vertcat(of_input, ca.DM(r, motion.size1_in(1)))
    return Function("loaded", [z, u], [ca.densify(expression) for expression in (end, rows, below)])
