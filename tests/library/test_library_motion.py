"""Every structure of the library moves as a dense oracle says: multipliers by least squares."""

import numpy as np
import pytest

import tenscontrol as tc

NAMES = [name for name in tc.library.__all__ if name != "net"]
SIZES = {"prism_tower": {"stages": 2}, "cable_net": {"rows": 4, "columns": 5}}


def oracle(structure, nodes, velocities, force_density):
    """Return accelerations, shape (d, n), by the masses and constraints of bars one by one."""
    d, n = nodes.shape
    mass, force = np.diag(structure.point_mass), np.zeros((d, n))
    for (a, b), m in zip(structure.bars, structure.bar_mass, strict=True):
        mass[np.ix_([a, b], [a, b])] += m / 6 * np.array([[2, 1], [1, 2]])
    for (a, b), gamma in zip(structure.strings, force_density, strict=True):
        pull = gamma * (nodes[:, b] - nodes[:, a])
        force[:, a] += pull
        force[:, b] -= pull
    rows, due = np.zeros((len(structure.bars), n * d)), np.zeros(len(structure.bars))
    for i, (a, b) in enumerate(structure.bars):
        along = nodes[:, b] - nodes[:, a]
        rows[i, d * a : d * a + d], rows[i, d * b : d * b + d] = -along, along
        due[i] = -np.sum((velocities[:, b] - velocities[:, a]) ** 2)
    free = structure.free_rows
    M = np.kron(mass, np.eye(d))[np.ix_(free, free)]
    J = rows[:, free]
    c = len(J)
    matrix = np.block([[M, J.T], [J, np.zeros((c, c))]])
    right = np.concatenate([force.ravel(order="F")[free], due])
    found = np.zeros(n * d)
    found[free] = np.linalg.lstsq(matrix, right, rcond=1e-13)[0][: len(free)]
    return found.reshape(nodes.shape, order="F"), J


@pytest.mark.parametrize("name", NAMES)
def test_accelerations_are_those_of_the_oracle(name):
    structure = getattr(tc.library, name)(**SIZES.get(name, {}))
    random = np.random.default_rng(len(name))
    gamma = random.uniform(0.0, 20.0, len(structure.strings))
    still = np.zeros_like(structure.nodes)
    _, J = oracle(structure, structure.nodes, still, gamma)
    speed = random.normal(size=len(structure.free_rows))
    speed -= np.linalg.pinv(J, rcond=1e-10) @ (J @ speed)  # as the bars allow
    flat = np.zeros(structure.nodes.size)
    flat[structure.free_rows] = speed
    velocities = flat.reshape(structure.nodes.shape, order="F")
    expected, _ = oracle(structure, structure.nodes, velocities, gamma)
    free = structure.free
    model = tc.Model(structure)
    found = model.acceleration(structure.nodes[:, free], velocities[:, free], gamma).full()
    off = np.abs(found - expected[:, free]).max() / np.abs(expected).max()
    assert off < 1e-10
