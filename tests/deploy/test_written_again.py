"""Controllers that are written into the folder of an earlier call."""

import subprocess
from hashlib import sha256
from shutil import which

import numpy as np
import pytest

import tenscontrol as tc
from tests.deploy import scenes


def mpc(horizon):
    plant = scenes.plant("force_density")
    return tc.MPC(
        plant,
        horizon=horizon,
        sample_time=scenes.SAMPLE,
        max_force_density=np.inf,
        time_limit=np.inf,
    )


def files(folder):
    return sorted(path.name for path in folder.iterdir())


def test_the_files_of_an_earlier_call_are_replaced(tmp_path):
    tc.generate_c(mpc(3), tmp_path)
    made = tc.generate_c(mpc(4), tmp_path)
    fresh = tc.generate_c(mpc(4), tmp_path / "fresh")
    assert files(tmp_path) == sorted([*made.files, "fresh"])
    for file in fresh.files:
        assert (tmp_path / file).read_text() == (tmp_path / "fresh" / file).read_text()


def test_those_of_another_name_or_law_go(tmp_path):
    tc.generate_c(mpc(3), tmp_path)
    plant = scenes.plant("force_density")
    law = tc.LQR(plant, *tc.energy_weights(plant), sample_time=scenes.SAMPLE)
    made = tc.generate_c(law, tmp_path, name="other")
    assert files(tmp_path) == sorted(made.files)
    assert "controller.c" not in made.files


@pytest.mark.skipif(which("sha256sum") is None, reason="needs sha256sum")
def test_the_list_of_files_can_be_checked(tmp_path):
    made = tc.generate_c(mpc(3), tmp_path)
    done = subprocess.run(
        ["sha256sum", "--check", "--strict", "SHA256SUMS"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("OK") == len(made.files) - 1


def test_what_others_put_there_stays(tmp_path):
    tc.generate_c(mpc(3), tmp_path)
    (tmp_path / "replay").write_bytes(b"a program")
    (tmp_path / "main.c").unlink()
    tc.generate_c(mpc(4), tmp_path)
    assert (tmp_path / "replay").read_bytes() == b"a program"
    assert (tmp_path / "main.c").exists()


@pytest.mark.parametrize("file", ["main.c", "controller.h"])
def test_a_file_that_was_changed_is_not_replaced(file, tmp_path):
    tc.generate_c(mpc(3), tmp_path)
    mine = (tmp_path / file).read_text() + "\n/* mine */\n"
    (tmp_path / file).write_text(mine)
    before = {name: (tmp_path / name).read_bytes() for name in files(tmp_path)}
    with pytest.raises(FileExistsError, match=f"has '{file}', which is not as an earlier call"):
        tc.generate_c(mpc(4), tmp_path)
    assert before == {name: (tmp_path / name).read_bytes() for name in files(tmp_path)}


def test_other_c_files_are_refused(tmp_path):
    tc.generate_c(mpc(3), tmp_path)
    (tmp_path / "mine.c").write_text("int mine;")
    with pytest.raises(FileExistsError, match=r"has 'mine\.c'"):
        tc.generate_c(mpc(3), tmp_path)
    (tmp_path / "mine.c").unlink()
    (tmp_path / "other_data.h").write_text("int mine;")
    with pytest.raises(FileExistsError, match=r"has 'other_data\.h'"):
        tc.generate_c(mpc(3), tmp_path, name="other")


def test_a_list_of_files_of_others_does_not_count(tmp_path):
    """Nor does one of ours that names files elsewhere."""
    (tmp_path / "data.csv").write_text("1, 2")
    theirs = f"{sha256(b'1, 2').hexdigest()}  data.csv\n"
    head = tc.generate_c(mpc(3), tmp_path / "ours").folder.joinpath("SHA256SUMS").read_text()
    head = head.splitlines()[0]
    for text in ("", "mine", theirs, f"{head}\n{'0' * 64}  ../x.c\n"):
        (tmp_path / "SHA256SUMS").write_text(text)
        with pytest.raises(FileExistsError, match="is not empty"):
            tc.generate_c(mpc(3), tmp_path)
        assert files(tmp_path) == ["SHA256SUMS", "data.csv", "ours"]
