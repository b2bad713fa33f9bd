"""Motions in the compiled core are those in CasADi's virtual machine."""

import warnings

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.integrate.core_scene import CoreMotion
from tests.marks import needs_core
from tests.random_scenes import random_scene
from tests.without_core import without_core

pytestmark = needs_core

# Of the first sixteen scenes those that neither blow up nor magnify round-off to a billionth.
SEEDS = (0, 3, 7, 9, 12, 15)

# Of these, scenes whose bars grow and shrink.
DRIVEN = (0, 3)


def run(seed, **how):
    scene = random_scene(seed)
    if seed in DRIVEN:
        structure, time = scene.structure, np.linspace(0.0, np.pi, 7)
        moves = ~np.isin(structure.bars, structure.fixed).all(axis=1)
        swell = 0.02 * np.sin(time * np.arange(1, len(moves) + 1)[:, None]) ** 2
        lengths = structure.bar_length[:, None] * (1 + swell * moves[:, None])
        how["bar_length"] = tc.Profile(np.linspace(0, scene.duration, 7), lengths, "cubic")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return scene.simulate(output_step=scene.duration / 10, error="none", **how)


@pytest.mark.parametrize("seed", SEEDS)
def test_steps_and_switches_are_those_of_the_virtual_machine(seed):
    duration, size = random_scene(seed).duration, random_scene(seed).size
    for how in {"method": "dop853"}, {"method": "rk4", "step": duration / 400, "project": False}:
        with without_core():
            slow = run(seed, **how)
        fast = run(seed, **how)
        assert slow.choice.back_end != "core"
        assert fast.choice.back_end == "core"
        assert fast.work == slow.work
        assert np.abs(fast.nodes - slow.nodes).max() < 1e-8 * size
        assert np.allclose(fast.energy, slow.energy, rtol=1e-6, atol=1e-9 * np.ptp(slow.energy))
        if seed in DRIVEN:
            work = slow.struts.work
            assert np.abs(fast.struts.work - work).max() < 1e-7 * np.abs(work).max()


def test_outputs_whose_bars_have_no_place_end_a_run(monkeypatch):
    scene = random_scene(0)
    original = CoreMotion.advance

    def advance(self, budget):
        is_over = original(self, budget)
        self._states[:, 4:] = np.nan  # what the core writes for them
        return is_over

    monkeypatch.setattr(CoreMotion, "advance", advance)
    with pytest.raises(tc.simulation.SimulationError, match="came to a dead centre") as it:
        scene.simulate(method="dop853", output_step=scene.duration / 10, error="none")
    assert it.value.trajectory.nodes.shape[2] == 4
    assert np.isfinite(it.value.trajectory.nodes).all()
