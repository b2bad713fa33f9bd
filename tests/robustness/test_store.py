"""The file of a sweep: what spoils it, who writes to it, and disks that fail."""

import json
import os
import subprocess
import sys
import time
import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from zlib import crc32

import pytest

import tenscontrol as tc
from tenscontrol import processes
from tests.robustness import cases
from tests.robustness.cases import PARAMETERS, Inline

COUNT, SEED = 12, 7


def swept(file=None, **options):
    return tc.sweep(
        cases.noisy, PARAMETERS, COUNT, seed=SEED, file=file, **({"executor": Inline()} | options)
    )


@pytest.fixture(scope="module")
def report():
    return swept()


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "runs.jsonl"
    swept(path)
    return path


def signed(content):
    """A line with the check sum of what it says, whatever that is."""
    text = json.dumps(content)
    return f'{text[:-1]}, "check": "{crc32(text.encode()):08x}"}}'.encode()


def respelt(file, number, change):
    """Change what a line says, counted from 0, and its check sum with it."""
    lines = file.read_bytes().split(b"\n")
    content = json.loads(lines[number])
    del content["check"]
    change(content)
    lines[number] = signed(content)
    file.write_bytes(b"\n".join(lines))


def put(*path_and_value):
    """A change of an entry."""
    *path, last, value = path_and_value

    def change(content):
        for name in path:
            content = content[name]
        content[last] = value

    return change


class TestLines:
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (put("success", "false"), r"success is 'false', expected bool"),
            (put("success", 1), r"success is 1, expected bool"),
            (put("run", True), r"run is True, expected int"),
            (put("run", 1.0), r"run is 1\.0, expected int"),
            (put("run", -1), r"run is -1, expected each of 0 to 11 once"),
            (put("parameters", []), r"parameters is \[\], expected dict"),
            (put("parameters", "delay", float("nan")), r"parameters is .*expected dict.*, finite"),
            (put("parameters", "mass", 1, "1.0"), r"parameters is .*expected dict\[str, Drawn\]"),
            (put("parameters", "mass", 1, True), r"parameters is .*expected dict\[str, Drawn\]"),
            (put("figures", "value", float("inf")), r"figures is .*expected .*, finite"),
            (put("figures", "value", [1.0]), r"figures is .*expected dict\[str, float\]"),
            (put("figures", [1.0]), r"figures is \[1\.0\], expected dict\[str, float\] | None"),
            (put("message", 3), r"message is 3, expected str"),
            (put("more", 3), r".*unexpected keyword argument 'more'"),
        ],
    )
    def test_fields_are_of_their_kinds(self, file, change, message):
        number = 1 + int(tc.robustness.SweepReport.load(file).completed.argmax())
        respelt(file, number, change)
        for use in (tc.robustness.SweepReport.load, swept):
            with pytest.raises(
                ValueError, match=rf"jsonl, line {number + 1} is not a run: {message}"
            ):
                use(file)

    @pytest.mark.parametrize(
        ("old", "new"),
        [(b'"value": 3.', b'"value": 4.'), (b'"value"', b'"other"'), (b'"error": null, ', b"")],
    )
    def test_what_was_changed_is_refused(self, file, old, new):
        changed = file.read_bytes().replace(old, new, 1)
        assert changed != file.read_bytes()
        file.write_bytes(changed)
        for use in (tc.robustness.SweepReport.load, swept):
            with pytest.raises(ValueError, match=r"line \d+ is not a run: it was changed after"):
                use(file)

    @pytest.mark.parametrize("number", [3, COUNT])
    def test_parameters_come_from_the_seed(self, file, number):
        """Also where the check sum is right."""
        respelt(file, number, put("parameters", "delay", 0.0625))
        with pytest.raises(
            ValueError,
            match=rf"line {number + 1} is not a run: parameters are .* those of the seed 7",
        ):
            swept(file)

    def test_deep_nesting_is_refused(self, file):
        file.write_bytes(file.read_bytes() + b"[" * 100_000 + b"\n")
        with pytest.raises(ValueError, match=r"line 14 is not a run: .*nested too deep"):
            swept(file)

    def test_other_encodings_are_refused(self, file):
        file.write_bytes(file.read_bytes().replace(b'"delay"', b'"d\xe9lay"', 1))
        with pytest.raises(ValueError, match="is not a sweep file: its first line"):
            swept(file)


class TestTornHeader:
    @pytest.mark.parametrize("length", [0, 1, 40])
    def test_it_is_begun_anew(self, file, report, length, recwarn):
        file.write_bytes(file.read_bytes()[:length])
        assert swept(file) == report
        told = [str(each.message).split("jsonl ")[1] for each in recwarn]
        assert told == ["has an incomplete header and no run; it is started again"] * (length > 0)
        assert tc.robustness.SweepReport.load(file) == report

    def test_another_file_is_left_alone(self, file):
        file.write_text('{"other": 3}', "utf-8")
        with pytest.raises(ValueError, match="is not a sweep file"):
            swept(file)
        assert file.read_text("utf-8") == '{"other": 3}'


HOLDER = """
import sys, time
from pathlib import Path
from tenscontrol import processes
with processes.locked_file(Path(sys.argv[1])) as (_, locked):
    print(locked, flush=True)
    time.sleep(600)
"""


class TestOneWriter:
    def test_a_second_sweep_is_refused_at_once(self, file):
        before = file.read_bytes()
        with (
            processes.locked_file(file),
            pytest.raises(BlockingIOError, match="another sweep writes to this file"),
        ):
            swept(file)
        assert file.read_bytes() == before

    def test_a_report_can_be_read_meanwhile(self, file, report):
        with processes.locked_file(file):
            assert tc.robustness.SweepReport.load(file) == report

    def test_a_lock_ends_with_its_process(self, file, report):
        with subprocess.Popen(
            [sys.executable, "-c", HOLDER, file], stdout=subprocess.PIPE, text=True,
            env=os.environ | {"PYTHONPATH": str(Path(tc.__file__).parents[1])},
        ) as process:  # fmt: skip
            assert process.stdout.readline() == "True\n"
            with pytest.raises(BlockingIOError):
                swept(file)
            process.kill()
        assert swept(file) == report

    @pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
    @pytest.mark.filterwarnings("ignore::DeprecationWarning")
    def test_a_fork_does_not_keep_it(self, file, report):
        """Workers of an executor of the user may outlive a process that is killed."""
        begun, begin = os.pipe()
        with processes.locked_file(file):
            child = os.fork()
            if child == 0:
                os.write(begin, b"x")
                time.sleep(600)
            os.read(begun, 1)
        try:
            assert swept(file) == report
        finally:
            os.kill(child, 9)
            os.waitpid(child, 0)
            os.close(begun)
            os.close(begin)

    def test_a_file_system_without_locks_is_told(self, file, report, monkeypatch):
        monkeypatch.setattr(processes, "_locked", lambda descriptor: None)
        with pytest.warns(RuntimeWarning, match="has no locks: let no other sweep write"):
            assert swept(file) == report


class TestDisks:
    @pytest.mark.skipif(os.name == "nt", reason="no limits of the size of a file")
    @pytest.mark.parametrize("lines", [0.5, 1, 1.5, 5.3])
    def test_a_full_disk_is_told_and_nothing_is_torn(self, tmp_path, file, report, lines):
        import resource

        whole = file.read_bytes().splitlines(keepends=True)
        size = int(sum(map(len, whole[: int(lines)])) + lines % 1 * len(whole[int(lines)]))
        path = tmp_path / "more.jsonl"
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            with pytest.raises(OSError, match=r"too large; the runs so far are kept.*more\.jsonl"):
                swept(path, in_flight=1)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert path.read_bytes() == b"".join(whole[: int(lines)])
        assert swept(path) == report

    def test_a_file_of_lines_alone_is_not_taken_apart_before_it_is_refused(self, tmp_path, file):
        path = tmp_path / "lines.jsonl"
        path.write_bytes(file.read_bytes().splitlines(keepends=True)[0] + b"\n" * 2_000_000)
        tracemalloc.start()
        try:
            with pytest.raises(ValueError, match="line 2 is not a run"):
                tc.robustness.SweepReport.load(path)
            assert tracemalloc.get_traced_memory()[1] < 1e7
        finally:
            tracemalloc.stop()

    @pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device")
    def test_a_device_is_refused(self):
        for use in (tc.robustness.SweepReport.load, swept):
            with pytest.raises(OSError, match="it is a pipe or a device"):
                use("/dev/full")


def test_runs_that_are_done_when_ctrl_c_comes_are_kept(tmp_path):
    with pytest.warns(RuntimeWarning, match="interrupted with 6 of 12 runs done"):
        part = swept(tmp_path / "runs.jsonl", executor=Inline(interrupt_after=6), in_flight=4)
    assert part.runs.tolist() == list(range(6))
    assert tc.robustness.SweepReport.load(tmp_path / "runs.jsonl") == part


@pytest.mark.skipif(os.name == "nt", reason="there are no forks")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_an_executor_that_forks(file, report):
    file.write_bytes(b"".join(file.read_bytes().splitlines(keepends=True)[:4]))
    import multiprocessing

    with ProcessPoolExecutor(2, multiprocessing.get_context("fork")) as executor:
        assert swept(file, executor=executor) == report
