"""Scenes to draw, and figures closed after each test."""

import matplotlib
import numpy as np
import pytest

import tenscontrol as tc

matplotlib.use("Agg")


@pytest.fixture(autouse=True)
def _close_figures():
    import matplotlib.pyplot as plt

    before = dict(matplotlib.rcParams)
    yield
    plt.close("all")
    assert dict(matplotlib.rcParams) == before, "a plot changed the settings of all figures"


@pytest.fixture(scope="session")
def plant(prism, rest):
    return tc.linearize(tc.Model(prism), rest)


@pytest.fixture(scope="session")
def slack_run(prism):
    """A prism with too little force in its vertical strings: the horizontal ones go slack."""
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    start = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    return tc.simulate(model, 0.4, rest_length=start, step=1e-3)


@pytest.fixture(scope="session")
def free_run(prism):
    """The same with γ held, so that there are no rest lengths."""
    gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    return tc.simulate(tc.Model(prism), 0.4, force_density=gamma, tolerance=1e-9)


@pytest.fixture
def flat():
    import matplotlib.pyplot as plt

    return plt.subplots()[1]


@pytest.fixture
def space():
    import matplotlib.pyplot as plt

    return plt.figure().add_subplot(projection="3d")
