"""Strings that are wound once: forces of finite elements, and least mass beside many starts."""

import numpy as np
import pytest
from scipy.optimize import minimize

import tenscontrol as tc
from tests.benchmarks.least_mass import ROPE, SOFT, random_case

GIVEN = {"bars": SOFT, "strings": ROPE, "common_prestress": True}


def cross():
    return tc.Structure([[-1, 0, 1, 0], [0, -1.5, 0, 1]], [(0, 2), (1, 3)],
                        [(0, 1), (1, 2), (2, 3), (3, 0)], bar_mass=1.0)  # fmt: skip


def press(structure, first, last, force):
    """A pair of forces that press two nodes together."""
    way = structure.nodes[:, last] - structure.nodes[:, first]
    load = np.zeros(structure.nodes.shape)
    load[:, first], load[:, last] = [sign * force * way / np.linalg.norm(way) for sign in (1, -1)]
    return load


def elongation_rates(structure):
    """How much each member is longer per motion of free coordinates, a row each."""
    d, n = structure.nodes.shape
    rates = np.zeros((len(structure.strings) + len(structure.bars), n, d))
    segments = zip(structure.segment_string, structure.segments, strict=True)
    bars = ((len(structure.strings) + i, bar) for i, bar in enumerate(structure.bars))
    for row, (i, j) in (*segments, *bars):
        way = structure.nodes[:, j] - structure.nodes[:, i]
        way = way / np.linalg.norm(way)
        rates[row, j] += way
        rates[row, i] -= way
    return rates.reshape(len(rates), -1)[:, structure.free_rows]


def loaded_tensions(structure, stiffness, load):
    """Tensions of elastic members under a load, by displacements."""
    rates = elongation_rates(structure)
    K = rates.T @ (stiffness[:, None] * rates)
    moved = np.linalg.lstsq(K, load.T.ravel()[structure.free_rows], rcond=1e-11)[0]
    return stiffness * (rates @ moved)


def stiffness_of(structure, string_area, bar_area):
    return np.r_[
        ROPE.modulus * string_area / structure.string_length(),
        SOFT.modulus * bar_area / structure.bar_length,
    ]


def clustered():
    nodes = [[0, 1, 1, 0, 2], [0, 0, 1, 1, 0.5]]
    return tc.Structure(nodes, [(0, 2), (1, 3), (1, 4), (2, 4)], [(0, 1, 2), (2, 3), (3, 0)],
                        bar_mass=1.0)  # fmt: skip


def cases():
    ball, shape = tc.library.six_bar_ball(), cross()
    yield shape, [press(shape, 0, 2, 900.0), press(shape, 1, 3, -200.0)], 10.0
    yield ball, [press(ball, 0, 1, 300.0), press(ball, 2, 5, 200.0)], 50.0
    tower, random = tc.prism_tower(stages=1), np.random.default_rng(1)
    E = tc.statics.equilibrium_matrix(tower)
    loads = [(E @ random.uniform(-20, 40, E.shape[1])).reshape(-1, 3).T for _ in range(2)]
    yield tower, loads, 20.0


@pytest.fixture(scope="module", params=list(cases()), ids=["cross", "ball", "tower"])
def sized(request):
    structure, loads, low = request.param
    return structure, loads, low, tc.design(
        structure, **GIVEN, loads=loads, min_force_density=low, least_radius=1e-5
    )  # fmt: skip


def test_forces_are_those_of_finite_elements(sized):
    structure, loads, low, found = sized
    stiffness = stiffness_of(structure, found.string_area, found.bar_area)
    length = np.r_[structure.string_length(), structure.bar_length]
    rest = np.r_[found.prestress, -found.bar_prestress] * length
    assert np.abs(elongation_rates(structure).T @ rest).max() < 1e-7 * np.abs(rest).max()
    for load, pull, push in zip(loads, found.force_density, found.bar_force_density, strict=True):
        tension = rest + loaded_tensions(structure, stiffness, load)
        scale = np.abs(tension).max()
        np.testing.assert_allclose(np.r_[pull, -push] * length, tension, atol=1e-7 * scale)
    assert min(found.prestress.min(), found.force_density.min()) > low * (1 - 1e-6)


def test_members_hold_with_and_without_loads(sized):
    structure, _, _, found = sized
    gamma = np.vstack([found.force_density, found.prestress]).T
    lam = np.vstack([found.bar_force_density, found.bar_prestress]).T
    pulls, pushes = found.margins(
        gamma * structure.string_length()[:, None], lam * structure.bar_length[:, None]
    )
    assert min(pulls.min(), pushes.min()) > 1 - 1e-9
    alone = {"strings": ROPE, "bars": SOFT, "least_radius": 1e-5}
    free = tc.design(structure, **alone, loads=sized[1], min_force_density=sized[2])
    assert found.mass > free.mass * (1 - 1e-9)  # one prestress is less free than one for each load


def test_no_start_of_another_solver_is_lighter():
    structure = cross()
    loads = [press(structure, 0, 2, 900.0), press(structure, 1, 3, -200.0)]
    found = tc.design(structure, **GIVEN, loads=loads, min_force_density=10.0, least_radius=1e-5)
    length = np.r_[structure.string_length(), structure.bar_length]
    state = tc.prestress(structure, force_density=1.0)
    state = np.r_[state.force_density, -state.bar_force_density] * length
    per = np.r_[np.full(4, ROPE.density), np.full(2, SOFT.density)] * length
    low = 10 * length[:4] / np.abs(state[:4])

    def limits(z):
        area, rest = np.exp(z[:6]), z[6] * 1e3 * state
        both = [rest]
        stiffness = stiffness_of(structure, area[:4], area[4:])
        both += [rest + loaded_tensions(structure, stiffness, load) for load in loads]
        rows = []
        for tension in both:
            push = -tension[4:]
            euler = np.pi * SOFT.modulus * area[4:] ** 2 / (4 * length[4:] ** 2)
            rows += [
                tension[:4] / (10 * length[:4]) - 1,
                1 - tension[:4] / (ROPE.yield_stress * area[:4]),
                1 - np.abs(push) / (SOFT.yield_stress * area[4:]),
                1 - push / euler,
            ]
        return np.concatenate(rows)

    random, best = np.random.default_rng(0), np.inf
    centre = np.log(np.r_[found.string_area, found.bar_area])
    for _ in range(3):
        start = np.r_[centre + random.uniform(-1, 2, 6), low.max() * 1e-3 * random.uniform(1, 40)]
        answer = minimize(
            lambda z: np.log(per @ np.exp(z[:6])), start, method="SLSQP",
            constraints={"type": "ineq", "fun": limits}, options={"maxiter": 200, "ftol": 1e-12},
        )  # fmt: skip
        if limits(answer.x).min() > -1e-9:
            best = min(best, float(np.exp(answer.fun)))
    assert np.isfinite(best)
    assert found.mass <= best * (1 + 1e-6)
    assert found.mass == pytest.approx(best, rel=1e-5)


def test_a_cluster_shares_one_tension_and_counts_all_of_its_length():
    structure = clustered()
    rest = tc.design(structure, **GIVEN, min_force_density=20.0, least_radius=1e-5)
    load = press(structure, 1, 3, 5.0)
    found = tc.design(structure, **GIVEN, loads=[load], min_force_density=20.0, least_radius=1e-5)
    assert rest.prestress is not None
    stiffness = stiffness_of(structure, found.string_area, found.bar_area)
    length = np.r_[structure.string_length(), structure.bar_length]
    tension = loaded_tensions(structure, stiffness, load) + np.r_[
        found.prestress, -found.bar_prestress
    ] * length  # fmt: skip
    both = np.r_[found.force_density[0], -found.bar_force_density[0]] * length
    np.testing.assert_allclose(both, tension, atol=1e-7 * np.abs(tension).max())


def test_without_loads_it_is_the_design_of_the_prestress_alone():
    ball = tc.library.six_bar_ball()
    once = tc.design(ball, **GIVEN, min_force_density=50.0)
    each = tc.design(ball, bars=SOFT, strings=ROPE, min_force_density=50.0)
    assert once.mass == pytest.approx(each.mass, rel=1e-6)
    assert (once.bar_load == -1).all() or (once.bar_load == 0).all()


def test_what_cannot_be_wound_is_refused():
    shape = tc.Structure([[0, 1, 2], [0, 1, 0]], [(0, 1), (1, 2)], [(0, 2)], bar_mass=1.0,
                         fixed=[0, (2, "y")])  # fmt: skip
    load = np.array([[0, 0, 0], [0, -100.0, 0]])
    with pytest.raises(ValueError, match="no state of self-stress"):
        tc.design(shape, **GIVEN, loads=[load])
    structure, loads = random_case(2)
    tc.design(structure, bars=SOFT, strings=ROPE, loads=loads, restarts=1, least_radius=1e-5)
    with pytest.raises(ValueError, match="no self-stress has every string at min_force_density"):
        tc.design(structure, **GIVEN, loads=loads, restarts=1, least_radius=1e-5)
