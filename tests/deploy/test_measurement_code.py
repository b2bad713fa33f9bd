"""The measured state by CasADi is that of the plant, wherever the structure is."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tenscontrol as tc
from tenscontrol.deploy.measurement_code import measurement


def plants():
    prism = tc.prism()
    model, rest = tc.Model(prism), tc.prestress(prism, 17.3205)
    found = {kind: tc.linearize(model, rest, coordinates=kind) for kind in ("nodes", "minimal")}
    for fixed in ([], [3], [3, 4]):
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
