"""Ctrl-C and SIGTERM in the command: what is done is kept, one line, status 130 or 143."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from tenscontrol.accuracy.measured_run import Bench
from tenscontrol.cli import main
from tenscontrol.integrate import RK4
from tenscontrol.interrupt import interruptible

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

SCENES = Path(__file__).parent.parent.parent / "examples" / "scenes"


def press_at(call, monkeypatch, owner, name, number=signal.SIGINT):
    """Send a signal at the beginning of the so many-th call of a function."""
    original, calls = getattr(owner, name), 0

    def pressed(*arguments, **options):
        nonlocal calls
        calls += 1
        if calls == call:
            signal.raise_signal(number)
        return original(*arguments, **options)

    monkeypatch.setattr(owner, name, pressed)


def one_line(capsys):
    """Check what is on stderr, and return what is on stdout."""
    out, err = capsys.readouterr()
    assert err == "tenscontrol: interrupted; what is above was done by then\n"
    return out


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_simulate(tmp_path, monkeypatch, capsys, number, status):
    press_at(6, monkeypatch, RK4, "advance", number)
    if number == signal.SIGTERM:  # figures take nearly all of the time
        monkeypatch.setattr("tenscontrol.cli._draw", lambda run, folder: [])
    assert main(["simulate", str(SCENES / "prism_mpc.toml"), "--output", str(tmp_path)]) == status
    assert "ended early" in one_line(capsys)
    with np.load(tmp_path / "trajectory.npz") as saved:
        assert saved["time"][-1] > 0
    assert (tmp_path / "trajectory.png").exists() == (number == signal.SIGINT)
    if number == signal.SIGTERM:
        with pytest.raises(SystemExit), interruptible():
            pytest.fail("a program that was told to end goes on")


def test_accuracy(tmp_path, monkeypatch, capsys):
    press_at(3, monkeypatch, Bench, "own")
    scene = str(SCENES / "prism_free.toml")
    options = ["--methods", "rk4", "--repeats", "1", "--outputs", "5", "--output", str(tmp_path)]
    assert main(["accuracy", scene, *options]) == 130
    assert one_line(capsys).count("\nrk4 ") == 2
    assert len((tmp_path / "accuracy.csv").read_text("utf-8").splitlines()) == 3


def test_demo(tmp_path, monkeypatch, capsys):
    """In the run of the LQR: modes are drawn, no closed loop."""
    press_at(50, monkeypatch, RK4, "advance")
    assert main(["demo", "--output", str(tmp_path)]) == 130
    assert "2. Modes" in one_line(capsys)
    assert {file.name for file in tmp_path.iterdir()} == {
        "prism.png", "modes_force_density.png", "modes_rest_length.png",
    }  # fmt: skip


def test_before_anything_is_done(tmp_path, monkeypatch, capsys):
    press_at(1, monkeypatch, Bench, "own")
    scene = str(SCENES / "prism_free.toml")
    assert main(["accuracy", scene, "--methods", "rk4", "--output", str(tmp_path)]) == 130
    assert one_line(capsys) == ""
