"""What actuators make of commands."""

from __future__ import annotations

import numpy as np

from tenscontrol.actuation import Winches, WinchMove
from tenscontrol.control.controller import Command, Controller
from tenscontrol.dynamics import StringLaw
from tenscontrol.simulation.loop import Loop
from tenscontrol.simulation.wiring import Wiring
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    frozen,
    instance,
    non_negative,
    positive,
    shaped,
)

_NONE = frozen(np.zeros(0, dtype=np.int64))


class Actuators:
    """Turn commands into what is held: γ as it is, or rest lengths through the winches.

    Parameters
    ----------
    loop : Loop
        Says what is held.
    controller : Controller
    winches : Winches or None
    rest_length : float or array_like, shape (α,), or None
        Where the winches stand at the start, m.
    sample : float
        Sample time, s.

    Attributes
    ----------
    start : ndarray, shape (α,), or None
        Where the winches stand at the start, m; None where that is not known.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or the commands cannot be held.
    """

    def __init__(
        self,
        loop: Loop,
        controller: Controller,
        winches: Winches | None,
        rest_length: object,
        sample: float,
    ) -> None:
        self._wiring = Wiring(controller, loop.model)
        if winches is not None:
            instance("winches", winches, Winches, "make them by Winches(rate=...)")
        self._held = loop.input
        self._convert = loop.input == "rest_length" and controller.input == "force_density"
        if controller.input == "rest_length" and loop.input == "force_density":
            raise ValueError(
                "the controller commands rest lengths; input='force_density' cannot follow it"
            )
        if loop.input == "force_density" and (winches is not None or rest_length is not None):
            raise ValueError("winches and rest_length have no meaning where γ is held")
        self._input = controller.input
        self._law = loop.model.strings
        self._winches = winches
        self._sample = sample
        self.start: FloatArray | None = None
        if rest_length is not None:
            self.start = self._wiring.checked_rest_length(rest_length)
            if winches is not None:
                winches.refuse_out_of_range("rest_length", self.start)
        elif winches is not None and (winches.rate is not None or winches.substeps > 1):
            raise ValueError(
                "winches with a rate or substeps need rest_length: where they stand at the start, "
                "m; to_rest_length(model, nodes, force_density) finds it"
            )
        self._current = self.start
        if self._convert:
            assert self._law is not None  # a rest length is held
            self._wiring.refuse_unreachable(self._law, controller.bounds[1])

    def _checked(self, value: object) -> FloatArray:
        """Return a command, or raise: a controller from elsewhere may promise what it does not."""
        wanted = shaped("command.value", value, (self._wiring.count,), "one per string")
        if self._input == "force_density":
            return non_negative("command.value", wanted, "a string can only pull")
        return positive("command.value", wanted, "rest length in m")

    def acting(self, nodes: FloatArray) -> FloatArray:
        """Return what the actuators hold, in the unit of the commands, in a shape."""
        assert self._current is not None  # callers have commanded, or know the start
        if not self._convert:
            return self._current
        assert isinstance(self._law, StringLaw)  # a rest length is held
        return self._wiring.gather_force_density(
            self._law.force_density(
                self._wiring.structure.string_length(nodes),
                self._wiring.spread_rest_length(self._current),
            )
        )

    def apply(
        self, command: Command, nodes: FloatArray, stuck: IntArray
    ) -> tuple[WinchMove, list[FloatArray]]:
        """Return what the actuators did, one entry a winch, and what is held, one a string.

        What is held comes part by part: they share the sample evenly.
        """
        wanted = self._checked(command.value)
        if self._held == "force_density":
            wanted = self._moved(wanted, stuck)
            self._current = wanted
            gamma = self._wiring.spread_force_density(wanted)
            return WinchMove(frozen(wanted), _NONE, _NONE), [gamma]
        if self._convert:
            assert isinstance(self._law, StringLaw)  # a rest length is held
            gamma = self._wiring.spread_force_density(wanted)
            wanted = self._wiring.gather(
                self._law.rest_length(self._wiring.structure.string_length(nodes), gamma)
            )
        wanted = self._moved(wanted, stuck)
        start = wanted if self._current is None else self._current
        move, substeps = WinchMove(frozen(wanted), _NONE, _NONE), 1
        if self._winches is not None:
            move = self._winches.move(start, wanted, self._sample)
            substeps = self._winches.substeps
        self._current = move.rest_length
        left = np.arange(substeps - 1.0, -1.0, -1.0)[:, None] / substeps
        reached = move.rest_length - left * (move.rest_length - start)
        return move, [self._wiring.spread_rest_length(each) for each in reached]

    def _moved(self, wanted: FloatArray, stuck: IntArray) -> FloatArray:
        """Return what is wanted, but what stands where an actuator is stuck."""
        if not len(stuck):
            return wanted
        if self._current is None:
            how = "give rest_length, or" if self._held == "rest_length" else "give"
            raise ValueError(
                f"faults has winch {stuck[0]} stuck from the start, but it is not known where it "
                f"stands: {how} a time after the first sample"
            )
        moved = wanted.copy()
        moved[stuck] = self._current[stuck]
        return moved
