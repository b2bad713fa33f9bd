"""Every public object says in a line what it is."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.short_repr import short_repr
from tests.public import public_classes
from tests.test_public_values import values  # noqa: F401  (a fixture)

LONGEST = 500


def test_no_class_shows_an_address():
    shown = [name for name, cls in public_classes().items() if cls.__repr__ is object.__repr__]
    assert shown == []


def test_values_are_shown_in_a_line(values):  # noqa: F811
    found = {name: repr(value) for name, value in values.items()}
    assert {name: text for name, text in found.items() if " at 0x" in text} == {}
    assert {name: len(text) for name, text in found.items() if len(text) > LONGEST} == {}
    assert [name for name, text in found.items() if "\n" in text] == []


def test_a_controlled_run_and_a_gait_are_shown_in_a_line():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0))
    plant = tc.linearize(model, tc.prestress(model.structure, force_density=10.0), "rest_length")
    law = tc.LQR(plant, sample_time=0.01)
    run = tc.simulate(model, 0.1, controller=law, rest_length=plant.rest_length, step=5e-3)
    assert repr(run.control) == f"ControlRecord({law!r}, 10 samples: 10 ok)"


@pytest.mark.parametrize(
    ("law", "text"),
    [
        (tc.LinearStrings(np.full(24, 100.0)), "LinearStrings(stiffness=100, damping=0)"),
        (tc.LinearStrings(100.0), "LinearStrings(stiffness=100, damping=0)"),
        (tc.Uniform(0, 1), "Uniform(size=None, low=0.0, high=1.0)"),
    ],
)
def test_equal_entries_are_written_once(law, text):
    assert repr(law) == text


def test_arrays_are_shown_by_shape_and_range():
    reference = tc.Reference([0.0, 1.0], np.zeros((3, 6, 2)) + np.array([0.0, 2.0]))
    assert short_repr(reference) == "Reference(time=[0, 1], nodes=3×6×2 from 0 to 2)"
