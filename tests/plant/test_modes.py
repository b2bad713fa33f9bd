"""Modes of the prism: the figures of the theory, zero modes, labels, shapes."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.dynamics.scenes import TOP_FORCE_DENSITY
from tests.oracle import consistent_mass
from tests.plant.scenes import INPUTS, KINDS, prism_plant, weighted_rest

# docs: theory, section 4.
SQUARES = [0.0] * 3 + [204.0035] * 2 + [215.5314] + [235.6922] * 3
FREQUENCIES = [2.31873, 2.89989, 2.89989, 3.25079, 3.25079, 4.49660, 4.52237, 4.52237, 5.16460]

ZERO_MODES = {
    ("force_density", "nodes"): 12,
    ("force_density", "minimal"): 9,
    ("force_density", "internal"): 3,
    ("rest_length", "nodes"): 9,
    ("rest_length", "minimal"): 6,
    ("rest_length", "internal"): 0,
}
every_plant = pytest.mark.parametrize(
    ("held", "kind"), [(held, kind) for held in INPUTS for kind in KINDS]
)


def of(rest, held, kind="internal", damping=0.0):
    return tc.modes(prism_plant(rest, held, kind, damping))


def stiffness_of(shape, rest, held):
    """Rayleigh quotient of a shape by the energies of the oracle, ω², with k = 100 N/m."""
    structure = rest.structure
    S, B = structure.string_vectors(structure.nodes), structure.bar_vectors(structure.nodes)
    ds, db = structure.string_vectors(shape), structure.bar_vectors(shape)
    geometric = (rest.force_density * (ds**2).sum(axis=0)).sum()
    geometric -= (rest.bar_force_density * (db**2).sum(axis=0)).sum()
    stretch = (S * ds).sum(axis=0) / np.linalg.norm(S, axis=0)
    # Held rest length: T = k(l - l0) adds (k - γ) times the squared change of length.
    material = ((100.0 - rest.force_density) * stretch**2).sum() if held == "rest_length" else 0.0
    assert np.abs((B * db).sum(axis=0)).max() < 1e-12
    kinetic = np.trace(shape @ consistent_mass(structure) @ shape.T)
    return (geometric + material) / kinetic


def test_frequencies_with_force_density_held(rest):
    squares = (2 * np.pi * of(rest, "force_density").frequency) ** 2
    np.testing.assert_allclose(squares, SQUARES, rtol=0, atol=5.1e-5)


def test_frequencies_with_rest_length_held(rest):
    np.testing.assert_allclose(of(rest, "rest_length").frequency, FREQUENCIES, rtol=0, atol=5.1e-6)


@every_plant
def test_number_of_zero_modes(rest, held, kind):
    found = of(rest, held, kind)
    assert np.count_nonzero(found.frequency == 0.0) == ZERO_MODES[held, kind]
    assert found.frequency[ZERO_MODES[held, kind] :].min() > 2.0


@every_plant
def test_the_other_frequencies_do_not_depend_on_the_coordinates(rest, held, kind):
    inner = of(rest, held, "internal").frequency
    nonzero = inner[inner > 0]
    np.testing.assert_allclose(of(rest, held, kind).frequency[-len(nonzero) :], nonzero, rtol=1e-10)


@every_plant
def test_labels_of_the_zero_modes(rest, held, kind):
    labels = of(rest, held, kind).label[: ZERO_MODES[held, kind]]
    expected = ["constraint"] * 3 if kind == "nodes" else []
    expected += ["rigid"] * 6 if kind != "internal" else []
    expected += ["affine"] * 3 if held == "force_density" else []
    assert list(labels) == expected


@pytest.mark.parametrize(("held", "place"), [("force_density", 5), ("rest_length", 0)])
def test_the_twist_is_the_mechanism(rest, held, place):
    found = of(rest, held)
    assert [i for i, label in enumerate(found.label) if label == "mechanism"] == [place]


def twist_of(structure):
    """The one motion that changes no length and carries no momentum, from singular values."""
    mass = consistent_mass(structure)
    centred = structure.nodes - structure.nodes.mean(axis=1, keepdims=True)
    rigid = [np.tile(axis, (6, 1)) for axis in np.eye(3)]
    rigid += [np.cross(axis, centred.T) for axis in np.eye(3)]
    momenta = np.array([(mass @ motion).ravel() for motion in rigid])
    conditions = np.vstack([tc.statics.equilibrium_matrix(structure).T, momenta])
    _, sizes, Vt = np.linalg.svd(conditions)
    assert sizes[-2] > 1e-3 > 1e-12 > sizes[-1]
    return Vt[-1].reshape(6, 3).T


@pytest.mark.parametrize("held", INPUTS)
def test_the_mechanism_has_its_share_of_the_kinetic_energy(rest, held):
    found, twist = of(rest, held), twist_of(rest.structure)
    mass = consistent_mass(rest.structure)
    shares = []
    for shape in np.moveaxis(found.shape, 2, 0):
        along = np.trace(shape @ mass @ twist.T) ** 2
        whole = np.trace(shape @ mass @ shape.T) * np.trace(twist @ mass @ twist.T)
        shares.append(along / whole)
    assert [share >= 0.95 for share in shares] == [label == "mechanism" for label in found.label]


def test_affine_modes_are_affine_and_keep_the_bars(rest):
    found = of(rest, "force_density")
    fields = np.vstack([rest.structure.nodes, np.ones(6)])
    for i, label in enumerate(found.label):
        if label != "affine":
            continue
        shape = found.shape[:, :, i]
        residual = shape - shape @ np.linalg.pinv(fields) @ fields
        assert np.abs(residual).max() < 1e-10


def test_rigid_modes_keep_every_distance(rest):
    found = of(rest, "rest_length", "minimal")
    N = rest.structure.nodes
    for i in range(6):
        shape = found.shape[:, :, i]
        for a in range(6):
            for b in range(a):
                assert abs((N[:, a] - N[:, b]) @ (shape[:, a] - shape[:, b])) < 1e-10


@pytest.mark.parametrize("held", INPUTS)
def test_shapes_have_the_energies_of_their_frequencies(rest, held):
    found = of(rest, held)
    for i, frequency in enumerate(found.frequency):
        square = stiffness_of(found.shape[:, :, i], rest, held)
        assert square == pytest.approx((2 * np.pi * frequency) ** 2, abs=1e-8)


@every_plant
def test_shapes_are_scaled_to_a_largest_displacement_of_one(rest, held, kind):
    shape = of(rest, held, kind).shape
    np.testing.assert_allclose(np.linalg.norm(shape, axis=0).max(axis=0), 1.0, rtol=1e-12)


def test_shapes_in_node_coordinates_are_independent(rest):
    shapes = of(rest, "rest_length", "nodes").shape.reshape(18, -1)
    assert np.linalg.cond(shapes) < 1e3


@every_plant
def test_without_damping_there_is_none(rest, held, kind):
    found = of(rest, held, kind)
    np.testing.assert_array_equal(found.damping, 0.0)
    np.testing.assert_allclose(np.abs(found.pole), 2 * np.pi * found.frequency, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_damped_modes_are_the_eigenvalues_of_the_plant(rest, kind):
    plant = prism_plant(rest, "rest_length", kind, damping=0.5)
    found = tc.modes(plant)
    moving = found.pole[found.frequency > 0]
    assert (found.damping[found.frequency > 0] > 0).all()
    eigenvalues = np.linalg.eigvals(plant.A)
    above = eigenvalues[eigenvalues.imag > 1.0]
    assert len(moving) == len(above) == 9
    for pole in moving:
        assert np.abs(above - pole).min() < 1e-9 * abs(pole)
    np.testing.assert_allclose(
        found.damping[found.frequency > 0], -moving.real / np.abs(moving), rtol=1e-12
    )


@pytest.mark.parametrize(("kind", "zeros"), [("nodes", 9), ("minimal", 6), ("internal", 0)])
def test_damping_leaves_the_zero_modes_at_zero(rest, kind, zeros):
    found = of(rest, "rest_length", kind, damping=0.5)
    np.testing.assert_array_equal(found.frequency[:zeros], 0.0)
    np.testing.assert_array_equal(found.damping[:zeros], 0.0)
    assert found.frequency[zeros:].min() > 2.0


def test_light_string_nodes_add_the_modes_of_masses_on_springs():
    """A gram between two halves of γ = 60 and k = 300 N/m: ω² = 2 γ/m across and 2 k/m along."""
    plant = prism_plant(weighted_rest(mass=1e-3), "rest_length", stiffness=300.0)
    found = tc.modes(plant).frequency
    assert len(found) == 18
    across, along = (np.sqrt(2 * each / 1e-3) / (2 * np.pi) for each in (60.0, 300.0))
    np.testing.assert_allclose(found[9:15], across, rtol=0.01)
    np.testing.assert_allclose(found[15:], along, rtol=0.01)
    assert found[8] < 0.2 * across


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_labels_do_not_depend_on_the_size(size):
    prism = tc.prism(radius=0.5 * size, height=size)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    plant = tc.linearize(model, tc.prestress(prism, TOP_FORCE_DENSITY), input="rest_length")
    labels = tc.modes(plant).label
    assert (labels[0], labels[-1]) == ("mechanism", "affine")
