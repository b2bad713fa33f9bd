"""What turns commands into lengths in time where a closed loop drives bars."""

from __future__ import annotations

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    inputs_of,
    member_rows,
    polynomials_of,
    strings_of,
    through,
)
from tenscontrol.actuation.winch_motion import Drive
from tenscontrol.actuation.winches import Winches, WinchMove
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.control.command import Command
from tenscontrol.control.controller import BaseController
from tenscontrol.dynamics.profile import Pieces
from tenscontrol.plant.input_bounds import refuse_motors_of_bars
from tenscontrol.plant.linear_plant import NO_JUMP
from tenscontrol.simulation.actuators import (
    commands_parent,
    of_all_members,
    refuse_stuck_passive,
    stuck_inputs,
    winches_of_inputs,
)
from tenscontrol.simulation.plant_run import PlantRun


class StrutDrives:
    """Apply commanded lengths of bars as ramps, within the rates and ranges of their drives.

    Also those of strings, where the controller winds them, too. They have the interface of
    :class:`Actuators`. ``held`` is what the strings hold, one value a string; ``start`` are the
    lengths of all that is commanded at the start, m, strings before bars, ``reached`` those that
    the last sample led to, and ``lengths`` how bars move in the sample.
    """

    ticks = 1
    known = True

    def __init__(
        self,
        plant_run: PlantRun,
        controller: BaseController,
        winches: Winches | None,
        held: FloatArray,
        sample_time: float,
    ) -> None:
        if commands_parent(plant_run.model, controller):
            raise ValueError(
                "the controller commands bars of the parent of a subdivided structure: design it "
                "on the model that is simulated"
            )
        if winches is None or not winches.ramp:
            raise ValueError(NO_JUMP)
        refuse_motors_of_bars(winches)
        assert plant_run.bars is not None  # the scene has made them
        self.held, self.lengths = held, plant_run.bars.lengths
        self._strings, self._bars = member_rows(controller.input, controller.commanded)
        bars = plant_run.bars.at(plant_run.now)
        self.start = self.reached = np.append(held[self._strings], bars)
        self.actuation = through(controller.actuation, self.start)
        refuse_stuck_passive(self.actuation, plant_run)
        name = "length" if self._bars.start else "bar_length"
        winches.refuse_out_of_range(name, self.start, self.actuation.driven)
        limits = winches_of_inputs(winches, self.actuation, None)
        self._drive = Drive(limits, inputs_of(self.actuation, self.start), sample_time)

    def applied_input(self, nodes: FloatArray) -> FloatArray:
        """Return the lengths that have come of the commands."""
        return self.reached

    def begin(self, command: Command, nodes: FloatArray, stuck: IntArray) -> WinchMove:
        """Take the command of a sample, and return the move to expect."""
        shape = self.actuation.input.shape
        desired = validation.shaped("command.value", command.value, shape, "one length per member")
        validation.positive("command.value", desired, "length in m")
        inputs = inputs_of(self.actuation, desired)
        move = self._drive.begin(inputs, stuck_inputs(self.actuation, stuck))
        return of_all_members(self.actuation, move)

    def tick(self, number: int, state: FloatArray, now: float) -> FloatArray | Pieces:
        """Return what strings hold in the sample that begins now, s, or how they are wound."""
        tick = self._drive.tick(number, now, _no_pull)
        moving = polynomials_of(self.actuation, tick.rest_length)
        self.reached = strings_of(self.actuation, self._drive.rest_length)
        strings, self.lengths = (
            Pieces(np.array([-np.inf]), np.array([now]), moving[None, rows])
            for rows in (self._strings, self._bars)
        )
        if not self._strings.stop:
            return self.held
        self.held = self.reached[self._strings]
        return strings

    def end(self) -> WinchMove:
        """Return the move of the sample, with the limits that were met."""
        return of_all_members(self.actuation, self._drive.end())

    def motor_record(self) -> None:
        """Return None: drives of bars have no motors."""
        return


def _no_pull(lengths: FloatArray, later: float) -> tuple[FloatArray, FloatArray]:
    """Return no force: drives of bars hold whatever acts on them."""
    return np.zeros_like(lengths), np.zeros_like(lengths)
