"""The measured state by CasADi is that of the plant, wherever the structure is."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tenscontrol as tc
from tenscontrol.deploy.measurement_code import measurement
from tests import coupled


def plants():
    prism = tc.prism()
    model, rest = tc.Model(prism), tc.prestress(prism, 17.3205)
    found = {kind: tc.linearize(model, rest, coordinates=kind) for kind in ("nodes", "minimal")}
    for fixed in ([], [3]):
        held = tc.Structure(prism.nodes, prism.bars, prism.strings, prism.bar_mass, fixed=fixed)
        plant = tc.linearize(tc.Model(held), tc.prestress(held, force_density=rest.force_density))
        found[f"{len(fixed)} fixed"] = plant
    return found


@pytest.mark.parametrize(("name", "plant"), plants().items())
def test_measured_state(name, plant):
    rng = np.random.default_rng(0)
    measure = measurement(plant)
    turns = [np.eye(3), np.diag([1.0, -1, -1]), np.diag([-1.0, -1, 1])]
    turns += list(Rotation.random(50, random_state=rng).as_matrix())
    for turn in turns:
        for size in (0.0, 1e-6, 0.1):
            N = turn @ (plant.nodes + size * rng.normal(size=(3, 6))) + rng.normal(size=(3, 1))
            V = rng.normal(size=(3, 6))
            z = measure(N.ravel(order="F"), V.ravel(order="F")).full().ravel()
            np.testing.assert_allclose(z, plant.measure(N, V), rtol=0, atol=3e-14)


def coupled_plants():
    """Plants of class 2, by their supports: a D-bar in the plane, and a tower."""
    found = {}
    for fixed in ((), [0, (2, "x")], [(0, "y"), (1, "y")]):
        held = coupled.d_bar(fixed=fixed)
        model = tc.Model(held, strings=tc.LinearStrings(500.0))
        rest = tc.prestress(held, force_density=10.0)
        found[f"d_bar {fixed}"] = tc.linearize(model, rest, input="rest_length")
    for fixed in ([(i, "z") for i in range(3)], [0, (1, "z")]):
        held = coupled.tower(fixed=fixed)
        rest = tc.prestress(held, coupled.tower_force_density())
        found[f"tower {fixed}"] = tc.linearize(tc.Model(held), rest)
    return found


@pytest.mark.parametrize(("name", "plant"), coupled_plants().items())
def test_measured_state_of_bars_that_share_nodes(name, plant):
    """The shape moves as the supports let it, and a little more."""
    structure, rng = plant.model.structure, np.random.default_rng(0)
    d, n = structure.nodes.shape
    measure = measurement(plant)
    left = tc.structure.supports.rigid_basis(structure)
    for size in (0.0, 1e-6, 0.03):
        for _ in range(10):
            moved = 0.3 * left @ rng.normal(size=left.shape[1])
            moved[structure.free_rows] += size * rng.normal(size=len(structure.free_rows))
            N = plant.nodes + moved.reshape(n, d).T
            V = rng.normal(size=(d, n))
            z = measure(N.ravel(order="F"), V.ravel(order="F")).full().ravel()
            np.testing.assert_allclose(z, plant.measure(N, V), rtol=0, atol=1e-12)


def test_supports_that_hold_by_the_shape_are_refused():
    held = coupled.tower(fixed=[0, (1, "x"), (2, "y")])  # a ring in a plane: z does not count
    plant = tc.linearize(tc.Model(held), tc.prestress(held, coupled.tower_force_density()))
    with pytest.raises(ValueError, match="supports allow other rigid-body motions"):
        measurement(plant)
