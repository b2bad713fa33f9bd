"""Planned inputs beside the optimum of the program with its states."""

import numpy as np
import pytest
from scipy.linalg import expm

import tenscontrol as tc
from tenscontrol.control.mpc import OutputLimit
from tenscontrol.control.mpc.sparse import Sparse
from tests.benchmarks.exact_commands import EXACT, commands, pushed
from tests.control.mpc.optimum import certain_inputs, exact_optimum, point_of_inputs
from tests.marks import needs_core

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


@pytest.mark.filterwarnings("ignore:no string reaches")
@pytest.mark.parametrize("seed", [0, 7, 9])
@pytest.mark.parametrize("scene", [ball, class_2_tower, tower])
def test_inputs_are_those_of_the_optimality_conditions(scene, seed):
    plant, given = scene()
    mpc = tc.MPC(plant, horizon=HORIZON, sample_time=0.02, **given)
    law, problem = mpc.law, mpc.law.design.problem
    rng, r = np.random.default_rng(seed), plant.degrees_of_freedom
    state = 0.01 * np.concatenate([rng.normal(size=r), 3 * rng.normal(size=r)])
    form, width, limited, violated = Sparse(problem), len(problem.low), 0, 0
    for k in range(SAMPLES):
        nodes = plant.to_nodes(state[:r])
        speeds = (plant.basis @ state[r:]).reshape(nodes.shape, order="F")
        previous = mpc._previous_input
        command = mpc.command(0.02 * k, nodes, speeds)
        assert command.status == "ok"
        data = law.stage_data(law.preview(0.0), None)
        previous = data.previous_origin if previous is None else previous
        first = law.first_state(data, plant.measure(nodes, speeds), previous)
        program = form.program(first, data, previous)
        near = point_of_inputs(program, mpc.plan)
        exact = exact_optimum(program.P, program.q, program.A, program.l, program.u, near)
        error = np.abs(program.inputs(exact) - mpc.plan)
        assert error.max() < 1e-9 * max(1.0, problem.level)
        violated += (exact[len(exact) - len(form.limits.price) :] > 1e-6).sum()
        limited += mpc.statistics.iterations[-1]
        size = 2 * r + width
        sampled = expm(0.02 * np.vstack([np.hstack([plant.A, plant.B]), np.zeros((width, size))]))
        held = command.value - plant.equilibrium_input
        state = (sampled @ np.concatenate([state, held]))[: 2 * r]
    assert limited
    assert violated or problem.rows is None


@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no long double")
@pytest.mark.parametrize("seed", [1, 7])
def test_inputs_that_cost_little_keep_their_digits(seed):
    """They are differences of numbers that are 1e4 times as large."""
    rest = tc.prestress(tc.prism(), min_force_density=5.0)
    model = tc.Model(rest.structure, strings=tc.LinearStrings(300.0))
    plant = tc.linearize(model, rest, input="rest_length")
    R = 1e-3 * np.array([6.0, 1.8, 0.56, 1.1, 3.7, 0.47, 0.79, 2.9, 16.0])
    winches = tc.Winches(rate=0.1, ramp=True, substeps=10)
    mpc = tc.MPC(plant, horizon=7, sample_time=0.02, R=R, winches=winches, min_force_density=4.0)
    push = 2.6e-3 * np.random.default_rng(seed).normal(size=(2, plant.degrees_of_freedom))
    nodes = plant.to_nodes(push[0])
    speeds = (plant.basis @ (3 * push[1])).reshape(nodes.shape, order="F")
    program = mpc.program(0.0, nodes, speeds)
    assert mpc.command(0.0, nodes, speeds).status == "ok"
    off = np.abs(certain_inputs(program, mpc.plan) - mpc.plan).max()
    assert off < 1e-10 * mpc.law.design.problem.level


@needs_core  # OSQP, which solves without it, runs out of iterations
@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no long double")
def test_limits_that_nearly_depend_on_others_are_seen_to_do_so():
    """The width of a rhombus is kept in a narrow band by γ that cost next to nothing."""
    structure = tc.library.d_bar()
    plant = tc.linearize(tc.Model(structure), tc.prestress(structure, force_density=6.4))
    row = np.zeros((1, 8))
    row[0, [0, 4]] = -1.0, 1.0
    width = float((row @ plant.nodes.ravel(order="F"))[0])
    mpc = tc.MPC(
        plant, horizon=7, sample_time=1.0, R=[2.4e-5, 7e-6], max_force_density=[6.5, 9.6],
        max_change=2.4, outputs=[OutputLimit(row, width - 9e-3, width + 9e-3, penalty=90.0)],
    )  # fmt: skip
    ends = pushed(mpc, np.random.default_rng(0), count=60)
    assert {one.status for one in ends} == {"ok"}
    assert max(one.error for one in ends) < EXACT
    assert max(one.changes for one in ends) > 100


@needs_core  # OSQP runs out of iterations
@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no long double")
@pytest.mark.parametrize("seed", [1, 2, 3, 5, 6, 7])  # 0 and 4 take as long as the others
def test_commands_of_random_programs_are_exact(seed):
    """All of the campaign: ``python -m tests.benchmarks.exact_commands``."""
    for one in commands(seed):
        assert one.status == "ok" or one.note == "no point keeps all rows"
        assert one.error < EXACT or one.note


@needs_core  # OSQP is not as exact
@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no long double")
@pytest.mark.parametrize("seed", [2006, 2104, 2310])
def test_many_inputs_are_exact_where_multipliers_are_huge(seed):
    """They hold limits against a state far off: up to 1e9, of which 1e-7 is round-off."""
    ends = commands(seed)[:2]
    assert {one.status for one in ends} == {"ok"}
    assert max(one.error for one in ends) < 1e-2 * EXACT


@needs_core  # OSQP runs out of iterations
@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no long double")
def test_few_limits_take_no_thousands_of_changes():
    """Rows whose lengths differ by decades went in and out 6,686 times: 136 of them."""
    ends = commands(40, "d_bar")
    assert {one.status for one in ends} == {"ok"}
    assert max(one.error for one in ends) < EXACT
    assert 5 * 136 < max(one.changes for one in ends) < 2500
