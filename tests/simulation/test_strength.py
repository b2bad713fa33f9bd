"""Margins of strength along a run: forces found anew, Euler's column, what is refused."""

import itertools
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.simulation import SimulationError, StrengthWarning
from tests.oracle import consistent_mass
from tests.random_structures import constraint_rows

SOFT = tc.Material(modulus=60e9, density=2700.0, yield_stress=110e6)


def sized(structure, **options):
    given = {"bar_radius": 0.006, "string_radius": 0.001} | options
    return tc.sections(structure, bars=SOFT, strings=SOFT, **given)


def bar_forces(run, k, law, ground, gravity, load):
    """The axial forces of the bars at a time, by the equations of motion of all nodes at once."""
    structure = run.structure
    N, V = run.nodes[:, :, k], run.velocities[:, :, k]
    d, n = N.shape
    rest = run.rest_length[:, k]
    F = load + gravity[:, None] * consistent_mass(structure).sum(axis=1)
    pull = np.zeros(len(rest))
    # A string slides over the nodes of its path: one tension, by its whole length.
    for string, path in enumerate(structure.paths or structure.strings):
        pieces = []
        for i, j in itertools.pairwise(path):
            along = (N[:, j] - N[:, i]) / np.linalg.norm(N[:, j] - N[:, i])
            pieces.append((i, j, along))
        length = sum(np.linalg.norm(N[:, j] - N[:, i]) for i, j, _ in pieces)
        rate = sum(along @ (V[:, j] - V[:, i]) for i, j, along in pieces)
        if length > rest[string]:
            stretch = law.stiffness[string] * (length - rest[string])
            pull[string] = max(stretch + law.damping[string] * rate, 0.0)
        for i, j, along in pieces:
            F[:, i] += pull[string] * along
            F[:, j] -= pull[string] * along
    if ground is not None:
        depth, rate = ground.height - N[-1], -V[-1]
        press = np.where(depth > 0, ground.stiffness * depth * (1 + ground.damping * rate), 0)
        press = np.maximum(press, 0)
        slip = V * np.array([1.0] * (d - 1) + [0.0])[:, None]
        F[-1] += press
        F -= ground.friction * press * slip / np.sqrt((slip**2).sum(axis=0) + ground.slip_speed**2)
    free = np.setdiff1d(np.arange(d * n), structure.fixed_rows)
    M = np.kron(consistent_mass(structure), np.eye(d))[np.ix_(free, free)]
    J = constraint_rows(structure, N)[:, free]
    bars = structure.bars
    moved = ((V[:, bars[:, 1]] - V[:, bars[:, 0]]) ** 2).sum(axis=0)
    J = J / np.abs(J).max(axis=1, keepdims=True)
    B = N[:, bars[:, 1]] - N[:, bars[:, 0]]
    rows = np.zeros((len(bars), d * n))
    for i, (start, end) in enumerate(bars):
        rows[i, d * end : d * end + d], rows[i, d * start : d * start + d] = B[:, i], -B[:, i]
    rows = rows[:, free]
    saddle = np.block([[M, -rows.T], [rows, np.zeros((len(bars), len(bars)))]])
    right = np.concatenate([F.ravel(order="F")[free], -moved])
    found = np.linalg.lstsq(saddle, right, None)[0]
    return found[len(free) :] * np.linalg.norm(B, axis=0), pull


def clustered(structure):
    """The structure with two of its strings that meet as one, which slides over their node."""
    first = tuple(structure.strings[0])
    k = int(np.flatnonzero(structure.strings[:, 0] == first[1])[0])
    path = (*first, structure.strings[k, 1])
    left = [tuple(each) for i, each in enumerate(structure.strings) if i not in (0, k)]
    return tc.Structure(
        structure.nodes, structure.bars, [path, *left], structure.bar_mass, fixed=structure.fixed
    )


@pytest.mark.parametrize(
    "case", ["free", "on ground", "joined and held", "clustered", "joined, clustered, on ground"]
)
def test_margins_are_those_of_forces_found_anew(case):
    law = tc.LinearStrings(2000.0, damping=4.0)
    gravity, ground, load = np.array([0.0, 0.0, -9.81]), None, 0.0
    structure = sized(tc.prism()).structure
    if case == "free":
        gravity = np.zeros(3)
    elif case == "clustered":
        structure = sized(clustered(structure)).structure
    elif case == "joined, clustered, on ground":
        tower = tc.library.class2_tower(stages=2, floating=True)
        structure = sized(clustered(tower)).structure
        ground = tc.Ground(5e3, damping=0.3, friction=0.5, height=structure.nodes[2].min() - 0.01)
    elif case == "on ground":
        ground = tc.Ground(5e3, damping=0.3, friction=0.5, height=structure.nodes[2].min() - 0.01)
    else:
        tower = tc.library.class2_tower(stages=2)
        structure = sized(replace(tower, fixed=[0, 1, 2])).structure
        load = np.random.default_rng(0).normal(size=structure.nodes.shape)
    sections = sized(structure)
    model = tc.Model(structure, law, load if np.ndim(load) else False, gravity, ground)
    run = tc.simulate(
        model, 0.3, rest_length=0.9 * structure.string_length(), step=5e-4, error="none",
        limits=tc.HealthLimits(crossings=None, energy_error=None),
    )  # fmt: skip
    law = run.model.strings
    found = tc.strength(run, sections)
    if ground is not None:  # some of the times below press on it
        pressed = {run.nodes[2, :, k].min() < ground.height for k in (200, 431, 600)}
        assert True in pressed
    area, weak = np.pi * 0.006**2, np.pi * 0.001**2
    inertia = np.pi * 0.006**4 / 4
    for k in (0, 200, 431, 600):
        force, pull = bar_forces(run, k, law, ground, gravity, load + np.zeros(run.nodes.shape[:2]))
        np.testing.assert_allclose(
            run.bar_force_density[:, k] * structure.bar_length, force, atol=1e-5 * abs(force).max()
        )
        euler = np.pi**2 * SOFT.modulus * inertia / structure.bar_length**2
        holds = np.where(force > 0, np.minimum(area * SOFT.yield_stress, euler), area * 110e6)
        np.testing.assert_allclose(found.bar_margin[:, k], holds / np.abs(force), rtol=1e-4)
        with np.errstate(divide="ignore"):
            own = weak * 110e6 / pull
        np.testing.assert_allclose(found.string_margin[:, k], own, rtol=1e-6)
    assert found.margin == pytest.approx(min(found.bar_margin.min(), found.string_margin.min()))
    assert (np.diff(found.least[np.argsort(found.least)]) >= 0).all()
    assert len(found.table().splitlines()) == 1 + len(found.least)


def test_a_column_of_the_library_buckles_at_eulers_load():
    prism = tc.prism()
    slender = sized(prism, bar_radius=0.004, string_radius=0.02)
    rest = tc.prestress(slender.structure, force_density=1.0)
    force = rest.bar_force_density * prism.bar_length
    euler = np.pi**2 * SOFT.modulus * np.pi * 0.004**4 / 4 / prism.bar_length**2
    gamma = rest.force_density * (euler / force)[0]
    run = tc.simulate(tc.Model(slender.structure), 0.01, force_density=gamma, step=1e-3)
    found = tc.strength(run, slender)
    assert found.margin == pytest.approx(1.0, rel=1e-6)
    assert found.limit[-3:] == ("buckling",) * 3
    assert found.when[-3:].max() <= 0.01


def test_what_has_no_margins_is_refused():
    structure = sized(tc.prism()).structure
    model = tc.Model(replace(structure, fixed=[0, 1, 2]), strings=tc.LinearStrings(2000.0))
    rest = 0.95 * structure.string_length()
    lifted = np.zeros((3, 3, 2))
    lifted[2, :, 1] = 1e-3
    profile = tc.Profile([0.0, 0.02], lifted, "cubic")
    run = tc.simulate(model, 0.02, rest_length=rest, support_motion=profile)
    with pytest.raises(ValueError, match="supports move"):
        tc.strength(run, sized(model.structure))
    still = tc.simulate(model, 0.02, rest_length=rest)
    with pytest.raises(
        ValueError, match="sections are of other strings than the run: 24 against 9"
    ):
        tc.strength(still, sized(tc.library.six_bar_ball()))


def spun(**limits):
    """A ball of thin bars that spins up, with limits on its members."""
    ball = tc.library.six_bar_ball()
    thin = sized(ball, bar_radius=0.004)
    model = tc.Model(thin.structure, tc.LinearStrings(2e4, damping=20.0))
    spin = np.cross([0.0, 0.0, 8.0], ball.nodes, axisb=0, axisc=0)
    limits = tc.HealthLimits(sections=thin, **limits)
    how = tc.Integration(step=1e-3, error="none", limits=limits)
    rest = 0.9999 * ball.string_length()
    return tc.Scene(model, 0.3, velocities=spin, rest_length=rest, integration=how), thin


def test_a_run_warns_of_the_member_that_fails_first_and_when():
    scene, thin = spun()
    with pytest.warns(StrengthWarning, match="the margin of ") as told:
        run = scene.simulate()
    found = tc.strength(run, thin)
    below = np.vstack([found.string_margin, found.bar_margin]) < 1
    first = run.time[below.any(axis=0).argmax()]
    soonest = np.flatnonzero(below[:, below.any(axis=0).argmax()])
    named = soonest[found.least[soonest].argmin()]
    name = f"bar {named - 24}" if named >= 24 else f"string {named}"
    assert f"of {name} falls below 1 at {first:.4g} s, to {found.least[named]:.3g}" in (
        str(told[0].message)
    )
    assert f"and {below.any(axis=1).sum() - 1} more members" in str(told[0].message)
    with pytest.raises(SimulationError, match="the margin of ") as stopped:
        spun(action="raise")[0].simulate()
    assert stopped.value.trajectory.time[-1] == pytest.approx(0.3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        spun(margin=0.99 * found.margin)[0].simulate()


def test_a_sweep_counts_runs_whose_members_fail():
    scene, _ = spun(margin=1 / 2.4)
    varied = {"stiffness": tc.Uniform(0.5, 1.5)}
    case = tc.ClosedLoopCase(scene, tolerance=10.0)
    with ThreadPoolExecutor(1) as executor:
        report = tc.sweep(case, varied, 6, seed=0, executor=executor)
    shares = report.figures["utilization"]
    np.testing.assert_array_equal(report.success, shares <= 2.4)
    assert 0 < report.success.sum() < 6
    one = case.together([{"stiffness": s} for s in report.parameters["stiffness"]])
    np.testing.assert_allclose([each().figures["utilization"] for each in one], shares, rtol=1e-9)


def test_limits_of_strength_are_checked_before_the_run():
    scene, thin = spun()
    other = sized(tc.prism())
    with pytest.raises(ValueError, match="sections are of other strings than the run"):
        replace(scene, integration=tc.Integration(limits=tc.HealthLimits(sections=other)))
    with pytest.raises(TypeError, match="sections is a "):
        tc.HealthLimits(sections=1.0)
    with pytest.raises(ValueError, match="margin is 0"):
        tc.HealthLimits(margin=0.0)
    held = replace(thin.structure, fixed=[0, 1, 2])
    with pytest.raises(ValueError, match="forces of bars are not found where supports move"):
        replace(
            scene, model=tc.Model(held, tc.LinearStrings(2e4)), velocities=None,
            support_motion=lambda time: np.zeros((3, 3)),
        )  # fmt: skip
