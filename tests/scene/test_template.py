"""Scenes written for the structures of the library: they load, run and linearize as they are."""

import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.scene import scene_names, scene_template, schema
from tenscontrol.scene.template import comment

NAMES = sorted(tc.library.__all__)


def test_every_structure_of_the_library_has_a_scene_and_a_line():
    assert list(scene_names()) == NAMES
    for line in scene_names().values():
        assert re.fullmatch(r"[A-Z].*\.", line)
        assert not line.startswith("Return")


@pytest.mark.parametrize("name", sorted({*NAMES[::2], "geiger_dome", "six_bar_ball"}))
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


def tables():
    """Every table with its keys, those of one choice of its first key by themselves."""
    yield from ((name, table.keys) for name, table in schema.TABLES.items())
    yield from (("structure", keys) for keys in (*schema.GENERATOR_KEYS.values(), schema.MEMBERS))
    yield from (("strings", keys) for keys in schema.LAW_KEYS.values())
    yield from (("ground", keys) for keys in schema.GROUND_KEYS.values())
    yield from (("controller", keys) for keys in schema.CONTROLLER_KEYS.values())
    yield from (("faults", keys) for keys in schema.FAULT_KEYS.values())
    yield from (("controller", keys) for keys in (schema.OUTPUT, schema.WAYPOINT))


@pytest.mark.parametrize(("table", "keys"), list(tables()))
def test_every_key_has_a_comment_of_unit_and_meaning(table, keys):
    assert schema.TABLES[table].meaning
    for name, key in keys.items():
        written = comment(f"{table}.{name}", key)
        assert written.startswith(f"# {key.unit}: " if key.unit else "# ")
        # A name at least, without the markup of a docstring, its symbols and its unit alone.
        assert re.match(r"[^`]*[A-Za-z]{3}[^`]*$", key.meaning), written
        assert not re.search(r":\w+:|\*\*", key.meaning), written


@pytest.mark.parametrize(
    ("table", "key", "expected"),
    [
        ("winches", "inertia", "kg m²: inertia J of the rotor, with that of the drum by 1/G²"),
        (
            "sensors",
            "bar_rate",
            "rad/s: standard deviation of each entry of an angular velocity d × ḋ",
        ),
        ("run", "sample_time", "s: time between two commands"),
        ("subdivide", "node_mass", "kg: mass of each new node"),
        (
            "controller",
            "max_change",
            "N/m or m: largest change of the command from sample to sample",
        ),
        (
            "controller",
            "solver",
            'solver of the quadratic programs: "auto", "stages" or "osqp"',
        ),
        (
            "controller",
            "outputs",
            "limits on node positions, in tables [[controller.outputs]]",
        ),
        ("ground", "nodes", "nodes that it acts on, or a mask of them; all, if not given"),
    ],
)
def test_comments_are_those_of_docstrings(table, key, expected):
    assert comment(f"{table}.{key}", schema.TABLES[table].keys[key]) == f"# {expected}"


def test_an_argument_that_no_file_can_hold_is_named():
    def law(gain):
        """Return nothing.

        Parameters
        ----------
        gain : callable
            Gain of a law.
        """

    with pytest.raises(LookupError, match="gain is documented as 'callable', which is no kind"):
        schema.keys_of(law)


def test_keys_of_a_written_table_are_all_listed():
    text = scene_template("arm")
    (table,) = re.findall(r"^\[controller\].*\n((?:.+\n)+)", text, re.M)
    keys = schema.CONTROLLER_KEYS["mpc"]
    listed = re.findall(r"^(?:# )?(\w+) =", table, re.M)
    assert sorted(listed) == sorted(keys)
    for line, name in zip(table.splitlines(), listed, strict=True):
        assert line.endswith(comment(f"controller.{name}", keys[name]))


def test_other_names_are_refused():
    with pytest.raises(ValueError, match="name is 'ball', expected one of 'arm'"):
        scene_template("ball")
    with pytest.raises(ValueError, match="name is 3, expected one of"):
        scene_template(3)
