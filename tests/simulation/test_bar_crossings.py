"""Bars that pass through each other in a run: found between outputs too, and said once."""

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.simulation import BarCrossingWarning, SimulationError
from tests.random_structures import any_motion_of, any_structure

# Diagonals wound to 0.8 of their length, horizontals let out to 1.6: bars cross four times, and all
# three pairs at once.
OFTEN, DURATION = 12, 1.5


@pytest.fixture(scope="module")
def scene():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=200.0, damping=0.5))
    return model, prism.string_length(prism.nodes) * np.repeat([1.6, 0.8], [6, 3])


@pytest.fixture(scope="module")
def run(scene):
    model, lengths = scene
    with pytest.warns(BarCrossingWarning) as caught:
        run = tc.simulate(model, DURATION, rest_length=lengths)
    (only,) = caught
    assert str(only.message).startswith(
        "bars 0 and 1 pass through each other at 0.1386 s, and 11 more such crossings up to 1.479 s"
    )
    assert only.filename == __file__
    return run


@pytest.fixture(scope="module")
def sampled(scene):
    """Times and pairs by the sign of the volume and where axes meet, at 30,001 times."""
    model, lengths = scene
    limits = tc.HealthLimits(crossings=None)
    fine = tc.simulate(
        model, DURATION, rest_length=lengths, tolerance=1e-9, output_step=5e-5, limits=limits
    )
    found, bars = [], model.structure.bars
    for i, j in ((0, 1), (0, 2), (1, 2)):
        a, b, c, d = (fine.nodes[:, node].T for node in (*bars[i], *bars[j]))
        u, v, w = b - a, d - c, c - a
        volume = (np.cross(u, v) * w).sum(axis=1)
        across = (np.cross(u, v) ** 2).sum(axis=1)
        p = (np.cross(w, v) * np.cross(u, v)).sum(axis=1) / across
        q = (np.cross(w, u) * np.cross(u, v)).sum(axis=1) / across
        inside = (p > 0) & (p < 1) & (q > 0) & (q < 1)
        changes = np.flatnonzero((volume[1:] > 0) != (volume[:-1] > 0))
        share = volume[changes] / (volume[changes] - volume[changes + 1])
        times = fine.time[changes] + share * np.diff(fine.time)[changes]
        found += [(t, (i, j)) for t, k in zip(times, changes, strict=True) if inside[k]]
    assert len(found) == OFTEN
    return found


def assert_same(crossings, expected, within):
    for pair in {bars for _, bars in expected}:
        mine = [each.time for each in crossings if each.bars == pair]
        assert mine == pytest.approx([time for time, bars in expected if bars == pair], abs=within)
    assert len(crossings) == len(expected)


def test_a_prism_wound_down_crosses_its_bars(run, sampled):
    assert_same(run.health.crossings, sampled, 2e-4)
    assert run.health.unresolved_intervals == 0
    assert run.health.clearance.distance == 0
    assert run.health.clearance.bars == (0, 1)
    assert "bars cross        12 times, first 0 and 1 at 0.1386 s" in run.summary().splitlines()


@pytest.mark.filterwarnings("ignore::tenscontrol.simulation.BarCrossingWarning")
@pytest.mark.parametrize("output_step", [1.5, 0.4, 0.3, 0.05])
@pytest.mark.parametrize("step", [None, 1e-3])
def test_crossings_between_two_outputs_are_found(scene, sampled, output_step, step):
    """In one output of 0.4 s bars pass through each other and back."""
    model, lengths = scene
    run = tc.simulate(model, DURATION, rest_length=lengths, step=step, output_step=output_step)
    assert_same(run.health.crossings, sampled, 5e-4)
    assert run.health.unresolved_intervals == 0


def test_what_outputs_do_not_tell_is_counted(scene, run):
    """Without a look at the end, a run has its outputs alone."""
    model, lengths = scene
    limits = tc.HealthLimits(crossings=None)
    coarse = tc.simulate(model, DURATION, rest_length=lengths, output_step=0.4, limits=limits)
    assert coarse.health.unresolved_intervals == 4
    assert "bars not seen     in 4 of 4 intervals: output_step is too long" in coarse.summary()
    fine = tc.simulate(model, DURATION, rest_length=lengths, limits=limits)
    assert fine.health == run.health


def test_limits_allow_count_and_raise(scene):
    model, lengths = scene
    for count in (OFTEN, None):
        limits = tc.HealthLimits(crossings=count)
        tc.simulate(model, DURATION, rest_length=lengths, limits=limits)
    with pytest.raises(SimulationError, match="bars 0 and 1 pass through") as caught:
        tc.simulate(
            model, 0.2, rest_length=lengths, limits=tc.HealthLimits(crossings=2, action="raise")
        )
    assert len(caught.value.trajectory.health.crossings) == 3
    for wrong, error in ((-1, ValueError), (1.5, TypeError)):
        with pytest.raises(error, match="crossings"):
            tc.HealthLimits(crossings=wrong)


def test_a_single_crossing_is_said_as_one(scene):
    """Of two bars; the second is thrown through the first."""
    nodes = np.array([[-1.0, 1, 0, 0], [0, 0, -1, 1], [0, 0, 1, 1]])
    pair = tc.Structure(nodes, [(0, 1), (2, 3)], [(0, 2)], 1.0)
    velocities = np.array([[0.0, 0, 0, 0], [0, 0, 0, 0], [0, 0, -2, -2]])
    with pytest.warns(BarCrossingWarning, match=r"bars 0 and 1 pass .* at 0\.5 s, which"):
        run = tc.simulate(tc.Model(pair), 1.2, nodes, velocities, force_density=0.0)
    (only,) = run.health.crossings
    assert only.time == pytest.approx(0.5, abs=1e-9)
    assert "bars cross        once, 0 and 1 at 0.5 s" in run.summary()


def test_planar_structures_and_single_bars_have_none():
    flat = tc.library.snelson_x(dimension=2)
    mast = tc.Structure(np.eye(3), [(0, 1)], [(0, 2), (1, 2)], 1.0, fixed=[2])
    for structure in (flat, mast):
        run = tc.simulate(tc.Model(structure), 0.1, force_density=1.0, step=1e-2)
        assert run.health.crossings is None
        assert run.health.clearance is None
        assert run.health.unresolved_intervals == 0


def test_the_clearance_of_a_ball_at_rest_is_that_of_its_shape():
    ball = tc.library.six_bar_ball()
    run = tc.simulate(tc.Model(ball), 0.5, force_density=tc.prestress(ball, 20.0).force_density)
    rest = tc.prestress(ball, 20.0)
    assert run.health.crossings == ()
    assert run.health.clearance.distance == pytest.approx(rest.clearance, rel=1e-9)


@pytest.mark.filterwarnings("ignore::tenscontrol.simulation.BarCrossingWarning")
@pytest.mark.parametrize("seed", range(6))
def test_bars_with_a_common_node_are_never_counted(seed):
    structure = any_structure(seed, 2, 3)
    nodes, velocities = any_motion_of(structure, seed)
    model = tc.Model(structure)
    run = tc.simulate(model, 1.0, nodes, 3 * velocities, force_density=1.0, output_step=0.05)
    bars = [set(each) for each in structure.bars.tolist()]
    assert all(not bars[i] & bars[j] for i, j in (each.bars for each in run.health.crossings))


def test_files_and_copies_hold_what_was_found(run, tmp_path):
    saved = tc.load_run(run.save(tmp_path / "run.npz"))
    copied = pickle.loads(pickle.dumps(run))
    for other in (saved, copied):
        assert other.health == run.health
        assert other.summary() == run.summary()


@pytest.mark.parametrize(
    "kwargs",
    [{}, {"output_step": 0.05}, {"step": 1e-3}, {"step": 2e-3, "method": "energy_momentum"}],
)
def test_each_run_of_a_batch_has_its_own(scene, sampled, kwargs):
    model, lengths = scene
    starts = np.stack([lengths, model.structure.string_length(), lengths])
    starts[2] *= 1.001
    how = tc.Integration(**kwargs)
    batched = tc.Scene(model, DURATION, rest_length=lengths, integration=how)
    batch = tc.simulate_many(batched, {"rest_length": starts})
    found = batch.crossings
    assert found.count.tolist() == [OFTEN, 0, OFTEN]
    assert found.first_time[0] == pytest.approx(sampled[0][0], abs=5e-4)
    assert np.isnan(found.first_time[1])
    assert found.first_time[2] != found.first_time[0]
    assert found.unresolved_intervals.tolist() == [0, 0, 0]


def test_batches_say_what_they_cannot_tell(scene):
    model, lengths = scene
    starts = np.stack([model.structure.nodes] * 2)
    values = np.stack([lengths, lengths, 1.01 * lengths], axis=1)
    growing = tc.Profile([0.0, 0.1, DURATION], values)
    growth = tc.Scene(model, DURATION, rest_length=growing)
    batch = tc.simulate_many(growth, {"nodes": starts})
    assert batch.crossings.unresolved_intervals.tolist() == [1, 1]
    finer = replace(growth, integration=tc.Integration(output_step=0.3))
    batch = tc.simulate_many(finer, {"nodes": starts})
    assert batch.crossings.count.tolist() == [OFTEN, OFTEN]
    assert batch.crossings.unresolved_intervals.tolist() == [0, 0]
    some = tc.simulate_many(replace(growth, duration=0.1), {"nodes": starts}, keep_nodes=[0])
    with pytest.raises(ValueError, match="leave keep_nodes out"):
        _ = some.crossings
    flat = tc.library.snelson_x(dimension=2)
    starts = np.stack([flat.nodes] * 2)
    held = tc.Scene(tc.Model(flat), 0.1, force_density=1.0)
    batch = tc.simulate_many(held, {"nodes": starts})
    assert batch.crossings is None


def test_a_run_without_crossings_is_silent(scene):
    model, _ = scene
    with warnings.catch_warnings(action="error"):
        tc.simulate(model, 0.5, rest_length=0.9 * model.structure.string_length())


@pytest.mark.parametrize("seed", range(6))
def test_the_core_finds_the_crossings_that_numpy_finds(seed, monkeypatch):
    random = np.random.default_rng(seed)
    ball = tc.library.six_bar_ball() if seed % 2 else tc.prism_tower(4)
    model = tc.Model(ball, strings=tc.LinearStrings(stiffness=50.0))
    lengths = ball.string_length() * random.uniform(0.4, 1.6, len(ball.strings))
    how = {"rest_length": lengths, "output_step": random.choice([0.01, 0.05]), "error": "none"}
    with warnings.catch_warnings(action="ignore"):
        here = tc.simulate(model, 1.0, **how)
        monkeypatch.setattr("tenscontrol.structure.bar_clearance.library", lambda: None)
        there = tc.simulate(model, 1.0, **how)
    assert here.health.crossings == there.health.crossings
    assert here.health.clearance == there.health.clearance
