"""The paper's equation in symbols: evaluated, it is that of models with those numbers."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tests.refused import assert_refused


def hanging_prism():
    """Of class 1, on a fixed node, with payloads and a string node."""
    prism = tc.prism()
    nodes = np.column_stack([prism.nodes, [0.0, 0.1, 1.5]])
    strings = [*map(tuple, prism.strings), (0, 6), (6, 1)]
    mass = np.zeros(7)
    mass[6] = 0.3
    return tc.Structure(nodes, prism.bars, strings, [1.0, 2.0, 3.0], point_mass=mass, fixed=[5])


STRUCTURES = {
    "prism on a node": hanging_prism,
    "class 2 in the plane": tc.library.arm,
    "clustered": lambda: tc.Structure(
        [[0, 1, 1, 0], [0, 0, 1, 1.2]], [(0, 1), (2, 3)], [(0, 3, 2, 1)], 1.0, fixed=[0]
    ),
}


def state(structure, seed=0):
    """A shape near the reference, and velocities, of all nodes."""
    random = np.random.default_rng(seed)
    N = structure.nodes.ravel(order="F").copy()
    N[structure.free_rows] += 0.03 * random.normal(size=len(structure.free_rows))
    V = np.zeros_like(N)
    V[structure.free_rows] = random.normal(size=len(structure.free_rows))
    return N, V


@pytest.mark.parametrize("name", STRUCTURES)
@pytest.mark.parametrize("input", ["force_density", "rest_length"])
def test_symbols_have_the_numbers_of_models_with_them(name, input):
    structure = STRUCTURES[name]()
    law = tc.LinearStrings(stiffness=300.0, damping=4.0)
    load = np.random.default_rng(1).normal(size=structure.nodes.shape)
    asked = {} if structure.blocks else {"bar_mass": 0.7 + np.arange(len(structure.bars))}
    if input == "rest_length":
        asked |= {"stiffness": np.full(len(structure.strings), 120.0), "damping": np.full(
            len(structure.strings), 0.4)}  # fmt: skip
    s = tc.Model(structure, law, external_force=load, gravity=9.81).symbolic(input, list(asked))
    held = s.gamma if input == "force_density" else s.rest_length
    names = ("N", "Nd", "Ndd", "gamma", "lam", "W", "M_s", "K_s")
    of = ca.Function("of", [s.x, held, *s.parameters.values()], [getattr(s, n) for n in names])
    N, V = state(structure)
    rows, u = structure.free_rows, 0.4
    given = [np.concatenate([N[rows], V[rows]]), u, *asked.values()]
    found = dict(zip(names, (np.array(ca.DM(part)) for part in of(*given)), strict=True))

    theirs = replace(structure, bar_mass=asked.get("bar_mass", structure.bar_mass))
    other = tc.Model(theirs, replace(law, **{k: v for k, v in asked.items() if k != "bar_mass"}),
                     external_force=load, gravity=9.81)  # fmt: skip
    free, gamma = theirs.free, found["gamma"].ravel()
    at = (found["N"][:, free], found["Nd"][:, free], gamma)
    if input == "rest_length":
        expected = other.string_force_density(given[0], u)
        np.testing.assert_allclose(gamma, np.array(expected).ravel(), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found["Ndd"][:, free], np.array(other.acceleration(*at)), atol=1e-10)
    lam = np.array(other.bar_force_density(*at)).ravel()
    np.testing.assert_allclose(found["lam"].ravel(), lam, rtol=1e-11)
    np.testing.assert_allclose(found["M_s"], other.M_s.toarray(), rtol=1e-14)
    np.testing.assert_allclose(found["K_s"], other.K_s(*at).full(), rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(found["W"], other.constant_force, rtol=1e-13, atol=1e-13)
    residual = found["Ndd"] @ found["M_s"] + found["N"] @ found["K_s"] - found["W"]
    assert np.abs(residual.ravel(order="F")[rows]).max() < 1e-11


def test_a_load_is_a_symbol_of_the_equation():
    s = tc.Model(tc.prism(), external_force=True).symbolic()
    assert ca.is_equal(ca.densify(s.W), s.load, 2)
    assert s.load.shape == (3, 6)
    assert s.rest_length is None


def test_unknown_words_are_refused():
    model, arm = tc.Model(tc.prism()), tc.Model(tc.library.arm())
    for call, message in (
        (lambda: model.symbolic("rest_length"), "no string law"),
        (lambda: model.symbolic("gamma"), "input is 'gamma', expected one of"),
        (lambda: model.symbolic(parameters=["mass"]), r"parameters is 'mass', expected one of"),
        (lambda: model.symbolic(parameters=["stiffness"]), "parameters is 'stiffness'"),
        (lambda: arm.symbolic(parameters=["bar_mass"]), "parameters is 'bar_mass', expected"),
    ):
        assert_refused(call, ValueError, message)
