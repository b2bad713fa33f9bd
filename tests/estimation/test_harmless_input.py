"""Sensors that are chosen by any collection or mask, or of which there are none."""

import numpy as np
import pytest

import tenscontrol as tc

PRISM = tc.prism()
PLANT = tc.linearize(tc.Model(PRISM), tc.prestress(PRISM, 17.3205))


def sensors(**chosen):
    return tc.Sensors(structure=PRISM, node_position=1e-3, string_length=2e-3, **chosen)


@pytest.mark.parametrize(
    "strings", [{1, 4}, [1, 4, 1], np.isin(np.arange(9), [1, 4]), [[1], [4]], [1.0, 4.0]], ids=repr
)
def test_strings_may_be_any_collection_or_mask(strings):
    known, found = sensors(strings=[1, 4]), sensors(strings=strings)
    assert found.readings == known.readings
    np.testing.assert_array_equal(found.noise, known.noise)
    np.testing.assert_array_equal(
        found.measure(PRISM.nodes, 0 * PRISM.nodes), known.measure(PRISM.nodes, 0 * PRISM.nodes)
    )


def test_one_string_may_be_one_number():
    assert sensors(strings=3).readings == sensors(strings=[3]).readings


def test_no_strings_are_none():
    without = tc.Sensors(structure=PRISM, node_position=1e-3)
    for strings in ([], (), set(), np.zeros(9, bool)):
        found = sensors(strings=strings)
        assert found.readings == without.readings
        filters = [tc.KalmanFilter(PLANT, each, sample_time=0.01) for each in (found, without)]
        assert len(filters[0].sensors.noise) == len(filters[1].sensors.noise) == 18
    assert tc.Sensors(structure=PRISM, node_position=1e-3, strings=[]).readings == without.readings


def test_a_structure_without_bars_has_no_directions_to_measure():
    net = tc.net(3, 3, spacing=0.1, node_mass=0.1)
    found = tc.Sensors(structure=net, node_position=1e-3, bar_direction=1e-3)
    assert len(found.noise) == 27


def test_what_is_chosen_still_needs_a_noise():
    with pytest.raises(ValueError, match="bars is given, but bar_direction is not"):
        sensors(bars=[0])
    with pytest.raises(ValueError, match=r"strings is a mask of shape \(8,\), expected \(9,\)"):
        sensors(strings=[True] * 8)


def test_a_delay_may_be_a_whole_float():
    assert tc.Sensors(structure=PRISM, node_position=1e-3, delay=2.0).delay == 2
