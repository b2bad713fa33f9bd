"""What a plant offers: discretization, state space, names, other coordinates."""

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tenscontrol as tc
from tests.dynamics.scenes import paper_force_density
from tests.plant.scenes import INPUTS, KINDS, prism_plant

every_kind = pytest.mark.parametrize("kind", KINDS)
every_input = pytest.mark.parametrize("held", INPUTS)


def drifting_plant(prism, held="rest_length", kind="internal"):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, 0.3))
    at = tc.OperatingPoint(prism.nodes, paper_force_density(9.0))
    return tc.linearize(model, at, held, kind, require_equilibrium=False)


# ---- discretization ----


@pytest.mark.parametrize("step", [1e-3, 0.02, 0.5])
@every_input
def test_discretization_follows_the_continuous_plant(prism, held, step):
    plant = drifting_plant(prism, held)
    random = np.random.default_rng(0)
    z, v = random.normal(size=18), random.normal(size=9)
    moved = solve_ivp(
        lambda _, y: plant.A @ y + plant.B @ v + plant.drift,
        (0, step),
        z,
        "DOP853",
        rtol=1e-12,
        atol=1e-12,
    ).y[:, -1]
    by_state, by_input, drift = plant.discretize(step)
    np.testing.assert_allclose(by_state @ z + by_input @ v + drift, moved, rtol=0, atol=1e-9)


@every_kind
def test_two_half_samples_are_one(rest, kind):
    plant = prism_plant(rest, "force_density", kind)
    whole, half = plant.discretize(0.04), plant.discretize(0.02)
    np.testing.assert_allclose(half[0] @ half[0], whole[0], rtol=0, atol=1e-11)
    np.testing.assert_allclose(half[0] @ half[1] + half[1], whole[1], rtol=0, atol=1e-12)


def test_a_plant_at_equilibrium_stays_there(rest):
    assert np.abs(prism_plant(rest, "rest_length").discretize(0.1)[2]).max() < 1e-13


# ---- control.StateSpace ----


@every_kind
@every_input
def test_state_space_has_the_plant_and_named_signals(rest, held, kind):
    plant = prism_plant(rest, held, kind)
    system = plant.to_statespace()
    r = plant.degrees_of_freedom
    assert (system.nstates, system.ninputs, system.noutputs) == (2 * r, 9, 18)
    np.testing.assert_array_equal(system.A, plant.A)
    np.testing.assert_array_equal(system.B, plant.B)
    np.testing.assert_array_equal(system.C, np.hstack([plant.basis, np.zeros((18, r))]))
    np.testing.assert_array_equal(system.D, 0)
    symbol = "gamma" if held == "force_density" else "rest_length"
    groups = ("top", "bottom", "vertical")
    assert system.input_labels == [f"{symbol}_{group}[{i}]" for group in groups for i in range(3)]
    assert system.output_labels == [f"delta_{axis}[{i}]" for i in range(6) for axis in "xyz"]
    first = "x[0]" if kind == "nodes" else "q[0]"
    assert (system.state_labels[0], system.state_labels[r]) == (first, "d" + first)
    assert len(set(system.state_labels)) == 2 * r


@every_input
@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_poles_of_the_state_space_are_the_modes(rest, held, damping):
    plant = prism_plant(rest, held, damping=damping)
    poles = plant.to_statespace().poles()
    frequency = np.sort(np.abs(poles[poles.imag >= 0])) / (2 * np.pi)
    modes = tc.modes(plant)
    moving = np.sort(modes.frequency[modes.frequency > 0])
    np.testing.assert_allclose(frequency[-len(moving) :], moving, rtol=1e-6)


def test_the_step_response_moves_the_nodes_as_the_nonlinear_model_does(rest):
    """A string of the top 0.1 mm shorter: control's response against the full simulation."""
    plant = prism_plant(rest, "rest_length", damping=0.3)
    time = np.linspace(0, 0.5, 26)
    change = np.zeros(9)
    change[0] = -1e-4
    response = control.forced_response(
        plant.to_statespace(), time, np.tile(change[:, None], (1, len(time)))
    )
    run = tc.simulate(
        plant.model, 0.5, rest_length=plant.rest_length + change, tolerance=1e-11, output_step=0.02
    )
    moved = (run.nodes - plant.nodes[:, :, None]).swapaxes(0, 1).reshape(18, -1)
    size = np.abs(moved).max()
    assert size > 1e-5
    assert np.abs(response.outputs - moved).max() < 1e-2 * size


def test_a_drifting_plant_has_no_state_space(prism):
    with pytest.raises(ValueError, match="the plant has a drift"):
        drifting_plant(prism).to_statespace()


# ---- other coordinates ----


@every_kind
@every_input
def test_the_same_plant_in_other_coordinates(rest, held, kind):
    found = tc.plant.in_coordinates(prism_plant(rest, held, "internal", damping=0.2), kind)
    expected = prism_plant(rest, held, kind, damping=0.2)
    np.testing.assert_allclose(found.A, expected.A, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.B, expected.B, rtol=0, atol=1e-12)


@every_input
def test_the_equilibrium_input_is_what_is_held(rest, held):
    plant = prism_plant(rest, held)
    expected = rest.force_density if held == "force_density" else plant.rest_length
    np.testing.assert_array_equal(plant.equilibrium_input, expected)
    tension = 100.0 * (rest.structure.string_length() - plant.rest_length)
    np.testing.assert_allclose(tension, rest.force_density * rest.structure.string_length())
