"""Structures go to files and come back bit by bit; what is no structure is refused with a word."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import tenscontrol as tc
from tests.random_structures import any_structure
from tests.scene.test_scene_structures import SIZES

ENDINGS = (".toml", ".json")
ARRAYS = ("nodes", "bars", "strings", "bar_mass", "point_mass", "fixed")


def assert_same(one, other):
    """The same to the last bit, parents too."""
    for name in ARRAYS:
        a, b = getattr(one, name), getattr(other, name)
        assert a.dtype == b.dtype, name
        assert a.tobytes() == b.tobytes(), name
        assert a.shape == b.shape, name
        assert not b.flags.writeable
    for name in ("string_groups", "rollers", "paths"):
        assert getattr(one, name) == getattr(other, name), name
    assert (one.string_parent is None) == (other.string_parent is None)
    if one.string_parent is not None:
        np.testing.assert_array_equal(one.string_parent, other.string_parent)
    assert (one.parent is None) == (other.parent is None)
    if one.parent is not None:
        assert_same(one.parent, other.parent)


def there_and_back(structure, folder, ending):
    path = Path(folder) / f"structure{ending}"
    assert structure.save(path) == path
    return tc.Structure.load(str(path))


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("name", tc.library.__all__)
def test_every_structure_of_the_library(name, ending, tmp_path):
    structure = getattr(tc.library, name)(**SIZES[name])
    assert_same(structure, there_and_back(structure, tmp_path, ending))


@pytest.mark.parametrize("ending", ENDINGS)
def test_skinned_and_subdivided(ending, tmp_path):
    skinned = tc.skin(tc.prism(), panels=["top"], iterations=1, node_mass=0.01)
    cut = tc.subdivide(skinned, segments=3, string_mass=0.3)
    found = there_and_back(cut, tmp_path, ending)
    assert found.parent.parent is not None
    assert_same(cut, found)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), ending=st.sampled_from(ENDINGS))
def test_random_structures(seed, ending, tmp_path_factory):
    """Rigid bodies, clustered strings, rollers, point masses, in space and in the plane."""
    structure = any_structure(seed)
    assert_same(structure, there_and_back(structure, tmp_path_factory.mktemp("files"), ending))


@settings(max_examples=25, deadline=None)
@given(
    x=st.tuples(st.just(0.0), st.just(-0.7), st.floats(-1e6, 1e6)),
    y=st.tuples(st.just(5e-324), st.just(-0.0), st.floats(-1e6, 1e6)),
    mass=st.floats(1e-60, 1e60),
    group=st.text("aβ_中", min_size=1, max_size=4),
    ending=st.sampled_from(ENDINGS),
)
def test_any_number_and_name(x, y, mass, group, ending, tmp_path_factory):
    made = tc.Structure(
        [x, y], [[0, 1]], [[1, 2]], mass, fixed=[0], string_groups=[group],
        point_mass=[0.0, 0.0, mass],
    )  # fmt: skip
    assert_same(made, there_and_back(made, tmp_path_factory.mktemp("files"), ending))


def test_a_file_with_prestress_and_run_is_a_scene(tmp_path):
    structure = tc.subdivide(tc.library.six_bar_ball(), segments=2, string_mass=0.01)
    path = structure.save(tmp_path / "ball.toml")
    with path.open("a", encoding="utf-8") as file:
        file.write("[prestress]\nforce_density = 5.0\n[run]\nduration = 0.01\nstep = 1e-3\n")
    scene = tc.load_scene(path)
    assert_same(structure, scene.structure)
    assert_same(structure, tc.Structure.load(path))
    assert scene.simulate().time[-1] == 0.01


def test_files_written_by_hand(tmp_path):
    path = tmp_path / "bar.TOML"
    path.write_text("[structure]\nnodes=[[0,0],[1,0]]\nbars=[[0,1]]\nstrings=[]\nbar_mass=2\n")
    assert tc.Structure.load(path).bar_mass.tolist() == [2.0]


def changed(**entries):
    """The text of a prism as JSON with other entries."""
    table = json.loads(json.dumps(tc.structure.structure_file.to_table(tc.prism()))) | entries
    return json.dumps({"structure": {k: v for k, v in table.items() if v != "absent"}})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[]", r"the table \[structure\] is missing"),
        ('{"structure": 1}', r"the table \[structure\] is missing"),
        (changed(version=2), "version is 2, expected at most 1: the file is of a later release"),
        (changed(version="1"), "version is '1', expected a whole number"),
        (changed(bars="absent"), "the key 'bars' is missing"),
        (changed(node=1), "'node' is no key of a structure; did you mean 'nodes'"),
        (changed(generator="prism"), "generator is 'prism'"),
        (changed(nodes=3), "nodes is 3, expected a list"),
        (changed(nodes=[[0, 1], [1]]), r"nodes\[1\] is \[1\], expected 2 coordinates"),
        (changed(nodes=[["a", 1], [1, 2]]), "nodes is .*expected a list of"),
        (changed(bars=[[0, 99]]), r"bars\[0"),
        (changed(bar_mass=[1.0]), "bar_mass has shape"),
        (changed(bar_mass=float("nan")), "bar_mass is nan, expected a finite number"),
        (changed(point_mass=[float("nan")] * 6), r"point_mass\[0\] is nan"),
        (changed(parent=3), "parent is 3, expected the table of a structure"),
        (changed(parent={"nodes": []}), "parent: the key 'bars' is missing"),
        (changed(string_parent=[0] * 9), "string_parent is given without parent"),
    ],
)  # fmt: skip
def test_what_is_no_structure_is_refused(text, message, tmp_path):
    path = tmp_path / "structure.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message) as raised:
        tc.Structure.load(path)
    assert str(raised.value).startswith(str(path))


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(FileNotFoundError, match="cannot be read: No such file"):
        tc.Structure.load(tmp_path / "absent.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(OSError, match="it is a folder"):
        tc.Structure.load(tmp_path / "folder.toml")
    with pytest.raises(ValueError, match=r"expected a name ending in \.toml, \.json"):
        tc.prism().save(tmp_path / "prism.yaml")
    (tmp_path / "bad.toml").write_bytes(b"[structure]\nnodes = \xff")
    with pytest.raises(ValueError, match=r"bad\.toml:2: not UTF-8 text"):
        tc.Structure.load(tmp_path / "bad.toml")


@pytest.mark.parametrize("path", [f"{'a.' * 50_000}b = 1", f"[{'a.' * 50_000}b]", "[" * 20])
def test_what_takes_toml_hours_or_all_memory_is_refused(path, tmp_path):
    (tmp_path / "deep.toml").write_text(f"\nx = {path}" if path == "[" * 20 else f"\n{path}")
    with pytest.raises(ValueError, match=r"deep\.toml:2: exceeds the limits: a structure file has"):
        tc.Structure.load(tmp_path / "deep.toml")


def test_a_text_that_becomes_too_much_memory_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "lists.json"
    path.write_text('{"structure": {"nodes": [' + "[]," * 1_000 + "[]]}}")
    with pytest.raises(ValueError, match="the key 'bars' is missing"):
        tc.Structure.load(path)
    monkeypatch.setattr(tc.validation, "_MOST_BYTES", 120_000)
    with pytest.raises(ValueError, match=r"lists\.json: it has 2,004 values and lists, "):
        tc.Structure.load(path)
