"""Controllers under faults: every command is one that the actuators can follow, and all recover."""

from collections import Counter
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Status
from tenscontrol.control.mpc.osqp_solver import OSQPSolver
from tests.control.fault_loop import (
    CHANGE,
    CONTROLLERS,
    FAULTS,
    GAMMA,
    HIGH,
    HORIZON,
    RANGE,
    RATE,
    SOLVER,
    STEP,
    STILL,
    FaultLoop,
    absurd,
    broken,
    controller,
    plant,
    solve_nothing,
)
from tests.known_structures import height_row

# Samples after the end of a fault by which a status is good again.
RECOVERED = 0

# How often faults are injected: 500 in all.
INJECTIONS = {"lqr": 75, "mpc": 145, "nmpc": 30}

# Largest reduced coordinate, m, when the loop has had 2 s without a fault.
SETTLED = {"lqr": 0.02, "mpc": 0.01, "nmpc": 0.01}

both_inputs = pytest.mark.parametrize("held", ["force_density", "rest_length"])
every_controller = pytest.mark.parametrize(("kind", "held"), CONTROLLERS)


def pushed(held, size=0.01, seed=0):
    """The prism pushed out of its shape."""
    return plant(held).to_nodes(size * np.random.default_rng(seed).normal(size=9))


def safe(held, status):
    """What a controller holds that has no plan."""
    return f"{status}: " + {"force_density": "equilibrium", "rest_length": "previous input"}[held]


# ---- injections by the hundred ----


@every_controller
def test_every_command_is_safe_and_controllers_recover(kind, held, monkeypatch):
    """Commands are checked in the loop: finite, within bounds, within reach of what stands."""
    rng = np.random.default_rng([7, CONTROLLERS.index((kind, held))])
    loop = FaultLoop(kind, held, controller(kind, held), rng)
    came = Counter()
    for _ in range(INJECTIONS[kind]):
        fault = str(rng.choice([f for f in FAULTS if kind != "lqr" or f not in SOLVER]))
        # A prism without one of its strings is a mechanism: soon there is no shape to return to.
        samples = int(rng.integers(1, 3 if fault == "cut" else 4))
        statuses = loop.inject(fault, samples, monkeypatch)
        if fault in SOLVER:
            assert all(status.startswith(f"{fault}: ") for status in statuses)
        if fault in ("not finite", "absurd"):
            word = "finite" if fault == "not finite" else "plausible"
            assert all(status.startswith(f"measurement not {word}: ") for status in statuses)
        loop.recover(RECOVERED)
        loop.sample()
        came[fault] += 1
    assert len(came) == (4 if kind == "lqr" else len(FAULTS))
    if kind != "lqr":
        parts = [text.split(": ") for text in loop.statuses]
        assert Counter(part[0] for part in parts) == loop.made.statistics.status_count
        assert Counter(part[1] for part in parts if len(part) > 1) == (
            loop.made.statistics.fallback_count
        )
    for _ in range(100):
        loop.sample()
    assert np.abs(loop.state[:9]).max() < SETTLED[kind]


# ---- measurements ----


@every_controller
def test_measurements_that_cannot_be_are_refused(kind, held):
    """Twenty of each, drawn by chance; the first command after them is good."""
    rng = np.random.default_rng(3)
    made = controller(kind, held)
    made.applied(plant(held).equilibrium_input)
    good = pushed(held)
    for k in range(40):
        spoil, word = ((broken, "finite"), (absurd, "plausible"))[k % 2]
        command = made.command(STEP * k, *spoil(rng, good, STILL))
        assert str(command) == safe(held, f"measurement not {word}") + " held"
        np.testing.assert_allclose(command.value, plant(held).equilibrium_input, rtol=1e-12)
    fresh = controller(kind, held).command(0.8, good, STILL)
    again = made.command(0.8, good, STILL)
    assert again.status == fresh.status
    np.testing.assert_allclose(again.value, fresh.value, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("stretched", "refused"), [(1.09, False), (0.91, False), (1.11, True), (0.89, True)]
)
def test_bars_may_seem_a_tenth_off(stretched, refused):
    """The threshold as it is documented."""
    at = plant("force_density")
    regulator = tc.LQR(at, *tc.energy_weights(at), sample_time=STEP)
    nodes = at.nodes.copy()
    i, j = at.model.structure.bars[0]
    nodes[:, j] = nodes[:, i] + stretched * (nodes[:, j] - nodes[:, i])
    found = regulator.command(0.0, nodes, STILL).status
    assert ("plausible" in found) == refused


def test_far_fast_and_moved_supports_are_refused_and_travel_is_not():
    at = plant("force_density")
    regulator = tc.LQR(at, *tc.energy_weights(at), sample_time=STEP)
    size = np.ptp(at.nodes, axis=1).max()
    fast = np.zeros((3, 6))
    fast[0, 0] = 10 * size / STEP
    for nodes, velocities, refused in (
        (at.nodes + 0.9e6 * size, STILL, False),
        (at.nodes + 1.1e6 * size, STILL, True),
        (at.nodes, 0.9 * fast, False),
        (at.nodes, 1.1 * fast, True),
        (at.nodes, np.full((3, 6), 1e4), False),  # all nodes together: it travels
    ):
        assert ("plausible" in regulator.command(0.0, nodes, velocities).status) == refused
    prism = tc.prism()
    held = tc.Structure(prism.nodes, prism.bars, prism.strings, 1.0, fixed=[0])
    gamma = tc.prestress(prism, 17.3205).force_density
    fixed = tc.linearize(tc.Model(held), tc.prestress(held, gamma))
    regulator = tc.LQR(fixed, *tc.energy_weights(fixed), sample_time=STEP)
    assert regulator.command(0.0, prism.nodes, STILL).status == "ok"
    away = regulator.command(0.0, prism.nodes + 0.2 * size, STILL).status
    assert away.startswith("measurement not plausible")


# ---- what stands ----


@every_controller
def test_changes_count_from_what_the_actuators_hold(kind, held):
    """The controller would go to the other end of its range: it goes a change a sample."""
    made = controller(kind, held)
    low, high = made.bounds
    for stands in (low + 0.1 * (high - low), low + 0.9 * (high - low)):
        made.applied(stands)
        value = made.command(0.0, pushed(held), STILL).value
        reach = CHANGE[held] * (1 + 1e-12)
        assert np.abs(value - stands).max() <= reach
        assert np.abs(value - stands).max() > 0.5 * reach


@every_controller
def test_reset_forgets_what_stands(kind, held):
    made, fresh = controller(kind, held), controller(kind, held)
    made.applied(made.bounds[1])
    made.command(0.0, pushed(held), STILL)
    made.reset()
    again, first = (m.command(0.0, pushed(held), STILL).value for m in (made, fresh))
    # The solver may start from elsewhere: the same up to its tolerance, in units of an input.
    unit = GAMMA if held == "force_density" else 0.3
    np.testing.assert_allclose(again, first, rtol=0, atol=1e-3 * unit)


@every_controller
def test_where_actuators_stand_out_of_bounds_bounds_come_first(kind, held):
    made = controller(kind, held)
    high = made.bounds[1]
    made.applied(high + 1.0)
    command = made.command(0.0, pushed(held), STILL)
    assert command.status in ("ok", "saturated")
    assert (command.value <= high).all()
    assert (command.value >= high - CHANGE[held] * (1 + 1e-12)).all()


@both_inputs
def test_the_load_observer_takes_what_was_applied(held):
    """A winch that did not move is no load; on the linear plant the estimate stays zero."""
    at = plant(held)
    limits = {} if held == "rest_length" else {"max_force_density": HIGH}
    mpc = tc.MPC(at, horizon=8, sample_time=STEP, **limits, load_gain=1.0)
    transition, inputs, _ = at.discretize(STEP)
    z = np.r_[0.01 * np.random.default_rng(0).normal(size=9), np.zeros(9)]
    told, deaf = [], []
    for loads, tell in ((told, True), (deaf, False)):
        mpc.reset()
        state, stands = z, at.equilibrium_input.copy()
        for k in range(6):
            q, rates = np.split(state, 2)
            wish = mpc.command(STEP * k, at.to_nodes(q), at.to_velocities(q, rates)).value
            stands = np.r_[stands[:2], wish[2:]]  # two actuators are stuck
            if tell:
                mpc.applied(stands)
            state = transition @ state + inputs @ (stands - at.equilibrium_input)
            loads.append(np.abs(mpc.load).max())
    assert max(told) < 1e-9
    assert max(deaf[1:]) > 1e-3


# ---- solvers ----


@pytest.mark.parametrize("kind", ["mpc", "nmpc"])
@both_inputs
def test_out_of_time_is_counted_and_over_when_there_is_time(kind, held, monkeypatch):
    made = controller(kind, held, time_limit=1e-9)
    made.applied(plant(held).equilibrium_input)
    for k in range(3):
        command = made.command(STEP * k, pushed(held), STILL)
        assert str(command).startswith("out of time: ")
    assert sum(made.statistics.status_count.values()) == 3
    assert made.statistics.iterations.sum() == 0
    monkeypatch.setattr(made, "_longest_time", 1e3)
    assert made.command(0.1, pushed(held), STILL).status == "ok"


@both_inputs
def test_a_generous_time_limit_changes_nothing(held):
    """OSQP counts setup and updates into its first and next solves; the limit is without them."""
    for kind in ("mpc", "nmpc"):
        limited, free = controller(kind, held, time_limit=1e3), controller(kind, held)
        for k in range(3):
            one, other = (m.command(STEP * k, pushed(held), STILL) for m in (limited, free))
            assert one.status == other.status == "ok"
            np.testing.assert_array_equal(one.value, other.value)


def test_time_that_osqp_counts_before_the_solve_is_given_back(monkeypatch):
    """By a clock that goes on by a quarter of a second whenever it is looked at."""
    from scipy.sparse import csc_array, identity

    looks = count()
    for module in ("osqp_solver", "qp_solver"):
        monkeypatch.setattr(
            f"tenscontrol.control.mpc.{module}.perf_counter", lambda: 0.25 * next(looks)
        )
    dense, zero = np.random.default_rng(0).normal(size=(5, 5)), np.zeros(5)
    program = OSQPSolver(identity(5).tocsc(), csc_array(dense), 1e-6, 4000)
    given = []
    program._solver.update_settings = lambda **settings: given.append(settings["time_limit"])
    program.update(dense.T.ravel())  # OSQP counts no update into the first solve
    for update in (False, True, False):
        if update:
            program.update(2 * dense.T.ravel())
        assert program.solve(zero, zero, zero, deadline=10.0).status is Status.OK
    # Setup took two looks, the first update one, the second two, a solve two.
    assert given == [10.0 - 1.0 + 0.25, 10.0 - 2.0 + 0.25, 10.0 - 2.5]
    past = program.solve(zero, zero, zero, deadline=2.0)
    assert (past.status, past.x, past.iterations) == (Status.OUT_OF_TIME, None, 0)
    assert len(given) == 3


@pytest.mark.parametrize("kind", ["mpc", "nmpc"])
@both_inputs
def test_a_plan_that_is_used_up_ends_in_what_is_safe(kind, held, monkeypatch):
    made = controller(kind, held)
    assert made.command(0.0, pushed(held), STILL).status == "ok"
    plan, horizon = made.plan, HORIZON[kind]
    with monkeypatch.context() as patch:
        solve_nothing(patch, Status.INFEASIBLE)
        before = made.command(STEP, pushed(held), STILL).value
        np.testing.assert_allclose(before, plan[:, 1], atol=1e-12)
        for k in range(2, horizon + 20):
            command = made.command(STEP * k, pushed(held), STILL)
            assert np.abs(command.value - before).max() <= CHANGE[held] * (1 + 1e-12)
            if k >= horizon:
                assert str(command) == safe(held, "infeasible") + " held"
                if held == "rest_length":
                    np.testing.assert_array_equal(command.value, before)
            before = command.value
    if held == "force_density":  # reached by steps of at most one change
        np.testing.assert_array_equal(before, plant(held).equilibrium_input)
    assert made.command(1.0, pushed(held), STILL).status == "ok"


def test_a_limit_that_cannot_be_kept_is_infeasible_and_over_with_the_reason():
    """Really infeasible, by a hard limit on the height that the shape is beyond."""
    at = plant("force_density")
    limit = tc.OutputLimit(height_row(), [0.99], [1.05])
    mpc = tc.MPC(
        at,
        horizon=8,
        sample_time=STEP,
        max_force_density=HIGH,
        max_change=CHANGE["force_density"],
        outputs=[limit],
    )
    low = tc.structure.restore_bar_lengths(at.model.structure, at.nodes * [[1.0], [1.0], [0.8]])
    statuses, before = [], at.force_density
    for k in range(30):
        nodes = low if 10 <= k < 20 else pushed("force_density", 0.002, k)
        command = mpc.command(STEP * k, nodes, STILL)
        assert np.abs(command.value - before).max() <= CHANGE["force_density"] * (1 + 1e-12)
        statuses.append(command.status.split(":")[0])
        before = command.value
    assert statuses == ["ok"] * 10 + ["infeasible"] * 10 + ["ok"] * 10
    assert mpc.statistics.fallbacks == 10
    # What an infeasible program did to the solver does not slow those after it.
    assert mpc.statistics.iterations[22:].max() <= 2 * mpc.statistics.iterations[:10].max()


def test_nmpc_begins_anew_where_its_plan_has_no_value(monkeypatch):
    """Along a plan the dynamics may have no value; with the next measurement all is well."""
    made, at = controller("nmpc", "rest_length"), plant("rest_length")
    model = made.law.model
    linearize, failing = model.linearize, [False]

    def spoilt(*plan):
        motion, rows = linearize(*plan)
        return (replace(motion, values=np.nan * motion.values) if failing[0] else motion), rows

    monkeypatch.setattr(model, "linearize", spoilt)
    first = made.command(0.0, at.nodes, STILL)
    assert first.status == "ok"
    np.testing.assert_allclose(first.value, at.rest_length, atol=1e-4)  # up to OSQP's tolerance
    failing[0] = True
    lost = made.command(STEP, at.nodes, STILL)
    assert str(lost) == "data not finite or too large: previous input held"
    np.testing.assert_array_equal(lost.value, first.value)
    failing[0] = False
    assert made.command(2 * STEP, at.nodes, STILL).status == "ok"


def test_a_decision_that_is_not_finite_is_not_given():
    class Broken(tc.control.Controller):
        """Decides on nothing."""

        def _decide(self, time, state):
            return tc.control.Command(np.full(9, np.nan))

    at = plant("force_density")
    command = Broken(at, STEP, np.zeros(9), np.full(9, 60.0)).command(0.0, at.nodes, STILL)
    assert str(command) == "input not finite: equilibrium held"
    np.testing.assert_array_equal(command.value, at.force_density)


# ---- limits of the regulator ----


def test_regulator_says_where_it_is_limited():
    at = plant("rest_length")
    Q, R = tc.energy_weights(at)
    winches = tc.Winches(RATE, *RANGE)
    limited, free = (tc.LQR(at, Q, R, sample_time=STEP, winches=w) for w in (winches, None))
    np.testing.assert_array_equal(limited.bounds[0], RANGE[0])
    np.testing.assert_array_equal(limited.bounds[1], RANGE[1])
    far = pushed("rest_length", 0.05)
    wish = free.command(0.0, far, STILL)
    assert wish.status == "ok"
    assert np.abs(wish.value - at.rest_length).max() > RATE * STEP
    command = limited.command(0.0, far, STILL)
    assert command.status == "saturated"
    expected = np.clip(wish.value, at.rest_length - RATE * STEP, at.rest_length + RATE * STEP)
    np.testing.assert_allclose(command.value, expected, rtol=1e-14)
    with pytest.raises(ValueError, match=r"winches\.rate limits changes .*: give sample_time"):
        tc.LQR(at, Q, R, winches=winches)
    with pytest.raises(ValueError, match=r"max_change limits changes .*: give sample_time"):
        tc.LQR(at, Q, R, max_change=0.01)
