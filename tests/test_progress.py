"""The progress bar: on a terminal only, and harmless where there is none."""

import io
import sys

import pytest

import tenscontrol as tc
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


@pytest.mark.parametrize("stream", [None, closed()], ids=["None", "closed"])
def test_a_simulation_without_messages(monkeypatch, stream):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))
    monkeypatch.setattr(sys, "stderr", stream)
    run = tc.simulate(model, 0.01, rest_length=1.0, step=1e-2, method="rk4", progress=True)
    assert run.time[-1] == 0.01
