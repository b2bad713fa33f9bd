"""CVODES through CasADi: error, work, stiffness."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state, unpack_states
from tenscontrol.integrate import IntegrationError
from tenscontrol.integrate.cvodes import CVODES
from tests.dynamics.scenes import paper_force_density, rest_lengths
from tests.integrate.stepping import smooth_equation
from tests.integrate.test_rk4 import oscillator
from tests.located_motion import exact_motion
from tests.oracle import HeldRestLength


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10, 1e-12])
def test_error_follows_the_tolerance(tolerance):
    """Errors of the steps add up: measured 9 to 460 tolerances over ten seconds."""
    run = CVODES(smooth_equation(oscillator()), tolerance).advance(
        np.zeros(2), np.ones(1), 10.0, 50
    )
    times = np.linspace(0.2, 10.0, 50)
    exact = np.array([1 - np.cos(times), np.sin(times)])
    assert np.abs(run.states - exact).max() < 1000 * tolerance


def test_a_tighter_tolerance_takes_more_work():
    work = [
        CVODES(smooth_equation(oscillator()), tolerance)
        .advance(np.zeros(2), np.ones(1), 10.0, 1)
        .work
        for tolerance in (1e-4, 1e-8, 1e-12)
    ]
    assert work[0].steps < work[1].steps < work[2].steps
    assert all(each.evaluations > each.steps for each in work)


def test_the_papers_example_follows_the_oracle_through_all_switches(prism, paper_motion):
    """55 switches in 5 s, six strings each; measured 1.4e-8 m at 1e-12, 9e-8 m at 1e-11."""
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    run = CVODES(model.equation("rest_length"), 1e-12).advance(
        state, paper_motion.rest_length, 5.0, 50
    )
    assert run.work.switches == 6 * 55
    assert run.work.missed == 0
    error = np.abs(unpack_states(prism, run.states)[0] - paper_motion.nodes[:, :, 100::100])
    assert error.max() < 1e-7


def test_stiff_damped_strings_take_few_steps(prism):
    """k = 10⁸ N/m: the fastest rate is 10⁵ s⁻¹, and an explicit step would be below 10 µs."""
    lengths = rest_lengths(prism, paper_force_density(45.0), 1e8)
    model = tc.Model(prism, strings=tc.LinearStrings(1e8, 1e5))
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    equation = model.equation("rest_length")
    run = CVODES(equation, 1e-6).advance(state, lengths, 0.1, 1)
    assert run.work.steps < 100
    fine = CVODES(equation, 1e-9).advance(state, lengths, 0.1, 1)
    np.testing.assert_allclose(run.states, fine.states, rtol=0, atol=1e-5)


def test_calls_that_cannot_reach_an_output_are_cut_short(prism):
    """Undamped, k = 10⁸ N/m: more steps to the output than CVODES takes in one go."""
    lengths = rest_lengths(prism, paper_force_density(45.0), 1e8)
    model = tc.Model(prism, strings=tc.LinearStrings(1e8))
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    run = CVODES(model.equation("rest_length"), 1e-6).advance(state, lengths, 0.1, 1)
    assert run.work.steps > 2_000 * 64 / 32
    assert np.isfinite(run.states).all()
    bars = unpack_states(prism, run.states)[0][:, prism.bars]
    length = np.linalg.norm(bars[:, :, 1] - bars[:, :, 0], axis=0)
    np.testing.assert_allclose(length[:, 0], prism.bar_length, rtol=1e-3)


def test_massive_strings_follow_the_oracle():
    structure = tc.subdivide(tc.prism(), segments=2, node_mass=0.05)
    parent = rest_lengths(tc.prism(), paper_force_density(9.0), 100.0)
    lengths = tc.structure.spread_rest_length(structure, parent)
    times = np.linspace(0, 0.3, 4)
    law = HeldRestLength(lengths, 200.0)
    exact, switches = exact_motion(structure, law, times)
    model = tc.Model(structure, strings=tc.LinearStrings(200.0))
    state = pack_state(structure, structure.nodes, np.zeros_like(structure.nodes))
    run = CVODES(model.equation("rest_length"), 1e-11).advance(state, lengths, 0.3, 3)
    assert len(switches) > 0
    assert run.work.switches > 0
    assert np.abs(unpack_states(structure, run.states)[0] - exact[:, :, 1:]).max() < 1e-8


def test_windows_that_round_off_makes_empty_end_the_motion(prism, monkeypatch):
    """After ever shorter windows between switches, time does not go on any more."""
    monkeypatch.setattr("tenscontrol.integrate.cvodes._Motion._end", lambda motion: motion.now)
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    with pytest.raises(IntegrationError, match="the step size vanishes"):
        CVODES(model.equation("rest_length"), 1e-6).advance(state, lengths, 0.3, 3)
