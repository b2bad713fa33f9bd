"""Scenes some of whose strings are driven: what the file says is what Python is given."""

import numpy as np
import pytest

import tenscontrol as tc

pytestmark = pytest.mark.filterwarnings("ignore:no string reaches 1 mode")

BALL = """\
[structure]
generator = "six_bar_ball"
[strings]
law = "linear"
stiffness = 1000.0
damping = 10.0
[prestress]
min_force_density = 20.0
[start]
disturbance = 0.01
[run]
duration = 0.2
step = 2e-3
[controller]
input = "rest_length"
sample_time = 0.02
"""
LQR, MPC = "kind = 'lqr'\n", "kind = 'mpc'\nhorizon = 5\nmax_force_density = 200.0\n"
FILTER = "[sensors]\nnode_position = 1e-3\n[estimator]\nkind = 'kalman'\n"
STUCK = "[[faults]]\nkind = 'stuck_winch'\nstring = {}\ntime = 0.1\n"

TWELVE = list(range(0, 24, 2))
PAIRS = {f"motor_{k}": {4 * k: 1.0, 4 * k + 2: -0.5} for k in range(6)}
WRITTEN = ", ".join(f"motor_{k} = {{{4 * k} = 1.0, {4 * k + 2} = -0.5}}" for k in range(6))
LAYOUTS = {"twelve": (f"actuated = {TWELVE}\n", TWELVE),
           "pairs": (f"actuated = {{{WRITTEN}}}\n", PAIRS)}  # fmt: skip


def in_python(scene, actuated):
    rest = tc.prestress(scene.structure, scene.prestress)
    return tc.linearize(scene.model, rest, input="rest_length", actuated=actuated)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("kind", [LQR, MPC])
def test_a_file_drives_the_strings_that_python_drives(load, layout, kind):
    written, actuated = LAYOUTS[layout]
    scene = load(BALL + kind + written + FILTER)
    plant = in_python(scene, actuated)
    np.testing.assert_array_equal(scene.controller.plant.B, plant.B)
    assert scene.estimator.plant.actuation.lead.tolist() == plant.actuation.lead.tolist()
    assert scene.linearize().actuation.names == plant.actuation.names
    assert scene.linearize("force_density").actuation.is_whole
    run, passive = scene.simulate(), plant.actuation.passive
    assert len(passive) == 12
    np.testing.assert_array_equal(np.ptp(run.rest_length[passive], axis=1), 0.0)
    assert np.ptp(run.rest_length[plant.actuation.driven], axis=1).min() > 1e-6
    law = tc.LQR if kind == LQR else tc.MPC
    given = {} if kind == LQR else {"horizon": 5, "max_force_density": 200.0}
    own = law(plant, sample_time=0.02, **given)
    still = np.zeros_like(scene.nodes)
    scene.controller.reset()
    first, other = (each.command(0.0, scene.nodes, still) for each in (scene.controller, own))
    np.testing.assert_array_equal(first.value, other.value)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_winch_sticks_with_all_its_strings_and_a_passive_string_is_cut(load, layout):
    cut = "[[faults]]\nkind = 'cut_string'\nstring = 1\ntime = 0.06\n"
    run = load(BALL + LQR + LAYOUTS[layout][0] + STUCK.format(6) + cut).simulate()
    late, still = run.control.time >= 0.1 - 1e-9, [6] if layout == "twelve" else [4, 6]
    applied = run.control.applied
    assert (np.ptp(applied[:, late], axis=1)[still] == 0).all()
    assert np.ptp(applied[8, late]) > 0
    assert np.ptp(applied[6, ~late]) > 0
    assert np.ptp(applied[1]) == 0
    assert (run.force_density[1, run.time > 0.061] == 0).all()


def test_a_winch_of_a_passive_string_cannot_stick(load):
    match = r"scene.toml:21: in \[\[faults\]\] number 1 .* string is of string 7, which no winch"
    with pytest.raises(ValueError, match=match):
        load(BALL + LQR + LAYOUTS["twelve"][0] + STUCK.format(7))


PRISM = BALL.replace("six_bar_ball", "prism")


@pytest.mark.parametrize(
    ("written", "match"),
    [
        ("actuatd = [0]", r"has no key 'actuatd'; did you mean 'actuated'\?"),
        ("actuated = 3", "actuated is 3, expected a list of indices and string groups, or a table"),
        ("actuated = [0, 9]", r"in \[controller\] .*actuated\[1\] is 9, expected 0 to 8"),
        ("actuated = ['tops']", r"actuated\[0\] is 'tops', expected one of 'top'"),
        ("actuated = {a = [true]}", "expected an index, a string group or a ratio"),
        ("actuated = {a = {0 = -1.0}}", "has no string with a positive ratio"),
        ("actuated = {a = [0], b = ['top']}", "has string 0, which another winch drives"),
        ("actuated = {a = true}", r"actuated.a is true, expected an index, a string group, a list"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_its_line(load, written, match):
    with pytest.raises(ValueError, match=rf"scene.toml:18: .*{match}"):
        load(PRISM + LQR + written)


def test_groups_and_single_strings_are_written_plainly(load):
    for written, names in (
        ("'vertical'", ("vertical[0]", "vertical[1]", "vertical[2]")),
        ("['vertical', 0]", ("vertical[0]", "vertical[1]", "vertical[2]", "top[0]")),
        ("{lid = 'top', side = 6}", ("lid", "side")),
    ):
        plant = load(PRISM + LQR + f"actuated = {written}\n").controller.plant
        assert plant.input_names == [f"rest_length_{name}" for name in names]


def test_a_shape_is_one_that_passive_strings_hold(load):
    prism = tc.prism()
    place = np.round(prism.nodes[:, 0] + [0.0, 0.0, -0.02], 6).tolist()
    table = f"[[controller.reference]]\ntime = 0.1\nnodes = [0]\npositions = [{place}]\n"
    text = PRISM + MPC.replace("max_force_density = 200.0\n", "")
    scene = load(text + "actuated = ['vertical', 'top']\n" + table)
    model, rest = scene.model, tc.prestress(prism, scene.prestress)
    plant = in_python(scene, ["vertical", "top"])
    goal = tc.shape_target(
        model, tc.NodesAt([0], np.array(place)[:, None]), prestress="least", plant=plant
    )
    springs = plant.actuation.passive
    np.testing.assert_allclose(goal.rest_length[springs], plant.rest_length[springs], atol=1e-9)
    assert np.abs(goal.rest_length - plant.rest_length).max() > 1e-3
    path = tc.shape_path(model, rest, goal, duration=0.1, step=0.02, plant=plant)
    own = tc.MPC(plant, horizon=5, sample_time=0.02, reference=path.reference())
    values = [
        law.command(0.0, scene.nodes, np.zeros_like(scene.nodes)).value
        for law in (scene.controller, own)
    ]
    np.testing.assert_allclose(values[0], values[1], rtol=0, atol=1e-9)


def test_code_of_ones_own_commands_what_is_driven(tmp_path):
    (tmp_path / "laws.py").write_text(
        "def law(time, nodes, velocities):\n    return [0.5, 0.6]\n"
        "def made(plant):\n"
        "    assert len(plant.actuation.lead) == 2\n"
        "    return law\n"
    )
    for key, name in (("function", "law"), ("factory", "made")):
        text = PRISM + f"kind = 'python'\n{key} = 'laws.py:{name}'\nactuated = [6, 7]\n"
        file = tmp_path / "own.toml"
        file.write_text(text)
        scene = tc.load_scene(file, allow_code=True)
        run = scene.simulate()
        assert run.control.applied[[6, 7], -1].tolist() == [0.5, 0.6]
        assert np.ptp(run.control.applied[:6], axis=1).max() == 0
