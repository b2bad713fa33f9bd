"""Record of a closed loop, sample by sample."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.properties import cached_property
from tenscontrol.simulation.arguments import Arguments
from tenscontrol.simulation.error_growth import ErrorGrowth, error_growth
from tenscontrol.status import UNSOLVED, Status
from tenscontrol.tables import percent

if TYPE_CHECKING:
    from tenscontrol.actuation.driven_strings import Actuation
    from tenscontrol.actuation.motor_record import MotorRecord
    from tenscontrol.control.command import Fallback
    from tenscontrol.simulation.observation import EstimateRecord

# A run ends away from its reference: by this part of the size, with errors in the last third above
# this part of those before, if it lasts so many radians of the slowest vibration. Or
# by the fourth, and so many times the error at the start.
_AWAY, _FALLING, _TURNED, _LOST, _WORSE = 0.02, 0.9, 4 * np.pi, 0.2, 1.2

# More programs not solved than this are worth a warning.
_UNSOLVED_SHARE = 0.05


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
    settings : Arguments
        Kind and settings of the controller by name.
    actuation : Actuation or None
        Which strings of the controller are driven, and by which of its inputs; None in files of
        earlier versions.
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
    settings: Arguments = field(default_factory=Arguments)
    actuation: Actuation | None = None

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {status}" for status, count in self.status_count.items())
        return f"ControlRecord({self.controller}, {len(self.time)} samples: {counts})"

    @property
    def unsolved(self) -> float:
        """Fraction of the samples whose program was not solved."""
        return sum(status in UNSOLVED for status in self.status) / len(self.status)

    @cached_property
    def growth(self) -> ErrorGrowth | None:
        """When the tracking error begins to grow exponentially, and how fast; None if it does not.

        It is seen after seven windows of three samples or more, long before the end is far off.
        """
        error = self.tracking_error
        if error is None or self.size is None or len(self.time) < 2:
            return None
        times = np.append(self.time, 2 * self.time[-1] - self.time[-2])
        return error_growth(times, error, self.size)

    @property
    def problems(self) -> list[str]:
        """A sentence for what went wrong; empty where the run did what was asked.

        The run ends away from the reference: by more than 2 % of the size in its last tenth, with
        errors in the last third of more than 0.9 of the largest of those in the second, after two
        turns of the slowest vibration of the plant. Or by more than a fifth of the size, and 1.2
        times as far as it began. Its error grows from sample to sample: see :attr:`growth`.
        Programs were not solved: more than one in twenty.
        """
        reasons, error = [], self.tracking_error
        if error is not None and self.size is not None and self.slowest_vibration is not None:
            off = error / self.size
            end = float(off[-max(1, len(off) // 10) :].max())
            third = max(1, len(off) // 3)
            long = float(self.time[-1] - self.time[0]) * self.slowest_vibration > _TURNED
            stays = long and off[-third:].max() > _FALLING * off[-2 * third :].max()
            if (end > _AWAY and stays) or end > max(_LOST, _WORSE * float(off[0])):
                reasons.append(
                    f"it ends up to {end * self.size:.2g} m from its reference, {percent(end)} "
                    "of the size, and comes no nearer"
                )
        if (growth := self.growth) is not None:
            reasons.append(
                f"from {growth.begin:.3g} s on its error grows by a factor e in "
                f"{growth.time_constant:.2g} s: the closed loop is unstable"
            )
        if self.unsolved > _UNSOLVED_SHARE:
            worst = Counter(status for status in self.status if status in UNSOLVED).most_common(1)
            reasons.append(
                f"{percent(self.unsolved)} of the programs were not solved, most of them "
                f"{worst[0][0]}"
            )
        return reasons

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
        >>> plant = tc.linearize(model, tc.prestress(prism, 10.0), input="rest_length")
        >>> start = plant.to_nodes([0.02] * 9)
        >>> mpc = tc.MPC(plant, horizon=10, sample_time=0.02)
        >>> run = tc.simulate(model, 3.0, start, controller=mpc, step=1e-3)
        >>> print(run.control.summary())  # doctest: +ELLIPSIS
        controller        MPC(... horizon 10, sample time 0.02 s, ...)
        samples           150 of 0.02 s: 150 ok
        tracking error    0.003... m at the end, 0.01... m rms (0.3... % and 1.1... % of the size)
        prediction error  ...e-05 m rms, 0.000... m at most
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
            lines.append(f"not solved        {percent(self.unsolved)} of the samples")
        if self.tracking_error is not None and self.size is not None:
            end, rms = float(self.tracking_error[-1]), _rms(self.tracking_error)
            lines.append(
                f"tracking error    {end:.2g} m at the end, {rms:.2g} m rms "
                f"({percent(end / self.size)} and {percent(rms / self.size)} of the size)"
            )
        if self.prediction_error is not None and np.isfinite(self.prediction_error).any():
            off = self.prediction_error[np.isfinite(self.prediction_error)]
            lines.append(f"prediction error  {_rms(off):.2g} m rms, {off.max():.2g} m at most")
        if self.at_bound is not None:
            share = np.count_nonzero(self.at_bound) / len(self.at_bound)
            lines.append(f"at a bound        {percent(share)} of the samples")
        slow, out = (int((counts > 0).sum()) for counts in (self.rate_limited, self.range_limited))
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
            lines[-1] += f": {percent(worst / self.sample_time)} of a sample"
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
