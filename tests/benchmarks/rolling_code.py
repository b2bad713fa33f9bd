"""A ball that rolls by IMUs and encoders: Kalman filter and gait as C code, beside Python.

Run: ``python -m tests.benchmarks.rolling_code``, some minutes. Needs a C compiler. In each sample
one call of the C code takes the readings of a simulated ball, some of them lost, infinite or far
off, and its command goes back to the ball. Filter and gait in Python take the same readings.
Printed are the largest difference of commands, m, and of estimated nodes, m, the statuses, which
are equal, the steps made, and how far estimates are from the true motion. ``--samples 300``
shortens the loop.
"""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

import tenscontrol as tc
from tests.benchmarks.command_line import options
from tests.benchmarks.filter_code import VECTOR, Code, spoilt
from tests.benchmarks.rolling import FACE, REST_LENGTH, SAMPLE, WINCHES, filter_of, modelled

DRIVEN, STEP = list(range(0, 24, 2)), 5e-4


@cache
def ball_of():
    """Return the ball on its ground, and its shape at the start."""
    model = modelled(0.0)
    return model, tc.plant.set_down(model, FACE)


def gait_of():
    return tc.shape.RollingGait(
        ball_of()[0], REST_LENGTH, [1.0, 0.0, 0.0], SAMPLE, winches=WINCHES, actuated=DRIVEN,
        tabulated=True,
    )  # fmt: skip


class OneCall(Code):
    """Filter and controller in C, by one call a sample."""

    def __init__(self, made, like=None):
        super().__init__(made, like)
        self.library.controller_sample.argtypes = [ctypes.c_double, VECTOR, VECTOR]

    def sample(self, time, y):
        command = np.zeros(self.commands)
        number = self.library.controller_sample(time, np.ascontiguousarray(y), command)
        return command, number


def compare(gait, estimator, robot, samples, folder):
    """Return the largest differences, the statuses, and errors of estimated nodes, m, by sample."""
    structure, home = gait.settings.structure, gait.settings.plans.home
    made = tc.generate_c(gait, folder, estimator=estimator)
    code = Code(made)
    one_call = OneCall(made, code)
    law = tc.FunctionController(structure, gait, equilibrium_input=home)
    noise, rng = estimator.sensors.noise, np.random.default_rng(0)
    worst, statuses, errors = np.zeros(2), set(), []
    read = robot.reset()
    for k in range(samples):
        time, true = k * gait.sample_time, robot.state.states[0]
        y = spoilt(read, noise, k, rng)
        estimate = estimator.update(y)
        command = law.command(time, estimate.nodes, estimate.velocities)
        nodes, velocities, status = code.estimate(y)
        in_c = code.command(nodes, velocities, time)
        code.predict(in_c)
        at_once, _ = one_call.sample(time, y)
        assert np.array_equal(at_once, in_c), k
        assert status is estimate.status, k
        statuses.add(status)
        driven = command.value[gait.actuated.lead]
        off = np.abs(in_c - driven).max(), np.abs(nodes - estimate.nodes).max()
        worst = np.maximum(worst, off)
        held = home.copy()
        held[gait.actuated.lead] = in_c
        estimator.predict(held)
        shapes = [
            each - each.mean(axis=1, keepdims=True)
            for each in (nodes, true[: nodes.size].reshape(nodes.shape, order="F"))
        ]
        errors.append(np.abs(shapes[0] - shapes[1]).max())
        read = robot.step(in_c)
    return worst, statuses, np.array(errors)


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, arguments, samples=5000)
    gait, (model, start) = gait_of(), ball_of()
    estimator = filter_of(model, REST_LENGTH, DRIVEN, start)
    robot = tc.Stepper(
        model, SAMPLE, step=STEP, nodes=start, rest_length=REST_LENGTH, winches=WINCHES,
        actuated=DRIVEN, sensors=estimator.sensors,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        worst, statuses, errors = compare(gait, estimator, robot, given.samples, Path(folder))
    print(f"{given.samples} samples, {len(gait.made)} steps")
    print("commands differ by {:.1e} m, nodes by {:.1e} m".format(*worst))
    print("statuses of the filter:", ", ".join(sorted(map(str, statuses))))
    typical, large = np.percentile(errors, [50, 95])
    print(f"farthest node of the shape: {typical:.3f} m off in the median, {large:.3f} m at 95 %")


if __name__ == "__main__":
    main()
