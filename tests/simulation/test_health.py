"""Figures that tell whether to trust a motion, limits on them, and interruption."""

import sys

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.core.library import library
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.integrate.core_scene import CoreMotion
from tests.dynamics.scenes import paper_force_density, rest_lengths


@pytest.fixture(scope="module")
def example():
    prism = tc.prism()
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    return tc.Model(prism, strings=tc.LinearStrings(100.0)), lengths


def test_a_good_run_is_healthy(example):
    model, lengths = example
    health = tc.simulate(model, 1.0, rest_length=lengths, tolerance=1e-9).health
    assert health.energy_error < 1e-6
    assert health.momentum_change < 1e-12
    assert health.angular_momentum_change < 1e-12
    assert health.bar_length_error < 1e-8
    assert health.work.switches > 0
    assert health.work.missed == 0


def test_energy_is_not_judged_where_it_may_change(example):
    model, lengths = example
    damped = tc.Model(model.structure, strings=tc.LinearStrings(100.0, damping=1.0))
    assert tc.simulate(damped, 0.1, rest_length=lengths, step=1e-3).health.energy_error is None


def test_too_long_a_step_is_told_where_energy_and_lengths_are_kept(example):
    """The energy-momentum method in steps of 30 ms keeps both, and is off by centimetres."""
    model, lengths = example
    with pytest.warns(tc.simulation.AccuracyWarning, match=r"position error .* step below 0\.03 s"):
        run = tc.simulate(model, 2.0, rest_length=lengths, method="energy_momentum", step=0.03)
    assert run.health.bar_length_error < 1e-13
    exact = tc.simulate(model, 2.0, rest_length=lengths, tolerance=1e-10, output_step=2.0)
    assert np.abs(run.nodes[:, :, -1] - exact.nodes[:, :, -1]).max() > 1e-2


@pytest.mark.parametrize("step", [4e-3, 1e-3])
def test_the_estimate_is_about_the_error(step):
    """Under damping, where the energy tells nothing."""
    prism = tc.prism()
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    run = tc.simulate(model, 0.5, rest_length=lengths, step=step)
    exact = tc.simulate(model, 0.5, rest_length=lengths, tolerance=1e-12, output_step=0.5)
    off = np.linalg.norm(run.nodes[:, :, -1] - exact.nodes[:, :, -1], axis=0).max()
    assert 1 < run.error[-1] * np.ptp(prism.nodes, axis=1).max() / off < 6


def test_a_limit_can_raise(example):
    model, lengths = example
    limits = tc.HealthLimits(bar_length_error=1e-12, action="raise")
    with pytest.raises(
        tc.simulation.SimulationError, match=r"bar length error .* above its limit"
    ) as info:
        tc.simulate(model, 0.5, rest_length=lengths, step=5e-3, limits=limits)
    assert info.value.trajectory.time[-1] == 0.5


def test_counts_can_be_limited(example):
    model, lengths = example
    with pytest.warns(tc.simulation.AccuracyWarning, match="switches 24 is above its limit 3"):
        tc.simulate(model, 0.3, rest_length=lengths, step=1e-3, limits=tc.HealthLimits(switches=3))


def test_without_limits_nothing_is_said(example):
    model, lengths = example
    none = tc.HealthLimits(energy_error=None, bar_length_error=None, position_error=None)
    run = tc.simulate(model, 0.5, rest_length=lengths, step=2.5e-2, limits=none)
    assert run.health.energy_error > 0.05


@pytest.mark.parametrize(
    ("method", "options", "kind", "calls"),
    [
        ("rk4", {"step": 1e-3}, CoreMotion, 2),
        ("dop853", {"tolerance": 1e-9}, CoreMotion, 2),
        ("energy_momentum", {"step": 1e-3}, Evaluator, 6),
    ],
)
def test_an_interrupted_run_returns_the_part_done(
    example, monkeypatch, method, options, kind, calls
):
    """Ctrl-C in a call that a method's loop makes; the core takes many steps a call."""
    if kind is CoreMotion and library() is None:
        pytest.skip("installed without a compiler")
    model, lengths = example
    name = "advance" if kind is CoreMotion else "__call__"
    original, count = getattr(kind, name), 0

    def call(self, *arguments):
        nonlocal count
        if "advance" in {sys._getframe(depth).f_code.co_name for depth in range(1, 6)}:
            count += 1
            if count == calls:
                raise KeyboardInterrupt
        return original(self, *arguments)

    duration = 60.0 if method == "dop853" else 5.0
    longer = {"method": method, "output_step": 1e-2, "error": "none", **options}
    whole = tc.simulate(model, duration, rest_length=lengths, **longer)
    monkeypatch.setattr(kind, name, call)
    with pytest.warns(RuntimeWarning, match=r"stopped at .* interrupted"):
        part = tc.simulate(model, duration, rest_length=lengths, **longer)
    done = len(part.time)
    assert 1 < done < len(whole.time)
    assert "interrupted" in part.summary()
    np.testing.assert_array_equal(part.nodes, whole.nodes[:, :, :done])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"energy_error": 0.0}, "energy_error is 0"),
        ({"switches": -1}, "switches is -1"),
        ({"action": "shout"}, "action is 'shout'"),
    ],
)
def test_bad_limits_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        tc.HealthLimits(**options)
