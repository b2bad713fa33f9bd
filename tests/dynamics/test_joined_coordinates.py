"""Coordinates where bars share nodes: counts, bases and maps, in the plane and in space."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.plant.joined import SCENES, d_bar, free_d_bar, spine

every_scene = pytest.mark.parametrize("structure", SCENES.values(), ids=SCENES)
every_reduced_kind = pytest.mark.parametrize("kind", ["minimal", "internal"])


def frame(structure, kind):
    return tc.dynamics.coordinates(tc.Model(structure), kind=kind)


def constraints(structure):
    bars = np.arange(len(structure.bars))
    return tc.structure.blocks.bar_rows(structure, bars, structure.nodes).toarray()[
        :, structure.free_rows
    ]


def mass(structure):
    node_mass = tc.structure.blocks.node_mass(structure).toarray()
    return np.kron(node_mass, np.eye(structure.dimension))


def random_state(coordinates, seed=0, size=0.01):
    return size * np.random.default_rng(seed).uniform(-1, 1, size=(2, coordinates.count))


@every_scene
def test_dimension_is_coordinates_less_rank(structure):
    rank = np.linalg.matrix_rank(constraints(structure), tol=1e-9)
    assert frame(structure, "nodes").count == len(structure.free_rows)
    assert frame(structure, "minimal").count == len(structure.free_rows) - rank


def test_known_dimensions():
    counts = {name: frame(each, "minimal").count for name, each in SCENES.items()}
    assert counts["d_bar"] == 1
    assert counts["free_d_bar"] == 4
    assert counts["arm"] == 2
    assert counts["spine"] == 6
    assert counts["tower"] == 12
    assert frame(free_d_bar(), "internal").count == 1
    assert frame(spine(), "internal").count == 12


@every_scene
@every_reduced_kind
def test_the_basis_is_mass_orthonormal_and_stretches_no_bar(structure, kind):
    T = frame(structure, kind).basis
    np.testing.assert_allclose(T.T @ mass(structure) @ T, np.eye(T.shape[1]), rtol=0, atol=2e-14)
    assert np.abs(constraints(structure) @ T[structure.free_rows]).max() < 1e-13
    assert not T[structure.fixed_rows].any()


@every_scene
@every_reduced_kind
def test_maps_are_inverse_and_exact(structure, kind):
    coordinates = frame(structure, kind)
    q, rates = random_state(coordinates)
    nodes, velocities = coordinates.to_nodes(q), coordinates.to_velocities(q, rates)
    measured = coordinates.measure(nodes, velocities)
    np.testing.assert_allclose(measured, np.r_[q, rates], rtol=0, atol=1e-13)
    B, Bd = structure.bar_vectors(nodes), structure.bar_vectors(velocities)
    np.testing.assert_allclose(np.linalg.norm(B, axis=0), structure.bar_length, rtol=1e-14)
    assert np.abs((B * Bd).sum(axis=0)).max() < 1e-14
    held = structure.fixed_rows
    np.testing.assert_array_equal(
        nodes.ravel(order="F")[held], structure.nodes.ravel(order="F")[held]
    )
    assert not velocities.ravel(order="F")[held].any()


@every_scene
@every_reduced_kind
def test_velocities_are_the_rate_of_the_shape(structure, kind):
    coordinates = frame(structure, kind)
    q, rates = random_state(coordinates, 1)
    step = 1e-5
    ahead, behind = (coordinates.to_nodes(q + sign * rates) for sign in (step, -step))
    expected = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(coordinates.to_velocities(q, rates), expected, rtol=0, atol=1e-9)


@every_scene
def test_expressions_are_the_maps(structure):
    import casadi as ca

    coordinates = frame(structure, "minimal")
    z = ca.SX.sym("z", 2 * coordinates.count)
    motion = ca.Function("motion", [z], list(coordinates.kept_lengths(*coordinates.displaced(z))))
    for size in (0.005, 0.015):
        q, rates = random_state(coordinates, 2, size)
        nodes, velocities = (np.array(part) for part in motion(np.r_[q, rates]))
        np.testing.assert_allclose(nodes, coordinates.to_nodes(q), rtol=0, atol=1e-13)
        expected = coordinates.to_velocities(q, rates)
        np.testing.assert_allclose(velocities, expected, rtol=0, atol=1e-12)


def test_out_of_reach_is_refused_and_no_number():
    import casadi as ca

    coordinates = frame(d_bar(), "minimal")
    with pytest.raises(ValueError, match=r"bars \[0, 1, 2, 3\], which are joined"):
        coordinates.to_nodes([3.0])
    z = ca.SX.sym("z", 2)
    nodes = ca.Function("nodes", [z], [coordinates.kept_lengths(*coordinates.displaced(z))[0]])
    assert np.isnan(np.array(nodes([3.0, 0.0]))).any()


def test_a_turned_vertebra_is_reached():
    """A rigid body turned by 40° about z: q is what the turn gives, and the map finds the turn."""
    structure = spine(1)
    coordinates = frame(structure, "minimal")
    angle = np.deg2rad(40)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    nodes = structure.nodes.copy()
    nodes[:, 5:] = turn @ nodes[:, 5:]
    q = coordinates.measure(nodes, 0 * nodes)[: coordinates.count]
    np.testing.assert_allclose(coordinates.to_nodes(q), nodes, rtol=0, atol=1e-13)


# What supports leave: a shape is laid over the reference along it, and along nothing else.


def cross(fixed, dimension=2):
    """Two bars that cross and four strings, on some supports."""
    nodes = np.array([[0.0, 1.0, 1.1, 0.1], [0.0, 0.1, 1.0, 0.9], [0.0, 0.3, 0.1, 0.4]])[:dimension]
    strings = [[0, 1], [1, 2], [2, 3], [3, 0]]
    return tc.Structure(nodes, [[0, 2], [1, 3]], strings, [1.0, 1.5], fixed=fixed)


def planar_turn(angle, dimension=2, axis=None):
    from scipy.linalg import expm

    if dimension == 2:
        return expm(np.array([[0, -angle], [angle, 0]]))
    axis = np.array(axis) / np.linalg.norm(axis)
    return expm(angle * np.cross(axis, np.eye(3)).T)


CASES = {
    "plane": (cross([]), 3, lambda N: planar_turn(2.5) @ N + [[3.0], [-1.0]]),
    "pin": (cross([0]), 1, lambda N: planar_turn(-2.0) @ N),
    "roller": (cross([(0, "y")]), 2, lambda N: planar_turn(1.2) @ N + [[2.0], [0.0]]),
    "two rollers": (cross([(0, "y"), (2, "y")]), 1, lambda N: N + np.array([[0.7], [0.0]])),
    "pin and roller": (cross([0, (1, "y")]), 0, lambda N: N),
    "hinge": (
        cross([0, 1], 3), 1,
        lambda N: planar_turn(1.9, 3, N[:, 1] - N[:, 0]) @ (N - N[:, :1]) + N[:, :1],
    ),
    "on a table": (
        cross([(0, "z"), (1, "z"), (2, "z")], 3), 3,
        lambda N: planar_turn(1.0, 3, [0, 0, 1]) @ N + [[1.0], [2.0], [0.0]],
    ),
}  # fmt: skip


@pytest.mark.parametrize(("structure", "left", "move"), CASES.values(), ids=CASES)
def test_internal_coordinates_do_not_see_what_supports_leave(structure, left, move):
    coordinates = frame(structure, "internal")
    assert frame(structure, "minimal").count - coordinates.count == left
    q, rates = random_state(coordinates, 3)
    nodes, velocities = coordinates.to_nodes(q), coordinates.to_velocities(q, rates)
    measured = coordinates.measure(nodes, velocities)
    np.testing.assert_allclose(measured, np.r_[q, rates], rtol=0, atol=1e-12)
    # A velocity turns as the difference of two shapes that the motion does not tell apart.
    held = structure.fixed
    turned = move(nodes + shift_only(velocities, held)) - move(nodes) if left else velocities
    moved = coordinates.measure(move(nodes), turned)
    np.testing.assert_allclose(moved, measured, rtol=0, atol=1e-12)


def shift_only(velocities, held):
    """Velocities, zero at fixed nodes: there a motion may take its axis from."""
    assert not velocities[:, held].any()
    return velocities


def test_a_long_chain_keeps_its_lengths_by_sparse_factors():
    """Twice as long, it has twice as many entries, and random shapes of it have their lengths."""
    entries = []
    for stages in (40, 80):
        tower = tc.library.class2_tower(stages)
        c = tc.dynamics.coordinates(tc.Model(tower))
        q, rates = 1e-3 * np.random.default_rng(0).normal(size=(2, c.count))
        nodes, velocities = c.to_nodes(q), c.to_velocities(q, rates)
        vectors = tower.bar_vectors(nodes)
        length = np.linalg.norm(vectors, axis=0)
        np.testing.assert_allclose(length, tower.bar_length, rtol=1e-13)
        turning = (vectors * tower.bar_vectors(velocities)).sum(axis=0)
        np.testing.assert_allclose(turning, 0.0, atol=1e-13)
        moved = (nodes - tower.nodes).ravel(order="F")
        np.testing.assert_allclose(c.project(moved), q, rtol=0, atol=1e-12)
        factors = [each.factors(vectors[:, each.block.independent]) for each in c._normals]
        entries.append(sum(each.L.nnz + each.U.nnz for each in factors))
    assert entries[1] < 2.2 * entries[0]
