"""Many runs at once: the same numbers as one by one, and what becomes of single runs."""

import os
import signal
import sys
import warnings
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state, unpack_states
from tenscontrol.integrate import Projector, watched
from tenscontrol.integrate.dop853 import cost_in_core
from tenscontrol.interrupt import InterruptionWarning
from tenscontrol.simulation.batch.runner import Runner
from tests.marks import needs_core
from tests.random_scenes import random_scene

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


def many(model, duration, how, vary, keep_nodes=None, threads=None, **given):
    """A batch of a scene; rest lengths that vary have those of the first run in it."""
    if "rest_length" in vary:
        given["rest_length"] = np.ones(len(model.structure.strings))
    held = tc.Scene(model, duration, integration=tc.Integration(**how), **given)
    return tc.simulate_many(held, vary, keep_nodes, threads=threads)


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
    vary = {"nodes": N, "velocities": V, "rest_length": lengths}
    batch = many(model, 0.3, how, vary, threads=1)
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
    vary = {"nodes": N, "velocities": V, "rest_length": lengths}
    batch = many(model, 0.3, how, vary, threads=2)
    assert batch.choice.back_end == "core, runs side by side"
    assert batch.switches.sum() > 10
    runs = {
        i: tc.simulate(model, 0.3, N[i], V[i], rest_length=lengths[i], **how) for i in (0, 3, 9, 10)
    }
    assert_same(batch, runs)


ADAPTIVE = {"tolerance": 1e-5, "output_step": 0.01}


@needs_core
@pytest.mark.parametrize("kind", ["undamped", "damped", "on ground"])
def test_lanes_of_adaptive_steps_have_the_bits_of_single_runs(kind):
    # More runs than are at work together, with steps, switches and outputs of their own.
    prism, runs = tc.prism(), 75
    N, V, lengths = scene(prism, runs=runs)
    damping = 0.5 if kind == "damped" else 0.0
    law, ground = tc.LinearStrings(100.0, damping=damping), None
    if kind == "on ground":
        ground = tc.Ground(2e3, 0.3, friction=0.5, slip_speed=0.05, height=-0.02)
    model = tc.Model(prism, strings=law, gravity=9.81, ground=ground)
    stiffness = np.random.default_rng(4).uniform(50.0, 150.0, (runs, 9))
    vary = {"nodes": N, "velocities": V, "rest_length": lengths, "stiffness": stiffness}
    batch = many(model, 0.2, ADAPTIVE, vary, threads=1)
    assert batch.choice.back_end == "core, runs side by side"
    assert batch.choice.method == "dop853"
    assert batch.switches.sum() > runs

    def alone(i):
        own = model.replace(strings=tc.LinearStrings(stiffness[i], np.full(9, damping)))
        return tc.simulate(own, 0.2, N[i], V[i], rest_length=lengths[i], **ADAPTIVE)

    singles = {i: alone(i) for i in (0, 40, runs - 1)}
    assert_same(batch, singles)
    looked_at = [i for i in singles if np.isfinite(batch.error[i, 0])]
    assert looked_at
    assert all(np.array_equal(batch.error[i], singles[i].error) for i in looked_at)


@needs_core
@pytest.mark.parametrize("seed", [1, 6, 9, 15])
def test_random_scenes_in_lanes_have_the_bits_of_single_runs(seed):
    given = random_scene(seed)
    value = given.value * np.linspace(0.97, 1.03, MORE)[:, None]
    V = given.velocities * np.linspace(0.5, 1.0, MORE)[:, None, None]
    how = tc.Integration(
        "dop853", 1e-4, output_step=given.duration / 7, error="none",
        limits=tc.HealthLimits(crossings=None),
    )  # fmt: skip
    held = tc.Scene(given.model, given.duration, integration=how, **{given.input: given.value})
    batch = tc.simulate_many(held, {"velocities": V, given.input: value})
    assert batch.choice.back_end == "core, runs side by side"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        runs = {
            i: replace(held, velocities=V[i], **{given.input: value[i]}).simulate()
            for i in (0, 4, MORE - 1)
        }
    assert_same(batch, runs)


@needs_core
@pytest.mark.parametrize("follows_profile", [False, True])
def test_runs_that_lanes_leave_go_on_by_the_methods_of_single_runs(monkeypatch, follows_profile):
    prism = tc.prism()
    N, V, lengths = scene(prism)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    vary = {"nodes": N, "velocities": V}
    if follows_profile:  # several spans, some of which runs are over when they leave
        ends = np.outer(lengths[0], [1.0, 0.7, 1.0])
        given = {"rest_length": tc.Profile([0.0, 0.05, 0.12], ends)}
        held = [given["rest_length"]] * RUNS
    else:
        given, held = {}, lengths
        vary["rest_length"] = lengths

    def alone(i):
        return tc.simulate(model, 0.3, N[i], V[i], rest_length=held[i], **ADAPTIVE)

    # What the first method may spend covers half of the runs, or a part of each.
    evaluations = [alone(i).work.evaluations for i in range(RUNS)]
    share = cost_in_core(2 * prism.nodes.size) * (0.5 if follows_profile else 1.0)
    monkeypatch.setattr(watched, "_FREE", share * float(np.median(evaluations)))
    left, replay = [], Runner._replay
    monkeypatch.setattr(
        Runner, "_replay", lambda runner, *of: left.append(of) or replay(runner, *of)
    )
    batch = many(model, 0.3, ADAPTIVE, vary, threads=1, **given)
    assert batch.choice.back_end == "core, runs side by side"
    runs = {i: alone(i) for i in range(RUNS)}
    if follows_profile:
        assert left
    else:
        # Other methods were tried in some of them.
        assert {runs[i].work.evaluations > evaluations[i] for i in runs} == {True, False}
    assert_same(batch, runs)


@needs_core
def test_no_run_is_stuck_where_a_string_dips_between_the_ends_of_a_step():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    rest = tc.prestress(prism, 0.5)
    lengths = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    V = thrown(prism, 0.5, runs=500)[1]
    how = {"method": "dop853", "tolerance": 1e-2, "error": "none"}
    assert many(model, 1.0, how, {"velocities": V}, rest_length=lengths).completed.all()
    # Steps go across switches under such a tolerance, and their error is told.
    loose, tight = (
        many(model, 1.0, {"tolerance": value}, {"velocities": V[:16]}, rest_length=lengths)
        for value in (1e-3, 1e-9)
    )
    off = np.linalg.norm(loose.nodes - tight.nodes, axis=1).max(axis=1)[:, -1] / prism.size
    assert 1e-4 < np.median(off) < 2e-3
    assert (loose.error[:, -1] > 0.9 * off).all()
    assert np.median(loose.error[:, -1] / off) < 4
    work = loose.scene_of(0).simulate().work
    assert work.carried == 0 < work.switches == loose.switches[0]
    assert 2 * work.evaluations < tight.scene_of(0).simulate().work.evaluations


@needs_core
def test_lanes_go_across_contacts_as_single_runs_do():
    prism = tc.prism()
    height = float(prism.nodes[2].min()) - 0.02
    ground = tc.Ground(2e3, damping=0.3, friction=0.5, slip_speed=0.05, height=height)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0), gravity=9.81, ground=ground)
    held = {"rest_length": 0.98 * prism.string_length()}
    V = thrown(prism, 0.2, runs=MORE)[1]
    how = {"tolerance": 1e-3, "output_step": 0.05}
    loose = many(model, 0.5, how, {"velocities": V}, **held)
    tight = many(model, 0.5, how | {"tolerance": 1e-9}, {"velocities": V}, **held)
    off = np.linalg.norm(loose.nodes - tight.nodes, axis=1).max(axis=1)[:, -1] / prism.size
    assert 1e-6 < np.median(off) < 2e-3
    assert (loose.error[:, -1] > 0.5 * off).all()
    assert np.median(loose.error[:, -1] / off) < 4
    runs = {i: tc.simulate(model, 0.5, velocities=V[i], **held, **how) for i in (0, 3, 9, 10)}
    for i, run in runs.items():
        assert run.work.switches == loose.switches[i] > 2
        assert 2 * run.work.evaluations < tight.scene_of(i).simulate().work.evaluations
    assert_same(loose, runs)


@needs_core
def test_lanes_pass_many_switches_as_single_runs_do():
    tower = tc.prism_tower(6)
    N, V = thrown(tower, 0.5, runs=MORE)
    model = tc.Model(tower, strings=tc.LinearStrings(100.0))
    held = {"rest_length": 0.999 * tower.string_length()}
    ways = (
        ({"step": 0.02, "method": "rk4"}, True),
        ({"tolerance": 1e-5, "error": "none"}, True),
        ({"tolerance": 1e-2, "error": "none"}, False),
    )
    for method, is_carried in ways:
        how = {"output_step": 0.1} | method
        batch = many(model, 0.2, how, {"nodes": N, "velocities": V}, **held)
        runs = {i: tc.simulate(model, 0.2, N[i], V[i], **held, **how) for i in (0, 3, 9, 10)}
        assert {run.work.carried > 0 for run in runs.values()} == {is_carried}
        assert all(run.work.switches for run in runs.values())
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
    starts = {"nodes": N, "velocities": V, "rest_length": lengths}
    batch = many(model, 0.1, how, starts | vary)

    def alone(i):
        law = tc.LinearStrings(vary["stiffness"][i], np.full(count, vary["damping"][i]))
        masses = replace(structure, bar_mass=vary["bar_mass"][i])
        own = tc.Model(masses, strings=law, gravity=vary["gravity"][i])
        return tc.simulate(own, 0.1, N[i], V[i], rest_length=lengths[i], **how)

    assert_same(batch, {i: alone(i) for i in (1, RUNS - 1)})


@pytest.mark.parametrize("how", [{"step": 0.01}, {"tolerance": 1e-5}])
def test_loads_and_profiles_are_those_of_single_runs(how):
    prism = tc.prism()
    N, V, lengths = scene(prism)
    loads = np.random.default_rng(3).standard_normal((RUNS, 3, 6))
    # In the second span the input differs by more than a fifth from that of the first.
    profile = tc.Profile([0.0, 0.05, 0.12], np.outer(lengths[0], [1.0, 0.75, 1.0]))
    model = tc.Model(prism, strings=tc.LinearStrings(100.0), external_force=True)
    how = {**how, "output_step": 0.05}
    vary = {"nodes": N, "velocities": V, "external_force": loads}
    batch = many(model, 0.15, how, vary, rest_length=profile, external_force=0)
    runs = {
        i: tc.simulate(model, 0.15, N[i], V[i], rest_length=profile, external_force=loads[i], **how)
        for i in LOOKED_AT
    }
    assert_same(batch, runs)


@pytest.mark.parametrize("how", [{"step": 0.01}, {"tolerance": 1e-5}])
def test_a_run_that_fails_ends_alone(how):
    prism = tc.prism()
    N, V, lengths = scene(prism)
    N[1, 2, 3] = np.nan
    N[2] *= 1.1
    V[3] *= 1e6 if "step" in how else 1e160
    lengths[4, 5] = -1.0
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    how = how | {"output_step": 0.1}
    vary = {"nodes": N, "velocities": V, "rest_length": lengths}
    batch = many(model, 0.3, how, vary)
    assert batch.completed.tolist() == [True, False, False, False, False, True]
    assert sorted(batch.messages) == [1, 2, 3, 4]
    why = "finite|velocities"
    for run, said in ((1, "nodes"), (2, "bar 0|bar 1|bar 2"), (3, why), (4, "rest_length")):
        assert any(word in batch.messages[run] for word in said.split("|"))
    assert np.isnan(batch.nodes[[1, 2, 4]]).all()
    assert np.isnan(batch.nodes[3, :, :, -1]).all()
    assert batch.end_time[3] < 0.3 == batch.end_time[0]
    fine = many(model, 0.3, how, {name: value[[0, 5]] for name, value in vary.items()})
    assert np.array_equal(fine.nodes, batch.nodes[[0, 5]])


def test_some_nodes_are_kept():
    prism = replace(tc.prism(), fixed=[3])
    N, V, lengths = scene(prism)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    given = model, 0.1, {"step": 0.01}, {"nodes": N, "velocities": V, "rest_length": lengths}
    every = many(*given)
    some = many(*given, keep_nodes=[4, 3])
    assert np.array_equal(some.nodes, every.nodes[:, :, [4, 3]])
    assert np.array_equal(some.velocities, every.velocities[:, :, [4, 3]])
    assert some.nodes.shape == (RUNS, 3, 2, 2)
    one = many(*given, keep_nodes=4)
    np.testing.assert_array_equal(one.nodes, every.nodes[:, :, 4:5])


@pytest.mark.parametrize("how", [{}, {"method": "rk4", "step": 0.01}])
def test_of_a_batch_no_run_of_which_can_begin_it_is_said_why(how):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))
    batch = many(model, 0.02, how, {"stiffness": np.zeros(2)}, rest_length=np.ones(9))
    assert not batch.completed.any()
    assert all("expected a positive number" in batch.messages[run] for run in range(2))


@pytest.mark.parametrize(
    ("vary", "more", "said"),
    [
        ({}, {}, "vary is empty, so all runs are the same"),
        ([1.0], {}, "vary is a list"),
        ({"rest_length": np.ones((2, 8))}, {}, r"vary\['rest_length'\] has shape"),
        ({"nodes": np.zeros((2, 3, 6)), "rest_length": np.ones(3)}, {}, "3 runs, but vary.'nodes"),
        ({"colour": [1, 2]}, {}, "vary is 'colour', expected .*'stiffness'"),
        ({"force_density": np.ones(2)}, {}, "vary is 'force_density'"),
        ({"gravity": np.ones((2, 2))}, {}, r"\(2, 3\)"),
        ({"stiffness": np.ones(0)}, {}, "0 runs"),
        ({"stiffness": 1j}, {}, "vary.*stiffness.*runs, 9"),
        ({"stiffness": 2.0}, {}, "vary.*stiffness.*runs, 9"),
        ({"nodes": np}, {}, "nodes"),
        ({"nodes": np.zeros((3, 6))}, {}, r"nodes.*\(3, 6\)"),
        ({"rest_length": np.ones(2)}, {"keep_nodes": [6]}, "keep_nodes"),
        ({"rest_length": np.ones(2)}, {"keep_nodes": [[1, 2]]}, r"keep_nodes.*\(1, 2\)"),
        ({"external_force": np.ones((2, 3, 6))}, {}, "no load"),
        ({"rest_length": np.ones(10**6)}, {"output_step": 1e-3}, "GB of memory"),
    ],
)
def test_bad_input_is_named(vary, more, said):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))
    how = {"step": 0.01} | {name: more.pop(name) for name in list(more) if name == "output_step"}
    kept = more.pop("keep_nodes", None)
    held = tc.Scene(model, 1.0, rest_length=1.0, integration=tc.Integration(**how), **more)
    with pytest.raises((TypeError, ValueError), match=said):
        tc.simulate_many(held, vary, kept)


def test_a_model_is_no_scene():
    with pytest.raises(TypeError, match=r"scene is .*Model.*, expected Scene: make one by Scene"):
        tc.simulate_many(tc.Model(tc.prism()), {"force_density": [1.0, 2.0]})


@pytest.mark.parametrize(
    ("friction", "back_end"),
    [
        pytest.param([0.2, 0.9], "core, runs side by side", marks=needs_core),
        ([0.0, 0.9], "a model built for each run"),
    ],
)
def test_numbers_of_the_ground_vary(friction, back_end):
    ball = tc.library.six_bar_ball()
    floor = tc.Ground(5e3, damping=0.3, friction=0.4, height=float(ball.nodes[2].min()) - 0.01)
    strings = tc.LinearStrings(500.0, damping=1.0)
    model = tc.Model(ball, strings=strings, gravity=9.81, ground=floor)
    V = np.array([[0.5], [0.0], [0.0]]) * np.ones(12)
    held = {"velocities": V, "rest_length": 0.95 * ball.string_length()}
    how = {"step": 1e-3, "output_step": 0.1}
    vary = {"ground.friction": np.array(friction), "ground.stiffness": np.array([3e3, 9e3])}
    batch = many(model, 0.2, how, vary, **held)
    assert np.abs(batch.nodes[0] - batch.nodes[1]).max() > 1e-3
    assert batch.choice.back_end == back_end

    def alone(i):
        ground = replace(floor, friction=friction[i], stiffness=[3e3, 9e3][i])
        own = tc.Model(ball, strings=strings, gravity=9.81, ground=ground)
        return tc.simulate(own, 0.2, **held, **how)

    assert_same(batch, {i: alone(i) for i in range(2)})


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("how", [{"step": 0.01}, {"tolerance": 1e-5}])
def test_an_interrupt_keeps_the_runs_that_are_done(monkeypatch, how):
    prism = tc.prism()
    N, V, lengths = scene(prism)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    count = 60
    held = tc.Scene(model, 0.05, rest_length=lengths[0], integration=tc.Integration(**how))
    starts = {"nodes": np.resize(N, (count, 3, 6)), "velocities": np.resize(V, (count, 3, 6))}
    whole = tc.simulate_many(held, starts, threads=1)

    @contextmanager
    def told(*_, **__):
        def report(done):
            if 0 < done < count:
                os.kill(os.getpid(), signal.SIGINT)

        yield report

    monkeypatch.setattr(simulate_many_file(), "progress_bar", told)
    with pytest.warns(InterruptionWarning, match="runs are done"):
        part = tc.simulate_many(held, starts, threads=1)
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
    vary = {"nodes": N, "velocities": V, "rest_length": lengths, "stiffness": stiffness}
    batch = many(model, 0.3, how, vary)
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
    how, held = {"step": 0.01, "output_step": 0.01}, {"rest_length": lengths[0]}
    vary = {"nodes": N, "velocities": V, "external_force": loads}
    run = many(model, 0.1, how, vary, external_force=0, **held).trajectory(2)
    alone = tc.simulate(model, 0.1, N[2], V[2], external_force=loads[2], **held, **how)
    assert run.health == alone.health
    for what in ("rest_length", "force_density", "energy", "momentum"):
        assert np.array_equal(getattr(run, what), getattr(alone, what)), what


def test_a_run_that_is_not_whole_is_no_trajectory():
    prism = tc.prism()
    N, V, lengths = scene(prism)
    V[3] *= 1e6
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    how = {"step": 0.01}
    batch = many(model, 0.1, how, {"nodes": N, "velocities": V, "rest_length": lengths})
    with pytest.raises(ValueError, match=r"run 3 ended early: .*finite"):
        batch.trajectory(3)
    with pytest.raises(ValueError, match="run"):
        batch.trajectory(RUNS)
    with pytest.raises(TypeError, match=r"limits is .*HealthLimits"):
        batch.trajectory(0, {"energy": 1.0})
    with pytest.raises(tc.simulation.SimulationError, match="bar length error"):
        batch.trajectory(0, tc.HealthLimits(bar_length_error=1e-15, action="raise"))
    some = many(model, 0.1, how, {"nodes": N[:2]}, [4], rest_length=0.9)
    with pytest.raises(ValueError, match="leave keep_nodes out"):
        some.trajectory(1)
    grounded = tc.Model(prism, strings=model.strings, ground=tc.Ground(1e3))
    with pytest.raises(ValueError, match="ground, or inputs that change"):
        many(grounded, 0.02, how, {"nodes": N[:2]}, rest_length=0.9).trajectory(0)
