"""Shapes of free structures at places in space, and what strings alone cannot do."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.shape import NodesAt, PointAt, ShapeError, shape_path, shape_target

BUILT = {
    "prism": (tc.prism, 100.0, 17.3205),
    "tower": (lambda: tc.prism_tower(stages=2), 1000.0, 20.0),
    "six-bar ball": (lambda: tc.library.six_bar_ball(bar_length=1.0), 1000.0, 20.0),
}


@cache
def model(name):
    structure, stiffness, _ = BUILT[name]
    return tc.Model(structure(), strings=tc.LinearStrings(stiffness, damping=2.0))


def target(name, demands, **settings):
    return shape_target(model(name), demands, force_density=BUILT[name][2], **settings)


def highest(name):
    nodes = model(name).structure.nodes
    node = int(nodes[2].argmax())
    return node, nodes[:, node]


def momenta(name, nodes, velocities):
    """Linear and angular momentum about the origin, by the whole mass matrix."""
    carried = velocities @ model(name).mass_matrix().toarray()
    return np.r_[carried.sum(axis=1), np.cross(nodes.T, carried.T).sum(axis=0)]


@pytest.mark.parametrize("name", BUILT)
def test_a_node_comes_to_a_point_while_the_centre_of_mass_stays(name):
    start = model(name).structure.nodes
    node, place = highest(name)
    wanted = place + np.array([0.06, 0.0, -0.03])
    found = target(name, NodesAt([node], wanted[:, None]), place="centre")
    np.testing.assert_allclose(found.nodes[:, node], wanted, atol=1e-12)
    np.testing.assert_allclose(momenta(name, start, found.nodes - start), 0.0, atol=1e-12)


def test_the_plant_brings_the_node_there():
    """On the nonlinear plant, in space. A path through small steps knows how the whole turns."""
    name = "prism"
    nodes = model(name).structure.nodes
    node, place = highest(name)
    wanted = place + np.array([0.1, 0.0, 0.0])
    goal = target(name, NodesAt([node], wanted[:, None]), place="centre")
    rest = tc.prestress(model(name).structure, force_density=BUILT[name][2])
    path = shape_path(model(name), rest, goal, duration=1.5, step=0.02, place="centre")
    for k in (10, 40, -10):
        left = momenta(name, path.nodes[:, :, k], path.velocities[:, :, k])
        np.testing.assert_allclose(left, 0.0, atol=1e-12)
    plant = tc.linearize(model(name), rest, input="rest_length")
    mpc = tc.MPC(plant, horizon=12, sample_time=0.02, reference=path.reference())
    run = tc.simulate(model(name), 2.5, nodes, controller=mpc, step=2e-3, error="none")
    assert np.linalg.norm(run.nodes[:, node, -1] - wanted) < 1.5e-4
    assert np.linalg.norm(run.nodes[:, :, -1] - path.nodes[:, :, -1], axis=0).max() < 6e-5


@pytest.mark.parametrize(("name", "place"), [("prism", "anywhere"), ("prism", "centre")])
def test_demands_that_only_move_the_whole_are_refused(name, place):
    nodes = model(name).structure.nodes
    far = [0.1, 0.0, 0.0]
    for demand in (
        NodesAt(range(nodes.shape[1]), nodes + np.array([far]).T),
        PointAt(range(nodes.shape[1]), nodes.mean(axis=1) + far),
    ):
        with pytest.raises(ShapeError, match="cannot move the centre of mass") as caught:
            target(name, demand, place=place)
        if place == "centre":
            at = caught.value.nearest.nodes
            np.testing.assert_allclose(momenta(name, nodes, at - nodes), 0.0, atol=1e-10)


def test_a_path_to_the_same_shape_elsewhere_is_refused():
    prism = model("prism").structure
    ends = [
        tc.prestress(replace(prism, nodes=prism.nodes + off), force_density=17.3205)
        for off in (0.0, 0.2)
    ]
    with pytest.raises(ValueError, match=r"a rigid-body motion of up to 0\.346 m"):
        shape_path(model("prism"), *ends, duration=1.0)


def test_a_supported_structure_is_in_space_already():
    standing = tc.Model(replace(tc.prism(), fixed=[3, 4, 5]), strings=tc.LinearStrings(100.0))
    point = PointAt([0, 1, 2], [0.1, 0.05], directions="xy")
    anywhere, centre = (
        shape_target(standing, point, force_density=60.0, place=place)
        for place in ("anywhere", "centre")
    )
    np.testing.assert_array_equal(anywhere.nodes, centre.nodes)
    with pytest.raises(ValueError, match="place is 'here', expected one of"):
        shape_target(standing, point, place="here")


def test_a_free_structure_is_not_carried_farther_than_its_size():
    bars = tc.library.d_bar()
    far = NodesAt([1], bars.nodes[:, [1]] + [[9.0], [0.0]])
    with pytest.raises(ShapeError, match="more than the size of the structure, 2 m") as error:
        shape_target(tc.Model(bars), far, force_density=20.0)
    nearest = error.value.nearest
    np.testing.assert_allclose(nearest.nodes[0, 1], 9.0)
    assert nearest.residual < 1e-9
