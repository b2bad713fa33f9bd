"""The PBH test and the number of states that no input reaches."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tenscontrol as tc
from tenscontrol.plant.controllability import reached_states, unreached_modes
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
    assert found.margin[weakest] == pytest.approx(0.110, abs=5e-4)
    assert found.pole[weakest] == pytest.approx(14.681j, abs=5e-4)
    pushed = np.linalg.svd(plant.B, compute_uv=False)
    assert np.count_nonzero(pushed > 1e-10 * pushed[0]) == 8


def test_the_self_stress_pushes_nowhere(rest):
    plant = prism_plant(rest, "force_density")
    assert (
        np.abs(plant.B @ rest.force_density).max() < 1e-12 * np.abs(rest.force_density).max() * 10
    )


@every_input
@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_margins_are_those_of_the_quadratic_pencil(rest, held, damping):
    """``y (s² + D s + K) = 0``, ‖y‖ = 1: the margin is ‖y B₂‖ / ‖B₂‖, least among equal poles."""
    plant = prism_plant(rest, held, damping=damping * (held == "rest_length"))
    found = tc.controllability(plant)
    push = plant.B[9:]
    for pole, margin in zip(found.pole, found.margin, strict=True):
        pencil = pole**2 * np.eye(9) - pole * plant.A[9:, 9:] - plant.A[9:, :9]
        U, sizes, _ = np.linalg.svd(pencil)
        y = U[:, sizes < 1e-6 * sizes[0]]
        # By the Gram matrix, not by singular values.
        gram = np.linalg.eigvalsh(y.conj().T @ push @ push.T @ y)
        assert margin == pytest.approx(np.sqrt(gram[0]) / np.linalg.norm(push, 2), rel=1e-6)


@every_input
def test_margins_do_not_depend_on_units(rest, held):
    plant = prism_plant(rest, held)
    expected = tc.controllability(plant)
    fast = np.r_[np.full(9, 1e3), np.ones(9)]  # seconds as milliseconds
    A = replace(plant, A=plant.A * 1e3 / fast * fast[:, None] / 1.0, B=1e9 * plant.B)
    A.A[:9, 9:], A.A[9:, :9] = np.eye(9), 1e6 * plant.A[9:, :9]
    found = tc.controllability(A)
    np.testing.assert_allclose(found.margin, expected.margin, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.pole, 1e3 * expected.pole, rtol=1e-6, atol=1e-3)


# ---- parts that no input reaches ----


def plant_of(rest, stiffness, friction, push):
    """Return a plant ``q̈ + D q̇ + K q = B₂ v`` on nine coordinates, otherwise that of the prism."""
    plant = prism_plant(rest, "rest_length")
    A = np.block([[np.zeros((9, 9)), np.eye(9)], [-stiffness, -friction]])
    return replace(plant, A=A, B=np.vstack([np.zeros_like(push), push]))


def turned(seed=0):
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(9, 9)))[0]


def assert_split(plant, unreachable, growing=0, round_off=1e-8):
    """The count is as expected, and A and B have their form in the basis."""
    found = reached_states(plant)
    assert len(plant.A) - found.count == unreachable
    assert found.growing_states == growing
    T, n = found.basis, found.count
    np.testing.assert_allclose(T.T @ T, np.eye(len(T)), atol=1e-12)
    A = T.T @ (plant.A * found.unit / found.unit[:, None]) @ T
    B = T.T @ (plant.B / found.unit[:, None])
    assert np.abs(A[n:, :n]).max(initial=0) < round_off * np.abs(A).max()
    assert np.abs(B[n:]).max(initial=0) < round_off * np.abs(B).max()


FREQUENCIES = np.array([1.0, 2.0, 2.0, 2.0, 3.0, 3.0, 4.0, 5.0, 6.0]) ** 2


@pytest.mark.parametrize("stiff", [1.0, 1e9])
@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_of_equal_frequencies_inputs_reach_some_combinations(rest, stiff, size):
    """Two inputs on three equal modes, mixed: one combination is out of reach, beside one mode."""
    V = turned()
    push = np.zeros((9, 9))
    push[:, :2] = np.random.default_rng(1).normal(size=(9, 2))
    push[7] = 0  # the mode at 5 rad/s
    squares = FREQUENCIES.copy()
    squares[8] *= stiff
    plant = plant_of(rest, V @ np.diag(squares) @ V.T, np.zeros((9, 9)), size * V @ push)
    # Soft modes beside stiff ones lose digits.
    assert_split(plant, 4, round_off=1e-15 * max(stiff, 1e7))
    lost = unreached_modes(plant)
    np.testing.assert_allclose(2 * np.pi * lost.frequency, [2.0, 5.0], rtol=1e-4)
    np.testing.assert_array_equal(lost.damping, 0.0)


def test_a_drift_that_nothing_reaches_grows(rest):
    """Double zeros: three, on which one input pushes."""
    V = turned(2)
    push = np.zeros((9, 9))
    push[:, 0] = 1.0
    squares = np.r_[np.zeros(3), np.arange(1.0, 7.0)]
    for friction in (0.0, 1e-300):  # by the stiffness, and by poles
        K, D = V @ np.diag(squares) @ V.T, np.full((9, 9), friction)
        plant = plant_of(rest, K, D, V @ push)
        assert_split(plant, 4, growing=4)
        assert list(unreached_modes(plant).frequency) == [0.0, 0.0]


def test_damped_modes_out_of_reach_are_left_alone_and_undamped_ones_found_among_them(rest):
    V = turned(3)
    push = np.random.default_rng(4).normal(size=(9, 9))
    push[[2, 6]] = 0
    damping = np.full(9, 0.3)
    damping[6] = 0.0
    plant = plant_of(rest, V @ np.diag(FREQUENCIES) @ V.T, V @ np.diag(damping) @ V.T, V @ push)
    assert_split(plant, 4)
    np.testing.assert_allclose(2 * np.pi * unreached_modes(plant).frequency, [2.0, 4.0], rtol=1e-9)
    np.testing.assert_allclose(unreached_modes(plant).damping, [0.3 / 4, 0.0], atol=1e-9)


@pytest.mark.parametrize("reached", [True, False])
def test_a_critically_damped_pair_is_one_eigenvector(rest, reached):
    """s = −2 twice with one eigenvector: a defective pole."""
    V = turned(5)
    push = np.random.default_rng(6).normal(size=(9, 9))
    push[6] *= reached
    damping = np.full(9, 0.1)
    damping[6] = 8.0  # 2 ω
    plant = plant_of(rest, V @ np.diag(FREQUENCIES) @ V.T, V @ np.diag(damping) @ V.T, V @ push)
    assert_split(plant, 0 if reached else 2)
    if not reached:
        np.testing.assert_allclose(unreached_modes(plant).damping, 1.0, atol=1e-6)


def test_a_mode_that_grows_out_of_reach(rest):
    V = turned(7)
    push = np.random.default_rng(8).normal(size=(9, 9))
    push[0] = 0
    squares = np.r_[-4.0, np.arange(1.0, 9.0)]
    for friction in (0.0, 0.2):
        plant = plant_of(rest, V @ np.diag(squares) @ V.T, friction * np.eye(9), V @ push)
        assert_split(plant, 2, growing=2 if friction == 0 else 1)
        with pytest.raises(ValueError, match="out of reach of the strings, and grow"):
            tc.LQR(plant)
        assert unreached_modes(plant).damping.min() == -1.0


def test_no_inputs_reach_nothing(rest):
    plant = prism_plant(rest, "rest_length")
    assert tc.controllability(replace(plant, B=plant.B[:, :0])).unreachable == 18
    assert tc.controllability(replace(plant, B=0 * plant.B)).unreachable == 18


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


def test_strings_that_pull_along_bars_push_nowhere():
    """A row of bars in line with its strings: what is left of their forces is round-off."""
    nodes = np.array([[0.0, 1.0, 2.0], [0.0, 0.0, 0.0]]) + 0.1
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    row = tc.Structure(turn @ nodes, [(0, 1), (1, 2)], [(0, 1), (0, 2)], 1.0, fixed=[0])
    model = tc.Model(row, strings=tc.LinearStrings(100.0))
    at = tc.OperatingPoint(row.nodes, [1.0, 1.0])
    for held in INPUTS:
        plant = tc.linearize(model, at, input=held)
        assert tc.controllability(plant).unreachable == len(plant.A) > 0
        with pytest.raises(ValueError, match="none of the 2 states"):
            tc.LQR(plant)
