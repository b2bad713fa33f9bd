"""References of free structures: strings move no centre of mass."""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc


@cache
def plant():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    return tc.linearize(model, tc.prestress(prism, force_density=17.3205), input="rest_length")


def mpc(reference):
    return tc.MPC(plant(), horizon=5, sample_time=0.02, reference=reference)


def moved(nodes, by=(0.0, 0.0, 0.0), angle=0.0):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ nodes + np.array([by]).T


@pytest.mark.parametrize("how", [{"by": (0.3, 0.0, 0.0)}, {"angle": 0.4}, {"by": (1e-3, 0, 0)}])
def test_a_shape_given_elsewhere_is_refused(how):
    nodes = moved(plant().nodes, **how)
    with pytest.raises(ValueError, match=r"a rigid-body motion only.*cannot move the centre"):
        mpc(nodes)
    with pytest.raises(ValueError, match="at 1 s by up to"):
        mpc(tc.Reference([0.0, 1.0], np.stack([plant().nodes, nodes], axis=-1)))
    with pytest.raises(ValueError, match="a rigid-body motion only"):
        mpc(None).follow(nodes)


def test_a_shape_that_travels_is_refused():
    time = np.linspace(0.0, 2.0, 41)
    radius = tc.structure.prism_radius(plant().model.structure.bar_length[0], 0.9)
    low = tc.prism(radius=radius, height=0.9).nodes
    way = np.stack([moved(low, by=(0.01 * t, 0.0, 0.0)) for t in time], axis=-1)
    with pytest.raises(ValueError, match="a rigid-body motion only"):
        mpc(tc.Reference(time, way))


def test_another_shape_may_be_given_anywhere():
    """The shape is followed; where it is given does not matter."""
    radius = tc.structure.prism_radius(plant().model.structure.bar_length[0], 0.9)
    low = tc.prism(radius=radius, height=0.9).nodes
    start = plant().nodes, np.zeros((3, 6))
    commands = [mpc(N).command(0.0, *start).value for N in (low, moved(low, (1.0, 2.0, 0.0), 0.5))]
    np.testing.assert_allclose(*commands, rtol=0, atol=1e-9)


def test_the_operating_point_itself_is_no_motion():
    for nodes in (plant().nodes, plant().nodes * (1 + 1e-9), plant().nodes.astype(np.float32)):
        mpc(nodes)
    mpc(tc.Reference([0.0, 1.0], plant().nodes[:, :, None] * [1.0, 1.0]))
