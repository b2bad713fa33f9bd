"""Figures that tell whether to trust a motion, and limits on them."""

from __future__ import annotations

from dataclasses import dataclass, fields

from tenscontrol.integrate import Work
from tenscontrol.validation import choice, positive_number


class AccuracyWarning(RuntimeWarning):
    """A motion that is not accurate."""


@dataclass(frozen=True)
class Health:
    """Figures that tell whether to trust a motion. Made by :attr:`Trajectory.health`.

    Attributes
    ----------
    energy_error : float or None
        Largest change of the energy since the start, as part of the largest
        kinetic energy; what cut strings stored is allowed for. None where the
        energy may change: strings are damped, or a controller acts.
    momentum_change, angular_momentum_change : float or None
        Largest change, as part of the largest momentum that the kinetic energy
        could give; None where supports or loads may change it.
    bar_length_error : float
        Largest change of the length of a bar, as part of its length.
    position_error : float or None
        Estimate of the error of the nodes at the end, as part of the size of
        the structure: see :attr:`Trajectory.position_error`.
    work : Work
        Steps, rejections, evaluations and switches.
    """

    energy_error: float | None
    momentum_change: float | None
    angular_momentum_change: float | None
    bar_length_error: float
    position_error: float | None
    work: Work


@dataclass(frozen=True)
class HealthLimits:
    """Limits on the figures of :class:`Health`; None for no limit.

    Parameters
    ----------
    energy_error : float, optional
        As part of the largest kinetic energy.
    momentum_change, angular_momentum_change : float, optional
        As part of the largest momentum that the kinetic energy could give.
    bar_length_error : float, optional
        As part of the length.
    position_error : float, optional
        As part of the size of the structure.
    steps, evaluations, switches : float, optional
        Counts.
    action : {"warn", "raise"}
        What happens where a limit is passed: an :class:`AccuracyWarning`, or a
        :class:`SimulationError` that carries the motion.

    Raises
    ------
    TypeError, ValueError
        If a limit is not positive, or ``action`` is another word.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> model = tc.Model(tc.prism())
    >>> limits = tc.HealthLimits(bar_length_error=1e-9, action="raise")
    >>> run = tc.simulate(model, 1.0, force_density=[17.3205] * 6 + [9.0] * 3, limits=limits)
    >>> run.health.bar_length_error < 1e-9
    True
    """

    energy_error: float | None = 0.05
    momentum_change: float | None = None
    angular_momentum_change: float | None = None
    bar_length_error: float | None = 1e-3
    position_error: float | None = 0.1
    steps: float | None = None
    evaluations: float | None = None
    switches: float | None = None
    action: str = "warn"

    def __post_init__(self) -> None:
        choice("action", self.action, ("warn", "raise"))
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "action" and value is not None:
                positive_number(field.name, value, "a limit; None for none")

    def passed(self, health: Health) -> list[str]:
        """Return a sentence for each limit that is passed.

        Parameters
        ----------
        health : Health

        Returns
        -------
        list of str
        """
        found = []
        for field in fields(self):
            limit = getattr(self, field.name)
            if field.name == "action" or limit is None:
                continue
            source = health if hasattr(health, field.name) else health.work
            value = getattr(source, field.name)
            if value is not None and value > limit:
                what = field.name.replace("_", " ")
                found.append(f"{what} {value:.2g} is above its limit {limit:g}")
        return found
