"""Rules for every figure: nothing loaded early, nothing shown, everything documented."""

import inspect
import subprocess
import sys

import pytest

import tenscontrol as tc


def test_importing_the_package_does_not_load_matplotlib():
    code = "import sys, tenscontrol; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("name", tc.plot.__all__)
def test_public_names_are_documented_with_an_example(name):
    thing = getattr(tc.plot, name)
    assert thing.__doc__
    if inspect.isfunction(thing):
        assert ">>>" in thing.__doc__
        for parameter in inspect.signature(thing).parameters:
            assert f"{parameter} : " in thing.__doc__ or f"{parameter}, " in thing.__doc__


def test_nothing_opens_a_window(prism, monkeypatch):
    import matplotlib.pyplot as plt

    monkeypatch.setattr(plt, "show", lambda *_: pytest.fail("show() was called"))
    tc.plot.structure(prism)
    tc.plot.poles([-1.0])
    tc.plot.history([0, 1], {"a": [0, 1]}, "m")
