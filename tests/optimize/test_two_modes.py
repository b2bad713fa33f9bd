"""Two linear modes with switching lines, in closed form: the example ``hybrid/ex1fwd`` of PETSc.

``u̇ = A_i u``; mode 1 ends at u₁ = λ₁ u₀, mode 2 at u₁ = λ₂ u₀. No string can do this, as the mode
depends on the line that was met last. So steps of the exact motion are differentiated in place of
traced ones, with u for the velocity of a node, and λ₁ for the input of a string.
"""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.equation import Equation, InputLayout
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.optimize.derivatives import Derivatives
from tenscontrol.optimize.parameters import Parameter
from tenscontrol.optimize.traced_steps import TracedSteps
from tenscontrol.optimize.variations import Variations

MODES = np.array([[[1.0, -100.0], [10.0, 1.0]], [[1.0, 10.0], [-100.0, 1.0]]])
LINES, START, END = (2.75, 0.36), (0.0, 1.0), 0.125

# As ``hybrid/ex1fd`` prints them, by Crank and Nicolson's method in steps of 1/256 s.
SWITCHES = 0.095845, 0.114916
BY_START, BY_LINE = [[-0.237478, -0.319570], [0.031943, -0.237558]], [-0.101525, 0.070411]


def flow(mode, u, time):
    """Return the state a time later, exp(A t) u."""
    (_, b), (c, _) = MODES[mode]
    rate = np.sqrt(-b * c)
    turned = [b * np.sin(rate * time) / rate * u[1], c * np.sin(rate * time) / rate * u[0]]
    return np.exp(time) * (np.cos(rate * time) * u + np.array(turned))


def time_to_line(mode, u, line):
    """Return when a motion meets u₁ = λ u₀, the first time after now."""
    (_, b), (c, _) = MODES[mode]
    rate = np.sqrt(-b * c)
    time = np.arctan((u[1] - line * u[0]) * rate / (line * b * u[1] - c * u[0])) / rate
    return time if time.real > 1e-9 else time + np.pi / rate


def motion(u0, u1, line):
    """Return the legs of the motion, (mode, state, length): of complex numbers, too."""
    legs, u, left = [], np.array([u0, u1]), END
    for mode, own in ((0, line), (1, LINES[1])):
        length = time_to_line(mode, u, own)
        legs.append((mode, u, length))
        u, left = flow(mode, u, length), left - length
    return [*legs, (0, u, left)]


class TwoModes(Equation):
    """The two modes: the second acts where the first line was met last."""

    def gap_scale(self, u):
        return ca.SX.ones(2)


def two_modes():
    """Return the equation of x = [anything; u]."""
    x, line, met = (ca.SX.sym(name, size) for name, size in (("x", 4), ("line", 1), ("met", 2)))
    matrix = ca.DM(MODES[0]) + (met[0] - met[1]) * ca.DM(MODES[1] - MODES[0])
    u = x[2:]
    gap = ca.vertcat(u[1] - line * u[0], u[1] - LINES[1] * u[0])
    return TwoModes(
        Function("slope", [x, line, met], [ca.vertcat(u, matrix @ u)]),
        Function("gap", [x, line], [gap, ca.SX.zeros(2)]),
    )


@pytest.fixture(scope="module")
def variations():
    """What carries small changes along the exact motion, in 24 steps a leg."""
    count, legs = 24, motion(*START, LINES[0])
    lengths = np.concatenate([np.full(count, length / count) for *_, length in legs])
    states = np.zeros((4, 3 * count + 1))
    for i, (mode, u, length) in enumerate(legs):
        for k in range(count + 1):
            states[2:, i * count + k] = flow(mode, u, k * length / count)
    met = np.repeat([[0.0, 1.0, 1.0], [0.0, 0.0, 1.0]], count, axis=1)
    begin = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    steps = TracedSteps(
        begin, lengths, np.zeros(len(begin), dtype=int), states,
        np.full((1, len(begin)), LINES[0]), met, False, "dop853", InputLayout(1),
    )  # fmt: skip
    node = tc.Structure(
        [[0.0, 1.0], [0.0, 0.0]], [], [(0, 1)], [], fixed=[0], point_mass=[0.0, 1.0]
    )
    parameters = [
        Parameter("velocities", "velocities", (2, 2)), Parameter("line", "input", (1,))
    ]  # fmt: skip
    derivatives = Derivatives(tc.Model(node), "force_density", 0, parameters)
    derivatives.equation = two_modes()
    return Variations(steps, derivatives, parameters, np.array([END]))


def derivative(variations):
    """Return the derivative of the state at the end."""
    sensitivities = np.empty((1, 4, 5))
    variations.forward(variations.start(), sensitivities)
    return sensitivities[0]


def test_two_linear_modes_have_the_derivatives_of_their_closed_form(variations):
    assert len(variations.switches.step) == 2
    X = derivative(variations)
    exact = np.empty((2, 3))
    for column, change in enumerate(1e-30j * np.eye(3)):
        mode, u, length = motion(*(np.array([*START, LINES[0]]) + change))[-1]
        exact[:, column] = flow(mode, u, length).imag / 1e-30
    np.testing.assert_allclose(X[2:, [1, 3, 4]], exact, atol=1e-12)
    for row in (2, 3):
        cost = np.zeros((1, 4))
        cost[0, row] = 1.0
        slope = np.zeros(5)
        mu = variations.backward(np.zeros(4), cost, slope, np.zeros(1))
        np.testing.assert_allclose(slope + mu @ variations.start(), X[row], atol=1e-13)


def test_they_are_those_that_petsc_prints_to_its_own_error(variations):
    times = variations.steps.begin[[24, 48]]
    np.testing.assert_allclose(times, SWITCHES, rtol=2e-3)
    X = derivative(variations)[2:]
    np.testing.assert_allclose(X[:, [1, 3]], BY_START, atol=4e-3)
    np.testing.assert_allclose(X[:, 4], BY_LINE, atol=2e-3)
