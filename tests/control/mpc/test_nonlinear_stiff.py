"""NMPC of stiff strings and of winches that wind: its programs, and closed loops."""

import pickle
from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control.mpc import real_time_iteration
from tenscontrol.demo import tour as demo
from tests.control.mpc.nmpc_oracle import IpoptNMPC, closed_loop_cost, optimality
from tests.control.mpc.test_constraints import height_row

SAMPLE = 0.02
STILL = np.zeros((3, 6))
EXACT = {"tolerance": 1e-6, "max_iterations": 50_000, "iterations": 6}


@cache
def plant_of(stiffness, height=1.0):
    prism = demo.prism_of_height(tc.prism(), height)
    law = tc.LinearStrings(stiffness, damping=0.02 * stiffness**0.5)
    rest = tc.prestress(prism, force_density=demo.TOP_FORCE_DENSITY)
    return tc.linearize(tc.Model(prism, strings=law), rest, input="rest_length")


def nodes_of(plant, state):
    return plant.to_nodes(state[:9]), plant.to_velocities(state[:9], state[9:])


def implicit(nmpc):
    return nmpc.law.model.implicit


@pytest.mark.parametrize(("stiffness", "pieces", "expected"), [
    (1e2, 1, False), (1e2, 20, True), (1e3, 1, True), (1e6, 1, True), (1e8, 20, True),
])  # fmt: skip
def test_steps_are_implicit_where_strings_are_stiff_or_winches_wind(stiffness, pieces, expected):
    winches = tc.Winches(rate=0.1, substeps=pieces)
    nmpc = tc.NMPC(plant_of(stiffness), horizon=2, sample_time=SAMPLE, winches=winches)
    assert implicit(nmpc) == expected
    assert nmpc.sampled.n_in() == (3 if pieces > 1 else 2)


def test_converged_plan_is_the_optimum_that_ipopt_finds():
    """Winches wind, stand elsewhere than planned, and the tail of the cost knows them."""
    stiffness = 1e5
    plant = plant_of(stiffness)
    winches = tc.Winches(shortest=0.5, longest=1.2, substeps=10)
    nmpc = tc.NMPC(plant, horizon=2, sample_time=SAMPLE, winches=winches, **EXACT)
    # Limits of γ are soft, and IPOPT's problem has none: none may matter.
    rng, size = np.random.default_rng(1), 1 / stiffness
    oracle = IpoptNMPC(nmpc, tolerance=1e-5, hessian="limited-memory")
    state = plant.measure(
        plant.nodes + size * rng.normal(size=(3, 6)), 0.02 * rng.normal(size=(3, 6))
    )
    nodes = nodes_of(plant, state)
    stands = plant.rest_length + size * rng.normal(size=9)
    for each in (nmpc, oracle):
        each.applied(stands)
        assert each.command(0.0, *nodes).status == "ok"
    moved = np.abs(nmpc.plan.T - plant.rest_length).max()
    assert np.abs(nmpc.plan.T - oracle.inputs).max() < 0.01 * moved


def test_program_satisfies_the_optimality_conditions():
    """With all kinds of rows; measured from the plan, about which it was linearized."""
    plant = plant_of(1e5)
    limit = tc.OutputLimit(height_row(), low=0.9999, high=1.0001, penalty=1e4)
    nmpc = tc.NMPC(
        plant,
        horizon=4,
        sample_time=SAMPLE,
        winches=tc.Winches(rate=2e-4, substeps=50),
        min_force_density=10.0,
        max_tension=33.0,
        outputs=[limit],
        tolerance=1e-6,
        max_iterations=50_000,
        solver="osqp",
    )
    stands = plant.rest_length - 2e-5
    nmpc.applied(stands)
    found, multipliers = optimality(nmpc, plant.nodes, STILL)
    assert found < 1e-5 * max(1.0, np.abs(multipliers).max())
    moves = np.abs(np.diff(np.vstack([stands, nmpc.plan.T]), axis=0))
    assert moves.max() == pytest.approx(2e-4 * SAMPLE, rel=1e-3)


def test_limits_hold_at_the_ends_of_samples():
    """γ of the plan by the law of the strings, on shapes that single steps lead to."""
    plant = plant_of(1e4)
    least = []
    for low in (0.0, 16.0):
        nmpc = tc.NMPC(
            plant,
            horizon=5,
            sample_time=SAMPLE,
            winches=tc.Winches(rate=0.1, substeps=20),
            min_force_density=low,
            **EXACT,
        )
        state = np.r_[np.zeros(9), plant.basis.T @ (0.1 * np.random.default_rng(4).normal(size=18))]
        nmpc.applied(plant.rest_length)
        assert nmpc.command(0.0, *nodes_of(plant, state)).status == "ok"
        before, found = plant.rest_length, []
        for held in nmpc.plan.T:
            state = nmpc.sampled(state, before, held).full().ravel()
            before = held
            shape = nodes_of(plant, state)[0]
            length = plant.model.structure.string_length(shape)
            found.append(1e4 * (1 - held / length))
        least.append(np.min(found))
    assert least[0] < 14.0
    assert least[1] > 16.0 - 0.25


def test_costs_are_those_of_explicit_steps_where_strings_are_soft(monkeypatch):
    """In a closed loop on the explicit prediction."""
    plant = plant_of(1e2)
    state = np.r_[plant.basis.T @ (0.01 * np.random.default_rng(0).normal(size=18)), np.zeros(9)]
    explicit = tc.NMPC(plant, horizon=10, sample_time=SAMPLE)
    monkeypatch.setattr(real_time_iteration, "_MOST_EXPLICIT", 0)
    other = tc.NMPC(plant, horizon=10, sample_time=SAMPLE)
    assert (implicit(explicit), implicit(other)) == (False, True)
    costs = [
        closed_loop_cost(explicit, each, explicit.sampled, state, 40)[0]
        for each in (explicit, other)
    ]
    assert costs[1] == pytest.approx(costs[0], rel=1e-3)


def smooth_way(first, last, duration):
    """Prisms of heights that start and end at rest, with the polynomial of least jerk."""
    s = np.linspace(0.0, 1.0, 51)
    heights = first + (last - first) * s**3 * (10 - 15 * s + 6 * s**2)
    shapes = [demo.prism_of_height(tc.prism(), height).nodes for height in heights]
    return tc.Reference(duration * s, np.stack(shapes, axis=-1))


@pytest.mark.parametrize(("stiffness", "pieces", "gain"), [
    (1e4, 20, 0.5), (1e6, 100, None),
])  # fmt: skip
def test_stiff_prism_is_moved_by_winches_that_wind(stiffness, pieces, gain):
    """From 1.0 m to 0.95 m, on the nonlinear model in fine steps; with a gain, an unknown load."""
    prism, middle = tc.prism(), plant_of(stiffness, 0.95)
    pull = np.zeros((3, 6))
    pull[2, :3], pull[2, 3:] = (0.0, 0.0) if gain is None else (0.2, -0.2)
    model = tc.Model(prism, strings=middle.model.strings, external_force=pull)
    winches = tc.Winches(rate=0.3, substeps=pieces)
    estimate = {} if gain is None else {"load_gain": gain, "tracked": height_row()}
    nmpc = tc.NMPC(
        middle, horizon=6, sample_time=SAMPLE, reference=smooth_way(1.0, 0.95, 0.5),
        winches=winches, min_force_density=5.0, max_tension=45.0, **estimate,
    )  # fmt: skip
    run = tc.simulate(
        model, 0.9, prism.nodes, controller=nmpc, winches=winches,
        rest_length=nmpc.targets(-SAMPLE)[1][0],  # what holds the start
        step=0.4 / (12 * stiffness) ** 0.5, output_step=SAMPLE,
    )  # fmt: skip
    assert run.control.status_count == {"ok": 45}
    assert np.abs(demo.height_of(run.nodes[:, :, run.time > 0.8]) - 0.95).max() < 1e-4
    start, end = (run.nodes[:, prism.strings[:, i]] for i in range(2))
    assert (run.force_density * np.linalg.norm(end - start, axis=0)).max() < 1.05 * 45.0
    if stiffness < 1e5:
        assert run.force_density.min() > 5.0


def softest(plant):
    """The direction in which strings resist least, by its largest entry."""
    stiffness = -plant.A[9:, :9]
    direction = np.linalg.eigh(0.5 * (stiffness + stiffness.T))[1][:, 0]
    return direction / np.abs(direction).max()


def test_a_stiff_prism_recovers_where_no_string_resists():
    """A thousand times as far off as strings of 1e6 N/m are stretched; on the prediction itself."""
    plant = plant_of(1e6)
    z = np.r_[0.015 * softest(plant), np.zeros(9)]
    nmpc = tc.NMPC(
        plant,
        horizon=6,
        sample_time=SAMPLE,
        winches=tc.Winches(rate=0.3, substeps=100),
        min_force_density=2.0,
    )
    # Wound so that the strings are as tense as at rest.
    stands = plant.model.structure.string_length(nodes_of(plant, z)[0]) * (1 - 17e-6)
    for k in range(40):
        nmpc.applied(stands)
        command = nmpc.command(k * SAMPLE, *nodes_of(plant, z))
        assert command.status == "ok"
        z, _ = nmpc.law.model.discretization.advance(z, stands, command.value)
        stands = command.value
    assert np.abs(z[:9]).max() < 0.05 * 0.015


def test_a_plan_begins_along_the_reference_where_the_law_leads_astray(monkeypatch):
    """Where single steps have no value; six programs lead both beginnings near to one plan."""
    plant, plans, winches = plant_of(1e6), [], tc.Winches(rate=0.3, substeps=100)
    z = np.r_[0.002 * softest(plant), np.zeros(9)]
    for astray in (False, True):
        nmpc = tc.NMPC(plant, horizon=4, sample_time=SAMPLE, winches=winches, **EXACT)
        nmpc.applied(plant.rest_length)
        if astray:
            none = np.full(18, np.nan), np.full((3, 9), np.nan)
            monkeypatch.setattr(
                nmpc.law.model.discretization, "advance", lambda *_, none=none, **__: none
            )
        assert nmpc.command(0.0, *nodes_of(plant, z)).status == "ok"
        plans.append(nmpc.plan.T - plant.rest_length)
    assert np.abs(plans[1] - plans[0]).max() < 0.2 * np.abs(plans[0]).max()


# ---- derivatives that are kept ----


@cache
def ball():
    structure = tc.library.six_bar_ball()
    model = tc.Model(structure, tc.LinearStrings(1e3))
    return tc.linearize(model, tc.prestress(structure, 20.0), input="rest_length")


def pushed(nmpc, count=8):
    """Closed-loop cost from a push, with a smaller one in each sample, and samples found anew."""
    plant, rng, cost = nmpc.plant, np.random.default_rng(0), 0.0
    r, (Q, R, _) = plant.degrees_of_freedom, nmpc.weights
    z = plant.measure(plant.nodes, 0.3 * rng.normal(size=plant.nodes.shape))
    for k in range(count):
        command = nmpc.command(k * SAMPLE, plant.to_nodes(z[:r]), plant.to_velocities(z[:r], z[r:]))
        assert command.status == "ok"
        z, _ = nmpc.law.model.discretization.advance(z, command.value, command.value)
        off = command.value - plant.equilibrium_input
        cost += z @ Q @ z + off @ R @ off
        z[r:] += 0.01 * rng.normal(size=r)
    return cost, nmpc.statistics.linearized


UNREACHED = pytest.mark.filterwarnings("ignore:no string reaches:RuntimeWarning")


@UNREACHED
@pytest.mark.parametrize("solver", ["auto", "osqp"])
def test_most_samples_of_a_plan_keep_their_derivatives(solver):
    given = {"horizon": 8, "sample_time": SAMPLE, "winches": tc.Winches(rate=1.0), "solver": solver}
    quick = tc.NMPC(ball(), **given)
    cost, linearized = pushed(quick)
    exact, every = pushed(tc.NMPC(ball(), linearization_tolerance=0.0, **given))
    assert cost == pytest.approx(exact, rel=1e-3)
    assert np.all(every == 8)
    assert 4 <= linearized[0] < 8  # the last ones take those of others
    assert linearized[1:].min() == 0
    assert linearized.mean() < 3
    # A copy knows nothing of what was kept in compiled memory, and goes on as its original.
    other = pickle.loads(pickle.dumps(quick))
    nodes, still = ball().nodes, np.zeros_like(ball().nodes)
    commands = [each.command(1.0, nodes, still).value for each in (quick, other)]
    np.testing.assert_allclose(*commands, rtol=0, atol=1e-4)
    assert other.statistics.linearized[-1] > quick.statistics.linearized[-1]


@UNREACHED
def test_programs_of_a_sample_converge_with_derivatives_found_anew():
    nmpc = tc.NMPC(ball(), horizon=3, sample_time=SAMPLE, iterations=3)
    assert nmpc.command(0.0, ball().nodes + 1e-3, np.zeros((3, 12))).status == "ok"
    assert nmpc.statistics.linearized[0] == 3 * nmpc.statistics.programs[0]


@UNREACHED
def test_slots_are_near_their_samples_and_filled_once():
    """A plan wanders: slots that samples have are those of places within the tolerance."""
    nmpc = tc.NMPC(ball(), horizon=8, sample_time=SAMPLE)
    nodes, still = ball().nodes, np.zeros_like(ball().nodes)
    assert nmpc.command(0.0, nodes, still).status == "ok"
    plan, rng, counts = nmpc._plan, np.random.default_rng(7), []
    assert plan._tolerance > 0
    inputs = plan._planned()
    known = plan._at.copy()
    for step in range(40):
        if step % 3 == 0:  # the plan moves on
            plan._slots = np.append(plan._slots[1:], plan._slots[-1])
        r, moved = ball().degrees_of_freedom, rng.choice([0.2, 1.0, 3.0])
        plan._states[:-1, :r] += moved * plan._tolerance * plan._reach[0] * rng.normal(size=(8, r))
        fresh = plan._choose_slots(inputs)
        parts = np.hstack([plan._states[:-1], inputs[1:]]) / plan._reach
        off = np.abs(parts - plan._at[plan._slots]).max(axis=1)
        assert off.max() <= plan._tolerance
        assert off[fresh].max(initial=0.0) == 0.0
        # A slot that was not filled is where it was; one that was, by one sample alone.
        filled = plan._slots[fresh]
        assert len(np.unique(filled)) == len(filled)
        same = np.setdiff1d(np.arange(8), filled)
        np.testing.assert_array_equal(plan._at[same], known[same])
        known = plan._at.copy()
        counts.append(int(fresh.sum()))
    assert min(counts) == 0
    assert max(counts) == 8
