"""Bars over a motion: which of them cross and how near they come, against fine sampling."""

import itertools

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import tenscontrol as tc
from tenscontrol.structure import bar_clearance
from tenscontrol.structure.bar_clearance import BarMotion, bar_distances
from tests.random_structures import any_structure


def two_bars(height=1.0, first=(-1.0, 1.0)):
    """A bar along x at rest, and one along y above it, in space."""
    nodes = np.array([[*first, 0, 0], [0, 0, -1, 1], [0, 0, height, height]], dtype=float)
    return tc.Structure(nodes, [(0, 1), (2, 3)], [(0, 2), (1, 3)], 1.0)


def uniform(structure, velocity, time):
    """Return nodes and velocities of a motion in which the second bar moves uniformly."""
    velocities = np.zeros(structure.nodes.shape)
    velocities[:, 2:] = np.reshape(velocity, (3, 1))
    return (
        structure.nodes[:, :, None] + velocities[:, :, None] * time,
        np.repeat(velocities[:, :, None], len(time), axis=2),
    )


@pytest.mark.parametrize("count", [2, 3, 18, 400])
@pytest.mark.parametrize("straight", [False, True])
def test_a_bar_that_falls_through_another(count, straight):
    pair, time = two_bars(), np.linspace(2.0, 5.0, count)
    nodes, velocities = uniform(pair, (0.1, 0.0, -1 / 1.7), time - 2)
    motion = BarMotion(pair, time, nodes, None if straight else velocities)
    (found,) = motion.crossings
    assert found.time == pytest.approx(3.7, abs=1e-9)
    assert found.bars == (0, 1)
    assert motion.clearance.distance == 0
    assert motion.clearance.time == found.time


@pytest.mark.parametrize("sideways", [1.1, -1.1, 2.0])
def test_a_bar_that_falls_past_the_end_of_another(sideways):
    """The lines meet, the bars do not."""
    pair, time = two_bars(), np.linspace(0, 3, 31)
    pair = tc.Structure(
        pair.nodes + np.array([sideways, 0, 0])[:, None] * [0, 0, 1, 1],
        pair.bars, pair.strings, 1.0,
    )  # fmt: skip
    motion = BarMotion(pair, time, *uniform(pair, (0, 0, -1), time))
    assert motion.crossings == ()
    assert motion.clearance.distance == pytest.approx(abs(sideways) - 1, rel=1e-3)
    assert motion.clearance.bars == (0, 1)
    assert motion.clearance.time == pytest.approx(1.0, abs=0.06)


def test_in_and_out_between_two_states_is_two_crossings():
    """A parabola: 0.01 m deep, over 0.4 of an interval of 1 s."""
    pair = two_bars(height=0.24)
    time, velocities = np.array([0.0, 1.0]), np.zeros((3, 4, 2))
    velocities[2, 2:] = [-1.0, 1.0]
    nodes = np.repeat(pair.nodes[:, :, None], 2, axis=2)
    motion = BarMotion(pair, time, nodes, velocities)
    assert [each.time for each in motion.crossings] == pytest.approx([0.4, 0.6])
    assert motion.unresolved == 1  # two states are too few to be sure


def test_a_touch_is_no_crossing():
    pair = two_bars(height=0.26)
    time, velocities = np.linspace(0, 1, 101), np.zeros((3, 4, 101))
    velocities[2, 2:] = 2 * time - 1
    nodes = np.repeat(pair.nodes[:, :, None], 101, axis=2)
    nodes[2, 2:] += time * (time - 1)
    motion = BarMotion(pair, time, nodes, velocities)
    assert motion.crossings == ()
    assert motion.clearance.distance == pytest.approx(0.01)
    assert motion.clearance.time == pytest.approx(0.5, abs=1e-4)


def test_what_cannot_cross_has_no_record():
    time = np.linspace(0, 1, 20)
    single = tc.Structure(np.eye(3), [(0, 1)], [(1, 2)], 1.0, point_mass=[0, 0, 1])
    star = tc.Structure(np.eye(3, 4), [(0, 3), (1, 3), (2, 3)], [(0, 1)], 1.0)
    for structure in (single, star, tc.library.snelson_x(dimension=2)):
        nodes = np.repeat(structure.nodes[:, :, None], len(time), axis=2)
        motion = BarMotion(structure, time, nodes, np.zeros_like(nodes))
        assert motion.crossings == ()
        assert motion.clearance is None


def sampled(structure, nodes):
    """Return (sample, pair) of all crossings, and the least distance, of shapes (d, n, S)."""
    crossings, least = [], np.inf
    for i, j in itertools.combinations(range(len(structure.bars)), 2):
        (a, b), (c, d) = structure.bars[[i, j]]
        if {a, b} & {c, d}:
            continue
        A, B, C, D = (nodes[:, e].T for e in (a, b, c, d))
        u, v, w = B - A, D - C, C - A
        # A + p u is nearest to C + q v: by the normal equations, and with one of them at an end.
        M = np.stack([u, -v], axis=2)
        inner = np.linalg.solve(M.swapaxes(1, 2) @ M, M.swapaxes(1, 2) @ w[:, :, None])[:, :, 0]
        inside = ((inner >= 0) & (inner <= 1)).all(axis=1)
        places = [np.where(inside[:, None], inner, 0.0)]
        for end in (0.0, 1.0):
            q = ((end * u - w) * v).sum(axis=1) / (v * v).sum(axis=1)
            p = ((w + end * v) * u).sum(axis=1) / (u * u).sum(axis=1)
            places += [np.column_stack([0 * q + end, q]), np.column_stack([p, 0 * p + end])]
        for place in places:
            p, q = np.clip(place, 0, 1).T[:, :, None]
            least = min(least, np.linalg.norm(p * u - q * v - w, axis=1).min())
        side = np.sign(np.linalg.det(np.stack([u, v, w], axis=2)))
        changed = np.flatnonzero((side[1:] != side[:-1]) & (inside[1:] | inside[:-1]))
        crossings += [(sample + 1, (i, j)) for sample in changed.tolist()]
    return sorted(crossings), least


@pytest.mark.parametrize("seed", range(6))
def test_random_motions_against_fine_sampling(seed):
    """Bars that turn and shift at random, some of which cross many times."""
    random = np.random.default_rng(seed)
    count, states = 4, 25
    time = np.sort(random.uniform(0, 2, states))
    phase, rate = random.uniform(0, 6, (2, 3, 2 * count, 1))
    start = np.sin(phase) + 0.4 * random.normal(size=(3, 2 * count, 1))
    nodes = start + 0.5 * np.sin(rate * time + phase)
    velocities = 0.5 * rate * np.cos(rate * time + phase)
    bars = [(2 * i, 2 * i + 1) for i in range(count)]
    structure = tc.Structure(nodes[:, :, 0], bars, [(0, 2)], 1.0)
    motion = BarMotion(structure, time, nodes, velocities)
    samples = np.linspace(time[0], time[-1], 4001)
    spline = CubicHermiteSpline(time, np.moveaxis(nodes, 2, 0), np.moveaxis(velocities, 2, 0))
    expected, least = sampled(structure, np.moveaxis(spline(samples), 0, 2))
    assert [each.bars for each in motion.crossings] == [bars for _, bars in expected]
    for found, (sample, _) in zip(motion.crossings, expected, strict=True):
        assert samples[sample - 1] <= found.time <= samples[sample]
    if expected:
        assert motion.clearance.distance == 0
    else:
        assert motion.clearance.distance == pytest.approx(least, rel=2e-3)


@pytest.mark.parametrize("seed", range(4))
def test_pairs_near_by_are_all_that_can_meet(seed, monkeypatch):
    """Bars of very different length, of which a tree finds those within reach."""
    random = np.random.default_rng(seed)
    count, time = 30, np.linspace(0, 1, 40)
    start, end = random.uniform(0, 6, (2, 3, count))
    end = start + (end - start) * random.choice([0.1, 0.2, 1.0], count, p=[0.6, 0.3, 0.1])
    rate = random.normal(size=(3, 2 * count, 1))
    nodes = np.stack([start, end], axis=2).reshape(3, -1, 1) + np.sin(3 * rate * time) / 2
    bars = [(2 * i, 2 * i + 1) for i in range(count)]
    structure = tc.Structure(nodes[:, :, 0], bars, [(0, 2)], 1.0)
    velocities = 1.5 * rate * np.cos(3 * rate * time)
    every = BarMotion(structure, time, nodes, velocities)
    before = every.crossings, every.clearance
    monkeypatch.setattr(bar_clearance, "_FEW_BARS", 2)
    some = BarMotion(structure, time, nodes, velocities)
    assert some.crossings == before[0]
    assert len(some.crossings) > 0
    assert some.clearance == before[1]
    still = BarMotion(structure, time, nodes[:, :, :1] + 0 * nodes)
    assert still.clearance.distance == bar_distances(structure, structure.nodes).least


def test_bars_with_a_common_node_never_cross():
    """A tower of class 2 whose bars turn about their joints by half a turn and more."""
    towers = [any_structure(seed, 2, 3, False) for seed in range(12)]
    for tower in towers:
        pairs = {(i, j) for i, j in itertools.combinations(range(len(tower.bars)), 2)
                 if set(tower.bars[i]) & set(tower.bars[j])}  # fmt: skip
        assert pairs
        random = np.random.default_rng(len(tower.bars))
        time, size = np.linspace(0, 1, 200), np.ptp(tower.nodes)
        rate = random.normal(size=(*tower.nodes.shape, 1))
        nodes = tower.nodes[:, :, None] + size * np.sin(4 * rate * time)
        motion = BarMotion(tower, time, nodes, 4 * size * rate * np.cos(4 * rate * time))
        assert not {each.bars for each in motion.crossings} & pairs


def test_a_common_fall_changes_nothing():
    prism, time = tc.prism(), np.linspace(0, 2, 200)
    turn = -1.5 * time
    ends = np.repeat(prism.nodes[:, :, None], len(time), axis=2)
    top = np.stack([np.cos(turn) * ends[0, :3] - np.sin(turn) * ends[1, :3],
                    np.sin(turn) * ends[0, :3] + np.cos(turn) * ends[1, :3]])  # fmt: skip
    ends[:2, :3] = top
    velocities = np.zeros_like(ends)
    velocities[:2, :3] = -1.5 * np.stack([-top[1], top[0]])
    at_rest = BarMotion(prism, time, ends, velocities)
    ends, velocities = ends.copy(), velocities.copy()
    ends[2] -= 5 * time**2
    velocities[2] -= 10 * time
    falling = BarMotion(prism, time, ends, velocities)
    assert [each.bars for each in falling.crossings] == [each.bars for each in at_rest.crossings]
    times = [[each.time for each in motion.crossings] for motion in (falling, at_rest)]
    assert times[0] == pytest.approx(times[1], abs=1e-9)
    assert len(times[0]) == 3


def test_states_too_far_apart_are_asked_for_again():
    """A bar that dips through another and back between two states, found by an exact motion."""
    pair, asked = two_bars(height=0.24), []

    def exactly(time):
        nodes, velocities = np.repeat(pair.nodes[:, :, None], len(time), axis=2), 0
        nodes[2, 2:] += 0.3 * (np.cos(2 * np.pi * time) - 1) / 2
        velocities = np.zeros_like(nodes)
        velocities[2, 2:] = -0.3 * np.pi * np.sin(2 * np.pi * time)
        return nodes, velocities

    def again(first, last, parts):
        asked.append((first, last, parts))
        time = first + (last + 1 - first) * np.arange(parts + 1) / parts
        return time, *exactly(time)

    time = np.arange(4.0)
    blind = BarMotion(pair, time, *exactly(time))
    assert blind.crossings == ()
    assert blind.unresolved == 3
    motion = BarMotion(pair, time, *exactly(time), again)
    first = np.arccos(1 - 2 * 0.24 / 0.3) / (2 * np.pi)
    expected = [k + each for k in range(3) for each in (first, 1 - first)]
    assert [each.time for each in motion.crossings] == pytest.approx(expected, abs=3e-4)
    assert motion.unresolved == 0
    assert asked[0][:2] == (0, 2)
    refused = BarMotion(pair, time, *exactly(time), lambda first, last, parts: None)
    assert refused.unresolved == 3


def test_a_motion_that_runs_away_counts_until_then():
    pair, time = two_bars(), np.linspace(0, 4, 41)
    nodes, velocities = uniform(pair, (0, 0, -1), time)
    nodes[:, :, 20:], velocities[:, :, 20:] = np.nan, np.nan
    assert [each.time for each in BarMotion(pair, time, nodes, velocities).crossings] == [1.0]
    nodes[:, :, 5:] = 1e200
    assert BarMotion(pair, time, nodes, velocities).crossings == ()
    assert BarMotion(pair, time, np.nan * nodes, velocities).clearance is None


def test_bars_that_touch_in_the_structure_have_no_sides():
    """A cross of two bars without a node in the middle, which turns and folds."""
    cross, time = two_bars(height=0.0), np.linspace(0, 1, 50)
    nodes, velocities = uniform(cross, (0, 0, 1.0), time)
    assert BarMotion(cross, time, nodes - 0.5 * time, velocities).clearance is None
    assert BarMotion(cross, time, np.sin(9 * time) * nodes, velocities).crossings == ()


def test_bars_that_fly_about_are_not_told_apart():
    """Every pair may meet in every interval: the intervals count as unresolved, at once."""
    tower = tc.library.prism_tower(20)
    rng, count = np.random.default_rng(0), 100
    nodes = tower.nodes[:, :, None] + rng.uniform(-50, 50, (*tower.nodes.shape, count))
    velocities = rng.uniform(-1e4, 1e4, nodes.shape)
    motion = BarMotion(tower, np.arange(count) / count, nodes, velocities)
    assert motion.unresolved == count - 1
    assert motion.crossings == ()


@pytest.mark.parametrize("has_core", [True, False])
def test_a_rate_that_is_no_number_bounds_nothing(monkeypatch, has_core):
    if not has_core:
        monkeypatch.setattr(bar_clearance, "library", lambda: None)
    pair, time = two_bars(), np.linspace(0.0, 1.0, 9)
    nodes, velocities = uniform(pair, (0.1, 0.0, -1.0), time)
    velocities[0, 2, 3] = np.nan  # and numbers after it
    motion = bar_clearance._Intervals.between(time, nodes, velocities, np.arange(8))
    assert np.isnan(motion.strays(np.arange(4))).all()
