"""Large structures: the same numbers by sparse factorizations as by whole decompositions."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import subspace_angles
from scipy.optimize import linprog

import tenscontrol as tc
from tests.known_structures import KNOWN, class2_tower
from tests.random_structures import any_structure
from tests.statics.structures import random_any, square_body, star_prism
from tests.statics.test_prestress import prism_with_extra_strings

MATRIX = sys.modules["tenscontrol.statics.equilibrium_matrix"]
LEAST_DISTANCE = sys.modules["tenscontrol.statics.least_distance"]
EXACT = 1e-8

SHAPES = {
    **KNOWN,
    "tall class-2 tower": lambda: class2_tower(8),
    "prism of six": lambda: tc.prism(6),
    "star prism": lambda: star_prism(7, 3, 2),
    "square body": square_body,
    "net": lambda: tc.net(4, 5, 0.1, 0.01),
    "massive strings": lambda: tc.subdivide(tc.prism(), 4, 0.01),
    "levy dome": tc.library.levy_dome,
    "balls": tc.library.thirty_bar_ball,
    **{f"random {i}": lambda i=i: any_structure(i) for i in range(4)},
    **{f"any {i}": lambda i=i: random_any(i) for i in range(4)},
}
LARGE = ("massive strings", "levy dome", "balls", "any 1", "any 2", "random 1", "random 2")
ASKED = (
    {"force_density": 10.0},
    {"min_force_density": 3.0},
    {"max_force_density": 7.0},
    {"force_density": 10.0, "min_force_density": 2.0, "max_force_density": 12.0},
)


def both(monkeypatch, ask):
    """The answers of the whole way and of the sparse one."""
    answers = []
    for few in (10**9, -1):
        monkeypatch.setattr(MATRIX, "_FEW", few)
        answers.append(ask())
    return answers


def judged(rest, stiffness):
    again = replace(rest)  # without what it remembers
    return again.stability, again.tangent_stiffness(stiffness, 2)


def refused_or(ask):
    try:
        return ask()
    except ValueError as error:
        return str(error)[:40]


@pytest.mark.parametrize("name", SHAPES)
def test_motions_that_keep_lengths_are_the_same(name, monkeypatch):
    structure = SHAPES[name]()
    forces = MATRIX.member_forces(structure, np.zeros(len(structure.free_rows)))
    picture = MATRIX.affine_picture(structure)
    whole, sparse = both(
        monkeypatch, lambda: MATRIX.kept_lengths(structure, picture, forces.matrix)
    )
    assert whole.rank == sparse.rank
    assert sparse.lost < 1e-14
    if whole.motions.shape[1]:
        assert np.sin(subspace_angles(whole.motions, sparse.motions)).max() < 1e-12


@pytest.mark.parametrize("name", [name for name in SHAPES if name not in LARGE])
def test_prestress_and_stability_are_the_same(name, monkeypatch):
    structure = SHAPES[name]()
    for asked in ASKED[list(SHAPES).index(name) % 2 :: 2]:
        whole, sparse = both(
            monkeypatch, lambda asked=asked: refused_or(lambda: tc.prestress(structure, **asked))
        )
        if isinstance(whole, str):
            assert sparse == whole
            continue
        unit = whole.force_density.max()
        for one, other in (
            (whole.force_density, sparse.force_density),
            (whole.bar_force_density, sparse.bar_force_density),
        ):
            np.testing.assert_allclose(other, one, rtol=0, atol=EXACT * unit)
        assert (whole.self_stress_states, whole.mechanisms) == (
            sparse.self_stress_states, sparse.mechanisms,
        )  # fmt: skip
        stiffness = 100.0 * unit
        one, other = both(monkeypatch, lambda rest=whole, k=stiffness: judged(rest, k))
        assert one[0].is_stable == other[0].is_stable
        assert one[0].is_super_stable == other[0].is_super_stable
        if np.abs(one[0].mechanism_stiffness).max(initial=unit) > EXACT * unit:  # else: no stress
            assert one[0].stress_matrix_rank_defect == other[0].stress_matrix_rank_defect
        for ours, theirs, size in (
            (one[0].mechanism_stiffness, other[0].mechanism_stiffness, unit),
            (one[1].eigenvalues, other[1].eigenvalues, stiffness),
        ):
            np.testing.assert_allclose(theirs, ours, rtol=0, atol=EXACT * size)
        assert one[1].is_stable == other[1].is_stable


MANY = {
    "class-2 tower": lambda: tc.library.class2_tower(25),
    "net": lambda: tc.net(9, 9, 0.1, 0.01, fixed="edges"),
    "net held at corners": lambda: tc.net(9, 9, 0.1, 0.01),
    "skins": lambda: tc.skin(tc.prism_tower(4), ("top", "bottom"), iterations=3, node_mass=0.01),
}


@pytest.mark.parametrize("name", MANY)
def test_the_lowest_of_many_mechanism_stiffnesses_are_those_of_all(name, monkeypatch):
    module = sys.modules["tenscontrol.statics.stability"]
    monkeypatch.setattr(MATRIX, "_FEW", -1)
    rest = tc.prestress(MANY[name](), 10.0)
    answers = []
    for many in (10, 10**9):
        monkeypatch.setattr(module, "_MANY", many)
        answers.append(replace(rest).stability)
    lowest, every = answers
    assert len(lowest.mechanism_stiffness) == module._LOWEST < len(every.mechanism_stiffness)
    assert lowest.is_stable == every.is_stable
    assert lowest.is_super_stable == every.is_super_stable
    assert lowest.stress_matrix_rank_defect == every.stress_matrix_rank_defect
    expected = every.mechanism_stiffness[: module._LOWEST]
    np.testing.assert_allclose(lowest.mechanism_stiffness, expected, rtol=0, atol=EXACT)


@pytest.mark.parametrize("seed", range(8))
def test_sparse_prestress_is_refused_where_a_linear_program_is_infeasible(seed, monkeypatch):
    structure = prism_with_extra_strings(seed)
    monkeypatch.setattr(MATRIX, "_FEW", -1)
    E = tc.statics.equilibrium_matrix(structure)
    program = linprog(
        np.zeros(20), A_eq=E, b_eq=np.zeros(24), bounds=[(3.0, None)] * 16 + [(None, None)] * 4
    )
    found = refused_or(lambda: tc.prestress(structure, min_force_density=3.0))
    assert isinstance(found, str) == (program.status == 2)


@pytest.mark.parametrize("asked", ASKED[:2])
def test_a_prestress_takes_as_many_factorizations_whatever_the_height(asked, monkeypatch):
    monkeypatch.setattr(MATRIX, "_FEW", -1)
    factored = LEAST_DISTANCE._Program._factored
    counts = []
    for stages in (8, 20):
        count = []

        def counted(self, *matrices, count=count):
            count.append(1)
            return factored(self, *matrices)

        monkeypatch.setattr(LEAST_DISTANCE._Program, "_factored", counted)
        tc.prestress(tc.prism_tower(stages), **asked)
        counts.append(len(count))
    assert counts[1] <= 1.5 * counts[0] <= 25


def test_a_mean_level_fills_no_factors(monkeypatch):
    """Its equation has entries of all strings; no column that is factorized has as many."""
    from scipy.sparse import linalg

    factorize, longest = linalg.splu, []

    def counted(matrix, *args, **kwargs):
        longest.append(int(np.diff(matrix.indptr).max()))
        return factorize(matrix, *args, **kwargs)

    monkeypatch.setattr(linalg, "splu", counted)
    for stages in (40, 80):
        tc.prestress(tc.library.class2_tower(stages), 10.0)
    assert 0 < max(longest) < 40


def test_factors_of_a_net_fill_little_faster_than_it_grows(monkeypatch):
    """Any order of elimination leaves n log n entries of a net of n knots, or more.

    Along its strings motions that keep lengths are apart: one chain for each string.
    """
    from scipy.sparse import linalg

    # By singular values, axes of equal extents are across the strings of these two.
    nets = [tc.net(side, side, 0.1, 0.01, fixed="edges") for side in (32, 64)]
    rests = [tc.prestress(net, 10.0) for net in nets]
    factorize, entries = linalg.splu, []

    def counted(*args, **kwargs):
        factors = factorize(*args, **kwargs)
        entries[-1].append(factors.L.nnz / factors.shape[0])
        return factors

    monkeypatch.setattr(linalg, "splu", counted)
    for rest in rests:
        entries.append([])
        assert rest.stability.is_stable
        assert entries[-1][0] < 2
    assert 1 < sum(entries[1]) / sum(entries[0]) < 4**0.3


def test_a_tall_tower_is_super_stable_and_its_lowest_stiffness_is_of_a_beam():
    """Twice as high: a beam that is free at its ends is softer by 2⁴ a unit length."""
    lowest = []
    for stages in (40, 80):
        rest = tc.prestress(tc.prism_tower(stages), 10.0, "vertical")
        assert (rest.mechanisms, rest.self_stress_states) == (0, 6 * stages - 6)
        assert rest.is_super_stable
        found = rest.tangent_stiffness(1e3, count=2)
        assert found.is_stable
        lowest.append(found.eigenvalues[0])
        assert found.eigenvalues[1] == pytest.approx(lowest[-1], rel=1e-4)
    assert lowest[0] / lowest[1] == pytest.approx(16.0, rel=0.15)


@pytest.mark.parametrize(("pivot", "orders"), [(0.5, 1), (1e-17, 2)])
def test_factors_are_judged_by_motions_without_rigid_ones(pivot, orders, monkeypatch):
    """A chain whose ends are free moves far as a whole, and springs of it hardly change length."""
    from scipy.sparse import block_diag, diags_array, linalg

    factorize, names = linalg.splu, []

    def counted(matrix, permc_spec="COLAMD", **how):
        names.append(permc_spec)
        return factorize(matrix, permc_spec=permc_spec, **how)

    monkeypatch.setattr(linalg, "splu", counted)
    n = 300
    diagonal = np.full(n, 2.0)
    diagonal[[0, -1]] = 1.0
    springs = diags_array([diagonal + 1e-12, -np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1, -1])
    pair = [[pivot, 1.0], [1.0, pivot]]
    matrix = block_diag([springs, pair], format="csc")
    load = np.cos(np.pi * np.arange(0.5, n) / n)
    right = np.append(load + 0.005, [1.0, 2.0])

    def motion(solution):
        return np.append(np.diff(solution[:n]), solution[n:])

    module = sys.modules["tenscontrol.statics.stability"]
    factors = module._factors_of_saddle(matrix, right, motion)
    solution = factors.solve(right)
    assert np.linalg.norm(matrix @ solution - right) > module._SOLVED * np.linalg.norm(right)
    assert len(names) == orders
    expected = np.append(-np.cumsum(load)[:-1], np.linalg.solve(pair, [1.0, 2.0]))
    np.testing.assert_allclose(motion(solution), expected, rtol=0, atol=1e-3)


def test_all_eigenvalues_of_a_large_structure_are_refused_with_a_hint():
    tower = tc.prism_tower(1500)
    gamma, lam = np.ones(len(tower.strings)), np.ones(len(tower.bars))
    rest = tc.statics.Prestress(tower, gamma, lam, 0 * tower.nodes, 0.0)
    with pytest.raises(ValueError, match="Give count"):
        rest.tangent_stiffness(1e3)


@pytest.mark.parametrize(
    "structure",
    [
        tc.net(8, 9, 0.1, 0.01, fixed="edges"),
        tc.subdivide(tc.prism_tower(3), 4, 0.01),
        tc.prism_tower(4),
    ],
    ids=["net", "massive strings", "tower"],
)
def test_clear_mechanisms_are_counted_without_a_basis(structure, monkeypatch):
    monkeypatch.delattr(MATRIX, "nearly_null")
    load = np.zeros(len(structure.free_rows))
    whole, sparse = both(monkeypatch, lambda: MATRIX.member_forces(structure, load).rank)
    assert whole == sparse


def test_mechanisms_of_a_large_net_are_counted():
    """Each knot moves out of the plane."""
    net = tc.net(50, 50, 0.1, 0.01, fixed="edges")
    rest = tc.prestress(net, 10.0)
    assert rest.mechanisms == 48**2
    assert rest.self_stress_states == len(net.strings) - 4 * 49 - 2 * 48**2


@pytest.mark.parametrize("bend", [1e-2, 1e-3, 1e-5])
def test_motions_that_change_lengths_a_little_are_no_mechanisms(bend, monkeypatch):
    net = tc.net(6, 7, 0.1, 0.01, fixed="edges")
    nodes = net.nodes.copy()
    nodes[2] += bend * np.sin(3 * nodes[0]) * np.cos(50 * nodes[1])
    bent = replace(net, nodes=nodes)
    counts = both(
        monkeypatch, lambda: MATRIX.member_forces(bent, np.zeros(len(bent.free_rows))).rank
    )
    assert counts[0] == counts[1]
