"""A prism, its plants, and sensors of every kind."""

import pytest

import tenscontrol as tc

STEP = 0.02

EVERY = {
    "node_position": 2e-3,
    "string_length": 1e-3,
    "bar_direction": 1e-2,
    "string_tension": 0.1,
    "bar_rate": 0.05,
}


@pytest.fixture(scope="session")
def model():
    return tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=0.5))


@pytest.fixture(scope="session")
def rest(model):
    return tc.prestress(model.structure, force_density=17.320508)


@pytest.fixture(scope="session")
def held(model, rest):
    """The plant whose rest lengths are held."""
    return tc.linearize(model, rest, input="rest_length")


@pytest.fixture(scope="session")
def by_force(model, rest):
    """The plant whose force densities are held."""
    return tc.linearize(model, rest)


@pytest.fixture
def sensors_of(model):
    """Make sensors of the prism: of some kinds, with other options."""

    def make(*kinds, scale=1.0, **options):
        noise = {kind: scale * EVERY[kind] for kind in kinds}
        return tc.Sensors(structure=model.structure, **noise, **options)

    return make
