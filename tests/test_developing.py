"""One of each that docs/developing.rst tells how to add, added here without touching a folder."""

from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Command, Controller, Fallback
from tenscontrol.dynamics import StringLaw
from tenscontrol.integrate import Integrator, Method, Span, Work

STILL = np.zeros((3, 6))


# ---- generator ----


def x_frame(width, height, bar_mass=1.0):
    """Two crossed bars with a string along each side of the frame."""
    nodes = np.array(
        [[0, width, 0, width], [0, 0, 0.01 * width, 0.01 * width], [0, height, height, 0]]
    )
    bars, strings = [[0, 1], [2, 3]], [[0, 3], [3, 1], [1, 2], [2, 0]]
    groups = ["horizontal", "vertical", "horizontal", "vertical"]
    return tc.Structure(nodes, bars, strings, bar_mass, string_groups=groups)


def test_generator():
    frame = x_frame(2.0, 1.0)
    np.testing.assert_allclose(frame.string_length(frame.nodes)[1::2], 1.0, rtol=1e-3)
    assert frame.strings_in("horizontal").tolist() == [0, 2]
    run = tc.simulate(tc.Model(frame), 0.1, force_density=1.0)
    assert run.health.bar_length_error < 1e-6


# ---- string law ----


@dataclass(frozen=True, eq=False)
class HardeningStrings(StringLaw):
    """Tension k s + h s² of the stretch s."""

    stiffness: np.ndarray
    hardening: np.ndarray
    damping: np.ndarray = 0.0

    def tension(self, length, rest_length):
        stretch = length - rest_length
        return self.stiffness * stretch + self.hardening * stretch * ca.fabs(stretch)

    def taut_rest_length(self, length, force_density):
        k, h = self.stiffness, self.hardening
        return length - (ca.sqrt(k**2 + 4 * h * length * force_density) - k) / (2 * h)

    def stored_energy(self, length, rest_length):
        stretch = ca.fmax(0, length - rest_length)
        return self.stiffness * stretch**2 / 2 + self.hardening * stretch**3 / 3

    @property
    def largest_force_density(self):
        return np.full(np.shape(self.stiffness), np.inf)


def test_string_law():
    prism = tc.prism()
    law = HardeningStrings(np.array(100.0), np.array(500.0))
    model, rest = tc.Model(prism, strings=law), tc.prestress(prism, force_density=17.3205)
    lengths = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    found = tc.to_force_density(model, prism.nodes, lengths)
    np.testing.assert_allclose(found, rest.force_density, rtol=1e-12)
    stiffer = tc.modes(tc.linearize(model, rest, input="rest_length")).frequency
    linear = tc.Model(prism, strings=tc.LinearStrings(100.0))
    softer = tc.modes(tc.linearize(linear, rest, input="rest_length")).frequency
    assert stiffer[0] > softer[0]
    run = tc.simulate(model, 1.0, rest_length=0.98 * lengths, step=1e-3)
    assert run.health.energy_error < 1e-6


# ---- controller ----


class Relay(Controller):
    """Winds the strings in while the prism is below a height, and lets them out above it."""

    def __init__(self, plant, sample_time, height, swing):
        level = plant.equilibrium_input
        super().__init__(plant, sample_time, level - swing, level + swing)
        self.height, self.swing = height, swing

    def reset(self):
        super().reset()

    def _decide(self, time, state):
        z = self.plant.to_nodes(state[: self.plant.degrees_of_freedom])[2]
        sign = 1.0 if z.max() - z.min() > self.height else -1.0
        return Command(self.plant.equilibrium_input + sign * self.swing)

    def _fall_back(self, status):
        return Command(self.plant.equilibrium_input, status, Fallback.EQUILIBRIUM_HELD)


def test_controller():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    plant = tc.linearize(model, tc.prestress(prism, force_density=17.3205), input="rest_length")
    relay = Relay(plant, 0.01, height=1.0, swing=0.001)
    run = tc.simulate(model, 0.2, controller=relay, step=1e-3)
    assert run.control.status_count == {"ok": 20}
    assert np.abs(run.control.command - plant.equilibrium_input[:, None]).max() < 0.001 + 1e-12
    lost = relay.command(0.0, np.full((3, 6), np.nan), STILL)
    assert lost.fallback is Fallback.EQUILIBRIUM_HELD


# ---- integrator ----


class Heun(Integrator):
    """Heun's method of order 2, in fixed steps that pass over switches."""

    name = "heun"

    def __init__(self, equation, step):
        super().__init__(equation)
        self.step = step

    def advance(self, state, held, duration, outputs, report=None):
        inner = int(np.ceil(duration / outputs / self.step - 1e-9))
        h, states = duration / outputs / inner, []
        for _ in range(outputs):
            for _ in range(inner):
                first = np.array(self._equation.kinked_slope(state, held)).ravel()
                second = np.array(self._equation.kinked_slope(state + h * first, held)).ravel()
                state = state + h / 2 * (first + second)
            states.append(state)
        return Span(np.array(states).T, Work(steps=outputs * inner))


def test_integrator():
    prism = tc.prism()
    model = tc.Model(prism)
    make = lambda equation, step, project=False: Heun(equation, step)  # noqa: E731
    method = Method("heun", ("step",), "order 2, fixed steps", make, compiles=False)
    gamma = tc.prestress(prism, force_density=17.3205).force_density * np.linspace(0.8, 1.2, 9)
    loose = {"limits": tc.HealthLimits(crossings=None)}
    exact = tc.simulate(model, 0.5, force_density=gamma, method="dop853", tolerance=1e-12, **loose)
    errors = [
        np.abs(
            tc.simulate(model, 0.5, force_density=gamma, method=method, step=step, **loose).nodes[
                ..., -1
            ]
            - exact.nodes[..., -1]
        ).max()
        for step in (0.005, 0.0025)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)


# ---- QP solver ----


def dense_admm():
    """A QP solver of MPC in NumPy: the alternating direction method of multipliers."""
    from tenscontrol.control.mpc import QPSolution, QPSolver

    class DenseADMM(QPSolver):
        rho = 0.1

        def __init__(self, P, A, tolerance, max_iterations, *, equations=False):
            self.P, self.A = P.toarray(), A.toarray()
            self.tolerance, self.max_iterations = tolerance, max_iterations

        def update(self, A):
            raise NotImplementedError("the matrix of a condensed program stays")

        def solve(self, q, l, u, start=None, deadline=np.inf):  # noqa: E741
            A, rho, status = self.A, self.rho, tc.control.Status
            inverse = np.linalg.inv(self.P + rho * A.T @ A)
            z, y = np.clip(0.0, l, u), np.zeros(len(l))
            for k in range(self.max_iterations):
                x = inverse @ (A.T @ (rho * z - y) - q)
                z, last = np.clip(A @ x + y / rho, l, u), z
                y = y + rho * (A @ x - z)
                if max(np.abs(A @ x - z).max(), rho * np.abs(z - last).max()) < self.tolerance:
                    return QPSolution(status.OK, x, y, k + 1)
            return QPSolution(status.OUT_OF_ITERATIONS, None, None, self.max_iterations)

        def reset(self):
            pass

    return DenseADMM


def test_qp_solver():
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    usual = {"horizon": 5, "sample_time": 0.02, "max_force_density": 33.0, "form": "condensed"}
    nodes = plant.to_nodes([0.05, *np.zeros(8)])
    wanted = tc.MPC(plant, **usual, tolerance=1e-9).command(0.0, nodes, STILL)
    dense = tc.MPC(plant, **usual, solver=dense_admm(), tolerance=1e-9, max_iterations=10**5)
    found = dense.command(0.0, nodes, STILL)
    assert found.status is tc.control.Status.OK
    np.testing.assert_allclose(found.value, wanted.value, atol=1e-4)


# ---- as the page says ----


def test_each_takes_less_than_sixty_lines():
    text = Path(__file__).read_text(encoding="utf-8")
    _, *parts = text.split("\n# ---- ")
    lengths = {part.partition(" ----")[0]: len(part.strip().splitlines()) for part in parts}
    assert set(lengths) >= {"generator", "string law", "controller", "integrator", "QP solver"}
    assert max(lengths.values()) < 60, lengths
