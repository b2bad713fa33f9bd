"""Gain schedule: several controllers, each used near the shape that it was designed at."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from tenscontrol.control.command import Command
from tenscontrol.control.controller import Controller
from tenscontrol.plant import Modes
from tenscontrol.status import Status
from tenscontrol.structure import different_members
from tenscontrol.validation import FloatArray, instance


@final
class GainSchedule(Controller):
    """Several controllers, each designed at one shape; that of the nearest shape commands.

    A linear plant is accurate near its operating point only. For a large change of shape, take
    several plants along the path and design a controller for each.

    The schedule counts its own commands in ``status_count`` and ``fallback_count``; each
    controller counts those that it gave.

    Parameters
    ----------
    controllers : sequence of Controller
        Of one structure, with the same input and sample time. If they follow a
        reference, it should be the same one.

    Raises
    ------
    TypeError, ValueError
        If there is none, one is no controller, or they do not fit together.

    Notes
    -----
    The distance of shapes is ``|q|``, weighted by mass, without rigid-body motion. At a
    switch the previous input is handed over, so that limits of change hold; an
    estimated load is not.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=1000.0))
    >>> start = tc.prestress(tc.prism(), force_density=17.3205)
    >>> low = tc.Height(0.7, top=[0, 1, 2], bottom=[3, 4, 5])
    >>> goal = tc.shape_target(model, low, force_density=17.3205)
    >>> path = tc.shape_path(model, start, goal, duration=3.0)
    >>> mpc = tc.GainSchedule([
    ...     tc.MPC(plant, horizon=10, sample_time=0.02, reference=path.reference())
    ...     for plant in path.plants(3, input="rest_length")
    ... ])
    >>> command = mpc.command(3.0, goal.nodes, np.zeros((3, 6)))
    >>> str(command), mpc.active
    ('ok', 2)
    """

    def __init__(self, controllers: Sequence[Controller]) -> None:
        given: Any = controllers
        if not isinstance(given, Sequence) or isinstance(given, str):
            raise TypeError(
                f"controllers is a {type(given).__name__}, expected a sequence of controllers"
            )
        if not given:
            raise ValueError("controllers is empty, expected at least one controller")
        for i, each in enumerate(given):
            instance(f"controllers[{i}]", each, Controller, "make one by LQR(...) or MPC(...)")
            _refuse_other(f"controllers[{i}]", each, given[0])
        lows, highs = zip(*(each.bounds for each in given), strict=True)
        first = given[0]
        super().__init__(
            first.plant, first.sample_time, np.min(lows, axis=0), np.max(highs, axis=0)
        )
        self._controllers: tuple[Controller, ...] = tuple(given)
        self.reset()

    @property
    def controllers(self) -> tuple[Controller, ...]:
        """All of them."""
        return self._controllers

    @property
    def active(self) -> int:
        """Which of them gave the last command."""
        return self._active

    @property
    def made_with(self) -> dict[str, Any]:
        """See :attr:`Controller.made_with`: with those of all controllers."""
        return super().made_with | {"controllers": [each.made_with for each in self._controllers]}

    @property
    def left_alone(self) -> Modes:
        """See :attr:`Controller.left_alone`: those of the controller that gave the last command."""
        return self._controllers[self._active].left_alone

    @property
    def prediction_error(self) -> float | None:
        """See :attr:`Controller.prediction_error`: that of the controller in use."""
        return self._controllers[self._active].prediction_error

    def reference_nodes(self, times: FloatArray) -> FloatArray | None:
        """See :meth:`Controller.reference_nodes`: those of the first one."""
        return self._controllers[0].reference_nodes(times)

    def reset(self) -> None:
        """Reset all controllers."""
        super().reset()
        for each in self._controllers:
            each.reset()
        self._active = 0

    def applied(self, value: object) -> None:
        """See :meth:`Controller.applied`."""
        super().applied(value)
        self._controllers[self._active].applied(value)

    def take_over(self, command: object) -> None:
        """See :meth:`Controller.take_over`."""
        super().take_over(command)
        self._controllers[self._active].take_over(command)

    def _measure(
        self, nodes: FloatArray, velocities: FloatArray
    ) -> tuple[FloatArray, Status | None]:
        # Each controller measures for itself: coordinates of one plant do not reach everywhere.
        return np.stack([nodes, velocities]), self._measurement_check.fault(nodes, velocities)

    def _decide(self, time: float, state: FloatArray) -> Command:
        r = self.plant.degrees_of_freedom
        N, V = state
        distance = [np.linalg.norm(each.plant.measure(N, V)[:r]) for each in self._controllers]
        nearest = int(np.argmin(distance))
        if nearest != self._active and self._previous_input is not None:
            self._controllers[nearest].take_over(self._previous_input)
        self._active = nearest
        return self._controllers[nearest].command(time, N, V)

    def _fall_back(self, status: Status) -> Command:
        return self._controllers[self._active].fall_back(status)

    def __repr__(self) -> str:
        return f"GainSchedule({len(self._controllers)} controllers, {self._controllers[0]!r} ...)"


def _refuse_other(name: str, one: Controller, first: Controller) -> None:
    """Raise if a controller does not fit the first one."""
    for what in ("input", "sample_time"):
        found, expected = getattr(one, what), getattr(first, what)
        if found != expected:
            raise ValueError(
                f"{name} has {what} {found!r}, expected {expected!r}, that of the first"
            )
    ours, theirs = one.plant.commanded, first.plant.commanded
    different = different_members(ours, theirs)
    if different:
        raise ValueError(
            f"{name} was designed on {ours!r}, but the first on {theirs!r} with {different}"
        )
    if one.plant.degrees_of_freedom != first.plant.degrees_of_freedom:
        raise ValueError(
            f"{name} was designed in {one.plant.degrees_of_freedom} coordinates, expected "
            f"{first.plant.degrees_of_freedom}, as many as the first"
        )
