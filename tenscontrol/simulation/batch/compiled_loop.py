"""Compiled controllers in many closed loops at once."""

from __future__ import annotations

import ctypes
from collections import deque
from typing import Protocol, cast, runtime_checkable
from weakref import WeakKeyDictionary

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import strings_of
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.control.controller import Controller
from tenscontrol.dynamics.model import Model
from tenscontrol.structure.structure import Structure, same_members

# Runs of a block: each has a controller of its own.
MOST_CONTROLLERS = 64


@runtime_checkable
class CompiledCode(Protocol):
    """What a controller of compiled code has beside what all have."""

    entry_points: tuple[int, ...]

    def another(self) -> CompiledCode:
        """Return a controller of the same code with a memory of its own."""


# Copies of a controller that no thread uses: a copy is a library, which the process never unloads.
_IDLE: WeakKeyDictionary[Controller, deque[list[CompiledCode]]] = WeakKeyDictionary()


def checked_controller(controller: object, model: Model) -> Controller:
    """Return a compiled controller that fits a model; raise TypeError or ValueError for others."""
    if not isinstance(controller, Controller) or not isinstance(controller, CompiledCode):
        advice = "the compiled code of one: generate_c(controller, folder).compile()"
        raise validation.wrong_kind("controller", controller, advice)
    structure, feet = model.structure, controller.feet if model.ground else ()
    for seen in (controller.structure, controller.commanded):
        if not same_members(seen, structure, feet):
            raise ValueError(
                f"the controller was designed on {seen!r}, but the model has {structure!r} with "
                "other bars, strings or fixed nodes"
            )
    if (controller.input == "rest_length") != (model.strings is not None):
        kind, law = controller.input.replace("_", " "), model.strings
        expected = "a string law" if law is None else "none: strings with a law hold rest lengths"
        raise ValueError(
            f"the controller commands {kind}, and the model's strings are {law}; expected "
            f"{expected}"
        )
    return controller


class CompiledLoops:
    """The controllers of the runs of a block: one each, for one thread."""

    def __init__(self, controller: Controller, structure: Structure) -> None:
        self._code = cast(CompiledCode, controller)
        self._idle = _IDLE.setdefault(controller, deque())
        try:
            self._copies = self._idle.pop()
        except IndexError:
            self._copies = []
        self._free = structure.free_rows
        self._nodes = structure.nodes.ravel(order="F")
        self._actuation = controller.actuation

    def reset(self, runs: int) -> None:
        """Let the controllers of so many runs forget everything."""
        while len(self._copies) < runs:
            self._copies.append(self._code.another())
        reset, command = ctypes.CFUNCTYPE(ctypes.c_int), ctypes.CFUNCTYPE(
            ctypes.c_int, ctypes.c_double, *[ctypes.c_void_p] * 3
        )  # fmt: skip
        self._commands = []
        for copy in self._copies[:runs]:
            first, second = copy.entry_points
            reset(first)()
            self._commands.append(command(second))

    def give_back(self) -> None:
        """Leave the copies to others."""
        self._idle.append(self._copies)

    def commands(
        self, time: float, states: FloatArray, places: IntArray
    ) -> tuple[FloatArray, np.ndarray]:
        """Return the commands of some runs, (runs, α), and which are not of status OK.

        States have shape (runs, states); places are those of the runs in the block.
        """
        runs, half = len(states), len(self._free)
        motion = np.zeros((runs, 2, len(self._nodes)))
        motion[:, 0] = self._nodes
        motion[:, 0, self._free], motion[:, 1, self._free] = states[:, :half], states[:, half:]
        commands = np.zeros((runs, len(self._actuation.lead)))
        failed = np.zeros(runs, dtype=bool)
        for i, place in enumerate(places.tolist()):
            at = motion.ctypes.data + i * motion.strides[0]
            to = commands.ctypes.data + i * commands.strides[0]
            failed[i] = self._commands[place](time, at, at + motion.strides[1], to)
        return np.ascontiguousarray(strings_of(self._actuation, commands.T).T), failed
