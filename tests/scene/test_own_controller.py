"""Scenes whose controller is Python code: a file beside the scene, or a module."""

import pickle
import sys

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.scene import SceneError

BALL = """
[structure]
generator = "class2_tower"
[strings]
law = "linear"
stiffness = 1000.0
damping = 0.5
[prestress]
min_force_density = 50.0
[start]
disturbance = 0.01
[run]
duration = 0.1
step = 2e-3
{run}
[controller]
kind = "python"
{controller}
"""

LAWS = '''
from __future__ import annotations
from dataclasses import dataclass
import numpy as np
import tenscontrol as tc

def hold(time, nodes, velocities):
    return np.full(12, 0.8)

@dataclass
class Damper:
    """Needs its module while it is made."""
    plant: tc.plant.LinearPlant
    gain: float
    sample_time = 0.02

    @property
    def input(self):
        return self.plant.input

    def command(self, time, nodes, velocities):
        z = self.plant.measure(nodes, velocities)
        return self.plant.equilibrium_input - self.gain * self.plant.B.T @ z

def lqr(plant, **settings):
    return tc.LQR(plant, **settings)

def broken(plant):
    raise ValueError("gain is missing")

number = 3
'''


@pytest.fixture
def loaded(tmp_path):
    """Load a scene with these keys, beside a file of laws."""
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    yield lambda controller, run="": _load(tmp_path, controller, run)
    sys.modules.pop("_scene_laws", None)


def _load(folder, controller, run):
    file = folder / "scene.toml"
    file.write_text(BALL.format(run=run, controller=controller), encoding="utf-8")
    return tc.load_scene(file)


def test_a_function_in_a_file_beside_the_scene(loaded):
    scene = loaded('function = "laws.py:hold"\nsample_time = 0.02\nmax_change = 0.001')
    assert scene.controller.label == "hold"
    control = scene.simulate().control
    change = np.diff(control.command, prepend=scene.rest_length[:, None])
    assert np.abs(change).max() == pytest.approx(0.001)
    assert control.status_count == {"saturated": 5}


def test_a_factory_gets_the_plant_and_its_settings(loaded):
    scene = loaded('factory = "laws.py:Damper"\n[controller.settings]\ngain = 1e-3')
    assert repr(scene.controller) == "FunctionController(Damper, input 'rest_length', every 0.02 s)"
    found = scene.simulate()
    plant = scene.linearize()

    def damper(time, nodes, velocities):
        return plant.rest_length - 1e-3 * plant.B.T @ plant.measure(nodes, velocities)

    by_hand = tc.simulate(
        scene.model, 0.1, scene.nodes, controller=damper, sample_time=0.02, step=2e-3,
        rest_length=scene.rest_length,
    )  # fmt: skip
    np.testing.assert_array_equal(found.nodes, by_hand.nodes)


def test_a_factory_may_return_a_controller(loaded):
    settings = 'factory = "laws.py:lqr"\ninput = "force_density"\n[controller.settings]\n'
    scene = loaded(settings + "sample_time = 0.01\nmax_force_density = 200.0")
    assert isinstance(scene.controller, tc.LQR)
    assert scene.controller.input == "force_density"
    assert scene.simulate().control.status_count == {"ok": 10}


def test_a_function_of_an_installed_module(loaded, tmp_path, monkeypatch):
    (tmp_path / "laws_of_a_package.py").write_text(LAWS, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    scene = loaded('function = "laws_of_a_package:hold"', "sample_time = 0.02")
    assert set(scene.simulate().control.status) == {"ok"}
    assert pickle.loads(pickle.dumps(scene.controller)).label == "hold"
    sys.modules.pop("laws_of_a_package")


def test_whole_strings_and_held_force_density(loaded):
    scene = loaded('function = "laws.py:hold"', 'sample_time = 0.02\ninput = "force_density"')
    assert scene.controller.input == "force_density"
    lost = scene.controller.command(0.0, np.nan * scene.nodes, scene.velocities)
    np.testing.assert_array_equal(lost.value, scene.force_density)


def test_a_function_needs_no_equilibrium(tmp_path):
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    text = BALL.replace("min_force_density = 50.0", "force_density = [{}]").format(
        ", ".join(["60.0"] * 11 + ["90.0"]), run="", controller="{}\nsample_time = 0.02"
    )
    file = tmp_path / "scene.toml"
    file.write_text(text.format('function = "laws.py:hold"'), encoding="utf-8")
    assert tc.load_scene(file).simulate().control.status_count == {"ok": 5}
    file.write_text(text.format('factory = "laws.py:lqr"'), encoding="utf-8")
    with pytest.raises(SceneError, match=r"scene\.toml:.*for a controller"):
        tc.load_scene(file)


REFUSED = {
    "nothing": ("", r"expects one of function and factory, found neither"),
    "both": ('function = "a:b"\nfactory = "a:b"', r"expects one of function and fac.*found both"),
    "no name": ('function = "laws.py"', r"function is 'laws.py', expected 'file.py:name'"),
    "no place": ('function = ":hold"', r"expected 'file.py:name'"),
    "a statement": ('function = "os; x:hold"', r"expected 'file.py:name'"),
    "relative": ('function = ".laws:hold"', r"expected 'file.py:name'"),
    "a call": ('function = "laws.py:hold()"', r"expected 'file.py:name'"),
    "no file": ('function = "other.py:hold"', r"other.py is not loaded: there is no file"),
    "a folder": ('function = "../..py:hold"', r"is not loaded: there is no file"),
    "no module": (
        'function = "no_such_module:f"', r":18: in \[controller\].*function: no_such_module is "
        "not loaded: No module named"),
    "no such name": ('function = "laws.py:holds"', r"laws.py has no holds"),
    "a number": ('function = "laws.py:number"', r"controller is a int, expected"),
    "a class": ('function = "laws.py:Damper"', r"controller is the class Damper"),
    "settings of a function": (
        'function = "laws.py:hold"\n[controller.settings]\ngain = 1.0', r"arguments of a factory"),
    "settings that are none": (
        'factory = "laws.py:Damper"\n[controller.settings]\ngains = 1.0', r"unexpected keyword"),
    "a factory that raises": ('factory = "laws.py:broken"', r"gain is missing"),
    "limits of a controller": (
        'factory = "laws.py:lqr"\nhigh = 1.0', r"which has limits and a sample time of its own"),
    "limits of some groups": ('function = "laws.py:hold"\nlow = {top = 1}', r"group is 'top'"),
    "another input": ('function = "laws.py:hold"\ninput = "force"', r"input is 'force'"),
    "a horizon": ('function = "laws.py:hold"\nhorizon = 3', r"has no key 'horizon'"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused_with_its_line(loaded, case):
    text, message = REFUSED[case]
    with pytest.raises(SceneError, match=r"(?s)scene\.toml.*" + message):
        loaded(text)


def test_code_that_cannot_be_read_is_named(loaded, tmp_path):
    (tmp_path / "wrong.py").write_text("def f(:\n", encoding="utf-8")
    (tmp_path / "lacks.py").write_text("import no_such_package\n", encoding="utf-8")
    for name, message in (("wrong", "invalid syntax"), ("lacks", "No module named")):
        with pytest.raises(SceneError, match=rf"{name}.py is not loaded.*{message}"):
            loaded(f'function = "{name}.py:f"')
