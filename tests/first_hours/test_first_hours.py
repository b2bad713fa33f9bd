"""The projects of the documentation: each file runs, and prints what the page says of it."""

import re
import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from tenscontrol.dynamics.machine_code import compiler
from tests.code_blocks import DOCS, agree
from tests.first_hours import log

PAGE = (DOCS / "projects.rst").read_text(encoding="utf-8")
HERE = Path(__file__).parent


def follow(name, capsys):
    """Run a file of the page and return its names."""
    names = runpy.run_path(str(HERE / f"{name}.py"))
    plt.close("all")
    part = PAGE[PAGE.rindex(f"first_hours/{name}.py") :]
    (shown,) = re.findall(r"It prints:\n\n\.\. code-block:: text\n\n((?:   .*\n|\n)+)", part)[:1]
    printed = capsys.readouterr().out
    assert agree(printed, shown), printed
    return names


def test_a_mast_from_matrices_is_sized_and_stilled(capsys):
    names = follow("mast", capsys)
    mast, margins = names["mast"], names["margins"]
    assert np.array_equal((mast.C_b @ mast.C_nb).toarray(), names["C_b"])
    assert np.array_equal(mast.C_s.toarray(), names["C_s"])
    assert margins.margin > 2.0  # as it was sized for
    late = {
        name: np.abs(top[names["still"].time > 1.0]).max() for name, top in names["sway"].items()
    }
    assert late["LQR"] < 0.01 * late["strings held"]


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
def test_a_robot_from_its_log_is_controlled_in_c(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = follow("robot", capsys)
    # To the tolerance of the run that made it.
    np.testing.assert_allclose(log.log().readings, names["log"].readings, rtol=0, atol=1e-5)
    for parameter, true in {"stiffness": log.STIFFNESS, "damping": log.DAMPING}.items():
        low, high = re.search(rf"{parameter}.* ([\d.]+) to ([\d.]+)", names["fit"].table()).groups()
        believed = getattr(names["believed"].strings, parameter)
        assert float(low) < true / np.max(believed) < float(high)
    by_c, by_python = (names["runs"][name].nodes for name in ("LQR in C", "LQR"))
    assert np.abs(by_c - by_python).max() < 1e-9


def test_a_program_on_the_symbols_of_a_prism_is_right(capsys):
    names = follow("symbols", capsys)
    end = names["played"].nodes[..., -1] - names["prism"].nodes
    assert np.abs(end).max() < 5e-4  # from 54 mm
    assert names["planned"].min() > -1e-6
    assert names["planned"].max() < 40.0 + 1e-6


@pytest.mark.parametrize("name", ["mast", "robot", "symbols"])
def test_the_page_shows_all_of_a_file(name):
    options = re.findall(rf"literalinclude:: .*/{name}\.py\n((?:   :.*\n)+)", PAGE)
    begins, ends = (
        re.findall(rf":{option}: # %% (\w+)", "".join(options))
        for option in ("start-after", "end-before")
    )
    marks = re.findall(r"^# %% (\w+)", HERE.joinpath(f"{name}.py").read_text("utf-8"), re.MULTILINE)
    # The first part shows all up to its end, the last all from its start.
    assert begins == ends
    assert [mark for mark in marks if mark in begins] == begins
    assert ":start-after:" not in options[0]
    assert ":end-before:" not in options[-1]
