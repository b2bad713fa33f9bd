"""Shapes at rest while bars get other lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc


def plant_of(structure, actuated=None):
    model = tc.Model(structure, tc.LinearStrings(stiffness=200.0))
    rest = tc.prestress(structure, min_force_density=20.0)
    return tc.linearize(model, rest, "bar_length", "minimal", actuated=actuated)


@pytest.fixture(scope="module")
def plant():
    return plant_of(replace(tc.prism(), fixed=[3, 4, 5]))


@pytest.mark.parametrize("structure", [None, tc.library.d_bar_3d()])
def test_shapes_have_the_lengths_and_are_those_of_least_energy(plant, structure):
    """On supports, and bars that share nodes in the air."""
    plant = plant if structure is None else plant_of(structure)
    structure = plant.model.structure
    lengths = np.outer(structure.bar_length, [0.95, 1.0, 1.04])
    path = tc.shape.strut_path(plant, lengths, [0.0, 1.0, 2.0])
    np.testing.assert_allclose(path.nodes[:, :, 1], plant.nodes, atol=1e-9)
    for nodes, length, gamma in zip(
        path.nodes.T.swapaxes(1, 2), lengths.T, path.force_density.T, strict=True
    ):
        found = np.linalg.norm(structure.bar_vectors(nodes), axis=0)
        np.testing.assert_allclose(found, length, rtol=1e-12)
        there = replace(structure, nodes=nodes)
        assert tc.prestress(there, gamma).residual < 1e-9
        least = tc.equilibrium(plant.model.replace(structure=there), rest_length=plant.rest_length)
        np.testing.assert_allclose(least.structure.nodes, nodes, atol=1e-7)


def test_a_path_ends_where_strings_go_slack(plant):
    lengths = plant.model.structure.bar_length
    with pytest.raises(tc.shape.PathError, match="goes slack with bars of") as stopped:
        tc.shape.strut_path(plant, np.outer(lengths, [1.0, 0.4]), [0.0, 1.0])
    reached = stopped.value.reached.structure
    assert (reached.bar_length < 0.95 * lengths).all()
    few = plant_of(plant.model.structure, actuated=[0])
    with pytest.raises(ValueError, match="changes bar 1, which the plant does not drive"):
        tc.shape.strut_path(few, np.outer(lengths, [1.0, 1.1]), [0.0, 1.0])
    wound = tc.linearize(plant.model, tc.prestress(plant.model.structure, min_force_density=20.0))
    with pytest.raises(ValueError, match="expected 'bar_length'"):
        tc.shape.strut_path(wound, np.outer(lengths, [1.0, 1.1]), [0.0, 1.0])
