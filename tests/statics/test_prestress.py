"""Self-stress and prestress: the prism in closed form, refusals, several states, loads."""

import re
from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import linprog, minimize
from scipy.spatial.transform import Rotation

import tenscontrol as tc
from tenscontrol.statics.equilibrium_matrix import member_forces
from tests.dynamics.scenes import TOP_FORCE_DENSITY, random_force_density, random_structure

SIDES = range(3, 9)
TOP_RADII = (None, 0.3, 0.8)
HANDS = ("left", "right")


def every_prism(test):
    for name, values in (("sides", SIDES), ("top_radius", TOP_RADII), ("hand", HANDS)):
        test = pytest.mark.parametrize(name, values)(test)
    return test


def square(bars, strings):
    """Four nodes of a unit square in the plane z = 0."""
    nodes = [[0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0]]
    return tc.Structure(nodes, bars, strings, bar_mass=1.0)


def prism_with_diagonals():
    """A prism of four bars with both diagonals of the top as strings: two states of self-stress."""
    plain = tc.prism(4)
    return tc.Structure(
        plain.nodes,
        plain.bars,
        np.vstack([plain.strings, [[0, 2], [1, 3]]]),
        bar_mass=1.0,
        string_groups=(*plain.string_groups, "diagonal", "diagonal"),
    )


# ---- closed form ----


@every_prism
def test_closed_form_and_numerical_self_stress_agree(sides, top_radius, hand):
    structure = tc.prism(sides, 0.5, 1.0, top_radius, handedness=hand)
    strings, bars = tc.statics.prism_force_density(sides, 17.0, 0.5, top_radius)
    found = tc.prestress(structure, force_density=17.0)
    np.testing.assert_allclose(found.force_density, strings, rtol=1e-10)
    np.testing.assert_allclose(found.bar_force_density, bars, rtol=1e-10)


@every_prism
def test_closed_form_balances(sides, top_radius, hand):
    structure = tc.prism(sides, 0.5, 1.0, top_radius, handedness=hand)
    strings, bars = tc.statics.prism_force_density(sides, 17.0, 0.5, top_radius)
    unbalanced = tc.statics.equilibrium_matrix(structure) @ np.concatenate([strings, bars])
    assert np.abs(unbalanced).max() < 1e-12


@every_prism
def test_a_prism_has_one_state_of_self_stress_and_its_count_of_mechanisms(sides, top_radius, hand):
    structure = tc.prism(sides, 0.5, 1.0, top_radius, handedness=hand)
    found = tc.prestress(structure, force_density=1.0)
    assert (found.self_stress_states, found.mechanisms) == (1, 2 * sides - 5)


def test_the_prism_rests_at_vertical_strings_root_three_times_the_others(prism):
    gamma = TOP_FORCE_DENSITY * np.repeat([1.0, 1.0, np.sqrt(3)], 3)
    found = tc.prestress(prism, force_density=gamma)
    assert found.residual < 1e-12
    np.testing.assert_allclose(found.bar_force_density, 30.0, rtol=1e-13)
    np.testing.assert_array_equal(found.force_density, gamma)


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_vertical_strings_off_by_one_percent_are_refused(prism, factor):
    gamma = TOP_FORCE_DENSITY * np.repeat([1.0, 1.0, factor * np.sqrt(3)], 3)
    with pytest.raises(ValueError, match=r"does not balance: node \d is left with .* of 0\.\d+ N"):
        tc.prestress(prism, force_density=gamma)


@pytest.mark.parametrize("height", [0.2, 1.0, 3.0])
def test_prisms_of_equal_radii_and_any_height_share_their_force_densities(height):
    found = tc.prestress(tc.prism(height=height), force_density=10.0)
    expected = np.repeat([10.0, 10.0, 10.0 * np.sqrt(3)], 3)
    np.testing.assert_allclose(found.force_density, expected, rtol=1e-11)


@pytest.mark.parametrize("reference", ["top", "bottom", "vertical"])
def test_the_reference_strings_get_the_force_density_asked_for(reference):
    structure = tc.prism(5, top_radius=0.35)
    found = tc.prestress(structure, force_density=12.0, reference=reference)
    chosen = found.force_density[structure.strings_in(reference)]
    np.testing.assert_allclose(chosen, 12.0, rtol=1e-12)
    assert found.residual < 1e-12


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_prestress_does_not_depend_on_the_size_of_the_structure(size):
    found = tc.prestress(tc.prism(radius=0.5 * size, height=size), force_density=10.0)
    np.testing.assert_allclose(found.force_density[6:], 10.0 * np.sqrt(3), rtol=1e-11)
    assert found.is_super_stable


# ---- no prestress ----


@pytest.mark.parametrize("degrees", [-20.0, 1e-3, 5.0, 30.0])
def test_a_prism_turned_by_the_wrong_angle_has_no_self_stress(prism, degrees):
    nodes = prism.nodes.copy()
    nodes[:, :3] = Rotation.from_euler("z", degrees, degrees=True).as_matrix() @ nodes[:, :3]
    turned = tc.Structure(nodes, prism.bars, prism.strings, bar_mass=1.0)
    with pytest.raises(ValueError, match="no state of self-stress"):
        tc.prestress(turned, force_density=10.0)


def test_self_stress_that_needs_a_string_in_compression_is_refused():
    # In a braced square the four sides carry one sign and the diagonals the other: with bars on
    # two sides, the other two sides and the diagonals cannot all pull.
    structure = square(bars=[[0, 1], [3, 2]], strings=[[0, 3], [1, 2], [0, 2], [1, 3]])
    with pytest.raises(ValueError, match="needs a string in compression"):
        tc.prestress(structure, force_density=10.0)


def test_bars_as_diagonals_of_a_square_are_prestressed():
    structure = square(bars=[[0, 2], [1, 3]], strings=[[0, 1], [1, 2], [2, 3], [3, 0]])
    found = tc.prestress(structure, force_density=10.0)
    np.testing.assert_allclose(found.force_density, 10.0, rtol=1e-12)
    np.testing.assert_allclose(found.bar_force_density, 10.0, rtol=1e-12)
    assert found.is_stable  # the fold about a diagonal


# ---- several states ----


def test_two_states_of_self_stress_are_counted():
    found = tc.prestress(prism_with_diagonals(), force_density=10.0)
    assert (found.self_stress_states, found.mechanisms) == (2, 2)


@pytest.mark.parametrize("reference", ["top", "bottom", "vertical", "diagonal"])
def test_a_symmetric_structure_with_two_states_gets_a_symmetric_answer(reference):
    structure = prism_with_diagonals()
    found = tc.prestress(structure, force_density=10.0, reference=reference)
    assert found.residual < 1e-12
    for group in dict.fromkeys(structure.string_groups):
        assert np.ptp(found.force_density[structure.strings_in(group)]) < 1e-11
    assert found.force_density.min() >= 0


def nearest_by_general_optimization(structure, level, strings):
    """Balanced γ >= 0 of mean ``level`` over the strings nearest to uniform, by SLSQP."""
    alpha = len(structure.strings)
    E = tc.statics.equilibrium_matrix(structure)
    rows = np.vstack([E, np.isin(np.arange(E.shape[1]), strings) / len(strings)])
    goal = np.r_[np.zeros(len(E)), level]
    start, _, rank, _ = np.linalg.lstsq(rows, goal, rcond=1e-9)
    free = np.linalg.svd(rows)[2][rank:].T
    result = minimize(
        lambda c: (
            ((start + free @ c)[:alpha] / level - 1) @ ((start + free @ c)[:alpha] / level - 1)
        ),
        np.zeros(free.shape[1]),
        constraints={"type": "ineq", "fun": lambda c: (start + free @ c)[:alpha]},
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
    )
    gamma = (start + free @ result.x)[:alpha]
    return gamma if result.success and gamma.min() > -1e-7 * level else None


@pytest.mark.parametrize("reference", ["top", "bottom", "vertical", "diagonal"])
def test_the_answer_is_the_nearest_to_uniform(reference):
    structure = prism_with_diagonals()
    found = tc.prestress(structure, force_density=10.0, reference=reference)
    expected = nearest_by_general_optimization(structure, 10.0, structure.strings_in(reference))
    np.testing.assert_allclose(found.force_density, expected, atol=1e-5)


# ---- given force densities and loads ----


def loaded(structure, seed):
    """Random γ and a load that it balances together with bars in compression."""
    gamma = random_force_density(structure, seed)
    bars = np.random.default_rng(seed).uniform(5.0, 20.0, len(structure.bars))
    load = tc.statics.equilibrium_matrix(structure) @ np.concatenate([gamma, bars])
    return gamma, bars, load.reshape(3, -1, order="F")


@pytest.mark.parametrize("seed", range(3))
def test_given_force_densities_under_a_load_are_accepted_and_bars_found(seed):
    structure = random_structure(seed)
    gamma, bars, load = loaded(structure, seed)
    found = tc.prestress(structure, force_density=gamma, external_force=load)
    np.testing.assert_allclose(found.bar_force_density, bars, rtol=1e-10)
    np.testing.assert_array_equal(found.external_force, load)
    assert found.residual < 1e-11


def test_a_load_changes_the_force_densities_that_balance(prism):
    _, _, load = loaded(prism, 3)
    found = tc.prestress(prism, force_density=50.0, external_force=load)
    balance = (
        tc.statics.equilibrium_matrix(prism) @ np.r_[found.force_density, found.bar_force_density]
    )
    np.testing.assert_allclose(balance, load.ravel(order="F"), atol=1e-11)
    assert found.force_density[:3].mean() == pytest.approx(50.0, rel=1e-12)
    assert found.force_density.min() >= 0
    free = tc.prestress(prism, force_density=50.0)
    assert np.abs(found.force_density - free.force_density).max() > 1.0


def test_a_structure_under_its_load_does_not_move(prism):
    _, _, load = loaded(prism, 3)
    found = tc.prestress(prism, force_density=50.0, external_force=load)
    model = tc.Model(prism, external_force=True)
    still = np.zeros((3, 6))
    acceleration = np.array(model.acceleration(prism.nodes, still, found.force_density, load))
    np.testing.assert_allclose(acceleration, 0, atol=1e-10)
    compression = np.array(model.bar_force_density(prism.nodes, still, found.force_density, load))
    np.testing.assert_allclose(compression.ravel(), found.bar_force_density, rtol=1e-12)


def test_a_load_with_a_resultant_is_refused(prism):
    load = np.zeros((3, 6))
    load[2, 0] = 1.0
    with pytest.raises(ValueError, match="no member forces balance external_force"):
        tc.prestress(prism, force_density=10.0, external_force=load)


def test_a_load_along_the_mechanism_is_refused(prism):
    """The twist changes no length, so members cannot carry a load that does work on it."""
    E = tc.statics.equilibrium_matrix(prism)
    flexes = np.linalg.svd(E.T)[2][11:].T  # rigid motions and the twist
    centred = prism.nodes.T - prism.nodes.mean(axis=1)
    rigid = [np.tile(axis, 6) for axis in np.eye(3)]
    rigid += [np.cross(axis, centred).ravel() for axis in np.eye(3)]
    twist = flexes @ np.linalg.svd((flexes.T @ np.array(rigid).T).T)[2][-1]
    assert np.abs(np.array(rigid) @ twist).max() < 1e-12
    with pytest.raises(ValueError, match="no member forces balance external_force"):
        tc.prestress(prism, 10.0, external_force=twist.reshape(3, 6, order="F"))


def test_results_are_read_only(rest):
    for name in ("force_density", "bar_force_density", "external_force"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(rest, name)[...] = 0.0


def prism_with_extra_strings(seed):
    """Four diagonals added to a square prism at random: many sets of γ have no interior."""
    prism = tc.prism(4)
    members = {frozenset(pair) for pair in np.vstack([prism.strings, prism.bars]).tolist()}
    free = [pair for pair in combinations(range(8), 2) if frozenset(pair) not in members]
    chosen = np.random.default_rng(seed).permutation(len(free))[:4]
    return tc.Structure(
        prism.nodes,
        prism.bars,
        np.vstack([prism.strings, np.array(free)[chosen]]),
        bar_mass=1.0,
        string_groups=prism.string_groups + ("extra",) * 4,
    )


@pytest.mark.parametrize("seed", range(40))
def test_every_string_is_taut_exactly_where_a_linear_program_says_so(seed):
    structure = prism_with_extra_strings(seed)
    E = tc.statics.equilibrium_matrix(structure)
    bounds = [(3.0, None)] * 16 + [(None, None)] * 4
    total = np.r_[np.ones(16), np.zeros(4)]
    program = linprog(total, A_eq=E, b_eq=np.zeros(24), bounds=bounds)
    if program.status == 2:
        with pytest.raises(ValueError, match=r"^strings .* cannot be taut"):
            tc.prestress(structure, min_force_density=3.0)
        return
    found = tc.prestress(structure, min_force_density=3.0)
    assert found.force_density.min() == pytest.approx(3.0)
    assert found.residual < 1e-9 * found.force_density.max()
    # No other balance within the bounds is nearer to uniform: the way there goes up.
    uphill = linprog(np.r_[found.force_density - 3.0, np.zeros(4)], A_eq=E, b_eq=np.zeros(24),
                     bounds=bounds)  # fmt: skip
    ahead = (found.force_density - 3.0) @ (uphill.x[:16] - found.force_density)
    assert ahead > -1e-6 * found.force_density.max() ** 2


@pytest.mark.parametrize("seed", range(40))
def test_prestress_refuses_exactly_where_a_linear_program_is_infeasible(seed):
    structure = prism_with_extra_strings(seed)
    E = tc.statics.equilibrium_matrix(structure)
    top = np.zeros(E.shape[1])
    top[:4] = 0.25
    bounds = [(0, None)] * 16 + [(None, None)] * 4
    program = linprog(
        np.zeros(20), A_eq=np.vstack([E, top]), b_eq=np.r_[np.zeros(24), 10.0], bounds=bounds
    )
    if program.status == 2:
        with pytest.raises(ValueError, match="no force densities"):
            tc.prestress(structure, 10.0)
    else:
        found = tc.prestress(structure, 10.0)
        assert found.force_density.min() >= 0.0
        assert found.force_density[:4].mean() == pytest.approx(10.0)
        assert found.residual < 1e-9 * found.force_density.max()


@pytest.mark.parametrize("seed", range(20))
def test_a_prism_of_any_proportions_has_one_state_of_self_stress(seed):
    rng = np.random.default_rng(seed)
    radius, height, top = 10.0 ** rng.uniform(-3, 3, 3)
    sides = int(rng.integers(3, 7))
    prism = tc.prism(sides, radius, height, top)
    forces = member_forces(prism, np.zeros(prism.nodes.size))
    assert forces.states.shape[1] == 1
    gamma, lam = tc.statics.prism_force_density(sides, 1.0, radius, top)
    wanted = np.concatenate([gamma, lam]) / np.linalg.norm(np.concatenate([gamma, lam]))
    found = forces.states[:, 0] * np.sign(forces.states[:, 0] @ wanted)
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_the_proportions_that_showed_three_states():
    for sides, radius, height, top in (
        (6, 250.07462015060963, 0.0012839789441676849, 0.016036813132064058),
        (4, 0.032773169699274116, 0.002434922596824015, 602.9972061348006),
        (6, 1575.5281135362982, 0.00013955450772653588, 0.004044120537500458),
    ):
        rest = tc.prestress(tc.prism(sides, radius, height, top), 10.0)
        assert (rest.self_stress_states, rest.mechanisms) == (1, 2 * sides - 5)


def test_a_line_of_two_nodes_has_the_rank_of_its_one_member():
    bar = tc.Structure([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]], [[0, 1]], [], bar_mass=1.0)
    assert member_forces(bar, np.zeros(6)).rank == 1


def test_a_refusal_gives_the_nearest_forces_that_balance():
    """√3 rounded to four digits: the message has the digits that balance, which are accepted."""
    structure = tc.prism()
    rounded = np.repeat([10.0, 10.0, 17.3205], 3)
    with pytest.raises(ValueError, match="The nearest that balance") as refused:
        tc.prestress(structure, force_density=rounded)
    top, bottom, vertical = re.search(
        r"N/m: (\S+) in top, (\S+) in bottom, (\S+) in vertical", str(refused.value)
    ).groups()
    assert float(vertical) == pytest.approx(np.sqrt(3) * float(top), rel=1e-11)
    assert (top, bottom) == ("10", "10")
    tc.prestress(structure, np.repeat([float(top), float(bottom), float(vertical)], 3))
