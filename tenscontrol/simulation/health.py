"""Figures that tell whether to trust a motion, limits on them, and what they are evaluated from."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from tenscontrol.dynamics import Model, evaluate_columns
from tenscontrol.integrate import Work
from tenscontrol.validation import FloatArray, choice, instance, positive_number

# Limits on what is no error of the integration, and what to do.
_PHYSICAL = {
    "penetration": ", as part of the size: give the ground more stiffness",
    "fall": " sizes below z = 0: Model(..., ground=Ground(...)) would stop it",
}


class AccuracyWarning(RuntimeWarning):
    """A motion that is not accurate, or probably not what was meant."""


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
        Estimate of the error of the nodes at the end, as part of the size of
        the structure: see :attr:`Trajectory.position_error`.
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
    """

    energy_error: float | None
    momentum_change: float | None
    angular_momentum_change: float | None
    bar_length_error: float
    position_error: float | None
    work: Work
    penetration: float | None = None
    damping_work: float | None = None
    friction_work: float | None = None
    impulse: float | None = None
    impulse_error: float | None = None
    fall: float | None = None


@dataclass(frozen=True)
class HealthLimits:
    """Limits on the accuracy figures of a run (:class:`Health`); None for no limit.

    Parameters
    ----------
    energy_error : float, optional
        As part of the largest kinetic energy.
    momentum_change, angular_momentum_change, impulse_error : float, optional
        As part of the largest momentum that the kinetic energy could give.
    bar_length_error : float, optional
        As part of the length.
    position_error, penetration, fall : float, optional
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
    penetration: float | None = 0.25
    fall: float | None = None
    impulse_error: float | None = None

    def __post_init__(self) -> None:
        choice("action", self.action, ("warn", "raise"))
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "action" and value is not None:
                positive_number(field.name, value, "a limit; None for none")

    @property
    def names(self) -> list[str]:
        """Names of the figures that have a limit."""
        values = vars(self)
        return [name for name in values if name != "action" and values[name] is not None]

    def passed(self, health: Health) -> list[str]:
        """Return a sentence for each limit that is passed.

        Parameters
        ----------
        health : Health

        Returns
        -------
        list of str
        """
        instance("health", health, Health, "health of a trajectory")
        found = []
        for field in fields(self):
            limit = getattr(self, field.name)
            if field.name == "action" or limit is None:
                continue
            source = health if hasattr(health, field.name) else health.work
            value = getattr(source, field.name)
            if value is not None and value > limit:
                what = field.name.replace("_", " ")
                why = _PHYSICAL.get(field.name, "")
                found.append(f"{what} {value:.2g} is above its limit {limit:g}{why}")
        return found


# Times at which functions of the model are evaluated in one go: few enough that what they need of a
# large structure stays small.
BLOCK = 128


@dataclass(frozen=True, eq=False)
class Quantities:
    """What energies, momenta and force densities of a motion are evaluated from, when asked for.

    Attributes
    ----------
    model : Model
    moved : bool
        Whether supports move: functions are then those of all nodes.
    inputs : ndarray, shape (α, T)
        Rest lengths or force densities.
    load : ndarray, shape (d, n), or (d n, T) where it changes, node by node; or None
        N.
    stored : ndarray, shape (T,), or None
        What the ground stores, J.
    """

    model: Model
    moved: bool
    inputs: FloatArray
    load: FloatArray | None = None
    stored: FloatArray | None = None

    def of(
        self, name: str, nodes: FloatArray, velocities: FloatArray, *more: FloatArray
    ) -> list[FloatArray]:
        """Return a function of the model at all times, read-only: one array an output."""
        model, count = self.model, nodes.shape[2]
        every = self.moved or not len(model.structure.fixed_rows)
        rows = slice(None) if every else model.structure.free_rows
        function = model.of_all_nodes(name) if self.moved else getattr(model, name)

        def within(first: int) -> list[FloatArray]:
            some = slice(first, first + BLOCK)
            moving = [by_node(part[:, :, some])[rows] for part in (nodes, velocities)]
            return evaluate_columns(function, np.vstack(moving), *(each[:, some] for each in more))

        parts = zip(*(within(first) for first in range(0, count, BLOCK)), strict=True)
        return [read_only(np.hstack(part)) for part in parts]


def by_node(part: FloatArray) -> FloatArray:
    """Return shape (d n, T), node by node, of (d, n, T)."""
    return part.swapaxes(0, 1).reshape(-1, part.shape[2])


def read_only(array: FloatArray) -> FloatArray:
    """Return an array that is not to be written to."""
    array.setflags(write=False)
    return array
