"""The program of NMPC along its stages against the optimum of the same program, dense."""

import copy
from functools import cache

import numpy as np
import pytest
from scipy.sparse import csr_array

import tenscontrol as tc
from tenscontrol.control import NMPC, Status
from tenscontrol.control.mpc.problem import (
    MPCProblem,
    Rows,
    StageData,
    StageJacobians,
    Subproblem,
)
from tenscontrol.control.mpc.stages import StagesSubproblem
from tests.control.mpc.optimum import exact_optimum, fill_violations, is_feasible
from tests.marks import needs_core

SAMPLE = 0.02
pytestmark = needs_core


def exact_plan(problem, bounds, row_bounds, plan, motion, rows, given, found):
    """Return the plan of the optimum next to inputs that were found; None if there is none.

    States are eliminated by dense matrices, violations are unknown.
    """
    state, data, previous, acting = given
    N, (s, a) = problem.length, problem.input_matrix.shape
    ramp = len(problem.terminal_weight) > s
    p = 0 if rows is None else len(problem.rows.scale)
    unknowns = N * a + N * p  # inputs from those of the plan, and violations in units of the rows
    planned, level = plan[1], problem.level
    arguments = plan[0][:-1], planned[1:], planned[:-1]
    motion = motion.from_zero(*arguments[: len(motion.slopes)])
    if rows is not None:
        rows = rows.from_zero(*arguments[:2], plan[0][1:])

    def inputs(k):
        """Matrix and constant of u_k."""
        matrix = np.zeros((a, unknowns))
        if k < 0:
            return matrix, acting
        matrix[:, k * a : (k + 1) * a] = level * np.eye(a)
        return matrix, planned[k + 1]

    states = [(np.zeros((s, unknowns)), state)]
    for k in range(N):
        parts = [states[-1], inputs(k), *([inputs(k - 1)] if ramp else [])]
        moved = [
            sum(slope[k].T @ part[i] for slope, part in zip(motion.slopes, parts, strict=True))
            for i in (0, 1)
        ]
        states.append((moved[0], moved[1] + motion.values[k] + data.drift[k]))
    hessian, gradient = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    R = problem.input_weight
    R = np.diag(R) if R.ndim == 1 else R

    def add(weight, value, aim):
        nonlocal hessian, gradient
        matrix, constant = value
        hessian += matrix.T @ weight @ matrix
        gradient += matrix.T @ weight @ (constant - aim)

    for k in range(N if problem.cross_weight is not None else 0):
        off = data.first_reference if k == 0 else data.reference[k - 1]
        (z, c), (v, e) = states[k], inputs(k)
        both = z.T @ problem.cross_weight @ v
        hessian += both + both.T
        gradient += z.T @ problem.cross_weight @ (e - data.input_reference[k])
        gradient += v.T @ problem.cross_weight.T @ (c - off)
    for k in range(N):
        add(R, inputs(k), data.input_reference[k])
        if k < N - 1:
            add(problem.state_weight, states[k + 1], data.reference[k])
    end, aim = states[N], data.reference[N - 1]
    if ramp:
        end = tuple(np.concatenate(pair) for pair in zip(end, inputs(N - 1), strict=True))
        aim = np.r_[aim, data.input_reference[N - 1]]
    add(problem.terminal_weight, end, aim)
    matrix, low, high = dense_limits(
        problem, bounds, (rows, row_bounds), previous, inputs, states, (hessian, gradient)
    )
    scale = problem.cost_scale
    hessian, gradient = scale * hessian, scale * gradient
    hessian = 0.5 * (hessian + hessian.T)
    if found is None:
        assert not is_feasible(matrix, low, high)
        return None
    near = np.zeros(unknowns)
    near[: N * a] = ((found - planned[1:]) / level).ravel()
    fill_violations(near, matrix, low, high, N * a)
    x = exact_optimum(hessian, gradient, matrix, low, high, near)
    return (
        np.array([m @ x + c for m, c in states]),
        np.array([m @ x + c for m, c in (inputs(k) for k in range(N))]),
    )


def dense_limits(problem, bounds, row_limits, previous, inputs, states, cost):
    """Return the limits on inputs, changes and rows, and add the cost of violations."""
    (rows, row_bounds), (hessian, gradient) = row_limits, cost
    N, a, unknowns = problem.length, problem.input_matrix.shape[1], len(gradient)
    limits = []

    def limit(value, low, high, unit):
        matrix, constant = value
        limits.append((matrix / unit, (low - constant) / unit, (high - constant) / unit))

    def limit_row(value, i, violation):
        matrix, constant = value
        unit = problem.rows.scale[i]
        price = problem.rows.penalty[i] * unit
        low, high = row_bounds[0][i], row_bounds[1][i]
        hessian[violation, violation] = 1.0
        if np.isinf(price):
            limit(value, low, high, unit)
            return
        hessian[violation, violation], gradient[violation] = price, price
        for sign, least, most in ((-1, -np.inf, high), (1, low, np.inf)):
            relaxed = matrix.copy()
            relaxed[0, violation] = sign * unit
            limit((relaxed, constant), least, most, unit)
        zero = np.zeros((1, unknowns))
        zero[0, violation] = 1.0
        limit((zero, np.zeros(1)), 0.0, np.inf, 1.0)

    for k in range(N):
        limit(inputs(k), *bounds, problem.level)
        if problem.change is not None:
            (matrix, constant), before = inputs(k), inputs(k - 1)
            change = matrix - before[0], constant - (before[1] if k else previous)
            limit(change, -problem.change, problem.change, problem.level)
        count = 0 if rows is None else len(problem.rows.scale)
        for i in range(count):
            matrix = np.zeros((1, unknowns))
            constant = rows.values[k, i : i + 1].copy()
            for slope, value in zip(
                rows.slopes, (states[k], inputs(k), states[k + 1]), strict=True
            ):
                matrix += slope[k].T[i : i + 1] @ value[0]
                constant += slope[k].T[i] @ value[1]
            limit_row((matrix, constant), i, N * a + k * count + i)
    return (
        np.concatenate([np.atleast_1d(part) for part in parts])
        for parts in zip(*limits, strict=True)
    )


def random_program(seed, N, ramp, limited, changes, hard, size=(5, 3)):
    """A program of random stages, a plan to linearize it along, and what is measured."""
    rng = np.random.default_rng(seed)
    (s, a), p = size, 2
    n = s + a if ramp else s

    def weight(size, least):
        root = rng.normal(size=(size, size - 1 if least == 0 else size))
        return root @ root.T + least * np.eye(size)

    rows = penalty = None
    Q, R, cross = weight(s, 0.0), weight(a, 0.1), None
    if seed % 2:  # states and inputs share a weight
        shared = weight(s + a, 0.0)
        Q, R, cross = shared[:s, :s], shared[s:, s:] + 0.1 * np.eye(a), shared[:s, s:]
    if limited:
        penalty = np.array([3.0, np.inf if hard else 0.4])
        scale = rng.uniform(0.5, 2.0, p)
        E, G = np.ones((p, s)), np.ones((p, a))
        rows = Rows(E, E, csr_array(G), scale, penalty, (True, True))
    problem = MPCProblem(
        np.eye(s), np.ones((s, a)), np.zeros(s), Q, R, weight(n, 0.0),
        -np.ones(a), np.ones(a), np.full(a, 0.4) if changes else None, N, 0.7, np.zeros((a, s)),
        rows, cross,
    )  # fmt: skip
    widths = (s, a, a) if ramp else (s, a)
    slopes = tuple(0.4 * rng.normal(size=(N, width, s)) for width in widths)
    motion = StageJacobians(0.1 * rng.normal(size=(N, s)), slopes)
    along, reach = None, np.array([1.0, 12.0 if hard else 0.5])[: p if limited else 0]
    if limited:
        slopes = tuple(rng.normal(size=(N, width, p)) for width in (s, a, s))
        along = StageJacobians(0.1 * rng.normal(size=(N, p)), slopes)
    zeros = np.zeros((N, a))
    data = StageData(
        rng.normal(size=(N, s)), 0.3 * rng.normal(size=(N, a)), 0.1 * rng.normal(size=(N, s)),
        zeros, zeros, zeros, zeros, zeros, zeros, zeros[0], rng.normal(size=s),
    )  # fmt: skip
    previous = 0.1 * rng.normal(size=a)
    given = 2 * rng.normal(size=s), data, previous, previous + 0.1
    plan = states, inputs = rng.normal(size=(N + 1, s)), rng.normal(size=(N + 1, a))
    arguments = -states[:-1], -inputs[1:], -inputs[:-1]
    motion = motion.from_zero(*arguments[: len(widths)])
    if limited:
        along = along.from_zero(*arguments[:2], -states[1:])
    bounds = np.full(a, -0.5), np.full(a, 0.6)
    return problem, bounds, (-reach, reach), plan, motion, along, given


@pytest.mark.parametrize("N", [1, 2, 7])
@pytest.mark.parametrize(("ramp", "limited", "changes", "hard"), [
    (False, False, False, False), (True, False, True, False), (False, True, False, False),
    (False, True, True, True), (True, True, True, False),
])  # fmt: skip
def test_random_programs(N, ramp, limited, changes, hard):
    """Twice each: cold, then from the active set of the first, at another state."""
    solved = 0
    for seed in range(4):
        made = random_program(seed, N, ramp, limited, changes, hard)
        problem, bounds, row_bounds, plan, motion, rows, given = made
        program = StagesSubproblem(problem, row_bounds, 500, bounds)
        for factor in (1.0, 0.8):
            at = factor * given[0], *given[1:]
            assert program.linearize(*plan, motion, rows)
            found = program.solve(*at, np.inf)
            if found.plan is None:
                assert found.status is Status.INFEASIBLE
                assert exact_plan(*made[:-1], at, None) is None
                continue
            states, inputs = exact_plan(*made[:-1], at, found.plan[1][1:])
            np.testing.assert_allclose(found.plan[1][1:], inputs, rtol=0, atol=1e-9)
            np.testing.assert_allclose(found.plan[0], states, rtol=0, atol=1e-8)
            solved += 1
    assert solved >= 4
    # From the active set of the answer, nothing changes.
    program.linearize(*plan, motion, rows)
    if found.plan is not None:
        assert program.solve(*at, np.inf).iterations == 0


@pytest.mark.parametrize("ramp", [False, True])
def test_large_programs(ramp):
    """So large that the BLAS multiplies, with rows of all stages and kinds in a batch."""
    made = random_program(3, 3, ramp, True, True, False, (35, 33))
    problem, bounds, row_bounds, plan, motion, rows, given = made
    for slope in motion.slopes:
        slope *= 0.3
    program = StagesSubproblem(problem, row_bounds, 500, bounds)
    changes = []
    for _ in range(2):
        assert program.linearize(*plan, motion, rows)
        found = program.solve(*given, np.inf)
        _, inputs = exact_plan(*made, found.plan[1][1:])
        np.testing.assert_allclose(found.plan[1][1:], inputs, rtol=0, atol=1e-9)
        changes.append(found.iterations)
    assert changes[0] > 40
    assert changes[1] == 0  # more rows than a batch are reached again


@pytest.mark.parametrize("ramp", [False, True])
def test_stages_of_a_plan_that_moved_on_stay_in_their_places(ramp):
    """Kept are matrices, and costs within the tolerance; with none, all is as in a new one."""
    N = 6
    problem, bounds, row_bounds, plan, motion, rows, given = random_program(
        1, N, ramp, True, True, False
    )
    exact, kept, near = (
        StagesSubproblem(problem, row_bounds, 500, bounds, tolerance=tolerance)
        for tolerance in (0.0, 0.0, 1e-3)
    )
    for program in (kept, near):
        assert program.linearize(*plan, motion, rows)
    rng, found = np.random.default_rng(5), []
    for slope in motion.slopes:  # slot 0 takes the new sample
        slope[0] = 0.4 * rng.normal(size=slope[0].shape)
    fresh = np.arange(N) == N - 1
    moved = StageJacobians(motion.values, motion.slopes, np.roll(np.arange(N), -1), fresh)
    for program, data in ((exact, moved.in_order()), (kept, moved), (near, moved)):
        assert program.linearize(*plan, data, rows)
        answer = program.solve(*given, np.inf)
        assert answer.status is Status.OK
        found.append(answer.plan[1])
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-12)
    assert np.abs(found[2] - found[0]).max() < 1e-2


@pytest.mark.parametrize("ramp", [False, True])
def test_samples_that_share_their_derivatives_have_the_plan_of_equal_ones(ramp):
    """Slots go from sample to sample; no step of the recursion may be that of other derivatives."""
    N = 6
    problem, bounds, row_bounds, plan, motion, rows, given = random_program(
        1, N, ramp, True, True, False
    )
    shared = StagesSubproblem(problem, row_bounds, 500, bounds)
    rng, slots, fresh = np.random.default_rng(6), np.zeros(N, int), np.arange(N) == 0
    for _ in range(12):
        for slot in slots[fresh]:
            for part in motion.slopes:
                part[slot] = 0.4 * rng.normal(size=part[slot].shape)
        jacobians = StageJacobians(motion.values, motion.slopes, slots, fresh)
        exact = StagesSubproblem(problem, row_bounds, 500, bounds)
        answers = []
        for program, data in ((shared, jacobians), (exact, jacobians.in_order())):
            assert program.linearize(*plan, data, rows)
            answers.append(program.solve(*given, np.inf))
            assert answers[-1].status is Status.OK
        np.testing.assert_allclose(answers[0].plan[1], answers[1].plan[1], rtol=0, atol=1e-12)
        # A sample moves on, one takes the slot of another, and one fills a slot that is free.
        slots, fresh = np.append(slots[1:], slots[-1]), np.zeros(N, bool)
        taking, filling = rng.choice(N, 2, replace=False)
        slots[taking] = rng.choice(slots)
        slots[filling] = np.setdiff1d(np.arange(N), np.delete(slots, filling))[0]
        fresh[filling] = True


def test_data_without_value_are_told():
    problem, bounds, row_bounds, plan, motion, rows, given = random_program(
        0, 3, False, True, True, False
    )
    program = StagesSubproblem(problem, row_bounds, 500, bounds)
    for part in (motion.values, motion.slopes[0], rows.slopes[2]):
        kept = part.copy()
        part.flat[-1] = np.nan
        assert not program.linearize(*plan, motion, rows)
        part[:] = kept
    assert program.linearize(*plan, motion, rows)
    nothing = program.solve(np.full(5, np.nan), *given[1:], np.inf)
    assert nothing.status is Status.BAD_DATA
    assert nothing.plan is None
    assert program.solve(*given, 0.0).status is Status.OUT_OF_TIME
    assert program.solve(*given, np.inf).status is Status.OK


@cache
def scene(name):
    """A plant and an NMPC of it whose limits matter, and a motion that it starts from."""
    strings = tc.LinearStrings(200.0)
    limits = {"horizon": 4}
    if name == "ball, winches":
        structure = tc.library.six_bar_ball(bar_length=1.0)
        rest, held = tc.prestress(structure, force_density=20.0), "rest_length"
        limits |= {"winches": tc.Winches(rate=0.3), "min_force_density": 10.0, "max_tension": 16.0}
    elif name == "ball, ramps":
        structure = tc.library.six_bar_ball(bar_length=1.0)
        rest, held = tc.prestress(structure, force_density=20.0), "rest_length"
        limits |= {"winches": tc.Winches(rate=0.3, substeps=10), "min_force_density": 10.0}
    elif name == "d_bar":
        structure = tc.library.d_bar()
        rest, held = tc.prestress(structure, force_density=20.0), "force_density"
        limits |= {"max_force_density": 20.008, "max_change": 0.006}
    else:
        structure = tc.library.class2_tower(2)
        rest, held = tc.prestress(structure, min_force_density=5.0), "force_density"
        tension = rest.force_density * structure.string_length()
        limits |= {"max_force_density": 1.05 * rest.force_density, "max_tension": 1.02 * tension}
    plant = tc.linearize(tc.Model(structure, strings=strings), rest, input=held)
    return plant, limits


class Compared(Subproblem):
    """The program of an NMPC, each solution against the optimum."""

    def __init__(self, law):
        self._law, self.changes = law, 0
        self._program = StagesSubproblem(law.problem, law.row_bounds, 500, law.bounds)

    def reset(self):
        self.forget()

    def forget(self):
        self._program.forget()

    def shift(self):
        self._program.shift()

    def linearize(self, states, inputs, motion, rows):
        self._data = (states.copy(), inputs.copy()), motion, rows
        return self._program.linearize(states, inputs, motion, rows)

    def solve(self, *given):
        law = self._law
        found = self._program.solve(*given)
        assert found.status is Status.OK
        _, inputs = exact_plan(
            law.problem, law.bounds, law.row_bounds, *self._data, given[:-1], found.plan[1][1:]
        )
        assert np.abs(found.plan[1][1:] - inputs).max() < 1e-9 * law.problem.level
        self.changes += found.iterations
        return found


@pytest.mark.filterwarnings("ignore:no string reaches")
@pytest.mark.parametrize("name", ["ball, winches", "ball, ramps", "d_bar", "class-2 tower"])
def test_structures(name):
    """Programs of two samples of a closed loop; derivatives need no compiler here."""
    plant, limits = scene(name)
    nmpc = NMPC(plant, sample_time=SAMPLE, **limits)
    compared = nmpc._plan.program = Compared(nmpc.law)
    r = plant.degrees_of_freedom
    rng = np.random.default_rng(0)
    z = np.r_[0.003 * rng.normal(size=r), 0.15 * rng.normal(size=r)]
    before = plant.equilibrium_input
    for k in range(2):
        command = nmpc.command(k * SAMPLE, plant.to_nodes(z[:r]), plant.to_velocities(z[:r], z[r:]))
        assert command.status is Status.OK
        given = (before, command.value) if nmpc.sampled.n_in() == 3 else (command.value,)
        z, before = nmpc.sampled(z, *given).full().ravel(), command.value
    assert compared.changes > 0  # limits matter


def test_solvers_agree():
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, 30 / np.sqrt(3)))
    nodes = plant.to_nodes(0.05 * np.random.default_rng(0).normal(size=9))
    values = []
    for solver in ("stages", "osqp"):
        nmpc = NMPC(
            plant, horizon=4, sample_time=SAMPLE, max_force_density=33.0, max_change=1.0,
            tolerance=1e-9, max_iterations=50_000, solver=solver,
        )  # fmt: skip
        values.append(nmpc.command(0.0, nodes, np.zeros((3, 6))).value)
        assert nmpc.solver == solver
    np.testing.assert_allclose(*values, rtol=0, atol=1e-6 * 17)


@pytest.mark.parametrize("code", [True, False])
def test_a_copy_continues_as_its_original(code):
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, 30 / np.sqrt(3)))
    nmpc = NMPC(plant, horizon=4, sample_time=SAMPLE, max_force_density=33.0, machine_code=code)
    rng = np.random.default_rng(0)
    shapes = [plant.to_nodes(0.05 * rng.normal(size=9)) for _ in range(3)]
    nmpc.command(0.0, shapes[0], np.zeros((3, 6)))
    nmpc.prepare()
    other = copy.deepcopy(nmpc)
    for k in (1, 2):
        found = [each.command(k * SAMPLE, shapes[k], np.zeros((3, 6))) for each in (nmpc, other)]
        np.testing.assert_array_equal(found[0].value, found[1].value)
