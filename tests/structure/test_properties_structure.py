"""Structures at large: any class-1 structure obeys the paper's products, and no other is accepted.

Coordinates are eighths, so that sums and differences of them are exact.
"""

from dataclasses import FrozenInstanceError
from itertools import combinations
from math import prod

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

import tenscontrol as tc

MATRICES = ("C_b", "C_r", "C_s", "C_nb", "C_ns", "C_sb", "C_ss")
ARRAYS = ("nodes", "bars", "strings", "bar_mass", "string_node_mass")
MEASURES = ("bar_nodes", "string_nodes", "bar_length")

GROUPS = np.array(["top", "side", "net_2"])


def small_numbers(count):
    """So many whole numbers from -128 to 127, drawn as one: each alone takes ten times as long."""
    return st.binary(min_size=count, max_size=count).map(lambda b: np.frombuffer(b, np.int8))


def masses(count):
    return small_numbers(count).map(lambda numbers: 10.0 ** (numbers / 64))


def orders(count):
    return small_numbers(count).map(lambda numbers: np.argsort(numbers, kind="stable").tolist())


def eighths(*shape):
    return small_numbers(prod(shape)).map(lambda numbers: numbers.reshape(shape) / 8)


@st.composite
def arguments(draw, least_bars=0, least_points=0, least_strings=0):
    """Arguments of a Structure: bars and string nodes, numbered at random."""
    bars = draw(st.integers(least_bars, 4))
    points = draw(st.integers(max(least_points, 2 if bars == 0 else 0), 3))
    count = 2 * bars + points
    order = draw(orders(count))
    places = draw(eighths(count, 3))
    assume(len(set(map(tuple, places.tolist()))) == count)
    bar_pairs = [tuple(order[2 * i : 2 * i + 2]) for i in range(bars)]
    taken = {frozenset(pair) for pair in bar_pairs}
    free = [pair for pair in combinations(range(count), 2) if frozenset(pair) not in taken]
    assume(len(free) >= least_strings)
    chosen = draw(st.sets(st.sampled_from(free), min_size=least_strings)) if free else set()
    for point in order[2 * bars :]:
        if not any(point in pair for pair in chosen):
            chosen.add(draw(st.sampled_from([pair for pair in free if point in pair])))
    turned = draw(small_numbers(len(chosen))) % 2
    strings = [pair[::-1] if i else pair for pair, i in zip(sorted(chosen), turned, strict=True)]
    strings = [strings[i] for i in draw(orders(len(strings)))]
    return {
        "nodes": places.T,
        "bars": np.array(bar_pairs, dtype=int).reshape(-1, 2),
        "strings": np.array(strings, dtype=int).reshape(-1, 2),
        "bar_mass": draw(masses(bars)),
        "string_node_mass": draw(masses(points)) if points else None,
        "string_groups": GROUPS[draw(small_numbers(len(strings))) % 3].tolist(),
    }


def structures(**least):
    return arguments(**least).map(lambda given: tc.Structure(**given))


@st.composite
def structures_and_shapes(draw, **least):
    """A structure and node positions that are not its own."""
    structure = draw(structures(**least))
    count = structure.nodes.shape[1]
    return structure, draw(eighths(3, count))


def dense(structure, name):
    return getattr(structure, name).toarray()


# ---- the paper's products ----


@given(structures_and_shapes())
def test_connectivity_times_nodes_are_the_member_vectors(case):
    structure, N = case
    bars, strings = structure.bars, structure.strings
    B = N @ dense(structure, "C_nb").T @ dense(structure, "C_b").T
    S = N @ dense(structure, "C_s").T
    np.testing.assert_array_equal(B, N[:, bars[:, 1]] - N[:, bars[:, 0]])
    np.testing.assert_array_equal(S, N[:, strings[:, 1]] - N[:, strings[:, 0]])
    np.testing.assert_array_equal(structure.bar_vectors(N), B)
    np.testing.assert_array_equal(structure.string_vectors(N), S)


@given(structures_and_shapes())
def test_lengths_are_those_of_the_vectors(case):
    structure, N = case
    S = structure.string_vectors(N)
    np.testing.assert_allclose(structure.string_length(N) ** 2, (S**2).sum(axis=0), rtol=1e-14)
    np.testing.assert_array_equal(
        structure.string_length(), structure.string_length(structure.nodes)
    )
    B = structure.bar_vectors(structure.nodes)
    np.testing.assert_allclose(structure.bar_length**2, (B**2).sum(axis=0), rtol=1e-14)


@given(structures_and_shapes())
def test_centres_of_mass_are_halfway(case):
    structure, N = case
    centres = N @ dense(structure, "C_nb").T @ dense(structure, "C_r").T
    ends = N[:, structure.bars]
    np.testing.assert_array_equal(centres, ends.sum(axis=2) / 2)


@given(structures())
def test_string_connectivity_is_parted_into_bar_nodes_and_string_nodes(structure):
    parts = [dense(structure, name) for name in ("C_sb", "C_nb", "C_ss", "C_ns")]
    C_sb, C_nb, C_ss, C_ns = parts
    np.testing.assert_array_equal(C_sb @ C_nb + C_ss @ C_ns, dense(structure, "C_s"))
    np.testing.assert_array_equal(dense(structure, "C_s") @ C_nb.T, C_sb)
    np.testing.assert_array_equal(dense(structure, "C_s") @ C_ns.T, C_ss)


@given(structures())
def test_selections_are_orthogonal_and_take_every_node_once(structure):
    C_nb, C_ns = dense(structure, "C_nb"), dense(structure, "C_ns")
    both = np.vstack([C_nb, C_ns])
    count = structure.nodes.shape[1]
    np.testing.assert_array_equal(both @ both.T, np.eye(count))
    np.testing.assert_array_equal(both.T @ both, np.eye(count))
    np.testing.assert_array_equal(C_nb @ C_ns.T, 0)
    assert set(np.unique(both)) <= {0.0, 1.0}
    # Nodes keep their order within each kind.
    np.testing.assert_array_equal(C_nb @ np.arange(count), structure.bar_nodes)
    np.testing.assert_array_equal(C_ns @ np.arange(count), structure.string_nodes)


@given(structures())
def test_members_take_from_their_start_what_they_give_to_their_end(structure):
    for name, count in (("C_b", len(structure.bars)), ("C_s", len(structure.strings))):
        matrix = dense(structure, name)
        assert len(matrix) == count
        np.testing.assert_array_equal(matrix.sum(axis=1), 0)
        np.testing.assert_array_equal(np.abs(matrix).sum(axis=1), 2)
    # Class 1: every bar node is on one bar.
    np.testing.assert_array_equal(np.abs(dense(structure, "C_b")).sum(axis=0), 1)


@given(structures())
def test_string_groups_part_the_strings(structure):
    group_of = {}
    for group in set(structure.string_groups):
        for string in structure.strings_in(group).tolist():
            assert string not in group_of
            group_of[string] = group
    assert [group_of[string] for string in range(len(structure.strings))] == list(
        structure.string_groups
    )


@given(structures_and_shapes())
def test_restored_bars_have_their_length_and_stay_when_restored_again(case):
    structure, N = case
    assume((np.linalg.norm(structure.bar_vectors(N), axis=0) > 0).all())
    mended = tc.structure.restore_bar_lengths(structure, N)
    length = np.linalg.norm(structure.bar_vectors(mended), axis=0)
    np.testing.assert_allclose(length, structure.bar_length, rtol=1e-12)
    again = tc.structure.restore_bar_lengths(structure, mended)
    np.testing.assert_allclose(again, mended, rtol=0, atol=1e-12)
    points = structure.string_nodes
    np.testing.assert_array_equal(mended[:, points], N[:, points])


# ---- the order of nodes and members ----


@given(arguments(), st.randoms(use_true_random=False))
def test_renumbered_nodes_give_renumbered_matrices(given_arguments, random):
    structure = tc.Structure(**given_arguments)
    count = structure.nodes.shape[1]
    place = np.array(random.sample(range(count), count))
    nodes = np.empty_like(structure.nodes)
    nodes[:, place] = structure.nodes
    masses_of = dict(zip(structure.string_nodes, structure.string_node_mass, strict=True))
    origin = np.argsort(place)
    points = [new for new in range(count) if origin[new] in masses_of]
    changed = tc.Structure(
        nodes=nodes,
        bars=place[structure.bars],
        strings=place[structure.strings],
        bar_mass=structure.bar_mass,
        string_node_mass=[masses_of[origin[new]] for new in points] if points else None,
        string_groups=structure.string_groups,
    )
    moved = np.eye(count)[:, origin]  # columns of the old order, in the new one
    np.testing.assert_array_equal(changed.string_nodes, points)
    np.testing.assert_array_equal(changed.bar_nodes, np.sort(place[structure.bar_nodes]))
    np.testing.assert_array_equal(dense(changed, "C_s"), dense(structure, "C_s") @ moved)
    np.testing.assert_array_equal(
        dense(changed, "C_b") @ dense(changed, "C_nb"),
        dense(structure, "C_b") @ dense(structure, "C_nb") @ moved,
    )
    np.testing.assert_array_equal(changed.bar_length, structure.bar_length)
    np.testing.assert_array_equal(changed.string_length(), structure.string_length())
    np.testing.assert_array_equal(
        changed.bar_vectors(changed.nodes), structure.bar_vectors(structure.nodes)
    )
    assert changed.string_groups == structure.string_groups


@given(arguments(), st.randoms(use_true_random=False))
def test_reordered_and_turned_members_give_reordered_and_turned_vectors(given_arguments, random):
    structure = tc.Structure(**given_arguments)
    changed, signs, orders = dict(given_arguments), {}, {}
    for name in ("bars", "strings"):
        count = len(given_arguments[name])
        orders[name] = np.array(random.sample(range(count), count), dtype=int)
        signs[name] = np.array([random.choice([-1, 1]) for _ in range(count)], dtype=int)
        pairs = given_arguments[name][orders[name]]
        changed[name] = np.where(signs[name][:, None] > 0, pairs, pairs[:, ::-1])
    changed["bar_mass"] = given_arguments["bar_mass"][orders["bars"]]
    changed["string_groups"] = [given_arguments["string_groups"][i] for i in orders["strings"]]
    other, N = tc.Structure(**changed), structure.nodes
    np.testing.assert_array_equal(
        other.bar_vectors(N), structure.bar_vectors(N)[:, orders["bars"]] * signs["bars"]
    )
    np.testing.assert_array_equal(
        other.string_vectors(N),
        structure.string_vectors(N)[:, orders["strings"]] * signs["strings"],
    )
    for name in ("bar_nodes", "string_nodes", "string_node_mass"):
        np.testing.assert_array_equal(getattr(other, name), getattr(structure, name))


@given(arguments())
def test_the_kind_of_array_does_not_matter(given_arguments):
    structure = tc.Structure(**given_arguments)
    plain = {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in given_arguments.items()
    }
    other_memory = given_arguments | {
        "nodes": np.asfortranarray(given_arguments["nodes"]),
        "bars": given_arguments["bars"].astype(np.int16),
        "strings": given_arguments["strings"].astype(float),
    }
    for same in (tc.Structure(**plain), tc.Structure(**other_memory)):
        for name in (*ARRAYS, *MEASURES):
            np.testing.assert_array_equal(getattr(same, name), getattr(structure, name))
            assert getattr(same, name).dtype == getattr(structure, name).dtype
        assert repr(same) == repr(structure)


# ---- structures do not change ----


@given(arguments())
def test_a_structure_is_not_changed_through_what_it_holds(given_arguments):
    structure = tc.Structure(**given_arguments)
    for name in (*ARRAYS, *MEASURES):
        array = getattr(structure, name)
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        with pytest.raises(FrozenInstanceError):
            setattr(structure, name, array)
        assert array is getattr(structure, name)
    with pytest.raises(FrozenInstanceError):
        structure.colour = "red"


@given(arguments())
def test_a_structure_is_not_changed_through_what_it_was_given(given_arguments):
    structure = tc.Structure(**given_arguments)
    before = {name: getattr(structure, name).copy() for name in (*ARRAYS, *MEASURES)}
    groups = structure.string_groups
    for value in given_arguments.values():
        if isinstance(value, np.ndarray):
            value[...] = 7
        elif isinstance(value, list):
            value.clear()
    for name, array in before.items():
        np.testing.assert_array_equal(getattr(structure, name), array)
    assert structure.string_groups == groups


@given(structures())
def test_a_structure_is_not_changed_through_what_it_computes(structure):
    for name in MATRICES:
        before = dense(structure, name)
        getattr(structure, name).data[...] = 7.0
        np.testing.assert_array_equal(dense(structure, name), before)
    length = structure.string_length()
    length[...] = 7.0
    np.testing.assert_array_equal(
        structure.string_length(), np.linalg.norm(structure.string_vectors(structure.nodes), axis=0)
    )


# ---- structures that are none ----


@st.composite
def spoilt(draw, name, least):
    """Valid arguments, one member of one array, and the name of that array's entry."""
    given_arguments = draw(arguments(**least))
    return given_arguments, draw(st.integers(0, len(given_arguments[name]) - 1))


MEMBERS = ("bars", "strings")


def some_members(name):
    least = {"least_bars": 1} if name == "bars" else {"least_bars": 1, "least_strings": 1}
    return spoilt(name, least | {"least_points": 1})


@pytest.mark.parametrize("name", MEMBERS)
@given(data=st.data())
def test_an_index_out_of_range_is_refused(name, data):
    given_arguments, i = data.draw(some_members(name))
    count = given_arguments["nodes"].shape[1]
    index = data.draw(st.one_of(st.integers(-50, -1), st.integers(count, count + 50)))
    given_arguments[name][i, data.draw(st.integers(0, 1))] = index
    with pytest.raises(ValueError, match=rf"{name}\[{i}\] is node {index}, expected 0 to"):
        tc.Structure(**given_arguments)


@pytest.mark.parametrize("name", MEMBERS)
@given(data=st.data())
def test_an_index_that_is_not_whole_is_refused(name, data):
    given_arguments, i = data.draw(some_members(name))
    spoiled = given_arguments[name].astype(float)
    spoiled[i, 1] += data.draw(st.floats(-0.9, -0.1) | st.floats(0.1, 0.9))
    with pytest.raises(TypeError, match=rf"{name}\[{i}\] is .* expected a whole number"):
        tc.Structure(**(given_arguments | {name: spoiled}))


@pytest.mark.parametrize("name", MEMBERS)
@given(data=st.data())
def test_a_member_from_a_node_to_itself_is_refused(name, data):
    given_arguments, i = data.draw(some_members(name))
    node = given_arguments[name][i, 0]
    given_arguments[name][i, 1] = node
    with pytest.raises(ValueError, match=rf"{name}\[{i}\] joins node {node} to itself"):
        tc.Structure(**given_arguments)


@given(data=st.data())
def test_a_bar_that_repeats_another_is_refused(data):
    given_arguments, i = data.draw(some_members("bars"))
    again = given_arguments["bars"][i]
    pair = again[::-1] if data.draw(st.booleans()) else again
    given_arguments["bars"] = np.vstack([given_arguments["bars"], pair])
    last = len(given_arguments["bars"]) - 1
    message = rf"bars\[{last}\] joins nodes {min(pair)} and {max(pair)}, as bars\[{i}\] does"
    with pytest.raises(ValueError, match=message):
        tc.Structure(**given_arguments)


@given(arguments(), st.integers(1, 3))
def test_a_node_that_nothing_touches_is_refused(given_arguments, extra):
    nodes = given_arguments["nodes"]
    count = nodes.shape[1]
    given_arguments["nodes"] = np.hstack([nodes, np.full((3, extra), 99.0)])
    with pytest.raises(ValueError, match=rf"^nodes\[:, {count}\].* in none of bars"):
        tc.Structure(**given_arguments)


@given(data=st.data())
def test_a_bar_of_no_length_is_refused(data):
    given_arguments, i = data.draw(some_members("bars"))
    start, end = given_arguments["bars"][i]
    given_arguments["nodes"][:, end] = given_arguments["nodes"][:, start]
    with pytest.raises(ValueError, match=rf"bars\[{i}\] has no length"):
        tc.Structure(**given_arguments)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@given(data=st.data())
def test_a_place_that_is_not_finite_is_refused(value, data):
    given_arguments = data.draw(arguments())
    row = data.draw(st.integers(0, 2))
    column = data.draw(st.integers(0, given_arguments["nodes"].shape[1] - 1))
    given_arguments["nodes"][row, column] = value
    with pytest.raises(ValueError, match=rf"nodes\[{row}, {column}\] is {value}"):
        tc.Structure(**given_arguments)


@given(arguments())
def test_transposed_nodes_are_refused(given_arguments):
    transposed = given_arguments["nodes"].T
    assume(len(transposed) not in (2, 3))  # which no one can tell
    with pytest.raises(ValueError, match=rf"nodes has shape \({len(transposed)}, 3\), .*transpose"):
        tc.Structure(**(given_arguments | {"nodes": transposed}))


@pytest.mark.parametrize("name", ["bar_mass", "string_node_mass"])
@given(data=st.data())
def test_a_mass_that_is_not_positive_is_refused(name, data):
    given_arguments, i = data.draw(spoilt(name, {"least_bars": 1, "least_points": 1}))
    given_arguments[name][i] = data.draw(st.floats(-10.0, 0.0))
    with pytest.raises(ValueError, match=rf"{name}\[{i}\] is -?\d.*, expected a positive mass"):
        tc.Structure(**given_arguments)


@pytest.mark.parametrize("name", ["bar_mass", "string_node_mass"])
@given(data=st.data())
def test_masses_too_many_are_refused(name, data):
    given_arguments = data.draw(arguments(least_bars=1, least_points=1))
    count = len(given_arguments[name])
    more = np.append(given_arguments[name], 1.0)
    message = rf"{name} has shape \({count + 1},\), expected \(\) or \({count},\)"
    with pytest.raises(ValueError, match=message):
        tc.Structure(**(given_arguments | {name: more}))


@given(arguments())
def test_string_node_mass_is_asked_for_where_there_are_string_nodes(given_arguments):
    if given_arguments["string_node_mass"] is None:
        structure = tc.Structure(**(given_arguments | {"string_node_mass": 1.0}))
        assert not structure.point_mass.any()
        return
    with pytest.raises(ValueError, match=r"node \d+ is in none of bars.* string_node_mass"):
        tc.Structure(**(given_arguments | {"string_node_mass": None}))


@given(arguments(), st.booleans())
def test_string_groups_of_another_count_are_refused(given_arguments, more):
    groups = given_arguments["string_groups"]
    assume(more or groups)
    wrong = [*groups, "top"] if more else groups[:-1]
    message = rf"string_groups has {len(wrong)} names, expected {len(groups)}"
    with pytest.raises(ValueError, match=message):
        tc.Structure(**(given_arguments | {"string_groups": wrong}))
