"""Tables of scenes that do nothing, and numbers in another form."""

import numpy as np
import pytest

import tenscontrol as tc

BAR = """
[structure]
nodes = [[0, 0], [1, 0]]
bars = [[0, 1]]
strings = []
bar_mass = 1.0
fixed = [0.0, 0, [0, "x"]]
[run]
duration = 0.1
step = 1e-2
[loads]
gravity = 9.81
"""
PRISM = """
[structure]
generator = "prism"
sides = 3.0
point_mass = 0.1
[strings]
law = "linear"
stiffness = 100.0
[prestress]
force_density = 17.0
[run]
duration = 0.1
"""


def scene(tmp_path, text):
    file = tmp_path / "scene.toml"
    file.write_text(text)
    return tc.load_scene(file)


@pytest.mark.parametrize(
    "more",
    [
        "",
        "[strings]\nlaw = 'linear'\nstiffness = 100.0\n",
        "[strings]\nlaw = 'linear'\nstiffness = []\n",
        "[prestress]\nforce_density = []\n",
    ],
)
def test_tables_of_strings_where_there_are_none_do_nothing(more, tmp_path):
    known = scene(tmp_path, BAR).simulate().nodes
    found = scene(tmp_path, BAR + more)
    assert found.structure.fixed.tolist() == [0]
    np.testing.assert_allclose(found.simulate().nodes, known, atol=1e-9)
    assert known[1, 1, -1] == pytest.approx(-0.75 * 9.81 * 0.01, rel=1e-2)  # 3 g/2 t²/2


def test_one_point_mass_and_whole_floats(tmp_path):
    found = scene(tmp_path, PRISM)
    np.testing.assert_array_equal(found.structure.point_mass, np.full(6, 0.1))


def test_ground_of_no_nodes_and_of_nodes_named_twice(tmp_path):
    ground = "[loads]\ngravity = 9.81\n[[ground]]\nstiffness = 1e4\nnodes = "
    free, known, twice = (
        scene(tmp_path, PRISM + ground + nodes).simulate().nodes[2, 3, -1]
        for nodes in ("[]", "[3]", "[3, 3]")
    )
    assert free < -0.04
    assert twice == known > -0.02


def test_infinite_limits_and_whole_floats_of_controllers(tmp_path):
    text = PRISM + "[controller]\nkind = 'mpc'\nsample_time = 0.02\nhorizon = 5.0\n"
    text += "max_force_density = inf\n[[controller.outputs]]\nnode = 3.0\naxis = 'z'\nlow = -0.5\n"
    text += "[winches]\nrate = inf\nlongest = [{}]\n".format(", ".join(["inf"] * 8 + ["9.0"]))
    found = scene(tmp_path, text)
    assert found.winches.rate is None
    assert found.winches.longest[8] == 9.0
    assert found.controller.horizon == 5
