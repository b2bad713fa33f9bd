"""Steps ``(x, u, taut, h) -> x1`` taken many times, and what they are compared with."""

import casadi as ca
import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics.equation import Equation, pack_state
from tenscontrol.dynamics.evaluator import Evaluator
from tests.dynamics.scenes import paper_force_density, random_structure, rest_lengths
from tests.located_motion import exact_motion
from tests.oracle import HeldForceDensity, HeldRestLength


def smooth_equation(slope):
    """Return the equation of a smooth ``(x, u) -> xdot``, dense columns, without a structure."""
    x, u = (ca.SX.sym(name, slope.size1_in(i)) for i, name in enumerate("xu"))
    taut, none = ca.SX.sym("taut", 0), ca.SX(0, 1)
    return Equation(
        slope=ca.Function("slope", [x, u, taut], [slope(x, u)]),
        gap=ca.Function("gap", [x, u], [none, none]),
    )


def march(step, x, u, h, count, taut=None):
    """Return the state after ``count`` steps of h."""
    return records(step, x, u, h, 1, count, taut)[:, -1]


def records(step, x, u, h, count, every, taut=None):
    """Return the states after every ``every`` of ``count · every`` steps, shape (states, count)."""
    many = Evaluator(step.fold(every) if every > 1 else step)
    taut = np.ones(step.size1_in(2)) if taut is None else taut
    held = [np.tile(np.reshape(each, (-1, 1)), every) for each in (u, taut, h)]
    held = [each.ravel() for each in held] if every == 1 else held
    held[2] = np.full((1, every), h) if every > 1 else h
    states = np.empty((len(x), count))
    for k in range(count):
        x = many(x, *held)[0].copy()
        states[:, k] = x
    return states


def rk4(equation):
    """A step of the classical Runge-Kutta method."""
    x, u, taut, h = equation.symbols()
    k1 = equation.slope(x, u, taut)
    k2 = equation.slope(x + h / 2 * k1, u, taut)
    k3 = equation.slope(x + h / 2 * k2, u, taut)
    k4 = equation.slope(x + h * k3, u, taut)
    return ca.Function("rk4", [x, u, taut, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])


def fitted_order(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def supported_structure(seed):
    """A random structure with a free bar, two that swing (hinged at either end), one that is
    part of the support, two point masses and a fixed string end."""
    loose = random_structure(seed, bars=4, points=3)
    fixed = [loose.bars[1, 0], loose.bars[2, 1], *loose.bars[3], loose.string_nodes[0]]
    return tc.Structure(
        loose.nodes,
        loose.bars,
        loose.strings,
        loose.bar_mass,
        loose.string_node_mass[1:],
        fixed=fixed,
    )


def rigid_velocities(structure, seed):
    """Random velocities, shape (3, n), that neither stretch bars nor move fixed nodes."""
    velocities = np.random.default_rng(seed).normal(size=structure.nodes.shape)
    velocities[:, structure.fixed] = 0
    vectors, rates = structure.bar_vectors(structure.nodes), structure.bar_vectors(velocities)
    change = -vectors * (vectors * rates).sum(axis=0) / (vectors**2).sum(axis=0)
    velocities[:, structure.bars[:, 0]] -= structure.end_share[:, 0] * change
    velocities[:, structure.bars[:, 1]] += structure.end_share[:, 1] * change
    return velocities


def moving(structure, seed=0):
    """The state of a structure in its reference shape with random velocities."""
    return pack_state(structure, structure.nodes, rigid_velocities(structure, seed))


def smooth_motion(prism, held, damping=0.0, duration=1.0):
    """Equation, input and start of a prism, γ_v = 45 N/m, and where the oracle takes its nodes.

    It starts with a twist and a shake; no string goes slack.
    """
    gamma = paper_force_density(45.0)
    lengths = rest_lengths(prism, gamma, 100.0)
    u = gamma if held == "force_density" else lengths
    law = HeldForceDensity(u) if held == "force_density" else HeldRestLength(u, 100.0, damping)
    velocities = 0.2 * rigid_velocities(prism, 3)
    nodes, switches = exact_motion(prism, law, np.array([0.0, duration]), velocities)
    assert len(switches) == 0
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping))
    x = pack_state(prism, prism.nodes, velocities)
    return model.equation(held), u, x, nodes[:, :, -1].ravel(order="F")


def bar_errors(structure, states):
    """Largest relative errors of bar lengths and of rates along bars, m/s, of states (6n, T)."""
    nodes, velocities = tc.dynamics.equation.unpack_states(structure, np.atleast_2d(states.T).T)
    start, end = structure.bars.T
    B, Bd = nodes[:, end] - nodes[:, start], velocities[:, end] - velocities[:, start]
    length = structure.bar_length[:, None]
    stretch = np.abs(np.linalg.norm(B, axis=0) / length - 1)
    rate = np.abs((B * Bd).sum(axis=0) / length)
    return stretch.max(), rate.max()
