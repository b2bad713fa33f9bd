"""The PBH test and the number of states that no input reaches."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tenscontrol as tc
from tests.plant.scenes import INPUTS, KINDS, prism_plant

UNREACHABLE = {"nodes": 18, "minimal": 12, "internal": 0}
every_kind = pytest.mark.parametrize("kind", KINDS)
every_input = pytest.mark.parametrize("held", INPUTS)


@every_kind
@every_input
def test_the_number_of_unreachable_states(rest, held, kind):
    """Of 36, 30, 18 states: 2 a bar constraint, 2 a rigid motion; in node coordinates both."""
    found = tc.controllability(prism_plant(rest, held, kind))
    assert found.unreachable == UNREACHABLE[kind]
    assert found.is_controllable == (kind == "internal")


def test_the_weakest_mode_is_the_twist(rest):
    """Nine strings push on eight directions: the ninth is reached through the stiffness."""
    plant = prism_plant(rest, "force_density")
    found = tc.controllability(plant)
    weakest = found.margin.argmin()
    assert found.margin[weakest] == pytest.approx(0.025, abs=5e-4)
    assert found.pole[weakest] == pytest.approx(14.681j, abs=5e-4)
    pushed = np.linalg.svd(plant.B, compute_uv=False)
    assert np.count_nonzero(pushed > 1e-10 * pushed[0]) == 8


def test_the_self_stress_pushes_nowhere(rest):
    plant = prism_plant(rest, "force_density")
    assert (
        np.abs(plant.B @ rest.force_density).max() < 1e-12 * np.abs(rest.force_density).max() * 10
    )


@every_input
def test_margins_are_those_of_the_matrix_pencil(rest, held):
    plant = prism_plant(rest, held)
    found = tc.controllability(plant)
    for pole, margin in zip(found.pole, found.margin, strict=True):
        pencil = np.hstack([pole * np.eye(18) - plant.A, plant.B])
        # By the Gram matrix, not by singular values.
        gram = np.linalg.eigvalsh(pencil @ pencil.conj().T)
        assert margin == pytest.approx(np.sqrt(gram[0]), rel=1e-6)


@every_kind
@every_input
def test_every_eigenvalue_of_the_plant_is_among_the_poles(rest, held, kind):
    plant = prism_plant(rest, held, kind)
    poles = tc.controllability(plant).pole
    for value in np.linalg.eigvals(plant.A):
        assert np.abs(poles - (value.real + 1j * abs(value.imag))).min() < 1e-4


def test_the_reachable_space_is_that_of_the_gramian(rest):
    """Rank of the discrete controllability Gramian over many samples, in minimal coordinates."""
    plant = prism_plant(rest, "rest_length", "minimal", damping=0.5)
    step, column, _ = plant.discretize(0.05)
    gramian = np.zeros_like(step)
    for _ in range(200):
        gramian += column @ column.T
        column = step @ column
    sizes = np.linalg.svd(gramian, compute_uv=False)
    assert np.count_nonzero(sizes > 1e-12 * sizes[0]) == 30 - tc.controllability(plant).unreachable


def test_inputs_that_keep_a_symmetry_reach_only_motions_that_have_it(rest):
    """All top strings wound alike: of nine internal motions, those with the threefold symmetry."""
    plant = prism_plant(rest, "rest_length")
    alike = plant.B[:, :3].sum(axis=1, keepdims=True)
    found = tc.controllability(replace(plant, B=np.hstack([alike, np.zeros((18, 8))])))
    assert 18 - found.unreachable == 2 * symmetric_motions(plant)
    assert 0 < symmetric_motions(plant) < 9


def symmetric_motions(plant):
    """Number of internal motions that a turn of the prism by a third maps onto themselves."""
    turn = Rotation.from_euler("z", 120, degrees=True).as_matrix()
    following = np.array([1, 2, 0, 4, 5, 3])
    T = plant.basis.reshape(6, 3, -1)
    turned = np.empty_like(T)
    turned[following] = np.einsum("ij,njk->nik", turn, T)
    action = plant.coordinates.project(turned.reshape(18, -1))
    return np.count_nonzero(np.abs(np.linalg.eigvals(action) - 1) < 1e-9)
