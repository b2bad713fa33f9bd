"""Sparse derivatives of a model at rest are those of its state equation."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.tangent import tangent
from tests import known_structures
from tests.random_structures import any_structure

STRUCTURES = {
    "ball": known_structures.six_bar_ball,
    "class-2 tower": lambda: known_structures.class2_tower(2),
    "D-bar": known_structures.d_bar,
    "clusters": known_structures.clustered_d_bar,
    "arm": known_structures.arm,
    "spine": known_structures.spine,
    **{f"random {seed}": lambda seed=seed: any_structure(seed) for seed in range(3)},
}


def by_casadi(model, input, nodes, held):
    """Accelerations and their derivatives by x and by the input, of what supports leave free."""
    equation = model.state_equation(input)
    x, u = (ca.SX.sym(name, equation.size1_in(i)) for i, name in enumerate("xu"))
    xdot = equation(x, u)
    function = ca.Function("f", [x, u], [xdot, ca.jacobian(xdot, x), ca.jacobian(xdot, u)])
    state = pack_state(model.structure, nodes, np.zeros_like(nodes))
    half = len(state) // 2
    return [part.full()[half:] for part in function(state, held)]


@pytest.mark.parametrize("input", ["force_density", "rest_length"])
@pytest.mark.parametrize("name", STRUCTURES)
def test_derivatives_are_those_of_the_state_equation_in_balance_or_not(name, input):
    structure = STRUCTURES[name]()
    rng = np.random.default_rng(0)
    gamma = rng.uniform(5, 20, len(structure.strings))
    law = tc.LinearStrings(stiffness=100.0, damping=0.5)
    ground = tc.Ground(stiffness=1e3, damping=0.3, friction=0.5, slip_speed=0.01,
                       height=float(np.median(structure.nodes[-1])) + 1e-3)  # fmt: skip
    model = tc.Model(structure, strings=law, gravity=9.81, ground=ground)
    held = gamma
    if input == "rest_length":
        held = model.strings.rest_length(structure.string_length(), gamma)
        held[0] = 1.2 * structure.string_length()[0]  # slack
    found = tangent(model, structure.nodes, input, held, model.constant_force)
    a, by_state, by_input = by_casadi(model, input, structure.nodes, held)
    free = structure.free_rows
    np.testing.assert_allclose(found.acceleration[free], a[:, 0], atol=1e-11 * np.abs(a).max())
    bent, none = -found.curvature[:, free].toarray(), np.zeros((found.curvature.shape[0], 1))
    parts = np.hstack([
        found.accelerations(-found.stiffness[:, free].toarray(), bent),
        found.accelerations(-found.damping[:, free].toarray(), 0 * bent),
    ])  # fmt: skip
    np.testing.assert_allclose(parts, by_state, atol=1e-12 * np.abs(by_state).max())
    inputs = found.by_input.toarray()
    pushed = found.accelerations(inputs, none.repeat(inputs.shape[1], axis=1))
    np.testing.assert_allclose(pushed, by_input, atol=1e-12 * np.abs(by_input).max())


def test_work_grows_with_the_members():
    counts = []
    for stages in (4, 8, 16):
        structure = tc.prism_tower(stages)
        gamma = np.ones(len(structure.strings))
        model = tc.Model(structure)
        found = tangent(model, structure.nodes, "force_density", gamma, model.constant_force)
        counts.append(found.stiffness.nnz + found.by_input.nnz + found.curvature.nnz)
    assert (counts[2] - counts[1]) == 2 * (counts[1] - counts[0])
