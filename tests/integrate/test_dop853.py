"""The adaptive method: its error follows the tolerance."""

import casadi as ca
import numpy as np
import pytest
import scipy.integrate

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.integrate import (
    CVODES,
    DOP853,
    RK4,
    EnergyMomentum,
    IntegrationError,
    dop853_coefficients,
)
from tenscontrol.integrate.dop853 import (
    _PATH_OF_POSITIONS,
    _PATH_OF_VELOCITIES,
    _DormandPrince,
    _factors,
    _interpolant_error,
    _on_path,
)
from tenscontrol.integrate.events import path
from tests.dynamics.scenes import paper_force_density, rest_lengths
from tests.integrate.stepping import smooth_equation
from tests.integrate.test_rk4 import explosion, oscillator
from tests.located_motion import exact_motion
from tests.oracle import HeldRestLength


def test_coefficients_are_those_of_scipy():
    for name in ("A", "B", "C", "D", "E3", "E5", "A_EXTRA", "C_EXTRA"):
        known = getattr(scipy.integrate.DOP853, name)
        np.testing.assert_array_equal(getattr(dop853_coefficients, name), known)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10, 1e-12])
def test_error_follows_the_tolerance(tolerance):
    span = DOP853(smooth_equation(oscillator()), tolerance).advance(
        np.zeros(2), np.ones(1), 10.0, 50
    )
    times = np.linspace(0.2, 10.0, 50)
    exact = np.array([1 - np.cos(times), np.sin(times)])
    assert np.abs(span.states - exact).max() < 20 * tolerance


@pytest.mark.parametrize("tolerance", [1e-6, 1e-9, 1e-12])
def test_error_follows_the_tolerance_for_a_structure(prism, tolerance):
    """γ_v = 45 N/m, 2 s, against the oracle; measured 0.2 to 6 tolerances."""
    lengths = rest_lengths(prism, paper_force_density(45.0), 100.0)
    times = np.linspace(0, 2, 21)
    exact, _ = exact_motion(prism, HeldRestLength(lengths, 100.0), times)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    run = tc.simulate(model, 2.0, rest_length=lengths, tolerance=tolerance, output_step=0.1)
    assert np.abs(run.nodes - exact).max() < 50 * tolerance


def test_a_tighter_tolerance_takes_more_work():
    work = [
        DOP853(smooth_equation(oscillator()), tolerance)
        .advance(np.zeros(2), np.ones(1), 10.0, 1)
        .work.evaluations
        for tolerance in (1e-4, 1e-8, 1e-12)
    ]
    assert work[0] < work[1] < work[2]


def test_shortened_steps_err_less_where_they_end_at_switches():
    """What is off where steps end on interpolants is not told by a smaller tolerance alone."""
    ball = tc.library.six_bar_ball(bar_length=1.0)
    model = tc.Model(ball, strings=tc.LinearStrings(100.0))
    spin = np.cross([3.0, 2.0, 6.0], (ball.nodes - ball.nodes.mean(axis=1, keepdims=True)).T).T
    state, held = pack_state(ball, ball.nodes, spin), ball.string_length(ball.nodes)

    def end(tolerance, is_shortened=False):
        method = DOP853(model.equation("rest_length"), tolerance)
        if is_shortened:
            method.shorten()
        span = method.advance(state, held, 1.0, 1)
        assert span.work.switches == 100
        return span.states[:72, -1]

    exact = end(1e-12)
    plain, shortened = (np.abs(end(1e-6, which) - exact).max() for which in (False, True))
    assert shortened < 0.4 * plain


def test_states_do_not_depend_on_how_many_are_asked_for():
    few, many = (
        DOP853(smooth_equation(oscillator()), 1e-9).advance(np.zeros(2), np.ones(1), 5.0, count)
        for count in (5, 500)
    )
    np.testing.assert_allclose(many.states[:, 99::100], few.states, rtol=0, atol=1e-14)
    assert few.work.steps == many.work.steps


def test_interpolated_states_are_as_good_as_stepped_ones():
    states = (
        DOP853(smooth_equation(oscillator()), 1e-10)
        .advance(np.zeros(2), np.ones(1), 5.0, 5000)
        .states
    )
    times = np.linspace(1e-3, 5.0, 5000)
    assert np.abs(states[0] - (1 - np.cos(times))).max() < 1e-9


@pytest.mark.parametrize("h", [0.3, 0.5, 0.8])
def test_what_the_interpolant_errs_is_known(h):
    """On ``ẍ = 1 - x``, at parts of a step where the error is not next to zero."""
    equation = smooth_equation(oscillator())
    method, x, u, taut = _DormandPrince(equation), np.array([0.3, 1.0]), np.ones(1), np.zeros(0)
    f = Evaluator(equation.slope)(x, u, taut)[0]
    x1, f1, (estimate, _), K, _ = Evaluator(method.tried())(x, f, u, taut, h, np.ones(2))
    (made,) = Evaluator(method.interpolant())(x, x1, f, f1, K, u, taut, h)
    for part in (0.4, 0.5, 0.6, 0.8, 0.9):
        t = part * h
        found = x + made @ _factors(part)
        turn = np.array([[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]])
        off = found - [1, 0] - turn @ (x - [1, 0])
        share = abs(np.polynomial.polynomial.polyval(part, _interpolant_error()))
        assert np.sqrt(np.mean(off**2)) == pytest.approx(share * estimate, rel=0.03)


def test_what_the_path_from_the_ends_of_a_step_errs_is_known():
    """On ``ẍ = 1 - x``, at the leading order of the step."""
    equation = smooth_equation(oscillator())
    x, u, taut, h = np.array([0.3, 1.0]), np.ones(1), np.zeros(0), 0.05
    f = Evaluator(equation.slope)(x, u, taut)[0]
    tried = Evaluator(_DormandPrince(equation).tried())
    x1, f1, _, K, _ = tried(x, f, u, taut, h, np.ones(2))
    parts = np.linspace(0, 1, 201)
    found = _on_path(Evaluator(path(equation))(x, f, x1, f1, h)[0], parts, h).T
    cos, sin = np.cos(parts * h), np.sin(parts * h)
    off = np.abs(found - [1 - 0.7 * cos + sin, 0.7 * sin + cos]).max(axis=1)
    fifth = abs(K @ dop853_coefficients.E5)[0]
    known = [_PATH_OF_POSITIONS * h * fifth, _PATH_OF_VELOCITIES * fifth]
    np.testing.assert_allclose(off, known, rtol=0.05)


def test_a_tolerance_below_round_off_is_refused():
    with pytest.raises(ValueError, match="double precision goes no further"):
        DOP853(smooth_equation(oscillator()), 1e-16)


def test_progress_is_reported_step_by_step():
    times = []
    span = DOP853(smooth_equation(oscillator()), 1e-6).advance(
        np.zeros(2), np.ones(1), 2.0, 3, times.append
    )
    assert span.work.steps > len(times) >= 1  # some steps at a time
    assert times == sorted(times)
    assert times[-1] == 2.0


def test_a_singularity_stops_with_what_was_good():
    with pytest.raises(IntegrationError, match="dop853 stopped after") as info:
        DOP853(smooth_equation(explosion()), 1e-8).advance(np.ones(1), np.zeros(1), 2.0, 40)
    good = info.value.span.states
    assert info.value.time == pytest.approx(1.0, abs=1e-3)
    assert good.shape[1] in (19, 20)
    np.testing.assert_allclose(good[0, :19], 1 / (1 - 0.05 * np.arange(1, 20)), rtol=1e-6)


@pytest.mark.parametrize("entry", [np.inf, np.nan, 1e308])
@pytest.mark.parametrize("method", [DOP853, CVODES, EnergyMomentum, RK4])
def test_a_state_that_has_run_away_is_told_without_a_warning(prism, method, entry):
    equation = tc.Model(prism).equation("force_density")
    state = np.concatenate([prism.nodes.ravel(order="F"), np.zeros(18)])
    state[6] = entry
    with pytest.raises(IntegrationError, match="the state has run away"):
        method(equation, 1e-2).advance(state, np.full(9, 20.0), 1.0, 2)


def test_a_step_that_explodes_is_never_taken_for_exact():
    """Where the mean square of the error overflows, and the sum of a part of it does not yet."""
    count = 100
    x, u = ca.SX.sym("x", count), ca.SX.sym("u", 0)
    equation = smooth_equation(ca.Function("slope", [x, u], [-1e20 * x]))
    tried = Evaluator(_DormandPrince(equation).tried())
    ones, none = np.ones(count), np.zeros(0)
    for h in np.geomspace(1e-12, 1e-2, 500):
        end, _, (error, _), *_ = tried(ones, -1e20 * ones, none, none, h, ones)
        assert not np.abs(end).max() < 10
        assert not error < 1
