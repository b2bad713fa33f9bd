"""The progress bar on a terminal, and the note elsewhere."""

import io
import sys

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol import progress
from tenscontrol.progress import progress_bar


class Terminal(io.StringIO):
    def isatty(self):
        return True


def closed():
    stream = Terminal()
    stream.close()
    return stream


class Bare:
    """A stream that can only be written to, as some windows of text are."""

    def write(self, text):
        raise AssertionError(f"{text!r} is written to what is no terminal")


def test_it_shows_on_a_terminal(monkeypatch):
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    with progress_bar(2.0, shown=True) as report:
        report(2.0)
    assert "2.00/2.00 s" in stream.getvalue()


@pytest.mark.parametrize("stream", [None, closed(), io.StringIO(), Bare()], ids=type)
def test_it_does_not_show_elsewhere(monkeypatch, stream):
    monkeypatch.setattr(sys, "stderr", stream)
    with progress_bar(2.0, shown=True) as report:
        report(2.0)


@pytest.mark.parametrize("error", ["estimate", "none"])
def test_only_an_estimate_has_a_bar_of_its_own(monkeypatch, error):
    model, stream = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0)), Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    tc.simulate(model, 0.01, rest_length=1.0, error=error, progress=True)
    assert "simulating" in stream.getvalue()
    assert ("estimating error" in stream.getvalue()) == (error == "estimate")


def test_a_fit_and_a_plan_count_in_their_own_units(monkeypatch):
    prism, stream = tc.prism(), Terminal()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    lengths = 0.95 * prism.string_length()
    run = tc.simulate(model, 0.1, rest_length=lengths, error="none", output_step=0.02)
    sensors = tc.Sensors(structure=prism, node_position=0.001)
    log = tc.Log.of_run(run, sensors, np.linspace(0.02, 0.1, 5))
    told = tc.identifiable(model, log, ["stiffness"])
    monkeypatch.setattr(sys, "stderr", stream)
    tc.fit(model, log, ["stiffness"], groups={"stiffness": "all"}, progress=True)
    tc.exciting_input(told, tc.Winches(rate=0.3), parts=1, most_rollouts=2, progress=True)
    assert "100/100 % of the logs" in stream.getvalue()
    assert "2/2 rollouts" in stream.getvalue()


@pytest.mark.parametrize("stream", [None, closed()], ids=["None", "closed"])
def test_a_simulation_without_messages(monkeypatch, stream):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))
    monkeypatch.setattr(sys, "stderr", stream)
    run = tc.simulate(model, 0.01, rest_length=1.0, step=1e-2, method="rk4", progress=True)
    assert run.time[-1] == 0.01


def notes(caplog, monkeypatch, reached, **how):
    """Return what is said of work that reaches so much, 2 s apart."""
    clock = iter(2.0 * np.arange(len(reached) + 2))
    monkeypatch.setattr(progress, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    caplog.clear()
    with progress_bar(3.0, **how) as report:
        for so_far in reached:
            report(so_far)
    assert {record.name for record in caplog.records} <= {"tenscontrol"}
    return [record.getMessage() for record in caplog.records]


@pytest.mark.parametrize("shown", [False, True])
def test_long_work_without_a_bar_is_announced_once(monkeypatch, caplog, shown):
    slow = np.linspace(1.0, 1.1, 11)
    (note,) = notes(caplog, monkeypatch, slow, shown=shown, label="fitting", start=1.0)
    assert note.startswith("fitting: 1 % took 6 s; at this rate it takes 10 minutes in all. ")
    assert not notes(caplog, monkeypatch, np.linspace(1.1, 3.0, 8), shown=shown, start=1.0)


def test_work_that_is_done_once_more_is_timed_anew(monkeypatch, caplog):
    once = np.linspace(0.5, 3.0, 6)
    assert not notes(caplog, monkeypatch, [*once, *once], shown=False)
