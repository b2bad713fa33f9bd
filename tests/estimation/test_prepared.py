"""What is built in CasADi for a plant is built once."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.plant.reduced_dynamics import tracked_motion
from tenscontrol.plant.string_outputs import string_map

from .conftest import EVERY, STEP


@pytest.fixture
def built(monkeypatch):
    """Names of the functions built in CasADi since the last clear()."""
    names = []

    def counted(self, *arguments):
        if arguments and isinstance(arguments[0], str):
            names.append(arguments[0])
        ca.Function.__init__(self, *arguments)

    monkeypatch.setattr(Function, "__init__", counted)
    return names


@pytest.mark.parametrize(("prediction", "load"), [("linear", True), ("nonlinear", False)])
def test_a_second_filter_on_a_plant_builds_nothing(model, built, prediction, load):
    plant = tc.linearize(model, tc.prestress(model.structure, 17.3205), input="rest_length")
    options = {"sample_time": STEP, "prediction": prediction, "load": load}
    first = tc.KalmanFilter(plant, tc.Sensors(structure=model.structure, **EVERY), **options)
    assert built
    built.clear()
    again = tc.KalmanFilter(plant, tc.Sensors(structure=model.structure, **EVERY), **options)
    assert built == []
    np.testing.assert_array_equal(first.gain, again.gain)


def test_other_sensors_get_functions_of_their_own(model, built):
    plant = tc.linearize(model, tc.prestress(model.structure, 17.3205), input="rest_length")
    lengths = tc.Sensors(structure=model.structure, string_length=1e-3)
    every = tc.Sensors(structure=model.structure, **EVERY)
    assert tc.KalmanFilter(plant, lengths, sample_time=STEP).C.shape[0] == 9
    built.clear()
    assert tc.KalmanFilter(plant, every, sample_time=STEP).C.shape[0] == len(every.noise)
    assert "readings" in built


def test_maps_and_coordinates_of_a_plant_are_kept(model, built):
    plant = tc.linearize(model, tc.prestress(model.structure, 17.3205))
    matrix = np.eye(plant.nodes.size)[:3]

    def everything():
        return (
            string_map(plant, "rest_length"),
            tracked_motion(plant, matrix),
            tc.plant.in_coordinates(plant, "minimal"),
            tc.plant.linear_plant.acceleration_response(plant, STEP),
        )

    first = everything()
    assert built
    built.clear()
    assert all(one is other for one, other in zip(first, everything(), strict=True))
    assert built == []
    assert tracked_motion(plant, 2 * matrix) is not first[1]
