"""Scenes written for the structures of the library: they load, run and linearize as they are."""

import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.scene import comments, scene_names, scene_template, schema

NAMES = sorted(tc.library.__all__)


def test_every_structure_of_the_library_has_a_scene_and_a_line():
    assert list(scene_names()) == NAMES
    for line in scene_names().values():
        assert re.fullmatch(r"[A-Z].*\.", line)
        assert not line.startswith("Return")


@pytest.mark.parametrize("name", NAMES)
def test_a_written_scene_runs_as_it_is(load, name):
    text = scene_template(name)
    scene = load(text)
    assert all(len(line) <= 110 for line in text.splitlines())
    off = np.linalg.norm(scene.nodes - scene.structure.nodes, axis=0).max()
    assert off == pytest.approx(tomllib.loads(text)["start"]["disturbance"])
    plant = scene.linearize()
    assert plant.input == "rest_length"
    reached = name not in ("six_bar_ball", "geiger_dome", "net")
    assert (scene.controller is not None) == reached
    assert ("\n# There is no controller" in text) != reached
    how = replace(scene.integration, output_step=1e-3)
    run = replace(scene, duration=2e-3, integration=how).simulate()
    assert run.stopped is None
    assert np.isfinite(run.nodes).all()
    assert (np.abs(run.velocities[:, :, -1]) > 0).any()


def test_the_controller_brings_the_arm_to_rest(load):
    scene = load(scene_template("arm"))
    run = replace(scene, duration=1.0).simulate()
    assert run.control.status_count == {"ok": 100}
    off = np.linalg.norm(run.nodes - scene.structure.nodes[:, :, None], axis=0).max(axis=0)
    assert off[-1] < 1e-3 * off[0]


def test_the_lqr_that_leaves_modes_alone_is_there_to_be_taken(load):
    lines = scene_template("six_bar_ball").splitlines()
    first = lines.index("# Remove the first # of these lines for an LQR that leaves those modes "
                        "alone:")  # fmt: skip
    for i in range(first + 1, first + 5):
        lines[i] = lines[i].removeprefix("# ")
    with pytest.warns(RuntimeWarning, match="no string reaches 1 mode "):
        scene = load("\n".join(lines))
    assert isinstance(scene.controller, tc.LQR)


def test_every_table_and_key_of_a_scene_has_a_comment():
    assert set(comments.TABLE_COMMENTS) == set(schema.TABLES)
    for table, keys in schema.TABLES.items():
        for key, (_, unit) in keys.items():
            said = comments.comment(table, key, unit)
            assert said.startswith(f"# {unit}: " if unit else "# ")
            assert len(said) > len(unit) + 8


def test_keys_of_a_written_table_are_all_listed():
    text = scene_template("arm")
    (table,) = re.findall(r"^\[controller\].*\n((?:.+\n)+)", text, re.M)
    listed = re.findall(r"^(?:# )?(\w+) =", table, re.M)
    assert sorted(listed) == sorted(schema.CONTROLLER_KEYS["mpc"])
    for line in table.splitlines():
        key = re.match(r"(?:# )?(\w+)", line).group(1)
        assert line.endswith(
            comments.comment("controller", key, schema.CONTROLLER_KEYS["mpc"][key][1])
        )


def test_other_names_are_refused():
    with pytest.raises(ValueError, match="name is 'ball', expected one of 'arm'"):
        scene_template("ball")
    with pytest.raises(ValueError, match="name is 3, expected one of"):
        scene_template(3)
