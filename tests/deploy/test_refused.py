"""What cannot be written or compiled, and what the refusal says."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.machine_code import VARIABLE
from tests.deploy import scenes


def regulator(step=scenes.SAMPLE):
    plant = scenes.plant("force_density")
    return tc.LQR(plant, *tc.energy_weights(plant), sample_time=step)


def test_law_in_continuous_time(tmp_path):
    with pytest.raises(ValueError, match=r"controller is an LQR in continuous time.*sample_time="):
        tc.generate_c(regulator(None), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("what", [None, 3, scenes.Pair])
def test_other_controllers(what, tmp_path):
    with pytest.raises(TypeError, match=r"controller is a \w+, expected .* or a RollingGait"):
        tc.generate_c(what, tmp_path)


def test_a_controller_that_is_not_written(tmp_path):
    plant = scenes.plant("force_density")
    law = tc.FeedbackLinearization(
        plant, reference=None, sample_time=scenes.SAMPLE, max_force_density=60.0, frequency=1.0
    )
    with pytest.raises(TypeError, match=r"controller is a Feed\w+, expected .* or a RollingGait"):
        tc.generate_c(law, tmp_path)


def test_gaits_that_plan_while_they_run(tmp_path):
    model, _, winches = scenes.rolling_ball()
    planning = tc.shape.RollingGait(model, 0.55, [1.0, 0.0, 0.0], 0.05, winches=winches)
    with pytest.raises(ValueError, match=r"RollingGait that plans while it runs.*tabulated=True"):
        tc.generate_c(planning, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", [tc.MPC, tc.NMPC])
def test_limit_of_time(kind, tmp_path):
    limited = kind(
        scenes.plant("force_density"),
        horizon=2,
        sample_time=scenes.SAMPLE,
        max_force_density=80.0,
        time_limit=0.01,
    )
    with pytest.raises(ValueError, match=r"time_limit=0\.01 s, but C code .* has no clock"):
        tc.generate_c(limited, tmp_path)


@pytest.mark.parametrize(("stiffness", "pieces"), [(1e4, 1), (1e2, 5)])
def test_nonlinear_mpc_with_implicit_steps(stiffness, pieces, tmp_path):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness))
    plant = tc.linearize(model, tc.prestress(tc.prism(), 17.32), input="rest_length")
    nmpc = tc.NMPC(
        plant, horizon=2, sample_time=scenes.SAMPLE, winches=tc.Winches(rate=0.1, substeps=pieces)
    )
    with pytest.raises(
        ValueError, match=r"NMPC with implicit steps, for stiff strings .* or use MPC"
    ):
        tc.generate_c(nmpc, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("folder", [None, 3, np.zeros(2)])
def test_folder_that_is_no_path(folder):
    with pytest.raises(TypeError, match=r"folder is .*expected a path"):
        tc.generate_c(regulator(), folder)


def test_folder_with_something_in_it(tmp_path):
    (tmp_path / "mine.c").write_text("int mine;")
    with pytest.raises(FileExistsError, match="is not empty"):
        tc.generate_c(regulator(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.c"]


@pytest.mark.parametrize(
    "name", [None, "", "1st", "my controller", "a/b", "ä", "x" * 32, "main", "stages"]
)
def test_name_that_is_none_in_c(name, tmp_path):
    with pytest.raises(ValueError, match=r"name is .*, (expected a letter|which is reserved)"):
        tc.generate_c(regulator(), tmp_path / "code", name=name)
    assert not (tmp_path / "code").exists()


def test_reference_too_long_for_a_table(tmp_path):
    mpc = tc.MPC(
        scenes.plant("force_density"), horizon=2, sample_time=scenes.SAMPLE, max_force_density=80.0
    )
    nodes = mpc.plant.nodes
    mpc.follow(tc.Reference([0.0, 1e5], np.stack([nodes, 1.001 * nodes], axis=-1)))
    with pytest.raises(ValueError, match=r"reference of 100000 s, \d+ samples.*Follow a shorter"):
        tc.generate_c(mpc, tmp_path)


def test_no_compiler(tmp_path, monkeypatch):
    made = tc.generate_c(regulator(), tmp_path)
    monkeypatch.setenv(VARIABLE, "none")
    with pytest.raises(FileNotFoundError, match="switched off by TENSCONTROL_COMPILER"):
        made.compile()


@pytest.mark.parametrize(
    ("timeout", "expected"),
    [(bad, "positive") for bad in (0.0, -1.0, np.nan, None)] + [(2**31, "between 1e-70 and 86400")],
)
def test_timeout(timeout, expected, tmp_path):
    made = tc.generate_c(regulator(), tmp_path)
    with pytest.raises((TypeError, ValueError), match=f"timeout is .*{expected}"):
        made.compile(timeout)


@pytest.mark.parametrize("number", [errno.EACCES, errno.ENOSPC])
def test_what_keeps_the_code_from_being_written_is_said(number, tmp_path, monkeypatch):
    mkdir = os.mkdir

    def fail(path, *arguments, **options):
        if Path(path).name == "code":
            raise OSError(number, os.strerror(number))
        mkdir(path, *arguments, **options)

    monkeypatch.setattr(os, "mkdir", fail)
    with pytest.raises(OSError, match=f"cannot write C code: {os.strerror(number)}") as raised:
        tc.generate_c(regulator(), tmp_path)
    assert raised.value.errno == number
    assert not list(tmp_path.iterdir())


def test_generating_leaves_the_controller_as_it_was(tmp_path):
    """Also in the middle of a run: the next command is the same to the last bit."""
    nodes = scenes.plant("force_density").to_nodes(np.r_[0.02, np.zeros(8)])
    commands = []
    for generates in (False, True):
        mpc = scenes.with_load()
        for k in range(6):
            if k == 3 and generates:
                tc.generate_c(mpc, tmp_path)
            commands.append(mpc.command(k * scenes.SAMPLE, nodes, np.zeros((3, 6))).value)
    np.testing.assert_array_equal(commands[:6], commands[6:])
