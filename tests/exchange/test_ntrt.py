"""Structure files of NTRT, written here as its users write them."""

from itertools import pairwise

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.exchange import ntrt

pytest.importorskip("yaml", reason="PyYAML comes with the extra yaml")

PRISM = """
nodes:
  bottom1: [-5, 0, 0]
  bottom2: [5, 0, 0]
  bottom3: [0, 0, 8.66]
  top1: [-5, 5, 0]
  top2: [5, 5, 0]
  top3: [0, 5, 8.66]

pair_groups:
  prism_rod segment:
    - [bottom1, top2]
    - [bottom2, top3]
    - [bottom3, top1]
  muscle:
    - [bottom1, bottom2]
    - [bottom2, bottom3]
    - [bottom1, bottom3]
    - [top1, top2]
    - [top2, top3]
    - [top1, top3]
    - [bottom1, top1]
    - [bottom2, top2]
    - [bottom3, top3]

builders:
  prism_rod:
    class: tgRodInfo
    parameters: {density: 0.688, radius: 0.31, friction: 0.99}
  muscle:
    class: tgBasicActuatorInfo
    parameters: {stiffness: 1e3, damping: 10, pretension: 1000}
"""

TOWER = """
substructures:
  one/two/three:
    path: parts/prism.yaml
    rotation: {axis: [0, 1, 0], angle: 90, reference: [0, 0, 0]}
    scale: 0.5
    offset: [0, 6, 0]
    translation: [1, 2, 3]
bond_groups:
  cable:
    one/two/three/node_node:
      - [top1, bottom1]
      - [top2, bottom2]
      - [top3, bottom3]
  one/three/node_node:
    cable far:
      - [bottom1, top1]
builders:
  cable:
    class: tgKinematicActuatorInfo
    parameters: {stiffness: 500}
  muscle:
    class: tgBasicActuatorInfo
    parameters: {stiffness: 700}
"""


@pytest.fixture
def files(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "prism.yaml").write_text(PRISM)
    (tmp_path / "tower.yaml").write_text(TOWER)
    return tmp_path


def test_a_prism_in_decimetres(files):
    found = tc.exchange.from_ntrt(files / "parts" / "prism.yaml", length_unit=0.1)
    structure = found.structure
    np.testing.assert_allclose(structure.nodes[:, 0], [-0.5, 0, 0])
    np.testing.assert_array_equal(structure.bars, [[0, 4], [1, 5], [2, 3]])
    length = structure.bar_length / 0.1  # in the units of its density
    np.testing.assert_allclose(structure.bar_mass, np.pi * 0.31**2 * 0.688 * length)
    np.testing.assert_array_equal(found.model.strings.stiffness, np.full(9, 1000.0))
    np.testing.assert_array_equal(found.model.strings.damping, np.full(9, 10.0))
    pull = found.model.strings.stiffness * (structure.string_length() - found.rest_length)
    np.testing.assert_allclose(pull, 100.0)  # 1000 kg dm/s²
    assert set(structure.string_groups) == {"muscle"}


def test_substructures_are_turned_scaled_and_moved_and_bonded(files):
    found = tc.exchange.from_ntrt(files / "tower.yaml")
    prism = tc.exchange.from_ntrt(files / "parts" / "prism.yaml").structure.nodes
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    turned = turn @ prism
    middle = turned.mean(axis=1, keepdims=True)
    first = middle + 0.5 * (turned - middle) + np.array([[1], [2], [3]])
    parts = [first + k * np.array([[0], [6], [0]]) for k in range(3)]
    np.testing.assert_allclose(found.structure.nodes, np.hstack(parts), atol=1e-12)
    strings = found.structure.strings.tolist()
    bonds = [[3, 6], [4, 7], [5, 8], [9, 12], [10, 13], [11, 14], [0, 15]]
    assert [pair for pair in strings if abs(pair[0] - pair[1]) > 2 and pair in bonds] == bonds
    assert len(strings) == 3 * 9 + 7
    stiffness = {
        tuple(pair): k for pair, k in zip(strings, found.model.strings.stiffness, strict=True)
    }
    assert stiffness[3, 6] == 500
    assert stiffness[0, 1] == 700  # the builder of the upper file comes later


def test_notes_say_what_is_another_there(files):
    assert tc.exchange.from_ntrt(files / "parts" / "prism.yaml").notes == (
        "cables end at nodes, not at the surface of rods",
    )
    more = "- [bottom3, top1]\n    - [bottom1, top1]\n  lost: [[top1, top3]]"
    (files / "welded.yaml").write_text(PRISM.replace("- [bottom3, top1]", more))
    notes = tc.exchange.from_ntrt(files / "welded.yaml").notes
    assert "rods that share a node are welded in NTRT and pinned here" in notes
    assert "the pair top1, top3 of 'lost' has no builder and is left out" in notes


BOMBS = {
    "lists": "nodes: " + "[" * 1_000,
    "dashes": "nodes:\n  " + "- " * 5_000 + "a",
    "aliases": "a: &a [x, x]\n" + "".join(
        f"{b}: &{b} [*{a}, *{a}, *{a}, *{a}, *{a}, *{a}]\n" for a, b in pairwise("abcdefghijklm")),
    "an alias of itself": "nodes: &a [*a]",
    "values": "nodes: [" + "1," * 500_000 + "]",
    "itself": "substructures: {a/b/c/d: {path: bomb.yaml}}",
    "files": "substructures: {a/b/c/d: {path: 1.yaml}}",
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_files_that_ask_for_too_much_are_refused(name, tmp_path, monkeypatch):
    monkeypatch.setattr(ntrt, "_OF_FILE", 2_000)  # 50 files, not 2,000
    (tmp_path / "bomb.yaml").write_text(BOMBS[name])
    for i in range(1, 20):
        (tmp_path / f"{i}.yaml").write_text(f"substructures: {{a/b/c/d: {{path: {i + 1}.yaml}}}}")
    (tmp_path / "20.yaml").write_text(PRISM)
    with pytest.raises(ValueError, match=r"\w\.yaml is (not YAML that|nested|of a str|a subs)"):
        tc.exchange.from_ntrt(tmp_path / "bomb.yaml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("nodes:", "nodes: [", "is not YAML"),
        ("top1: [", "top3: [", "has 'top3' twice"),
        ("top1: [-5, 5, 0]", "top1: [-5, 5]", r"node 'top1' is .*expected \[x, y, z\]"),
        ("[bottom1, top2]", "[bottom1, top9]", "names the node 'top9', which is not there"),
        ("[bottom1, top2]", "[bottom1]", r"expected pairs of nodes \[a, b\]"),
        ("    - [bottom3, top1]\n", "", "node 'bottom3' is on cables alone"),
        ("tgRodInfo", "tgBoxInfo", "builder 'prism_rod' is of the class tgBoxInfo"),
        ("1e3", "firm", "stiffness is 'firm', expected a number"),
        ("pretension: 1000", "pretension: 1e9", "stretches it by more than its length"),
        ("pair_groups", "pairs", "has 'pairs', expected nodes, pair_groups"),
        ("builders:", "bond_groups: {x: {a/b/node_edge: []}}\nbuilders:", "another kind than node"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(old, new, message, tmp_path):
    file = tmp_path / "wrong.yaml"
    file.write_text(PRISM.replace(old, new, 1))
    with pytest.raises(ValueError, match=message):
        tc.exchange.from_ntrt(file)


def test_a_file_within_itself_is_refused(tmp_path):
    file = tmp_path / "circle.yaml"
    file.write_text("substructures: {inner: {path: circle.yaml}}")
    with pytest.raises(ValueError, match="is a substructure of itself"):
        tc.exchange.from_ntrt(file)


def test_without_pyyaml_the_extra_is_named(files, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "yaml", None)
    with pytest.raises(ImportError, match=r"pip install 'tenscontrol\[yaml\]'"):
        tc.exchange.from_ntrt(files / "tower.yaml")
