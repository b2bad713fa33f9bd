"""Scene files: what they give, and what is said of broken ones."""

import os
import sys
import tomllib
from dataclasses import replace
from inspect import signature
from pathlib import Path

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol import parsing
from tenscontrol.parsing import TomlLimits, headings
from tenscontrol.scene import SceneError, schema
from tenscontrol.scene.document import key_lines
from tests.scene.limits import limits

SCENES = Path(__file__).parent.parent.parent / "examples" / "scenes"

PRISM = """\
[structure]
generator = "prism"
[strings]
law = "linear"
stiffness = 100.0
[prestress]
force_density = 17.3205
[run]
duration = 0.1
step = 1e-2
"""


def shipped(name, **settings):
    return replace(tc.load_scene(SCENES / f"{name}.toml"), **settings)


# ---- what scenes give ----


def test_values_come_through(load):
    scene = load(
        """
[structure]
generator = "prism"
sides = 4
radius = 0.4
height = 0.9
top_radius = 0.3
bar_mass = [1.0, 1.1, 1.2, 1.3]
handedness = "right"
fixed = [4, 5]
[strings]
law = "elastic"
axial_rigidity = {top = 200, bottom = 300, vertical = 400}
damping = 0.5
[loads]
gravity = [0.0, 0.0, -3.7]
forces = [{node = 1, force = [0.1, 0.2, 0.3]}]
[prestress]
force_density = {top = 1.0, bottom = 2.0, vertical = 3}
[start]
velocities = [[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0],
  [0, 0, 0]]
[run]
duration = 2
tolerance = 1e-7
output_step = 0.1
method = "dop853"
"""
    )
    prism = tc.prism(4, 0.4, 0.9, 0.3, [1.0, 1.1, 1.2, 1.3], "right")
    forces = np.zeros((3, 8))
    forces[:, 1] = 0.1, 0.2, 0.3
    law = tc.ElasticStrings(np.repeat([200.0, 300.0, 400.0], 4), 0.5)
    model = tc.Model(replace(prism, fixed=[4, 5]), law, forces, [0.0, 0.0, -3.7])
    gamma = np.repeat([1.0, 2.0, 3.0], 4)
    np.testing.assert_array_equal(scene.nodes, prism.nodes)
    np.testing.assert_array_equal(scene.structure.bar_mass, prism.bar_mass)
    np.testing.assert_array_equal(scene.structure.fixed, [4, 5])
    np.testing.assert_array_equal(scene.model.constant_force, model.constant_force)
    np.testing.assert_array_equal(scene.model.strings.axial_rigidity, law.axial_rigidity)
    np.testing.assert_array_equal(scene.model.strings.damping, 0.5)
    np.testing.assert_array_equal(scene.prestress, gamma)
    wound = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    np.testing.assert_array_equal(scene.rest_length, wound)
    assert scene.duration == 2
    assert (scene.integration.tolerance, scene.integration.output_step) == (1e-7, 0.1)
    assert (scene.integration.method, scene.input, scene.integration.step) == (
        "dop853",
        "rest_length",
        None,
    )
    assert len(scene.simulate().time) == 21


def test_structure_by_its_members(load):
    scene = load(
        """
run = {duration = 0.1}
[structure]
nodes = [
  [0, 0, 0],
  [1, 0, 0],  # a comment, and a bracket ]
  [2, 0, 0],
  [3, 0, 0],
]
bars = [[1, 2]]
strings = [[0, 1], [2, 3]]
bar_mass = 2
string_node_mass = 0.1
string_groups = ["left", "right"]
[prestress.force_density]
left = 1
right = 2
"""
    )
    assert scene.structure.string_groups == ("left", "right")
    np.testing.assert_array_equal(scene.structure.string_nodes, [0, 3])
    np.testing.assert_array_equal(scene.force_density, [1, 2])
    assert scene.input == "force_density"
    assert scene.simulate().time[-1] == pytest.approx(0.1)


def test_pendulum_without_strings(load):
    scene = load(
        "[structure]\nnodes=[[0,0,0],[0,0,-1]]\nbars=[[0,1]]\nstrings=[]\nbar_mass=1\nfixed=[0]\n"
        "[loads]\ngravity=9.81\n[run]\nduration=0.2\n"
        "[start]\nvelocities=[[0,0,0],[1,0,0]]\n"
    )
    run = scene.simulate()
    assert np.ptp(run.energy) < 1e-5
    assert run.nodes[0, 1, -1] > 0.15


def test_a_number_is_a_balance_and_a_table_is_not(load):
    scene = load(PRISM)
    np.testing.assert_allclose(scene.prestress[[0, -1]], [17.3205, 30.0], rtol=1e-5)
    plant = scene.linearize("force_density")
    assert tc.modes(plant).frequency[-1] == pytest.approx(2.44339, abs=1e-5)
    with pytest.raises(ValueError, match="not at rest"):
        shipped("prism_free").linearize()


@pytest.mark.parametrize("law", ["linear", "elastic"])
def test_cut_strings_act_as_whole_ones(load, law):
    stiffness = "stiffness" if law == "linear" else "axial_rigidity"
    scene = load(
        PRISM.replace("linear", law)
        .replace("stiffness", stiffness)
        .replace("100.0", "100\ndamping=2")
        + "[subdivide]\nsegments={top=2,bottom=3,vertical=4}\n"
        "string_mass={top=0.1,bottom=0.1,vertical=0.2}\n"
    )
    structure = scene.structure
    count = tc.structure.segment_counts(structure)
    np.testing.assert_array_equal(np.bincount(structure.string_parent), np.repeat([2, 3, 4], 3))
    np.testing.assert_array_equal(scene.model.strings.damping, 2.0 * count)
    # The tension of a segment is that of its string, also where the string is longer.
    longer = 1.1 * structure.string_length()
    gamma = scene.model.strings.force_density(longer, scene.rest_length)
    parent = structure.parent
    model = tc.Model(
        parent,
        strings=load(PRISM.replace("linear", law).replace("stiffness", stiffness)).model.strings,
    )
    rest = tc.prestress(parent, 17.3205)
    wound = tc.to_rest_length(model, parent.nodes, rest.force_density).rest_length
    whole = model.strings.force_density(1.1 * parent.string_length(), wound)
    np.testing.assert_allclose(
        gamma, tc.structure.spread_force_density(structure, whole), rtol=1e-12
    )
    assert scene.linearize().invariance_residual < 1e-8


def test_values_of_segments_are_taken_as_they_are():
    whole, literal = shipped("prism_massive_strings"), shipped("prism_massive_literal")
    assert set(whole.model.strings.stiffness) == {400.0}
    assert set(literal.model.strings.stiffness) == {100.0}
    np.testing.assert_allclose(whole.prestress, 4 * literal.prestress, rtol=1e-12)
    np.testing.assert_allclose(whole.rest_length, literal.rest_length, rtol=1e-12)


@pytest.mark.parametrize("per", ["string", "segment"])
@pytest.mark.parametrize(
    "controller", ["input = 'rest_length'", "max_force_density = {top=40,bottom=40,vertical=45}"]
)
def test_controller_commands_whole_strings(load, per, controller):
    scene = load(
        PRISM.replace("100.0", f"100.0\nper='{per}'\ndamping=1")
        .replace("step = 1e-2", "tolerance = 1e-6\nsample_time = 0.01")
        .replace("17.3205", f"17.3205\nper='{per}'")
        + "[subdivide]\nsegments = 2\nnode_mass = 0.001\n"
        f"[controller]\nkind = 'lqr'\n{controller}\n"
        "[winches]\nrate = {top=1.0,bottom=1.0,vertical=2.0}\n[start]\ndisturbance = 0.005\n"
    )
    plant = scene.controller.plant
    assert len(plant.model.structure.strings) == 9
    factor = 1.0 if per == "string" else 0.5
    np.testing.assert_allclose(plant.model.strings.stiffness, 100.0 * factor)
    np.testing.assert_allclose(plant.model.strings.damping, factor)
    np.testing.assert_allclose(plant.force_density[0], 17.3205 * factor)
    run = scene.simulate()
    assert set(run.control.status) <= {"ok", "saturated"}
    assert run.control.applied.shape[0] == 9
    assert scene.winches.rate[-1] == 2.0


def test_elastic_segments_in_series(load):
    scene = load(
        PRISM.replace('"linear"\nstiffness', '"elastic"\nper = "segment"\naxial_rigidity')
        + "[subdivide]\nsegments = 2\nnode_mass = 0.01\n[controller]\nkind = 'lqr'\n"
    )
    np.testing.assert_allclose(scene.controller.plant.model.strings.axial_rigidity, 100.0)


def test_disturbance_is_as_large_as_it_says(load):
    moved = [load(PRISM + f"[start]\ndisturbance = 0.02\nseed = {seed}\n") for seed in (1, 1, 2)]
    off = np.linalg.norm(moved[0].nodes - moved[0].structure.nodes, axis=0)
    assert off.max() == pytest.approx(0.02, rel=1e-9)
    bars = np.linalg.norm(moved[0].structure.bar_vectors(moved[0].nodes), axis=0)
    np.testing.assert_allclose(bars, moved[0].structure.bar_length, rtol=1e-12)
    np.testing.assert_array_equal(moved[0].nodes, moved[1].nodes)
    assert not np.array_equal(moved[0].nodes, moved[2].nodes)


def test_a_force_may_be_a_whole_number_of_any_size(load):
    scene = load(
        PRISM.replace("17.3205", "{top=1,bottom=1,vertical=1}")
        + "[[loads.forces]]\nnode = 0\nforce = [-1000000000000000000000, 0, 0.5]\n"
    )
    assert scene.model.constant_force[:, 0].tolist() == [-1e21, 0.0, 0.5]


def test_forces_in_tables_of_their_own(load):
    scene = load(
        PRISM.replace("17.3205", "{top=1,bottom=1,vertical=1}")
        + "[[loads.forces]]\nnode = 0\nforce = [1, 0, 0]\n"
        "[[loads.forces]]\nnode = 2\nforce = [0, 1, 0]\n"
    )
    np.testing.assert_array_equal(scene.model.constant_force[:, [0, 2]], [[1, 0], [0, 1], [0, 0]])


# ---- what ships ----


def test_every_scene_that_ships_is_tested():
    assert {file.stem for file in SCENES.glob("*.toml")} == {
        "prism_fault",
        "prism_free",
        "prism_massive_strings",
        "prism_massive_literal",
        "prism_skin",
        "prism_skin_expanding",
        "prism_morph",
        "prism_mpc",
        "prism_standing",
        "d_bar_on_rails",
        "class2_tower",
        "ball_drop",
    }


def test_prism_free():
    scene = shipped("prism_free", duration=1.0)
    np.testing.assert_allclose(scene.nodes[:, 0], [0.4830, -0.1294, 1.0], atol=5e-5)
    np.testing.assert_allclose(scene.structure.bar_length, 1.3903, atol=5e-5)
    run = scene.simulate()
    assert run.nodes[2, 0].max() == pytest.approx(1.078, abs=1e-3)
    assert (run.force_density == 0).any()


def test_literal_reading_is_the_other_at_half_speed():
    scene = shipped("prism_massive_strings", duration=1.0)
    assert scene.structure.string_node_mass.sum() == pytest.approx(0.09 * 3.0)
    run = scene.simulate()
    slow = shipped("prism_massive_literal", duration=2.0).simulate()
    np.testing.assert_allclose(run.nodes, slow.nodes, atol=1e-5)
    assert run.energy[0] == pytest.approx(4 * slow.energy[0])


def test_skin_of_a_contracting_prism_goes_slack():
    scene = shipped("prism_skin")
    run = scene.simulate()
    bare = shipped("prism_free", duration=scene.duration).simulate()
    assert run.nodes[2, 0].max() == pytest.approx(1.08, abs=5e-3)
    assert bare.nodes[2, 0].max() == pytest.approx(1.08, abs=5e-3)
    skin = run.force_density[scene.structure.strings_in("skin")]
    assert len(skin) == 24
    assert (skin == 0).mean() > 0.3


def test_skin_of_a_contracting_prism_is_chaotic():
    scene = shipped("prism_skin", duration=2.0)
    pushed = scene.nodes + 1e-10 * np.random.default_rng(0).normal(size=scene.nodes.shape)
    pushed = tc.structure.restore_bar_lengths(scene.structure, pushed)
    apart = scene.simulate().nodes - replace(scene, nodes=pushed).simulate().nodes
    assert np.abs(apart[:, :, -1]).max() > 1e-3


def test_skin_of_an_expanding_prism_stiffens_it():
    scene = shipped("prism_skin_expanding")
    run = scene.simulate()
    bare = shipped("prism_free")
    gamma = np.repeat([17.3205, 17.3205, 45.0], 3)
    wound = tc.to_rest_length(bare.model, bare.nodes, gamma).rest_length
    free = replace(bare, rest_length=wound).simulate()
    fall = [1.0 - motion.nodes[2, 0].min() for motion in (run, free)]
    assert fall[1] == pytest.approx(0.09, abs=1e-3)
    assert fall[0] / fall[1] == pytest.approx(0.25, abs=0.02)
    assert (run.force_density > 0).all()


def test_prism_standing():
    """The shape of the scene is the one that has given under the weight, and it is held."""
    scene = shipped("prism_standing")
    top = scene.structure.nodes[2, :3]
    np.testing.assert_allclose(top, 1.0 - 0.0041, atol=1e-4)
    run = scene.simulate()
    off = np.linalg.norm(run.nodes - scene.structure.nodes[:, :, None], axis=0).max(axis=0)
    assert off[0] > 5e-3
    assert off[-1] < 1e-3
    assert scene.linearize("rest_length", "minimal").degrees_of_freedom == 6


def test_prism_mpc():
    scene = shipped("prism_mpc")
    run = scene.simulate()
    plant = scene.controller.plant
    r = plant.degrees_of_freedom

    def off(k):
        q = plant.measure(run.nodes[..., k], run.velocities[..., k])[:r]
        return np.linalg.norm(plant.to_nodes(q) - plant.nodes, axis=0).max()

    assert off(0) > 0.015
    assert off(-1) < 0.002
    assert run.control.status_count == {"ok": 150}
    assert np.abs(run.control.winch_rate).max() < 0.5 + 1e-9
    assert run.force_density.min() > 0


def test_prism_morph():
    scene = shipped("prism_morph")
    plant = scene.controller.plant
    assert plant.input == "rest_length"
    np.testing.assert_allclose(scene.controller.bounds[0], 0.1)  # of the winches
    reference = reference_of(scene)
    assert reference.time[[0, 1, -1]] == pytest.approx([0.0, 0.5, 3.5])
    assert height(reference.nodes)[[0, 1, -1]] == pytest.approx([1.0, 1.0, 0.85])
    run = scene.simulate()
    found = height(run.nodes)
    assert abs(found[-1] - 0.85) < 1e-3
    assert found.min() > 0.84
    assert np.abs(run.control.winch_rate).max() < 0.15 + 1e-9
    assert set(run.control.status) == {"ok"}
    assert run.force_density.min() > 5.0


def height(nodes):
    """Height of the top nodes of a prism above the bottom ones."""
    return nodes[2, :3].mean(axis=0) - nodes[2, 3:].mean(axis=0)


def twist(nodes):
    """Turn of the top nodes of a prism against the bottom ones, rad, positive as a screw."""
    ends = [part - part.mean(axis=1, keepdims=True) for part in (nodes[:2, :3], nodes[:2, 3:])]
    top, bottom = (part[0] + 1j * part[1] for part in ends)
    return np.angle((top * bottom.conj()).sum())


def reference_of(scene):
    """The reference that a scene gave its controller, node by node."""
    controller = scene.controller
    path = controller.law.path
    q = path._coordinates
    nodes = np.stack([controller.plant.to_nodes(each) for each in q], axis=-1)
    return tc.Reference(path._time, nodes)


def test_a_reference_goes_from_shape_to_shape(load):
    scene = load(
        PRISM
        + MPC
        + """max_force_density = 60.0
[[controller.reference]]
time = 1.0
height = 0.9
twist = -0.5
[[controller.reference]]
start = 2.0
time = 3.0
height = 0.95
top = [0, 1, 2]
bottom = [3, 4, 5]
force_density = 20.0
"""
    )
    reference = reference_of(scene)
    at = [np.flatnonzero(np.isclose(reference.time, t)) for t in (0.0, 1.0, 2.0, 3.0)]
    assert [len(each) for each in at] == [1, 1, 1, 1]
    found = height(reference.nodes[:, :, np.concatenate(at)])
    # Laid over the first shape, the others stand a little aslant.
    np.testing.assert_allclose(found, [1.0, 0.9, 0.9, 0.95], atol=1e-3)
    assert twist(reference.nodes[:, :, at[1][0]]) == pytest.approx(-0.5, abs=1e-2)
    for k in at:  # all are in balance
        shape = replace(scene.structure, nodes=reference.nodes[:, :, k[0]])
        assert tc.prestress(shape, 17.0).residual < 1e-7


def test_a_reference_gives_the_places_of_nodes(load):
    turned = tc.prism().nodes.T[[3, 4, 5]].tolist()
    scene = load(
        PRISM
        + MPC
        + f"""max_force_density = 60.0
[[controller.reference]]
time = 1.0
height = 0.9
[[controller.reference]]
time = 2.0
height = 1.0
nodes = [3, 4, 5]
positions = {turned}
"""
    )
    assert height(reference_of(scene).nodes)[-1] == pytest.approx(1.0)


def test_predictive_controllers_of_rest_lengths(load):
    text, given = limits(high=3.0)
    winches = "[winches]\nrate = 0.3\nlongest = 2.0\n"
    scene = load(PRISM + MPC + 'input = "rest_length"\nmax_change = 0.01\n' + text + winches)
    plant, controller = scene.controller.plant, scene.controller
    assert isinstance(controller, tc.MPC)
    assert plant.input == "rest_length"
    assert controller.bounds[1] == pytest.approx(2.0)
    same = tc.MPC(
        plant,
        horizon=5,
        sample_time=0.02,
        max_change=0.01,
        winches=tc.Winches(rate=0.3, longest=2.0),
        **given,
    )
    pushed = plant.to_nodes(0.01 * np.arange(9))
    commands = [each.command(0.0, pushed, np.zeros((3, 6))).value for each in (controller, same)]
    np.testing.assert_array_equal(*commands)
    assert np.abs(commands[0] - plant.rest_length).max() <= 0.3 * 0.02 + 1e-12


def test_motors_of_winches_and_of_cables(load):
    motor = "[winches]\ndrum_radius = {top=0.01,bottom=0.01,vertical=0.02}\ntorque = 2.0\n"
    lqr = LQR + "sample_time = 0.02\n"
    scene = load(PRISM + lqr + 'input = "rest_length"\n' + motor + "speed = 50\nrate = 0.6\n")
    assert scene.winches.largest_rate.tolist() == [0.5] * 6 + [0.6] * 3
    assert scene.simulate().control.motors.torque.shape[0] == 9
    held = PRISM + 'input = "force_density"\n' + lqr + motor
    assert load(held).simulate().control.motors.angle_command is None


@pytest.mark.parametrize(("input", "substeps"), [
    ("force_density", 1), ("rest_length", 1), ("rest_length", 4),
])  # fmt: skip
def test_nmpc_of_a_scene(load, input, substeps):
    limit = "max_force_density = 60.0\n" if input == "force_density" else ""
    winches = f"[winches]\nrate = 0.3\nsubsteps = {substeps}\n"
    scene = load(
        PRISM
        + f"[controller]\nkind = 'nmpc'\ninput = '{input}'\nhorizon = 3\nsample_time = 0.02\n"
        + f"iterations = 2\n{limit}{winches}"
    )
    plant = scene.controller.plant
    given = {"winches": tc.Winches(rate=0.3, substeps=substeps)} if input == "rest_length" else {}
    largest = 60.0 if input == "force_density" else None
    same = tc.NMPC(
        plant, horizon=3, sample_time=0.02, max_force_density=largest, iterations=2, **given
    )
    pushed = plant.to_nodes(0.01 * np.arange(9))
    commands = [e.command(0.0, pushed, np.zeros((3, 6))).value for e in (scene.controller, same)]
    np.testing.assert_array_equal(*commands)
    assert plant.input == input


def test_feedback_linearization_of_a_scene(load):
    scene = load(
        PRISM
        + SHAPE
        + """damping = 0.8
[[controller.reference]]
time = 1.0
height = 0.9
[[controller.tracked]]
node = 0
relative_to = 3
axis = "z"
"""
    )
    law = scene.controller
    omega = 2 * np.pi * 2.0
    assert law.rates == pytest.approx((1.6 * omega, omega**2))
    E, _ = law.error(1.0, scene.structure.nodes, np.zeros((3, 6)))
    np.testing.assert_allclose(E, [0.1])
    E, _ = law.error(0.0, scene.structure.nodes, np.zeros((3, 6)))
    np.testing.assert_allclose(E, [0.0], atol=1e-12)
    assert scene.simulate().control.status_count["ok"] > 0


# ---- broken scenes ----


def changed(old, new):
    assert old in PRISM
    return PRISM.replace(old, new)


LQR = "[controller]\nkind = 'lqr'\n"
MPC = "[controller]\nkind = 'mpc'\nhorizon = 5\nsample_time = 0.02\n"
SHAPE = (
    "[controller]\nkind = 'feedback_linearization'\nsample_time = 0.02\nfrequency = 2.0\n"
    "max_force_density = 60.0\n"
)
AIM = "[[controller.reference]]\n"
SEEN = "[sensors]\nstring_length = 0.001\nbar_direction = 0.01\n[estimator]\nkind = 'kalman'\n"
CUT = "[[faults]]\nkind = 'cut_string'\nstring = 6\ntime = 0.05\n"
BAR = "[structure]\nnodes = [[0,0,0],[1,0,0]]\nbars = [[0,1]]\nstrings = []\nbar_mass = 1\n"
RUN = "[run]\nduration = 1\n"

# Name: text of the file, and what the message says after the name of the file.
BROKEN = {
    "not toml": ("[structure]\nradius 0.5\n", r":2: not TOML: Expected '='"),
    "not closed": ("[structure]\nfixed = [1,\n2", r":3: not TOML: Unclosed array"),
    "key twice": (
        changed("[strings]", "[strings]\nlaw='linear'"),
        r":5: not TOML: Cannot overwrite",
    ),
    "endless number": ("[run]\nduration = " + "9" * 5000, r":2: not TOML: Exceeds the limit"),
    "not text": (b"[structure]\n\n# \xff\n", r":3: not UTF-8 text"),
    "empty": ("", r": the table \[structure\] is missing"),
    "no run": (PRISM.split("[run]")[0], r": the table \[run\] is missing"),
    "unknown table": (
        changed("[strings]", "[string]"),
        r":3: a scene has no table \[string\]; did you mean 'strings'\? The tables are: "
        r"structure, skin",
    ),
    "far table": (PRISM + "[camera]\n", r":11: a scene has no table \[camera\]. The tables are"),
    "value for table": (
        "run = 5\n" + PRISM.split("[run]")[0],
        r":1: run is no table; write \[run\]",
    ),
    "table twice": ("[[run]]\nduration = 1\n" + BAR, r":1: run is no table"),
    "unknown key": (
        changed("stiffness", "stifness"),
        r":5: \[strings\] has no key 'stifness'; did you mean 'stiffness'\? The keys are: law, "
        r"stiffness, damping, per, axial_rigidity",
    ),
    "unit in key": (
        changed("duration", "duration_ms"),
        r":9: \[run\] has no key 'duration_ms'; did you mean 'duration', in s\? Quantities are "
        r"in SI",
    ),
    "unit in value": (
        changed("duration = 0.1", "duration = '0.1 s'"),
        r":9: in \[run\], duration is the text '0.1 s', expected a number in s; quantities are "
        r"in SI",
    ),
    "truth for number": (
        changed("0.1", "true"),
        r":9: in \[run\], duration is true, expected a number in s",
    ),
    "no duration": (
        changed("duration = 0.1\n", ""),
        r":8: \[run\] lacks the key duration: a number in s",
    ),
    "negative duration": (
        changed("0.1", "-1"),
        r":9: in \[run\], duration is -1, expected a positive",
    ),
    "step nan": (
        changed("1e-2", "nan"),
        r":10: in \[run\], step is nan, expected a positive finite",
    ),
    "too large": (changed("100.0", "[1, 1e300]"), r":5: in .*stiffness holds 1e\+300, expected"),
    "too many digits": (changed("0.1", "1" * 400), r":9: in \[run\], duration holds a number of"),
    "half a segment": (
        PRISM + "[subdivide]\nsegments = [1.5]\nnode_mass = 0.1\n",
        r":12: in \[subdivide\], segments\[0\] is 1.5, expected a whole number",
    ),
    "controller step": (
        PRISM + "[controller]\nkind = 'mpc'\nsample_time = 0\n",
        r":13: in \[controller\] .*sample_time is 0, expected a positive",
    ),
    "date": (
        changed("0.1", "2020-01-01"),
        r":9: in \[run\], duration is a date, expected a number",
    ),
    "generator": (
        changed('"prism"', '"prizm"'),
        r":2: in \[structure\], generator is 'prizm'; did you mean 'prism'\?",
    ),
    "nodes beside generator": (
        changed("[strings]", "nodes = []\n[strings]"),
        r":3: \[structure\] with generator = 'prism' has no key 'nodes'",
    ),
    "half a bar": (
        changed('"prism"', '"prism"\nsides = 3.5'),
        r":3: in \[structure\], sides is 3.5, expected a whole number",
    ),
    "two sides": (
        changed('"prism"', '"prism"\nsides = 2'),
        r":3: in .*sides is 2, expected a whole number of at least 3",
    ),
    "bar masses": (
        changed('"prism"', '"prism"\nbar_mass = [1, 2]'),
        r":3: in .*bar_mass has shape \(2,\)",
    ),
    "fixed out of range": (
        changed('"prism"', '"prism"\nfixed = [0,\n 9]'),
        r":3: in .*fixed\[1\] is node 9, expected 0 to 5",
    ),
    "fixed text": (
        changed('"prism"', '"prism"\nfixed = "top"'),
        r":3: in .*fixed is the text 'top', expected a list of node numbers",
    ),
    "empty structure": ("[structure]\n" + RUN, r":1: \[structure\] is empty"),
    "no strings key": (
        BAR.replace("strings = []\n", "") + RUN,
        r":1: \[structure\] without a generator lacks the key strings",
    ),
    "no bar mass": (
        BAR.replace("bar_mass = 1\n", "") + RUN,
        r":1: .*lacks the key bar_mass: .* in kg",
    ),
    "flat node": (
        BAR.replace("[1,0,0]", "[1,0]") + RUN,
        r":2: in .*nodes\[1\] is \[1, 0\], expected 3 coordinates as nodes\[0\] has",
    ),
    "node infinite": (BAR.replace("[1,0,0]", "[inf,0,0]") + RUN, r":2: in .*nodes\[0, 1\] is inf"),
    "triple for bar": (
        BAR.replace("[[0,1]]", "[[0,1,2]]") + RUN,
        r":3: in .*bars\[0\] is \[0, 1, 2\], expected a pair",
    ),
    "bar to nowhere": (BAR.replace("[[0,1]]", "[[0,7]]") + RUN, r":3: in .*bars\[0\] is node 7"),
    "no prestress": (
        PRISM.replace("[prestress]\nforce_density = 17.3205\n", ""),
        r": the table \[prestress\] is missing",
    ),
    "group unknown": (
        changed("17.3205", "{tip = 1, bottom = 1, vertical = 1}"),
        r":7: in \[prestress\], group is 'tip', expected one of 'top', 'bottom', "
        r"'vertical'; did you mean 'top'\?",
    ),
    "group missing": (
        changed("17.3205", "{top = 1, vertical = 1}"),
        r":7: in \[prestress\], force_density lacks the string group 'bottom'",
    ),
    "group text": (
        changed("17.3205", "{top = 'a', bottom=1, vertical = 1}"),
        r":7: in \[prestress\], force_density.top is the text 'a', expected a number in N/m",
    ),
    "count of strings": (
        changed("17.3205", "[1, 2]"),
        r":7: in \[prestress\], force_density has shape \(2,\)",
    ),
    "pushing": (
        changed("17.3205", "{top = -1, bottom=1, vertical = 1}"),
        r":7: in \[prestress\], force_density\[0\] is -1, expected at least 0",
    ),
    "beyond stiffness": (
        changed("17.3205", "90.0"),
        r":7: in \[prestress\], force_density\[6\] is 155.885 N/m, expected less than the "
        r"stiffness",
    ),
    "reference": (
        changed("17.3205", "17.3205\nreference = 'side'"),
        r":8: in \[prestress\], group is 'side'",
    ),
    "reference beside table": (
        changed("17.3205", "{top=1,bottom=1,vertical=1}\nreference = 'top'"),
        r":8: in \[prestress\], reference goes with a single number",
    ),
    "law": (
        changed('"linear"', '"rubber"'),
        r":4: in \[strings\], law is 'rubber'; expected one of 'linear', 'elastic'",
    ),
    "wrong law's key": (
        changed("stiffness", "axial_rigidity"),
        r":5: \[strings\] with law = 'linear' has no key 'axial_rigidity'",
    ),
    "no stiffness": (
        changed("stiffness = 100.0\n", ""),
        r":3: \[strings\] .* lacks the key stiffness: .* in N/m",
    ),
    "stiffness zero": (
        changed("100.0", "0"),
        r":5: in \[strings\] .*stiffness\[0\] is 0, expected a positive",
    ),
    "per": (
        changed("100.0", "100.0\nper = 'segments'"),
        r":6: in \[strings\] .*per is 'segments'; did you mean 'segment'\?",
    ),
    "gravity": (
        PRISM + "[loads]\ngravity = [0, 9.81]\n",
        r":12: in \[loads\], gravity has shape \(2,\), expected \(\) or \(3,\)",
    ),
    "gravity nan": (
        PRISM.replace("17.3205", "{top=1,bottom=1,vertical=1}") + "[loads]\ngravity = nan\n",
        r":12: in \[loads\], gravity is nan",
    ),
    "no force": (
        PRISM + "[loads]\nforces = [{node = 1}]\n",
        r":12: \[loads\] forces\[0\] lacks the key force: \[x, y, z\] \(or \[x, y\]\) in N",
    ),
    "force key": (
        PRISM + "[loads]\nforces = [{node = 1, forse = [0,0,1]}]\n",
        r":12: \[loads\] forces\[0\] has no key 'forse'; did you mean 'force'\?",
    ),
    "force node": (
        PRISM
        + "[[loads.forces]]\nnode = 0\nforce = [0,0,1]\n"
        + "[[loads.forces]]\nnode = 6\nforce = [0,0,1]\n",
        r":15: in \[loads\], forces\[1\] is on node 6, expected 0 to 5",
    ),
    "force twice": (
        PRISM + "[loads]\nforces = [{node = 1, force = [0,0,1]}, {node = 1, force = [0,0,1]}]\n",
        r":12: in \[loads\], forces\[1\] is on node 1 a second time",
    ),
    "segments": (
        PRISM + "[subdivide]\nsegments = 0\nnode_mass = 0.1\n",
        r":12: in \[subdivide\], segments\[0\] is 0, expected a positive",
    ),
    "segments mass": (
        PRISM + "[subdivide]\nsegments = 2\n",
        r":11: in \[subdivide\], found no mass, expected exactly one of node_mass",
    ),
    "no segments": (
        PRISM + "[subdivide]\nnode_mass = 0.1\n",
        r":11: \[subdivide\] lacks the key segments",
    ),
    "weight of segments": (
        PRISM + "[loads]\ngravity = 9.81\n[subdivide]\nsegments = 2\nnode_mass = 0.1\n",
        r":7: in \[prestress\], force_density is a single number, which asks for an "
        r"equilibrium, but",
    ),
    "panel": (
        PRISM + "[skin]\npanels = ['lid']\nnode_mass = 0.1\n",
        r":12: in \[skin\], panels\[0\] is 'lid', expected a name of panels .*'top', 'bottom', "
        r"'sides'",
    ),
    "no panels": (PRISM + "[skin]\nnode_mass = 0.1\n", r":11: \[skin\] lacks the key panels"),
    "velocities": (
        PRISM + "[start]\nvelocities = [[0, 0, 0]]\n",
        r":12: in \[start\], velocities has 1 entries, expected 6",
    ),
    "stretching": (
        PRISM + "[start]\nvelocities = [[1,0,0],[0,0,0],[0,0,0],[0,0,0],[0,0,0],[0,0,0]]\n",
        r":12: in \[start\], velocities stretch bar 0",
    ),
    "fixed moves": (
        BAR + "fixed = [0]\n" + RUN + "[start]\nvelocities = [[0,1,0],[0,1,0]]\n",
        r":10: in \[start\], velocities move the fixed node 0",
    ),
    "disturbance": (
        PRISM + "[start]\ndisturbance = -1\n",
        r":12: in \[start\], disturbance is -1, expected a positive",
    ),
    "nothing to disturb": (
        BAR + "fixed = [0, 1]\n" + RUN + "[start]\ndisturbance = 0.1\n",
        r":10: in \[start\], disturbance moves nothing",
    ),
    "lone seed": (PRISM + "[start]\nseed = 1\n", r":12: in \[start\], seed goes with disturbance"),
    "input": (
        changed("1e-2", "1e-2\ninput = 'restlength'"),
        r":11: in \[run\], input is 'restlength'; did you mean 'rest_length'\?",
    ),
    "input without law": (
        BAR + RUN + "input = 'rest_length'\n",
        r":8: in \[run\], input is 'rest_length', which needs a table \[strings\]",
    ),
    "method": (
        changed("1e-2", "1e-2\nmethod = 'rk5'"),
        r":11: in \[run\], method is 'rk5'; did you mean 'rk4'\?",
    ),
    "method without step": (
        changed("step = 1e-2", "method = 'rk4'"),
        r":10: in \[run\], method is 'rk4', which needs step",
    ),
    "step without method": (
        changed("1e-2", "1e-2\nmethod = 'dop853'"),
        r":10: in \[run\], 'dop853' takes tolerance, not step",
    ),
    "step and tolerance": (
        changed("1e-2", "1e-2\ntolerance = 1e-8"),
        r":11: in \[run\], expected one of step",
    ),
    "controller": (
        PRISM + "[controller]\nkind = 'pid'\n",
        r":12: in \[controller\], kind is 'pid'; expected one of 'lqr', 'mpc'",
    ),
    "controller kind": (
        PRISM + "[controller]\nhorizon = 5\n",
        r":11: \[controller\] lacks the key kind",
    ),
    "lqr horizon": (
        PRISM + LQR + "horizon = 5\n",
        r":13: \[controller\] with kind = 'lqr' has no key 'horizon'",
    ),
    "lqr not at rest": (
        PRISM.replace("17.3205", "{top=1,bottom=1,vertical=1}") + LQR,
        r":7: in \[prestress\], for a controller force_density does not balance",
    ),
    "lqr weight": (PRISM + LQR + "R = -1.0\n", r":13: in \[controller\] .*R has the eigenvalue -1"),
    "lqr cross weight": (
        PRISM + LQR + "N = [[1.0]]\n",
        r":13: in .*N has shape \(1, 1\), expected",
    ),
    "rows of a weight": (PRISM + LQR + "N = [1.0]\n", r":13: in .*N\[0\] is 1, expected a row of"),
    "mpc terminal weight": (
        PRISM + MPC + "terminal_weight = -1.0\n",
        r":15: in \[controller\] .*terminal_weight has the eigenvalue -1",
    ),
    "lqr no sample": (
        changed("step = 1e-2", "") + LQR,
        r":11: \[controller\] lacks the key sample_time, s, and \[run\] has no sample_time or step",
    ),
    "lqr both samples": (
        changed("1e-2", "1e-2\nsample_time = 0.01") + LQR + "sample_time = 0.01\n",
        r":11: in \[run\], sample_time is that of a law in continuous time, but \[controller\]",
    ),
    "sample time alone": (
        changed("1e-2", "1e-2\nsample_time = 0.01"),
        r":11: in \[run\], sample_time goes with a table \[controller\]",
    ),
    "sample time negative": (
        changed("1e-2", "1e-2\nsample_time = -1") + LQR,
        r":11: in \[run\], sample_time is -1, expected a positive",
    ),
    "renamed step": (
        PRISM + LQR + "step = 0.01\n",
        r":13: \[controller\] has no key 'step' any more; write sample_time",
    ),
    "renamed hold": (
        changed("1e-2", "1e-2\nhold = 'force_density'"),
        r":11: \[run\] has no key 'hold' any more; write input",
    ),
    "renamed pieces": (
        PRISM + LQR + "[winches]\npieces = 4\n",
        r":14: \[winches\] has no key 'pieces' any more; write substeps",
    ),
    "renamed kind": (
        PRISM + "[controller]\nkind = 'shape_control'\n",
        r":12: in \[controller\], kind is 'shape_control', which is now called "
        r"'feedback_linearization'",
    ),
    "lqr input": (
        changed("1e-2", "1e-2\ninput = 'force_density'") + LQR + "input = 'rest_length'\n",
        r":14: in \[controller\], input is 'rest_length', but \[run\] holds force_density",
    ),
    "mpc limit low": (
        PRISM + MPC + "max_force_density = 20\n",
        r":15: in \[controller\] .*max_force_density\[6\] is 20 N/m, but string 6 has 30",
    ),
    "feedback linearization frequency missing": (
        PRISM + SHAPE.replace("frequency = 2.0\n", ""),
        r":11: \[controller\] with kind = 'feedback_linearization' lacks the key frequency: .*Hz",
    ),
    "feedback linearization too fast": (
        PRISM + SHAPE.replace("2.0", "20.0"),
        r":14: in \[controller\] .*frequency 20 Hz .* the error would grow",
    ),
    "feedback linearization of rest lengths": (
        PRISM + SHAPE + "input = 'rest_length'\n",
        r":11: in \[controller\] .*plant has input='rest_length'",
    ),
    "lqr reference": (
        PRISM + LQR + AIM + "time = 1.0\nheight = 0.9\n",
        r":13: \[controller\] with kind = 'lqr' has no key 'reference'",
    ),
    "reference no list": (
        PRISM + SHAPE + "[controller.reference]\ntime = 1.0\n",
        r":16: in \[controller\].*reference is a table, expected a list of tables",
    ),
    "reference empty": (
        PRISM + SHAPE + "reference = []\n",
        r":16: in \[controller\] .*reference is empty",
    ),
    "reference key": (
        PRISM + SHAPE + AIM + "time = 1.0\nheigth = 0.9\n",
        r":18: \[\[controller\.reference\]\] number 1 has no key 'heigth'; did you mean 'height'",
    ),
    "reference without time": (
        PRISM + SHAPE + AIM + "height = 0.9\n",
        r":16: \[\[controller\.reference\]\] number 1 lacks the key time: a number in s",
    ),
    "reference without shape": (
        PRISM + SHAPE + AIM + "time = 1.0\n",
        r":16: .* number 1 asks for no shape: give height, twist, or nodes and positions",
    ),
    "reference times": (
        PRISM + SHAPE + AIM + "time = 1.0\nheight = 0.9\n" + AIM + "time = 1.0\nheight = 0.8\n",
        r":20: .* number 2, time is 1 s, expected more than 1 s",
    ),
    "reference start": (
        PRISM + SHAPE + AIM + "start = -1.0\ntime = 1.0\nheight = 0.9\n",
        r":17: .*start\[0\] is -1, expected at least 0",
    ),
    "reference early": (
        PRISM
        + SHAPE
        + AIM
        + "time = 1.0\nheight = 0.9\n"
        + AIM
        + "start = 0.5\ntime = 2.0\nheight = 0.8\n",
        r":20: .*start is 0\.5 s, expected at least 1 s",
    ),
    "reference out of reach": (
        PRISM + SHAPE + AIM + "time = 1.0\nheight = 5.0\n",
        r":17: in .* number 1, no equilibrium.*height",
    ),
    "reference too soon": (
        PRISM + SHAPE + AIM + "time = 0.1\nheight = 0.8\n[winches]\nrate = 0.1\n",
        r":17: in .* number 1, duration is 0\.1 s, expected at least .* winches",
    ),
    "tracked node": (
        PRISM + SHAPE + "tracked = [{node = 6, axis = 'x'}]\n",
        r":16: .* number 1, node is 6, expected 0 to 5",
    ),
    "tracked axis": (
        PRISM + SHAPE + "[[controller.tracked]]\nnode = 1\naxis = 'w'\n",
        r":18: .*axis is 'w'; expected one of 'x', 'y', 'z'",
    ),
    "tracked itself": (
        PRISM + SHAPE + "[[controller.tracked]]\nnode = 1\naxis = 'x'\nrelative_to = 1\n",
        r":19: .*relative_to is node itself",
    ),
    "output without limit": (
        PRISM + MPC + "max_force_density = 60\n[[controller.outputs]]\nnode = 1\naxis = 'x'\n",
        r":16: \[\[controller\.outputs\]\] number 1 has no limit",
    ),
    "output limits cross": (
        PRISM + MPC + "max_force_density = 60\n[[controller.outputs]]\nnode = 1\naxis = 'x'\n"
        "low = 1.0\nhigh = 0.0\n",
        r":19: .*low",
    ),
    "winches alone": (
        PRISM + "[winches]\nrate = 1\n",
        r":11: \[winches\] goes with a table \[controller\]",
    ),
    "motor without a drum": (
        PRISM + LQR + "[winches]\ntorque = 1.0\n",
        r":13: \[winches\] lacks the key drum_radius",
    ),
    "motor of no size": (
        PRISM + LQR + "[winches]\ndrum_radius = 0.0\n",
        r":\d+: in \[winches\], drum_radius\[0\] is 0, expected a positive",
    ),
    "motor of a cable with a lag": (
        changed("1e-2", "1e-2\ninput = 'force_density'")
        + LQR
        + "[winches]\ndrum_radius = 0.01\nlag = 0.1\n",
        r":14: \[winches\] limits rest lengths",
    ),
    "winches and force": (
        changed("1e-2", "1e-2\ninput = 'force_density'") + LQR + "[winches]\nrate = 1\n",
        r":14: \[winches\] limits rest lengths",
    ),
    "mpc time limit": (
        PRISM + MPC + "max_force_density = 60\ntime_limit = 0.0\n",
        r":16: in \[controller\] .*time_limit is 0.*expected a positive",
    ),
    "lqr change": (
        PRISM + LQR + "max_change = -1.0\n",
        r":13: in \[controller\] .*max_change\[0\] is -1",
    ),
    "nmpc gain": (
        PRISM + MPC.replace("mpc", "nmpc") + "max_force_density = 60\nload_gain = 2.0\n",
        r":16: in \[controller\] .*load_gain",
    ),
    "lqr time limit": (
        PRISM + LQR + "time_limit = 0.1\n",
        r":13: \[controller\] with kind = 'lqr' has no key 'time_limit'",
    ),
    "ramp": (
        PRISM + LQR + "[winches]\nramp = 4\n",
        r":14: in \[winches\], ramp is 4, expected true or false",
    ),
    "ramp without substeps": (
        PRISM + LQR + "[winches]\nramp = true\nsubsteps = 1\n",
        r":15: in \[winches\], substeps is 1, expected at least 2 for a ramp",
    ),
    "substeps": (
        PRISM + LQR + "[winches]\nsubsteps = 0\n",
        r":14: in \[winches\], substeps is 0, expected a whole number of at least 1",
    ),
    "sensors alone": (
        PRISM + LQR + "[sensors]\nstring_length = 0.001\n",
        r":13: \[sensors\] goes with a table \[estimator\]",
    ),
    "estimator alone": (
        PRISM + LQR + "[estimator]\nkind = 'kalman'\n",
        r":13: \[estimator\] goes with a table \[sensors\]",
    ),
    "estimator in open loop": (
        PRISM + SEEN,
        r":11: \[sensors\] goes with a table \[controller\]",
    ),
    "estimator kind": (
        PRISM + LQR + SEEN.replace("kalman", "kalmann"),
        r":17: in \[estimator\], kind is 'kalmann'; did you mean 'kalman'\?",
    ),
    "estimator without kind": (
        PRISM + LQR + SEEN.replace("kind = 'kalman'\n", "gate = 0.01\n"),
        r":16: \[estimator\] lacks the key kind",
    ),
    "estimator key": (
        PRISM + LQR + SEEN + "step = 0.02\n",
        r":18: \[estimator\] has no key 'step'",
    ),
    "estimator gate": (PRISM + LQR + SEEN + "gate = 2\n", r":18: in \[estimator\], gate is 2"),
    "sensor key": (
        PRISM + LQR + SEEN.replace("bar_direction", "bar_directions"),
        r":15: \[sensors\] has no key 'bar_directions'; did you mean 'bar_direction'",
    ),
    "sensor noise": (
        PRISM + LQR + SEEN.replace("0.001", "0"),
        r":14: in \[sensors\], string_length\[0\] is 0, expected a positive",
    ),
    "sensor of no bar": (
        PRISM + LQR + SEEN.replace("[estimator]", "bars = [3]\n[estimator]"),
        r":16: in \[sensors\], bars\[0\] is 3, expected 0 to 2",
    ),
    "sensor seed": (
        PRISM + LQR + SEEN.replace("[estimator]", "seed = -1\n[estimator]"),
        r":16: in \[sensors\], seed is -1, expected a whole number of at least 0",
    ),
    "seen too little": (
        PRISM + LQR + "[sensors]\nstring_length=0.001\nstrings=[0]\n[estimator]\nkind='kalman'\n",
        r":16: in \[estimator\], .*of the 18 states are not observable",
    ),
    "faults no list": (
        PRISM + "[faults]\nkind = 'cut_string'\n",
        r":11: faults is no list of tables",
    ),
    "faults of numbers": ("faults = [1]\n" + PRISM, r":1: faults is no list of tables; write"),
    "fault kind": (
        PRISM + "[[faults]]\nkind = 'cut_strings'\n",
        r":12: in \[\[faults\]\] number 1, kind is 'cut_strings'; did you mean 'cut_string'\?",
    ),
    "fault without kind": (
        PRISM + "[[faults]]\ntime = 1.0\n",
        r":11: \[\[faults\]\] number 1 lacks the key kind",
    ),
    "fault key": (
        PRISM + CUT + "until = 1.0\n",
        r":15: \[\[faults\]\] number 1 with kind = 'cut_string' has no key 'until'",
    ),
    "fault without time": (
        PRISM + CUT.replace("time = 0.05\n", ""),
        r":11: .* number 1 .*lacks the key time: a number in s",
    ),
    "fault time": (
        PRISM + CUT.replace("0.05", "-1.0"),
        r":14: .*number 1.*time is -1.* at least 0",
    ),
    "fault string": (
        PRISM + CUT + CUT.replace("6", "9"),
        r":17: .*number 2 .*string is 9, expected 0 to 8: there are 9 strings",
    ),
    "fault winch": (
        PRISM + LQR + CUT.replace("cut_string", "stuck_winch").replace("6", "-1"),
        r":15: .*number 1 .*string is -1, expected 0 to 8: there are 9 winches",
    ),
    "fault in open loop": (
        PRISM + "[[faults]]\nkind = 'lost_measurement'\ntime = 0.0\nuntil = 1.0\n",
        r":12: .* number 1 .* goes with a table \[controller\]",
    ),
    "fault over before": (
        PRISM + LQR + "[[faults]]\nkind = 'lost_measurement'\ntime = 1.0\nuntil = 1.0\n",
        r":16: .*number 1 .*until is 1 s, expected after time",
    ),
    "winch rate": (
        PRISM + LQR + "[winches]\nrate = 0\n",
        r":14: in \[winches\], rate\[0\] is 0, expected a positive",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_scenes_are_refused_by_line_and_name(load, name):
    text, message = BROKEN[name]
    with pytest.raises(SceneError, match=r"scene\.toml" + f"({message})"):
        load(text)


def test_no_broken_scene_is_like_another():
    assert len(BROKEN) > 60
    assert len({str(text) for text, _ in BROKEN.values()}) == len(BROKEN)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(SceneError, match=r"none\.toml: cannot be read: No such file"):
        tc.load_scene(tmp_path / "none.toml")
    with pytest.raises(SceneError, match="cannot be read"):
        tc.load_scene(tmp_path)
    with pytest.raises(TypeError, match="file is a int, expected a path"):
        tc.load_scene(5)


def test_a_solver_that_fails_is_told_by_line(load, monkeypatch):
    def failing(*_, **__):
        raise ArithmeticError("the linear program of the prestress failed")

    monkeypatch.setattr(sys.modules["tenscontrol.scene.structure_tables"], "prestress", failing)
    with pytest.raises(SceneError, match=r"scene\.toml:7: in \[prestress\], the linear program"):
        load(PRISM)


# ---- files that are no scenes ----


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders here")
def test_a_pipe_and_a_device_are_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    for file in (tmp_path / "pipe.toml", "/dev/zero"):
        with pytest.raises(SceneError, match="cannot be read: it is a pipe or a device, exp"):
            tc.load_scene(file)


def test_a_name_that_no_file_has():
    with pytest.raises(SceneError, match=r"cannot be read: .*embedded null"):
        tc.load_scene("a\0b.toml")


def test_a_file_beside_the_caller_is_named_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_bytes(b"\n\xff")
    with pytest.raises(SceneError, match=r"^scene\.toml:2: not UTF-8 text"):
        tc.load_scene("./scene.toml")


def test_a_mark_of_the_byte_order_is_left_out(load):
    assert load(b"\xef\xbb\xbf" + PRISM.encode()).duration == 0.1


MANY = "a scene file has at most 100,000 keys and tables, 250,000 lists and 16 levels"
TOO_MUCH = {
    "bytes": (
        "#" * 10_000_001,
        r": cannot be read: it is too large: 10,000,001 bytes, at most 10,000,000 are read; "
        + MANY,
    ),
    "parts": ("\n" + "a." * 100_000 + "b = 1", r":2: exceeds the limits: " + MANY),
    "parts of a heading": ("[" + "a." * 100_000 + "b]", r":1: exceeds"),
    "parts without an end": ("[" + "a." * 100_000, r":1: exceeds"),
    "parts in a table": (
        "x = {y = 1.5, " + "a . 'b'." * 50_000 + "b = 1}",
        r":1: exceeds",
    ),
    "keys": ("".join(f"k{i} = {i}\n" for i in range(200_000)), r":100001: exceeds"),
    "tables": ("".join(f"[t{i}]\n" for i in range(200_000)), r":100001: exceeds"),
    "tables in a list": ("a = [" + "{}," * 200_000 + "]", r":1: exceeds"),
    "lists": ("a = [" + "[]," * 300_000 + "]", r":1: exceeds"),
    "nested lists": ("\n\na = " + "[" * 10_000 + "]" * 10_000, r":3: exceeds"),
    "nested tables": ("a = " + "{a = " * 10_000 + "1" + "}" * 10_000, r":1: exceeds"),
    "quotes": ('\\"' * 500_000, r":1: not TOML"),
    "open text": ('a = """' + "\\\\" * 500_000, r":1: not TOML: Unterminated"),
    "nul": ("[run]\n\0", r":2: not TOML"),
    "utf-16": (PRISM.encode("utf-16"), r":1: not UTF-8 text"),
    "date": (PRISM.replace("0.1", "1979-05-27"), r":9: .*duration is a date, expected a number"),
    "1e999": (PRISM.replace("0.1", "1e999"), r":9: .*duration is inf, expected a positive"),
    "400 digits": (
        PRISM.replace("0.1", "1" + "0" * 400),
        r":9: .*a number of more than 20 digits",
    ),
    "long key": (PRISM + "k" * 100_000 + " = 1", r":11: \[run\] has no key 'k{60}'\. The keys are"),
    "long table": ("[" + "k" * 100_000 + "]", r":1: a scene has no table \[k{60}\]\. The tables"),
    "other script": (PRISM + "ʎ = 1", r":11: not TOML"),
    "other script quoted": (PRISM + "'ключ' = 1", r":11: \[run\] has no key 'ключ'"),
    "twice": (PRISM + "step = 1", r":11: not TOML: Cannot overwrite a value"),
}


@pytest.mark.parametrize("name", TOO_MUCH)
def test_files_that_ask_for_too_much_are_refused(load, name):
    text, message = TOO_MUCH[name]
    with pytest.raises(SceneError, match=r"scene\.toml" + message) as raised:
        load(text)
    assert len(str(raised.value)) < 1000


def test_points_in_texts_and_numbers_are_not_parts_of_keys(load):
    numbers = f"[{', '.join(['1.5'] * 50)}]"
    dots = "." * 99
    text = f"x = {numbers}\ny = ['{dots}', '{dots}']  # {dots}\nz = "
    text += f"{{a = 1.5, b.c = '{dots}', e = 1}}\n"
    with pytest.raises(SceneError, match=r"scene\.toml:11: \[run\] has no key 'x'"):
        load(PRISM + text)


# ---- lines ----

TOML = TomlLimits("a test", keys=100_000, lists=100_000, levels=16)

TRICKY = '''\
# [not.a.table]
top = 1
[ "a b" . c ] # a comment with ] and "
"x = y" = "= \\" [" # quoted
z.w = [
  { k = "]" }, # ]
  2,
]
long = """
[not]
key = 1 \\"""
""""
raw = \'\'\'
no = 1
\'\'\'
[[list]]
one = 1
[[list]]
one = 2
[list.inner]
deep = 1
'''


def test_lines_of_keys_are_found_in_any_toml():
    values = tomllib.loads(TRICKY)
    lines = key_lines(headings("scene.toml", TRICKY, TOML))
    assert {path: line for path, line in lines.items() if path[0] == "list"} == {
        ("list",): 16,
        ("list", 0): 16,
        ("list", 0, "one"): 17,
        ("list", 1): 18,
        ("list", 1, "one"): 19,
        ("list", 1, "inner"): 20,
        ("list", 1, "inner", "deep"): 21,
    }
    inner = {path[2:]: line for path, line in lines.items() if path[:2] == ("a b", "c")}
    assert inner == {(): 3, ("x = y",): 4, ("z",): 5, ("z", "w"): 5, ("long",): 9, ("raw",): 13}
    assert lines["top",] == 2
    assert set(values) == {path[0] for path in lines}


def test_windows_line_ends_count_once(load):
    with pytest.raises(SceneError, match=":9: "):
        load(changed("0.1", "-1").replace("\n", "\r\n"))


class CountedText(str):
    """A text that counts the characters that are read of it by slices and searches."""

    read = 0

    def __getitem__(self, key):
        found = super().__getitem__(key)
        self.read += len(found)
        return found

    def count(self, sub, start=0, end=None):
        end = len(self) if end is None else end
        self.read += end - start
        return super().count(sub, start, end)

    def find(self, sub, start=0, end=None):
        found = super().find(sub, start, len(self) if end is None else end)
        self.read += (found if found >= 0 else len(self)) - start
        return found


def test_lines_are_found_in_work_that_grows_as_the_file(monkeypatch):
    """Ten times as many keys take ten times as much, not a hundred times."""
    work = []
    for count in (2_000, 20_000):
        text = CountedText("".join(f"key{i:05d} = [1, 2]\n" for i in range(count)))
        passes, tokens = 0, parsing._TOKEN

        class Counted:
            def finditer(self, text, tokens=tokens):
                nonlocal passes
                passes += 1
                return tokens.finditer(text)

        monkeypatch.setattr(parsing, "_TOKEN", Counted())
        lines = key_lines(headings("scene.toml", text, TOML))
        monkeypatch.undo()
        assert lines[f"key{count - 1:05d}",] == count
        assert passes == 1
        work.append(text.read / len(text))
    assert work[0] < 3
    assert work[1] == pytest.approx(work[0])


def test_every_argument_of_a_class_is_a_key_or_comes_from_elsewhere():
    assert "sample_time" in schema.CONTROLLER_KEYS["lqr"]
    for kind, make in (schema.CONTROLLERS | schema.FAULTS).items():
        keys = (schema.CONTROLLER_KEYS | schema.FAULT_KEYS)[kind]
        assert set(signature(make).parameters) - set(keys) <= {"plant", "winches", "machine_code"}
