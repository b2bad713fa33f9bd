"""MPC: the program it solves, the commands it gives, and what it does when it cannot."""

import ctypes
import os
import signal
from dataclasses import replace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Status
from tenscontrol.control.mpc import settings
from tenscontrol.control.mpc.osqp_solver import OSQPSolver
from tenscontrol.control.mpc.problem import MPCProblem, StageData
from tenscontrol.control.mpc.sparse import Sparse
from tenscontrol.core.library import absence
from tenscontrol.plant.riccati import horizon_radius
from tests.control.fault_loop import solve_nothing
from tests.control.mpc.optimum import exact_optimum, point_of_inputs

STILL = np.zeros((3, 6))
GIVEN = {"sample_time": 0.02, "max_force_density": 60.0}


@pytest.fixture(scope="module")
def plant():
    prism = tc.prism()
    return tc.linearize(tc.Model(prism), tc.prestress(prism, 30 / np.sqrt(3)))


def pushed(plant, size=0.01, seed=0):
    q = size * np.random.default_rng(seed).normal(size=plant.degrees_of_freedom)
    return plant.to_nodes(q)


def kkt_residual(P, q, A, l, u, x, y):  # noqa: E741
    """Return the largest violation of the optimality conditions of min ½xᵀPx + qᵀx, l ≤ Ax ≤ u."""
    Ax = A @ x
    return max(
        np.abs(P @ x + q + A.T @ y).max(),  # stationarity
        np.maximum(l - Ax, Ax - u).max(),  # feasibility
        np.abs(np.minimum(y, 0) * (Ax - l))[np.isfinite(l)].max(initial=0),  # complementarity
        np.abs(np.maximum(y, 0) * (u - Ax))[np.isfinite(u)].max(initial=0),
    )


def steady_data(problem, reference):
    """Return stage data in which only the reference of the state changes."""
    N = problem.length
    still, none = np.zeros((N, len(problem.low))), np.zeros((N, 0))
    bounds = (np.tile(bound, (N, 1)) for bound in (problem.low, problem.high))
    drift = np.tile(problem.drift, (N, 1))
    return StageData(reference, still, drift, *bounds, still, none, none, still, still[0])


@pytest.mark.parametrize("max_change", [None, 2.0])
@pytest.mark.parametrize("size", [0.01, 0.1])
def test_solution_satisfies_the_optimality_conditions(plant, max_change, size):
    mpc = tc.MPC(
        plant,
        horizon=20,
        sample_time=0.02,
        max_force_density=60.0,
        solver="osqp",
        max_change=max_change,
        tolerance=1e-7,
        R=1e-3,
    )
    state = plant.measure(pushed(plant, size), STILL)
    data = steady_data(mpc.law.design.problem, np.zeros((20, 18)))
    form = mpc._program.form
    vectors = form.vectors(state, data, np.zeros(9))
    answer = mpc._program.solver.solve(*vectors)
    assert answer.status is Status.OK
    scale = max(1.0, np.abs(answer.y).max())
    assert kkt_residual(form.P, vectors[0], form.A, *vectors[1:], answer.x, answer.y) < 1e-6 * scale
    # The case is worth something only if bounds are met where the push is large.
    inputs = form.trajectory(answer.x)[1] + plant.force_density
    assert inputs.min() > -1e-5
    if size == 0.1 and max_change is None:
        assert (inputs < 1e-4).any()
        assert (inputs > 45 - 1e-4).any()


def test_both_solvers_give_the_same_commands(plant):
    commands = {}
    for solver in ("auto", "osqp"):
        mpc = tc.MPC(
            plant,
            horizon=20,
            sample_time=0.02,
            max_force_density=60.0,
            solver=solver,
            max_change=3.0,
            tolerance=1e-9,
        )
        commands[solver] = [
            mpc.command(0.02 * k, pushed(plant, 0.1, seed=k), STILL).value for k in range(5)
        ]
    assert np.allclose(commands["auto"], commands["osqp"], atol=1e-4)


def test_horizon_cost_is_the_sum_it_stands_for(plant):
    """The quadratic programs differ from the cost written out by a constant only."""
    rng = np.random.default_rng(1)
    transition, inputs, _ = plant.discretize(0.02)
    N, s, a = 4, 18, 9
    problem = MPCProblem(
        transition, inputs, 0.01 * rng.normal(size=s), np.diag(rng.uniform(1, 2, s)),
        np.diag(rng.uniform(1, 2, a)), 3 * np.eye(s), np.full(a, -9.0), np.full(a, 9.0),
        None, N, 5.0, rng.normal(size=(a, s)), cross_weight=0.1 * rng.normal(size=(s, a)),
    )  # fmt: skip
    state, reference, start = rng.normal(size=s), rng.normal(size=(N, s)), rng.normal(size=s)

    def cost(plan):
        z, off, total = state, state - start, 0.0
        for k, v in enumerate(plan):
            total += 2 * off @ problem.cross_weight @ v
            z = transition @ z + inputs @ v + problem.drift
            weight = problem.terminal_weight if k == N - 1 else problem.state_weight
            off = z - reference[k]
            total += off @ weight @ off + v @ problem.input_weight @ v
        return 0.5 * total

    first, second = rng.normal(size=(2, N, a))
    form = Sparse(problem)
    data = replace(steady_data(problem, reference), first_reference=start)
    program, values = form.program(state, data, np.zeros(a)), []
    for plan in (first, second):
        x = point_of_inputs(program, plan.T)
        values.append(0.5 * x @ (program.P @ x) + program.q @ x)
    expected = problem.cost_scale * (cost(first) - cost(second))
    assert values[0] - values[1] == pytest.approx(expected, rel=1e-9)


def test_unconstrained_first_input_is_that_of_the_discrete_lqr(plant):
    """With the LQR cost at the end, a horizon without active bounds is the infinite one."""
    Q, R = tc.energy_weights(plant)
    mpc = tc.MPC(
        plant, horizon=5, sample_time=0.02, max_force_density=300.0, Q=Q, R=R, tolerance=1e-9
    )
    regulator = tc.LQR(plant, Q, R, sample_time=0.02)
    nodes = pushed(plant, 0.001)
    assert np.allclose(
        mpc.command(0.0, nodes, STILL).value, regulator.command(0.0, nodes, STILL).value, atol=1e-5
    )


def test_pattern_of_the_program_is_fixed_and_setup_happens_once(plant, monkeypatch):
    import osqp

    setups = []
    original = osqp.OSQP.setup

    def counted(self, **data):
        setups.append(data["P"].nnz)
        return original(self, **data)

    monkeypatch.setattr(osqp.OSQP, "setup", counted)
    mpc = tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=60.0, solver="osqp")
    for k in range(10):
        assert mpc.command(0.02 * k, pushed(plant, seed=k), STILL).status == "ok"
    assert len(setups) == 1


def test_start_moved_on_by_a_sample_saves_iterations(plant):
    """The last solution, shifted, is a better start than the last solution as it was."""
    model = tc.Model(plant.model.structure, strings=tc.LinearStrings(100.0))
    work = {}
    for shifted in (True, False):
        mpc = tc.MPC(
            plant, horizon=20, sample_time=0.02, max_force_density=34.0, R=1e-3, solver="osqp"
        )
        if not shifted:
            solver = mpc._program.solver
            solve = solver.solve
            solver.solve = lambda q, l, u, solve=solve, **_: solve(q, l, u)  # noqa: E741
        tc.simulate(model, 1.0, pushed(plant, 0.05), controller=mpc, step=2e-3)
        work[shifted] = mpc.statistics.iterations.sum()
    assert work[True] < work[False]


@pytest.mark.parametrize("solver", ["auto", "osqp"])
def test_commands_are_within_bounds_exactly_and_changes_within_theirs(plant, solver):
    high = np.linspace(40, 60, 9)
    mpc = tc.MPC(
        plant,
        horizon=10,
        sample_time=0.02,
        max_force_density=high,
        solver=solver,
        max_change=4.0,
        tolerance=1e-3,
    )
    last = plant.force_density
    rng = np.random.default_rng(2)
    for k in range(50):
        shape = plant.to_nodes(0.1 * rng.normal(size=9))
        command = mpc.command(0.02 * k, shape, STILL)
        assert np.isfinite(command.value).all()
        assert (command.value >= 0.0).all()
        assert (command.value <= high).all()
        assert np.abs(command.value - last).max() <= 4.0 * (1 + 1e-12)
        last = command.value


def test_height_is_reached_on_the_nonlinear_prism():
    from tenscontrol.demo import tour as demo

    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(demo.STIFFNESS))
    rest = tc.prestress(prism, demo.TOP_FORCE_DENSITY)
    morph = demo.show_mpc(model, rest)
    assert abs(morph.height_error) < 1e-3
    assert abs(morph.height[0] - demo.TARGET) > 0.1
    assert morph.run.control.command.min() >= 0.0
    assert morph.run.force_density.min() >= 0.0
    assert morph.run.control.status_count == {"ok": 250}
    assert np.abs(morph.run.control.winch_rate).max() <= demo.WINCH_RATE * (1 + 1e-12)
    assert np.abs(morph.run.velocities[..., -1]).max() < 5e-3


def test_moving_reference_is_seen_ahead(plant):
    """The first command already reacts to a step that is still within the horizon."""
    shape = pushed(plant, 0.02)
    steps = np.stack([plant.nodes, plant.nodes, shape], axis=-1)
    near = tc.Reference([0.0, 0.1, 0.12], steps)
    far = tc.Reference([0.0, 1.0, 1.02], steps)
    quiet = tc.MPC(
        plant, horizon=20, sample_time=0.02, max_force_density=60.0, reference=far
    ).command(0.0, plant.nodes, STILL)
    early = tc.MPC(
        plant, horizon=20, sample_time=0.02, max_force_density=60.0, reference=near
    ).command(0.0, plant.nodes, STILL)
    assert np.abs(quiet.value - plant.force_density).max() < 1e-3
    assert np.abs(early.value - plant.force_density).max() > 0.1


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.OK])
def test_unsolved_programs_continue_the_last_plan_then_hold_equilibrium(plant, monkeypatch, status):
    mpc = tc.MPC(plant, horizon=4, sample_time=0.02, max_force_density=60.0)
    nodes = pushed(plant)
    mpc.command(0.0, nodes, STILL)
    plan = mpc.plan
    with monkeypatch.context() as patch:
        solve_nothing(patch, status)
        for k in range(1, 4):
            command = mpc.command(0.02 * k, nodes, STILL)
            assert str(command) == f"{status.value}: plan continued"
            assert np.allclose(command.value, plan[:, k])
        for k in range(4, 6):
            command = mpc.command(0.02 * k, nodes, STILL)
            assert str(command) == f"{status.value}: equilibrium held"
            assert np.array_equal(command.value, plant.force_density)
    assert mpc.command(0.12, nodes, STILL).status == "ok"  # recovers by itself
    assert mpc.statistics.fallbacks == 5
    assert mpc.statistics.status_count["ok"] == 2
    mpc.reset()
    assert mpc.statistics.status_count == {}


def test_measurement_that_is_not_finite_never_reaches_the_solver(plant):
    mpc = tc.MPC(plant, horizon=10, sample_time=0.02, max_force_density=60.0)
    broken = plant.nodes.copy()
    broken[1, 2] = np.nan
    command = mpc.command(0.0, broken, STILL)
    assert str(command) == "measurement not finite: equilibrium held"
    assert np.array_equal(command.value, plant.force_density)
    command = mpc.command(0.02, pushed(plant), STILL)
    assert command.status == "ok"
    fresh = tc.MPC(plant, horizon=10, sample_time=0.02, max_force_density=60.0).command(
        0.02, pushed(plant), STILL
    )
    assert np.allclose(command.value, fresh.value, atol=1e-3)


def test_out_of_iterations_is_a_fallback_and_not_a_bad_command(plant):
    mpc = tc.MPC(
        plant,
        horizon=20,
        sample_time=0.02,
        max_force_density=60.0,
        max_iterations=1,
        tolerance=1e-9,
    )
    command = mpc.command(0.0, pushed(plant, 0.2), STILL)
    assert str(command) == "out of iterations: equilibrium held"
    assert np.array_equal(command.value, plant.force_density)


def test_every_status_of_osqp_is_mapped():
    import osqp

    from tenscontrol.control.mpc.osqp_solver import _STATUS

    assert {status.name for status in osqp.SolverStatus} == set(_STATUS)
    assert [name for name, status in _STATUS.items() if status is Status.OK] == ["OSQP_SOLVED"]


def test_program_answers_infeasible_unbounded_and_bad_data_without_a_solution():
    from scipy.sparse import csc_array

    zero = csc_array(np.zeros((2, 2)))
    rows = csc_array(np.array([[1.0, 0.0], [1.0, 0.0]]))
    program = OSQPSolver(zero, rows, 1e-6, 4000)
    q, free = np.array([1.0, 1.0]), np.full(2, np.inf)
    unbounded = program.solve(q, -free, free)
    assert (unbounded.status, unbounded.x) == (Status.UNBOUNDED, None)
    infeasible = program.solve(0 * q, np.array([1.0, -np.inf]), np.array([np.inf, -1.0]))
    assert (infeasible.status, infeasible.x) == (Status.INFEASIBLE, None)
    crossed = program.solve(q, np.ones(2), -np.ones(2))
    assert (crossed.status, crossed.x) == (Status.INFEASIBLE, None)
    poisoned = program.solve(np.array([np.nan, 1.0]), -free, free)
    assert (poisoned.status, poisoned.x) == (Status.BAD_DATA, None)
    good = program.solve(0 * q, np.array([1.0, -np.inf]), np.array([2.0, np.inf]))
    assert good.status is Status.OK
    assert 1 - 1e-4 <= good.x[0] <= 2 + 1e-4


def test_the_core_solves_programs_where_it_is(plant, monkeypatch):
    core = not absence()
    usual = tc.MPC(plant, horizon=20, **GIVEN)
    assert usual.solver == ("stages" if core else "osqp")
    named = tc.MPC(plant, horizon=20, **GIVEN, solver="osqp")
    assert repr(named).endswith("sample time 0.02 s, osqp)")
    monkeypatch.setattr(settings, "library", lambda: None)
    monkeypatch.setattr(settings, "absence", lambda: "the package was installed without it")
    assert tc.MPC(plant, horizon=20, **GIVEN).solver == "osqp"
    with pytest.raises(
        ValueError, match=r"solver is 'stages', .* core, but the package was .*osqp"
    ):
        tc.MPC(plant, horizon=20, **GIVEN, solver="stages")


def test_a_program_is_for_any_solver_and_changes_nothing(plant):
    """Its solution has the plan of the next command, under a load and along a reference too."""
    given = {"horizon": 5, "max_force_density": 40.0, "max_change": 2.0, "load_gain": 0.5}
    mpc, same = (tc.MPC(plant, sample_time=0.02, **given) for _ in range(2))
    for k in range(3):
        moment = 0.02 * k, pushed(plant, 0.05, seed=k), STILL
        program = mpc.program(*moment)
        value = mpc.command(*moment).value
        np.testing.assert_array_equal(value, same.command(*moment).value)
        solver = OSQPSolver(program.P, program.A, 1e-10, 100_000)
        x = solver.solve(program.q, program.l, program.u).x
        exact = exact_optimum(program.P, program.q, program.A, program.l, program.u, x)
        np.testing.assert_allclose(program.inputs(exact)[:, 0], value, rtol=0, atol=17e-9)
    with pytest.raises(ValueError, match=r"x has shape \(3,\), expected"):
        program.inputs(np.zeros(3))
    with pytest.raises(ValueError, match="nodes"):
        mpc.program(0.0, np.full((3, 6), np.nan), STILL)


def test_an_operating_point_without_prestress_can_be_controlled():
    """All twelve lines between the ends of the bars as strings: in reach without any force.

    But the twist that changes no length of nine strings is pushed one way only by the others.
    """
    prism = tc.prism()
    bars = {frozenset(pair) for pair in prism.bars.tolist()}
    pairs = [[i, j] for i in range(6) for j in range(i) if frozenset((i, j)) not in bars]
    full = tc.Structure(prism.nodes, prism.bars, pairs, 1.0)
    plant = tc.linearize(tc.Model(full), tc.prestress(full, np.zeros(12)))
    with pytest.warns(tc.control.ControlWarning, match="drifts one way only"):
        mpc = tc.MPC(plant, horizon=5, sample_time=0.02, max_force_density=40.0)
    command = mpc.command(0.0, pushed(plant, 0.01), STILL)
    assert command.status == "ok"
    assert command.value.max() > 0


def test_data_too_large_for_the_solver_never_reach_it(plant, capfd):
    mpc = tc.MPC(plant, horizon=5, sample_time=0.02, max_force_density=60.0)
    command = mpc.command(0.0, plant.nodes * 1e100, STILL)
    assert str(command) == "measurement not plausible: equilibrium held"
    assert capfd.readouterr().out == ""


def test_the_plan_lies_within_the_bounds(plant):
    mpc = tc.MPC(
        plant, horizon=20, sample_time=0.02, max_force_density=40.0, tolerance=1e-2, R=1e-3
    )
    for seed in range(10):
        mpc.command(0.0, pushed(plant, 0.08, seed), STILL)
        assert mpc.plan.min() >= 0.0
        assert mpc.plan.max() <= 40.0


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_ctrl_c_after_the_last_iteration_is_not_lost(monkeypatch):
    from scipy.sparse import csc_array

    program = OSQPSolver(csc_array(np.eye(2)), csc_array(np.eye(2)), 1e-6, 4000)
    solver, vector = program._solver, np.ones(2)
    library, solve = ctypes.PyDLL(solver.ext.__file__), solver.solve
    if not hasattr(library, "osqp_start_interrupt_listener"):
        pytest.skip("the library of OSQP hides how it listens")

    def interrupted(**options):
        result = solve(**options)
        library.osqp_start_interrupt_listener()
        signal.raise_signal(signal.SIGINT)
        library.osqp_end_interrupt_listener()
        return result

    monkeypatch.setattr(solver, "solve", interrupted)
    with pytest.raises(KeyboardInterrupt):
        program.solve(vector, -vector, vector)
    monkeypatch.setattr(solver, "solve", solve)
    assert program.solve(vector, -vector, vector).status is Status.OK


def test_a_failed_solve_leaves_nothing_behind():
    """After data that cannot be solved, the answer is that of a fresh program."""
    from scipy.sparse import csc_array

    P, A = csc_array(np.diag([2.0, 1.0])), csc_array(np.array([[1.0, 1.0], [1.0, -1.0]]))
    used, fresh = (OSQPSolver(P, A, 1e-9, 4000) for _ in range(2))
    q, low, high = np.array([1.0, -1.0]), np.array([-1.0, -1.0]), np.array([0.2, 0.3])
    assert used.solve(q, np.array([1.0, 1.0]), np.array([np.inf, np.inf])).status is Status.OK
    short = OSQPSolver(P, A, 1e-15, 1)
    assert short.solve(q, low, high).status is Status.OUT_OF_ITERATIONS
    again, first = (program.solve(q, low, high) for program in (used, fresh))
    np.testing.assert_allclose(again.x, first.x, atol=1e-7)


def test_a_horizon_that_holds_nothing_is_said(plant):
    """Its loop without bounds, by the normal equations of all inputs together."""
    with pytest.warns(tc.control.ControlWarning, match="spectral radius of its loop is 1 a sample"):
        tc.MPC(plant, horizon=1, sample_time=0.02, terminal_weight=0.0)  # whose law does nothing
    tc.MPC(plant, horizon=2, sample_time=0.02, terminal_weight=0.0)
    (A, B, _), (Q, R) = plant.discretize(0.02), tc.plant.natural_weights(plant)
    N, P, (s, a) = 0.1 * np.sqrt(np.diag(Q)[:, None] * R) / 18, 2 * Q, B.shape
    powers = [np.linalg.matrix_power(A, k) for k in range(4)]
    H, F = np.zeros((3 * a, 3 * a)), np.zeros((3 * a, s))
    for k in range(4):  # z_k = by_u u + A^k z
        by_u = np.hstack([powers[k - 1 - j] @ B if j < k else 0 * B for j in range(3)])
        W = P if k == 3 else Q
        H += by_u.T @ W @ by_u
        F += by_u.T @ W @ powers[k]
        if k < 3:
            here = slice(k * a, k * a + a)
            H[here, here] += np.diag(R)
            H[here] += N.T @ by_u
            H[:, here] += by_u.T @ N
            F[here] += N.T @ powers[k]
    expected = np.abs(np.linalg.eigvals(A - B @ np.linalg.solve(H, F)[:a])).max()
    found = horizon_radius(plant, A, B, Q, R, P, 3, N)
    assert found == pytest.approx(expected, abs=1e-9)
