"""NMPC through contact: how far its prediction is off, and its time against the sample time.

Run: ``python -m tests.benchmarks.nmpc_contact``. Snelson's X in the plane (12 states, 4 winches)
and the six-bar ball (60 states, 24 winches) are dropped, land, stand, jump up by their winches and
land again. Controllers are designed in the air, on a model with the smooth law; the run has the
sharp one. A prediction error is how far a node is from where it was predicted a sample before.
Times are those of the processor for a command, preparation and feedback together, as a part of the
sample time.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import process_time

import numpy as np

import tenscontrol as tc
from tenscontrol.control import Controller
from tenscontrol.plant.reduced_dynamics import explicit_substeps
from tests.benchmarks.command_line import options
from tests.control.mpc.contact_scenes import STRUCTURES, hop, models

# Structure, sample time, s, horizon, height of the jump, m.
SCENES = (("x", 0.02, 15, 0.15), ("ball", 0.04, 10, 0.12), ("ball", 0.08, 6, 0.12))


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, duration=1.5, scenes=len(SCENES))
    print(
        "        sample s  horizon  steps  clear of    prediction error mm     time / sample time"
    )
    print("                                  ground m    median    largest      median   largest")
    for name, sample, horizon, height in SCENES[: given.scenes]:
        plant = STRUCTURES[name](height=0.1)
        nmpc = hop(plant, height, horizon, sample, tolerance=1e-3)
        timed = Timed(nmpc)
        sharp = models(plant.model.structure)[0]
        run = tc.simulate(
            sharp, given.duration, plant.nodes, rest_length=plant.rest_length, controller=timed
        )
        low, time = run.nodes[-1].min(axis=0), run.time
        flight = low[(time > 0.5) & (time < 1.2)].max(initial=-np.inf)
        error, spent = 1e3 * np.array(timed.errors[1:]), np.array(timed.times[1:]) / sample
        print(
            f"{name:8s}{sample:8.2f} {horizon:8d} {explicit_substeps(plant, sample):6d} "
            f"{flight:9.3f} {np.median(error):9.2f} {error.max():10.2f} "
            f"{np.median(spent):11.2f} {spent.max():9.2f}"
        )
        counts = ", ".join(f"{count} {status.value}" for status, count in nmpc.status_count.items())
        print(f"        derivatives: {nmpc.back_end}; commands: {counts}")


class Timed(Controller):
    """A controller whose commands are timed, and their prediction errors kept."""

    def __init__(self, controller):
        super().__init__(controller.plant, controller.sample_time, *controller.bounds)
        self._controller = controller

    def reset(self):
        self._controller.reset()
        self.times, self.errors = [], []

    def command(self, time, nodes, velocities):
        began = process_time()
        command = self._controller.command(time, nodes, velocities)
        self.times.append(process_time() - began)
        self.errors.append(self._controller.prediction_error)
        return command

    def _decide(self, time, state):
        raise NotImplementedError  # command is passed on whole


if __name__ == "__main__":
    main()
