"""Members that share a cross section: symmetry, equal lengths, and the least mass with both."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from scipy.optimize import linprog

import tenscontrol as tc
from tests.benchmarks.least_mass import ROPE, SOFT, random_case
from tests.random_structures import any_structure
from tests.sizing.test_design import ANGLES, d_bar, pressed

HARD = tc.Material(modulus=1e20, density=2700.0, yield_stress=110e6)


@pytest.mark.parametrize(
    ("structure", "strings", "bars"),
    [
        (tc.prism(), [6, 3], [3]),
        (tc.library.six_bar_ball(), [24], [6]),
        (d_bar(ANGLES[1]), [1], [4]),  # a rhombus in the plane
        (replace(d_bar(ANGLES[1]), fixed=[0]), [1], [2, 2]),  # one mirror is left
        (replace(tc.prism(), fixed=[0, 1, 2]), [3, 3, 3], [3]),
        (replace(tc.prism(), fixed=[0]), [1] * 9, [1] * 3),
    ],
)
def test_symmetry_is_found(structure, strings, bars):
    groups = tc.sizing.symmetry_groups(structure)
    assert sorted(map(len, groups["strings"])) == sorted(strings)
    assert sorted(map(len, groups["bars"])) == sorted(bars)


def all_maps(structure):
    """All permutations of few nodes that keep all distances and members, one by one."""
    N = structure.nodes
    apart = np.linalg.norm(N[:, :, None] - N[:, None], axis=0)
    bars = {frozenset(pair) for pair in structure.bars.tolist()}
    strings = {frozenset(pair) for pair in structure.strings.tolist()}
    for to in permutations(range(N.shape[1])):
        moved = list(to)
        if np.abs(apart[np.ix_(moved, moved)] - apart).max() > 1e-6:
            continue
        sets = [{frozenset(to[i] for i in pair) for pair in kind} for kind in (bars, strings)]
        if sets == [bars, strings]:
            yield np.array(to)


def test_groups_are_those_of_all_permutations_that_keep_distances():
    structure = tc.prism()
    maps = list(all_maps(structure))
    assert len(maps) == 6
    groups = tc.sizing.symmetry_groups(structure)
    pairs = [frozenset(pair) for pair in structure.strings.tolist()]
    for i, pair in enumerate(pairs):
        orbit = sorted({pairs.index(frozenset(to[list(pair)].tolist())) for to in maps})
        assert orbit in groups["strings"], i


def test_what_is_random_has_no_symmetry_but_equal_lengths_by_chance():
    structure = any_structure(7)
    groups = tc.sizing.symmetry_groups(structure)
    assert all(len(group) == 1 for group in groups["bars"])
    assert sum(map(len, tc.sizing.length_groups(structure)["bars"])) == len(structure.bars)


def test_a_group_has_the_area_of_its_neediest_member():
    structure = replace(d_bar(ANGLES[3]), fixed=[0, 2])
    given = {"bars": SOFT, "strings": ROPE, "min_force_density": 10.0}
    loads = [np.array([[2e3, 1e3, 0, 0], [0, -3e3, 0, 3e3]])]
    alone = tc.design(structure, **given, loads=loads)
    assert np.ptp(alone.bar_area) > 0.1 * alone.bar_area.max()
    found = tc.design(structure, **given, loads=loads, groups={"bars": [[0, 1, 2, 3]]})
    np.testing.assert_allclose(found.bar_area, found.bar_area[0], rtol=0)
    assert len(set(found.bar_sized_by.tolist())) == 1
    _, pushes = found.margins(
        *(density[0] * length for density, length in (
            (found.force_density, structure.string_length()),
            (found.bar_force_density, structure.bar_length),
        ))
    )  # fmt: skip
    assert pushes.argmin() == found.bar_sized_by[0]
    assert pushes.min() == pytest.approx(1.0, rel=1e-9)
    assert "sized by" in found.table()


@pytest.mark.parametrize("seed", [3, 11, 28])
def test_shared_areas_by_yield_are_those_of_another_statement(seed):
    structure, loads = random_case(seed)
    random, alpha, beta = np.random.default_rng(seed), len(structure.strings), len(structure.bars)
    thirds = [part.tolist() for part in np.array_split(random.permutation(alpha), 3)]
    halves = [part.tolist() for part in np.array_split(random.permutation(beta), 2)]
    found = tc.design(structure, bars=HARD, strings=ROPE, loads=loads, min_force_density=10.0,
                      least_radius=1e-6, groups={"strings": thirds, "bars": halves})  # fmt: skip
    area = np.r_[found.string_area, found.bar_area]
    parts = [*thirds, *[[alpha + i for i in half] for half in halves]]
    for part in parts:
        assert np.ptp(area[part]) <= 1e-12 * area[part].max(initial=0.0)
    # Tensions and signed pushes of each load, then areas of groups in mm².
    E = tc.statics.equilibrium_matrix(structure)[structure.free_rows]
    length = np.r_[structure.string_length(), structure.bar_length]
    count, cases = alpha + beta, len(loads)
    stress = np.r_[np.full(alpha, 300e6), np.full(beta, 110e6)]
    density = np.r_[np.full(alpha, 1100.0), np.full(beta, 2700.0)]
    cost = np.r_[np.zeros(cases * count), [1e-6 * density[part] @ length[part] for part in parts]]
    rows, equal, right = [], np.zeros((cases * len(E), len(cost))), []
    for k, load in enumerate(loads):
        equal[k * len(E) : (k + 1) * len(E), k * count : (k + 1) * count] = E / length
        right.append(load.T.ravel()[structure.free_rows])
        for g, part in enumerate(parts):
            for i in part:
                for sign in (1, -1):
                    row = np.zeros(len(cost))
                    row[k * count + i], row[cases * count + g] = sign, -stress[i] * 1e-6
                    rows.append(row)
    low = np.r_[np.tile(np.r_[10 * length[:alpha], np.full(beta, -np.inf)], cases)]
    bounds = np.c_[np.r_[low, np.full(len(parts), 1e6 * np.pi * 1e-12)], np.full(len(cost), np.inf)]
    answer = linprog(
        cost, np.array(rows), np.zeros(len(rows)), equal, np.concatenate(right), bounds
    )
    assert found.mass == pytest.approx(answer.fun, rel=1e-6)


@pytest.mark.parametrize(
    ("groups", "error", "message"),
    [
        ([[0, 1]], TypeError, "groups is"),
        ({"cables": [[0]]}, ValueError, "groups is 'cables'"),
        ({"bars": [[0, 4]]}, ValueError, r'groups\["bars"\]\[0\]\[1\] is 4'),
        ({"bars": [[0, 1], [1, 2]]}, ValueError, r"has bar 1, which is in .*\[0\] too"),
        ({"strings": ["top"]}, ValueError, "top"),
    ],
)
def test_groups_that_do_not_fit_are_refused(groups, error, message):
    structure = d_bar(ANGLES[2])
    with pytest.raises(error, match=message):
        tc.design(structure, bars=SOFT, strings=ROPE, loads=[pressed(structure, 0, 2)],
                  groups=groups)  # fmt: skip
