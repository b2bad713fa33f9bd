"""Actuators: from commands of a controller to what each string of the plant is held at."""

from __future__ import annotations

import numpy as np

from tenscontrol.actuation import Winches, WinchMove
from tenscontrol.control import Command, Controller
from tenscontrol.plant import to_segments, to_strings
from tenscontrol.simulation.loop import Loop
from tenscontrol.structure import same_members
from tenscontrol.validation import (
    FloatArray,
    IntArray,
    frozen,
    instance,
    non_negative,
    per_member,
    positive,
    shaped,
)

_NONE = frozen(np.zeros(0, dtype=np.int64))


class Actuators:
    """Apply commands: γ as it is, or rest lengths through the winches.

    A controller commands the strings of the plant, or those of its parent, whose segments then
    move together. ``start`` are the rest lengths at the start, m, shape (α,), if they are known.
    """

    def __init__(
        self,
        loop: Loop,
        controller: Controller,
        winches: Winches | None,
        rest_length: object,
        sample_time: float,
    ) -> None:
        self._structure = loop.model.structure
        self._by_segment = _commands_parent(loop, controller)
        self._count = len(controller.plant.commanded.strings)
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
        self._sample_time = sample_time
        self.start: FloatArray | None = None
        if rest_length is not None:
            lengths = per_member(
                "rest_length", rest_length, self._count, "string of the controller"
            )
            self.start = positive("rest_length", lengths, "length in m")
            if winches is not None:
                winches.refuse_out_of_range("rest_length", self.start)
        elif winches is not None and (winches.rate is not None or winches.substeps > 1):
            raise ValueError(
                "winches with a rate or substeps need rest_length: where they stand at the start, "
                "m; to_rest_length(model, nodes, force_density) finds it"
            )
        self._current = self.start
        if self._convert:
            self._refuse_unreachable(controller.bounds[1])

    def applied_input(self, nodes: FloatArray) -> FloatArray:
        """Return what the actuators hold in a shape, in the unit of the commands."""
        assert self._current is not None  # callers have commanded, or know the start
        if not self._convert:
            return self._current
        assert self._law is not None  # a rest length is held
        rest_length = self._to_plant("rest_length", self._current)
        gamma = self._law.force_density(self._structure.string_length(nodes), rest_length)
        return to_strings(self._structure, "force_density", gamma) if self._by_segment else gamma

    def apply(
        self, command: Command, nodes: FloatArray, stuck: IntArray
    ) -> tuple[WinchMove, list[FloatArray]]:
        """Return the move, one entry a winch, and the input of each substep, one entry a string.

        The substeps share the sample evenly.
        """
        desired = self._checked(command.value)
        if self._held == "force_density":
            self._current = self._unless_stuck(desired, stuck)
            gamma = self._to_plant("force_density", self._current)
            return WinchMove(frozen(self._current), _NONE, _NONE), [gamma]
        if self._convert:
            assert self._law is not None  # a rest length is held
            gamma = self._to_plant("force_density", desired)
            desired = self._law.rest_length(self._structure.string_length(nodes), gamma)
            if self._by_segment:
                desired = to_strings(self._structure, "rest_length", desired)
        desired = self._unless_stuck(desired, stuck)
        start = desired if self._current is None else self._current
        move, substeps = WinchMove(frozen(desired), _NONE, _NONE), 1
        if self._winches is not None:
            move = self._winches.move(start, desired, self._sample_time)
            substeps = self._winches.substeps
        self._current = move.rest_length
        left = np.arange(substeps - 1.0, -1.0, -1.0)[:, None] / substeps
        reached = move.rest_length - left * (move.rest_length - start)
        return move, list(self._to_plant("rest_length", reached))

    def _checked(self, value: object) -> FloatArray:
        """Return a command, or raise: a user's controller may break its promises."""
        desired = shaped("command.value", value, (self._count,), "one per string")
        if self._input == "force_density":
            return non_negative("command.value", desired, "a string can only pull")
        return positive("command.value", desired, "rest length in m")

    def _to_plant(self, what: str, values: FloatArray) -> FloatArray:
        """Return values of the plant's strings from those of the commanded ones."""
        return to_segments(self._structure, what, values) if self._by_segment else values

    def _unless_stuck(self, desired: FloatArray, stuck: IntArray) -> FloatArray:
        """Return the desired input, but the current one of stuck actuators."""
        if not len(stuck):
            return desired
        if self._current is None:
            how = "give rest_length, or" if self._held == "rest_length" else "give"
            raise ValueError(
                f"faults has winch {stuck[0]} stuck from the start, but it is not known where it "
                f"stands: {how} a time after the first sample"
            )
        moved = desired.copy()
        moved[stuck] = self._current[stuck]
        return moved

    def _refuse_unreachable(self, most: FloatArray) -> None:
        """Refuse a controller that may command a γ, at most ``most``, beyond any rest length."""
        assert self._law is not None  # a rest length is held
        largest, limit = self._to_plant("force_density", most), self._law.largest_force_density
        segments = self._to_plant("force_density", np.ones(self._count))
        over = np.flatnonzero(largest >= limit)
        if len(over):
            i = over[0]
            raise ValueError(
                f"the controller may command γ = {largest[i]:g} N/m on string {i}, but a string of "
                f"stiffness {limit[i]:g} N/m stays below that whatever its rest length. Give the "
                f"controller max_force_density below {limit[i] / segments[i]:g}"
            )


def _commands_parent(loop: Loop, controller: Controller) -> bool:
    """Return whether a controller commands the strings of the plant's parent, or refuse it."""
    structure, designed = loop.model.structure, controller.plant.commanded
    seen, parent = controller.plant.model.structure, structure.parent
    by_segment = not same_members(designed, structure)
    fits = same_members(seen, structure)
    if by_segment:
        fits = parent is not None and same_members(designed, parent) and (fits or seen is designed)
    if not fits:
        raise ValueError(
            f"the controller was designed on {seen!r}, but the model has {structure!r} "
            "with other bars, strings or fixed nodes, and is no direct subdivision of it"
        )
    return by_segment
