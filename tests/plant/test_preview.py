"""Previews of references, and values of segments and whole strings."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.demo import tour as demo
from tenscontrol.plant.linear_plant import sampled
from tenscontrol.plant.reference import ReferencePreview, _acceleration_at_rest
from tenscontrol.plant.string_outputs import to_commanded_strings, to_model_strings
from tenscontrol.structure.segments import to_segments, to_strings

SAMPLE, LENGTH = 0.02, 7


def plant_of(kind):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(1e3, damping=1.0))
    return tc.linearize(model, tc.prestress(prism, demo.TOP_FORCE_DENSITY), input=kind)


@pytest.mark.parametrize("kind", ["force_density", "rest_length"])
def test_the_operating_point_is_at_rest_over_the_whole_horizon(kind):
    plant = plant_of(kind)
    preview = ReferencePreview(plant, None, sampled(plant, SAMPLE, False)).over_horizon(0.3, LENGTH)
    assert preview.reference.shape == preview.drift.shape == (LENGTH, 18)
    assert preview.input.shape == preview.force_density.shape == (LENGTH + 1, 9)
    for still in (preview.reference, preview.rest, preview.drift):
        np.testing.assert_allclose(still, 0.0, atol=1e-9)
    np.testing.assert_allclose(preview.input - plant.equilibrium_input, 0.0, atol=1e-9)
    np.testing.assert_allclose(preview.previous_input, plant.equilibrium_input, atol=1e-9)
    np.testing.assert_allclose(
        preview.tension,
        plant.force_density * plant.model.structure.string_length() + 0 * preview.tension,
    )


def test_the_balance_of_few_coordinates_grows_as_the_chain():
    """Where bars share nodes, each string moves all of them: a dense derivative by all strings."""
    counts = []
    for stages in (10, 20):
        tower = tc.library.class2_tower(stages)
        rest = tc.prestress(tower, 10.0)
        model = tc.Model(tower, strings=tc.LinearStrings(1e4))
        plant = tc.reduce(tc.linearize(model, rest, input="rest_length"), 4)
        counts.append(sum(each.n_instructions() for each in _acceleration_at_rest(plant)[:2]))
    assert counts[1] < 2.2 * counts[0]


def aims(path, times, ramp):
    """Motion at the ends of samples and inputs, from the values of the path at these times."""
    if not ramp:
        return path.wanted(times[1:]), path.at(times[:-1]).input
    q = path.wanted(np.append(times, times[-1] + SAMPLE))[:, :9]
    return np.hstack([q[1:-1], (q[2:] - q[:-2]) / (2 * SAMPLE)]), path.at(times[1:]).input


@pytest.mark.parametrize("ramp", [False, True])
def test_linear_and_nonlinear_controllers_aim_at_the_same_motion_and_inputs(ramp):
    plant = plant_of("rest_length")
    reference = demo.ramp(tc.prism(), 1.0, 0.95, 0.2)
    path = ReferencePreview(plant, reference, sampled(plant, SAMPLE, ramp))
    preview = path.over_horizon(0.06, LENGTH)
    motion, inputs = aims(path, 0.06 + SAMPLE * np.arange(LENGTH + 1.0), ramp=ramp)
    np.testing.assert_allclose(preview.reference, motion, atol=1e-12)
    np.testing.assert_allclose(preview.input[:-1], inputs, atol=1e-12)
    assert np.abs(np.diff(preview.input, axis=0)).max() > 1e-4
    # Another reference has the same plant and sample.
    still = path.following(plant.nodes).over_horizon(0.06, LENGTH)
    np.testing.assert_allclose(still.reference, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("what", "share"),
    [("force_density", 3.0), ("rest_length", 1 / 3), ("length", 1 / 3), ("tension", 1.0)],
)
def test_segments_have_the_tension_of_their_string_and_share_its_length(what, share):
    structure = tc.subdivide(tc.prism(), 3, node_mass=0.01)
    values = np.random.default_rng(0).uniform(1.0, 2.0, size=(2, 9))
    segments = to_segments(structure, what, values)
    np.testing.assert_allclose(segments, share * values[:, structure.string_parent])
    np.testing.assert_allclose(to_strings(structure, what, segments), values)


def test_a_plant_that_commands_its_own_strings_has_nothing_to_map():
    plant, values = plant_of("force_density"), np.ones(9)
    assert to_model_strings(plant, "force_density", values) is values
    assert to_commanded_strings(plant, "length", values) is values
