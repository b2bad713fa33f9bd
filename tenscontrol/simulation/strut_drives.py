"""Drives of the bars of a closed loop: they turn commands into lengths in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import inputs_of, moved_by, strings_of, through
from tenscontrol.actuation.winches import Drive, Winches, WinchMove
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.control.command import Command
from tenscontrol.control.controller import BaseController
from tenscontrol.dynamics.profile import Pieces
from tenscontrol.plant.input_bounds import refuse_motors_of_bars
from tenscontrol.plant.linear_plant import NO_JUMP
from tenscontrol.simulation.actuators import commands_parent, winches_of_inputs
from tenscontrol.simulation.plant_run import PlantRun


class StrutDrives:
    """Apply commanded lengths of bars as ramps, within the rates and ranges of their drives.

    They have the interface of :class:`Actuators`. ``held`` is what the strings hold, one value a
    string; ``start`` are the lengths of all bars at the start, m, ``reached`` those that the last
    sample led to, and ``lengths`` how they move in the sample.
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
        self.start = self.reached = plant_run.bars.at(plant_run.now)
        self.actuation = through(controller.actuation, self.start)
        winches.refuse_out_of_range("bar_length", self.start, self.actuation.driven)
        limits = winches_of_inputs(winches, self.actuation, None)
        self._drive = Drive(limits, inputs_of(self.actuation, self.start), sample_time)

    def applied_input(self, nodes: FloatArray) -> FloatArray:
        """Return the lengths that bars have come to."""
        return self.reached

    def begin(self, command: Command, nodes: FloatArray, stuck: IntArray) -> WinchMove:
        """Take the command of a sample, and return the move to expect."""
        shape = self.actuation.input.shape
        desired = validation.shaped("command.value", command.value, shape, "one per bar")
        validation.positive("command.value", desired, "length in m")
        return self._of_bars(self._drive.begin(inputs_of(self.actuation, desired), stuck))

    def tick(self, number: int, state: FloatArray, now: float) -> FloatArray:
        """Return what strings hold in the sample that begins now, s."""
        moving = self._drive.tick(number, now, _no_pull).rest_length
        if not self.actuation.is_whole:
            moving = moved_by(self.actuation, moving.T).T
            moving[:, 0] += self.actuation.offset
        self.reached = strings_of(self.actuation, self._drive.rest_length)
        self.lengths = Pieces(np.array([-np.inf]), np.array([now]), moving[None])
        return self.held

    def end(self) -> WinchMove:
        """Return the move of the sample, with the limits that were met."""
        return self._of_bars(self._drive.end())

    def motor_record(self) -> None:
        """Return None: drives of bars have no motors."""
        return

    def _of_bars(self, move: WinchMove) -> WinchMove:
        return replace(move, rest_length=frozen(strings_of(self.actuation, move.rest_length)))


def _no_pull(lengths: FloatArray, later: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return no force: drives of bars hold whatever acts on them."""
    return np.zeros_like(lengths), np.zeros_like(lengths), lengths
