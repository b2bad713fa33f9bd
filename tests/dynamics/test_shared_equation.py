"""Equations that are taken from another model, with other parameters entered."""

from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc

PRISM = tc.prism()


def prisms():
    """Return a model, and another in which strings and masses differ."""
    random = np.random.default_rng(0)
    other = replace(PRISM, bar_mass=1.0 + random.random(3))
    laws = [
        tc.LinearStrings(stiffness * random.uniform(1, 2, size=9), damping)
        for stiffness, damping in ((100.0, 0.0), (300.0, random.random(9)))
    ]
    return [
        tc.Model(structure, law, gravity=9.81)
        for structure, law in zip((PRISM, other), laws, strict=True)
    ]


@pytest.mark.parametrize(("degree", "load_input"), [(0, False), (3, True)])
def test_functions_are_those_of_a_model_of_its_own(degree, load_input):
    first, alone = prisms()
    names = ["stiffness", "damping", "bar_mass"]
    sharing = prisms()[1].sharing(first, names)
    options = {"degree": degree, "load_input": load_input}
    ours, theirs = (model.equation("rest_length", **options) for model in (sharing, alone))
    random = np.random.default_rng(1)
    x = np.r_[PRISM.nodes.ravel(order="F"), np.zeros(18)] + 0.1 * random.normal(size=36)
    u, taut = random.random(ours.inputs), np.ones(9)
    for name, values in (("slope", (x, u, taut)), ("gap", (x, u))):
        own, wanted = (getattr(equation, name)(*values) for equation in (ours, theirs))
        if name == "gap":
            own, wanted = own[0], wanted[0]
        np.testing.assert_allclose(own, wanted, rtol=1e-12)
    forces = (equation.force(x[:18], x[18:], u, taut) for equation in (ours, theirs))
    np.testing.assert_allclose(*forces, rtol=1e-12)
    # Where the weight of the masses is built in, each model has its own equation.
    assert bool(first.prepared._kept) == load_input


def test_what_no_equation_takes_as_an_input_is_not_shared():
    first, other = prisms()
    sharing = other.sharing(first, ["stiffness", "ground.friction"])
    built = sharing.equation("rest_length")
    assert not first.prepared._kept
    x = np.r_[PRISM.nodes.ravel(order="F"), np.zeros(18)]
    u = np.ones(9)
    np.testing.assert_array_equal(
        built.slope(x, u, u), prisms()[1].equation("rest_length").slope(x, u, u)
    )
