"""The implicit Radau method: error, work, stiffness."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics import pack_state, smooth_equation, unpack_states
from tenscontrol.integrate import radau as module
from tenscontrol.integrate.radau import Radau
from tests.dynamics.scenes import paper_force_density, rest_lengths, side_by_side
from tests.integrate.test_rk4 import oscillator
from tests.oracle import HeldRestLength, RigidBars


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10])
def test_error_follows_the_tolerance(tolerance):
    """Measured: 0.2 to 0.4 tolerances between steps."""
    run = Radau(smooth_equation(oscillator()), tolerance).advance(np.zeros(2), np.ones(1), 10.0, 50)
    times = np.linspace(0.2, 10.0, 50)
    exact = np.array([1 - np.cos(times), np.sin(times)])
    assert np.abs(run.states - exact).max() < 2 * tolerance


def test_order_of_the_error_in_the_work():
    """The steps follow an error estimate of order 4, the error of their ends is of order 5."""
    errors, steps = [], []
    for tolerance in (1e-4, 1e-6, 1e-8):
        run = Radau(smooth_equation(oscillator()), tolerance).advance(
            np.zeros(2), np.ones(1), 10.0, 1
        )
        errors.append(np.abs(run.states[:, -1] - [1 - np.cos(10.0), np.sin(10.0)]).max())
        steps.append(run.work.steps)
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 4.5 <= order <= 5.5


def test_the_papers_example_follows_the_oracle_through_all_switches(prism, paper_motion):
    """55 switches in 5 s, six strings each; measured 6e-10 m."""
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    run = Radau(model.equation("rest_length"), 1e-8).advance(
        state, paper_motion.rest_length, 5.0, 50
    )
    assert len(paper_motion.switches) == 55
    assert run.work.switches == 6 * 55
    assert run.work.unlocated == 0
    error = np.abs(unpack_states(prism, run.states)[0] - paper_motion.nodes[:, :, 100::100])
    assert error.max() < 1e-8


def test_a_tight_tolerance_reaches_round_off(prism, paper_motion):
    """The first half second, six switches; measured 4e-12 m."""
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    run = Radau(model.equation("rest_length"), 1e-10).advance(
        state, paper_motion.rest_length, 0.5, 5
    )
    error = np.abs(unpack_states(prism, run.states)[0] - paper_motion.nodes[:, :, 100:501:100])
    assert error.max() < 2e-11


def test_stiff_damped_strings_take_few_steps(prism):
    """k = 10⁸ N/m: the fastest rate is 10⁵ s⁻¹, and an explicit step would be below 10 µs."""
    lengths = rest_lengths(prism, paper_force_density(45.0), 1e8)
    model = tc.Model(prism, strings=tc.LinearStrings(1e8, 1e5))
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    equation = model.equation("rest_length")
    run = Radau(equation, 1e-6).advance(state, lengths, 0.1, 1)
    assert run.work.steps < 30
    fine = Radau(equation, 1e-9).advance(state, lengths, 0.1, 1)
    np.testing.assert_allclose(run.states, fine.states, rtol=0, atol=1e-6)


def test_large_structures_use_the_sparse_jacobian_for_the_same_motion(prism):
    """Four prisms side by side move as one does."""
    gamma = paper_force_density(45.0)
    runs = []
    for structure, copies in ((prism, 1), (side_by_side(prism, 4), 4)):
        lengths = np.tile(rest_lengths(prism, gamma, 100.0), copies)
        model = tc.Model(structure, strings=tc.LinearStrings(100.0))
        integrator = Radau(model.equation("rest_length", form="flat"), 1e-8)
        state = pack_state(structure, structure.nodes, np.zeros_like(structure.nodes))
        run = integrator.advance(state, lengths, 0.2, 2)
        assert integrator._sparse == (copies == 4)
        runs.append(unpack_states(structure, run.states)[0][:, :6])
    assert 36 < module._SPARSE_FROM < 144
    np.testing.assert_allclose(runs[1], runs[0], rtol=0, atol=1e-8)


def test_massive_strings_follow_the_oracle():
    structure = tc.subdivide(tc.prism(), segments=2, node_mass=0.05)
    parent = rest_lengths(tc.prism(), paper_force_density(9.0), 100.0)
    lengths = tc.structure.spread_rest_length(structure, parent)
    times = np.linspace(0, 0.3, 4)
    law = HeldRestLength(lengths, 200.0)
    exact, switches = RigidBars(structure, law).integrate(
        structure.nodes, np.zeros_like(structure.nodes), times
    )
    model = tc.Model(structure, strings=tc.LinearStrings(200.0))
    state = pack_state(structure, structure.nodes, np.zeros_like(structure.nodes))
    run = Radau(model.equation("rest_length"), 1e-9).advance(state, lengths, 0.3, 3)
    assert len(switches) > 0
    assert run.work.switches > 0
    assert np.abs(unpack_states(structure, run.states)[0] - exact[:, :, 1:]).max() < 1e-8
