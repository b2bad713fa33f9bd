"""Derivatives of closed loops by the numbers of their motors: differences of the simulator."""

import numpy as np
import pytest

import tenscontrol as tc

DURATION, COUNT = 0.2, 9
NUMBERS = {"drum_radius": 0.02, "gear_ratio": 4.0, "speed": 60.0, "lag": 0.03, "backlash": 0.2}
PRISM = tc.prism()
MODEL = tc.Model(PRISM, tc.LinearStrings(200.0, damping=1.0))
START = 0.95 * PRISM.string_length()


def command(time, nodes, velocities):
    """What winches are told, whatever the motion."""
    return START * (1 + 0.1 * np.sin(30 * time + np.arange(COUNT)))


def run_of(winches, **how):
    law = tc.FunctionController(PRISM, command, input="rest_length", sample_time=0.04)
    return tc.simulate(
        MODEL, DURATION, controller=law, winches=winches, rest_length=START,
        **(how or {"tolerance": 1e-11, "error": "none"}),
    )  # fmt: skip


def test_numbers_of_motors():
    each, random = np.linspace(0.9, 1.1, COUNT), np.random.default_rng(1)
    numbers = {name: value * each for name, value in NUMBERS.items()}
    change = {name: value * random.normal(size=COUNT) for name, value in numbers.items()}

    def moved(by):
        motor = tc.Motor(**{name: value + by * change[name] for name, value in numbers.items()})
        return run_of(tc.Winches(ramp=True, motor=motor))

    run = moved(0.0)
    assert 0 < run.control.rate_limited.sum() < run.control.rate_limited.size * COUNT
    names = [f"motor.{name}" for name in NUMBERS]
    tangent = tc.sensitivity(run, names)
    ends = [moved(by).nodes[:, :, -1] for by in (1e-4, -1e-4)]
    difference = (ends[0] - ends[1]) / 2e-4
    found = sum(tangent.nodes[f"motor.{name}"][:, :, 0] @ by for name, by in change.items())
    np.testing.assert_allclose(found, difference, atol=1e-6 * np.abs(difference).max())
    gradient = tc.gradient(run, lambda time, nodes, velocities: nodes[2, 4], names)
    for name in names:
        by = tangent.nodes[name]
        found, close = gradient.slope[name], 1e-11 * np.abs(by).max()
        np.testing.assert_allclose(found, by[2, 4, 0], atol=close)


@pytest.mark.filterwarnings("ignore:rest length error")
def test_motors_that_depend_on_the_motion_are_refused():
    motor = tc.Motor(0.02, torque=1e-3, lag=0.03)
    run = run_of(tc.Winches(ramp=True, motor=motor))
    with pytest.raises(ValueError, match="a motor of the run met its torque"):
        tc.sensitivity(run, ["motor.lag"])
    heavy = tc.Motor(0.02, torque=1.0, inertia=1e-4)
    run = run_of(tc.Winches(motor=heavy))
    with pytest.raises(ValueError, match=r"to\[0\] is 'motor.lag', expected one of"):
        tc.sensitivity(run, ["motor.lag"])
