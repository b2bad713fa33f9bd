"""Stability of a prestress: where it holds, where it does not, and what the dynamics says."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.dynamics.scenes import TOP_FORCE_DENSITY, random_turn
from tests.statics.test_prestress import prism_with_diagonals, square


def star_prism(sides, skip):
    """A prism whose horizontal strings join each node to the ``skip``-th next one."""
    plain = tc.prism(sides)
    node = np.arange(sides)
    following = (node + skip) % sides
    strings = plain.strings.copy()
    strings[:sides] = np.column_stack([node, following])
    strings[sides : 2 * sides] = sides + strings[:sides]
    return tc.Structure(
        plain.nodes, plain.bars, strings, bar_mass=1.0, string_groups=plain.string_groups
    )


def energy_after(rest, motion, size):
    """Energy ½ Σ γ l² less ½ Σ λ b² of the prestress after a small motion, J."""
    structure = rest.structure
    nodes = structure.nodes + size * motion
    strings = (structure.string_vectors(nodes) ** 2).sum(axis=0)
    bars = (structure.bar_vectors(nodes) ** 2).sum(axis=0)
    return 0.5 * (rest.force_density @ strings - rest.bar_force_density @ bars)


@pytest.mark.parametrize("sides", range(3, 9))
@pytest.mark.parametrize("top_radius", [None, 0.3, 0.8])
def test_prisms_are_stable_and_super_stable(sides, top_radius):
    rest = tc.prestress(tc.prism(sides, top_radius=top_radius), force_density=10.0)
    assert rest.is_stable
    assert rest.is_super_stable
    assert len(rest.stability.mechanism_stiffness) == 2 * sides - 5
    assert rest.stability.stress_matrix_rank_defect == 4


@pytest.mark.parametrize("sides", [5, 6, 7])
def test_star_prisms_balance_but_are_not_stable(sides):
    rest = tc.prestress(star_prism(sides, skip=2), force_density=10.0)
    assert rest.residual < 1e-12
    assert not rest.is_stable
    assert not rest.is_super_stable
    assert rest.stability.mechanism_stiffness.min() < -1.0


def test_an_unstable_prestress_runs_away_in_the_dynamics():
    structure = star_prism(5, skip=2)
    plant = tc.linearize(tc.Model(structure), tc.prestress(structure, force_density=10.0))
    assert np.linalg.eigvals(plant.A).real.max() > 1.0


def test_a_stable_prestress_stays_in_the_dynamics(prism, rest):
    plant = tc.linearize(tc.Model(prism), rest)
    assert np.linalg.eigvals(plant.A).real.max() < 1e-6


def test_stiffness_of_the_twist_is_the_curvature_of_the_energy(prism, rest):
    flexes = np.linalg.svd(tc.statics.equilibrium_matrix(prism).T)[2][11:].T
    centred = (prism.nodes - prism.nodes.mean(axis=1, keepdims=True)).T
    rigid = np.array(
        [np.tile(axis, 6) for axis in np.eye(3)]
        + [np.cross(axis, centred).ravel() for axis in np.eye(3)]
    )
    twist = flexes @ np.linalg.svd(rigid @ flexes)[2][-1]
    motion = twist.reshape(3, 6, order="F")
    # The energy is quadratic in the nodes: its second difference is exact.
    curvature = sum(w * energy_after(rest, motion, s) for w, s in ((1, 1), (-2, 0), (1, -1)))
    np.testing.assert_allclose(rest.stability.mechanism_stiffness, [curvature], rtol=1e-11)


def test_stiffness_of_the_mechanism_grows_with_the_prestress(prism):
    one, two = (tc.prestress(prism, level).stability for level in (10.0, 20.0))
    np.testing.assert_allclose(two.mechanism_stiffness, 2 * one.mechanism_stiffness, rtol=1e-10)


def test_stable_but_not_super_stable():
    """Tense diagonals make the stress matrix indefinite; string stiffness holds that motion."""
    rest = tc.prestress(prism_with_diagonals(), force_density=10.0, reference="diagonal")
    stress = tc.statics.stress_matrix(rest.structure, rest.force_density, rest.bar_force_density)
    assert np.linalg.eigvalsh(stress).min() < -0.1
    assert rest.is_stable
    assert not rest.is_super_stable


def test_slack_strings_give_no_stability():
    """A square whose only prestress is none at all keeps its mechanisms."""
    structure = square(bars=[[0, 2], [1, 3]], strings=[[0, 1], [1, 2], [2, 3], [3, 0]])
    nothing = tc.prestress(structure, force_density=np.zeros(4))
    assert not nothing.is_stable
    assert not nothing.is_super_stable


def test_stress_matrix_is_the_stiffness_matrix_at_rest(prism, rest):
    model = tc.Model(prism)
    K = model.stiffness_matrix(prism.nodes, np.zeros((3, 6)), rest.force_density)
    stress = tc.statics.stress_matrix(prism, rest.force_density, rest.bar_force_density)
    np.testing.assert_allclose(np.array(K.full()), stress, rtol=0, atol=1e-12)
    np.testing.assert_allclose(prism.nodes @ stress, 0, atol=1e-12)
    np.testing.assert_allclose(stress.sum(axis=0), 0, atol=1e-12)


def test_stability_does_not_depend_on_where_and_how_the_structure_lies(prism):
    moved = tc.Structure(
        random_turn(7) @ prism.nodes + [[5.0], [-3.0], [100.0]],
        prism.bars,
        prism.strings,
        bar_mass=1.0,
        string_groups=prism.string_groups,
    )
    there = tc.prestress(moved, force_density=TOP_FORCE_DENSITY).stability
    here = tc.prestress(prism, force_density=TOP_FORCE_DENSITY).stability
    np.testing.assert_allclose(there.mechanism_stiffness, here.mechanism_stiffness, rtol=1e-9)
    assert there.is_super_stable


def test_a_flat_square_with_crossed_bars_is_super_stable():
    """Its stress matrix has the least rank defect of a flat structure, 3."""
    structure = square(bars=[[0, 2], [1, 3]], strings=[[0, 1], [1, 2], [2, 3], [3, 0]])
    rest = tc.prestress(structure, 10.0)
    assert rest.stability.stress_matrix_rank_defect == 3
    assert rest.is_super_stable


def test_strings_drawn_together_have_a_stability():
    # Uniform force densities draw the ends of most strings of a prism together.
    model = tc.Model(tc.prism(), external_force=True)
    rest = tc.equilibrium(model, force_density=0.5, external_force=np.zeros((3, 6)))
    assert rest.structure.string_length().min() < 1e-12
    assert isinstance(rest.stability.is_super_stable, bool)
