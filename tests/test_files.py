"""Files are written whole or not at all, and errors say where and what to do."""

import errno
import os
import stat
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import pytest

import tenscontrol as tc
from tenscontrol import validation
from tenscontrol.files import make_folder, read_file, write_file
from tests.fuzz import disk


@pytest.mark.parametrize("name", ["run.npz", "accuracy.csv", "figure.png", "code"])
def test_what_was_there_stays_whole_where_a_writer_fails(name):
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)  # for another user to look into
        found = disk.tried(name, Path(folder), count=0)
    assert len(found) >= 4
    assert {label: said for label, said in found.items() if any(said)} == {}


def test_writers_on_a_full_and_a_read_only_file_system():
    if not disk.can_mount():
        pytest.skip("no file system can be mounted here")
    command = ["unshare", "-m", sys.executable, "-m", "tests.fuzz.disk", "--small", "--count", "0"]
    project = Path(__file__).parent.parent
    done = subprocess.run(
        [*command, "--only", "run.npz"], cwd=project, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("full ") == done.stdout.count("read-only") == 1


def test_a_slow_disk_shows_the_old_file_until_the_new_one_is_whole(tmp_path):
    assert disk.slow("run.npz", tmp_path) is None


def test_a_killed_writer_leaves_a_whole_file(tmp_path):
    assert disk.killed(tmp_path, 2) == [None, None]


def test_mode_and_links_stay(tmp_path):
    file, link = tmp_path / "file", tmp_path / "link"
    link.symlink_to(file)
    write_file(link, "one")  # where the link points there is nothing yet
    assert link.is_symlink()
    file.chmod(0o640)
    assert write_file(link, "two") == link
    assert link.is_symlink()
    assert file.read_text() == "two"
    assert stat.S_IMODE(file.stat().st_mode) == 0o640
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "link"]


@pytest.mark.skipif(os.name != "posix", reason="modes and pipes are POSIX")
def test_new_files_have_the_usual_mode_and_pipes_are_written_to(tmp_path):
    (tmp_path / "usual").write_text("")
    write_file(tmp_path / "file", "")
    assert (tmp_path / "file").stat().st_mode == (tmp_path / "usual").stat().st_mode
    os.mkfifo(tmp_path / "run.csv")
    got = []
    reader = threading.Thread(target=lambda: got.append((tmp_path / "run.csv").read_bytes()))
    reader.start()
    write_file(tmp_path / "run.csv", "1,2\n")
    reader.join()
    assert got == [b"1,2\n"]
    assert stat.S_ISFIFO((tmp_path / "run.csv").stat().st_mode)


def test_errors_hold_number_and_path(tmp_path):
    with pytest.raises(FileNotFoundError, match="make its folder first") as raised:
        write_file(tmp_path / "absent" / "file", "")
    assert raised.value.errno == errno.ENOENT
    assert raised.value.filename == str(tmp_path / "absent" / "file")
    (tmp_path / "file").write_text("")
    with pytest.raises(FileExistsError, match="give another name"):
        make_folder(tmp_path / "file")
    with pytest.raises(NotADirectoryError, match="what is in its place is a file"):
        make_folder(tmp_path / "file" / "below")


READERS = {
    "run": (".npz", tc.load_run),
    "structure in TOML": (".toml", tc.Structure.load),
    "structure in JSON": (".json", tc.Structure.load),
    "scene": (".toml", tc.load_scene),
    "nodes": (".csv", lambda path: tc.exchange.from_csv(path, path)),
    "members": (".csv", lambda path: tc.exchange.from_csv(_nodes(path), path)),
    "MJCF": (".xml", tc.exchange.from_mujoco),
    "sweep": (".jsonl", tc.robustness.SweepReport.load),
}


def _nodes(path):
    file = path.with_name("nodes.csv")
    file.write_text("x,y\n0,0\n1,0\n")
    return file


@pytest.mark.skipif(os.name != "posix", reason="pipes and sparse files are POSIX")
@pytest.mark.parametrize("name", READERS)
def test_readers_refuse_at_once_what_is_no_file_or_too_large(name, tmp_path):
    ending, read = READERS[name]
    path = tmp_path / f"file{ending}"
    refused = OSError if name != "scene" else tc.scene.SceneError
    for make, message in (
        (lambda: os.mkfifo(path), "cannot be read: it is a pipe or a device"),
        (lambda: path.symlink_to("/dev/zero"), "cannot be read: it is a pipe or a device"),
        (path.mkdir, "cannot be read: it is a folder"),
        (lambda: path.touch() or os.truncate(path, 10**11), "cannot be read: it is too large"),
        (lambda: None, "cannot be read: No such file"),
    ):
        make()
        with pytest.raises(refused, match=message) as raised:
            read(path)
        assert str(path) in str(raised.value)
        if path.is_dir():
            path.rmdir()
        path.unlink(missing_ok=True)


@pytest.mark.skipif(os.name != "posix", reason="pipes are POSIX")
def test_a_pipe_that_takes_the_place_of_a_file_is_not_waited_for(tmp_path, monkeypatch):
    path = tmp_path / "file"
    path.write_text("")
    found = path.stat()
    path.unlink()
    os.mkfifo(path)
    monkeypatch.setattr(Path, "stat", lambda path: found)
    with pytest.raises(OSError, match="it is a pipe or a device") as raised:
        read_file(path, 10)
    assert (raised.value.errno, raised.value.filename) == (errno.EINVAL, str(path))


@pytest.mark.parametrize(
    ("path", "error", "message"),
    [
        (None, TypeError, "path is None, expected a path"),
        (3, TypeError, "path is 3, expected a path"),
        ("", ValueError, "path is '', expected a name that a file can have"),
        ("a\0b.png", ValueError, "expected a name that a file can have"),
        ("\ud800.png", ValueError, "expected a name that a file can have"),
        (b"a.png", TypeError, "expected a path"),
    ],
)
def test_names_that_no_file_can_have(path, error, message):
    for call in (
        lambda: validation.file_path("path", path),
        lambda: tc.plot.save_figure(disk.figure(), path),
        lambda: tc.plot.animate(disk.run(), path),
        lambda: disk.measured().to_csv(path),
        lambda: disk.run().save(path),
        lambda: disk.run().to_csv(path),
        lambda: tc.prism().save(path),
        lambda: tc.load_run(path),
    ):
        with pytest.raises(error, match=message):
            call()


def test_the_ending_says_the_format(tmp_path):
    for name in ("figure", "figure.xyz", "folder.png/figure"):
        with pytest.raises(ValueError, match=r"expected a name ending in .*\.pdf.*\.png"):
            tc.plot.save_figure(disk.figure(), tmp_path / name)
    for name in ("figure.PNG", "figure.svg"):
        assert tc.plot.save_figure(disk.figure(), str(tmp_path / name)).exists()


@pytest.mark.parametrize("what", [[], None, "figure", tc])
def test_figures_and_motions_of_another_kind(what, tmp_path):
    with pytest.raises(TypeError, match=r"figure is a \w+, expected Figure: take ax.figure"):
        tc.plot.save_figure(what, tmp_path / "figure.png")
    assert list(tmp_path.iterdir()) == []
