"""Structures of any class: copies, replacements, paths and numbering.

In space or in the plane, with rollers, point masses and clustered strings.
"""

import copy
import pickle
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st

import tenscontrol as tc
from tenscontrol.structure.structure import same_members

FIELDS = [field.name for field in fields(tc.Structure)]
DERIVED = (
    *("segments", "segment_string", "fixed_rows", "free_rows", "free", "string_nodes"),
    *("string_node_mass", "bar_length", "free_bars", "swinging_bars", "coupled_bars"),
)


def arguments(seed):
    """Arguments of a structure at random: bars share nodes, some strings run over several."""
    random = np.random.default_rng(seed)
    d, count = int(random.integers(2, 4)), int(random.integers(4, 9))
    nodes = random.normal(size=(d, count))
    pairs = [(i, j) for i in range(count) for j in range(i)]
    bars = [pairs[i] for i in random.permutation(len(pairs))[: random.integers(1, count + 1)]]
    strings = [random.permutation(count)[: random.integers(2, 5)].tolist() for _ in range(4)]
    strings += [[*path, path[0]] for path in strings[:1] if len(path) > 2]
    touched = {node for member in [*bars, *strings] for node in member}
    strings += [(node, (node + 1) % count) for node in range(count) if node not in touched]
    on_bar = set(np.ravel(bars))
    fixed = [int(node) for node in random.permutation(count)[:2]]
    pairs_held = [(n, "xyz"[random.integers(d)]) for n in range(count) if random.random() < 0.2]
    mass = random.random(count)
    mass[list(on_bar)] *= random.random(len(on_bar)) < 0.5
    mass[fixed] = 0.0
    return {
        "nodes": nodes,
        "bars": bars,
        "strings": strings,
        "bar_mass": 0.1 + random.random(len(bars)),
        "point_mass": mass,
        "fixed": [*fixed, *(pair for pair in pairs_held if pair[0] not in fixed)],
        "string_groups": [("top", "side")[i % 2] for i in range(len(strings))],
    }


seeds = st.integers(0, 100_000)


def assert_equal(one, other):
    for name in [*FIELDS, *DERIVED]:
        left, right = getattr(one, name), getattr(other, name)
        if isinstance(left, np.ndarray):
            np.testing.assert_array_equal(left, right)
            assert left.dtype == right.dtype
        else:
            assert left == right or (left is None and right is None)


@given(seeds)
def test_copies_are_the_same_structure(seed):
    structure = tc.Structure(**arguments(seed))
    for other in (
        pickle.loads(pickle.dumps(structure)), copy.deepcopy(structure), replace(structure),
    ):  # fmt: skip
        assert_equal(structure, other)
        assert same_members(structure, other)
        assert len(other.blocks) == len(structure.blocks)


@given(seeds)
def test_one_argument_can_be_replaced(seed):
    structure = tc.Structure(**arguments(seed))
    heavier = replace(structure, bar_mass=2.0, point_mass=2 * structure.point_mass)
    assert same_members(structure, heavier)
    np.testing.assert_array_equal(heavier.string_node_mass, 2 * structure.string_node_mass)
    if len(structure.string_nodes):
        alike = replace(structure, string_node_mass=0.7)
        assert (alike.point_mass[alike.string_nodes] == 0.7).all()
        others = np.setdiff1d(np.arange(structure.nodes.shape[1]), structure.string_nodes)
        np.testing.assert_array_equal(alike.point_mass[others], structure.point_mass[others])
    # What is held stays held; supports are taken away by rollers=().
    node = int(structure.fixed[0])
    fewer = replace(structure, fixed=structure.fixed[1:], point_mass=structure.point_mass + 0.0
                    + 0.1 * (np.arange(structure.nodes.shape[1]) == node))  # fmt: skip
    assert fewer.rollers == structure.rollers
    assert not same_members(structure, fewer)
    assert replace(structure, rollers=()).rollers == ()


@given(seeds)
def test_all_pairs_of_a_node_hold_it(seed):
    given_arguments = arguments(seed)
    structure = tc.Structure(**given_arguments)
    d = structure.dimension
    pairs = [(int(row) // d, "xyz"[int(row) % d]) for row in structure.fixed_rows]
    by_axis = tc.Structure(**(given_arguments | {"fixed": pairs}))
    assert_equal(structure, by_axis)
    again = tc.Structure(**(given_arguments | {"rollers": structure.rollers}))
    assert_equal(structure, again)
    every = np.concatenate([structure.fixed_rows, structure.free_rows])
    np.testing.assert_array_equal(np.sort(every), np.arange(structure.nodes.size))


@given(seeds)
def test_segments_part_the_paths_and_lengths_add_up(seed):
    given_arguments = arguments(seed)
    structure = tc.Structure(**given_arguments)
    length = np.zeros(len(structure.strings))
    for i, path in enumerate(given_arguments["strings"]):
        own = structure.segments[structure.segment_string == i]
        assert own.tolist() == [[a, b] for a, b in pairwise(path)]
        assert structure.strings[i].tolist() == [path[0], path[-1]]
        for a, b in own:
            length[i] += np.linalg.norm(structure.nodes[:, a] - structure.nodes[:, b])
    np.testing.assert_allclose(structure.string_length(), length, rtol=1e-14)
    np.testing.assert_array_equal(
        structure.string_vectors(structure.nodes),
        structure.nodes @ structure.C_s.toarray().T,
    )
    assert structure.has_clusters == any(len(path) > 2 for path in given_arguments["strings"])


@given(seeds, st.randoms(use_true_random=False))
def test_numbering_does_not_matter_to_blocks(seed, random):
    given_arguments = arguments(seed)
    structure = tc.Structure(**given_arguments)
    count = structure.nodes.shape[1]
    place = random.sample(range(count), count)
    nodes, mass = np.empty_like(structure.nodes), np.empty(count)
    nodes[:, place], mass[place] = structure.nodes, structure.point_mass
    changed = tc.Structure(
        nodes=nodes,
        bars=np.array(place)[structure.bars],
        strings=[[place[node] for node in path] for path in given_arguments["strings"]],
        bar_mass=structure.bar_mass,
        point_mass=mass,
        fixed=[
            (place[each[0]], each[1]) if isinstance(each, tuple) else place[each]
            for each in given_arguments["fixed"]
        ],
    )
    assert changed.structure_class == structure.structure_class

    def sizes(of):
        return sorted((*block.bars.tolist(), len(block.independent)) for block in of.blocks)

    assert sizes(changed) == sizes(structure)
    for name in ("free_bars", "swinging_bars", "coupled_bars"):
        np.testing.assert_array_equal(getattr(changed, name), getattr(structure, name))


@pytest.mark.parametrize("seed", range(5))
def test_arrays_cannot_be_changed(seed):
    structure = tc.Structure(**arguments(seed))
    for name in [*FIELDS, *DERIVED]:
        value = getattr(structure, name)
        if isinstance(value, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                value[...] = 0
    for block in structure.blocks:
        for name in ("nodes", "rows", "bars", "independent", "order"):
            with pytest.raises(ValueError, match="read-only"):
                getattr(block, name)[...] = 0


def test_members_differ_by_supports_and_paths():
    square = {
        "nodes": [[0, 1, 1, 0], [0, 0, 1, 1]], "bars": [(0, 1), (1, 2)], "bar_mass": 1.0,
        "point_mass": [0, 0, 0, 0.1],
    }  # fmt: skip
    straight = tc.Structure(strings=[(2, 3), (3, 0)], **square)
    over = tc.Structure(strings=[(2, 3, 0)], **square)
    assert not same_members(straight, over)
    assert same_members(straight, replace(straight, nodes=straight.nodes * 2))
    rolling = replace(straight, fixed=[(2, "x")])
    assert not same_members(straight, rolling)
    assert same_members(rolling, replace(straight, rollers=[(2, "x")]))
    flat = replace(straight, nodes=np.vstack([straight.nodes, np.zeros(4)]))
    assert flat.dimension == 3
    assert not same_members(straight, flat)
