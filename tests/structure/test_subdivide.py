"""Strings cut into segments: mass, statics and length of a string are those of its chain."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

import tenscontrol as tc
from tests.dynamics.scenes import random_structure


def cord(tension=10.0, length=2.0):
    """A string between two supports, and the force density of this tension."""
    structure = tc.Structure(
        nodes=[[0, length], [0, 0], [0, 0]], bars=[], strings=[[0, 1]], bar_mass=[], fixed=[0, 1]
    )
    return structure, tension / length


@st.composite
def subdivisions(draw):
    """A structure with string nodes, numbered at random, and segments of its strings."""
    structure = random_structure(draw(st.integers(0, 20)))
    count = len(structure.strings)
    segments = draw(st.lists(st.integers(1, 5), min_size=count, max_size=count))
    return structure, np.array(segments)


def fitted_order(segments, error):
    return -np.polyfit(np.log(segments), np.log(error), 1)[0]


# ---- geometry ----


@given(subdivisions())
def test_what_was_there_is_kept_and_comes_first(case):
    structure, segments = case
    cut = tc.subdivide(structure, segments, node_mass=0.01)
    known, points = structure.nodes.shape[1], len(structure.string_nodes)
    np.testing.assert_array_equal(cut.nodes[:, :known], structure.nodes)
    np.testing.assert_array_equal(cut.bars, structure.bars)
    np.testing.assert_array_equal(cut.bar_mass, structure.bar_mass)
    np.testing.assert_array_equal(cut.string_nodes[:points], structure.string_nodes)
    np.testing.assert_array_equal(cut.string_node_mass[:points], structure.string_node_mass)
    assert cut.parent is structure


@given(subdivisions())
def test_numbers_of_nodes_and_segments(case):
    structure, segments = case
    cut = tc.subdivide(structure, segments, node_mass=0.01)
    assert cut.nodes.shape[1] == structure.nodes.shape[1] + (segments - 1).sum()
    assert len(cut.strings) == segments.sum()
    np.testing.assert_array_equal(cut.string_parent, np.repeat(np.arange(len(segments)), segments))
    np.testing.assert_array_equal(tc.structure.segment_counts(cut), np.repeat(segments, segments))


@given(subdivisions())
def test_segments_are_equal_parts_of_the_straight_string_from_start_to_end(case):
    structure, segments = case
    cut = tc.subdivide(structure, segments, node_mass=0.01)
    part = structure.string_vectors(structure.nodes) / segments
    np.testing.assert_allclose(
        cut.string_vectors(cut.nodes), part[:, cut.string_parent], atol=1e-14
    )
    for i, (start, end) in enumerate(structure.strings):
        chain = cut.strings[cut.string_parent == i]
        assert (chain[0, 0], chain[-1, 1]) == (start, end)
        np.testing.assert_array_equal(chain[1:, 0], chain[:-1, 1])


def test_new_nodes_are_numbered_string_by_string(prism):
    cut = tc.subdivide(prism, [3, 1, 2, 1, 1, 1, 1, 1, 1], node_mass=0.01)
    assert cut.strings[:6].tolist() == [[0, 6], [6, 7], [7, 1], [1, 2], [2, 8], [8, 0]]


def test_segments_are_in_the_group_of_their_string(prism):
    cut = tc.subdivide(prism, 3, node_mass=0.01)
    for group in ("top", "bottom", "vertical"):
        expected = np.isin(cut.string_parent, prism.strings_in(group))
        np.testing.assert_array_equal(cut.strings_in(group), np.flatnonzero(expected))


def test_one_segment_leaves_the_structure_as_it_is(prism):
    cut = tc.subdivide(prism, 1, node_mass=0.01)
    np.testing.assert_array_equal(cut.nodes, prism.nodes)
    np.testing.assert_array_equal(cut.strings, prism.strings)
    assert len(cut.string_nodes) == 0
    np.testing.assert_array_equal(tc.structure.segment_counts(cut), np.ones(9))


def test_fixed_nodes_stay_fixed_and_new_nodes_are_free():
    structure, _ = cord()
    cut = tc.subdivide(structure, 4, node_mass=0.01)
    assert cut.fixed.tolist() == [0, 1]
    assert cut.string_nodes.tolist() == [2, 3, 4]


def test_segments_can_be_cut_again(prism):
    twice = tc.subdivide(tc.subdivide(prism, 2, node_mass=0.01), 3, node_mass=0.02)
    once = tc.subdivide(prism, 6, node_mass=0.01)
    lengths = [np.sort(structure.string_length()) for structure in (twice, once)]
    np.testing.assert_allclose(*lengths, rtol=1e-14)
    assert sorted(twice.string_node_mass.tolist()) == [0.01] * 9 + [0.02] * 36
    np.testing.assert_array_equal(tc.structure.segment_counts(twice), np.full(54, 3))
    assert twice.parent.parent is prism


def test_a_structure_without_strings_stays_as_it_is():
    bar = tc.Structure([[0, 1], [0, 0], [0, 0]], bars=[[0, 1]], strings=[], bar_mass=1.0)
    cut = tc.subdivide(bar, 4, node_mass=0.01)
    assert (cut.nodes.shape, cut.strings.shape) == ((3, 2), (0, 2))


# ---- mass ----


@given(subdivisions(), st.floats(0.001, 10.0))
def test_the_mass_of_each_string_is_preserved(case, mass):
    structure, segments = case
    given_mass = np.where(segments > 1, mass * np.arange(1, len(segments) + 1), 0.0)
    cut = tc.subdivide(structure, segments, string_mass=given_mass)
    points = len(structure.string_nodes)
    new = cut.string_node_mass[points:]
    string = np.repeat(np.arange(len(segments)), segments - 1)
    found = np.bincount(string, weights=new, minlength=len(segments))
    np.testing.assert_allclose(found, given_mass, rtol=1e-14)


def test_masses_of_example_1(prism):
    cut = tc.subdivide(prism, 4, node_mass=0.01)
    np.testing.assert_array_equal(cut.string_node_mass, np.full(27, 0.01))
    same = tc.subdivide(prism, 4, string_mass=0.03)
    np.testing.assert_allclose(same.string_node_mass, 0.01, rtol=1e-15)


@pytest.mark.parametrize(
    ("mass", "order"),
    [(lambda s: {"string_mass": 0.3}, 1), (lambda s: {"node_mass": 0.3 / s}, 2)],
    ids=["string_mass", "node_mass"],
)
def test_a_chain_approaches_the_vibrating_string_in_the_order_that_is_documented(mass, order):
    structure, gamma = cord(tension=10.0, length=2.0)
    exact = np.pi / 2.0 * np.sqrt(10.0 / (0.3 / 2.0))
    segments, errors = np.array([8, 16, 32, 64]), []
    for s in segments.tolist():
        chain = tc.subdivide(structure, s, **mass(s))
        stress = tc.statics.stress_matrix(
            chain, tc.structure.spread_force_density(chain, gamma), []
        )
        free = chain.string_nodes
        square = np.linalg.eigvalsh(stress[np.ix_(free, free)] / chain.string_node_mass[0])[0]
        errors.append(abs(np.sqrt(square) - exact))
    assert abs(fitted_order(segments, errors) - order) < 0.05


# ---- statics ----


@pytest.mark.parametrize("segments", [1, 2, 4, [2, 2, 2, 1, 1, 1, 5, 3, 4]])
def test_a_prism_at_rest_is_at_rest_with_its_strings_cut(prism, rest, segments):
    cut = tc.subdivide(prism, segments, node_mass=0.01)
    found = tc.prestress(cut, tc.structure.spread_force_density(cut, rest.force_density))
    assert found.residual < 1e-12
    np.testing.assert_allclose(found.bar_force_density, rest.bar_force_density, rtol=1e-12)


@given(subdivisions(), st.integers(0, 1000))
def test_a_chain_pulls_its_ends_as_the_whole_string_does(case, seed):
    structure, segments = case
    gamma = np.random.default_rng(seed).uniform(1, 30, len(segments))
    lam = np.random.default_rng(seed).uniform(0, 30, len(structure.bars))
    cut = tc.subdivide(structure, segments, node_mass=0.01)
    K = tc.statics.stress_matrix(cut, tc.structure.spread_force_density(cut, gamma), lam)
    known = structure.nodes.shape[1]
    # The new nodes follow where the ends go: eliminate them.
    kept, crossed, inner = K[:known, :known], K[:known, known:], K[known:, known:]
    condensed = kept - crossed @ np.linalg.solve(inner, crossed.T)
    np.testing.assert_allclose(
        condensed, tc.statics.stress_matrix(structure, gamma, lam), atol=1e-11
    )


def test_a_chain_keeps_the_stiffness_and_the_tension_of_its_string(prism):
    rest_length = 0.9 * prism.string_length()
    cut = tc.subdivide(prism, [2, 2, 2, 3, 3, 3, 4, 1, 5], node_mass=0.01)
    counts = tc.structure.segment_counts(cut)
    for stretch in (0.95, 1.0, 1.2):
        whole = tc.LinearStrings(100.0).force_density(stretch * prism.string_length(), rest_length)
        segment = tc.LinearStrings(100.0 * counts).force_density(
            stretch * cut.string_length(), tc.structure.spread_rest_length(cut, rest_length)
        )
        np.testing.assert_allclose(
            segment, tc.structure.spread_force_density(cut, whole), rtol=1e-12
        )


@given(subdivisions(), st.floats(0.0, 3.0, allow_subnormal=False))
def test_rest_lengths_of_the_segments_make_up_that_of_the_string(case, length):
    structure, segments = case
    cut = tc.subdivide(structure, segments, node_mass=0.01)
    given_length = length * np.arange(1, len(segments) + 1)
    spread = tc.structure.spread_rest_length(cut, given_length)
    np.testing.assert_allclose(np.bincount(cut.string_parent, spread), given_length, rtol=1e-14)


def test_a_subdivided_prism_at_rest_does_not_accelerate(prism, rest):
    cut = tc.subdivide(prism, 4, node_mass=0.01)
    gamma = tc.structure.spread_force_density(cut, rest.force_density)
    acceleration = tc.Model(cut).acceleration(cut.nodes, np.zeros(cut.nodes.shape), gamma)
    np.testing.assert_allclose(np.array(acceleration), 0, atol=1e-9)


# ---- what is refused ----


def whole():
    return tc.prism()


def cut():
    return tc.subdivide(whole(), 2, node_mass=0.01)


def flawed():
    """A string between two nodes at the same place."""
    return tc.Structure(
        nodes=[[0, 0, 1], [0, 0, 0], [0, 0, 0]],
        bars=[],
        strings=[[0, 1], [1, 2]],
        bar_mass=[],
        string_node_mass=1.0,
    )


def made(**changes):
    """A structure with a parent, some arguments replaced."""
    prism = whole()
    arguments = {
        "nodes": prism.nodes,
        "bars": prism.bars,
        "strings": prism.strings,
        "bar_mass": 1.0,
        "parent": prism,
        "string_parent": np.arange(9),
    }
    return tc.Structure(**(arguments | changes))


REFUSED = {
    "no structure": (lambda: tc.subdivide(3, 4, 0.01), TypeError, "structure is a int"),
    "zero": (
        lambda: tc.subdivide(whole(), 0, 0.01),
        ValueError,
        "segments[0] is 0, expected a positive whole number; 1 leaves the string as it is",
    ),
    "negative": (lambda: tc.subdivide(whole(), -2, 0.01), ValueError, "segments[0] is -2"),
    "zero of one": (
        lambda: tc.subdivide(whole(), [1, 2, 0, 1, 1, 1, 1, 1, 1], 0.01),
        ValueError,
        "segments[2] is 0, expected a positive whole number",
    ),
    "a part": (
        lambda: tc.subdivide(whole(), 2.5, 0.01),
        TypeError,
        "segments[0] is 2.5, expected a whole number",
    ),
    "yes": (lambda: tc.subdivide(whole(), True, 0.01), TypeError, "segments is True"),
    "word": (lambda: tc.subdivide(whole(), "four", 0.01), TypeError, "segments must be an array"),
    "None": (lambda: tc.subdivide(whole(), None, 0.01), TypeError, "segments is None"),
    "too few": (
        lambda: tc.subdivide(whole(), [2, 2], 0.01),
        ValueError,
        "segments has shape (2,), expected () or (9,): one number for all, or one per string",
    ),
    "no mass": (
        lambda: tc.subdivide(whole(), 4),
        ValueError,
        "found no mass, expected exactly one of node_mass",
    ),
    "two masses": (
        lambda: tc.subdivide(whole(), 4, node_mass=0.01, string_mass=0.03),
        ValueError,
        "found node_mass and string_mass, expected exactly one of",
    ),
    "no weight": (lambda: tc.subdivide(whole(), 4, 0.0), ValueError, "node_mass is 0.0, expected"),
    "array of masses": (lambda: tc.subdivide(whole(), 4, [1.0] * 27), TypeError, "node_mass is [1"),
    "no string weight": (
        lambda: tc.subdivide(whole(), 4, string_mass=[0.01] * 4 + [-1] + [0.01] * 4),
        ValueError,
        "string_mass[4] is -1, expected a positive mass in kg",
    ),
    "nowhere to go": (
        lambda: tc.subdivide(whole(), [2] * 8 + [1], string_mass=0.03),
        ValueError,
        "string_mass[8] is 0.03, but string 8 is not cut (segments is 1) and has no node",
    ),
    "other count of masses": (
        lambda: tc.subdivide(whole(), 4, string_mass=[0.01, 0.01]),
        ValueError,
        "string_mass has shape (2,), expected () or (9,)",
    ),
    "no length": (
        lambda: tc.subdivide(flawed(), 2, 0.01),
        ValueError,
        "in structure.nodes, strings[0] has no length",
    ),
    "γ of segments": (
        lambda: tc.structure.spread_force_density(cut(), np.ones(18)),
        ValueError,
        "force_density has shape (18,), expected () or (9,): one number for all, or one per "
        "whole string",
    ),
    "γ that pushes": (
        lambda: tc.structure.spread_force_density(cut(), [1.0] * 8 + [-1.0]),
        ValueError,
        "force_density[8] is -1, expected at least 0: a string can only pull",
    ),
    "l0 below zero": (
        lambda: tc.structure.spread_rest_length(cut(), -0.1),
        ValueError,
        "rest_length[0] is -0.1, expected at least 0",
    ),
    "no parent": (lambda: made(parent=None), ValueError, "string_parent is given without parent"),
    "another parent": (lambda: made(parent="prism"), TypeError, "parent is a str, expected"),
    "parents too few": (
        lambda: made(string_parent=[0, 1]),
        ValueError,
        "string_parent has shape (2,), expected (9,): one per string",
    ),
    "half a parent": (
        lambda: made(string_parent=[0.5, *range(1, 9)]),
        TypeError,
        "string_parent[0] is 0.5, expected a whole number",
    ),
    "parent out of range": (
        lambda: made(string_parent=[*range(8), 9]),
        ValueError,
        "string_parent[8] is 9, expected 0 to 8",
    ),
    "parent left out": (
        lambda: made(string_parent=[0, *range(8)]),
        ValueError,
        "string_parent leaves out string 8 of the parent",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused(case):
    call, exception, message = REFUSED[case]
    with pytest.raises(exception, match=re.escape(message)):
        call()


def test_planar_structures_with_rollers_and_payloads_are_cut():
    arm = tc.library.arm(sections=2)
    mass = np.array([0, 0, 0, 0, 1.5, 0.0])
    arm = replace(arm, fixed=[0, (1, "x"), (4, "y")], point_mass=mass)
    cut = tc.subdivide(arm, segments=3, node_mass=0.1)
    assert (cut.dimension, cut.structure_class) == (2, 2)
    assert cut.rollers == arm.rollers
    np.testing.assert_array_equal(cut.point_mass[:6], mass)
    np.testing.assert_array_equal(cut.point_mass[6:], 0.1)
    np.testing.assert_allclose(
        tc.structure.segments.to_strings(cut, "length", cut.string_length()),
        arm.string_length(),
        rtol=1e-14,
    )
    assert len(cut.blocks) == len(arm.blocks)
    for one, other in zip(cut.blocks, arm.blocks, strict=True):
        np.testing.assert_array_equal(one.bars, other.bars)


def test_clustered_strings_are_not_cut():
    arm = tc.library.arm(sections=2)
    over = replace(arm, strings=[(0, 2, 4), (1, 3)], string_groups=("string",) * 2)
    with pytest.raises(ValueError, match=r"structure has clustered strings.*cannot be cut"):
        tc.subdivide(over, segments=2, node_mass=0.1)
