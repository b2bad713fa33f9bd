"""Statics of structures of any class, beside closed forms and numerical derivatives."""

import numpy as np
import pytest
from scipy.optimize import linprog

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tests.statics.structures import (
    bipyramid,
    d_bar,
    random_any,
    random_balance,
    snelson_x,
    square_body,
    star_prism,
    two_crosses,
)

SEEDS = range(12)


def string_lengths(structure, nodes):
    """Lengths of strings from the nodes of their paths."""
    paths = structure.paths or structure.strings.tolist()
    return np.array([np.linalg.norm(np.diff(nodes[:, list(path)]), axis=0).sum() for path in paths])


# ---- the equilibrium matrix ----


@pytest.mark.parametrize("seed", SEEDS)
def test_its_transpose_gives_the_rates_of_lengths(seed):
    """Virtual work: γ L times dL in each string, clustered or not, and -λ b times db in bars."""
    structure = random_any(seed)
    motion = np.random.default_rng(seed).normal(size=structure.nodes.shape)
    work = tc.statics.equilibrium_matrix(structure).T @ motion.ravel(order="F")
    there, here = (structure.nodes + h * motion for h in (1e-6, -1e-6))
    strings = (string_lengths(structure, there) - string_lengths(structure, here)) / 2e-6
    bars = (structure.bar_vectors(structure.nodes) * structure.bar_vectors(motion)).sum(axis=0)
    alpha = len(structure.strings)
    np.testing.assert_allclose(work[:alpha], structure.string_length() * strings, atol=1e-7)
    np.testing.assert_allclose(work[alpha:], -bars, atol=1e-13)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_at_rest_does_not_move_in_the_dynamics(seed):
    structure = random_any(seed)
    gamma, compression, load = random_balance(structure, seed)
    rest = tc.prestress(structure, gamma, external_force=load)
    model = tc.Model(structure, external_force=True)
    still = pack_state(structure, structure.nodes, np.zeros_like(structure.nodes))
    rate = np.array(model.dynamics(still, gamma, load[:, structure.free]))
    np.testing.assert_allclose(rate, 0, atol=1e-9)
    if not any(block.is_redundant for block in structure.blocks):
        moving = ~np.isin(structure.bars, structure.fixed).all(axis=1)
        np.testing.assert_allclose(rest.bar_force_density[moving], compression[moving], rtol=1e-8)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_stress_matrix_gives_the_load(seed):
    structure = random_any(seed)
    gamma, compression, load = random_balance(structure, seed)
    stress = tc.statics.stress_matrix(structure, gamma, compression)
    np.testing.assert_allclose(structure.nodes @ stress, load, atol=1e-12)


# ---- counts ----


@pytest.mark.parametrize(
    ("structure", "states", "mechanisms"),
    [
        (snelson_x(2), 1, 0), (snelson_x(3), 1, 1), (d_bar(2), 1, 0), (d_bar(3), 1, 1),
        (bipyramid(), 1, 0), (two_crosses(), 2, 0), (square_body(), 3, 1),
    ],
)  # fmt: skip
def test_states_of_self_stress_and_mechanisms_are_counted(structure, states, mechanisms):
    """Maxwell's rule, counted by hand: members − coordinates = states − mechanisms − bodies."""
    rest = tc.prestress(structure, min_force_density=1.0)
    assert (rest.self_stress_states, rest.mechanisms) == (states, mechanisms)
    assert rest.force_density.min() >= 1.0 - 1e-12
    assert rest.residual < 1e-12


def test_a_crossed_square_is_super_stable_and_a_rhombus_of_bars_folds_in_space():
    assert tc.prestress(snelson_x(2), 1.0).is_super_stable
    flat, folding = (tc.prestress(d_bar(d), min_force_density=1.0) for d in (2, 3))
    assert flat.is_stable and not flat.is_super_stable  # noqa: PT018
    # Rhombus with diagonals 2 m, γ = 1: bars of λ = 2 γ/2 on each side. The fold lifts one corner.
    assert not folding.is_stable
    assert folding.stability.mechanism_stiffness[0] < -1.0


def test_the_bipyramid_in_closed_form():
    """At an apex three bars carry the axis: 3 λ z = γ_axis 2 z; at the ring 2 λ r = 3 γ_ring r."""
    rest = tc.prestress(bipyramid(), min_force_density=1.0)
    gamma, lam = rest.force_density, rest.bar_force_density[0]
    np.testing.assert_allclose(gamma[3], 1.5 * lam, rtol=1e-12)
    np.testing.assert_allclose(gamma[:3], 2 / 3 * lam, rtol=1e-12)
    assert len(rest.bars_in_tension) == 0


def test_redundant_bars_get_the_least_forces():
    structure = square_body()
    rest = tc.prestress(structure, min_force_density=2.0)
    np.testing.assert_allclose(rest.force_density, 2.0, rtol=1e-12)
    E = tc.statics.equilibrium_matrix(structure)[structure.free_rows]
    least = -np.linalg.pinv(E[:, 4:], rcond=1e-9) @ E[:, :4] @ rest.force_density
    np.testing.assert_allclose(rest.bar_force_density, least, atol=1e-12)
    # The strings pull the corners outward: all bars pull.
    np.testing.assert_array_equal(rest.bars_in_tension, range(6))


def test_a_string_over_a_pulley_has_one_tension():
    """A closed string around the corners of crossed bars is four strings of one tension."""
    nodes = [[0, 2, 2, 0], [0, 0, 1, 1]]
    bars, ends = [[0, 2], [1, 3]], [(0, 1), (1, 2), (2, 3), (3, 0)]
    apart = tc.Structure(nodes, bars, ends, bar_mass=1.0)
    assert tc.prestress(apart, min_force_density=1.0).force_density == pytest.approx(np.ones(4))
    # On a rectangle one tension is no balance; on a square it is.
    around = tc.Structure(nodes, bars, [(0, 1, 2, 3, 0)], bar_mass=1.0)
    with pytest.raises(ValueError, match="no state of self-stress"):
        tc.prestress(around, 1.0)
    square = tc.Structure(snelson_x().nodes, bars, [(0, 1, 2, 3, 0)], bar_mass=1.0)
    rest = tc.prestress(square, 1.0)
    np.testing.assert_allclose(rest.force_density, 1.0)  # T = 4 N, L = 4 m
    np.testing.assert_allclose(rest.bar_force_density, 4.0)  # each segment has T/l = 4 N/m
    assert (rest.self_stress_states, rest.mechanisms) == (1, 3)


# ---- bounds ----


def test_an_arm_of_crosses_is_taut_everywhere():
    rest = tc.prestress(two_crosses(), min_force_density=5.0)
    assert rest.force_density.min() == pytest.approx(5.0)
    assert len(rest.slack_strings) == 0


def test_strings_have_bounds_of_their_own():
    structure = two_crosses()
    least = np.array([1.0, 1.0, 3.0, 1.0, 1.0, 1.0, 0.0])
    rest = tc.prestress(structure, min_force_density=least, max_force_density=3.5)
    assert (rest.force_density >= least - 1e-12).all()
    assert rest.force_density.max() <= 3.5 + 1e-12
    at_level = tc.prestress(structure, 2.0, min_force_density=0.5, max_force_density=4.0)
    assert at_level.force_density.mean() == pytest.approx(2.0)
    with pytest.raises(
        ValueError, match=r"^max_force_density .* force_density of 2 N/m: without it"
    ):
        tc.prestress(structure, 2.0, min_force_density=0.5, max_force_density=3.0)
    assert at_level.force_density.max() <= 4.0 + 1e-12


@pytest.mark.parametrize("most", [1e-3, 30.0, 1e6])
def test_the_least_force_density_is_as_large_as_can_be(most):
    rest = tc.prestress(tc.prism(), max_force_density=most)
    np.testing.assert_allclose(rest.force_density[6:], most, rtol=1e-5)
    np.testing.assert_allclose(rest.force_density[:6], most / np.sqrt(3), rtol=1e-5)
    # Each of the two states of the arm of crosses has another bottleneck.
    structure = two_crosses()
    found = tc.prestress(structure, max_force_density=most).force_density
    E = tc.statics.equilibrium_matrix(structure)[structure.free_rows] @ np.eye(11)
    best = linprog(
        np.r_[np.zeros(11), -1.0],
        A_ub=np.column_stack([-np.eye(7, 11), np.ones(7)]), b_ub=np.zeros(7),
        A_eq=np.column_stack([E, np.zeros(len(E))]), b_eq=np.zeros(len(E)),
        bounds=[(0, 1.0)] * 7 + [(None, None)] * 5,
    )  # fmt: skip
    assert found.min() == pytest.approx(-best.fun * most, rel=1e-5)
    assert found.max() <= most * (1 + 1e-8)


def test_the_least_forces_that_carry_a_load():
    """A mass on two strings at right angles: γ l of each is W/√2."""
    structure = tc.Structure(
        [[-1, 1, 0], [1, 1, 0]], np.zeros((0, 2)), [[0, 2], [1, 2]], 1.0, point_mass=[0, 0, 1.0],
        fixed=[0, 1],
    )  # fmt: skip
    load = np.zeros((2, 3))
    load[1, 2] = -8.0
    rest = tc.prestress(structure, min_force_density=0.0, external_force=load)
    np.testing.assert_allclose(rest.force_density, 4.0)
    with pytest.raises(ValueError, match=r"string \d would get γ = 4 N/m, expected at least 5 N"):
        tc.prestress(structure, min_force_density=5.0, external_force=load)


def test_strings_that_cannot_be_taut_are_named():
    """A string beside a bar only adds to it; one across the free end of a string carries none."""
    square = snelson_x()
    nodes = np.hstack([square.nodes, [[3.0], [0.5]]])
    structure = tc.Structure(
        nodes, square.bars, [*square.strings.tolist(), [1, 4]], 1.0, point_mass=[0, 0, 0, 0, 1.0]
    )
    with pytest.raises(ValueError, match=r"strings 4 cannot be taut while no other"):
        tc.prestress(structure, min_force_density=1.0)
    rest = tc.prestress(structure, min_force_density=[1.0, 1.0, 1.0, 1.0, 0.0])
    np.testing.assert_allclose(rest.force_density, [1, 1, 1, 1, 0], atol=1e-12)
    np.testing.assert_array_equal(rest.slack_strings, [4])


def test_bounds_that_are_too_narrow_name_the_largest_level():
    with pytest.raises(ValueError, match=r"too low: .* 0\.5774 times the least that is asked for"):
        tc.prestress(tc.prism(), min_force_density=10.0, max_force_density=10.0)


# ---- stiffness ----


def energy(rest, stiffness, nodes):
    """Energy of linear strings with held rest lengths, less work of load and bars, J."""
    structure = rest.structure
    at_rest, length = structure.string_length(), string_lengths(structure, nodes)
    tension = rest.force_density * at_rest
    stretch = length - at_rest
    bars = (structure.bar_vectors(nodes) ** 2).sum(axis=0) / 2
    strings = (tension * stretch + stiffness * stretch**2 / 2).sum()
    return strings - rest.bar_force_density @ bars - (rest.external_force * nodes).sum()


@pytest.mark.parametrize("seed", SEEDS)
def test_tangent_stiffness_is_the_second_derivative_of_the_energy(seed):
    structure = random_any(seed)
    gamma, _, load = random_balance(structure, seed)
    rest = tc.prestress(structure, gamma, external_force=load)
    stiffness = np.random.default_rng(seed).uniform(20, 100, len(gamma))
    found = rest.tangent_stiffness(stiffness)
    h = 1e-4
    for value, mode in zip(found.eigenvalues, found.modes.transpose(2, 0, 1), strict=True):
        values = [energy(rest, stiffness, structure.nodes + k * h * mode) for k in (-1, 0, 1)]
        assert np.array([1, -2, 1]) @ values / h**2 == pytest.approx(value, rel=1e-4, abs=1e-3)
        kept = (structure.bar_vectors(structure.nodes) * structure.bar_vectors(mode)).sum(axis=0)
        moving = ~np.isin(structure.bars, structure.fixed).all(axis=1)
        np.testing.assert_allclose(kept[moving], 0, atol=1e-10)
        np.testing.assert_allclose(mode.ravel(order="F")[structure.fixed_rows], 0)
    bars = np.linalg.matrix_rank(
        tc.statics.equilibrium_matrix(structure)[structure.free_rows][:, len(gamma) :], tol=1e-9
    )
    assert 0 <= len(structure.free_rows) - bars - len(found.eigenvalues) <= 6
    assert found.is_stable == (found.eigenvalues[0] > 0)


@pytest.mark.parametrize(("ratio", "growing"), [(1.5, 6), (3.0, 6), (10.0, 4), (100.0, 0)])
def test_prestress_stability_is_not_stability_with_soft_strings(ratio, growing):
    """D_7^{3,2} with height = radius: its mechanisms are stiff, its soft strings are not enough."""
    rest = tc.prestress(star_prism(7, 3, 2), min_force_density=1.0)
    assert rest.is_stable
    assert not rest.is_super_stable
    found = rest.tangent_stiffness(ratio * rest.force_density)
    assert np.count_nonzero(found.eigenvalues < 0) == growing
    assert found.is_stable == (growing == 0)


def test_growing_modes_grow_in_the_dynamics():
    structure = star_prism(7, 3, 2)
    rest = tc.prestress(structure, min_force_density=1.0)
    model = tc.Model(structure, strings=tc.LinearStrings(10.0 * rest.force_density))
    plant = tc.linearize(model, rest, input="rest_length")
    assert np.count_nonzero(np.linalg.eigvals(plant.A).real > 1e-3) == 4


@pytest.mark.parametrize("height", [1e-6, 1e-3, 1e3, 1e6])
@pytest.mark.parametrize("top", [1e-5, 1e-3, 1.0])
def test_stability_of_prisms_of_extreme_proportions(height, top):
    """Prisms are super-stable, whatever their proportions (Connelly & Terrell 1995)."""
    rest = tc.prestress(tc.prism(6, 1.0, height, top), force_density=10.0)
    assert rest.is_stable
    assert rest.is_super_stable
    assert len(rest.stability.mechanism_stiffness) == 7


def test_a_pendulum_upside_down_is_not_stable():
    """Gravity resists or drives its motion as one body, which counts then."""
    load = np.zeros((2, 2))
    load[1, 1] = -5.0
    for height, is_stable in ((-1.0, True), (1.0, False)):
        bar = tc.Structure([[0, 0], [0, height]], [[0, 1]], [], 1.0, fixed=[0])
        rest = tc.prestress(bar, [], external_force=load)
        assert rest.is_stable is is_stable
        # W/l per unit displacement of the tip
        found = rest.tangent_stiffness([])
        np.testing.assert_allclose(found.eigenvalues, [5.0 if is_stable else -5.0])
