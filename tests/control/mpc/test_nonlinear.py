"""NMPC by real-time iterations: its model, its programs, and the optimum as IPOPT finds it."""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import NMPC, Status
from tenscontrol.control.mpc.osqp_solver import OSQPSolver
from tenscontrol.control.mpc.problem import SubproblemSolution
from tenscontrol.demo import tour as demo
from tenscontrol.dynamics.machine_code import compiler
from tenscontrol.plant.reduced_dynamics import explicit_substeps, sampled_dynamics
from tests.control.mpc.nmpc_oracle import IpoptNMPC, closed_loop_cost
from tests.control.mpc.test_linear import kkt_residual
from tests.marks import needs_core
from tests.without_core import without_core

SAMPLE = 0.02
STILL = np.zeros((3, 6))


@cache
def at_rest(held="force_density", stiffness=100.0):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness))
    return tc.linearize(model, tc.prestress(prism, demo.TOP_FORCE_DENSITY), input=held)


def disturbed(size, seed):
    rng = np.random.default_rng(seed)
    return np.r_[size * rng.normal(size=9), 5 * size * rng.normal(size=9)]


@pytest.mark.parametrize(("held", "stiffness"), [
    ("force_density", 100.0), ("rest_length", 100.0), ("rest_length", 1e4),
])  # fmt: skip
def test_prediction_is_the_motion_of_the_model(held, stiffness):
    """18 reduced states against the 36 of the model; large motion, where linear is off by far."""
    plant = at_rest(held, stiffness)
    motion, _ = sampled_dynamics(plant, SAMPLE)
    transition, inputs, _ = plant.discretize(SAMPLE)
    rng = np.random.default_rng(0)
    z = disturbed(0.03 * np.sqrt(100 / stiffness), 1)
    v = plant.equilibrium_input * 2 / stiffness * rng.normal(size=9)
    u = plant.equilibrium_input + v
    nodes, velocities = plant.to_nodes(z[:9]), plant.to_velocities(z[:9], z[9:])
    run = tc.simulate(plant.model, SAMPLE, nodes, velocities, step=1e-4, **{held: u})
    found = plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
    moved = np.linalg.norm(found - z)
    error = np.linalg.norm(np.array(motion(z, u)).ravel() - found) / moved
    linear = np.linalg.norm(transition @ z + inputs @ v - found) / moved
    assert error < 2e-3
    assert linear > 5 * error


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_derivatives_are_those_of_the_prediction(held):
    plant = at_rest(held)
    motion, linearized = sampled_dynamics(plant, SAMPLE)
    z, u = disturbed(0.02, 2), plant.equilibrium_input
    _, by_z, by_u = (np.array(part) for part in linearized(z, u))
    rng = np.random.default_rng(3)
    dz, du = 1e-5 * rng.normal(size=18), 1e-5 * rng.normal(size=9)
    there, back = (np.array(motion(z + s * dz, u + s * du)).ravel() for s in (1, -1))
    assert np.allclose(0.5 * (there - back), by_z @ dz + by_u @ du, rtol=1e-4, atol=1e-11)


def test_bars_keep_their_lengths_in_the_prediction():
    """The reduced states have none to lose: an invariant of the coordinates, not of the step."""
    plant = at_rest()
    motion, _ = sampled_dynamics(plant, SAMPLE)
    z = disturbed(0.03, 4)
    for _ in range(50):
        z = np.array(motion(z, plant.equilibrium_input)).ravel()
    structure = plant.model.structure
    vectors = structure.bar_vectors(plant.to_nodes(z[:9]))
    rates = structure.bar_vectors(plant.to_velocities(z[:9], z[9:]))
    assert np.allclose(np.linalg.norm(vectors, axis=0), structure.bar_length, atol=1e-14)
    assert np.abs((vectors * rates).sum(axis=0)).max() < 1e-13


def test_program_satisfies_the_optimality_conditions():
    plant = at_rest()
    nmpc = NMPC(
        plant,
        horizon=8,
        sample_time=SAMPLE,
        max_force_density=45.0,
        max_change=8.0,
        tolerance=1e-8,
        max_iterations=20000,
        solver="osqp",
    )
    kept = {}
    program = nmpc._plan.program.solver
    solve, update = program.solve, program.update

    def watched(q, l, u, start=None, **_):  # noqa: E741
        kept["vectors"], kept["answer"] = (q, l, u), solve(q, l, u, start)
        return kept["answer"]

    def noted(values):
        kept["values"] = values.copy()
        update(values)

    program.solve, program.update = watched, noted
    z = disturbed(0.05, 0)
    nodes, velocities = plant.to_nodes(z[:9]), plant.to_velocities(z[:9], z[9:])
    value = nmpc.command(0.0, nodes, velocities).value
    form = nmpc._plan.program.form
    pattern = form.A.copy()
    pattern.data = kept["values"]
    answer, (q, l, u) = kept["answer"], kept["vectors"]  # noqa: E741
    residual = kkt_residual(form.P, q, pattern, l, u, answer.x, answer.y)
    assert residual < 1e-6 * max(1.0, np.abs(answer.y).max())
    assert np.abs(value - plant.force_density).max() <= 8.0 * (1 + 1e-12)
    # The equations of the program are the linearization: at the plan itself they hold exactly.
    count = len(form.units) * 8
    assert np.abs((pattern @ answer.x - l)[:count]).max() < 1e-6


@cache
def beside_ipopt(ipopt_tolerance, **options):
    """An NMPC whose bounds matter, and IPOPT on its problem."""
    nmpc = NMPC(at_rest(), horizon=20, sample_time=SAMPLE, max_force_density=33.0, **options)
    return nmpc, IpoptNMPC(nmpc, ipopt_tolerance)


@pytest.mark.parametrize("seed", range(2))
def test_converged_plan_is_the_optimum_that_ipopt_finds(seed):
    plant = at_rest()
    nmpc, oracle = beside_ipopt(1e-8, iterations=20, tolerance=1e-8, max_iterations=20000)
    z = disturbed(0.05, seed)
    nodes, velocities = plant.to_nodes(z[:9]), plant.to_velocities(z[:9], z[9:])
    for each in (nmpc, oracle):
        each.reset()
        assert each.command(0.0, nodes, velocities).status == "ok"
    assert nmpc.statistics.last_change[0] < 1e-5
    assert nmpc.plan.max() > 33.0 - 1e-3  # bounds matter
    # Gauss-Newton reaches the same stationary point.
    assert np.allclose(nmpc.plan.T, oracle.inputs, atol=0.02)


def test_real_time_iterations_cost_within_a_percent_of_ipopt():
    z = disturbed(0.05, 0)
    # At 1e-5 costs are those of 1e-8 to five digits, after a third of the iterations.
    nmpc, oracle = beside_ipopt(1e-5)
    costs = [closed_loop_cost(nmpc, each, nmpc.sampled, z, 12)[0] for each in (nmpc, oracle)]
    assert costs[0] == pytest.approx(costs[1], rel=0.01)
    assert (nmpc.statistics.programs == 1).all()


@pytest.mark.parametrize(("held", "stiffness"), [("force_density", 100.0), ("rest_length", 1e3)])
def test_new_height_is_reached_on_the_nonlinear_prism(held, stiffness):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness))
    target = demo.prism_of_height(prism, demo.TARGET)
    plant = tc.linearize(model, tc.prestress(target, demo.TOP_FORCE_DENSITY), input=held)
    limit = 80.0 if held == "force_density" else None
    winches = tc.Winches(rate=0.5, shortest=0.1) if held == "rest_length" else None
    reference = demo.ramp(prism, 1.0, demo.TARGET, 1.0)
    nmpc = NMPC(
        plant,
        horizon=10,
        sample_time=SAMPLE,
        max_force_density=limit,
        winches=winches,
        reference=reference,
    )
    run = tc.simulate(model, 2.0, prism.nodes, controller=nmpc, input=held, step=2e-3 / 2)
    height = demo.height_of(run.nodes[:, :, run.time > 1.8])
    assert np.abs(height - demo.TARGET).max() < 2e-3
    assert nmpc.statistics.status_count == {"ok": 100}


def test_preparation_is_apart_from_feedback_and_setup_happens_once(monkeypatch):
    import osqp

    setups, original = [], osqp.OSQP.setup
    monkeypatch.setattr(
        osqp.OSQP, "setup", lambda self, **data: (setups.append(1), original(self, **data))[1]
    )
    plant = at_rest()
    nmpc, plain = (
        NMPC(plant, horizon=6, sample_time=SAMPLE, max_force_density=60.0, solver="osqp")
        for _ in range(2)
    )
    model, calls = nmpc.law.model, []
    linearize = model.linearize
    monkeypatch.setattr(model, "linearize", lambda *given: (calls.append(1), linearize(*given))[1])
    setups_before = len(setups)
    nmpc.prepare()  # nothing to prepare from
    for k in range(4):
        nodes = plant.to_nodes(disturbed(0.02, k)[:9])
        calls.clear()
        first = nmpc.command(SAMPLE * k, nodes, STILL)
        assert len(calls) == (k == 0)  # prepared before, but the first time
        nmpc.prepare()
        nmpc.prepare()
        assert len(calls) == 1 + (k == 0)
        assert np.array_equal(first.value, plain.command(SAMPLE * k, nodes, STILL).value)
    assert len(setups) == setups_before


def test_unsolved_programs_continue_the_plan(monkeypatch):
    plant = at_rest()
    nmpc = NMPC(plant, horizon=4, sample_time=SAMPLE, max_force_density=60.0)
    nodes = plant.to_nodes(disturbed(0.03, 0)[:9])
    nmpc.command(0.0, nodes, STILL)
    plan = nmpc.plan
    with monkeypatch.context() as patch:
        unsolved = SubproblemSolution(Status.INFEASIBLE, 7, None)
        patch.setattr(nmpc._plan.program, "solve", lambda *_: unsolved)
        for k in range(1, 7):
            command = nmpc.command(SAMPLE * k, nodes, STILL)
            if k < 4:
                assert str(command) == "infeasible: plan continued"
                assert np.allclose(command.value, plan[:, k])
            else:
                # Begun anew from the law of the linear plant, but not solved: not for use.
                assert str(command) == "infeasible: equilibrium held"
                assert np.array_equal(command.value, plant.force_density)
    broken = np.full((3, 6), np.nan)
    assert str(nmpc.command(0.14, broken, STILL)) == "measurement not finite: equilibrium held"
    assert nmpc.command(0.16, nodes, STILL).status == "ok"
    assert str(nmpc.command(0.18, broken, STILL)) == "measurement not finite: plan continued"
    nmpc.reset()
    assert nmpc.statistics.status_count == {}
    first = nmpc.command(0.0, broken, STILL)
    assert str(first) == "measurement not finite: equilibrium held"
    assert np.array_equal(first.value, plant.force_density)


@pytest.mark.parametrize(("arguments", "error", "message"), [
    ({"iterations": 0}, ValueError, "iterations"),
    ({"linearization_tolerance": -0.1}, ValueError, "linearization_tolerance is -0.1, expected"),
    ({"linearization_tolerance": "all"}, TypeError, "linearization_tolerance"),
    ({"winches": 3.0}, TypeError, "winches"),
    ({"winches": tc.Winches(rate=1.0)}, ValueError, "input='rest_length'"),
])  # fmt: skip
def test_arguments_that_do_not_fit_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        NMPC(at_rest(), horizon=4, sample_time=SAMPLE, max_force_density=60.0, **arguments)


def test_force_densities_need_no_limit_but_zero():
    plant = tc.linearize(tc.Model(tc.prism()), tc.prestress(tc.prism(), force_density=17.3205))
    nodes, still = plant.to_nodes(np.full(9, 0.01)), np.zeros((3, 6))
    for kind in (tc.MPC, tc.NMPC):
        values = [
            kind(plant, horizon=5, sample_time=0.02, max_force_density=most)
            .command(0.0, nodes, still)
            .value
            for most in (None, np.inf, 1e6)
        ]
        assert (values[0] >= 0).all()
        np.testing.assert_array_equal(values[0], values[1])
        np.testing.assert_allclose(values[0], values[2], atol=1e-6)


def test_horizon_of_one_sample():
    plant = at_rest()
    nmpc = NMPC(plant, horizon=1, sample_time=SAMPLE, max_force_density=60.0)
    oracle = IpoptNMPC(nmpc)
    z = disturbed(0.02, 0)
    motion = plant.to_nodes(z[:9]), plant.to_velocities(z[:9], z[9:])
    values = [each.command(0.0, *motion).value for each in (nmpc, oracle)]
    assert np.allclose(*values, atol=0.02)


@needs_core
@pytest.mark.parametrize(("held", "stiffness"), [("force_density", 100.0), ("rest_length", 1e4)])
def test_the_core_and_machine_code_give_the_same_commands(held, stiffness):
    """By explicit and by implicit steps; the second with limits of strings."""
    plant = at_rest(held, stiffness)
    limits = {"winches": tc.Winches(rate=0.3)} if held == "rest_length" else {"R": 1e-3}
    size = 0.03 * 100 / stiffness

    def nmpc(code=False):
        return NMPC(
            plant, horizon=3, sample_time=SAMPLE, max_force_density=60.0, machine_code=code,
            **limits,
        )  # fmt: skip

    ways = [nmpc()]
    with without_core():
        ways += [nmpc(), nmpc(code=True)]
    compiled = "virtual machine" if compiler() is None else "machine code"
    assert [way.back_end for way in ways] == ["core", "virtual machine", compiled]
    for k in range(3):
        nodes = plant.to_nodes(disturbed(size, k)[:9])
        first, *others = (way.command(SAMPLE * k, nodes, STILL).value for way in ways)
        for other in others:
            np.testing.assert_allclose(other, first, rtol=0, atol=1e-11 * np.abs(first).max())


def test_equations_are_not_over_relaxed(monkeypatch):
    """Fewer iterations, and the same answers, than with the relaxation that OSQP starts from."""
    from tenscontrol.control.mpc import settings

    plant, work, values = at_rest(), [], []
    for equations in (True, False):

        def relaxed(P, A, tolerance, most, equations, as_wanted=equations):
            return OSQPSolver(P, A, tolerance, most, equations=as_wanted)

        with monkeypatch.context() as patch:
            patch.setattr(settings, "OSQPSolver", relaxed)
            nmpc = NMPC(
                plant, horizon=10, sample_time=SAMPLE, max_force_density=33.0, solver="osqp"
            )
        cost, _ = closed_loop_cost(nmpc, nmpc, nmpc.sampled, disturbed(0.05, 0), 10)
        work.append(nmpc.statistics.iterations.sum())
        values.append(cost)
    assert work[0] < 0.7 * work[1]
    assert values[0] == pytest.approx(values[1], rel=2e-3)


@pytest.mark.parametrize(
    ("stiffness", "steps"), [(1e2, 2), (1e3, 7), (1e4, 21), (1e5, 67), (1e6, 209)]
)
def test_steps_of_the_prediction_follow_the_fastest_vibration(stiffness, steps):
    """Stable at every stiffness, for as many steps as the root of it asks for."""
    plant = at_rest("rest_length", stiffness)
    count = explicit_substeps(plant, SAMPLE)
    assert count == steps
    fastest = np.abs(np.linalg.eigvals(plant.A)).max()
    assert 0.3 <= SAMPLE * fastest / count <= 0.35
    # So little motion that the linear plant, which is sampled exactly, is right. Displacements
    # count as the speeds that they turn into.
    motion, _ = sampled_dynamics(plant, SAMPLE)
    transition = plant.discretize(SAMPLE)[0]
    start = disturbed(1e-5 * 100 / stiffness, 1)
    scale = np.r_[np.full(9, fastest), np.ones(9)]
    size = np.linalg.norm(scale * start)
    z = np.array(motion(start, plant.equilibrium_input)).ravel()
    assert np.linalg.norm(scale * (z - transition @ start)) < 0.02 * size
    for _ in range(20):
        z = np.array(motion(z, plant.equilibrium_input)).ravel()
    assert np.linalg.norm(scale * z) < 2 * size


def test_vibrations_too_fast_for_explicit_steps_are_refused():
    with pytest.raises(ValueError, match=r"rad/s: a sample of 0.02 s takes \d+ steps of RK4"):
        sampled_dynamics(at_rest("rest_length", 1e8), SAMPLE)


def test_reference_seen_ahead_is_followed_more_closely():
    prism = tc.prism()
    target = demo.prism_of_height(prism, demo.TARGET)
    plant = tc.linearize(tc.Model(prism), tc.prestress(target, demo.TOP_FORCE_DENSITY))
    ramp = demo.ramp(prism, 1.0, demo.TARGET, 0.6)
    ahead, blind = (
        NMPC(plant, horizon=10, sample_time=SAMPLE, max_force_density=80.0) for _ in range(2)
    )
    ahead.follow(ramp)
    start = plant.measure(prism.nodes, STILL)
    path = ahead.law.path.wanted(SAMPLE * np.arange(40.0))
    errors = []
    for nmpc in (ahead, blind):
        state, off = start, 0.0
        for k in range(40):
            if nmpc is blind:
                blind.follow(plant.to_nodes(path[k, :9]))
            nodes = plant.to_nodes(state[:9])
            command = nmpc.command(SAMPLE * k, nodes, plant.to_velocities(state[:9], state[9:]))
            assert command.status == "ok"
            off += np.sum((state[:9] - path[k, :9]) ** 2)
            state = np.array(nmpc.sampled(state, command.value)).ravel()
        errors.append(np.sqrt(off / 40))
    assert errors[0] < 0.7 * errors[1]


def test_own_weights_are_those_of_linear_mpc_near_the_operating_point():
    """About a reference off the operating point, so that r_0 counts; and not under a load."""
    plant = at_rest()
    Q, R = tc.plant.natural_weights(plant)
    N = np.random.default_rng(0).normal(size=plant.B.shape) * np.sqrt(np.diag(Q)[:, None] * R) / 40
    aside = plant.to_nodes(2e-6 * np.ones(9))
    given = {"horizon": 4, "sample_time": SAMPLE, "reference": aside, "N": N}
    commands = [
        kind(plant, terminal_weight=2 * Q, **given).command(0.0, plant.nodes, STILL).value
        for kind in (tc.MPC, NMPC)
    ]
    moves = [value - plant.equilibrium_input for value in commands]
    np.testing.assert_allclose(*moves, rtol=0, atol=1e-4 * np.abs(moves[0]).max())
    with pytest.raises(ValueError, match="N and load_gain are both given: NMPC has no"):
        NMPC(plant, load_gain=0.5, **given)
