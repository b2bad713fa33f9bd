"""A controller of one's own: what the base class does for a subclass with ``_decide`` alone."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Command, Controller, Fallback, Status

STILL = np.zeros((3, 6))


class Constant(Controller):
    """Commands the same input at any state."""

    value = 45.0

    def _decide(self, time, state):
        return Command(np.full(len(self.bounds[0]), self.value))


@pytest.fixture(params=["force_density", "rest_length"])
def plant(request):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    return tc.linearize(model, tc.prestress(prism, force_density=17.3205), input=request.param)


def test_a_subclass_needs_a_decision_alone(plant):
    law = Constant(plant, 0.02, np.zeros(9), np.full(9, 40.0))
    command = law.command(0.0, plant.nodes, STILL)
    np.testing.assert_array_equal(command.value, 40.0)
    assert command.status is Status.OK
    lost = law.command(0.02, np.nan * plant.nodes, STILL)
    assert lost.status is Status.MEASUREMENT_NOT_FINITE
    if plant.input == "rest_length":
        assert lost.fallback is Fallback.PREVIOUS_INPUT_HELD
        np.testing.assert_array_equal(lost.value, 40.0)
    else:
        assert lost.fallback is Fallback.EQUILIBRIUM_HELD
        np.testing.assert_array_equal(lost.value, plant.equilibrium_input)
    assert law.status_count == {Status.OK: 1, Status.MEASUREMENT_NOT_FINITE: 1}
    assert law.fallback_count == {lost.fallback: 1}
    law.reset()
    assert law.status_count == {}
    fresh = law.command(0.0, np.nan * plant.nodes, STILL)
    assert fresh.fallback is Fallback.EQUILIBRIUM_HELD


def test_changes_are_limited_from_the_input_that_was_applied(plant):
    law = Constant(plant, 0.02, np.zeros(9), np.full(9, 30.0), np.full(9, 0.5))
    law.applied(np.full(9, 3.0))
    np.testing.assert_array_equal(law.command(0.0, plant.nodes, STILL).value, 3.5)
    np.testing.assert_array_equal(law.command(0.02, plant.nodes, STILL).value, 4.0)


def test_a_controller_without_a_decision_is_none(plant):
    with pytest.raises(TypeError, match="_decide"):
        Controller(plant, 0.02, np.zeros(9), np.ones(9))
