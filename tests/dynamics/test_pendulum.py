"""A bar with one fixed end is the physical pendulum of the textbooks."""

import numpy as np
import pytest
from scipy.special import ellipk

import tenscontrol as tc

LENGTH, MASS, GRAVITY = 1.3, 2.0, 9.81


def pendulum(angle, hinge=0):
    """A bar hung at the origin, its free end turned by ``angle`` from the vertical."""
    tip = LENGTH * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    nodes = np.zeros((3, 2))
    nodes[:, 1 - hinge] = tip
    return tc.Structure(nodes, [[0, 1]], [], MASS, fixed=[hinge])


@pytest.mark.parametrize("hinge", [0, 1])
@pytest.mark.parametrize("angle", [1e-4, 1.0, 2.5])
def test_period_is_that_of_the_elliptic_integral(angle, hinge):
    structure = pendulum(angle, hinge)
    model = tc.Model(structure, gravity=GRAVITY)
    small = 2 * np.pi * np.sqrt(2 * LENGTH / (3 * GRAVITY))
    period = small * 2 / np.pi * ellipk(np.sin(angle / 2) ** 2)
    run = tc.simulate(model, period, force_density=[], tolerance=1e-13)
    # Back at the start after the period, to better than 8 digits of the swing.
    np.testing.assert_allclose(run.nodes[:, :, -1], structure.nodes, atol=1e-9 * angle)
    np.testing.assert_allclose(run.velocities[:, :, -1], 0, atol=1e-9)
    # Not there before: half way it hangs on the other side.
    middle = run.nodes[:, 1 - hinge, len(run.time) // 2]
    np.testing.assert_allclose(middle[0], -structure.nodes[0, 1 - hinge], rtol=1e-6)


def test_small_swings_have_the_linear_frequency():
    """About the hanging rest: two equal modes at the physical pendulum's frequency."""
    structure = pendulum(0.0)
    model = tc.Model(structure, gravity=GRAVITY)
    at = tc.OperatingPoint(structure.nodes, [], model.constant_force)
    plant = tc.linearize(model, at, coordinates="minimal")
    expected = np.sqrt(3 * GRAVITY / (2 * LENGTH)) / (2 * np.pi)
    np.testing.assert_allclose(tc.modes(plant).frequency, expected, rtol=1e-12)


def test_conical_swing_keeps_energy_and_vertical_angular_momentum():
    structure = pendulum(0.8)
    model = tc.Model(structure, gravity=GRAVITY)
    velocities = np.zeros((3, 2))
    velocities[1, 1] = 1.7
    run = tc.simulate(model, 10.0, velocities=velocities, force_density=[], tolerance=1e-13)
    assert np.ptp(run.energy) < 1e-9 * np.ptp(run.kinetic_energy)
    assert np.ptp(run.angular_momentum[2]) < 1e-10 * abs(run.angular_momentum[2, 0])
    assert np.ptp(run.angular_momentum[0]) > 1.0  # the support takes the rest
    assert np.ptp(run.nodes[2, 1]) > 0.1


def test_angular_momentum_starts_as_that_of_a_rod():
    structure = pendulum(np.pi / 2)
    model = tc.Model(structure, gravity=GRAVITY)
    velocities = np.zeros((3, 2))
    velocities[1, 1] = 2.0
    run = tc.simulate(model, 0.01, velocities=velocities, force_density=[], step=1e-3)
    assert run.angular_momentum[2, 0] == pytest.approx(MASS * LENGTH**2 / 3 * 2.0 / LENGTH)
    assert run.kinetic_energy[0] == pytest.approx(0.5 * MASS / 3 * 2.0**2)


def test_first_acceleration_of_a_level_bar_is_three_halves_of_gravity():
    model = tc.Model(pendulum(np.pi / 2), gravity=GRAVITY)
    start = model.structure.nodes[:, [1]]
    Ndd = np.array(model.acceleration(start, np.zeros(3), []))
    np.testing.assert_allclose(Ndd.ravel(), [0, 0, -1.5 * GRAVITY], atol=1e-12)


def test_bar_force_is_that_of_the_textbook():
    """At the lowest point λ l holds half the weight and the centripetal force of the free end."""
    model = tc.Model(pendulum(0.0), gravity=GRAVITY)
    speed = 3.0
    nodes = model.structure.nodes[:, [1]]
    lam = float(model.bar_force_density(nodes, [speed, 0, 0], []))
    expected = -(MASS / 3 * speed**2 / LENGTH + MASS / 2 * GRAVITY) / LENGTH
    assert lam == pytest.approx(expected)
