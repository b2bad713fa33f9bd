"""Warnings name the line of the user; see also the fixture of ``conftest`` that asks it of all."""

import contextlib
import warnings
from pathlib import Path

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.core import library
from tenscontrol.warn import warn
from tests.marks import needs_core


@pytest.fixture(scope="module")
def plant():
    """Of the six-bar ball, with a mode that no string reaches."""
    ball = tc.library.six_bar_ball()
    return tc.linearize(tc.Model(ball), tc.prestress(ball, force_density=10.0))


@pytest.mark.parametrize(
    "design",
    [
        lambda plant: tc.LQR(plant, sample_time=0.02),
        lambda plant: tc.MPC(plant, horizon=2, sample_time=0.02),
        lambda plant: tc.NMPC(plant, horizon=2, sample_time=0.02),
    ],
    ids=["LQR", "MPC", "NMPC"],
)
def test_a_design_warns_at_its_line(plant, design):
    with pytest.warns(RuntimeWarning, match="no string reaches") as told:
        design(plant)
    assert {(each.filename, each.lineno) for each in told} == {
        (__file__, design.__code__.co_firstlineno)
    }


def test_frames_of_the_library_in_between_are_passed_over():
    """A loop in the package that is entered by a decorator of contextlib."""
    scope = {"__name__": "tenscontrol.made_up", "warn": warn, "contextlib": contextlib}
    exec(
        "@contextlib.contextmanager\n"
        "def kept():\n"
        "    yield\n"
        "    warn('told', UserWarning)\n"
        "def call():\n"
        "    with kept():\n"
        "        pass\n",
        scope,
    )
    with warnings.catch_warnings(record=True, action="always") as told:
        scope["call"]()
    assert told[0].filename == __file__


def test_every_warning_of_the_package_goes_this_way():
    package = Path(tc.__file__).parent
    others = [
        path.name for path in package.rglob("*.py") if "warnings.warn(" in path.read_text("utf-8")
    ]
    assert others == ["warn.py"]


def test_measured_shapes_warn_at_the_line_too():
    prism = tc.prism()
    rest = tc.prestress(prism, force_density=10.0)
    at = tc.OperatingPoint(1.001 * prism.nodes, rest.force_density)
    with pytest.warns(RuntimeWarning, match=r"in at\.nodes, bars are off") as told:
        tc.linearize(tc.Model(prism), at, require_equilibrium=False)
    assert [each.filename for each in told] == [__file__]
    assert np.isfinite(told[0].lineno)


@needs_core
def test_a_core_of_other_sources_is_named(monkeypatch):
    monkeypatch.setattr(library, "sources_id", lambda: "others")
    monkeypatch.setattr(library, "_loaded", library._loaded.__wrapped__)
    with pytest.warns(RuntimeWarning, match="built from other sources .* run pip install again"):
        assert library.library.__wrapped__() is None
