"""Open-loop motion against the oracle, and what physics says of it."""

import sys

import numpy as np
import pytest
from scipy.integrate import simpson

import tenscontrol as tc
from tests.dynamics.scenes import (
    paper_force_density,
    random_force_density,
    random_motion,
    random_structure,
    random_turn,
    rest_lengths,
    weighted_prism,
)
from tests.located_motion import exact_motion
from tests.oracle import HeldForceDensity, HeldRestLength

# Error of a node over 5 s, m; drift of a bar length, m; swing of the energy over its start.
PAPER_ERROR, PAPER_DRIFT, PAPER_ENERGY = 1e-5, 1e-6, 3e-5


def momenta(run):
    """Largest linear and angular momentum, kg m/s and kg m²/s."""
    return max(np.abs(run.momentum).max(), np.abs(run.angular_momentum).max())


def drift(run):
    return np.abs(run.bar_length_error).max()


def paper_model(damping=0.0):
    return tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping))


# ---- the paper's example 1: strings go slack and taut 55 times ----


@pytest.fixture(scope="module")
def paper_run(paper_motion):
    """The simulation that a user would write first."""
    return tc.simulate(paper_model(), 5.0, rest_length=paper_motion.rest_length, step=1e-3)


def test_the_first_node_follows_the_oracle_over_five_seconds(paper_run, paper_motion):
    np.testing.assert_allclose(paper_run.time, paper_motion.time, rtol=0, atol=1e-12)
    error = np.linalg.norm(paper_run.nodes[:, 0] - paper_motion.nodes[:, 0], axis=0)
    assert error.max() < PAPER_ERROR


def test_every_node_follows_the_oracle_over_five_seconds(paper_run, paper_motion):
    assert np.abs(paper_run.nodes - paper_motion.nodes).max() < PAPER_ERROR


def test_bars_keep_their_lengths(paper_run):
    assert drift(paper_run) < PAPER_DRIFT


def test_a_free_prism_keeps_its_momenta_to_round_off(paper_run):
    assert momenta(paper_run) < 1e-12


def test_energy_is_kept_within_the_error_of_the_switches(paper_run):
    """Measured: 1.92e-4 J of 8.05 J."""
    assert np.ptp(paper_run.energy) < PAPER_ENERGY * paper_run.energy[0]


def test_horizontal_strings_are_slack_a_fifth_of_the_time(paper_run):
    slack = paper_run.force_density == 0.0
    assert not slack[6:].any()
    np.testing.assert_allclose(slack[:6].mean(axis=1), 0.22, atol=0.01)


@pytest.mark.parametrize(("tolerance", "error"), [(1e-6, 1e-4), (1e-9, 1e-7), (1e-12, 2e-10)])
def test_the_adaptive_method_follows_the_oracle(paper_motion, tolerance, error):
    """Measured: 33, 24 and 38 tolerances; momentum at round-off, drift below the error."""
    run = tc.simulate(
        paper_model(),
        5.0,
        rest_length=paper_motion.rest_length,
        tolerance=tolerance,
        output_step=1e-2,
    )
    assert np.abs(run.nodes - paper_motion.nodes[:, :, ::10]).max() < error
    assert momenta(run) < 1e-12
    assert drift(run) < error


# ---- scenes without switches ----

# Name, γ_v, stiffness (None where γ is held), damping; measured errors of rk4 at 1 ms over 5 s.
SMOOTH = {
    "tense": (45.0, 100.0, 0.0, 1e-7, 4e-8, 1e-7),
    "damped": (9.0, 100.0, 1.0, 3e-8, 5e-8, None),
    "tense_damped": (45.0, 100.0, 1.0, 2e-8, 3e-8, None),
    "held": (9.0, None, 0.0, 2e-6, 2e-6, 1e-6),
    "tense_held": (45.0, None, 0.0, 2e-6, 1e-6, 1e-6),
}


def smooth_scene(name):
    """Model, held input and exact motion every 50 ms over 2 s."""
    vertical, stiffness, damping = SMOOTH[name][:3]
    prism, gamma = tc.prism(), paper_force_density(vertical)
    if stiffness is None:
        law, model, held = HeldForceDensity(gamma), tc.Model(prism), {"force_density": gamma}
    else:
        lengths = rest_lengths(prism, gamma, stiffness)
        law = HeldRestLength(lengths, stiffness, damping)
        model, held = paper_model(damping), {"rest_length": lengths}
    times = np.linspace(0, 2, 41)
    exact, switches = exact_motion(prism, law, times)
    assert len(switches) == 0
    return model, held, exact


@pytest.mark.parametrize("name", SMOOTH)
def test_scenes_without_slack_follow_the_oracle(name):
    model, held, exact = smooth_scene(name)
    error, stretch, energy = SMOOTH[name][3:]
    fixed = tc.simulate(model, 2.0, step=1e-3, output_step=0.05, **held)
    assert np.linalg.norm(fixed.nodes - exact, axis=0).max() < error
    assert drift(fixed) < stretch
    assert momenta(fixed) < 1e-12
    if energy is not None:
        assert np.ptp(fixed.energy) < energy * fixed.energy[0]
    adaptive = tc.simulate(model, 2.0, tolerance=1e-12, output_step=0.05, **held)
    assert np.abs(adaptive.nodes - exact).max() < 2e-10
    assert momenta(adaptive) < 1e-12
    assert drift(adaptive) < 1e-10
    if energy is not None:
        assert np.ptp(adaptive.energy) < 1e-9 * adaptive.energy[0]


# ---- other scenes, over a shorter time ----


def short_scene(name):
    """Structure, law of the oracle, model, held input, start, load."""
    still = None
    load = None
    if name == "point masses":
        structure = weighted_prism()
        gamma = np.r_[np.full(6, 17.3205), np.full(6, 18.0)]
        lengths = rest_lengths(structure, gamma, 200.0)
        law, strings = HeldRestLength(lengths, 200.0), tc.LinearStrings(200.0)
    elif name == "slack and damped":
        structure = tc.prism()
        lengths = rest_lengths(structure, paper_force_density(9.0), 100.0)
        law, strings = HeldRestLength(lengths, 100.0, 0.05), tc.LinearStrings(100.0, 0.05)
    elif name == "constant rigidity":
        structure = tc.prism()
        gamma = paper_force_density(9.0)
        lengths = 80.0 * structure.string_length() / (80.0 + gamma * structure.string_length())
        law = HeldRestLength(lengths, 80.0 / lengths)
        strings = tc.ElasticStrings(80.0)
    elif name == "moving start":
        structure = random_structure(2, bars=3, points=1)
        still = random_motion(structure, 5)
        lengths = 0.5 * structure.string_length()
        law, strings = HeldRestLength(lengths, 30.0, 0.1), tc.LinearStrings(30.0, 0.1)
    else:
        structure = tc.prism()
        lengths = rest_lengths(structure, paper_force_density(30.0), 100.0)
        law, strings = HeldRestLength(lengths, 100.0), tc.LinearStrings(100.0)
        load = np.random.default_rng(1).normal(size=(3, 6))
    start = still or (structure.nodes, np.zeros_like(structure.nodes))
    model = tc.Model(structure, strings=strings, external_force=load is not None)
    return law, model, lengths, start, load


@pytest.mark.parametrize(
    ("name", "switches"),
    [
        ("point masses", True),
        ("slack and damped", True),
        ("constant rigidity", True),
        ("moving start", True),
        ("load", False),
    ],
)
def test_other_scenes_follow_the_oracle(name, switches):
    law, model, lengths, start, load = short_scene(name)
    times = np.linspace(0, 0.5, 11)
    exact, found = exact_motion(model.structure, law, times, *reversed(start), load)
    assert (len(found) > 0) == switches
    run = tc.simulate(
        model,
        0.5,
        *start,
        rest_length=lengths,
        external_force=load,
        tolerance=1e-12,
        output_step=0.05,
    )
    assert np.abs(run.nodes - exact).max() < 1e-9 * np.abs(exact).max()


# ---- energy ----


def test_damping_only_takes_energy_out():
    run = tc.simulate(
        paper_model(damping=1.0),
        2.0,
        rest_length=rest_lengths(tc.prism(), paper_force_density(9.0), 100.0),
        tolerance=1e-10,
    )
    assert np.diff(run.energy).max() < 1e-9
    assert run.energy[-1] < run.energy[0] - 1.0


def test_the_energy_that_damping_takes_is_the_work_of_its_force():
    """``-∫ Σ c l̇² dt`` by Simpson's rule over the returned states, all strings taut."""
    prism, damping = tc.prism(), 1.0
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    run = tc.simulate(
        paper_model(damping), 1.0, rest_length=lengths, tolerance=1e-11, output_step=2.5e-4
    )
    assert run.force_density.min() > 0
    start, end = prism.strings.T
    S, Sd = (part[:, end] - part[:, start] for part in (run.nodes, run.velocities))
    rates = (S * Sd).sum(axis=0) / np.linalg.norm(S, axis=0)
    lost = simpson(damping * (rates**2).sum(axis=0), x=run.time)
    assert run.energy[0] - run.energy[-1] == pytest.approx(lost, rel=1e-9)


def test_energy_is_kept_where_force_density_is_held(prism):
    """Measured at 1 ms: 2.3e-5 J of 53 J over 5 s, and of order 4 to 5 in the step."""
    swings = []
    for step in (4e-3, 2e-3, 1e-3):
        run = tc.simulate(tc.Model(prism), 5.0, force_density=paper_force_density(9.0), step=step)
        swings.append(np.ptp(run.energy) / run.energy[0])
    assert swings[-1] < 1e-6
    assert swings[0] / swings[1] > 12
    assert swings[1] / swings[2] > 12


def test_energy_with_a_load_counts_the_work_of_the_load():
    _, model, lengths, _, load = short_scene("load")
    run = tc.simulate(model, 1.0, rest_length=lengths, external_force=load, tolerance=1e-11)
    assert np.ptp(run.kinetic_energy) > 0.1
    assert np.ptp(run.energy) < 1e-7


# ---- loads ----


def test_the_centre_of_mass_falls_freely(prism):
    """A constant load moves the centre of mass by ½ (ΣW/m) t², whatever the strings do."""
    load = np.random.default_rng(0).normal(size=(3, 6))
    model = tc.Model(prism, external_force=True)
    run = tc.simulate(
        model, 2.0, force_density=paper_force_density(9.0), external_force=load, step=1e-3
    )
    centre = run.nodes.mean(axis=1)  # bars of equal mass
    expected = centre[:, :1] + 0.5 * load.sum(axis=1)[:, None] / 3.0 * run.time**2
    assert np.abs(centre - expected).max() < 1e-12
    total = load.sum(axis=1)[:, None] * run.time
    assert np.abs(run.momentum - total).max() < 1e-11


def test_weight_leaves_the_internal_motion_alone(prism):
    """Under gravity, in proportion to the mass, all falls alike."""
    weight = np.zeros((3, 6))
    weight[2] = -9.81 * 0.5  # half a bar of 1 kg on each node
    gamma = paper_force_density(9.0)
    falling = tc.simulate(
        tc.Model(prism, external_force=True),
        1.0,
        force_density=gamma,
        external_force=weight,
        step=1e-3,
    )
    free = tc.simulate(tc.Model(prism), 1.0, force_density=gamma, step=1e-3)
    fallen = -0.5 * 9.81 * free.time**2
    relative = falling.nodes - fallen * np.array([0.0, 0.0, 1.0])[:, None, None]
    np.testing.assert_allclose(relative, free.nodes, rtol=0, atol=1e-11)


# ---- symmetry and simple motions ----


def test_a_turned_start_gives_the_turned_motion(prism):
    turn = random_turn(3)
    lengths = rest_lengths(prism, paper_force_density(45.0), 100.0)
    how = {"rest_length": lengths, "step": 1e-3}
    here = tc.simulate(paper_model(), 1.0, **how)
    there = tc.simulate(paper_model(), 1.0, turn @ prism.nodes, **how)
    expected = np.einsum("ij,jnt->int", turn, here.nodes)
    np.testing.assert_allclose(there.nodes, expected, rtol=0, atol=1e-11)


def test_a_moving_frame_changes_nothing(prism):
    lengths = rest_lengths(prism, paper_force_density(45.0), 100.0)
    how = {"rest_length": lengths, "step": 1e-3}
    travel = np.array([[1.0], [-2.0], [0.5]]) * np.ones((3, 6))
    here = tc.simulate(paper_model(), 1.0, **how)
    there = tc.simulate(paper_model(), 1.0, None, travel, **how)
    moved = here.nodes + travel[:, :, None] * here.time
    np.testing.assert_allclose(there.nodes, moved, rtol=0, atol=1e-11)


def test_a_prism_at_rest_stays_at_rest(prism, rest):
    run = tc.simulate(tc.Model(prism), 1.0, force_density=rest.force_density, step=1e-3)
    assert np.abs(run.nodes - prism.nodes[:, :, None]).max() < 1e-12


def test_time_runs_backwards(prism):
    """Forward, velocities reversed, forward again: back at the start."""
    how = {"force_density": paper_force_density(9.0), "tolerance": 1e-12}
    out = tc.simulate(tc.Model(prism), 1.0, **how)
    back = tc.simulate(
        tc.Model(prism),
        1.0,
        tc.structure.restore_bar_lengths(prism, out.nodes[:, :, -1]),
        -out.velocities[:, :, -1],
        **how,
    )
    np.testing.assert_allclose(back.nodes[:, :, -1], prism.nodes, rtol=0, atol=1e-9)


def test_a_free_bar_spins_steadily():
    """One turn a second: after 1 s it is where it was."""
    bar = tc.Structure([[-0.5, 0.5], [0.0, 0.0], [0.0, 0.0]], [[0, 1]], [], bar_mass=2.0)
    spin = np.pi * np.array([[0.0, 0.0], [-1.0, 1.0], [0.0, 0.0]])
    run = tc.simulate(tc.Model(bar), 1.0, None, spin, force_density=[], tolerance=1e-12)
    np.testing.assert_allclose(run.nodes[:, :, -1], bar.nodes, rtol=0, atol=1e-10)
    np.testing.assert_allclose(run.nodes[:, :, 250], [[0, 0], [-0.5, 0.5], [0, 0]], atol=1e-10)


def test_two_masses_on_a_string_oscillate_with_the_reduced_mass():
    """k = 9 N/m between 1 and 3 kg: ω² = k (1/m1 + 1/m2) = 12 s⁻²."""
    pair = tc.Structure(
        [[0.0, 2.0], [0.0, 0.0], [0.0, 0.0]], [], [[0, 1]], [], string_node_mass=[1.0, 3.0]
    )
    model = tc.Model(pair, strings=tc.LinearStrings(9.0))
    period = 2 * np.pi / np.sqrt(12.0)
    # Let go 0.5 m beyond a rest length of 1.5 m, it goes slack after a quarter of the period.
    run = tc.simulate(model, period / 4, rest_length=1.5, tolerance=1e-12)
    gap = run.nodes[0, 1] - run.nodes[0, 0]
    np.testing.assert_allclose(gap, 1.5 + 0.5 * np.cos(np.sqrt(12.0) * run.time), atol=1e-10)


# ---- output times ----


@pytest.mark.parametrize("output_step", [1e-3, 2e-3, 5e-3, 0.1, 1.0])
def test_the_states_do_not_depend_on_how_many_are_kept(prism, output_step):
    how = {"force_density": paper_force_density(9.0), "step": 1e-3}
    every = tc.simulate(tc.Model(prism), 2.0, **how)
    some = tc.simulate(tc.Model(prism), 2.0, output_step=output_step, **how)
    stride = round(output_step / 1e-3)
    assert some.steps == every.steps == 2000
    np.testing.assert_allclose(some.time, every.time[::stride], rtol=0, atol=1e-12)
    np.testing.assert_allclose(some.nodes, every.nodes[:, :, ::stride], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("duration", "output_step", "count"),
    [(1.0, None, 1001), (1.0005, None, 1002), (0.9999, 0.3, 5), (0.0004, None, 2), (0.7, 1.0, 2)],
)
def test_durations_that_are_no_multiple_of_the_step_end_on_time(
    prism, duration, output_step, count
):
    """Steps are shortened to fit, never lengthened, and states stay equally spaced."""
    lengths = rest_lengths(prism, paper_force_density(45.0), 100.0)
    run = tc.simulate(
        paper_model(), duration, rest_length=lengths, step=1e-3, output_step=output_step
    )
    assert len(run.time) == run.nodes.shape[2] == count
    assert run.time[-1] == pytest.approx(duration, rel=1e-15)
    assert np.ptp(np.diff(run.time)) < 1e-12
    assert duration / run.steps <= 1e-3 * (1 + 1e-9)
    adaptive = tc.simulate(
        paper_model(), duration, rest_length=lengths, tolerance=1e-11, output_step=duration
    )
    error = np.abs(run.nodes[:, :, -1] - adaptive.nodes[:, :, -1]).max()
    assert error < 1e-7


def test_by_default_an_adaptive_run_keeps_a_thousand_states(prism, rest):
    run = tc.simulate(tc.Model(prism), 3.0, force_density=rest.force_density)
    assert run.time.shape == (1001,)
    assert (run.method, run.step) == ("dop853", None)
    assert run.evaluations > run.steps > 0


def test_one_number_serves_all_strings():
    model = paper_model()
    one = tc.simulate(model, 0.1, rest_length=0.7, step=1e-3)
    each = tc.simulate(model, 0.1, rest_length=np.full(9, 0.7), step=1e-3)
    np.testing.assert_array_equal(one.nodes, each.nodes)


@pytest.mark.parametrize("seed", range(3))
def test_a_random_structure_from_a_random_start_keeps_its_momenta(seed):
    """A step keeps linear momentum exactly, angular momentum as well as the motion."""
    structure = random_structure(seed, bars=3, points=2)
    start = random_motion(structure, seed)
    gamma = random_force_density(structure, seed)
    run = tc.simulate(tc.Model(structure), 1.0, *start, force_density=gamma, tolerance=1e-12)
    assert np.ptp(run.momentum, axis=1).max() < 1e-12
    assert np.ptp(run.angular_momentum, axis=1).max() < 1e-9


def test_a_large_structure_keeps_fewer_states_by_default(monkeypatch):
    prism, module = tc.prism(), sys.modules["tenscontrol.simulation.scene"]
    numbers = 2 * prism.nodes.size  # of a state
    monkeypatch.setattr(module, "_NUMBERS", 40 * numbers + 5)
    run = tc.simulate(tc.Model(prism), 0.1, force_density=10.0)
    assert run.time.shape == (41,)
    assert tc.simulate(tc.Model(prism), 0.1, force_density=10.0, output_step=0.001).time.size == 101
