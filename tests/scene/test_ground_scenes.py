"""Scenes with ground: what its tables give, and what is said of broken ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.scene import SceneError

SCENES = Path(__file__).parent.parent.parent / "examples" / "scenes"
DROP = """\
[structure]
generator = "six_bar_ball"
[strings]
law = "linear"
stiffness = 500.0
[loads]
gravity = 9.81
[prestress]
force_density = 30.0
[run]
duration = 0.05
step = 1e-3
"""
# A bar between two supports, one above the other.
HUNG = DROP.replace(
    'generator = "six_bar_ball"',
    """nodes = [[0.0, 0, 1], [0, 0, 0], [0, 0, -1], [0, 0, -2]]
bars = [[1, 2]]
strings = [[0, 1], [2, 3]]
bar_mass = 1.0
fixed = [0, 3]""",
)
FLAT = "[ground]\nstiffness = 5e3\n"


def same_law(one, other):
    assert type(one) is type(other)
    assert vars(one).keys() == vars(other).keys()
    for name, value in vars(one).items():
        np.testing.assert_array_equal(value, getattr(other, name))


def test_values_come_through(load):
    every = """\
[[ground]]
stiffness = 5e3
damping = 0.3
friction = 0.5
slip_speed = 0.02
normal = [0.1, 0.0, 1.0]
height = -0.8
nodes = [0, 3]
[[ground]]
kind = "hertz"
stiffness = 1e5
[[ground]]
kind = "smooth"
stiffness = 100
width = 0.02
"""
    scene = load(DROP + every)
    expected = (
        tc.Ground(5e3, 0.3, 0.5, 0.02, normal=[0.1, 0, 1], height=-0.8, nodes=[0, 3]),
        tc.dynamics.HertzGround(1e5),
        tc.dynamics.SmoothGround(100, width=0.02),
    )
    assert len(scene.model.ground) == 3
    for one, other in zip(scene.model.ground, expected, strict=True):
        same_law(one, other)
    (one,) = load(DROP + FLAT).model.ground
    same_law(one, tc.Ground(5e3))
    assert load(DROP.replace("gravity = 9.81", "")).model.ground == ()
    assert tc.Scene(scene.model, 0.05, rest_length=scene.rest_length) is not None


def test_the_shipped_drop_bounces_on_the_floor_and_off_the_wall():
    scene = replace(tc.load_scene(SCENES / "ball_drop.toml"), duration=1.0)
    run = scene.simulate()
    lowest, farthest = run.nodes[2].min(), run.nodes[0].max()
    assert -0.83 < lowest < -0.805
    assert 1.005 < farthest < 1.03
    assert run.nodes[0].mean(axis=0).argmax() < 100  # it comes back from the wall
    assert run.health.work.missed == 0
    floor, wall = scene.model.ground
    model = tc.Model(
        scene.structure, strings=scene.model.strings, gravity=9.81, ground=[floor, wall]
    )
    same = tc.simulate(
        model, 1.0, velocities=scene.velocities, rest_length=scene.rest_length, tolerance=1e-6,
        output_step=0.01,
    )  # fmt: skip
    np.testing.assert_array_equal(same.nodes, run.nodes)


def test_prestress_is_before_weights_where_only_the_ground_holds_them(load):
    falling = load(DROP + FLAT)
    free = load(DROP.replace("gravity = 9.81", ""))
    np.testing.assert_array_equal(falling.prestress, free.prestress)
    np.testing.assert_array_equal(falling.rest_length, free.rest_length)
    # Supports hold the weights: the balance is with them, though there is ground.
    standing, beside = load(HUNG), load(HUNG + FLAT)
    np.testing.assert_allclose(np.diff(standing.prestress), -9.81, rtol=1e-9)
    np.testing.assert_array_equal(standing.prestress, beside.prestress)


@pytest.mark.filterwarnings("ignore:no string reaches")
def test_a_controller_is_designed_beside_the_ground(load):
    control = '[controller]\nkind = "lqr"\nsample_time = 0.01\nmax_force_density = 200.0\n'
    below = "[ground]\nstiffness = 5e3\nheight = -5.0\n"
    cut = "[subdivide]\nsegments = 2\nstring_mass = 0.01\n"
    some = "nodes = [1, 4]\n"  # of which 4 is within a string
    plain, beside = load(HUNG + control), load(HUNG + below + control)
    np.testing.assert_allclose(beside.controller.gain, plain.controller.gain, rtol=1e-12)
    within = load(HUNG.replace("gravity = 9.81\n", "") + cut + below + some + control)
    assert within.model.ground[0].nodes.tolist() == [1, 4]
    assert within.controller.structure.nodes.shape == (3, 4)


BROKEN = {
    "unknown key": (FLAT + "frictoin = 0.5\n", r":15: \[ground\] has no key 'frictoin'; did you "
                    "mean 'friction'"),
    "key of another unit": (FLAT + "height_mm = 5\n", r":15: \[ground\] has no key 'height_mm'; "
                            "did you mean 'height', in m"),
    "key of another kind": (FLAT + "width = 0.1\n",
                            r":15: \[ground\] with kind = 'linear' has no key 'width'"),
    "unknown kind": (FLAT + "kind = 'Hertz'\n",
                     r":15: in \[ground\], kind is 'Hertz'; did you mean 'hertz'"),
    "no stiffness": ("[ground]\nfriction = 0.5\n", r":13: \[ground\].*lacks the key stiffness: "
                     "a number in N/m"),
    "no stiffness of the second": ("[" + FLAT.replace("]", "]]") + "[[ground]]\nkind = 'hertz'\n",
                                   r":15: \[\[ground\]\] number 2 with kind = 'hertz' lacks .*"
                                   r"N/m\^1\.5"),
    "stiffness zero": ("[ground]\nstiffness = 0\n", r":14: in \[ground\].*stiffness is 0, expected "
                       "a positive"),
    "stiffness by string": ("[ground]\nstiffness = {top = 1.0}\n",
                            r":14: in \[ground\].* stiffness is a table, expected a number in N/m"),
    "friction negative": (FLAT + "friction = -0.1\n", r":15: in .*friction is -0\.1, expected at "
                          "least 0"),
    "height text": (FLAT + "height = 'x**2'\n", r":15: in .*height is the text 'x\*\*2', expected "
                    "a number in m"),
    "normal of the plane": (FLAT + "normal = [0.0, 1.0]\n", r":15: in .*normal has shape \(2,\), "
                            r"expected \(3,\)"),
    "normal zero": (FLAT + "normal = [0.0, 0.0, 0.0]\n", r":15: in .*normal is 0, expected a dir"),
    "unknown node": (FLAT + "nodes = [0, 12]\n", r":15: in .*nodes\[1\] is 12, expected 0 to 11"),
    "unknown table": ("[grounds]\nstiffness = 5e3\n", r":13: .*no table \[grounds\]; did you mean "
                      "'ground'"),
    "control on the ground": (FLAT + "[controller]\nkind = 'lqr'\nsample_time = 0.01\n",
                              r":9: in \[prestress\], for a controller .*"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_broken_grounds_are_refused_by_line_and_name(load, name):
    text, message = BROKEN[name]
    with pytest.raises(SceneError, match=r"scene\.toml" + f"({message})"):
        load(DROP + text)


def test_a_ground_that_is_no_table_is_refused(load):
    with pytest.raises(SceneError, match=r":1: ground is no list of tables; write \[\[ground\]\]"):
        load("ground = 5\n" + DROP)
