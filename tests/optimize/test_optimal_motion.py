"""Optimal motions against closed forms, and of the arm against its replay."""

import numpy as np

import tenscontrol as tc
from tenscontrol.status import Status

# A mass on a rail between two strings: kg, m, N, and how far away they are fixed, m.
MASS, WAY, FORCE, REACH = 2.0, 0.4, 3.0, 20.0


def rail(place):
    """Return the structure with its mass at a place, m."""
    return tc.Structure(
        [[-REACH, place, REACH], [0.0, 0.0, 0.0]],
        bars=[],
        strings=[[0, 1], [1, 2]],
        bar_mass=None,
        fixed=[0, 2, (1, "y")],
        point_mass=[0.0, MASS, 0.0],
    )


def along_rail(**arguments):
    """Return the optimal motion along the rail."""
    ends = [
        tc.prestress(rail(x), 1 / np.array([REACH + x, REACH - x])) for x in (-WAY / 2, WAY / 2)
    ]
    return tc.optimal_motion(tc.Model(rail(-WAY / 2)), *ends, **arguments)


def force(motion):
    """Return the force on the mass in the middle of each interval, N, and when, s."""
    time = (motion.time[1:] + motion.time[:-1]) / 2
    run = tc.simulate(motion.model, motion.duration, force_density=motion.profile, error="none")
    x = np.interp(time, run.time, run.nodes[0, 1])
    left, right = motion.profile.at(time)
    return right * (REACH - x) - left * (REACH + x), time


def test_fastest_motion_along_a_rail_is_bang_bang():
    motion = along_rail(max_tension=FORCE, intervals=20)
    assert motion.status is Status.OK
    np.testing.assert_allclose(motion.duration, 2 * np.sqrt(MASS * WAY / FORCE), rtol=1e-6)
    pushed = force(motion)[0]
    np.testing.assert_allclose(pushed, np.repeat([FORCE, -FORCE], 10), rtol=1e-4)
    assert motion.goal_miss < 1e-6
    assert motion.peak_tension < FORCE * (1 + 1e-5)


def test_motion_of_least_effort_is_a_cubic():
    duration = 1.5
    motion = along_rail(minimize="effort", duration=duration, intervals=20)
    largest = 6 * MASS * WAY / duration**2
    pushed, time = force(motion)
    np.testing.assert_allclose(pushed, largest * (1 - 2 * time / duration), atol=1e-4 * largest)
    share = motion.time / duration
    way = WAY * (3 * share**2 - 2 * share**3) - WAY / 2
    np.testing.assert_allclose(motion.nodes[0, 1], way, atol=1e-4 * WAY)
    np.testing.assert_allclose(motion.cost, 12 * (MASS * WAY) ** 2 / duration**3, rtol=1e-4)
