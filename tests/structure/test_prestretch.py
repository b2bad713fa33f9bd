"""Skins stretched from the start."""

import numpy as np
import pytest

import tenscontrol as tc


def skinned():
    return tc.skin(tc.prism(), panels=["top", "bottom"], iterations=2, node_mass=0.01)


def test_strain_of_the_skin_is_the_prestretch_and_the_others_keep_theirs():
    structure = skinned()
    given = np.linspace(0.5, 0.8, 9)
    rest_length = tc.structure.skin_rest_length(structure, given, prestretch=0.1)
    np.testing.assert_array_equal(rest_length[:9], given)
    np.testing.assert_allclose(structure.string_length()[9:] / rest_length[9:], 1.1)


def test_prestretch_gives_tension_and_its_lack_gives_none():
    structure = skinned()
    model = tc.Model(structure, strings=tc.LinearStrings(100.0))
    for prestretch, pulls in ((0.1, True), (0.0, False), (-0.1, False)):
        rest_length = tc.structure.skin_rest_length(structure, 0.7, prestretch)
        gamma = tc.to_force_density(model, structure.nodes, rest_length)
        assert (gamma[9:] > 0).all() == pulls
        assert (gamma[9:] >= 0).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tc.structure.skin_rest_length(tc.prism(), 0.7), "structure has no skin"),
        (
            lambda: tc.structure.skin_rest_length(tc.subdivide(tc.prism(), 2, 0.1), 0.7),
            "subdivided after",
        ),
        (
            lambda: tc.structure.skin_rest_length(skinned(), 0.7, -1.0),
            "prestretch is -1.0, expected",
        ),
        (lambda: tc.structure.skin_rest_length(skinned(), -0.7), r"rest_length\[0\] is -0.7"),
        (
            lambda: tc.structure.skin_rest_length(skinned(), [0.7] * 8),
            r"rest_length has shape \(8,\)",
        ),
    ],
)
def test_bad_arguments_are_refused_by_name(call, message):
    with pytest.raises(ValueError, match=message):
        call()
