"""How far rest lengths are off that motors at their limit of torque set in parts of a sample.

    python -m tests.benchmarks.motor_substeps

The strings of a ball on three nodes are wound in and out by motors that are strong enough for 1.2
times the tension at the start. Runs are compared with one of many substeps, of which each is one
step of the integration; the estimate is that of ``run.control.motors.rest_length_error``.
"""

from __future__ import annotations

import warnings

import numpy as np

import tenscontrol as tc
from tests.benchmarks.command_line import options
from tests.simulation.test_motors import GEAR, SAMPLE, Wave, scene

MOTORS = {
    "torque alone": {},
    "lag 30 ms": {"lag": 0.03},
    "inertia 1e-5 kg m²": {"inertia": 1e-5},
    "play 0.3 rad": {"backlash": 0.3},
}


def run(substeps, finest, **motor):
    """Return the run of the ball with so many substeps."""
    model, start = scene("ball on three nodes")
    length, lever = model.structure.string_length(), GEAR["drum_radius"] / GEAR["gear_ratio"]
    torque = 1.2 * model.strings.force_density(length, start) * length * lever
    winches = tc.Winches(
        ramp=True, substeps=substeps, motor=tc.Motor(**GEAR, torque=torque, **motor)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tc.simulation.AccuracyWarning)
        return tc.simulate(
            model, 0.6, controller=Wave(model, start, 0.02), winches=winches, rest_length=start,
            step=SAMPLE / finest, output_step=SAMPLE,
        )  # fmt: skip


def main(arguments=None):
    """Print a row for each kind of motor and number of substeps."""
    given = options(__doc__, arguments, substeps=(2, 4, 10, 32), finest=256)
    print("motors              substeps   rest length      nodes   estimate")
    for name, motor in MOTORS.items():
        finest = run(given.finest, given.finest, **motor)
        for substeps in given.substeps:
            found = run(substeps, given.finest, **motor)
            off = np.abs(found.control.applied - finest.control.applied).max()
            moved = np.linalg.norm(found.nodes[:, :, -1] - finest.nodes[:, :, -1], axis=0).max()
            estimate = found.control.motors.rest_length_error
            numbers = "".join(f"{1e3 * each:8.3f} mm" for each in (off, moved, estimate))
            print(f"{name:18s} {substeps:9d}   {numbers}", flush=True)


if __name__ == "__main__":
    main()
