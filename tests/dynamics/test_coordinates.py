"""Coordinates for control: counts, bases, and the maps both ways."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.linalg import null_space

import tenscontrol as tc
from tests.dynamics.scenes import random_structure, random_turn, weighted_prism
from tests.oracle import consistent_mass

KINDS = ("nodes", "minimal", "internal")
REDUCED = ("minimal", "internal")
every_kind = pytest.mark.parametrize("kind", KINDS)
every_reduced_kind = pytest.mark.parametrize("kind", REDUCED)
seeds = st.integers(0, 10_000)


def frame(structure, kind):
    return tc.dynamics.coordinates(tc.Model(structure), kind=kind)


def random_state(coordinates, seed, size=0.1):
    """Random q and q̇; bars turn by less than a right angle."""
    return size * np.random.default_rng(seed).uniform(-1, 1, size=(2, coordinates.count))


def flat_square():
    """Two bars that cross in a plane: nothing tells its shape from its mirror image."""
    nodes = [[0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0], [0.0] * 4]
    return tc.Structure(nodes, [[0, 2], [1, 3]], [[0, 1], [1, 2], [2, 3], [3, 0]], bar_mass=1.0)


def scenes():
    prisms = [tc.prism(), tc.prism(5, top_radius=0.3), weighted_prism()]
    return [*prisms, random_structure(3), flat_square()]


def scene(seed):
    return scenes()[seed % 5]


@pytest.mark.parametrize(("kind", "count"), [("nodes", 18), ("minimal", 15), ("internal", 9)])
def test_degrees_of_freedom_of_the_prism(prism, kind, count):
    assert frame(prism, kind).count == count


@pytest.mark.parametrize(("bars", "points"), [(2, 0), (3, 2), (4, 5), (1, 3)])
def test_degrees_of_freedom_are_five_a_bar_and_three_a_string_node(bars, points):
    structure = random_structure(0, bars=bars, points=points)
    counts = [frame(structure, kind).count for kind in KINDS]
    minimal = 5 * bars + 3 * points
    assert counts == [3 * (2 * bars + points), minimal, minimal - 6]


def test_a_structure_on_a_line_has_one_rigid_rotation_less():
    bar = tc.Structure([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]], [[0, 1]], [], bar_mass=1.0)
    assert [frame(bar, kind).count for kind in KINDS] == [6, 5, 0]


@every_reduced_kind
@pytest.mark.parametrize("structure", scenes(), ids=repr)
def test_the_basis_is_mass_orthonormal(structure, kind):
    T = frame(structure, kind).basis
    M = np.kron(consistent_mass(structure), np.eye(3))
    assert np.abs(T.T @ M @ T - np.eye(T.shape[1])).max() < 1e-14


@every_reduced_kind
@pytest.mark.parametrize("structure", scenes(), ids=repr)
def test_the_basis_stretches_no_bar(structure, kind):
    T = frame(structure, kind).basis.reshape(-1, 3, frame(structure, kind).count)
    change = T[structure.bars[:, 1]] - T[structure.bars[:, 0]]
    stretch = np.einsum("ib,bij->bj", structure.bar_vectors(structure.nodes), change)
    assert np.abs(stretch).max() < 1e-14


@pytest.mark.parametrize("structure", scenes(), ids=repr)
def test_internal_motions_carry_no_momentum(structure):
    """Linear and angular momentum vanish: the motion is not one of the whole body."""
    coordinates = frame(structure, "internal")
    M = consistent_mass(structure)
    for column in coordinates.basis.T:
        momenta = M @ column.reshape(-1, 3)
        assert np.abs(momenta.sum(axis=0)).max() < 1e-14
        assert np.abs(np.cross(structure.nodes.T, momenta).sum(axis=0)).max() < 1e-13


@every_kind
@given(seed=seeds)
def test_measuring_a_shape_made_of_coordinates_gives_them_back(kind, seed):
    coordinates = frame(scene(seed), kind)
    q, rates = random_state(coordinates, seed)
    nodes, velocities = coordinates.to_nodes(q), coordinates.to_velocities(q, rates)
    measured = coordinates.measure(nodes, velocities)
    np.testing.assert_allclose(measured, np.concatenate([q, rates]), rtol=0, atol=1e-12)


@every_reduced_kind
@given(seed=seeds)
def test_shapes_made_of_coordinates_have_exact_bars_that_do_not_stretch(kind, seed):
    structure = scene(seed)
    coordinates = frame(structure, kind)
    q, rates = random_state(coordinates, seed, size=0.2)
    nodes, velocities = coordinates.to_nodes(q), coordinates.to_velocities(q, rates)
    B, Bd = structure.bar_vectors(nodes), structure.bar_vectors(velocities)
    length = np.linalg.norm(B, axis=0)
    assert np.abs(length - structure.bar_length).max() < 1e-14
    assert np.abs((B * Bd).sum(axis=0)).max() < 1e-14


@every_reduced_kind
@given(seed=seeds)
def test_velocities_are_the_rate_of_the_shape(kind, seed):
    coordinates = frame(scene(seed), kind)
    q, rates = random_state(coordinates, seed)
    step = 1e-5
    ahead, behind = (coordinates.to_nodes(q + s * rates) for s in (step, -step))
    expected = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(coordinates.to_velocities(q, rates), expected, rtol=0, atol=1e-9)


@given(seed=seeds)
def test_internal_coordinates_do_not_see_a_rigid_motion(seed):
    structure = scene(seed)
    coordinates = frame(structure, "internal")
    q, rates = random_state(coordinates, seed)
    nodes, velocities = coordinates.to_nodes(q), coordinates.to_velocities(q, rates)
    turn = random_turn(seed)
    place, travel = 10 * np.random.default_rng(seed + 1).normal(size=(2, 3, 1))
    here = coordinates.measure(nodes, velocities)
    there = coordinates.measure(turn @ nodes + place, turn @ velocities + travel)
    np.testing.assert_allclose(there, here, rtol=0, atol=1e-12)


@given(seed=seeds)
def test_minimal_coordinates_see_a_translation(seed):
    coordinates = frame(tc.prism(), "minimal")
    q, rates = random_state(coordinates, seed)
    nodes, velocities = coordinates.to_nodes(q), coordinates.to_velocities(q, rates)
    change = coordinates.measure(nodes + np.array([[1.0], [0.0], [0.0]]), velocities)
    change -= coordinates.measure(nodes, velocities)
    # Three bars of 1 kg displaced by 1 m: ‖δq‖² is the mass.
    assert change @ change == pytest.approx(3.0, rel=1e-12)


@every_kind
def test_the_reference_shape_is_the_origin(prism, kind):
    coordinates = frame(prism, kind)
    zero = np.zeros(coordinates.count)
    np.testing.assert_allclose(coordinates.to_nodes(zero), prism.nodes, rtol=0, atol=1e-15)
    measured = coordinates.measure(prism.nodes, np.zeros((3, 6)))
    np.testing.assert_allclose(measured, 0, atol=1e-14)


@every_reduced_kind
@given(seed=seeds)
def test_kinetic_energy_at_the_reference_is_half_the_square_of_the_rates(kind, seed):
    structure = scene(seed)
    coordinates = frame(structure, kind)
    _, rates = random_state(coordinates, seed)
    velocities = coordinates.to_velocities(np.zeros(coordinates.count), rates)
    energy = 0.5 * np.trace(velocities @ consistent_mass(structure) @ velocities.T)
    assert energy == pytest.approx(0.5 * rates @ rates, rel=1e-12)


def test_turning_a_bar_by_a_right_angle_is_refused(prism):
    coordinates = frame(prism, "minimal")
    with pytest.raises(ValueError, match="turns bar 0 by a right angle"):
        coordinates.to_nodes(np.r_[0, 0, 0, 10.0, np.zeros(11)])


@pytest.mark.parametrize(
    "structure",
    [
        tc.library.class2_tower(60),
        tc.library.class2_tower(60, floating=True),
        tc.library.arm(80),
        tc.Structure(  # an arch of bars in space between two supports
            [np.linspace(0, 99, 100), np.sin(np.arange(100)), np.cos(np.arange(100))],
            np.column_stack([np.arange(99), np.arange(1, 100)]), [[0, 50]], 1.0, fixed=[0, 99],
        ),
    ],
    ids=["class2_tower", "floating", "arm", "arch"],
)  # fmt: skip
def test_basis_of_a_long_chain_is_banded_and_spans_what_a_whole_decomposition_does(structure):
    model, d = tc.Model(structure), structure.dimension
    frame = tc.dynamics.coordinates(model, kind="minimal")
    T, rows = frame.sparse_basis.toarray(), structure.free_rows
    M = np.kron(np.asarray(model.mass_matrix().todense()), np.eye(d))[np.ix_(rows, rows)]
    J = (tc.statics.equilibrium_matrix(structure)[:, len(structure.strings) :].T)[:, rows]
    L = np.linalg.cholesky(M)
    whole = null_space(np.linalg.solve(L, J.T).T)
    assert frame.sparse_basis.nnz < 0.7 * np.count_nonzero(T.any(axis=1)) * T.shape[1]
    np.testing.assert_allclose(T[rows].T @ M @ T[rows], np.eye(T.shape[1]), atol=1e-13)
    turned = L.T @ T[rows]
    np.testing.assert_allclose(turned @ turned.T, whole @ whole.T, atol=1e-12)
