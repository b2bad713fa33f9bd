"""The fixed-step Runge-Kutta method: order, chunks, counts, failure."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, strategies as st

import tenscontrol as tc
from tenscontrol.integrate import RK4, IntegrationError
from tests.dynamics.scenes import paper_force_density, rest_lengths
from tests.integrate.stepping import fitted_order, smooth_equation
from tests.located_motion import exact_motion
from tests.oracle import HeldForceDensity, HeldRestLength

STEPS = np.array([8e-3, 4e-3, 2e-3, 1e-3])


def oscillator():
    """``ẍ = u - x``: from rest at 0 it moves as u (1 - cos t)."""
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    return ca.Function("oscillator", [x, u], [ca.vertcat(x[1], u - x[0])])


def explosion():
    """``ẋ = x²``: from 1 it reaches infinity at t = 1."""
    x, u = ca.SX.sym("x"), ca.SX.sym("u")
    return ca.Function("explosion", [x, u], [x**2 + 0 * u])


def scene(name, prism):
    """Oracle, model and held input of a scene that never goes slack."""
    gamma = paper_force_density(45.0)
    if name == "force_density":
        return HeldForceDensity(gamma), tc.Model(prism), {"force_density": gamma}
    damping = 1.0 if name == "damped" else 0.0
    lengths = rest_lengths(prism, gamma, 100.0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping))
    return HeldRestLength(lengths, 100.0, damping), model, {"rest_length": lengths}


@pytest.mark.parametrize("name", ["rest_length", "damped", "force_density"])
def test_order_is_four_where_no_string_goes_slack(prism, name):
    """Fitted over steps of 8 to 1 ms, γ_v = 45 N/m, after 2 s, against the oracle."""
    law, model, held = scene(name, prism)
    exact, switches = exact_motion(prism, law, np.array([0.0, 2.0]))
    assert len(switches) == 0
    errors = []
    for step in STEPS:
        run = tc.simulate(model, 2.0, step=step, **held)
        errors.append(np.abs(run.nodes[:, :, -1] - exact[:, :, -1]).max())
    assert 3.8 <= fitted_order(STEPS, errors) <= 4.3
    assert errors[-1] < 2e-7


def test_order_of_the_step_alone():
    steps = 0.4 / 2.0 ** np.arange(4)
    errors = []
    for step in steps:
        span = RK4(smooth_equation(oscillator()), step).advance(np.zeros(2), np.ones(1), 2.0, 1)
        errors.append(np.abs(span.states[:, -1] - [1 - np.cos(2.0), np.sin(2.0)]).max())
    assert 3.9 <= fitted_order(steps, errors) <= 4.1


def test_a_step_of_the_method_is_that_of_runge_and_kutta():
    """On ``ẋ = A x`` a step is the Taylor polynomial of degree 4."""
    A = np.array([[0.0, 1.0], [-1.0, 0.0]])
    h, x = 0.3, np.array([0.7, -0.2])
    powers = [np.linalg.matrix_power(h * A, k) for k in range(5)]
    expected = sum(p / f for p, f in zip(powers, (1, 1, 2, 6, 24), strict=True)) @ x
    found = RK4(smooth_equation(oscillator()), h).advance(x, np.zeros(1), h, 1).states[:, 0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-16)


@pytest.mark.parametrize("outputs", [1, 500])
def test_long_runs_are_chained_without_a_seam(outputs):
    """The states do not depend on where spans end."""
    integrator = RK4(smooth_equation(oscillator()), step=1e-3)
    whole = integrator.advance(np.zeros(2), np.ones(1), outputs * 1e-3, outputs)
    state = np.zeros(2)
    for i in range(outputs):
        state = integrator.advance(state, np.ones(1), 1e-3, 1).states[:, -1]
        np.testing.assert_allclose(whole.states[:, i], state, rtol=0, atol=1e-14)


@given(
    duration=st.floats(0.01, 3.0),
    outputs=st.integers(1, 40),
    step=st.floats(1e-3, 0.5),
)
def test_steps_fit_between_outputs_and_are_no_longer_than_asked(duration, outputs, step):
    span = RK4(smooth_equation(oscillator()), step).advance(
        np.zeros(2), np.ones(1), duration, outputs
    )
    assert span.states.shape == (2, outputs)
    assert span.work.steps % outputs == 0
    assert duration / span.work.steps <= step * (1 + 1e-8)
    # And no more than needed.
    assert duration / (span.work.steps / outputs - 1 + 1e-12) / outputs >= step * (1 - 1e-8)
    assert span.work.evaluations == 4 * span.work.steps
    times = duration * np.arange(1, outputs + 1) / outputs
    assert np.abs(span.states[0] - (1 - np.cos(times))).max() < 0.2 * step**4 * max(1, duration)


def test_twenty_milliseconds_are_twenty_steps_of_one():
    span = RK4(smooth_equation(oscillator()), 0.001).advance(np.zeros(2), np.ones(1), 0.02, 1)
    assert span.work.steps == 20


def test_progress_is_reported_up_to_the_end():
    times = []
    RK4(smooth_equation(oscillator()), 1e-3).advance(
        np.zeros(2), np.ones(1), 1.2, 1200, times.append
    )
    assert 2 < len(times) < 100  # some steps at a time
    assert times == sorted(times)
    assert times[-1] == 1.2


def test_a_state_that_leaves_all_bounds_stops_with_what_was_good():
    with pytest.raises(IntegrationError, match=r"no longer finite between .* try a step") as info:
        RK4(smooth_equation(explosion()), 0.05).advance(np.ones(1), np.zeros(1), 3.0, 60)
    error = info.value
    good = error.span.states
    assert np.isfinite(good).all()
    assert good.shape[1] == round(error.time / 0.05)
    assert 1.0 < error.time < 3.0
    early = RK4(smooth_equation(explosion()), 0.05).advance(np.ones(1), np.zeros(1), 0.5, 10).states
    np.testing.assert_allclose(good[:, :10], early, rtol=1e-12)
