"""Scenes of any structure: generators of the library, the plane, rollers, payloads, clusters."""

import sys
from inspect import signature
from pathlib import Path

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.scene import SceneError
from tenscontrol.scene.document import read_document
from tenscontrol.scene.schema import GENERATOR_KEYS, GENERATORS
from tenscontrol.scene.structure_tables import build_structure

SCENES = Path(__file__).parent.parent.parent / "examples" / "scenes"

# Arguments that are not the default, for every generator of scenes.
SIZES = {
    "arm": {"sections": 3, "length": 0.8, "height": 0.5, "bar_mass": 0.4},
    "cable_net": {"rows": 4, "columns": 5, "spacing": 0.2, "sag": 0.1, "node_mass": 0.05},
    "class2_tower": {"stages": 3, "sides": 4, "radius": 0.3, "height": 0.7, "bar_mass": 2.0,
                     "handedness": "right", "floating": True},
    "d_bar": {"width": 1.0, "height": 3.0, "dimension": 3, "bar_mass": [1, 2, 3, 4]},
    "d_bar_3d": {"sides": 4, "radius": 0.5, "height": 1.0, "bar_mass": 0.1},
    "geiger_dome": {"sides": 5, "hoops": 2, "radius": 10, "rise": 2.0, "slope": 0.4,
                    "bar_mass": 3.0},
    "kite": {"width": 1.0, "height": 2.0, "across": 0.3, "up": 0.4, "dimension": 2,
             "bar_mass": 0.5},
    "levy_dome": {"sides": 8, "hoops": 2, "radius": 10, "rise": 2.0, "slope": 0.4,
                  "bar_mass": 3.0},
    "net": {"rows": 3, "columns": 4, "spacing": 0.1, "node_mass": 0.01, "fixed": "edges"},
    "prism": {"sides": 4, "radius": 0.3, "height": 0.8, "top_radius": 0.2, "bar_mass": 2.0,
              "handedness": "right", "diagonals": True},
    "prism_tower": {"stages": 2, "sides": 4, "radius": 0.3, "height": 0.8, "bar_mass": 2.0,
                    "overlap": 0.2, "handedness": "right"},
    "six_bar_ball": {"bar_length": 1.0, "bar_mass": 0.2},
    "snelson_x": {"width": 2.0, "height": 0.5, "dimension": 3, "bar_mass": 0.2},
    "spine": {"vertebrae": 3, "leg_length": 0.2, "spread": 1.0, "spacing": 0.15, "bar_mass": 0.2},
    "stedy_arm": {"bar_length": 0.5, "bar_mass": 0.2},
    "t_bar": {"width": 1.0, "height": 1.0, "dimension": 2, "bar_mass": 0.2, "continuous": True},
    "thirty_bar_ball": {"bar_length": 2.0, "bar_mass": 0.2},
    "truncated_tetrahedron": {"bar_length": 2.0, "bar_mass": 0.2},
    "twelve_bar_ball": {"bar_length": 2.0, "bar_mass": 0.2},
    "wheel": {"spokes": 8, "radius": 0.5, "width": 0.2, "bar_mass": 0.2},
}  # fmt: skip

SQUARE = """
[structure]
nodes = [[0, 0], [1, 0], [1, 1], [0, 1]]
bars = [[0, 1], [1, 2]]
strings = [[2, 3], [0, 3, 2]]
bar_mass = 1.0
point_mass = [0, 0, 0.5, 0.2]
fixed = [0, [1, "y"]]
[prestress]
force_density = [1.0, 2.0]
[run]
duration = 0.1
step = 1e-3
"""


@pytest.fixture
def structure(tmp_path):
    """Return the structure of a scene file with this text."""

    def of(text):
        path = tmp_path / "scene.toml"
        run = "" if "[run]" in text else "[run]\nduration = 1\nstep = 1e-3\n"
        path.write_text(text + run, encoding="utf-8")
        return build_structure(read_document(path))

    return of


def toml(value):
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value!r}"


def test_every_generator_has_every_argument_as_a_key():
    assert set(GENERATORS) == set(tc.library.__all__) == set(SIZES)
    for name, make in GENERATORS.items():
        assert set(SIZES[name]) == set(signature(make).parameters)
        extra = {"generator", "point_mass", "fixed"}
        assert set(GENERATOR_KEYS[name]) == set(signature(make).parameters) | extra


@pytest.mark.parametrize("name", SIZES)
def test_generators_get_their_arguments(name, structure):
    keys = "".join(f"{key} = {toml(value)}\n" for key, value in SIZES[name].items())
    found = structure(f"[structure]\ngenerator = '{name}'\n{keys}")
    expected = getattr(tc.library, name)(**SIZES[name])
    assert tc.structure.structure.same_members(found, expected)
    np.testing.assert_array_equal(found.nodes, expected.nodes)
    np.testing.assert_array_equal(found.bar_mass, expected.bar_mass)
    np.testing.assert_array_equal(found.point_mass, expected.point_mass)
    assert found.string_groups == expected.string_groups


def test_structures_by_nodes_have_rollers_paths_and_payloads(structure):
    square = structure(SQUARE)
    assert square.dimension == 2
    assert square.fixed.tolist() == [0]
    assert square.rollers == ((1, "y"),)
    assert square.paths == ((2, 3), (0, 3, 2))
    assert square.point_mass.tolist() == [0, 0, 0.5, 0.2]
    np.testing.assert_array_equal(square.nodes, [[0, 1, 1, 0], [0, 0, 1, 1]])


def test_generated_structures_get_other_supports_and_payloads(structure):
    found = structure(
        "[structure]\ngenerator = 'd_bar'\nfixed = [0, [2, 'y']]\npoint_mass = [0, 0, 3, 0]\n"
    )
    assert found.fixed.tolist() == [0]
    assert found.rollers == ((2, "y"),)
    assert found.point_mass[2] == 3.0
    standing = structure("[structure]\ngenerator = 'spine'\nfixed = [0, [1, 'z'], [3, 'x']]\n")
    assert standing.fixed.tolist() == [0]


def test_what_ships_is_what_it_says():
    scene = tc.load_scene(SCENES / "d_bar_on_rails.toml")
    assert (scene.structure.structure_class, scene.structure.dimension) == (2, 2)
    assert scene.structure.rollers == ((2, "y"),)
    speeds = scene.structure.bar_vectors(scene.velocities)
    along = (speeds * scene.structure.bar_vectors(scene.nodes)).sum(axis=0)
    np.testing.assert_allclose(along, 0.0, atol=1e-15)
    tower = tc.load_scene(SCENES / "class2_tower.toml")
    off = np.linalg.norm(tower.nodes - tower.structure.nodes, axis=0)
    assert off.max() == pytest.approx(0.02)
    assert off[tower.structure.fixed].max() == 0.0
    length = np.linalg.norm(tower.structure.bar_vectors(tower.nodes), axis=0)
    np.testing.assert_allclose(length, tower.structure.bar_length, rtol=1e-12)


def test_bounds_of_force_density_come_through(tmp_path, monkeypatch):
    asked = {}

    def balance(structure, force_density=None, **settings):
        asked.update(settings, force_density=force_density)
        return tc.OperatingPoint(structure.nodes, np.ones(9))

    monkeypatch.setattr(sys.modules["tenscontrol.scene.structure_tables"], "prestress", balance)
    text = "[structure]\ngenerator = 'prism'\n[prestress]\n{}\n[run]\nduration = 1\nstep = 1e-3\n"
    path = tmp_path / "scene.toml"
    path.write_text(text.format("min_force_density = {top = 1, bottom = 2, vertical = 3}"))
    tc.load_scene(path)
    np.testing.assert_array_equal(asked["min_force_density"], np.repeat([1.0, 2.0, 3.0], 3))
    assert asked["force_density"] is None
    path.write_text(text.format("force_density = 9.0\nmax_force_density = 20\nreference = 'top'"))
    tc.load_scene(path)
    assert (asked["force_density"], asked["reference"]) == (9.0, "top")
    np.testing.assert_array_equal(asked["max_force_density"], np.full(9, 20.0))
    path.write_text(text.format("force_density = {top = 1, bottom = 1, vertical = 1}\n"
                                "min_force_density = 1.0"))  # fmt: skip
    with pytest.raises(SceneError, match=r":5: .*min_force_density goes with a single number"):
        tc.load_scene(path)


START = "[structure]\ngenerator = "
BROKEN = {
    "axis that is none": (
        SQUARE.replace('"y"', '"w"'),
        r":8: in .*fixed axis of node 1 is 'w', expected one of 'x', 'y'",
    ),
    "axis of space in the plane": (
        SQUARE.replace('"y"', '"z"'),
        r":8: in .*fixed axis of node 1 is 'z', expected one of 'x', 'y'",
    ),
    "axis first": (
        SQUARE.replace('[1, "y"]', '["y", 1]'),
        r":8: in .*fixed\[1\] is \['y', 1\], expected a node number, or a pair like \[4, \"z\"\]",
    ),
    "nodes of two kinds": (
        SQUARE.replace("[1, 1]", "[1, 1, 0]"),
        r":3: in .*nodes\[2\] is \[1, 1, 0\], expected 2 coordinates as nodes\[0\] has",
    ),
    "nodes on a line": (
        SQUARE.replace("[[0, 0], [1, 0], [1, 1], [0, 1]]", "[[0], [1], [2], [3]]"),
        r":3: in .*nodes\[0\] is \[0\], expected \[x, y, z\] \(or \[x, y\]\) in m",
    ),
    "path of one node": (
        SQUARE.replace("[2, 3]", "[2]"),
        r":5: in .*strings\[0\] is \[2\], expected a pair of node numbers, or a path of more",
    ),
    "path back": (
        SQUARE.replace("[0, 3, 2]", "[0, 3, 0]"),
        r":5: in .*strings\[1\] passes node 0 twice",
    ),
    "a force in space on a planar node": (
        SQUARE + "[loads]\nforces = [{node = 2, force = [0, 0, 1]}]\n",
        r":15: in \[loads\], forces\[0\].force has 3 numbers, expected 2 in N",
    ),
    "velocities in space": (
        SQUARE + "[start]\nvelocities = [[0,0,0], [0,0,0], [0,0,0], [0,0,0]]\n",
        r":15: in \[start\], velocities\[0\] is \[0, 0, 0\], expected 2 coordinates",
    ),
    "velocities too few": (
        SQUARE + "[start]\nvelocities = [[0,0]]\n",
        r":15: in \[start\], velocities has 1 entries, expected 4: \[x, y\] for each node",
    ),
    "generator unknown": (
        START + "'six_bar_bal'\n",
        r":2: in \[structure\], generator is 'six_bar_bal'; did you mean 'six_bar_ball'\?",
    ),
    "argument of another generator": (
        START + "'d_bar'\nstages = 2\n",
        r":3: \[structure\] with generator = 'd_bar' has no key 'stages'",
    ),
    "argument that is needed": (
        START + "'prism_tower'\n",
        r":1: \[structure\] with generator = 'prism_tower' lacks the key stages: a whole number",
    ),
    "a word for supports": (
        START + "'d_bar'\nfixed = 'edges'\n",
        r":3: in .*'d_bar', fixed is the text 'edges', expected a list of node numbers, and of",
    ),
    "an argument out of range": (
        START + "'kite'\nacross = 2\n",
        r":3: in .*across is 2, expected a share of the width, below 1",
    ),
    "truth as a number": (
        START + "'class2_tower'\nfloating = 1\n",
        r":3: in .*floating is 1, expected true or false",
    ),
    "too many members": (
        START + "'arm'\nsections = 2000000000\n",
        r":3: in .*sections is 2000000000, which makes .* GB of memory",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_scenes_are_refused_by_line_and_name(case, tmp_path):
    text, message = BROKEN[case]
    if "[run]" not in text:
        text += "[run]\nduration = 1\nstep = 1e-3\n"
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match=r"scene\.toml" + f"({message})"):
        tc.load_scene(path)
