"""A family of structures: columns of shorter and shorter bars, and what it names."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

import tenscontrol as tc
from tests.sizing.test_design import ROPE, SOFT, d_bar, pressed

ANGLES = [10, 20, 30, 60]


def sized(**changed):
    family = {angle: d_bar(np.radians(angle)) for angle in ANGLES}

    def least(bars):
        given = {"loads": [pressed(bars, 0, 2)], "min_force_density": 0.0} | changed
        return tc.design(bars, bars=SOFT, strings=ROPE, **given)

    return tc.sizing.complexity(family, least)


def test_masses_of_a_family_are_those_of_the_closed_form():
    found = sized()
    angle = np.radians(ANGLES)
    column = 2 * SOFT.density * 4 * np.sqrt(1e4 / (np.pi * SOFT.modulus))
    strings = ROPE.density / ROPE.yield_stress * 1e4 * 2 * np.tan(angle) ** 2
    expected = column / np.sqrt(2) * np.cos(angle) ** -2.5 + strings
    np.testing.assert_allclose(found.mass, expected, rtol=1e-9)
    assert found.lightest == 10
    assert len(found.table().splitlines()) == 5


def test_its_figure_has_a_column_each():
    found = sized()
    drawing = tc.plot.least_mass(found, xlabel="angle, degrees")
    tops = [patch.get_y() + patch.get_height() for patch in drawing.strings]
    np.testing.assert_allclose(tops, found.mass)
    assert [tick.get_text() for tick in drawing.ax.get_xticklabels()] == ["10", "20", "30", "60"]
    plt.close(drawing.ax.figure)


def test_the_structure_that_fails_is_named():
    with pytest.raises(ValueError, match=r"family\[10\]: loads\[0\] cannot be carried"):
        sized(loads=[np.eye(2, 4)])
    with pytest.raises(TypeError, match="family"):
        tc.sizing.complexity({}, len)
    with pytest.raises(TypeError, match=r"what sized returns for family\[1\] is .*Design"):
        tc.sizing.complexity({1: d_bar(1.0)}, lambda _: None)
