"""Least mass: closed forms, other solvers, many starts, and loads that cannot be carried."""

import numpy as np
import pytest
from scipy.optimize import linprog

import tenscontrol as tc
from tests.random_structures import any_structure

SOFT = tc.Material(modulus=60e9, density=2700.0, yield_stress=110e6)
ROPE = tc.Material(modulus=2e9, density=1100.0, yield_stress=300e6)
FORCE, SPAN = 1e4, 2.0


def d_bar(angle):
    """Four bars around a string, 2 m long, in compression."""
    high = SPAN / 2 * np.tan(angle)
    nodes = [[-SPAN / 2, 0, SPAN / 2, 0], [0, high, 0, -high]]
    bars = [[0, 1], [1, 2], [2, 3], [3, 0]]
    return tc.Structure(nodes, bars, [[1, 3]], bar_mass=1.0)


def d_bar_in_space(angle):
    """Six bars around a triangle of strings."""
    high, turn = SPAN / 2 * np.tan(angle), 2 * np.pi / 3 * np.arange(3)
    rim = np.vstack([np.zeros(3), high * np.cos(turn), high * np.sin(turn)])
    nodes = np.hstack([[[-SPAN / 2], [0], [0]], [[SPAN / 2], [0], [0]], rim])
    bars = [[0, k] for k in (2, 3, 4)] + [[1, k] for k in (2, 3, 4)]
    return tc.Structure(nodes, bars, [[2, 3], [3, 4], [4, 2]], bar_mass=1.0)


def pressed(structure, first, last):
    load = np.zeros(structure.nodes.shape)
    load[0, first], load[0, last] = FORCE, -FORCE
    return load


ANGLES = np.radians([10, 25, 45, 60, 75])


@pytest.mark.parametrize("angle", ANGLES)
def test_planar_d_bar_has_the_mass_of_the_closed_form(angle):
    structure = d_bar(angle)
    found = tc.design(structure, bars=SOFT, strings=ROPE, loads=[pressed(structure, 0, 2)],
                      min_force_density=0.0)  # fmt: skip
    column = 2 * SOFT.density * SPAN**2 * np.sqrt(FORCE / (np.pi * SOFT.modulus))
    string = ROPE.density / ROPE.yield_stress * FORCE * SPAN * np.tan(angle) ** 2
    expected = column / np.sqrt(2) * np.cos(angle) ** -2.5 + string
    assert found.mass == pytest.approx(expected, rel=1e-9)
    assert set(found.bar_limit) == {"buckling"}
    assert found.restarts_agree


@pytest.mark.parametrize("angle", ANGLES)
def test_d_bar_in_space_has_the_mass_of_the_closed_form(angle):
    structure = d_bar_in_space(angle)
    found = tc.design(structure, bars=SOFT, strings=ROPE, loads=[pressed(structure, 0, 1)],
                      min_force_density=0.0)  # fmt: skip
    length, push = SPAN / 2 / np.cos(angle), FORCE / (3 * np.cos(angle))
    bars = 6 * 2 * SOFT.density * length**2 * np.sqrt(push / (np.pi * SOFT.modulus))
    side = np.sqrt(3) * SPAN / 2 * np.tan(angle)
    # At a node of the rim two bars push outwards by 2 F/3 tan α, two strings hold by √3 T.
    pull = 2 * FORCE / 3 * np.tan(angle) / np.sqrt(3)
    strings = 3 * ROPE.density / ROPE.yield_stress * pull * side
    assert found.mass == pytest.approx(bars + strings, rel=1e-9)


def random_case(seed):
    """A random structure, and two loads that it carries with every string at 10 N/m or more."""
    structure, random = any_structure(seed), np.random.default_rng(seed)
    alpha = len(structure.strings)
    E = tc.statics.equilibrium_matrix(structure)
    loads = []
    for _ in range(2):
        density = np.r_[
            random.uniform(10, 500, alpha), random.uniform(-300, 900, E.shape[1] - alpha)
        ]
        load = (E @ density).reshape(-1, structure.dimension).T
        load[:, structure.fixed] = 0
        loads.append(load)
    return structure, loads


def needed(structure, forces):
    """The mass of all members under forces (K, α + β), written again."""
    alpha = len(structure.strings)
    pull = np.maximum(forces[:, :alpha], 0) / ROPE.yield_stress
    push = forces[:, alpha:]
    column = 2 * structure.bar_length * np.sqrt(np.maximum(push, 0) / (np.pi * SOFT.modulus))
    area = np.maximum(np.abs(push) / SOFT.yield_stress, column)
    strings = ROPE.density * pull.max(axis=0) @ structure.string_length()
    return strings + SOFT.density * area.max(axis=0) @ structure.bar_length


@pytest.mark.parametrize("seed", range(50))
def test_least_mass_of_random_structures(seed):
    structure, loads = random_case(seed)
    low = 10.0
    found = tc.design(structure, bars=SOFT, strings=ROPE, loads=loads, min_force_density=low,
                      least_radius=1e-6, restarts=8)  # fmt: skip
    E = tc.statics.equilibrium_matrix(structure)[structure.free_rows]
    densities = np.hstack([found.force_density, found.bar_force_density])
    assert (found.force_density >= low * (1 - 1e-7)).all()
    for load, density in zip(loads, densities, strict=True):
        w = load.T.ravel()[structure.free_rows]
        np.testing.assert_allclose(E @ density, w, atol=1e-6 * np.abs(w).max())
    length = np.r_[structure.string_length(), structure.bar_length]
    assert found.mass == pytest.approx(needed(structure, densities * length), rel=1e-4)
    pulls, pushes = found.margins(*np.split((densities * length).T, [len(structure.strings)]))
    assert min(pulls.min(), pushes.min()) > 1 - 1e-9
    # The least of a concave mass is at a corner: none of many random ones is lighter.
    assert found.mass <= least_of_many_corners(structure, E, loads, low, seed) * (1 + 1e-6)


def least_of_many_corners(structure, E, loads, low, seed):
    """The least mass at 50 corners of the balanced forces of each load, met by random costs."""
    random, alpha, beta = np.random.default_rng(seed), len(structure.strings), len(structure.bars)
    length = np.r_[structure.string_length(), structure.bar_length]
    if np.linalg.matrix_rank(E) == E.shape[1]:
        return np.inf  # one set of forces alone
    unit = np.hstack([E / length, -E[:, alpha:] / length[alpha:]])  # bars push or pull
    bounds = [(low * size, None) for size in length[:alpha]] + [(0.0, None)] * (2 * beta)
    corners = np.zeros((50, len(loads), alpha + beta))
    for start in range(50):
        cost = 10 ** random.uniform(-2, 2, alpha + 2 * beta)
        for k, load in enumerate(loads):
            w = load.T.ravel()[structure.free_rows]
            x = linprog(cost, A_eq=unit, b_eq=w, bounds=bounds).x
            corners[start, k] = x[: alpha + beta]
            corners[start, k, alpha:] -= x[alpha + beta :]
    return min(needed(structure, forces) for forces in corners)


def test_yield_alone_is_the_linear_program_of_another_statement():
    hard = tc.Material(modulus=1e20, density=2700.0, yield_stress=110e6)
    for seed in range(10):
        structure, loads = random_case(seed)
        found = tc.design(structure, bars=hard, strings=ROPE, loads=loads[:1],
                          min_force_density=10.0, least_radius=1e-6)  # fmt: skip
        assert found.restarts_agree
        E = tc.statics.equilibrium_matrix(structure)[structure.free_rows]
        least = least_by_interior_point(structure, E, loads[0].T.ravel()[structure.free_rows])
        assert found.mass == pytest.approx(least, rel=1e-4)


def least_by_interior_point(structure, E, w):
    """Least mass by yield with bars as a push less a pull, by CasADi's IPOPT."""
    import casadi as ca

    length = np.r_[structure.string_length(), structure.bar_length]
    alpha, beta = len(structure.strings), len(structure.bars)
    unit, size = E / length, np.abs(w).max()
    per = np.r_[
        ROPE.density / ROPE.yield_stress * length[:alpha], 2700 / 110e6 * length[alpha:]
    ]  # fmt: skip
    x = ca.SX.sym("x", alpha + 2 * beta)
    force = ca.vertcat(x[: alpha + beta])
    force[alpha:] -= x[alpha + beta :]
    cost = np.r_[per, per[alpha:]]
    solver = ca.nlpsol(
        "s", "ipopt", {"x": x, "f": ca.dot(cost / cost.max(), x), "g": unit @ force},
        {"print_time": 0, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10},
    )  # fmt: skip
    low = np.r_[10.0 * length[:alpha] / size, np.zeros(2 * beta)]
    answer = solver(x0=low + 1, lbx=low, ubx=np.inf, lbg=w / size, ubg=w / size)
    return float(answer["f"]) * cost.max() * size


def test_a_tube_is_lighter_by_its_ratio():
    structure = d_bar(ANGLES[2])
    given = {"bars": SOFT, "strings": ROPE, "loads": [pressed(structure, 0, 2)]}
    solid = tc.design(structure, **given, min_force_density=0.0)
    tube = tc.design(structure, **given, min_force_density=0.0, tube=tc.sizing.Tube(0.9))
    ratio = np.sqrt((1 - 0.81) / (1 + 0.81))
    np.testing.assert_allclose(tube.bar_area / solid.bar_area, ratio)
    np.testing.assert_allclose(tube.buckling_force, solid.buckling_force)


def test_safety_counts_and_loads_share_areas():
    structure = d_bar(ANGLES[2])
    load = pressed(structure, 0, 2)
    given = {"bars": SOFT, "strings": ROPE, "min_force_density": 0.0}
    both = tc.design(structure, **given, loads=[load, 2 * load])
    double = tc.design(structure, **given, loads=[load], safety=2.0)
    assert both.mass == pytest.approx(double.mass, rel=1e-9)
    assert both.bar_load.tolist() == [1] * 4


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"loads": [np.eye(2, 4)]}, r"loads\[0\] cannot be carried .* hold nodes"),
        ({"loads": []}, "nothing is to be carried"),
        ({"safety": 0.1}, "safety is 0.1, expected at least 1"),
        ({"min_force_density": -1.0}, "min_force_density"),
        ({"least_radius": -1.0}, "least_radius"),
    ],
)
def test_what_cannot_be_is_refused(changed, message):
    structure = d_bar(ANGLES[2])
    given = {"bars": SOFT, "strings": ROPE, "loads": [pressed(structure, 0, 2)]}
    with pytest.raises(ValueError, match=message):
        tc.design(structure, **{**given, **changed})


def test_a_member_without_force_needs_a_least_radius():
    structure = d_bar(ANGLES[2])
    load = np.zeros((2, 4))
    with pytest.raises(ValueError, match="give min_force_density"):
        tc.design(structure, bars=SOFT, strings=ROPE, loads=[load], min_force_density=0.0)
    bridge = tc.Structure(
        [[-1, 0, 1, 0, 3, 4], [0, 1, 0, -1, 0, 0]],
        [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5]], [[1, 3]], bar_mass=1.0, fixed=[4],
    )  # fmt: skip
    with pytest.raises(ValueError, match="bar 4 carries no force under any load"):
        tc.design(bridge, bars=SOFT, strings=ROPE, loads=[pressed(bridge, 0, 2)])
