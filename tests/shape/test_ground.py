"""Searches for shapes do not know ground, and say what to give them."""

import numpy as np
import pytest

import tenscontrol as tc


def test_a_model_with_ground_is_refused_and_that_of_a_stance_taken():
    prism = tc.prism()
    ground = tc.Ground(1e4, friction=0.9)
    model = tc.Model(prism, strings=tc.LinearStrings(500.0), gravity=9.81, ground=ground)
    gamma = tc.statics.prism_force_density(3, 60.0)[0]
    lengths = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    stance = tc.equilibrium(model, rest_length=lengths)
    low = tc.Height(0.95, top=[0, 1, 2], bottom=[3, 4, 5])
    with pytest.raises(ValueError, match="ground, whose contact forces the search"):
        tc.shape_target(model, low, force_density=60.0)
    with pytest.raises(ValueError, match="ground, whose contact forces the search"):
        tc.shape_path(model, stance, stance, duration=1.0)
    held = tc.linearize(model, stance).model
    target = tc.shape_target(held, low, force_density=60.0)
    assert not target.missed
    np.testing.assert_allclose(target.nodes[:, 3:], stance.structure.nodes[:, 3:], atol=1e-12)
