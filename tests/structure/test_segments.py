"""Values of whole strings and of their segments: each map is the inverse of the other."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import tenscontrol as tc
from tests.structure.test_subdivide import cord, subdivisions

KINDS = (
    "force_density",
    "rest_length",
    "length",
    "tension",
    "stiffness",
    "damping",
    "axial_rigidity",
)


@given(subdivisions(), st.sampled_from(KINDS))
def test_values_of_segments_made_from_whole_strings_give_these_strings_again(case, what):
    structure, segments = case
    cut = tc.subdivide(structure, segments, node_mass=0.1)
    values = np.linspace(1.0, 2.0, 3 * len(segments)).reshape(3, -1)
    spread = tc.structure.segments.to_segments(cut, what, values)
    assert spread.shape == (3, segments.sum())
    np.testing.assert_allclose(
        tc.structure.segments.to_strings(cut, what, spread), values, rtol=1e-14
    )
    if what in ("rest_length", "length"):
        np.testing.assert_allclose(spread.sum(axis=1), values.sum(axis=1), rtol=1e-14)


@pytest.mark.parametrize("what", KINDS)
def test_strings_that_are_not_cut_are_their_own_segments(what):
    values = np.arange(1.0, 10.0)
    for change in (tc.structure.segments.to_segments, tc.structure.segments.to_strings):
        np.testing.assert_array_equal(change(tc.prism(), what, values), values)


def test_whole_strings_of_unequal_segments_add_lengths_and_act_in_series():
    cut = tc.subdivide(cord()[0], 2, node_mass=0.1)
    given = np.array([2.0, 6.0])
    found = {what: float(tc.structure.segments.to_strings(cut, what, given)[0]) for what in KINDS}
    assert found == {
        "force_density": 2.0,  # the mean tension over the whole length of equal segments
        "rest_length": 8.0,
        "length": 8.0,
        "tension": 4.0,
        "stiffness": 1.5,
        "damping": 1.5,
        "axial_rigidity": 3.0,
    }


def test_other_kinds_and_shapes_are_refused():
    with pytest.raises(ValueError, match="what is 'mass', expected one of 'force_density'"):
        tc.structure.segments.to_segments(tc.prism(), "mass", np.ones(9))
    with pytest.raises(
        ValueError, match=r"length has shape \(2, 8\), expected \(..., 9\): one per"
    ):
        tc.structure.segments.to_strings(tc.prism(), "length", np.ones((2, 8)))
