"""Derivatives of closed loops with motors: differences of the simulator, and closed forms."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.optimize.dual_numbers import Dual

DURATION, COUNT = 0.2, 9
LAGGING = {"drum_radius": 0.02, "gear_ratio": 4.0, "speed": 60.0, "lag": 0.03, "backlash": 0.2}
WEAK = {"drum_radius": 0.02, "gear_ratio": 1.0, "torque": 0.03}
HEAVY = {**WEAK, "torque": 0.3, "inertia": 1e-4, "backlash": 0.02}
PRISM = tc.prism()
MODEL = tc.Model(PRISM, tc.LinearStrings(200.0, damping=1.0))
START = 0.95 * PRISM.string_length()
# Two strings on one drum, one of which is wound as the other is paid out, and one without a motor.
GANGED = {"pair": {0: 1.0, 4: -0.7}} | {f"motor_{i}": [i] for i in (1, 2, 3, 5, 6, 7)}


def run_of(winches, model=MODEL, start=START, actuated=None, **how):
    """A run whose winches are told the same, whatever the motion."""

    def command(time, nodes, velocities):
        lengths = start + 0.1 * START * np.sin(30 * time + np.arange(COUNT))
        return law.actuation.inputs(lengths)

    law = tc.FunctionController(
        PRISM, command, input="rest_length", sample_time=0.04, actuated=actuated,
        equilibrium_input=start,
    )  # fmt: skip
    return tc.simulate(
        model, DURATION, controller=law, winches=winches, rest_length=start,
        **(how or {"tolerance": 1e-11, "error": "none"}),
    )  # fmt: skip


CASES = {
    "lag and play": (LAGGING, {"ramp": True}, None),
    "torque, at once": (WEAK, {}, None),
    "torque, ramps": (WEAK, {"substeps": 4}, GANGED),
    "inertia": (HEAVY, {"substeps": 4}, GANGED),
}


@pytest.mark.filterwarnings("ignore:rest length error")
@pytest.mark.parametrize("kind", list(CASES))
def test_motors_are_differentiated_as_they_ran(kind):
    numbers, how, actuated = CASES[kind]
    each, random = np.linspace(0.9, 1.1, COUNT), np.random.default_rng(1)
    numbers = {name: value * each for name, value in numbers.items()}
    change = {name: value * random.normal(size=COUNT) for name, value in numbers.items()}
    stiffer, longer = 20.0 * random.normal(size=COUNT), 0.05 * random.normal(size=COUNT)

    def moved(by):
        motor = tc.Motor(**{name: value + by * change[name] for name, value in numbers.items()})
        model = tc.Model(PRISM, tc.LinearStrings(200.0 + by * stiffer, damping=1.0))
        winches = tc.Winches(**how, motor=motor)
        return run_of(winches, model, START + by * longer, actuated)

    run = moved(0.0)
    limited = run.control.rate_limited if "speed" in numbers else run.control.motors.torque_limited
    assert 0 < limited.sum() < limited.size * COUNT
    names = [*(f"motor.{name}" for name in numbers), "stiffness", "rest_length"]
    tangent = tc.sensitivity(run, names)
    ends = [moved(by).nodes[:, :, -1] for by in (1e-4, -1e-4, 2e-4, -2e-4)]
    difference = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / 12e-4
    # Strings that are longer in all samples are so at the start and in all commands.
    along = {f"motor.{name}": by for name, by in change.items()} | {"stiffness": stiffer}
    found = sum(tangent.nodes[name][:, :, 0] @ by for name, by in along.items())
    found = found + tangent.nodes["rest_length"][:, :, 0].sum(axis=3) @ longer
    np.testing.assert_allclose(found, difference, atol=1e-7 * np.abs(difference).max())
    gradient = tc.gradient(run, lambda time, nodes, velocities: nodes[2, 4], names)
    for name in names:
        by = tangent.nodes[name]
        found, close = gradient.slope[name], 1e-11 * np.abs(by).max()
        np.testing.assert_allclose(found, by[2, 4, 0], atol=close)


LEVER, GRAVITY = 0.01, 9.81


def hoisted(numbers, first, time):
    """How far a winch at its full torque has raised a weight from rest, m.

    With s the stretch of the string, at first as given: ``z̈ = k s/m − g`` and ``s̈ = g + f/M − k s
    (1/m + 1/M)``, f the force of the motor and M its inertia as a mass.
    """
    k, m, torque, inertia = (numbers[i] for i in range(4))
    f, M = torque / LEVER, inertia / LEVER**2
    rate = ca.sqrt(k * (1 / m + 1 / M))
    mean = (GRAVITY + f / M) / rate**2
    bounced = (1 - ca.cos(rate * time)) / rate**2
    return (k * mean / m - GRAVITY) * time**2 / 2 + k / m * (first - mean) * bounced


def test_a_weight_on_a_winch_with_inertia():
    """The motion in closed form, which the simulator meets in the limit of many substeps."""
    k, m, torque, inertia, span = 2000.0, 0.5, 0.15, 4e-5, 0.03
    hanging = tc.Structure(
        np.array([[0.0, 0.0], [0.0, -1.0]]), np.zeros((0, 2), int), [(0, 1)], [], fixed=[0],
        point_mass=[0.0, m],
    )  # fmt: skip
    model = tc.Model(hanging, tc.LinearStrings(k), gravity=[0.0, -GRAVITY])
    start = np.array([1.0 - m * GRAVITY / k])
    motor = tc.Motor(LEVER, torque=torque, inertia=inertia)
    law = tc.FunctionController(
        hanging, lambda *_: 0.2 * start, input="rest_length", sample_time=span, low=0.01
    )
    names = ["stiffness", "point_mass", "motor.torque", "motor.inertia"]
    symbols = ca.SX.sym("numbers", 4)
    height = hoisted(symbols, 1.0 - start[0], span)
    exact = ca.Function("exact", [symbols], [height, ca.gradient(height, symbols)])
    value, slopes = exact([k, m, torque, inertia])
    expected, found = np.append(value.full(), slopes.full()), []
    for substeps in (100, 200):
        run = tc.simulate(
            model, span, controller=law, winches=tc.Winches(substeps=substeps, motor=motor),
            rest_length=start, tolerance=1e-9, error="none",
        )  # fmt: skip
        tangent = tc.sensitivity(run, names)
        slopes = [tangent.nodes[name][1, 1, 0].ravel()[-1] for name in names]
        found.append(np.array([run.nodes[1, 1, -1] + 1, *slopes]))
    first, second = np.array(found) / expected - 1
    np.testing.assert_allclose(first / second, 4.0, rtol=0.02)  # of order 2
    np.testing.assert_allclose((4 * second - first) / 3, 0.0, atol=1e-7)


def test_what_motors_are_not_differentiated_with_is_named():
    law = tc.LQR(
        tc.linearize(MODEL, tc.prestress(PRISM, force_density=10.0), input="rest_length"),
        sample_time=0.1,
    )
    winches = tc.Winches(rate=10.0)
    run = tc.simulate(
        MODEL, 0.2, controller=law, winches=winches, rest_length=law.plant.equilibrium_input,
        step=1e-2,
    )  # fmt: skip
    with pytest.raises(ValueError, match="feedback: no derivative is taken through motors"):
        tc.sensitivity(run, ["winches.rate"], feedback=True)
    law = tc.FunctionController(
        PRISM, lambda *_: np.full(COUNT, 10.0), input="force_density", sample_time=0.1
    )
    winches = tc.Winches(motor=tc.Motor(0.02, torque=0.05))
    held = {"input": "force_density", "controller": law, "winches": winches}
    run = tc.simulate(MODEL, 0.2, **held, step=1e-2)
    with pytest.raises(ValueError, match="met its torque where force densities are held"):
        tc.sensitivity(run, ["gravity"])


def test_numbers_with_derivatives_know_no_other_functions():
    number = Dual(np.ones((1, 2)), np.ones((1, 1, 2)))
    for function in (np.sin, np.cumsum):
        with pytest.raises(TypeError):
            function(number)
