"""The record that a predictive controller goes by: nobody changes it, the controller obeys."""

from dataclasses import fields, is_dataclass

import numpy as np
import pytest

import tenscontrol as tc
from tests.deploy import scenes


def arrays(value, name):
    """Yield name and array of every array in a record, and in the records in it."""
    if isinstance(value, np.ndarray):
        yield name, value
    elif is_dataclass(value):
        for field in fields(value):
            yield from arrays(getattr(value, field.name), f"{name}.{field.name}")
    elif isinstance(value, tuple):
        for i, each in enumerate(value):
            yield from arrays(each, f"{name}[{i}]")


@pytest.mark.parametrize(
    "make",
    [scenes.of_rest_length, scenes.winding, scenes.with_load, scenes.nonlinear_of_rest_length,
     scenes.nonlinear_with_load],
)  # fmt: skip
def test_its_arrays_are_read_only(make):
    found = dict(arrays(make().law, "law"))
    assert len(found) > 10
    assert [name for name, array in found.items() if array.flags.writeable] == []


@pytest.mark.parametrize("kind", [tc.MPC, tc.NMPC])
@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_another_reference_is_that_of_a_new_controller(kind, held):
    """Also after a reset, which forgets no reference."""
    plant = scenes.plant(held)
    largest = 80.0 if held == "force_density" else None
    new = kind(
        plant,
        horizon=3,
        sample_time=scenes.SAMPLE,
        max_force_density=largest,
        reference=scenes.ramp(),
        load_gain=0.2,
    )
    used = kind(
        plant, horizon=3, sample_time=scenes.SAMPLE, max_force_density=largest, load_gain=0.2
    )
    before = used.law
    used.follow(scenes.ramp())
    assert used.law.load is before.load
    pushed = plant.to_nodes(np.full(9, 0.005))
    for _ in range(2):
        for k in range(4):
            one, other = (
                each.command(2.0 + k * scenes.SAMPLE, pushed, np.zeros((3, 6)))
                for each in (used, new)
            )
            assert one.status == other.status == "ok"
            np.testing.assert_array_equal(one.value, other.value)
        used.reset()
        new.reset()
    used.follow(None)
    gone = used.command(2.0, pushed, np.zeros((3, 6)))
    assert np.abs(gone.value - new.command(2.0, pushed, np.zeros((3, 6))).value).max() > 1e-4
