"""Sections: masses, rigidity and margins from materials and radii."""

import numpy as np
import pytest

import tenscontrol as tc

SOFT = tc.Material(modulus=60e9, density=2700.0, yield_stress=110e6)
STEEL = tc.sizing.materials["steel"]


def sized(**changed):
    given = {"bars": SOFT, "strings": STEEL, "bar_radius": 0.01, "string_radius": 1e-3}
    return tc.sections(tc.prism(), **{**given, **changed})


def test_masses_and_rigidity_are_those_of_the_formulas():
    sections, structure = sized(bar_inner_radius=0.008), tc.prism()
    area = np.pi * (0.01**2 - 0.008**2)
    np.testing.assert_allclose(sections.bar_mass, 2700 * area * structure.bar_length)
    np.testing.assert_allclose(sections.structure.bar_mass, sections.bar_mass)
    np.testing.assert_allclose(sections.axial_rigidity, 210e9 * np.pi * 1e-6)
    np.testing.assert_allclose(sections.bar_inertia, np.pi / 4 * (0.01**4 - 0.008**4))
    euler = np.pi**2 * 60e9 * sections.bar_inertia / structure.bar_length**2
    np.testing.assert_allclose(sections.buckling_force, euler)
    assert sections.mass == pytest.approx(sections.bar_mass.sum() + sections.string_mass.sum())


def test_string_mass_goes_to_the_nodes_on_request():
    sections = sized(string_mass_to_nodes=True)
    assert sections.structure.point_mass.sum() == pytest.approx(sections.string_mass.sum())
    assert not sized().structure.point_mass.any()


def test_a_cluster_keeps_its_path_and_its_mass():
    arm = tc.Structure(
        [[0, 1, 2], [0, 1, 0]], [[0, 1], [1, 2]], [[0, 1, 2]], bar_mass=1.0, fixed=[0]
    )
    sections = tc.sections(
        arm, bars=SOFT, strings=STEEL, bar_radius=0.01, string_radius=1e-3,
        string_mass_to_nodes=True,
    )  # fmt: skip
    assert sections.structure.paths == arm.paths
    half = 0.5 * 7850 * np.pi * 1e-6 * np.sqrt(2)
    np.testing.assert_allclose(sections.structure.point_mass, [half, 2 * half, half])


def test_margins_tell_yield_from_buckling():
    sections = sized()
    euler = sections.buckling_force[0]
    _, bars = sections.margins(np.zeros(9), [euler / 2, -110e6 * sections.bar_area[1] / 4, 0.0])
    np.testing.assert_allclose(bars, [2.0, 4.0, np.inf])
    strings, _ = sections.margins(np.full((9, 5), 355e6 * np.pi * 1e-6), np.zeros((3, 5)))
    np.testing.assert_allclose(strings, 1.0)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"bar_inner_radius": 0.01}, "bar_inner_radius"),
        ({"bar_radius": None}, "bar_radius or bar_area, none"),
        ({"string_area": 1e-6}, "string_radius or string_area, both"),
        ({"string_radius": 0.0}, "string_radius"),
        ({"bar_inertia": 1e-9}, "bar_inertia goes with bar_area"),
        ({"bar_radius": None, "bar_area": 1e-4, "bar_inner_radius": 0.1}, "goes with bar_radius"),
    ],
)
def test_what_does_not_fit_is_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        sized(**changed)


def test_zero_modulus_is_refused():
    with pytest.raises(ValueError, match="modulus"):
        tc.Material(modulus=0.0, density=1.0, yield_stress=1.0)
    with pytest.raises(ValueError, match="string_force has shape"):
        sized().margins(np.zeros(8), np.zeros(3))
