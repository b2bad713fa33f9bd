"""M_s, K_s, λ and eq. (7), built by the products of the paper's matrices."""

import numpy as np
import pytest
from scipy.sparse import diags_array

import tenscontrol as tc
from tests.dynamics.scenes import any_motion, random_force_density, random_structure
from tests.oracle import consistent_mass, node_acceleration

SCENES = [(seed, points) for seed in range(4) for points in (0, 1, 4)]
every_scene = pytest.mark.parametrize(("seed", "points"), SCENES)


def in_node_order(structure, columns):
    """Put the columns ``[bar nodes, string nodes]`` of the paper in the order of the nodes."""
    order = np.concatenate([structure.bar_nodes, structure.string_nodes])
    result = np.empty_like(columns)
    result[:, order] = columns
    return result


def paper_mass_matrix(structure):
    """Eq. (8)."""
    C_b, C_r, C_nb, C_ns = structure.C_b, structure.C_r, structure.C_nb, structure.C_ns
    m_b, m_s = diags_array(structure.bar_mass), diags_array(structure.string_node_mass)
    bars = C_nb.T @ (C_b.T @ m_b @ C_b / 12 + C_r.T @ m_b @ C_r)
    return in_node_order(structure, np.hstack([bars.toarray(), (C_ns.T @ m_s).toarray()]))


def paper_stiffness_matrix(structure, gamma, compression):
    """Eq. (9)."""
    g, lam = diags_array(gamma), diags_array(compression)
    C_b, C_nb = structure.C_b, structure.C_nb
    bars = structure.C_s.T @ g @ structure.C_sb - C_nb.T @ C_b.T @ lam @ C_b
    points = structure.C_s.T @ g @ structure.C_ss
    return in_node_order(structure, np.hstack([bars.toarray(), points.toarray()]))


def paper_compression(structure, N, V, gamma, W):
    """λ of each bar: eq. (1) with the force of eq. (2), the current length for l."""
    to_bars = (structure.C_b @ structure.C_nb).T
    F = W - N @ (structure.C_s.T @ diags_array(gamma) @ structure.C_s)
    B, Bd, f = N @ to_bars, V @ to_bars, F @ to_bars
    length = (B * B).sum(axis=0)
    inertial = structure.bar_mass * (Bd * Bd).sum(axis=0) / (12 * length)
    return -inertial - (B * f).sum(axis=0) / (2 * length)


def scene(seed, points):
    structure = random_structure(seed, bars=3, points=points)
    N, V = any_motion(structure, seed)
    W = 10 * np.random.default_rng(seed).normal(size=N.shape)
    return structure, N, V, random_force_density(structure, seed), W


def relative(found, expected):
    return np.abs(np.asarray(found) - expected).max() / np.abs(expected).max()


@every_scene
def test_mass_matrix_is_the_product_of_equation_8(seed, points):
    structure = random_structure(seed, bars=3, points=points)
    found = tc.Model(structure).mass_matrix().toarray()
    assert relative(found, paper_mass_matrix(structure)) < 1e-14
    assert relative(found, consistent_mass(structure)) < 1e-14


@every_scene
def test_stiffness_matrix_is_the_product_of_equation_9(seed, points):
    structure, N, V, gamma, W = scene(seed, points)
    model = tc.Model(structure, external_force=True)
    compression = np.array(model.bar_force_density(N, V, gamma, W)).ravel()
    found = model.stiffness_matrix(N, V, gamma, W).full()
    assert relative(found, paper_stiffness_matrix(structure, gamma, compression)) < 1e-14


@every_scene
def test_bar_force_density_is_the_paper_s_and_the_multiplier_of_the_oracle(seed, points):
    structure, N, V, gamma, W = scene(seed, points)
    model = tc.Model(structure, external_force=True)
    found = np.array(model.bar_force_density(N, V, gamma, W)).ravel()
    assert relative(found, paper_compression(structure, N, V, gamma, W)) < 1e-13
    assert relative(found, node_acceleration(structure, N, V, gamma, W)[1]) < 1e-12


@every_scene
def test_acceleration_satisfies_equation_7_to_round_off(seed, points):
    structure, N, V, gamma, W = scene(seed, points)
    model = tc.Model(structure, external_force=True)
    acceleration = np.array(model.acceleration(N, V, gamma, W))
    K = model.stiffness_matrix(N, V, gamma, W).full()
    residual = acceleration @ model.mass_matrix() + N @ K - W
    assert np.abs(residual).max() < 1e-14 * (np.abs(N) @ np.abs(K) + np.abs(W)).max()


@every_scene
def test_equation_7_holds_with_matrices_and_multipliers_of_others(seed, points):
    """The same with M_s of the paper's products and λ of the oracle: nothing of ours but N̈."""
    structure, N, V, gamma, W = scene(seed, points)
    model = tc.Model(structure, external_force=True)
    acceleration = np.array(model.acceleration(N, V, gamma, W))
    _, multipliers = node_acceleration(structure, N, V, gamma, W)
    K = paper_stiffness_matrix(structure, gamma, multipliers)
    residual = acceleration @ paper_mass_matrix(structure) + N @ K - W
    assert np.abs(residual).max() < 1e-12 * np.abs(N @ K).max()


def test_matrices_are_sparse(prism):
    model = tc.Model(prism)
    assert model.mass_matrix().nnz == 4 * 3
    # The diagonal, and two entries for each of the 12 members.
    assert model.stiffness_matrix.sparsity_out(0).nnz() == 6 + 2 * 12
