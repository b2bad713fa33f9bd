"""Systems of python-control as controllers, and controllers as systems of python-control."""

import control
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import LinearController

SAMPLE = 0.01


@pytest.fixture(scope="module")
def model():
    return tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0, damping=0.5))


@pytest.fixture(scope="module")
def plant(model):
    rest = tc.prestress(model.structure, force_density=10.0)
    return tc.linearize(model, rest, input="rest_length")


def simulated(plant, law, duration=0.3):
    pushed = plant.to_velocities(np.zeros(9), 0.01 * np.ones(9))
    return tc.simulate(
        plant.model, duration, velocities=pushed, controller=law, step=2e-3,
        rest_length=plant.rest_length, output_step=SAMPLE,
    )  # fmt: skip


def test_a_sampled_plant_is_the_exact_discretization(plant):
    """By the exponential of the whole matrix, of python-control."""
    found, theirs = plant.to_statespace(SAMPLE), plant.to_statespace().sample(SAMPLE, "zoh")
    assert found.dt == SAMPLE
    for name in "ABCD":
        np.testing.assert_allclose(getattr(found, name), getattr(theirs, name), atol=1e-10)
    state = plant.to_statespace(outputs="state")
    np.testing.assert_array_equal(state.C, np.eye(18))
    assert state.output_labels == plant.state_names


@pytest.mark.parametrize("winches", [None, tc.Winches(rate=1.0, shortest=0.1, substeps=2)])
def test_the_law_closes_the_loop_with_its_poles(plant, winches):
    regulator = tc.LQR(plant, sample_time=SAMPLE, winches=winches)
    law = regulator.to_statespace()
    if winches is None:
        system = plant.to_statespace(SAMPLE, outputs="state")
        poles = control.feedback(system, law, sign=1).poles()
        np.testing.assert_allclose(
            np.sort(abs(poles)), np.sort(abs(regulator.poles)), rtol=1e-9, atol=1e-12
        )
    else:
        np.testing.assert_array_equal(law.A, -regulator.previous_input_gain)
        assert law.nstates == 9
    assert law.output_labels == plant.input_names


def test_an_exported_law_commands_what_the_regulator_does(plant):
    regulator = tc.LQR(plant, sample_time=SAMPLE)
    again = LinearController(plant, regulator.to_statespace(), sees="state")
    runs = [simulated(plant, law) for law in (regulator, again)]
    np.testing.assert_allclose(runs[0].nodes, runs[1].nodes, atol=1e-13)


def test_a_compensator_sees_displacements_and_starts_anew_in_each_run(plant):
    """LQG of python-control: its loop of nodes and estimator decays as its poles say."""
    A, B = plant.A, plant.B
    C = plant.to_statespace().C
    Q, R = tc.energy_weights(plant)
    K, _, _ = control.lqr(A, B, Q, np.diag(10 * R))
    L, _, _ = control.lqe(A, np.eye(18), C, np.eye(18), 1e-2 * np.eye(18))
    continuous = control.ss(A - B @ K - L @ C, L, -K, 0.0)
    with pytest.raises(ValueError, match="system is continuous and has 18 states"):
        LinearController(plant, continuous, sees="nodes")
    system = control.sample_system(continuous, SAMPLE, "tustin")
    loop = control.feedback(plant.to_statespace(SAMPLE), system, sign=1)
    assert abs(loop.poles()).max() < 1
    law = LinearController(plant, system, sees="nodes")
    runs = [simulated(plant, law, 1.5) for _ in range(2)]
    np.testing.assert_array_equal(runs[0].nodes, runs[1].nodes)
    moved = np.linalg.norm(runs[0].velocities, axis=(0, 1))
    assert moved[-1] < 0.2 * moved[0]


def test_systems_without_a_shape_or_with_other_signals_are_refused(plant):
    with pytest.raises(TypeError, match=r"give control\.LinearController\(plant, system, "):
        tc.simulate(plant.model, 0.1, controller=plant.to_statespace(), rest_length=0.7)
    with pytest.raises(ValueError, match="system has 9 inputs and 18 outputs, expected 18 inputs"):
        LinearController(plant, plant.to_statespace(), sees="nodes")
    with pytest.raises(ValueError, match=r"system\.dt is True"):
        LinearController(plant, control.ss([], [], [], np.zeros((9, 18)), True), sees="state")
    with pytest.raises(TypeError, match="system is a int, expected a control"):
        LinearController(plant, 3, sees="state")
    gain = control.ss([], [], [], np.zeros((9, 18)))
    assert LinearController(plant, gain, sees="state").sample_time is None
