"""Derivatives along a plan, by the core and by sparse Jacobians of one point, and their cost."""

from contextlib import nullcontext
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control.mpc.core_motion import core_motion
from tenscontrol.control.mpc.real_time_iteration import TrajectoryModel, limited_rows
from tenscontrol.control.mpc.settings import MPCSettings, design
from tenscontrol.control.mpc.shooting import RK4, AccelerationSlopes
from tenscontrol.core.library import library
from tenscontrol.plant.reduced_dynamics import (
    acceleration_slopes,
    linked_accelerations,
    reduced_acceleration,
    sampled_dynamics,
)
from tests.control.mpc.contact_scenes import hanging
from tests.random_structures import any_structure
from tests.without_core import without_core

CLOSE = 1e-12


def rest_lengths(structure, stiffness=1000.0, damping=0.0, **options):
    model = tc.Model(structure, tc.LinearStrings(stiffness, damping=damping), **options)
    return tc.linearize(model, tc.prestress(structure, 20.0), input="rest_length")


def drawn(seed):
    """A random structure at random force densities, pushed along by what is left."""
    structure = any_structure(seed, clusters=bool(seed % 2))
    rng = np.random.default_rng(seed)
    model = tc.Model(structure, tc.LinearStrings(200.0, damping=1.0))
    at = tc.OperatingPoint(structure.nodes, rng.uniform(5.0, 10.0, len(structure.strings)))
    return tc.linearize(
        model, at, input="rest_length", coordinates="minimal", require_equilibrium=False
    )


def held_up():
    """Bars that swing about supports, by their weight and a load, with elastic strings."""
    prism = replace(tc.prism(), fixed=[0, 1, 2])
    model = tc.Model(prism, tc.ElasticStrings(1e3), gravity=9.81, external_force=True)
    load = np.random.default_rng(5).normal(size=(3, 6))
    at = tc.OperatingPoint(prism.nodes, np.full(len(prism.strings), 20.0), load)
    return tc.linearize(model, at, input="rest_length", require_equilibrium=False)


def few():
    """Six modes, and winches of strings in threes, with some left as they are."""
    tower = tc.prism_tower(2)
    model, rest = tc.Model(tower, tc.LinearStrings(1e3)), tc.prestress(tower, 20.0)
    gangs = {f"winch_{first}": [first, first + 1, first + 2] for first in range(0, 24, 3)}
    return tc.reduce(tc.linearize(model, rest, input="rest_length", actuated=gangs), 6)


NAMED = {
    "prism": lambda: tc.linearize(tc.Model(tc.prism()), tc.prestress(tc.prism(), 20.0)),
    "ball, damped": lambda: rest_lengths(tc.library.six_bar_ball(), damping=3.0),
    "class 2": lambda: rest_lengths(tc.library.class2_tower(2), gravity=0.0),
    "plane": lambda: rest_lengths(tc.library.d_bar()),
    "string nodes": lambda: rest_lengths(tc.subdivide(tc.prism(), 2, node_mass=0.1)),
    "ground": lambda: hanging(tc.prism(), -0.01),
    "held up": held_up,
    "few": few,
}
RANDOM = {f"random {seed}": partial(drawn, seed) for seed in (2, 3)}
SCENES = NAMED | RANDOM


@cache
def plant_of(name):
    return SCENES[name]()


def points(plant, count, size=1e-2):
    rng, (s, a) = np.random.default_rng(0), plant.B.shape
    inputs = plant.equilibrium_input * (1 + 0.01 * rng.normal(size=(count, a)))
    return size * rng.normal(size=(count, s)), inputs


def off(found, expected):
    return np.abs(found - expected).max(initial=0) / max(np.abs(expected).max(initial=0), 1e-12)


@pytest.mark.parametrize(
    ("name", "taut"),
    [(name, k % 2 == 1) for k, name in enumerate(SCENES)],
)
def test_slopes_are_those_of_the_whole_expression(name, taut):
    """Against CasADi's derivatives of the acceleration written out in reduced coordinates."""
    plant = plant_of(name)
    states, inputs = points(plant, 2)
    by_core = core_motion(plant, taut=taut)
    assert (by_core is None) == (library() is None or bool(plant.model.structure.blocks))
    ways = AccelerationSlopes(plant, 2, taut=taut, machine_code=False), by_core
    found = [way(states, inputs) for way in ways if way is not None]
    whole = acceleration_slopes(plant, taut=taut)
    for k in range(2):
        qdd, by_q, by_v, by_u = (part.full() for part in whole(states[k], inputs[k]))
        assert np.isfinite(qdd).all()
        expected = qdd.ravel(), np.hstack([by_q, by_v]).T, by_u.T
        for own in found:
            for part, exact in zip(own, expected, strict=True):
                assert off(part[k], exact) < CLOSE


@pytest.mark.parametrize("name", ["ball, damped", "class 2", "ground"])
def test_slopes_are_differences_of_the_acceleration(name):
    plant = plant_of(name)
    states, inputs = points(plant, 1)
    _, by_z, by_u = AccelerationSlopes(plant, 1, taut=False, machine_code=False)(states, inputs)
    acceleration = reduced_acceleration(plant, taut=False)
    rng = np.random.default_rng(1)
    dz, du = rng.normal(size=states.shape[1]), rng.normal(size=inputs.shape[1])
    ends = []
    for h in (1e-6, -1e-6):
        ends.append(acceleration(states[0] + h * dz, inputs[0] + h * du).full().ravel())
    assert off((ends[0] - ends[1]) / 2e-6, dz @ by_z[0] + du @ by_u[0]) < 1e-6


@pytest.mark.parametrize(
    ("name", "context"),
    [("ball, damped", without_core), ("ball, damped", nullcontext), ("held up", nullcontext)],
)
def test_samples_are_linearized_alike_in_all_ways(name, context):
    """In products of slopes, by the core, and by the function that C code is written of."""
    plant = plant_of(name)
    states, inputs = points(plant, 3)
    held = np.vstack([inputs[:1], inputs])
    with context():
        found = RK4(plant, 0.02, 3, False).linearize(states, held, np.zeros((3, 0)))
    for k in range(3):
        end, by_z, by_u = (
            part.full() for part in sampled_dynamics(plant, 0.02)[1](states[k], inputs[k])
        )
        assert off(found.values[k], end.ravel()) < CLOSE
        assert off(found.slopes[0][k], by_z.T) < CLOSE
        assert off(found.slopes[1][k], by_u.T) < CLOSE


@pytest.mark.parametrize(
    ("name", "ramp"),
    [("ball, damped", True), ("class 2", False), ("plane", True), ("few", False), ("prism", False)],
)
def test_limited_rows_are_those_of_the_whole_expression(name, ramp):
    plant = plant_of(name)
    limit = np.random.default_rng(1).normal(size=(2, plant.nodes.size))
    settings = MPCSettings(
        horizon=2, sample_time=0.005, max_force_density=300.0, max_tension=500.0,
        outputs=(tc.control.OutputLimit(limit, np.full(2, -99.0), np.full(2, 99.0)),),
        winches=tc.Winches(rate=1.0, ramp=ramp) if plant.input == "rest_length" else None,
    )  # fmt: skip
    constraints = design(plant, settings, nonlinear=True).constraints
    model = TrajectoryModel(plant, settings, constraints, False)
    states, inputs = points(plant, 3)
    held = np.vstack([inputs[:1], inputs[:2]])
    _, found = model.linearize(states, held, np.zeros((2, 3, states.shape[1] // 2)))
    whole = limited_rows(plant, constraints, ramp)
    patterns = model._rows.patterns
    for k in range(2):
        given = states[k], inputs[k], states[k + 1]
        value, *slopes = (part.full() for part in whole(*given))
        for part, slope, pattern in zip(found.slopes, slopes, patterns, strict=True):
            assert off(part[k].T, slope) < CLOSE
            assert not slope[pattern == 0].any()
        assert off(found.values[k], value.ravel()) < CLOSE


# ---- what they cost ----


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_the_code_grows_with_the_members(held):
    counts = []
    for stages in (1, 2, 4):
        tower = tc.prism_tower(stages)
        model = tc.Model(tower, tc.LinearStrings(1000.0))
        plant = tc.linearize(model, tc.prestress(tower, 20.0), input=held)
        counts.append(linked_accelerations(plant, taut=False)[0].n_instructions())

    assert counts[2] - counts[1] < 2.1 * (counts[1] - counts[0])


def test_the_code_is_a_part_of_the_whole_expression():
    plant = plant_of("ball, damped")
    one = linked_accelerations(plant, taut=True)[0].n_instructions()
    assert one < 0.1 * acceleration_slopes(plant, taut=True).n_instructions()


def test_every_horizon_takes_the_same_functions(monkeypatch):
    """What is compiled is one point, whatever the number of points that it is looped over."""
    import tenscontrol.control.mpc.shooting as of

    seen = []
    monkeypatch.setattr(of, "compiled", lambda function: seen.append(function))
    plant = rest_lengths(tc.prism())
    with without_core():
        for horizon in (2, 20):
            tc.NMPC(
                plant, horizon=horizon, sample_time=0.02, winches=tc.Winches(rate=1.0, ramp=True),
                machine_code=True, solver="osqp",
            )  # fmt: skip
    assert len(seen) == 2  # the accelerations and the limited rows
