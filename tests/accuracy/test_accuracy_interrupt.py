"""Ctrl-C in accuracy reports: the finished rows come back, with a warning."""

import os
import signal
import sys
from contextlib import suppress

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy import long_run, measured_run, predictability, stability_map
from tenscontrol.accuracy.measured_run import Bench
from tenscontrol.interrupt import InterruptionWarning

LONG_RUN = sys.modules[long_run.__module__]

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


@pytest.fixture(scope="module")
def case():
    gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    return tc.Scene(tc.Model(tc.prism()), 0.5, force_density=gamma)


def press_at(call, monkeypatch, owner, name, lost=None):
    """Press the key at the beginning of the so many-th call of a function.

    ``lost`` is an error that the function swallows, as CasADi may.
    """
    original, calls = getattr(owner, name), 0

    def pressed(*arguments, **options):
        nonlocal calls
        calls += 1
        if calls == call:
            with suppress(*[lost] if lost else []):
                signal.raise_signal(signal.SIGINT)
        return original(*arguments, **options)

    monkeypatch.setattr(owner, name, pressed)


def test_work_precision(case, monkeypatch):
    press_at(3, monkeypatch, Bench, "own")
    with pytest.warns(InterruptionWarning, match="2 runs are measured") as caught:
        found = tc.work_precision(
            case, ["rk4"], {"rk4": [0.05, 0.025, 0.0125, 0.00625]}, repeats=1, outputs=10
        )
    assert caught[0].filename == __file__
    assert [row.steps for row in found.rows] == [10, 20]
    assert found.table()


def test_convergence_order(case, monkeypatch):
    press_at(4, monkeypatch, Bench, "own")
    with pytest.warns(InterruptionWarning, match="3 runs"):
        found = tc.convergence_order(case, "rk4", [0.02, 0.01, 0.005, 0.0025])
    assert len(found.step) == len(found.error) == 3
    assert 3.5 < found.order < 4.5


def test_before_the_first_row_there_is_nothing(case, monkeypatch):
    press_at(1, monkeypatch, Bench, "own")
    with pytest.raises(KeyboardInterrupt):
        tc.convergence_order(case, "rk4", [0.02, 0.01, 0.005, 0.0025])


def test_long_run(case, monkeypatch):
    press_at(3, monkeypatch, LONG_RUN._Recorder, "add")
    with pytest.warns(InterruptionWarning, match="150 states are judged"):
        found = long_run(case, "rk4", 5e-3, steps=5000, outputs=1000)
    assert found.failure.startswith("interrupted at")
    assert len(found.time) == len(found.of("energy").error) == 150


@pytest.mark.parametrize(
    ("owner", "name", "loop"),
    [
        (LONG_RUN._Recorder, "__init__", lambda case: long_run(case, "rk4", 5e-3, 1000, 100)),
        (measured_run, "fastest_rate", lambda case: tc.work_precision(case, ["rk4"], repeats=1)),
    ],
)
def test_a_key_that_is_lost_before_a_long_loop_ends_it(case, monkeypatch, owner, name, loop):
    press_at(1, monkeypatch, owner, name, lost=KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt):
        loop(case)


def test_predictability(case, monkeypatch):
    module = sys.modules[predictability.__module__]
    original = module._growths

    def pressed(*arguments):
        for i, each in enumerate(original(*arguments)):
            if i == 5:
                signal.raise_signal(signal.SIGINT)
            yield each

    monkeypatch.setattr(module, "_growths", pressed)
    with pytest.warns(InterruptionWarning, match="20 times are compared"):
        found = predictability(case, outputs=40)
    assert found.duration == found.time[-1] < 0.5
    assert not found.is_limited


def test_stability_map(monkeypatch):
    press_at(2, monkeypatch, sys.modules[stability_map.__module__], "fastest_rate")
    with pytest.warns(InterruptionWarning, match="1 cases are done"):
        found = tc.stability_map("rk4", [1e3, 1e4], [0.1], steps=50)
    assert np.isfinite(found.step[0, 0])
    assert np.isnan(found.step[1, 0])
    assert "nan" in found.table()
