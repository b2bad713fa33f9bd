"""Steps differentiated by the core are those that CasADi differentiates."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.model_parameters import ground_numbers, law_parameters
from tenscontrol.optimize import variations
from tests.marks import needs_core
from tests.random_scenes import random_scene

pytestmark = needs_core


def squares(_, nodes, velocities):
    """A cost of all coordinates."""
    return ca.sumsqr(nodes) + 0.1 * ca.sumsqr(velocities)


def names_of(scene):
    """All that a scene depends on."""
    model, names = scene.model, ["nodes", "velocities", "bar_mass", "point_mass", "gravity"]
    names += [scene.input] * bool(len(scene.structure.strings))
    names += law_parameters(model) if scene.input == "rest_length" else ()
    return [*names, "external_force", *ground_numbers(model)]


def compare(run, names, monkeypatch, close=1e-11):
    """Derivatives by the core and by CasADi, forward and backward."""
    times = [0.5 * run.time[-1], run.time[-1]]
    cores, begin = [], variations.CoreSteps.__init__
    monkeypatch.setattr(
        variations.CoreSteps,
        "__init__",
        lambda self, *given: cores.append(self) or begin(self, *given),
    )
    by_core = tc.sensitivity(run, names, times), tc.gradient(run, squares, names, times)
    assert cores
    monkeypatch.setattr(variations, "core_scene", lambda _: None)
    wanted = tc.sensitivity(run, names, times), tc.gradient(run, squares, names, times)
    for name in names:
        for found, known in (
            (by_core[0].nodes, wanted[0].nodes), (by_core[0].velocities, wanted[0].velocities),
            (by_core[1].slope, wanted[1].slope),
        ):  # fmt: skip
            size = np.abs(known[name]).max(initial=1e-12)
            assert np.abs(found[name] - known[name]).max(initial=0.0) < close * size, name


@pytest.mark.parametrize("seed", [3, 15, 22])
def test_on_random_scenes(seed, monkeypatch):
    scene = random_scene(seed)
    limits = tc.HealthLimits(crossings=None, penetration=None, energy_error=None)
    run = scene.simulate(method="dop853", tolerance=1e-3, error="none", limits=limits)
    compare(run, names_of(scene), monkeypatch)


@pytest.mark.parametrize(
    ("structure", "law", "damping"),
    [
        (tc.library.d_bar, tc.Ground, 0.3), (tc.library.d_bar, tc.dynamics.SmoothGround, 0.3),
        (tc.library.d_bar, tc.dynamics.SmoothGround, 0.0), (tc.prism, tc.Ground, 0.0),
        (tc.prism, tc.dynamics.HertzGround, 0.3),
    ],
)  # fmt: skip
def test_on_all_kinds_of_ground(structure, law, damping, monkeypatch):
    structure = structure()
    height = float(structure.nodes[-1].min()) - 0.05
    more = {"width": 0.02} if law is tc.dynamics.SmoothGround else {}
    ground = law(2e3, damping=damping, friction=0.4, height=height, slip_speed=0.1, **more)
    strings = tc.ElasticStrings(100.0, damping=0.5)
    model = tc.Model(structure, strings, gravity=9.81, ground=ground)
    aside = np.zeros_like(structure.nodes)
    aside[0] = 0.3
    given = {"rest_length": 0.95 * structure.string_length(), "step": 2e-3, "error": "none"}
    run = tc.simulate(model, 0.14, velocities=aside, **given)
    assert run.contacts.stored_energy.max() > 0
    names = ["rest_length", "axial_rigidity", "damping", "bar_mass", *ground_numbers(model)]
    compare(run, names, monkeypatch)


def test_profiles_count_at_the_stages(monkeypatch):
    tower = tc.library.class2_tower(1)
    model = tc.Model(tower, tc.LinearStrings(300.0))
    lengths = 0.95 * tower.string_length()
    wound = tc.Profile([0.0, 0.05, 0.1], np.outer(lengths, [1.0, 0.95, 1.0]), "cubic")
    run = tc.simulate(model, 0.15, rest_length=wound, error="none")
    compare(run, ["rest_length", "damping"], monkeypatch)
