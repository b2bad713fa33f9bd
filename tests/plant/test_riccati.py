"""Riccati equations of regulators and filters: residual, duality and the check of a solution."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.plant.linear_plant import tall_qr
from tenscontrol.plant.riccati import (
    check_riccati,
    filter_riccati,
    regulator_riccati,
    riccati_residual,
)

TRANSITION = np.array([[1.0, 0.1], [-0.2, 0.95]])
DRIVE = np.array([[0.01], [0.3]])
OUTPUT = np.array([[1.0, 0.0]])
NOISE = np.array([0.05])


def test_filter_is_the_dual_of_the_regulator():
    gain, P, poles, residual = filter_riccati(TRANSITION, DRIVE, OUTPUT, NOISE)
    dual_gain, dual_poles, dual_P, _ = regulator_riccati(
        TRANSITION.T, OUTPUT.T, DRIVE @ DRIVE.T, np.diag(NOISE**2), np.ones(2), 1.0, discrete=True
    )
    np.testing.assert_allclose(P, dual_P, rtol=1e-9)
    # The regulator's gain predicts: Φ times that of a correction.
    np.testing.assert_allclose(TRANSITION @ gain, dual_gain.T, rtol=1e-9)
    np.testing.assert_allclose(np.sort(np.abs(poles)), np.sort(np.abs(dual_poles)), rtol=1e-9)
    assert residual < 1e-12


def test_residual_is_that_of_the_covariance_recursion():
    _, P, _, _ = filter_riccati(TRANSITION, DRIVE, OUTPUT, NOISE)
    R = np.diag(NOISE**2)
    gain = P @ OUTPUT.T @ np.linalg.inv(OUTPUT @ P @ OUTPUT.T + R)
    after = TRANSITION @ (P - gain @ OUTPUT @ P) @ TRANSITION.T + DRIVE @ DRIVE.T
    np.testing.assert_allclose(after, P, rtol=1e-9)
    dual = TRANSITION.T, OUTPUT.T, DRIVE @ DRIVE.T, R
    assert riccati_residual(*dual, P, discrete=True) < 1e-12
    assert riccati_residual(*dual, 1.01 * P, discrete=True) > 1e-4


@pytest.mark.parametrize(
    ("residual", "pole", "discrete", "expected"),
    [
        (1e-3, 0.5, True, r"residual of 1\.0e-03, expected at most 1e-06"),
        (np.nan, 0.5, True, "residual of nan"),
        (0.0, 1.1, True, r"not stable by 1\.0e-01"),
        (0.0, 0.0, False, "not stable by"),
    ],
)
def test_a_bad_solution_is_refused(residual, pole, discrete, expected):
    with pytest.raises(ValueError, match=expected):
        check_riccati(residual, np.array([pole]), discrete)


def test_what_no_reading_tells_of_is_named_a_problem_of_the_filter():
    with pytest.raises(ValueError, match=r"of the filter .* process_noise"):
        filter_riccati(np.diag([1.0, 0.5]), np.eye(2), np.array([[0.0, 1.0]]), NOISE)


def test_numbers_beyond_double_precision_are_refused_without_a_warning():
    with pytest.raises(ValueError, match=r"no stabilizing solution: [^.]*[^.]\. .* process_noise"):
        filter_riccati(TRANSITION, 1e60 * DRIVE, OUTPUT, NOISE)


def test_weights_of_any_size_are_symmetric_to_the_solver():
    plant = tc.linearize(tc.Model(tc.prism()), tc.prestress(tc.prism(), force_density=17.3205))
    half = np.random.default_rng(0).normal(size=(18, 18))
    law = tc.LQR(plant, Q=1e12 * half.T @ half, R=1e6, sample_time=0.02)
    assert abs(law.poles).max() < 1


@pytest.mark.parametrize("discrete", [True, False])
def test_a_tower_is_solved_as_by_the_pencil(discrete):
    """By doubling, which takes a twentieth of the time there; SciPy's solver is the oracle."""
    from scipy.linalg import solve_continuous_are, solve_discrete_are

    tower = tc.prism_tower(4)
    model = tc.Model(tower, strings=tc.LinearStrings(stiffness=1e3))
    plant = tc.linearize(model, tc.prestress(tower, min_force_density=5.0), input="rest_length")
    assert len(plant.A) > 100
    Q, R = tc.energy_weights(plant, by_mode=True)
    law = tc.LQR(plant, Q, R, sample_time=0.02 if discrete else None)
    A, B = plant.discretize(0.02)[:2] if discrete else (plant.A, plant.B)
    expected = (solve_discrete_are if discrete else solve_continuous_are)(A, B, Q, np.diag(R))
    np.testing.assert_allclose(law.cost, expected, atol=1e-9 * np.abs(expected).max())
    assert law.riccati_residual < 1e-12


@pytest.mark.parametrize(("rows", "zeros"), [(300, 0), (2000, 0), (4321, 0), (4321, 5)])
def test_a_tall_matrix_is_the_product_of_its_parts(rows, zeros):
    matrix = np.random.default_rng(rows).normal(size=(rows, 12))
    matrix[:, :zeros] = 0.0  # as inputs that move no positions
    Q, R = tall_qr(matrix)
    np.testing.assert_allclose(Q @ R, matrix, rtol=0, atol=1e-13)
    np.testing.assert_allclose(Q.T @ Q, np.eye(12), rtol=0, atol=1e-14)
    np.testing.assert_array_equal(np.tril(R, -1), 0.0)
