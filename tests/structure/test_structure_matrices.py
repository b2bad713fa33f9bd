"""The paper's connectivity matrices, and bar lengths, for structures in any node order."""

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

import tenscontrol as tc
from tests.dynamics.scenes import any_motion, random_structure

SEEDS = range(5)


@pytest.mark.parametrize("seed", SEEDS)
def test_connectivity_gives_bar_vectors_centres_and_string_vectors(seed):
    structure = random_structure(seed)
    N, _ = any_motion(structure, seed)
    start, end = (N[:, structure.bars[:, i]] for i in (0, 1))
    bar_nodes = N @ structure.C_nb.T
    np.testing.assert_array_equal(bar_nodes @ structure.C_b.T, end - start)
    np.testing.assert_allclose(bar_nodes @ structure.C_r.T, 0.5 * (start + end), atol=1e-15)
    first, second = (N[:, structure.strings[:, i]] for i in (0, 1))
    np.testing.assert_array_equal(N @ structure.C_s.T, second - first)


@pytest.mark.parametrize("seed", SEEDS)
def test_member_vectors_agree_with_the_connectivity(seed):
    structure = random_structure(seed)
    N, _ = any_motion(structure, seed)
    B = N @ (structure.C_b @ structure.C_nb).T
    np.testing.assert_array_equal(structure.bar_vectors(N), B)
    np.testing.assert_array_equal(structure.string_vectors(N), N @ structure.C_s.T)
    expected = np.sqrt(((N @ structure.C_s.T) ** 2).sum(axis=0))
    np.testing.assert_allclose(structure.string_length(N), expected, rtol=1e-15)


@pytest.mark.parametrize("seed", SEEDS)
def test_string_connectivity_splits_into_bar_and_string_nodes(seed):
    structure = random_structure(seed)
    rebuilt = structure.C_sb @ structure.C_nb + structure.C_ss @ structure.C_ns
    np.testing.assert_array_equal(rebuilt.toarray(), structure.C_s.toarray())


@pytest.mark.parametrize("seed", SEEDS)
def test_every_node_is_a_bar_node_or_a_string_node(seed):
    structure = random_structure(seed)
    selections = np.vstack([structure.C_nb.toarray(), structure.C_ns.toarray()])
    np.testing.assert_array_equal(selections @ selections.T, np.eye(structure.nodes.shape[1]))
    assert set(structure.bar_nodes) == set(structure.bars.ravel())


def test_nodes_in_the_order_of_the_paper_give_its_selections_letter_by_letter():
    structure = tc.Structure(
        nodes=np.random.default_rng(0).normal(size=(3, 6)),
        bars=[[0, 1], [2, 3]],
        strings=[[0, 4], [4, 5], [5, 3], [1, 2]],
        bar_mass=1.0,
        string_node_mass=0.1,
    )
    identity = np.eye(6)
    np.testing.assert_array_equal(structure.C_nb.toarray(), identity[:4])
    np.testing.assert_array_equal(structure.C_ns.toarray(), identity[4:])
    np.testing.assert_array_equal(structure.C_b.toarray(), [[-1, 1, 0, 0], [0, 0, -1, 1]])
    np.testing.assert_array_equal(structure.C_r.toarray(), [[0.5, 0.5, 0, 0], [0, 0, 0.5, 0.5]])
    np.testing.assert_array_equal(structure.C_ss.toarray(), [[1, 0], [-1, 1], [0, -1], [0, 0]])


@pytest.mark.parametrize("matrix", ["C_b", "C_r", "C_s", "C_nb", "C_ns", "C_sb", "C_ss"])
def test_matrices_have_the_shapes_of_the_paper(matrix):
    structure = random_structure(0, bars=4, points=3)
    bars, strings, points = 4, len(structure.strings), 3
    shapes = {
        "C_b": (bars, 2 * bars),
        "C_r": (bars, 2 * bars),
        "C_s": (strings, 2 * bars + points),
        "C_nb": (2 * bars, 2 * bars + points),
        "C_ns": (points, 2 * bars + points),
        "C_sb": (strings, 2 * bars),
        "C_ss": (strings, points),
    }
    assert getattr(structure, matrix).shape == shapes[matrix]


@pytest.mark.parametrize("name", ["nodes", "bars", "strings", "bar_mass", "string_node_mass"])
def test_a_structure_cannot_be_changed(name):
    structure = random_structure(1)
    with pytest.raises(ValueError, match="read-only"):
        getattr(structure, name)[...] = 0
    with pytest.raises(FrozenInstanceError):
        setattr(structure, name, None)


def test_a_structure_does_not_follow_the_arrays_that_it_was_made_of():
    nodes = np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    structure = tc.Structure(nodes, [[0, 1]], [], bar_mass=1.0)
    nodes[0, 1] = 2.0
    assert structure.bar_length == 1.0


def test_strings_are_found_by_their_group(prism):
    found = [prism.strings_in(group).tolist() for group in ("top", "bottom", "vertical")]
    assert found == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]


@pytest.mark.parametrize("seed", SEEDS)
def test_restored_bars_keep_centre_and_direction_and_get_their_length(seed):
    structure = random_structure(seed)
    bent, _ = any_motion(structure, seed + 100)
    restored = tc.structure.restore_bar_lengths(structure, bent)
    before, after = structure.bar_vectors(bent), structure.bar_vectors(restored)
    length = np.linalg.norm(after, axis=0)
    np.testing.assert_allclose(length, structure.bar_length, rtol=1e-14)
    np.testing.assert_allclose(
        after / length, before / np.linalg.norm(before, axis=0), rtol=0, atol=1e-14
    )
    centres = (structure.C_r @ structure.C_nb).T
    np.testing.assert_allclose(restored @ centres, bent @ centres, rtol=0, atol=1e-14)
    points = structure.string_nodes
    np.testing.assert_array_equal(restored[:, points], bent[:, points])


def test_a_shape_with_true_bar_lengths_is_left_alone(prism):
    restored = tc.structure.restore_bar_lengths(prism, prism.nodes)
    np.testing.assert_allclose(restored, prism.nodes, rtol=0, atol=1e-15)


@pytest.mark.parametrize("seed", SEEDS)
def test_structures_come_back_from_their_matrices(seed):
    structure = random_structure(seed)
    again = tc.Structure.from_matrices(
        structure.nodes, structure.C_b @ structure.C_nb, structure.C_s.toarray(),
        structure.bar_mass, structure.string_node_mass,
    )  # fmt: skip
    np.testing.assert_array_equal(again.bars, structure.bars)
    np.testing.assert_array_equal(again.strings, structure.strings)
    np.testing.assert_array_equal(again.point_mass, structure.point_mass)


@pytest.mark.parametrize(
    ("C", "message"),
    [
        (np.eye(6), r"C_b\[0\] is \[1\.0, .*expected one -1, at the start node, and one 1"),
        (np.zeros((2, 6)), r"C_b\[0\] is"),
        (
            [[-1.0, 1.0]],
            r"C_b has shape \(1, 2\), expected \(members, 6\): a column for each of nodes",
        ),
    ],
)
def test_matrices_that_are_no_connectivity_are_refused(C, message):
    prism = tc.prism()
    with pytest.raises(ValueError, match=message):
        tc.Structure.from_matrices(prism.nodes, C, prism.C_s, 1.0)


def test_geometry_of_a_motion_is_that_of_its_shapes():
    cable = tc.Structure(
        [[0, 1, 2, 3], [0, 1, 0, 0], [0, 0, 0, 1]], [(0, 3)], [(0, 1, 2), (2, 3)], 1.0,
        point_mass=1.0,
    )  # fmt: skip
    random = np.random.default_rng(0)
    for structure in (tc.prism(), cable):
        motion = structure.nodes[..., None] + random.normal(size=(*structure.nodes.shape, 5))
        for of in (structure.bar_vectors, structure.string_vectors, structure.string_length):
            each = np.stack([of(motion[..., i]) for i in range(5)], axis=-1)
            np.testing.assert_allclose(of(motion), each, rtol=1e-15)
        with pytest.raises(ValueError, match="expected"):
            structure.string_length(motion[..., None])
