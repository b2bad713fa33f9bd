"""Motions that are known by themselves: pendulums, rigid bodies, chains, strings over nodes."""

from itertools import combinations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import tenscontrol as tc
from tests.dynamics.model_motion import ModelMotion
from tests.known_structures import arm, d_bar, snelson_x, t_bar, vertebra

GRAVITY = 9.8


def moved(model, times, held=(), velocities=None, input="force_density", tolerance=1e-13):
    """Return nodes at the times, shape (d, n, T)."""
    nodes = model.structure.nodes
    velocities = np.zeros_like(nodes) if velocities is None else velocities
    motion = ModelMotion(model, input, np.array(held, dtype=float))
    return motion.integrate(nodes, velocities, np.asarray(times), tolerance)[0]


def test_a_double_pendulum_of_rods_moves_as_its_two_angles():
    """Slender rods, m = L = 1, both at 45 degrees at rest, over 5 s."""
    s, c = np.sin(np.pi / 4), np.cos(np.pi / 4)
    rods = tc.Structure([[0, s, 2 * s], [0, -c, -2 * c]], [[0, 1], [1, 2]], [], 1.0, fixed=[0])
    times = np.linspace(0, 5, 51)
    nodes = moved(tc.Model(rods, gravity=GRAVITY), times)

    def slope(_, y):
        """Lagrange's equations of L = T - V, by the angles from the vertical."""
        one, two, first, second = y
        between, turning = np.cos(one - two), np.sin(one - two)
        matrix = [[4 / 3, between / 2], [between / 2, 1 / 3]]
        right = [
            -(second**2) * turning / 2 - 1.5 * GRAVITY * np.sin(one),
            first**2 * turning / 2 - 0.5 * GRAVITY * np.sin(two),
        ]
        return [first, second, *np.linalg.solve(matrix, right)]

    start = [np.pi / 4, np.pi / 4, 0, 0]
    angles = solve_ivp(slope, (0, 5), start, "DOP853", times, rtol=1e-13, atol=1e-13).y[:2]
    ends = np.cumsum([np.sin(angles), -np.cos(angles)], axis=1)  # (d, rod, T)
    assert np.abs(nodes[:, 1:] - ends).max() < 1e-9


@pytest.mark.parametrize("bars", [6, 10])
def test_bodies_of_bars_turn_by_eulers_equations(bars):
    """A tetrahedron, and the same with a bar from each corner to its centre: redundant."""
    nodes, pairs = vertebra()
    random = np.random.default_rng(bars)
    nodes = nodes[:, : (4 if bars == 6 else 5)] * np.array([[1.0], [1.4], [0.7]])
    pairs = list(combinations(range(nodes.shape[1]), 2))
    mass = random.uniform(0.5, 2, len(pairs))
    body = tc.Structure(nodes, pairs, [], mass)
    assert len(body.bars) == bars
    assert [block.is_redundant for block in body.blocks] == [bars == 10]
    ends = [nodes[:, [a, b]].T for a, b in pairs]
    centre = sum(m * end.mean(axis=0) for m, end in zip(mass, ends, strict=True)) / mass.sum()
    # Inertia of thin rods: at each rod's centre m l²/12 across it, and at a distance.
    inertia = np.zeros((3, 3))
    for m, (a, b) in zip(mass, ends, strict=True):
        for way, part in ((b - a, m / 12), ((a + b) / 2 - centre, m)):
            inertia += part * (way @ way * np.eye(3) - np.outer(way, way))
    drift, spin = np.array([0.3, -0.2, 0.1]), np.array([1.0, 2.0, -1.5])

    def slope(_, y):
        """Euler's equations in the body, with the rotation as a matrix."""
        turn, spin = y[:9].reshape(3, 3), y[9:]
        rate = np.linalg.solve(inertia, np.cross(inertia @ spin, spin))
        return [*(turn @ np.cross(np.eye(3), spin)).ravel(), *rate]

    times = np.linspace(0, 2, 9)
    start = [*np.eye(3).ravel(), *spin]
    turns = solve_ivp(slope, (0, 2), start, "DOP853", times, rtol=1e-13, atol=1e-13).y[:9]
    arms = nodes - centre[:, None]
    expected = np.einsum("ijt,jn->int", turns.reshape(3, 3, -1), arms)
    expected += centre[:, None, None] + drift[:, None, None] * times
    velocities = drift[:, None] + np.cross(spin, arms.T).T
    found = moved(tc.Model(body), times, velocities=velocities)
    assert np.abs(found - expected).max() < 1e-10


def test_a_chain_of_short_bars_hangs_as_a_catenary():
    """Its shape at rest is where forces vanish; the chain of n bars is 1/n² from the curve."""
    span, length = 1.0, 1.5
    a = brentq(lambda a: 2 * a * np.sinh(span / (2 * a)) - length, 0.1, 1.0)
    sags = []
    for count in (10, 20, 40):
        # Each node on the catenary moves to the length of a bar of the chain, by Newton in angles.
        angles = np.arctan((np.arange(count) + 0.5 - count / 2) * length / count / a)
        angles = _hung(angles, length / count, span)
        steps = length / count * np.array([np.cos(angles), np.sin(angles)])
        nodes = np.hstack([np.zeros((2, 1)), np.cumsum(steps, axis=1)])
        bars = [(i, i + 1) for i in range(count)]
        chain = tc.Structure(nodes, bars, [], 1.0 / count, fixed=[0, count])
        model = tc.Model(chain, gravity=GRAVITY)
        rest = np.array(model.acceleration(nodes[:, 1:-1], np.zeros((2, count - 1)), []))
        assert np.abs(rest).max() < 1e-9
        lam = np.array(model.bar_force_density(nodes[:, 1:-1], np.zeros((2, count - 1)), []))
        tension = -lam.ravel() * length / count
        horizontal = GRAVITY / length * a  # weight by length times a, of the curve
        np.testing.assert_allclose(tension * np.cos(angles), horizontal, rtol=2 / count**2)
        sags.append(-nodes[1].min())
    exact = a * (np.cosh(span / (2 * a)) - 1)
    errors = np.abs(np.array(sags) - exact)
    np.testing.assert_allclose(errors[:-1] / errors[1:], 4, rtol=0.1)


def _hung(angles, length, span):
    """Angles of equal bars between two points at one level, at rest: tan grows evenly."""
    place = np.arange(len(angles)) + 0.5 - len(angles) / 2
    rise = brentq(lambda k: length * np.cos(np.arctan(k * place)).sum() - span, 1e-3, 10)
    return np.arctan(rise * place)


def test_a_string_over_a_held_node_is_as_one_string_of_its_length():
    """A mass on a string over a pulley pulls up a bar, as in Atwood's machine."""
    nodes = [[0, 0, 1, 1], [-1.0, 0, 0, -1.5]]
    over = tc.Structure(nodes, [], [(0, 1, 2, 3)], [], point_mass=[2.0, 0, 0, 1.5], fixed=[1, 2])
    straight = tc.Structure(
        [[0, 3.5], [0, 0]], [], [(0, 1)], [], point_mass=[2.0, 1.5], fixed=[(0, "y"), (1, "y")]
    )
    law, times = tc.LinearStrings(200.0, damping=0.1), np.linspace(0, 1, 11)
    pulled = moved(tc.Model(over, law, gravity=GRAVITY), times, [3.4], input="rest_length")
    # Along the string: one weight pulls back, the other on.
    load = [[-2.0 * GRAVITY, 1.5 * GRAVITY], [0, 0]]
    model = tc.Model(straight, law, external_force=load)
    expected = moved(model, times, [3.4], input="rest_length")
    assert np.abs(pulled[1, 0] + 1 - expected[0, 0]).max() < 1e-11
    assert np.abs(-1.5 - pulled[1, 3] - (expected[0, 1] - 3.5)).max() < 1e-11
    assert np.ptp(expected[0, 0]) > 0.5


def test_a_string_over_a_node_of_a_bar_is_two_strings_of_one_tension():
    """Held force densities that change along the motion would differ: compare accelerations."""
    structure = arm()
    N, gamma = structure.nodes, np.array([3.0, 1.0, 2.0, 1.5])
    cut = tc.Structure(
        N, structure.bars, structure.segments, 1.0, fixed=structure.fixed,
        rollers=structure.rollers, point_mass=structure.point_mass,
    )  # fmt: skip
    each = np.linalg.norm(structure.string_vectors(N), axis=0)
    tension = (gamma * structure.string_length())[structure.segment_string]
    still = np.zeros((2, len(structure.free)))
    one, other = (
        np.array(tc.Model(some).acceleration(N[:, structure.free], still, held))
        for some, held in ((structure, gamma), (cut, tension / each))
    )
    np.testing.assert_allclose(one, other, atol=1e-12)


@pytest.mark.parametrize("planar", [snelson_x, d_bar, t_bar, arm])
def test_the_plane_is_space_without_z(planar):
    """The same motion to round-off, with fewer states and instructions."""
    flat = planar()
    fixed = [*flat.fixed.tolist(), *flat.rollers]
    flat = tc.Structure(
        flat.nodes, flat.bars, flat.paths or flat.strings, flat.bar_mass, fixed=fixed,
        point_mass=flat.point_mass,
    )  # fmt: skip
    deep = tc.Structure(
        np.vstack([flat.nodes, np.zeros(flat.nodes.shape[1])]), flat.bars,
        flat.paths or flat.strings, flat.bar_mass, fixed=fixed, point_mass=flat.point_mass,
    )  # fmt: skip
    law, times = tc.LinearStrings(50.0, 0.2), np.linspace(0, 1, 11)
    load = np.random.default_rng(0).normal(size=flat.nodes.shape)
    models = (
        tc.Model(flat, law, external_force=load),
        tc.Model(deep, law, external_force=np.vstack([load, 0 * load[0]])),
    )
    rest = 0.9 * flat.string_length()
    two, three = (moved(model, times, rest, input="rest_length") for model in models)
    assert np.abs(three[2]).max() == 0.0
    assert np.abs(three[:2] - two).max() < 1e-11
    counts = [model.rest_length_dynamics.n_instructions() for model in models]
    assert counts[0] < 0.8 * counts[1]
    assert models[0].dynamics.size1_in(0) < models[1].dynamics.size1_in(0)


def test_a_d_bar_by_short_strings_comes_near_the_one_of_shared_nodes():
    """Four bars on their own, tied at the joints by strings of 1e-2, 1e-3, 1e-4 m: order one."""
    shared, force_density, times = d_bar(), np.array([10.0, 13.0]), np.linspace(0, 0.5, 6)
    expected = moved(tc.Model(shared), times, force_density)
    assert np.abs(expected[:, :, -1] - shared.nodes).max() > 0.1
    errors = []
    for short in (1e-2, 1e-3, 1e-4):
        tied, held = tied_d_bar(shared, force_density, short)
        ends = moved(tc.Model(tied), times, held, tolerance=1e-10)
        # Bars j and j - 1 end at joint j.
        joints = (ends[:, 0::2] + ends[:, [7, 1, 3, 5]]) / 2
        errors.append(np.abs(joints - expected).max())
    assert errors[0] < 0.02
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 10, rtol=0.4)


def tied_d_bar(shared, force_density, short):
    """The D-bar with bars whose ends are ``short`` apart at each joint, and its force densities.

    Each end is on the side to which its bar pushes, so that the tie between them is taut. Each
    string is one from each of the two ends, with half the force density.
    """
    nodes = np.empty((2, 8))
    ties = np.empty(4)
    for joint in range(4):
        across = np.array([[0, -1], [1, 0]]) @ shared.nodes[:, joint]
        across /= np.linalg.norm(across)
        for bar, end in ((joint, 0), (joint - 1, 1)):
            push = shared.nodes[:, joint] - shared.nodes[:, shared.bars[bar, 1 - end]]
            side = np.sign(push @ across)
            at = shared.nodes[:, joint] + side * short / 2 * across
            nodes[:, 2 * (bar % 4) + end] = at
        ties[joint] = 10.0 * abs(push @ across) / short
    strings = [(0, 3), (7, 4), (1, 6), (2, 5)]  # along x, then along y
    strings += [(7, 0), (1, 2), (3, 4), (5, 6)]
    tied = tc.Structure(nodes, np.arange(8).reshape(4, 2), strings, shared.bar_mass)
    return tied, np.concatenate([np.repeat(force_density / 2, 2), ties])
