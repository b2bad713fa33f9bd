"""The ground of a run as a view shows it."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.simulation.drawn_ground import drawn_ground


def ball():
    return tc.library.six_bar_ball()


def motion(height=1.0):
    """Two states of a ball, the second a metre along x."""
    return ball().nodes[:, :, None] + np.array([[0.0, 1.0], [0.0, 0.0], [height, height]])[:, None]


def test_a_plane_reaches_beyond_the_motion_and_lies_on_its_height():
    nodes = motion()
    (grid,) = drawn_ground([tc.Ground(stiffness=1e3, height=0.2)], None, nodes)["ground"]
    assert grid.shape == (3, 2, 2)
    np.testing.assert_allclose(grid[2], 0.2)
    for axis in (0, 1):
        assert grid[axis].min() < nodes[axis].min()
        assert grid[axis].max() > nodes[axis].max()


def test_a_tilted_plane_contains_its_points():
    normal = np.array([0.6, 0.0, 0.8])
    law = tc.Ground(stiffness=1e3, normal=normal, height=-0.3)
    (grid,) = drawn_ground([law], None, motion())["ground"]
    np.testing.assert_allclose(normal @ grid.reshape(3, -1), -0.3)


def test_a_curved_ground_has_the_height_of_its_function():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    law = tc.Ground(stiffness=1e3, height=ca.Function("h", [x, y], [0.1 * ca.sin(x) + 0.2 * y]))
    (grid,) = drawn_ground([law], None, motion())["ground"]
    assert grid.shape == (3, 33, 33)
    np.testing.assert_allclose(grid[2], 0.1 * np.sin(grid[0]) + 0.2 * grid[1], atol=1e-12)


def test_in_the_plane_it_is_a_line():
    x = ca.SX.sym("x")
    law = tc.Ground(stiffness=1e3, height=ca.Function("h", [x], [x**2]))
    nodes = tc.library.d_bar().nodes[:, :, None]
    curve, line = drawn_ground([law, tc.Ground(stiffness=1e3)], None, nodes)["ground"]
    assert curve.shape == (2, 33, 1)
    np.testing.assert_allclose(curve[1], curve[0] ** 2)
    assert line.shape == (2, 2, 1)
    np.testing.assert_allclose(line[1], 0.0)


@pytest.mark.parametrize("height", [-50.0, 50.0])
def test_a_ground_that_is_far_away_is_left_out(height):
    assert drawn_ground([tc.Ground(stiffness=1e3, height=height)], None, motion())["ground"] == ()


def test_nodes_that_press_are_those_with_a_normal_force():
    model = tc.Model(ball(), gravity=9.81, ground=tc.Ground(stiffness=1e4, friction=0.5))
    gamma = tc.prestress(ball(), 200.0).force_density
    start = ball().nodes + np.array([[0.0], [0.0], [0.05 - ball().nodes[2].min()]])
    run = tc.simulate(model, 0.2, start, force_density=gamma, step=1e-3)
    found = drawn_ground(run.ground, run.contacts, run.nodes)["pressed"]
    depth = -run.nodes[2]
    assert found.any()
    assert not found[depth < 0].any()
    assert found[depth > 1e-4].all()
