"""Accuracy figures of a motion, with limits on them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from tenscontrol import validation
from tenscontrol.integrate.integrator import Work
from tenscontrol.properties import cached_property
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.bar_clearance import BarClearance, BarCrossing

if TYPE_CHECKING:
    from tenscontrol.sizing.sections import Sections

# The error, as part of the size, up to which a motion is trusted unless the user says otherwise.
ERROR_LIMIT = 0.01

# What goes with the limits, and is none on a figure of `Health`.
_BESIDE = ("action", "sections", "margin")

# Limits on what is no error of the integration, and what to do.
_PHYSICAL = {
    "penetration": ", as part of the size: give the ground more stiffness",
    "fall": " sizes below z = 0: Model(..., ground=Ground(...)) would stop it",
    "rest_length_error": ", as part of the size: the motors are followed in too few parts of a "
    "sample. Give Winches(ramp=True, substeps=...) more",
}


class AccuracyWarning(RuntimeWarning):
    """A motion that is not accurate, or probably not what was meant."""


class BarCrossingWarning(RuntimeWarning):
    """Bars pass through each other, which the model lets them do and real ones cannot."""


class StrengthWarning(RuntimeWarning):
    """A member that yields or buckles, which the model lets it bear and a real one cannot."""


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

    __repr__ = short_repr


@dataclass(frozen=True)
class HealthLimits:
    """Limits on the accuracy figures of a run (:class:`Health`); None or inf for no limit.

    With ``sections``, the forces of members are limited too, by their strength.

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
        :class:`BarCrossingWarning`, of members a :class:`StrengthWarning`, or a
        :class:`SimulationError` that carries the motion.
    sections : Sections, optional
        What the members of the run are made of: their margins of yield and buckling are looked
        at, see :func:`strength`. Not with supports that move.
    margin : float
        Least margin of a member, with ``sections``: 1 where it would just fail.

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
    sections: Sections | None = None
    margin: float = 1.0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        validation.choice("action", self.action, ("warn", "raise"))
        if self.sections is not None:
            from tenscontrol.sizing.sections import Sections

            how = "make them by sections(...) or design(...)"
            validation.instance("sections", self.sections, Sections, how)
        put = object.__setattr__  # the dataclass is frozen for everyone else
        put(self, "margin", validation.positive_number("margin", self.margin, "times the force"))
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.name in _BESIDE:
                continue
            if validation.is_unlimited(value):
                put(self, entry.name, None)
            elif entry.name == "crossings":
                validation.whole_number(entry.name, value, 0)
            else:
                validation.positive_number(entry.name, value, "a limit; None or inf for none")

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the figures that have a limit."""
        return tuple(self._limits)

    @cached_property
    def _limits(self) -> dict[str, Any]:
        """The limits that there are, by the names of their figures."""
        named = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {k: v for k, v in named.items() if k not in _BESIDE and v is not None}

    def passed(self, health: Health) -> dict[str, str]:
        """Return a sentence for each limit that is passed, by its name.

        Parameters
        ----------
        health : Health

        Returns
        -------
        dict of str to str
        """
        validation.instance("health", health, Health, "health of a trajectory")
        sentences: dict[str, str] = {}
        values = vars(health.work) | vars(health)
        for name, limit in self._limits.items():
            if name == "crossings":
                if len(health.crossings or ()) > limit:
                    sentences[name] = _passing(health.crossings or ())
                continue
            value = values[name]
            if value is not None and value > limit:
                label = name.replace("_", " ")
                why = _PHYSICAL.get(name, "")
                if name == "position_error":
                    why = f" of the size from {health.trusted_until:.4g} s on"
                sentences[name] = f"{label} {value:.2g} is above its limit {limit:g}{why}"
        return sentences


def _passing(crossings: tuple[BarCrossing, ...]) -> str:
    """Return the sentence on bars that pass through each other."""
    (i, j), more = crossings[0].bars, len(crossings) - 1
    rest = f", and {more} more such crossing{'s' * (more > 1)} up to {crossings[-1].time:.4g} s"
    return (
        f"bars {i} and {j} pass through each other at {crossings[0].time:.4g} s"
        f"{rest * (more > 0)}, which real bars cannot. Hold other inputs, keep bars apart by "
        "clearance(...) in MPC, or accept it by HealthLimits(crossings=None)"
    )
