"""The command, called as the shell calls it."""

import io
import json
import os
import re
import subprocess
import sys
from importlib import import_module
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

RUN_FILES = {"trajectory.npz", "trajectory.png", "health.png", "structure.png"}


@pytest.fixture
def scene(tmp_path):
    file = tmp_path / "rest.toml"
    file.write_text(AT_REST, encoding="utf-8")
    return file


@pytest.fixture
def undrawn(monkeypatch):
    """Runs are saved without figures, which take nearly all of the time."""
    monkeypatch.setattr("tenscontrol.cli._draw", lambda run, folder: [])


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
    assert {file.name for file in folder.iterdir()} == RUN_FILES
    out = capsys.readouterr().out
    run = tc.load_scene(scene).simulate()
    assert out.startswith(run.summary())
    assert all(str(file) in out for file in folder.iterdir())
    saved = tc.load_run(folder / "trajectory.npz")
    np.testing.assert_array_equal(saved.nodes, run.nodes)
    np.testing.assert_array_equal(saved.rest_length, run.rest_length)
    np.testing.assert_array_equal(saved.structure.strings, run.structure.strings)
    assert saved.choice == run.choice


@pytest.mark.usefixtures("undrawn")
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


@pytest.mark.usefixtures("undrawn")
def test_the_folder_is_named_after_the_scene(tmp_path, monkeypatch, scene):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "rest.toml"]) == 0
    assert (tmp_path / "tenscontrol-rest" / "trajectory.npz").exists()


@pytest.mark.usefixtures("undrawn")
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


def test_a_folder_that_cannot_be_made(capsys, scene):
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
    assert out.startswith("Scene(rest, 0.1 s, rest_length held, 6 nodes)\n")
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


# ---- new, summaries as JSON, completion ----


def test_new_writes_a_scene_and_does_not_replace_a_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "d_bar"]) == 0
    assert capsys.readouterr().out == "d_bar.toml\n"
    assert tc.load_scene("d_bar.toml").structure.strings.tolist() == [[0, 2], [1, 3]]
    assert "d_bar.toml exists already" in refused(capsys, "new", "d_bar")
    Path("d_bar.toml").write_text("")
    assert main(["new", "d_bar", "--force"]) == 0
    assert Path("d_bar.toml").stat().st_size > 1000
    assert main(["new", "kite", "--output", "mine.toml"]) == 0
    assert tc.load_scene("mine.toml").controller is not None


def test_new_lists_the_structures(capsys):
    assert main(["new", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == sorted(tc.library.__all__)
    assert "--list shows all names" in refused(capsys, "new")
    assert "expected one of 'arm'" in refused(capsys, "new", "cube")


def summary(capsys, *arguments):
    """The summary that a command prints as JSON, and what is on stderr."""
    main([*map(str, arguments), "--json"])
    out, err = capsys.readouterr()
    found = json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert [found["command"], found["scene"]] == [str(each) for each in arguments[:2]]
    assert found["version"] == tc.__version__
    assert all(Path(file).exists() and file in err for file in found["files"])
    keys = {key for key in found if key not in ("command", "version", "scene", "files")}
    return found, keys


DOCUMENTED = re.findall(
    r"^   \* - ``(\w+)``\n     - ((?:``\w+``(?:, )?)+)",
    (Path(__file__).parents[2] / "docs" / "scenes.rst").read_text(encoding="utf-8"),
    re.M,
)
KEYS = {command: set(re.findall(r"``(\w+)``", keys)) for command, keys in DOCUMENTED}


@pytest.mark.usefixtures("undrawn")
def test_a_run_as_json(tmp_path, capsys):
    text = (SCENES / "prism_mpc.toml").read_text(encoding="utf-8")
    file = tmp_path / "short.toml"
    file.write_text(text.replace("duration = 3.0", "duration = 0.1"), encoding="utf-8")
    found, keys = summary(capsys, "simulate", file, "--output", tmp_path)
    assert keys == KEYS["simulate"] - {"tolerance"}
    assert found["time"] == pytest.approx(0.1)
    assert found["control"]["status"] == {"ok": 5}
    assert found["displacement"]["start"] == pytest.approx(0.02)
    assert found["health"]["energy_error"] is None
    assert found["health"]["work"]["steps"] == 100


def test_a_motion_that_runs_away_as_json(tmp_path, capsys, scene):
    text = AT_REST.replace("17.3205", "{top = 0, bottom = 0, vertical = 1e20}")
    text = text.replace("step = 1e-2", 'step = 1e-2\ninput = "force_density"')
    scene.write_text(text, encoding="utf-8")
    found, _ = summary(capsys, "simulate", scene, "--output", tmp_path)
    assert "stopped" in found
    assert found["files"] == [str(tmp_path / "trajectory.npz")]


def test_modes_as_json(tmp_path, capsys, scene):
    found, keys = summary(capsys, "modes", scene, "--output", tmp_path)
    assert keys == KEYS["modes"]
    plant = tc.load_scene(scene).linearize()
    modes = tc.modes(plant)
    assert [each["frequency"] for each in found["modes"]] == modes.frequency.tolist()
    assert found["modes"][-1]["pole"] == [modes.pole[-1].real, modes.pole[-1].imag]
    assert found["modes"][0]["kind"] == modes.label[0]


def test_a_comparison_as_json(tmp_path, capsys, scene):
    asked = ["--methods", "rk4", "--repeats", "1", "--outputs", "5", "--output", tmp_path]
    found, keys = summary(capsys, "accuracy", scene, *asked)
    assert keys == KEYS["accuracy"]
    assert {row["method"] for row in found["rows"]} == {"rk4"}


def test_the_shell_completes_commands_and_structures(tmp_path):
    pytest.importorskip("argcomplete", reason="without the extra there is no completion")
    answer = tmp_path / "answer"
    for line, expected in (("tenscontrol si", ["simulate"]), ("tenscontrol new sp", ["spine"])):
        asked = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line))}
        subprocess.run(
            [sys.executable, "-m", "tenscontrol"],
            env=os.environ | asked | {"_ARGCOMPLETE_STDOUT_FILENAME": str(answer)},
            check=False,
        )
        assert [each.strip() for each in answer.read_text().split("\v")] == expected


# ---- disks and pipes that take no more, and memory that ends ----

# Figures take nearly all of the time.
UNDRAWN = """
import sys
from tenscontrol import cli
cli._draw = lambda run, folder: [cli.write_file(folder / "drawn", "")]
sys.exit(cli.main(sys.argv[1:]))
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
        said = ended(
            ["simulate", scene, "--output", tmp_path / "saved"], ("-c", UNDRAWN), stdout=full
        )
    assert said == "tenscontrol: cannot write to the standard output: No space left on device"
    assert (tmp_path / "saved" / "trajectory.npz").exists()


def into_a_closed_pipe(*arguments, start=("-m", "tenscontrol")):
    """Run the command with a standard output that nobody reads; its status."""
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, *start, *map(str, arguments)]
    with open(writing, "w") as pipe:
        done = subprocess.run(command, stdout=pipe, stderr=subprocess.PIPE, text=True)
    assert done.stderr == ""
    return done.returncode


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_a_closed_pipe_ends_nothing_and_is_told_by_the_status(tmp_path, scene):
    assert (
        into_a_closed_pipe("simulate", scene, "--output", tmp_path / "saved", start=("-c", UNDRAWN))
        == 141
    )
    assert (tmp_path / "saved" / "trajectory.npz").exists()
    assert (tmp_path / "saved" / "drawn").exists()  # figures would be
    assert into_a_closed_pipe("--help") == 0


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
def test_a_full_disk(tmp_path, capsys, scene):
    import resource

    (tmp_path / "trajectory.npz").write_text("old")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        said = refused(capsys, "simulate", scene, "--output", tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "cannot write: File too large; write elsewhere" in said
    assert str(tmp_path / "trajectory.npz") in said
    assert (tmp_path / "trajectory.npz").read_text() == "old"


@pytest.mark.parametrize(
    ("error", "message"),
    [(MemoryError(), "ask for less"), (MemoryError("Unable to allocate 1. TiB"), "1. TiB")],
)
def test_memory_that_ends(error, message, capsys, scene, monkeypatch):
    place = import_module("tenscontrol.scene.load_scene")
    monkeypatch.setattr(place, "load_scene", Mock(side_effect=error))
    assert message in refused(capsys, "modes", scene)


def test_view_writes_a_page_and_opens_it_only_when_asked(tmp_path, capsys, scene, monkeypatch):
    shown = []
    monkeypatch.setattr("webbrowser.open", shown.append)
    assert main(["view", str(scene), "--output", str(tmp_path)]) == 0
    page = tmp_path / "view.html"
    assert capsys.readouterr().out == f"{page}\n"
    assert "<title>run of 0.1 s by" in page.read_text("utf-8")
    assert shown == []
    assert main(["view", str(scene), "--output", str(tmp_path), "--browser"]) == 0
    assert shown == [page.as_uri()]


def test_view_shows_a_saved_run(tmp_path, capsys, scene):
    run = tc.load_scene(scene).simulate()
    file = run.save(tmp_path / "motion.npz")
    assert main(["view", str(file), "--output", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'view.html'}\n"
    assert (tmp_path / "view.html").read_text("utf-8") == run.to_html(
        tmp_path / "b.html"
    ).read_text("utf-8")
    assert "none.npz" in refused(capsys, "view", tmp_path / "none.npz")


def test_view_without_plotly_says_how_to_get_it(tmp_path, capsys, scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    said = refused(capsys, "view", scene, "--output", tmp_path)
    assert "pip install 'tenscontrol[view]'" in said
    assert not (tmp_path / "view.html").exists()


@pytest.mark.parametrize("encoding", ["ascii", "cp437"])
@pytest.mark.usefixtures("undrawn")
def test_a_terminal_that_cannot_print_every_sign(tmp_path, monkeypatch, scene, encoding):
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="")
    monkeypatch.setattr(sys, "stdout", stream)
    folder = tmp_path / "\N{GREEK SMALL LETTER GAMMA}"
    assert main(["simulate", str(scene), "--output", str(folder)]) == 0
    stream.flush()
    said = stream.buffer.getvalue().decode(encoding)
    assert "\\u03b3" in said
    assert "kg m^2/s" in said
    assert stream.errors == "strict"  # the stream is the user's


@pytest.mark.usefixtures("undrawn")
def test_without_any_streams(tmp_path, monkeypatch, scene):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    assert main(["simulate", str(scene), "--output", str(tmp_path / "run")]) == 0
    assert main(["simulate", str(tmp_path / "missing.toml")]) == 2


def test_what_is_told_does_not_get_among_the_results(tmp_path, monkeypatch, capsys, scene):
    monkeypatch.setattr(sys, "stderr", None)
    given = ["accuracy", str(scene), "--methods", "rk4", "--csv", "--output", str(tmp_path)]
    assert main(given) == 0
    out = capsys.readouterr().out
    assert out.startswith("method,")
    assert "accuracy.csv" not in out
