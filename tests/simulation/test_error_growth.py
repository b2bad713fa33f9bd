"""Growth of the error of a closed loop: seen early, with its rate, and never where none is."""

from types import SimpleNamespace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.simulation.error_growth import error_growth

SAMPLE = 0.02
TIME = np.arange(0, 2, 0.01)
HARMLESS = {
    "ramp": 0.05 * TIME,
    "cubic": 0.02 * TIME**3,
    "approach": 0.1 * (1 - np.exp(-TIME / 0.1)),
    "decay": 0.1 * np.exp(-TIME / 0.1),
    "pulse": 0.1 * np.exp(-(((TIME - 1) / 0.2) ** 2)),
    "noise": 1e-3 * np.abs(np.random.default_rng(0).normal(size=len(TIME))),
    "vibration": 1e-2 * np.abs(np.cos(13 * TIME)),
    "below round-off": 1e-14 * np.exp(TIME / 0.2),
    "nothing": 0 * TIME,
}


@pytest.mark.parametrize("name", HARMLESS)
def test_what_does_not_grow_exponentially_is_no_growth(name):
    assert error_growth(TIME, HARMLESS[name], 1.0) is None


@pytest.mark.parametrize("constant", [0.1, 0.2, 0.4])
def test_an_exponential_is_found_with_its_time_constant(constant):
    error = 1e-5 * np.exp(TIME / constant) * np.abs(np.cos(20 * TIME))
    found = error_growth(TIME, np.minimum(error, 0.5), 1.0)
    assert found.time_constant == pytest.approx(constant, rel=0.15)
    assert found.begin < 0.5


@pytest.fixture(scope="module")
def plant():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=1000.0, damping=0.2))
    rest = tc.prestress(model.structure, force_density=10.0)
    return tc.linearize(model, rest, input="rest_length")


@pytest.mark.parametrize(("weight", "duration"), [(200.0, 1.0), (400.0, 0.5)])
def test_a_loop_that_pushes_the_wrong_way_is_said_at_its_rate(plant, weight, duration):
    """The rate is the spectral radius of the sampled loop; the end is 18 % of the size off."""
    by_rate = plant.B[9:].T / np.linalg.norm(plant.B) ** 2
    D = weight * np.hstack([np.zeros((9, 9)), by_rate])
    nothing = {"A": np.zeros((0, 0)), "B": np.zeros((0, 18)), "C": np.zeros((9, 0))}
    system = SimpleNamespace(**nothing, D=D, dt=SAMPLE)
    law = tc.control.LinearController(plant, system, sees="state")
    transition, by_input, _ = plant.discretize(SAMPLE)
    radius = np.abs(np.linalg.eigvals(transition + by_input @ D)).max()
    with pytest.warns(tc.control.ControlWarning, match="the closed loop is unstable"):
        run = tc.simulate(
            plant.model, duration, plant.to_nodes([1e-4] * 9), controller=law, step=2e-3,
            rest_length=plant.rest_length, error="none",
        )  # fmt: skip
    growth = run.control.growth
    assert growth.time_constant == pytest.approx(SAMPLE / np.log(radius), rel=0.1)
    assert run.control.tracking_error[-1] < 0.2 * run.control.size
    assert "error grows by a factor e in" in run.control.problems[0]


def test_a_loop_that_settles_has_none(plant):
    law = tc.LQR(plant, sample_time=SAMPLE)
    run = tc.simulate(
        plant.model, 0.5, plant.to_nodes([0.01] * 9), controller=law, step=2e-3,
        rest_length=plant.rest_length,
    )  # fmt: skip
    assert run.control.growth is None
    assert run.control.problems == []
