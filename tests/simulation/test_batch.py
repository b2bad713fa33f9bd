"""Many runs at once: the same numbers as one by one, and what becomes of single runs."""

import os
import signal
import sys
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.core.library import library
from tenscontrol.dynamics.equation import pack_state, unpack_states
from tenscontrol.integrate import Projector
from tenscontrol.interrupt import InterruptionWarning

needs_core = pytest.mark.skipif(library() is None, reason="no core")

RUNS = 6
MORE = 11  # than lanes, and not a multiple of them
LOOKED_AT = (0, 3, 5)


def thrown(structure, speed, seed=0, runs=RUNS):
    """Nodes and velocities of runs that start in the reference shape."""
    rng = np.random.default_rng(seed)
    equation = tc.Model(structure).equation("force_density")
    at_rest = pack_state(structure, structure.nodes, 0 * structure.nodes)
    states = np.tile(at_rest[:, None], runs)
    half = len(at_rest) // 2
    states[half:] = speed * rng.standard_normal((half, runs))
    N, V = unpack_states(structure, Projector(equation, True)(states))
    return np.moveaxis(N, 2, 0), np.moveaxis(V, 2, 0)


def scene(structure, seed=1, runs=RUNS):
    """Starts and rest lengths of which some strings go slack."""
    N, V = thrown(structure, 0.8, runs=runs)
    rng = np.random.default_rng(seed)
    factors = rng.uniform(0.92, 1.0, (runs, len(structure.strings)))
    return N, V, factors * structure.string_length(structure.nodes)


STRUCTURES = {
    "prism": tc.prism,
    "supported": lambda: replace(tc.prism(), fixed=[3]),
    "planar": tc.library.d_bar,
    "class 2": lambda: tc.library.class2_tower(1),
}


def assert_same(batch, runs):
    """Every number of the batch is that of the run by itself, by its number."""
    for i, run in runs.items():
        at = np.searchsorted(run.time, batch.time - 1e-12)
        assert np.array_equal(batch.nodes[i], run.nodes[:, :, at])
        assert np.array_equal(batch.velocities[i], run.velocities[:, :, at])
        assert batch.switches[i] == run.work.switches
    assert batch.completed.all()
    assert not batch.messages


@pytest.mark.parametrize("method", [{}, {"step": None, "tolerance": 1e-5}])
@pytest.mark.parametrize("name", STRUCTURES)
def test_a_batch_has_the_bits_of_single_runs(name, method):
    structure = STRUCTURES[name]()
    N, V, lengths = scene(structure)
    model = tc.Model(structure, strings=tc.LinearStrings(100.0))
    how = {"step": 0.01, "output_step": 0.1} | method
    batch = tc.simulate_many(model, 0.3, N, V, rest_length=lengths, threads=1, **how)
    runs = {
        i: tc.simulate(model, 0.3, N[i], V[i], rest_length=lengths[i], **how) for i in LOOKED_AT
    }
    assert batch.switches.sum() > 0
    assert_same(batch, runs)


@needs_core
def test_lanes_have_the_bits_of_single_runs():
    prism = tc.prism()
    N, V, lengths = scene(prism, runs=MORE)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    how = {"step": 0.01, "output_step": 0.1}
    batch = tc.simulate_many(model, 0.3, N, V, rest_length=lengths, threads=2, **how)
    assert batch.choice.back_end == "core, runs side by side"
    assert batch.switches.sum() > 10
    runs = {
        i: tc.simulate(model, 0.3, N[i], V[i], rest_length=lengths[i], **how) for i in (0, 3, 9, 10)
    }
    assert_same(batch, runs)


@needs_core
def test_lanes_carry_switches_as_single_runs_do():
    tower = tc.prism_tower(6)
    N, V = thrown(tower, 0.5, runs=MORE)
    model = tc.Model(tower, strings=tc.LinearStrings(100.0))
    how = {"rest_length": 0.999 * tower.string_length(), "step": 0.02, "output_step": 0.1}
    how["method"] = "rk4"
    batch = tc.simulate_many(model, 0.2, N, V, **how)
    runs = {i: tc.simulate(model, 0.2, N[i], V[i], **how) for i in (0, 3, 9, 10)}
    assert all(run.work.carried for run in runs.values())
    assert_same(batch, runs)


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("prism", {}),
        ("supported", {}),
        ("class 2", {"step": None, "tolerance": 1e-5}),
    ],
)
def test_parameters_that_vary_give_the_bits_of_models_with_them(name, method):
    structure = STRUCTURES[name]()
    N, V, lengths = scene(structure)
    rng = np.random.default_rng(2)
    count = len(structure.strings)
    vary = {
        "bar_mass": rng.uniform(0.5, 2.0, (RUNS, len(structure.bars))),
        "stiffness": rng.uniform(50.0, 150.0, (RUNS, count)),
        "damping": rng.uniform(0.1, 1.0, RUNS),
        "gravity": rng.uniform(5.0, 10.0, RUNS),
    }
    model = tc.Model(structure, strings=tc.LinearStrings(100.0, damping=0.1), gravity=9.81)
    how = {"step": 0.01} | method
    batch = tc.simulate_many(model, 0.1, N, V, rest_length=lengths, vary=vary, **how)

    def alone(i):
        law = tc.LinearStrings(vary["stiffness"][i], np.full(count, vary["damping"][i]))
        masses = replace(structure, bar_mass=vary["bar_mass"][i])
        own = tc.Model(masses, strings=law, gravity=vary["gravity"][i])
        return tc.simulate(own, 0.1, N[i], V[i], rest_length=lengths[i], **how)

    assert_same(batch, {i: alone(i) for i in (1, RUNS - 1)})


def test_loads_and_profiles_are_those_of_single_runs():
    prism = tc.prism()
    N, V, lengths = scene(prism)
    loads = np.random.default_rng(3).standard_normal((RUNS, 3, 6))
    profile = tc.Profile([0.0, 0.05, 0.12], np.outer(lengths[0], [1.0, 0.95, 1.0]))
    model = tc.Model(prism, strings=tc.LinearStrings(100.0), external_force=True)
    how = {"step": 0.01, "output_step": 0.05}
    batch = tc.simulate_many(model, 0.15, N, V, rest_length=profile, external_force=loads, **how)
    runs = {
        i: tc.simulate(model, 0.15, N[i], V[i], rest_length=profile, external_force=loads[i], **how)
        for i in LOOKED_AT
    }
    assert_same(batch, runs)


def test_a_run_that_fails_ends_alone():
    prism = tc.prism()
    N, V, lengths = scene(prism)
    N[1, 2, 3] = np.nan
    N[2] *= 1.1
    V[3] *= 1e6
    lengths[4, 5] = -1.0
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    how = {"step": 0.01, "output_step": 0.1}
    batch = tc.simulate_many(model, 0.3, N, V, rest_length=lengths, **how)
    assert batch.completed.tolist() == [True, False, False, False, False, True]
    assert sorted(batch.messages) == [1, 2, 3, 4]
    for run, said in ((1, "nodes"), (2, "bar 0|bar 1|bar 2"), (3, "finite"), (4, "rest_length")):
        assert any(word in batch.messages[run] for word in said.split("|"))
    assert np.isnan(batch.nodes[[1, 2, 4]]).all()
    assert np.isnan(batch.nodes[3, :, :, -1]).all()
    assert batch.end_time[3] < 0.3 == batch.end_time[0]
    fine = tc.simulate_many(model, 0.3, N[[0, 5]], V[[0, 5]], rest_length=lengths[[0, 5]], **how)
    assert np.array_equal(fine.nodes, batch.nodes[[0, 5]])


def test_some_nodes_are_kept():
    prism = replace(tc.prism(), fixed=[3])
    N, V, lengths = scene(prism)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    given = {"rest_length": lengths, "step": 0.01}
    every = tc.simulate_many(model, 0.1, N, V, **given)
    some = tc.simulate_many(model, 0.1, N, V, keep_nodes=[4, 3], **given)
    assert np.array_equal(some.nodes, every.nodes[:, :, [4, 3]])
    assert np.array_equal(some.velocities, every.velocities[:, :, [4, 3]])
    assert some.nodes.shape == (RUNS, 3, 2, 2)
    one = tc.simulate_many(model, 0.1, N, V, keep_nodes=4, **given)
    np.testing.assert_array_equal(one.nodes, every.nodes[:, :, 4:5])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"rest_length": np.ones(9)}, "all runs are the same"),
        ({"rest_length": np.ones((2, 8))}, "rest_length has shape"),
        ({"nodes": np.zeros((2, 3, 6)), "rest_length": np.ones((3, 9))}, "has 3 runs, but nodes"),
        ({"rest_length": np.ones((2, 9)), "vary": {"colour": [1, 2]}}, "vary"),
        ({"rest_length": np.ones((2, 9)), "vary": {"stiffness": [1, 2, 3]}}, "3 runs"),
        ({}, "expected one of rest_length, force_density and controller, found none"),
        ({"rest_length": np.ones((2, 9)), "vary": {"stiffness": 1j}}, "vary.*stiffness.*runs, 9"),
        ({"rest_length": np.ones((2, 9)), "vary": {"stiffness": 2.0}}, "vary.*stiffness.*runs, 9"),
        ({"rest_length": np.ones((2, 9)), "nodes": np}, "nodes"),
        ({"rest_length": np.ones((2, 9)), "keep_nodes": [6]}, "keep_nodes"),
        ({"rest_length": np.ones((2, 9)), "keep_nodes": [[1, 2]]}, r"keep_nodes.*\(1, 2\)"),
        ({"rest_length": np.ones((2, 9)), "method": "rk4", "step": None}, "step"),
        ({"rest_length": np.ones((2, 9)), "external_force": np.ones((2, 3, 6))}, "no load"),
        ({"rest_length": np.ones((10**6, 9)), "output_step": 1e-3}, "GB of memory"),
    ],
)
def test_bad_input_is_named(given, said):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))
    with pytest.raises((TypeError, ValueError), match=said):
        tc.simulate_many(model, 1.0, **{"step": 0.01} | given)


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_an_interrupt_keeps_the_runs_that_are_done(monkeypatch):
    prism = tc.prism()
    N, V, lengths = scene(prism)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    count = 60
    given = {
        "nodes": np.resize(N, (count, 3, 6)), "velocities": np.resize(V, (count, 3, 6)),
        "rest_length": lengths[0], "step": 0.01, "threads": 1,
    }  # fmt: skip
    whole = tc.simulate_many(model, 0.05, **given)

    @contextmanager
    def told(*_, **__):
        def report(done):
            if 0 < done < count:
                os.kill(os.getpid(), signal.SIGINT)

        yield report

    monkeypatch.setattr(simulate_many_file(), "progress_bar", told)
    with pytest.warns(InterruptionWarning, match="runs are done"):
        part = tc.simulate_many(model, 0.05, **given)
    assert 0 < part.completed.sum() < count
    assert {part.messages[i] for i in np.flatnonzero(~part.completed)} == {"interrupted"}
    done = part.completed
    assert np.array_equal(part.nodes[done], whole.nodes[done])


def simulate_many_file():
    return sys.modules["tenscontrol.simulation.batch.simulate_many"]


@pytest.mark.parametrize(
    ("name", "damping", "method"),
    [
        ("supported", 0.0, {"step": 0.01}),
        ("planar", 0.5, {"step": 0.01}),
        ("planar", 0.0, {"tolerance": 1e-5}),
    ],
)
def test_a_run_of_a_batch_is_that_of_simulate(name, damping, method):
    structure = STRUCTURES[name]()
    N, V, lengths = scene(structure)
    stiffness = np.linspace(50.0, 150.0, RUNS)
    model = tc.Model(structure, strings=tc.LinearStrings(100.0, damping), gravity=1.0)
    how = method | {"output_step": 0.01}
    vary = {"stiffness": stiffness}
    batch = tc.simulate_many(model, 0.3, N, V, rest_length=lengths, vary=vary, **how)
    count, i = len(structure.strings), RUNS - 1
    own = tc.LinearStrings(np.full(count, stiffness[i]), np.full(count, damping))
    run = batch.trajectory(i)
    alone = tc.simulate(
        tc.Model(structure, strings=own, gravity=1.0), 0.3, N[i], V[i], rest_length=lengths[i],
        **how,
    )  # fmt: skip
    assert run.health == alone.health
    assert (run.health.energy_error is None) == (damping > 0)
    assert np.array_equal(batch.error[i], alone.error)
    for what in ("time", "force_density", "rest_length", "tension", "energy", "angular_momentum"):
        assert np.array_equal(getattr(run, what), getattr(alone, what)), what
    assert np.array_equal(run.given["rest_length"], lengths[i])


def test_a_run_under_a_load_is_that_of_simulate():
    prism = tc.prism()
    N, V, lengths = scene(prism)
    loads = np.random.default_rng(3).standard_normal((RUNS, 3, 6))
    model = tc.Model(prism, strings=tc.LinearStrings(100.0), external_force=True)
    how = {"step": 0.01, "rest_length": lengths[0], "output_step": 0.01}
    batch = tc.simulate_many(model, 0.1, N, V, external_force=loads, **how)
    run = batch.trajectory(2)
    alone = tc.simulate(model, 0.1, N[2], V[2], external_force=loads[2], **how)
    assert run.health == alone.health
    for what in ("rest_length", "force_density", "energy", "momentum"):
        assert np.array_equal(getattr(run, what), getattr(alone, what)), what


def test_a_run_that_is_not_whole_is_no_trajectory():
    prism = tc.prism()
    N, V, lengths = scene(prism)
    V[3] *= 1e6
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    how = {"rest_length": lengths, "step": 0.01}
    batch = tc.simulate_many(model, 0.1, N, V, **how)
    with pytest.raises(ValueError, match=r"run 3 ended early: .*finite"):
        batch.trajectory(3)
    with pytest.raises(ValueError, match="run"):
        batch.trajectory(RUNS)
    with pytest.raises(TypeError, match=r"limits is .*HealthLimits"):
        batch.trajectory(0, {"energy": 1.0})
    with pytest.raises(tc.simulation.SimulationError, match="bar length error"):
        batch.trajectory(0, tc.HealthLimits(bar_length_error=1e-15, action="raise"))
    some = tc.simulate_many(model, 0.1, N[:2], keep_nodes=[4], **how | {"rest_length": 0.9})
    with pytest.raises(ValueError, match="leave keep_nodes out"):
        some.trajectory(1)
    grounded = tc.Model(prism, strings=model.strings, ground=tc.Ground(1e3))
    with pytest.raises(ValueError, match="ground, or inputs that change"):
        tc.simulate_many(grounded, 0.02, N[:2], **how | {"rest_length": 0.9}).trajectory(0)
