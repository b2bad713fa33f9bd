"""Scenes whose controller is Python code: a file beside the scene, or a module."""

import os
import pickle
import re
import sys
from py_compile import compile as compiled

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.cli import main
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
    (tmp_path / "folder.py").mkdir()
    yield lambda controller, run="": _load(tmp_path, controller, run)
    sys.modules.pop("_scene_laws", None)


def _load(folder, controller, run):
    file = folder / "scene.toml"
    file.write_text(BALL.format(run=run, controller=controller), encoding="utf-8")
    return tc.load_scene(file, allow_code=True)


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
    np.testing.assert_array_equal(lost.value, scene.prestress)


def test_a_function_needs_no_equilibrium(tmp_path):
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    text = BALL.replace("min_force_density = 50.0", "force_density = [{}]").format(
        ", ".join(["60.0"] * 11 + ["90.0"]), run="", controller="{}\nsample_time = 0.02"
    )
    file = tmp_path / "scene.toml"
    file.write_text(text.format('function = "laws.py:hold"'), encoding="utf-8")
    assert tc.load_scene(file, allow_code=True).simulate().control.status_count == {"ok": 5}
    file.write_text(text.format('factory = "laws.py:lqr"'), encoding="utf-8")
    with pytest.raises(SceneError, match=r"scene\.toml:.*for a controller"):
        tc.load_scene(file, allow_code=True)


REFUSED = {
    "nothing": ("", r"expects one of function and factory, found neither"),
    "both": ('function = "a:b"\nfactory = "a:b"', r"expects one of function and fac.*found both"),
    "no name": ('function = "laws.py"', r"function is 'laws.py', expected 'file.py:name'"),
    "no place": ('function = ":hold"', r"expected 'file.py:name'"),
    "a statement": ('function = "os; x:hold"', r"expected 'file.py:name'"),
    "relative": ('function = ".laws:hold"', r"expected 'file.py:name'"),
    "a call": ('function = "laws.py:hold()"', r"expected 'file.py:name'"),
    "no file": ('function = "other.py:hold"', r"other.py is not loaded: .*No such file"),
    "a folder": ('function = "folder.py:hold"', r"is not loaded: .*is a folder, expected a file"),
    "a file above": (
        'function = "../laws.py:hold"', r":18: .*expected one in the folder of the scene, .*copy"),
    "a file anywhere": ('function = "/tmp/laws.py:hold"', r"expected one in the folder of the sc"),
    "a nul": ('function = "a\\u0000.py:hold"', r"in \[controller\].*null"),
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


@pytest.mark.skipif(os.name != "posix", reason="links and pipes are POSIX")
def test_links_that_lead_out_and_pipes_are_refused(loaded, tmp_path):
    os.mkfifo(tmp_path / "pipe.py")
    with pytest.raises(SceneError, match=r"pipe\.py is not loaded: .*is a pipe or a device"):
        loaded('function = "pipe.py:hold"')
    assert "_scene_pipe" not in sys.modules
    outside = tmp_path.parent / "outside.py"
    (tmp_path / "link.py").symlink_to(outside)
    with pytest.raises(SceneError, match=rf"function is the file {outside}, expected one in the"):
        loaded('function = "link.py:hold"')


def test_code_that_cannot_be_read_is_named(loaded, tmp_path):
    (tmp_path / "wrong.py").write_text("def f(:\n", encoding="utf-8")
    (tmp_path / "lacks.py").write_text("import no_such_package\n", encoding="utf-8")
    for name, message in (("wrong", "invalid syntax"), ("lacks", "No module named")):
        with pytest.raises(SceneError, match=rf"{name}.py is not loaded.*{message}"):
            loaded(f'function = "{name}.py:f"')


@pytest.mark.parametrize("code", ["laws.py:hold", "below/laws.py:hold", "marking:hold"])
def test_no_code_runs_unless_it_is_allowed(code, tmp_path, monkeypatch, capsys):
    """The refusal says what would run, and the command has an option for it."""
    (tmp_path / "below").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    mark = tmp_path / "mark"
    for name in ("laws.py", "below/laws.py", "marking.py"):
        text = f"{LAWS}\nopen({str(mark)!r}, 'w').close()\n"
        (tmp_path / name).write_text(text, encoding="utf-8")
    place, _, name = code.partition(":")
    where = f"the file {tmp_path / place}" if "." in place else f"the module {place}"
    file = tmp_path / "scene.toml"
    controller = f'function = "{code}"\nsample_time = 0.02'
    file.write_text(BALL.format(run="", controller=controller), encoding="utf-8")
    wanted = rf"scene\.toml:18: .*function runs Python code, hold of {re.escape(where)}, and no"
    with pytest.raises(SceneError, match=wanted + r".*allow_code=True\), or --allow-code"):
        tc.load_scene(file)
    is_one = code == "laws.py:hold"  # by the command, too
    for command in ("simulate", "modes", "view", "accuracy") * is_one:
        assert main([command, str(file), "--output", str(tmp_path / "out")]) == 2
        assert re.search(wanted, capsys.readouterr().err)
    assert not mark.exists()
    if is_one:
        assert main(["modes", str(file), "--allow-code", "--output", str(tmp_path / "out")]) == 0
    else:
        tc.load_scene(file, allow_code=True)
    assert mark.exists()
    sys.modules.pop("_scene_laws", None)
    sys.modules.pop("marking", None)


def test_the_file_runs_and_not_a_compiled_copy_beside_it(loaded, tmp_path):
    """A copy in ``__pycache__`` that says it is of this file may be of another."""
    file, text = tmp_path / "laws.py", LAWS
    os.utime(file, (1e9, 1e9))
    (tmp_path / "__pycache__").mkdir()
    file.write_text(text.replace("0.8", "9.9"), encoding="utf-8")
    os.utime(file, (1e9, 1e9))
    compiled(str(file))
    file.write_text(text, encoding="utf-8")
    os.utime(file, (1e9, 1e9))
    scene = loaded('function = "laws.py:hold"\nsample_time = 0.02')
    np.testing.assert_array_equal(scene.simulate().control.command, 0.8)


def test_whether_code_is_allowed_is_true_or_false(tmp_path):
    with pytest.raises(TypeError, match=r"allow_code is 'no' .*expected True or False"):
        tc.load_scene(tmp_path / "scene.toml", allow_code="no")
