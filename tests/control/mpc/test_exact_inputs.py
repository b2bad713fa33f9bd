"""Planned inputs beside a solution of the optimality conditions, states and all, by elimination."""

import numpy as np
import pytest
from scipy.linalg import expm

import tenscontrol as tc
from tenscontrol.control.mpc.sparse import Sparse

HORIZON, SAMPLES = 5, 6


def ball():
    """Winches that ramp, at a limited rate, with γ to be kept in a narrow band."""
    structure = tc.library.six_bar_ball(bar_length=1.0)
    rest = tc.prestress(structure, force_density=20.0)
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness=500.0))
    plant = tc.linearize(model, rest, input="rest_length")
    winches = tc.Winches(rate=0.3, ramp=True)
    return plant, {"winches": winches, "max_force_density": 20.5, "min_force_density": 19.0}


def class_2_tower():
    """Bars that share nodes, winches that jump, tension limited."""
    structure = tc.library.class2_tower(2)
    rest = tc.prestress(structure, min_force_density=10.0)
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness=1e3))
    plant = tc.linearize(model, rest, input="rest_length")
    tension = rest.force_density * structure.string_length(structure.nodes)
    return plant, {"winches": tc.Winches(rate=0.2), "max_tension": 1.02 * tension}


def tower():
    """Force densities, with changes limited."""
    structure = tc.prism_tower(2)
    rest = tc.prestress(structure, min_force_density=10.0)
    plant = tc.linearize(tc.Model(structure), rest)
    most = 1.01 * rest.force_density.max()
    return plant, {"max_force_density": most, "max_change": 1.0, "R": 1e-4}


def by_elimination(problem, data, state, previous, multipliers):
    """Solve for states and inputs with the rows active whose multipliers are not zero."""
    program = Sparse(problem)
    q, low, high = program.vectors(state, data, previous)
    P, A = program.P.toarray(), program.A.toarray()
    equations = len(low) - len(multipliers)
    y = np.concatenate([np.zeros(equations), multipliers])
    taken = np.flatnonzero((low == high) | (y != 0))
    bound = np.where(y > 0, high, low)[taken]
    size = len(q)
    system = np.block([[P, A[taken].T], [A[taken], np.zeros((len(taken), len(taken)))]])
    right = np.concatenate([-q, bound])
    x = np.linalg.solve(system, right)
    x += np.linalg.solve(system, right - system @ x)
    found = np.zeros(len(low))
    found[taken] = x[size:]
    inequal = low < high
    moved = A @ x[:size]
    assert np.maximum(low - moved, moved - high).max() < 1e-8  # feasible
    assert (found[inequal] * np.sign(y[inequal])).min() > -1e-8  # of the right sign
    return program.inputs(x[:size], state, data), (
        x[size - len(program.limits.price) : size] > 1e-6
    )


@pytest.mark.filterwarnings("ignore:no string reaches")
@pytest.mark.parametrize("scene", [ball, class_2_tower, tower])
def test_inputs_are_those_of_the_optimality_conditions(scene):
    plant, given = scene()
    mpc = tc.MPC(plant, horizon=HORIZON, sample_time=0.02, **given)
    assert (mpc.form, mpc.solver) == ("condensed", "daqp")
    law, problem = mpc.law, mpc.law.design.problem
    rng, r = np.random.default_rng(0), plant.degrees_of_freedom
    state = 0.01 * np.concatenate([rng.normal(size=r), 3 * rng.normal(size=r)])
    width = len(problem.low)
    changed, violated, limited = 0, 0, 0
    for k in range(SAMPLES):
        nodes = plant.to_nodes(state[:r])
        speeds = (plant.basis @ state[r:]).reshape(nodes.shape, order="F")
        measured = plant.measure(nodes, speeds)
        solved = []
        solve = mpc._solver.solve
        mpc._solver.solve = lambda *a, **b: solved.append(solve(*a, **b)) or solved[-1]  # noqa: B023
        previous = mpc._previous_input
        command = mpc.command(0.02 * k, nodes, speeds)
        mpc._solver.solve = solve
        assert command.status == "ok"
        data = law.stage_data(law.preview(0.0), None)
        previous = data.previous_origin if previous is None else previous
        first = law.first_state(data, measured, previous)
        y = solved[0].y
        exact, violations = by_elimination(problem, data, first, previous - data.origin[0], y)
        error = np.abs(law.inputs(solved[0].x, data, measured, previous) - data.origin - exact)
        assert error.max() < 1e-9 * max(1.0, problem.level)
        violated += violations.sum()
        limited += (y[: HORIZON * width] != 0).sum()
        changed += (y[HORIZON * width : 2 * HORIZON * width] != 0).sum()
        size = 2 * r + width
        sampled = expm(0.02 * np.vstack([np.hstack([plant.A, plant.B]), np.zeros((width, size))]))
        held = command.value - plant.equilibrium_input
        state = (sampled @ np.concatenate([state, held]))[: 2 * r]
    if problem.rows is not None:
        assert violated
    assert changed or limited
