"""The file of a sweep: what spoils it, who writes to it, and disks that fail."""

import json
import os
import subprocess
import sys
import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

import tenscontrol as tc
from tenscontrol.robustness import store
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


def respelt(file, number, change):
    """Change what a line says, counted from 0."""
    lines = file.read_text("utf-8").split("\n")
    content = json.loads(lines[number])
    change(content)
    lines[number] = json.dumps(content)
    file.write_text("\n".join(lines), "utf-8")


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
            (put("run", -1), r"run is -1, expected each of 0 to 11 once"),
            (put("parameters", []), r"line \d+ is not a run: parameters is \[\]"),
            (put("success", "false"), r"success is 'false'"),
            (put("parameters", "delay", [1.0]), r"parameters are .*, expected the shapes"),
            (put("figures", {"other": 1.0}), r"run \d+ has the figures"),
            (put("more", 3), r".*unexpected keyword argument 'more'"),
        ],
    )
    def test_what_is_no_run_of_the_sweep_is_refused(self, file, change, message):
        number = 1 + int(tc.robustness.SweepReport.load(file).completed.argmax())
        respelt(file, number, change)
        for use in (tc.robustness.SweepReport.load, swept):
            with pytest.raises(ValueError, match=message):
                use(file)

    @pytest.mark.parametrize("number", [3, COUNT])
    def test_parameters_come_from_the_seed(self, file, number):
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


def test_an_empty_file_is_begun(tmp_path, report):
    (tmp_path / "runs.jsonl").touch()
    assert swept(tmp_path / "runs.jsonl") == report


def test_another_file_is_left_alone(file):
    file.write_text('{"other": 3}', "utf-8")
    with pytest.raises(ValueError, match="is not a sweep file"):
        swept(file)
    assert file.read_text("utf-8") == '{"other": 3}'


HOLDER = """
import sys, time
from pathlib import Path
from tenscontrol.robustness import store
with store._locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(600)
"""


class TestOneWriter:
    def test_a_second_sweep_is_refused_at_once(self, file):
        before = file.read_bytes()
        with (
            store._locked(file),
            pytest.raises(BlockingIOError, match="another sweep writes to this file"),
        ):
            swept(file)
        assert file.read_bytes() == before

    def test_a_report_can_be_read_meanwhile(self, file, report):
        with store._locked(file):
            assert tc.robustness.SweepReport.load(file) == report

    def test_a_lock_ends_with_its_process(self, file, report):
        with subprocess.Popen(
            [sys.executable, "-c", HOLDER, file], stdout=subprocess.PIPE, text=True,
            env=os.environ | {"PYTHONPATH": str(Path(tc.__file__).parents[1])},
        ) as process:  # fmt: skip
            assert process.stdout.readline() == "locked\n"
            with pytest.raises(BlockingIOError):
                swept(file)
            process.kill()
        assert swept(file) == report


class TestDisks:
    @pytest.mark.skipif(os.name == "nt", reason="no limits of the size of a file")
    @pytest.mark.parametrize("lines", [0.5, 1, 1.5, 5.3])
    @pytest.mark.filterwarnings("ignore:.*incomplete line")
    def test_a_full_disk_is_told_and_the_sweep_goes_on_from_there(
        self, tmp_path, file, report, lines
    ):
        import resource

        whole = file.read_bytes().splitlines(keepends=True)
        size = int(sum(map(len, whole[: int(lines)])) + lines % 1 * len(whole[int(lines)]))
        path = tmp_path / "more.jsonl"
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            with pytest.raises(OSError, match=r"cannot write: .*too large.*more\.jsonl"):
                swept(path, in_flight=1)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
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

    @pytest.mark.skipif(os.name == "nt", reason="no such pipes")
    def test_a_pipe_is_refused(self, tmp_path):
        os.mkfifo(tmp_path / "pipe")
        for use in (tc.robustness.SweepReport.load, swept):
            with pytest.raises(OSError, match="it is a pipe or a device"):
                use(tmp_path / "pipe")


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
