"""Sweeps: the same numbers from any executor, from a file, and after a failure."""

import json
import os
import signal
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import matplotlib.pyplot as plt
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.robustness import pool
from tests.robustness import cases
from tests.robustness.cases import PARAMETERS, Inline, Waiting

COUNT, SEED = 24, 7


def without_back_end(report):
    """The summary that a report from a file has."""
    return "\n".join(line for line in report.summary().splitlines() if line[:5] != "runs ")


def lines(report):
    """Every number and text of a report, to the last bit."""
    return [json.dumps(vars(record)) for record in report._records]


def inline(case=cases.noisy, parameters=PARAMETERS, count=COUNT, **options):
    """A sweep in this process, with what was handed to the executor."""
    executor = Inline()
    report = tc.sweep(case, parameters, count, **({"seed": SEED, "executor": executor} | options))
    return report, executor.runs


@pytest.fixture(scope="module")
def report():
    return inline()[0]


class TestNumbersDoNotDependOnTheWorkers:
    def test_the_case_has_every_fate(self, report):
        assert report.is_complete
        assert 0 < len(report.failures) < COUNT
        assert 0 < report.success.sum() < report.completed.sum() < COUNT

    def test_processes(self, report):
        found = tc.sweep(cases.noisy, PARAMETERS, COUNT, seed=SEED, processes=2)
        assert lines(found) == lines(report)
        assert found == report

    def test_threads_which_are_left_running(self, report):
        with ThreadPoolExecutor(3) as executor:
            found = tc.sweep(cases.noisy, PARAMETERS, COUNT, seed=SEED, executor=executor)
            assert executor.submit(int, "3").result() == 3
        assert lines(found) == lines(report)

    def test_dask(self, report):
        distributed = pytest.importorskip("distributed")
        with (
            distributed.LocalCluster(
                n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0"
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            found = tc.sweep(
                cases.noisy, PARAMETERS, COUNT, seed=SEED, executor=client.get_executor()
            )
        assert lines(found) == lines(report)

    def test_another_seed_gives_other_numbers(self, report):
        other, _ = inline(seed=SEED + 1)
        assert not np.isin(other.parameters["mass"], report.parameters["mass"]).any()
        assert other != report

    def test_more_runs_leave_the_first_as_they_are(self, report):
        assert lines(inline(count=COUNT + 5)[0])[:COUNT] == lines(report)

    def test_runs_and_parameters_have_the_streams_that_numpy_spawns(self):
        found, _ = inline(cases.first_of_the_stream, {}, count=4)
        spawned = [run.spawn(2)[1] for run in np.random.SeedSequence(SEED).spawn(4)]
        first = [np.random.default_rng(stream).random() for stream in spawned]
        assert found.figure("first").tolist() == first

    def test_a_further_parameter_changes_no_other(self, report):
        more = {"added": tc.Uniform(0, 1), **dict(reversed(PARAMETERS.items()))}
        found, _ = inline(parameters=more)
        assert np.array_equal(found.parameters["mass"], report.parameters["mass"])
        assert found.success.tolist() == report.success.tolist()

    def test_nothing_passes_from_run_to_run_in_the_case(self):
        found, _ = inline(cases.Remembering(), {}, count=5)
        assert found.figure("calls").tolist() == [1.0] * 5

    def test_a_bounded_number_of_runs_is_handed_out_at_a_time(self, report):
        with Waiting() as executor:
            found = tc.sweep(
                cases.noisy, PARAMETERS, COUNT, seed=SEED, executor=executor, in_flight=3
            )
        assert executor.most == 3
        assert found == report


class TestDistributions:
    # Kolmogorov and Smirnov: a sample of 600 is off by 0.067 once in a hundred.
    @pytest.mark.parametrize(
        ("distribution", "share"),
        [
            (tc.Uniform(2.0, 4.0, size=3), lambda x: (x - 2.0) / 2.0),
            (tc.Normal(1.0, 0.5, size=3), lambda x: _normal((x - 1.0) / 0.5)),
        ],
    )
    def test_numbers_are_distributed_as_they_should(self, distribution, share):
        found, _ = inline(cases.first_of_the_stream, {"x": distribution}, count=200)
        drawn = np.sort(found.parameters["x"].ravel())
        expected = share(drawn)
        assert np.abs(expected - np.arange(1, 601) / 600).max() < 0.067
        # Entries of one run have nothing to do with each other: 0.07 is the deviation of each.
        across = np.corrcoef(found.parameters["x"].T)[np.triu_indices(3, 1)]
        assert np.abs(across).max() < 4 * 0.07

    def test_one_of_draws_each_value(self):
        found, _ = inline(cases.first_of_the_stream, {"x": tc.OneOf([1, 2, 4])}, count=90)
        values, counts = np.unique(found.parameters["x"], return_counts=True)
        assert values.tolist() == [1.0, 2.0, 4.0]
        assert counts.min() > 18  # 30 expected, deviation 4.5

    def test_a_case_cannot_write_to_its_parameters(self):
        found, _ = inline(cases.writes_to_its_parameters, count=2)
        assert {failure.error for failure in found.failures} == {"ValueError"}


def _normal(x):
    from scipy.special import ndtr

    return ndtr(x)


class TestFailuresAreData:
    def test_kind_and_text_are_kept(self, report):
        failure = report.failures[0]
        assert (failure.error, failure.message[:11]) == ("ArithmeticError", "ran away at")
        assert not report.completed[failure.run]
        assert not report.success[failure.run]
        assert report.success_rate == report.success.sum() / COUNT

    def test_figures_are_those_of_completed_runs(self, report):
        values = report.figures["value"]
        assert len(values) == report.completed.sum()
        first = report.parameters["mass"][report.completed, 0]
        assert np.array_equal(report.figures["first_mass"], first)

    def test_a_figure_that_is_no_number_is_a_failure(self):
        found, _ = inline(cases.not_a_number, count=2)
        assert found.figures == {}
        assert "figures['error'] is nan" in found.failures[0].message

    def test_a_worker_that_dies_is_named_and_the_other_runs_are_kept(self, tmp_path):
        file, drawn = tmp_path / "runs.jsonl", {"x": tc.Uniform(0, 1)}
        x = inline(cases.first_of_the_stream, drawn, count=16)[0].parameters["x"]
        deadly = int(np.flatnonzero(x < 0.05)[0])
        assert deadly >= 4  # so that there are others before it
        with pytest.raises(
            tc.robustness.SweepError, match=rf"worker process died.*\b{deadly}\b"
        ) as raised:
            tc.sweep(cases.dies, drawn, 16, seed=SEED, processes=1, file=file)
        kept = raised.value.report.runs.tolist()
        assert set(range(deadly - 1)) <= set(kept) <= set(range(deadly))
        assert tc.robustness.SweepReport.load(file).runs.tolist() == kept

    @pytest.mark.parametrize(
        ("case", "message"),
        [
            (cases.returns_a_number, "run 0 stopped.*returned a float, expected Outcome"),
            (cases.without_memory, "run 0 stopped the sweep: MemoryError: none left"),
            (cases.stops_the_sweep, "run 0 stopped the sweep: SweepError: no such parameter"),
            (cases.changing_figures, r"has the figures \['[ab]'\], but run 0 has \['[ab]'\]"),
        ],
    )
    def test_a_case_that_is_wrong_stops_the_sweep(self, case, message):
        with pytest.raises(tc.robustness.SweepError, match=message) as raised:
            inline(case, {"x": tc.Uniform(0, 1)})
        assert len(raised.value.report) < COUNT

    def test_ctrl_c_returns_what_is_done(self, report, tmp_path):
        file = tmp_path / "runs.jsonl"
        with pytest.warns(RuntimeWarning, match="interrupted with 6 of 24 runs done"):
            part = tc.sweep(
                cases.noisy, PARAMETERS, COUNT, seed=SEED, file=file,
                executor=Inline(interrupt_after=6), in_flight=1,
            )  # fmt: skip
        assert lines(part) == lines(report)[: len(part)]
        whole, runs = inline(file=file)
        assert lines(whole) == lines(report)
        assert runs == [0, *range(len(part), COUNT)]

    def test_ctrl_c_raises_nothing_while_locks_are_taken(self, monkeypatch):
        waited, wait = [], pool.wait

        def interrupted(*arguments):
            signal.raise_signal(signal.SIGINT)
            waited.append(arguments)
            return wait(*arguments)

        monkeypatch.setattr(pool, "wait", interrupted)
        with pytest.warns(RuntimeWarning, match="interrupted with 1 of 24 runs"):
            inline(in_flight=1)
        assert len(waited) == 1

    def test_ctrl_c_waits_for_no_process_that_has_yet_to_begin(self, monkeypatch):
        def interrupted(pending, *_):
            signal.raise_signal(signal.SIGINT)
            return set(), pending

        monkeypatch.setattr(pool, "wait", interrupted)
        monkeypatch.setattr(pool, "_begin_work", cases.never_begins)
        with pytest.warns(RuntimeWarning, match="interrupted with 0 of 24 runs"):
            tc.sweep(cases.noisy, PARAMETERS, COUNT, seed=SEED, processes=2)

    def test_ctrl_c_leaves_a_run_in_file_and_report_or_in_neither(self, tmp_path, monkeypatch):
        file, synced, fsync = tmp_path / "runs.jsonl", [], os.fsync

        def interrupted(descriptor):
            synced.append(descriptor)
            if len(synced) == 5:  # the empty file and its header were the first
                signal.raise_signal(signal.SIGINT)
                time.sleep(0.6)  # a slow disk
            fsync(descriptor)

        monkeypatch.setattr(os, "fsync", interrupted)
        with pytest.warns(RuntimeWarning, match="interrupted with 3 of 24 runs"):
            part, _ = inline(file=file, in_flight=1)
        assert lines(part) == file.read_text("utf-8").splitlines()[1:]


def other_outcome(line):
    """The line of a run of which something else came."""
    found = json.loads(line)
    figures = {"value": 1.0, "first_mass": 1.0}
    changed = {"success": True, "error": None, "message": None, "figures": figures}
    return json.dumps(found | changed) + "\n"


class TestFile:
    @pytest.fixture
    def file(self, tmp_path):
        path = tmp_path / "runs.jsonl"
        inline(file=path)
        return path

    def test_what_is_written_comes_back_to_the_last_bit(self, file, report):
        assert tc.robustness.SweepReport.load(file) == report
        assert lines(tc.robustness.SweepReport.load(file)) == lines(report)

    def test_runs_in_another_order_are_the_same_report(self, file, report):
        head, *rest = file.read_text("utf-8").splitlines(keepends=True)
        file.write_text(head + "".join(reversed(rest)), "utf-8")
        assert tc.robustness.SweepReport.load(file) == report

    @pytest.mark.parametrize("torn", [False, True])
    def test_a_killed_sweep_goes_on(self, file, report, torn):
        head, *rest = file.read_bytes().splitlines(keepends=True)
        file.write_bytes(head + b"".join(rest[:9]) + torn * rest[9][:30])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found, runs = inline(file=file)
        assert [str(each.message).split(" ends in ")[1][:18] for each in caught] == [
            "an incomplete line"
        ] * torn
        assert runs == [0, *range(9, COUNT)]
        assert lines(found) == lines(report)
        assert tc.robustness.SweepReport.load(file) == report  # nothing torn is left in it

    def test_a_finished_sweep_does_one_run_to_see_that_it_is_the_same(self, file, report):
        found, runs = inline(file=file)
        assert (found, runs) == (report, [0])

    def test_a_case_that_has_changed_is_noticed(self, file):
        head, first, *rest = file.read_text("utf-8").splitlines(keepends=True)
        file.write_text(head + other_outcome(first) + "".join(rest), "utf-8")
        with pytest.raises(
            tc.robustness.SweepError, match=r"run 0 of the file gave .* case, a library or"
        ):
            inline(file=file)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"seed": 8}, "seed is 7 there and 8 here"),
            ({"case": cases.Remembering()}, "case is 'noisy' there and 'Remembering' here"),
            ({"parameters": PARAMETERS | {"mass": tc.Uniform(0.7, 1.2, size=3)}},
             "parameter 'mass' is .*'low': 0.8.* there and .*'low': 0.7.* here"),
            ({"parameters": PARAMETERS | {"x": tc.OneOf([1])}}, "parameter 'x' is None there"),
        ],
    )  # fmt: skip
    def test_the_file_of_another_sweep_is_refused(self, file, change, message):
        before = file.read_bytes()
        with pytest.raises(ValueError, match=message):
            inline(**({"file": file} | change))
        assert file.read_bytes() == before

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            ("notes", "is not a sweep file"),
            ("notes\n", "is not a sweep file: its first line is not a header"),
            ("HEAD\n{}\n", "line 2 is not a run"),
            (
                "HEAD\nFIRST\nFIRST\n",
                "line 3 is not a run: run is 0, expected each of 0 to 23 once",
            ),
            ("HEAD\n[]\n", "line 2 is not a run"),
            (
                'HEAD\n{"count": 24}\n',
                "line 2 is not a run: count is 24.* at least 25",
            ),
            ('HEAD\n{"count": true}\n', "line 2 is not a run: count is True"),
        ],
    )
    def test_what_is_no_sweep_is_refused(self, file, content, message):
        head, first, *_ = file.read_text("utf-8").splitlines()
        file.write_text(content.replace("HEAD", head).replace("FIRST", first), "utf-8")
        for use in (tc.robustness.SweepReport.load, lambda path: inline(file=path)):
            with pytest.raises(ValueError, match=message):
                use(file)


class TestAnotherNumberOfRuns:
    """A longer sweep is the same sweep with more runs, a shorter one the same with fewer."""

    LESS = 10

    @pytest.fixture
    def file(self, tmp_path):
        path = tmp_path / "runs.jsonl"
        inline(count=self.LESS, file=path)
        return path

    def test_more_runs_are_added(self, file, report):
        found, runs = inline(file=file)
        assert runs == [0, *range(self.LESS, COUNT)]
        assert lines(found) == lines(report)
        for same in (found, tc.robustness.SweepReport.load(file), inline(file=file)[0]):
            assert same == report
            assert same.summary() in (report.summary(), without_back_end(report))

    def test_it_can_be_made_longer_again_on_other_workers(self, file, report):
        inline(count=self.LESS + 3, file=file)
        with ThreadPoolExecutor(2) as executor:
            found = tc.sweep(
                cases.noisy, PARAMETERS, COUNT, seed=SEED, file=file, executor=executor
            )
        assert lines(found) == lines(report)
        assert tc.robustness.SweepReport.load(file) == report

    def test_fewer_runs_are_the_first_ones_and_the_file_keeps_all(self, file):
        inline(file=file)
        before = file.read_bytes()
        found, runs = inline(count=self.LESS, file=file)
        assert runs == [0]
        assert found == inline(count=self.LESS)[0]
        assert found.is_complete
        assert file.read_bytes() == before

    def test_fewer_runs_of_an_unfinished_sweep(self, file, report):
        """Of a sweep of 24 the runs 9 and 20 are done; then 10 are asked for, then all."""
        inline(file=file)
        head, *rest = file.read_text("utf-8").splitlines(keepends=True)
        kept = [line for line in rest if json.loads(line).get("run", 20) in (9, 20)]
        file.write_text(head + "".join(kept), "utf-8")
        found, runs = inline(count=self.LESS, file=file)
        assert runs == [9, *range(9)]
        assert found == inline(count=self.LESS)[0]
        part = tc.robustness.SweepReport.load(file)
        assert (part.count, part.runs.tolist()) == (COUNT, [*range(10), 20])
        assert inline(file=file)[0] == report

    def test_interrupted_runs_are_counted_without_those_beyond(self, file):
        inline(file=file)
        head, *rest = file.read_text("utf-8").splitlines(keepends=True)
        file.write_text(head + "".join(rest[3:]), "utf-8")
        with pytest.warns(RuntimeWarning, match="interrupted with 8 of 10 runs done"):
            part = tc.sweep(
                cases.noisy, PARAMETERS, self.LESS, seed=SEED, file=file,
                executor=Inline(interrupt_after=2), in_flight=1,
            )  # fmt: skip
        assert part.runs.tolist() == [0, *range(3, self.LESS)]

    @pytest.mark.parametrize("left", ["line of the count", "line of a run"])
    def test_a_torn_line_of_a_longer_sweep(self, file, report, left):
        short = len(file.read_bytes())
        inline(file=file)
        keep = short + 8 if left == "line of the count" else len(file.read_bytes()) - 30
        file.write_bytes(file.read_bytes()[:keep])
        with pytest.warns(RuntimeWarning, match="incomplete line, which is ignored"):
            part = tc.robustness.SweepReport.load(file)
        torn_count = left == "line of the count"
        assert (part.count, len(part)) == ((self.LESS,) * 2 if torn_count else (COUNT, COUNT - 1))
        with pytest.warns(RuntimeWarning, match="incomplete line, which is ignored"):
            found, _ = inline(file=file)
        assert lines(found) == lines(report)
        assert tc.robustness.SweepReport.load(file) == report

    def test_a_case_that_has_changed_adds_nothing(self, file):
        head, first, *rest = file.read_text("utf-8").splitlines(keepends=True)
        file.write_text(head + other_outcome(first) + "".join(rest), "utf-8")
        before = file.read_bytes()
        with (
            ThreadPoolExecutor(2) as executor,
            pytest.raises(tc.robustness.SweepError, match="run 0 of the"),
        ):
            tc.sweep(cases.noisy, PARAMETERS, COUNT, seed=SEED, file=file, executor=executor)
        assert file.read_bytes() == before

    def test_the_figure_of_a_sweep_made_longer_is_that_of_one_at_once(self, file, report):
        drawn = [tc.plot.sweep(each, "value") for each in (inline(file=file)[0], report)]
        (one, other) = (each.curve.get_xydata() for each in drawn)
        assert np.array_equal(one, other)
        assert one.shape == (report.completed.sum(), 2)
        (one, other) = (
            {name: line.get_xydata().tolist() for name, line in each.markers.items()}
            for each in drawn
        )
        assert one == other
        plt.close("all")
