"""Stability of a law in force densities if winches hold the rest lengths between samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.plant.controllability import reached_states
from tenscontrol.plant.linear_plant import LinearPlant, refuse_driven_bars
from tenscontrol.plant.linearize import OperatingPoint, linearize
from tenscontrol.plant.string_outputs import (
    StringMap,
    string_map,
    to_commanded_strings,
    to_model_strings,
)
from tenscontrol.warn import warn

# A loop that settles slower than this fraction of its design no longer follows: see
# tests/control/test_held_loop.py, with nonlinear runs on both sides of the limit.
SLOWEST = 0.25

# A spectral radius this close to 1 tells nothing of the rate.
_ROUND_OFF = 1e-13


@dataclass(frozen=True, eq=False)
class HeldLoop:
    """Stability of a loop with rest lengths held between samples. Made by :func:`held_loop`.

    Attributes
    ----------
    radius : float
        Spectral radius of the sampled loop with rest lengths held.
    designed_radius : float
        That radius with γ held, as the law was designed, no unit.
    """

    radius: float
    designed_radius: float

    @property
    def rate_ratio(self) -> float:
        """Rate at which the loop settles, relative to its design; negative if it is unstable."""
        return float(np.log(self.radius) / np.log(self.designed_radius))

    @property
    def holds(self) -> bool:
        """Whether the loop is stable and settles at a quarter of the designed rate or faster."""
        return self.rate_ratio >= SLOWEST


def held_loop(plant: LinearPlant, gain: object, *, sample_time: float) -> HeldLoop:
    """Return the stability of a sampled law in γ if winches hold rest lengths between samples.

    At each sample the desired ``γ₀ − K z`` is converted to rest lengths at the measured
    shape. These are held until the next sample, so that γ moves with the structure:
    ``z⁺ = Φ z + Γ L (−K z − G z)`` with Φ and Γ of the plant whose input is the rest length,
    G the change of γ with the shape and L that of the rest length with γ. Modes that no string
    reaches are left out.

    Parameters
    ----------
    plant : LinearPlant
        With ``input="force_density"``, of a model with a string law.
    gain : array_like, shape (α, 2r)
        K, for example that of :class:`LQR`.
    sample_time : float
        Sample time, s.

    Returns
    -------
    HeldLoop

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, the plant has another input or its model no string law.

    Examples
    --------
    The γ of stiff strings departs from the desired one long before the next sample:

    >>> import tenscontrol as tc
    >>> from tenscontrol.control import held_loop
    >>> prism = tc.prism()
    >>> for stiffness in (1e2, 1e4):
    ...     model = tc.Model(prism, strings=tc.LinearStrings(stiffness))
    ...     plant = tc.linearize(model, tc.prestress(prism, force_density=10.0))
    ...     Q, R = tc.energy_weights(plant)
    ...     law = tc.LQR(plant, Q, 0.1 * R, sample_time=0.02)
    ...     print(held_loop(plant, law.gain, sample_time=law.sample_time).holds)
    True
    False
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    refuse_driven_bars(plant, "held_loop")
    sample_time = validation.positive_number("sample_time", sample_time, "s")
    if plant.input != "force_density" or plant.model.strings is None:
        raise ValueError(
            f"plant has input={plant.input!r} and its model "
            f"{'no' if plant.model.strings is None else 'a'} string law; expected "
            "input='force_density' and Model(structure, strings=...)"
        )
    if not plant.actuation.is_whole:
        raise ValueError(
            f"plant has {plant.actuation!r}: passive strings that hold rest lengths have no γ that "
            "stays. Linearize with input='rest_length', or with all strings driven"
        )
    count, states = plant.B.shape[1], len(plant.A)
    K = validation.shaped("gain", gain, (count, states), "one row per string, one column per state")
    held, strings = plant.prepared.get("held rest lengths", lambda: _with_held_lengths(plant))
    by_shape = strings.gamma_by_state.copy()
    by_shape[:, states // 2 :] = 0.0  # the conversion ignores rates
    by_length = strings.gamma_by_input.diagonal()[:, None]
    change = to_model_strings(plant, "force_density", -K.T).T - by_shape
    length_gain = to_commanded_strings(plant, "rest_length", (change / by_length).T).T
    transition, input_matrix, _ = held.discretize(sample_time)
    designed_transition, designed_input, _ = plant.discretize(sample_time)
    reached = reached_states(plant)
    # Either loop keeps what strings reach; what they do not reach never settles.
    inside, unit = reached.basis[:, : reached.count], reached.unit
    loops = (
        inside.T @ (loop * unit / unit[:, None]) @ inside
        for loop in (
            transition + input_matrix @ length_gain,
            designed_transition - designed_input @ K,
        )
    )
    radius, designed = (float(np.abs(np.linalg.eigvals(loop)).max()) for loop in loops)
    if abs(1 - designed) <= _ROUND_OFF:
        raise ValueError(
            f"sample_time is {sample_time:g} s, in which the loop as designed neither decays nor "
            "grows by more than round-off: give a longer one, or a gain that damps"
        )
    return HeldLoop(radius, designed)


def _with_held_lengths(plant: LinearPlant) -> tuple[LinearPlant, StringMap]:
    """Return the plant with rest lengths as its input, and the map of its model's strings."""
    of_model = plant
    if plant.commanded is not plant.model.structure:
        gamma = to_model_strings(plant, "force_density", plant.force_density)
        point = OperatingPoint(plant.nodes, gamma, plant.external_force)
        kind = plant.coordinates.kind
        of_model = linearize(plant.model, point, coordinates=kind, require_equilibrium=False)
    strings = string_map(of_model, "rest_length")
    spread = to_model_strings(plant, "rest_length", np.eye(plant.B.shape[1])).T
    A = plant.A + of_model.B @ strings.gamma_by_state
    return replace(plant, A=A, B=of_model.B @ strings.gamma_by_input @ spread), strings


def warn_of_held_lengths(plant: LinearPlant, gain: FloatArray, sample_time: float) -> None:
    """Warn the caller of the caller if a law in γ fails with rest lengths held."""
    loop = held_loop(plant, gain, sample_time=sample_time)
    if loop.holds:
        return
    fault = (
        "the loop is unstable"
        if loop.radius >= 1
        else f"the loop settles at {100 * loop.rate_ratio:.0f} % of the rate it was designed for"
    )
    _warn(sample_time, f"undo a commanded γ: {fault}. Linearize with input='rest_length'")


def held_error_rate(
    plant: LinearPlant, matrix: FloatArray, rates: tuple[float, float], sample_time: float
) -> float:
    """Return the decay rate of tracked errors with rest lengths held, relative to the design.

    Over a sample γ grows with the strings' lengths by ``∂γ/∂q q̇ t``. To first order in the
    sample time h that is a damping ``D = −h/2 J ∂γ/∂y`` beside a, with ``J = ∂ÿ/∂γ``; the rate is
    that of the slowest root of ``s² + (a + D) s + b``. ``matrix`` is C, shape (p, d n), of what is
    tracked, and ``rates`` are a, 1/s, and b, 1/s².
    """
    r, (a, b) = plant.degrees_of_freedom, rates
    moved = matrix @ plant.basis
    spread = to_model_strings(plant, "force_density", np.eye(plant.B.shape[1])).T
    # The mean over the segments of a string, whose γ are alike.
    gather = np.linalg.pinv(spread)
    by_shape = gather @ string_map(plant, "rest_length").gamma_by_state[:, :r]
    D = -0.5 * sample_time * moved @ plant.B[r:] @ by_shape @ np.linalg.pinv(moved)
    damping = a + max(0.0, float(np.linalg.eigvals(D).real.max()))
    held, designed = (-np.roots([1.0, coefficient, b]).real.max() for coefficient in (damping, a))
    return float(held / designed)


def warn_of_slow_errors(
    plant: LinearPlant, matrix: FloatArray, rates: tuple[float, float], sample_time: float
) -> None:
    """Warn the caller of the caller if tracked errors would decay too slowly."""
    ratio = held_error_rate(plant, matrix, rates, sample_time)
    if ratio >= SLOWEST:
        return
    _warn(
        sample_time,
        f"act as dampers: errors decay at {100 * ratio:.0f} % of the rate asked for. Raise the "
        "frequency or shorten the step, or use MPC with input='rest_length'",
    )


def _warn(sample_time: float, effect: str) -> None:
    warn(
        f"where winches hold rest lengths between samples of {sample_time:g} s, strings this "
        f"stiff {effect}; if the actuators hold forces, build the model without a string law",
        RuntimeWarning,
    )
