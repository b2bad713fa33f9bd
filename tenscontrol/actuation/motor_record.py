"""Record of the motors of winches and cables during a run: what they turn, hold and do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tenscontrol.actuation.motors import EachMotor
from tenscontrol.arrays import FloatArray, IntArray, freeze_arrays
from tenscontrol.dynamics.evaluator import evaluate_columns
from tenscontrol.dynamics.model import Model
from tenscontrol.short_repr import short_repr

# Parts of an interval in which a string goes slack or taut.
_PARTS = 32


@dataclass(frozen=True, eq=False)
class MotorRecord:
    """Angle, speed, torque, power and energy of the motors during a run.

    Attributes
    ----------
    time : ndarray, shape (T,)
        s, those of the run.
    angle, speed : ndarray, shape (α, T)
        Of the motors, rad and rad/s, positive where they wind in; the speed is that of the step
        to each time. Where rest lengths jump at the start of a sample, it is that of the jump
        spread over the sample.
    torque, power : ndarray, shape (α, T)
        N m, positive against the tension, and torque times speed, W. A torque is never above its
        limit: what is missing gives the brake.
    energy : ndarray, shape (α, T)
        J, given by each motor since the start of this run: the integral of its power, with the
        work of jumps. Without damping and brakes their sum is the change of the energy of the run,
        and of that of the rotors, ½ J ω².
    energy_error : float
        Estimate of the error of the energy, J, from its quadrature between the times: two of fourth
        order are compared. A shorter ``output_step`` makes it smaller. 0 where γ is held.
    angle_command : ndarray, shape (α, K), or None
        What each command asks for as an angle, rad; None where γ is held.
    torque_limited : ndarray of int, shape (K,)
        Number of motors that met their limit of torque in each sample.
    zero : ndarray, shape (α,)
        Rest length, m, at which the angle is zero; length of the string where γ is held.
    at_end : ndarray, shape (3, α)
        Rest length without play, m, its rate, m/s, and the rest length that the motors follow, m,
        at the end: a run goes on from there.
    rest_length_error : float
        Estimate of the largest error of a rest length, m, that comes from following torque, lag,
        inertia and play in the parts of a sample; more ``substeps`` make it smaller. It is found
        along the motion that there was, whose own errors are in ``run.position_error``. 0 where γ
        is held or rest lengths jump.
    """

    time: FloatArray
    angle: FloatArray
    speed: FloatArray
    torque: FloatArray
    power: FloatArray
    energy: FloatArray
    energy_error: float
    angle_command: FloatArray | None
    torque_limited: np.ndarray
    zero: FloatArray
    at_end: FloatArray
    rest_length_error: float

    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze_arrays(self)


class Instants(NamedTuple):
    """One place of each interval between states that are kept: T of them."""

    time: FloatArray  # s, (T,)
    states: FloatArray  # positions, then velocities, of all nodes, node by node, (2 d n, T)
    inputs: FloatArray  # of the strings of the model, and their first two rates, (3, α′, T)


class Turning(NamedTuple):
    """Motors at instants, as lengths that they let out, shape (α, T) each."""

    position: FloatArray  # m
    rate: FloatArray  # m/s
    acceleration: FloatArray  # m/s²
    force: FloatArray  # of the string, as far as it reaches the motor, N


def cable_work(model: Model, ends: tuple[Instants, Instants]) -> tuple[list[Turning], FloatArray]:
    """Return motors at both ends of intervals, and the work of each, J, where γ is held.

    What a cable is let out by is its length. The work of a force density is exact.
    """
    turning = []
    for end in ends:
        length, rate = evaluate_columns(model.of_all_nodes("string_motion"), end.states)
        turning.append(Turning(length, rate, np.zeros_like(rate), end.inputs[0] * length))
    before, after = (motion.position for motion in turning)
    return turning, ends[0].inputs[0] * (before**2 - after**2) / 2


def winding_work(
    model: Model,
    ends: tuple[Instants, Instants],
    motion: Callable[[FloatArray, IntArray], Instants],
) -> tuple[list[FloatArray], list[FloatArray], FloatArray, float]:
    """Return stored energy, J, and force, N, at both ends of intervals, work, J, and its error, J.

    All but the error for each string of the model, shape (α′, T). ``motion`` is that at shares of
    intervals. Of two quadratures of order 4, Simpson's and the corrected trapezoid, the work is
    the mean in which the leading errors cancel, the error their difference. Where a string goes
    slack or taut, an interval is cut into many.
    """
    winding, count = model.of_all_nodes("winding"), len(ends[0].time)
    middle = motion(np.full(count, 0.5), np.arange(count))
    stored, forces, powers, slopes = [], [], [], []
    for instants in (ends[0], middle, ends[1]):
        lengths, rates, accelerations = instants.inputs
        energy, force, change, *_ = evaluate_columns(winding, instants.states, lengths, rates)
        stored.append(energy)
        forces.append(force)
        powers.append(-force * rates)
        slopes.append(-change * rates - force * accelerations)
    time = ends[1].time - ends[0].time
    trapezoid = time * (powers[0] + powers[2]) / 2 + time**2 * (slopes[0] - slopes[2]) / 12
    simpson = time * (powers[0] + 4 * powers[1] + powers[2]) / 6
    work, error = (4 * simpson + trapezoid) / 5, np.abs(simpson - trapezoid)
    taut = [force > 0 for force in forces]
    switches = ((taut[0] != taut[1]) | (taut[0] != taut[2])) & (powers[0] + powers[2] != 0)
    cut = np.flatnonzero(switches.any(axis=0))
    if len(cut):
        shares = np.repeat((np.arange(_PARTS) + 0.5) / _PARTS, len(cut))
        many = motion(shares, np.tile(cut, _PARTS))
        lengths, rates, _ = many.inputs
        power = -evaluate_columns(winding, many.states, lengths, rates)[1] * rates
        finer = time[cut] * power.reshape(len(power), _PARTS, -1).mean(axis=1)
        of = switches[:, cut]
        error[:, cut] = np.where(of, np.abs(finer - work[:, cut]) / _PARTS, error[:, cut])
        work[:, cut] = np.where(of, finer, work[:, cut])
    return stored[::2], forces[::2], work, float(error.sum())


def motor_record(
    motor: EachMotor,
    zero: FloatArray,
    ends: tuple[Instants, Instants],
    turning: list[Turning],
    work: FloatArray,
    error: float,
    asked: list[FloatArray],
    weak: list[int],
    at_end: FloatArray,
    rest_length_error: float,
) -> MotorRecord:
    """Return the record of motors, given the work on strings in each interval, J, shape (α, T).

    ``asked`` are the rest lengths of commands, m, ``weak`` how many motors met their torque.
    """
    lever, most, inertia = (column[:, None] for column in motor[:3])
    zero = np.where(np.isnan(motor.zero), zero, motor.zero)
    braked, torques, speeds = np.zeros(work.shape, dtype=bool), [], []
    for motion in turning:
        torque = motion.force * lever - inertia * motion.acceleration / lever
        braked |= np.abs(torque) > most
        torques.append(np.clip(torque, -most, most))
        speeds.append(-motion.rate / lever)
    power = [torque * speed for torque, speed in zip(torques, speeds, strict=True)]
    given = work + inertia / 2 * (speeds[1] ** 2 - speeds[0] ** 2)
    # Where a brake helps, what is left to the motor.
    given = np.where(braked, (ends[1].time - ends[0].time) * (power[0] + power[1]) / 2, given)
    return MotorRecord(
        time=ends[1].time,
        angle=(zero[:, None] - turning[1].position) / lever,
        speed=speeds[1],
        torque=torques[1],
        power=power[1],
        energy=np.cumsum(given, axis=1),
        energy_error=error,
        angle_command=(zero[:, None] - np.column_stack(asked)) / lever if asked else None,
        torque_limited=np.array(weak),
        zero=zero,
        at_end=at_end,
        rest_length_error=rest_length_error,
    )
