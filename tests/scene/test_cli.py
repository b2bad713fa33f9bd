"""The command, called as the shell calls it."""

import os
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.cli import main

SCENES = Path(__file__).parent.parent.parent / "examples" / "scenes"

AT_REST = """\
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


@pytest.fixture
def scene(tmp_path):
    file = tmp_path / "rest.toml"
    file.write_text(AT_REST, encoding="utf-8")
    return file


def refused(capsys, *arguments):
    """What the command says on stderr, after checking that it ends with status 2."""
    assert main([str(argument) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("tenscontrol: ")
    assert "Traceback" not in err
    return err


def test_simulate_saves_motion_and_figures(tmp_path, capsys, scene):
    folder = tmp_path / "new" / "folder"
    assert main(["simulate", str(scene), "--output", str(folder)]) == 0
    assert {file.name for file in folder.iterdir()} == {
        "trajectory.npz",
        "trajectory.png",
        "health.png",
        "structure.png",
    }
    out = capsys.readouterr().out
    run = tc.load_scene(scene).simulate()
    assert out.startswith(run.summary())
    assert all(str(file) in out for file in folder.iterdir())
    saved = tc.load_run(folder / "trajectory.npz")
    np.testing.assert_array_equal(saved.nodes, run.nodes)
    np.testing.assert_array_equal(saved.rest_length, run.rest_length)
    np.testing.assert_array_equal(saved.structure.strings, run.structure.strings)
    assert saved.choice == run.choice


def test_a_saved_run_goes_on(tmp_path, scene):
    one, two = tmp_path / "one", tmp_path / "two"
    assert main(["simulate", str(scene), "--output", str(one)]) == 0
    start = one / "trajectory.npz"
    assert main(["simulate", str(scene), "--start", str(start), "--output", str(two)]) == 0
    first, second = (tc.load_run(folder / "trajectory.npz") for folder in (one, two))
    assert second.time[0] == first.time[-1]
    np.testing.assert_array_equal(second.nodes[:, :, 0], first.nodes[:, :, -1])


def test_a_start_that_is_no_run(tmp_path, capsys, scene):
    assert main(["simulate", str(scene), "--start", str(scene), "--output", str(tmp_path)]) == 2
    assert "no run: expected a file that run.save(path) wrote" in capsys.readouterr().err


def test_the_folder_is_named_after_the_scene(tmp_path, monkeypatch, scene):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "rest.toml"]) == 0
    assert (tmp_path / "tenscontrol-rest" / "health.png").exists()


def test_closed_loop_is_saved_with_its_record(tmp_path, capsys):
    text = (SCENES / "prism_mpc.toml").read_text(encoding="utf-8")
    file = tmp_path / "short.toml"
    file.write_text(text.replace("duration = 3.0", "duration = 0.1"), encoding="utf-8")
    assert main(["simulate", str(file), "--output", str(tmp_path)]) == 0
    assert "commands          5 ok" in capsys.readouterr().out
    with np.load(tmp_path / "trajectory.npz") as saved:
        assert saved["control_status"].tolist() == ["ok"] * 5
        assert saved["control_applied"].shape == (9, 5)


def test_scene_without_strings(tmp_path):
    file = tmp_path / "pendulum.toml"
    file.write_text(
        "[structure]\nnodes=[[0,0,0],[1,0,0]]\nbars=[[0,1]]\nstrings=[]\nbar_mass=1\nfixed=[0]\n"
        "[loads]\ngravity=9.81\n[run]\nduration=0.2\n",
        encoding="utf-8",
    )
    assert main(["simulate", str(file), "--output", str(tmp_path)]) == 0
    assert (tmp_path / "trajectory.png").exists()


@pytest.mark.parametrize(("held", "highest"), [("force_density", 2.44339), ("rest_length", 5.1646)])
def test_modes_prints_the_table(tmp_path, capsys, scene, held, highest):
    assert main(["modes", str(scene), "--input", held, "--output", str(tmp_path / "m")]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"{held.replace('_', ' ')} held\nmode  frequency Hz")
    assert f"{highest:.5f}" in out
    assert (tmp_path / "m" / "modes.png").exists()


def test_modes_as_the_scene_says(tmp_path, capsys, scene):
    assert main(["modes", str(scene), "--coordinates", "minimal", "--output", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("rest length held")
    assert out.count("rigid") == 6


def test_modes_away_from_rest_are_refused(tmp_path, capsys):
    err = refused(capsys, "modes", SCENES / "prism_free.toml", "--output", tmp_path / "none")
    assert "prism_free.toml: " in err
    assert "not at rest" in err
    assert not (tmp_path / "none").exists()


def test_broken_scenes_are_refused(tmp_path, capsys, scene):
    scene.write_text(AT_REST.replace("stiffness", "stifness"), encoding="utf-8")
    for command in ("simulate", "modes"):
        err = refused(capsys, command, scene, "--output", tmp_path / "none")
        assert "rest.toml:5: " in err
        assert "did you mean 'stiffness'?" in err
    assert not (tmp_path / "none").exists()
    assert "cannot be read" in refused(capsys, "simulate", tmp_path / "missing.toml")


def test_a_scene_that_the_simulation_refuses(tmp_path, capsys, scene):
    scene.write_text(AT_REST.replace("duration = 0.1", "duration = 1e12"), encoding="utf-8")
    err = refused(capsys, "simulate", scene, "--output", tmp_path)
    assert "rest.toml: step is 0.01 s, which makes 1e+14 steps" in err


def test_a_motion_that_runs_away_is_saved_up_to_there(tmp_path, capsys, scene):
    text = AT_REST.replace("17.3205", "{top = 0, bottom = 0, vertical = 1e20}")
    text = text.replace("step = 1e-2", 'step = 1e-2\ninput = "force_density"')
    scene.write_text(text, encoding="utf-8")
    folder = tmp_path / "saved"
    assert main(["simulate", str(scene), "--output", str(folder)]) == 2
    assert "stopped at" in capsys.readouterr().err
    assert (folder / "trajectory.npz").exists()


def test_a_folder_that_cannot_be_made(tmp_path, capsys, scene):
    err = refused(capsys, "simulate", scene, "--output", scene / "below")
    assert "cannot write: Not a directory; give a folder" in err
    assert str(scene / "below") in err


def test_unknown_commands_and_missing_scenes_end_with_status_two(capsys):
    for arguments in ([], ["simulate"], ["fly"], ["modes", "x.toml", "--input", "torque"]):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 2
    assert "usage: tenscontrol" in capsys.readouterr().err


def test_accuracy_prints_and_saves_the_comparison(tmp_path, capsys, scene):
    folder = tmp_path / "measured"
    asked = ["accuracy", str(scene), "--methods", "rk4,dop853", "--repeats", "1", "--outputs", "5"]
    assert main([*asked, "--output", str(folder)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("Case(rest, 0.1 s, rest_length held, 6 nodes)\n")
    assert "reference: " in out
    assert out.count("\nrk4 ") > 2
    assert out.count("\ndop853 ") > 2
    names = {"accuracy.csv", "accuracy.md", "accuracy.png"}
    assert {file.name for file in folder.iterdir()} == names
    assert all(str(folder / name) in out for name in names)
    assert main([*asked, "--output", str(folder), "--csv"]) == 0
    out = capsys.readouterr().out
    assert out == (folder / "accuracy.csv").read_text(encoding="utf-8")
    assert main([*asked, "--output", str(folder), "--markdown"]) == 0
    assert capsys.readouterr().out.startswith("# rest\n")


def test_accuracy_of_an_unknown_method(tmp_path, capsys, scene):
    err = refused(capsys, "accuracy", scene, "--methods", "rk4,euler", "--output", tmp_path / "n")
    assert "rest.toml: methods[1] is 'euler', expected one of" in err
    assert not (tmp_path / "n").exists()


# ---- disks and pipes that take no more, and memory that ends ----

SMALL = """
import resource, sys
from tenscontrol.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, -1))
sys.exit(main(sys.argv[1:]))
"""


def ended(arguments, start=("-m", "tenscontrol"), **options):
    """Run the command in a process of its own; the one line that it says on stderr."""
    done = subprocess.run(
        [sys.executable, *start, *map(str, arguments)], stderr=subprocess.PIPE, text=True, **options
    )
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    return line


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full device")
def test_a_full_standard_output(tmp_path, scene):
    with open("/dev/full", "w") as full:
        said = ended(["simulate", scene, "--output", tmp_path / "saved"], stdout=full)
    assert said == "tenscontrol: cannot write to the standard output: No space left on device"
    assert (tmp_path / "saved" / "trajectory.npz").exists()


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_a_closed_pipe(tmp_path, scene):
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "w") as pipe:
        said = ended(["simulate", scene, "--output", tmp_path / "saved"], stdout=pipe)
    assert said == "tenscontrol: cannot write to the standard output: Broken pipe"
    assert (tmp_path / "saved" / "trajectory.npz").exists()


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
def test_a_full_disk(tmp_path, scene):
    (tmp_path / "trajectory.npz").write_text("old")
    said = ended(
        ["simulate", scene, "--output", tmp_path], ("-c", SMALL), stdout=subprocess.DEVNULL
    )
    assert "cannot write: File too large; write elsewhere" in said
    assert str(tmp_path / "trajectory.npz") in said
    assert (tmp_path / "trajectory.npz").read_text() == "old"


@pytest.mark.parametrize(
    ("error", "message"),
    [(MemoryError(), "ask for less"), (MemoryError("Unable to allocate 1. TiB"), "1. TiB")],
)
def test_memory_that_ends(error, message, capsys, scene, monkeypatch):
    monkeypatch.setattr("tenscontrol.scene.load_scene", Mock(side_effect=error))
    assert message in refused(capsys, "modes", scene)
