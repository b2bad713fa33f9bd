"""Strings that are cut, winches that are stuck, measurements that are lost, in a simulation."""

from functools import cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.integrate.methods import METHODS

GAMMA, STEP, CUT = 17.3205, 0.02, 0.1237
PRECISE = {"method": "dop853", "tolerance": 1e-10}
both = pytest.mark.parametrize("held", ["force_density", "rest_length"])


@cache
def rest():
    return tc.prestress(tc.prism(), GAMMA)


@cache
def model(damping=0.0):
    return tc.Model(tc.prism(), strings=tc.LinearStrings(100.0, damping=damping))


@cache
def start():
    return tc.to_rest_length(model(), tc.prism().nodes, rest().force_density).rest_length


def value(held):
    """What is held, a little off the equilibrium, so that there is motion before the cut."""
    if held == "force_density":
        return np.r_[1.1, np.ones(8)] * rest().force_density
    return 0.98 * start()


@cache
def precise(held, string=6):
    return tc.simulate(
        model(), 0.4, faults=[tc.CutString(string, CUT)], **{held: value(held)}, **PRECISE
    )


# ---- cut strings in open loop ----


@both
def test_after_a_cut_the_motion_is_that_of_a_structure_without_the_string(held):
    run = precise(held)
    keep = np.arange(9) != 6
    prism = tc.prism()
    less = tc.Structure(prism.nodes, prism.bars, prism.strings[keep], 1.0)
    before = tc.simulate(model(), CUT, **{held: value(held)}, **PRECISE)
    after = tc.simulate(
        tc.Model(less, strings=tc.LinearStrings(100.0)),
        0.4 - CUT,
        before.nodes[:, :, -1],
        before.velocities[:, :, -1],
        **{held: value(held)[keep]},
        **PRECISE,
    )
    np.testing.assert_allclose(run.nodes[:, :, -1], after.nodes[:, :, -1], rtol=0, atol=1e-8)
    whole = tc.simulate(model(), 0.4, **{held: value(held)}, **PRECISE)
    assert np.abs(run.nodes[:, :, -1] - whole.nodes[:, :, -1]).max() > 0.01


@both
def test_the_cut_is_at_its_time_exactly(held):
    run = precise(held)
    at = np.flatnonzero(run.time == CUT)
    assert len(at) == 1
    assert (run.force_density[6, 1 : at[0] + 1] > 1.0).all()
    assert (run.force_density[6, at[0] + 1 :] == 0.0).all()
    assert (np.delete(run.force_density, 6, axis=0)[:, : at[0] + 1] > 0).all()


@both
def test_what_the_string_stored_is_lost_and_all_else_is_kept(held):
    run = precise(held)
    at = np.flatnonzero(run.time == CUT)[0]
    i, j = run.structure.strings[6]
    length = np.linalg.norm(run.nodes[:, j, at] - run.nodes[:, i, at])
    stored = 0.5 * value(held)[6] * length**2
    if held == "rest_length":
        stored = 0.5 * 100.0 * (length - value(held)[6]) ** 2
    np.testing.assert_array_equal(run.released_energy[: at + 1], 0.0)
    np.testing.assert_allclose(run.released_energy[at + 1 :], stored, rtol=1e-12)
    assert run.energy[at + 1] - run.energy[at] == pytest.approx(-stored, rel=1e-6)
    assert run.health.energy_error < 1e-8
    assert run.health.momentum_change < 1e-12
    assert run.health.angular_momentum_change < 1e-9


@both
def test_the_balance_of_energy_still_tells_of_a_coarse_step(held):
    with pytest.warns(tc.simulation.AccuracyWarning, match="energy error"):
        coarse = tc.simulate(
            model(), 0.8, faults=[tc.CutString(6, CUT)], method="rk4", step=0.08,
            **{held: 0.9 * value(held)},
        )  # fmt: skip
    assert coarse.health.energy_error > 0.05


@pytest.mark.parametrize("method", sorted(METHODS))
@both
def test_all_methods_agree_on_a_cut(held, method):
    setting = {"step": 2e-3} if "step" in METHODS[method].settings else {"tolerance": 1e-7}
    run = tc.simulate(
        model(), 0.4, faults=[tc.CutString(6, CUT)], method=method, **setting, **{held: value(held)}
    )
    error = np.abs(run.nodes[:, :, -1] - precise(held).nodes[:, :, -1]).max()
    assert error < 2e-4  # the structure has gone 20 cm by then
    assert run.health.energy_error < 1e-3


def test_strings_of_constant_axial_rigidity_are_cut_as_well():
    elastic = tc.Model(tc.prism(), strings=tc.ElasticStrings(axial_rigidity=100.0))
    run = tc.simulate(elastic, 0.3, rest_length=0.9 * start(), faults=[tc.CutString(0, 0.1)])
    assert run.health.energy_error < 1e-4
    assert run.released_energy[-1] > 1.0
    assert (run.force_density[0, run.time > 0.1] == 0).all()


def test_several_cuts_and_one_at_the_start():
    """A string that is cut at 0 s was never there: it stores nothing that could be lost."""
    cuts = [tc.CutString(0, 0.0), tc.CutString(3, 0.1), tc.CutString(4, 0.1), tc.CutString(3, 0.2)]
    run = tc.simulate(model(), 0.3, force_density=rest().force_density, faults=cuts, **PRECISE)
    assert (run.force_density[0] == 0).all()
    for string in (3, 4):
        assert (run.force_density[string, run.time <= 0.1] > 0).all()
        assert (run.force_density[string, run.time > 0.1] == 0).all()
    steps = np.flatnonzero(np.diff(run.released_energy))
    np.testing.assert_allclose(run.time[steps], [0.1])
    assert run.health.energy_error < 1e-8
    assert run.faults == tuple(cuts)
    assert "fault             string 3 cut from 0.1 s" in run.summary()


@both
def test_of_a_subdivided_string_a_segment_is_cut_and_the_rest_dangles(held):
    massive = tc.subdivide(tc.prism(), segments=2, node_mass=0.05)
    segments = np.flatnonzero(massive.string_parent == 6)
    cut, left = segments
    spread = {
        "force_density": tc.structure.spread_force_density,
        "rest_length": tc.structure.spread_rest_length,
    }[held]
    given = spread(massive, rest().force_density if held == "force_density" else start())
    law = tc.LinearStrings(200.0)
    run = tc.simulate(
        tc.Model(massive, strings=law), 0.3, **{held: given}, faults=[tc.CutString(cut, 0.1)],
        **PRECISE,
    )  # fmt: skip
    late = run.time > 0.1
    assert (run.force_density[cut, late] == 0).all()
    assert (run.force_density[left, late] > 0).any()
    assert run.health.energy_error < 1e-7
    assert run.health.momentum_change < 1e-10


# ---- in closed loop ----


@cache
def plant(held):
    return tc.linearize(model(0.5), rest(), held)


@cache
def controller(kind, held, **changes):
    limits = {"max_force_density": 60.0, "max_change": 6.0}
    if held == "rest_length":
        limits = {"winches": winches()}
    if kind == "lqr":
        return tc.LQR(
            plant(held), *tc.energy_weights(plant(held)), sample_time=STEP, **limits, **changes
        )
    made = {"mpc": tc.MPC, "nmpc": tc.NMPC}[kind]
    return made(plant(held), horizon=6, sample_time=STEP, **limits, **changes)


def winches():
    return tc.Winches(rate=0.5, shortest=0.4, longest=1.1)


def closed(kind, held, faults, duration=1.0, **changes):
    """A run from a disturbed shape."""
    if held == "rest_length":
        changes = {"winches": winches(), "rest_length": start()} | changes
    else:
        changes = {"input": "force_density"} | changes
    q = 0.03 * np.random.default_rng(1).normal(size=9)
    return tc.simulate(
        model(0.5), duration, plant(held).to_nodes(q), controller=controller(kind, held),
        faults=faults, step=2e-3, output_step=STEP, **changes,
    )  # fmt: skip


def refuse_unsafe(run, held):
    """Every command is finite, within bounds and within reach of what stood before it."""
    low, high = (0.0, 60.0) if held == "force_density" else (0.4, 1.1)
    change = 6.0 if held == "force_density" else 0.5 * STEP
    first = rest().force_density if held == "force_density" else start()
    stood = np.column_stack([first, run.control.applied[:, :-1]])
    assert np.isfinite(run.control.command).all()
    assert run.control.command.min() >= low
    assert run.control.command.max() <= high
    assert np.abs(run.control.command - stood).max() <= change * (1 + 1e-9)


kinds = pytest.mark.parametrize("kind", ["lqr", "mpc", "nmpc"])


def off(run, held):
    """How far the shape is off at the end, m."""
    at = plant(held)
    z = at.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
    return np.abs(at.to_nodes(z[:9]) - at.nodes).max()


@kinds
@both
def test_a_stuck_winch_holds_what_it_has(kind, held):
    """The others go on, commands count from where it stands, and the shape is held at last."""
    stuck = tc.StuckWinch(string=4, time=0.06, until=0.4)
    run = closed(kind, held, [stuck], duration=2.5)
    refuse_unsafe(run, held)
    held_at = (run.control.time > 0.06 - 1e-9) & (run.control.time < 0.4 - 1e-9)
    before = run.control.applied[4, np.flatnonzero(held_at)[0] - 1]
    np.testing.assert_array_equal(run.control.applied[4, held_at], before)
    assert np.ptp(run.control.command[4, held_at]) > 0
    assert np.ptp(np.delete(run.control.applied, 4, axis=0)[:, held_at], axis=1).min() > 0
    free = run.control.time > 0.4
    np.testing.assert_allclose(run.control.applied[:, free], run.control.command[:, free])
    assert not np.array_equal(run.control.applied[4, free][:3], [before] * 3)
    assert off(run, held) < 5e-3


@kinds
@both
def test_a_lost_measurement_shows_in_the_status_and_is_over_with_its_end(kind, held):
    run = closed(kind, held, [tc.LostMeasurement(0.1, 0.3)], duration=2.5)
    refuse_unsafe(run, held)
    lost = np.array([status.startswith("measurement not") for status in run.control.status])
    np.testing.assert_array_equal(np.flatnonzero(lost), np.arange(5, 15))
    assert {run.control.status[k] for k in np.flatnonzero(~lost)} <= {"ok", "saturated"}
    assert off(run, held) < 5e-3


@pytest.mark.filterwarnings("ignore::tenscontrol.control.ControlWarning")
@kinds
@both
def test_a_controller_that_is_not_told_of_a_cut_gives_safe_commands(kind, held):
    """The cut is within a sample; the prism has no other state of self-stress, and is lost."""
    run = closed(kind, held, [tc.CutString(6, 0.111)], duration=0.4)
    refuse_unsafe(run, held)
    late = run.time > 0.1111
    assert (run.force_density[6, late] == 0).all()
    assert (run.force_density[6, ~late] > 0).all()
    assert (run.control.applied[6] > 0).all()  # the winch itself goes on
    assert len(run.control.status) == 20


def test_changes_of_a_force_controller_on_winches_count_from_the_force_that_stands():
    """It commands γ, winches hold rest lengths and one is stuck: γ moves with the structure."""
    soft = tc.linearize(model(), rest())
    mpc = tc.MPC(soft, horizon=6, sample_time=STEP, max_force_density=60.0, max_change=2.0)
    nodes = soft.to_nodes(0.02 * np.random.default_rng(1).normal(size=9))
    begin = tc.to_rest_length(model(), nodes, rest().force_density).rest_length
    run = tc.simulate(
        model(), 0.4, nodes, controller=mpc, rest_length=begin, winches=tc.Winches(rate=0.5),
        faults=[tc.StuckWinch(2, 0.1, 0.3)], step=2e-3, output_step=STEP,
    )  # fmt: skip
    shapes = run.nodes[:, :, : run.control.command.shape[1]]
    law = model().strings
    lengths = np.column_stack(
        [run.structure.string_length(shapes[:, :, k]) for k in range(shapes.shape[2])]
    )
    stands = np.column_stack(
        [law.force_density(*pair) for pair in zip(lengths.T, run.control.applied.T, strict=True)]
    )
    before = np.column_stack([rest().force_density, stands[:, :-1]])
    assert np.abs(run.control.command - before).max() <= 2.0 * (1 + 1e-9)
    assert np.abs(run.control.command[2] - stands[2]).max() > 0.01


class Ear(tc.control.Controller):
    """Commands γ that grow from sample to sample, and notes what it is told."""

    def __init__(self, designed):
        super().__init__(designed, STEP, np.zeros(9), np.full(9, 60.0))
        self.told = []

    def applied(self, value):
        super().applied(value)
        self.told.append(value)

    def reset(self):
        super().reset()
        self.told = []

    def _decide(self, time, state):
        return tc.control.Command((1 + time) * rest().force_density)

    def _fall_back(self, status):
        return tc.control.Command(rest().force_density, status)


def test_winches_of_a_subdivided_structure_are_those_of_whole_strings():
    """A stuck one holds the rest lengths of all segments; γ told is that of the whole string."""
    massive = tc.subdivide(tc.prism(), segments=2, node_mass=0.05)
    ear = Ear(tc.linearize(model(), rest()))
    run = tc.simulate(
        tc.Model(massive, strings=tc.LinearStrings(200.0)), 0.1, controller=ear,
        rest_length=start(), faults=[tc.StuckWinch(6, 0.04)], step=1e-3,
        output_step=STEP,
    )  # fmt: skip
    segments = np.flatnonzero(massive.string_parent == 6)
    late = run.time > 0.05
    assert np.ptp(run.rest_length[segments][:, late]) == 0.0
    others = np.setdiff1d(np.arange(18), segments)
    assert np.ptp(run.rest_length[others][:, late], axis=1).min() > 0
    np.testing.assert_allclose(ear.told[0], rest().force_density, rtol=1e-9)  # where they stood
    np.testing.assert_allclose(ear.told[1], run.control.command[:, 0], rtol=1e-9)
    free = np.arange(9) != 6
    np.testing.assert_allclose(ear.told[4][free], run.control.command[free, 3], rtol=1e-3)
    assert ear.told[4][6] < 0.99 * run.control.command[6, 3]


def test_a_tower_is_held_without_a_string_by_a_controller_that_is_told():
    """It has states of self-stress without that string: the second controller is made for them.

    The first one, not told, keeps its commands within bounds and loses the shape.
    """
    tower, string = tc.prism_tower(2), 15
    keep = np.arange(len(tower.strings)) != string
    less = tc.Structure(tower.nodes, tower.bars, tower.strings[keep], tower.bar_mass)
    controllers = [
        tc.MPC(
            tc.linearize(tc.Model(each), tc.prestress(each, GAMMA)),
            horizon=5,
            sample_time=STEP,
            max_force_density=150.0,
        )
        for each in (tower, less)
    ]
    deaf, told = controllers
    cut = tc.simulate(
        tc.Model(tower), 0.3, controller=deaf, faults=[tc.CutString(string, 0.05)],
        step=5e-3,
    )  # fmt: skip
    assert np.isfinite(cut.control.command).all()
    assert cut.control.command.min() >= 0
    assert cut.control.command.max() <= 150.0
    run = tc.simulate(
        tc.Model(less), 1.5, cut.nodes[:, :, -1], cut.velocities[:, :, -1],
        controller=told, step=5e-3,
    )  # fmt: skip
    z = told.plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
    left = np.abs(told.plant.to_nodes(z[:24]) - tower.nodes).max()
    z = deaf.plant.measure(cut.nodes[:, :, -1], cut.velocities[:, :, -1])
    lost = np.abs(deaf.plant.to_nodes(z[:24]) - tower.nodes).max()
    assert run.control.status_count == {"ok": 75}
    assert lost > 0.1
    assert left < 1e-3


# ---- what is refused ----


def go(fault, **changes):
    """An open loop with a fault."""
    return tc.simulate(model(), 0.1, rest_length=start(), faults=fault, **changes)


def steered(fault, **changes):
    """A closed loop with a fault."""
    made = controller("lqr", "rest_length")
    return tc.simulate(model(0.5), 0.1, controller=made, step=2e-3, faults=fault, **changes)


@pytest.mark.parametrize(("call", "error", "message"), [
    (lambda: tc.CutString(-1, 0.0), ValueError, "string is -1"),
    (lambda: tc.CutString(1.5, 0.0), TypeError, r"string is 1\.5, expected a whole number"),
    (lambda: tc.CutString(1, -0.1), ValueError, r"time is -0\.1, expected a time in s"),
    (lambda: tc.CutString(1, np.nan), ValueError, "time is nan"),
    (lambda: tc.CutString(1, [0.1]), ValueError, "time is .*expected a time in s"),
    (lambda: tc.StuckWinch(1, 0.2, 0.2), ValueError, r"until is 0\.2 s, expected after time"),
    (lambda: tc.StuckWinch(1, 0.2, -np.inf), ValueError, "until is -inf"),
    (lambda: tc.LostMeasurement(0.2, "later"), TypeError, "until is 'later'"),
    (lambda: go(tc.CutString(1, 0.0)), TypeError, "faults is a CutString, expected a list"),
    (lambda: go([3]), TypeError, r"faults\[0\] is a int, expected Fault"),
    (lambda: go([tc.CutString(9, 0.0)]), ValueError,
     r"faults\[0\]\.string is 9, expected 0 to 8: there are 9 strings in the model"),
    (lambda: go([tc.LostMeasurement(0.0, 0.1)]), ValueError,
     r"faults\[0\] is a LostMeasurement, which goes with a controller"),
    (lambda: steered([tc.StuckWinch(9, 0.0)]), ValueError,
     r"faults\[0\]\.string is 9, expected 0 to 8: there are 9 strings of the controller"),
    (lambda: steered([tc.StuckWinch(3, 0.0)]), ValueError,
     r"faults has winch 3 stuck from the start.*give rest_length"),
    (lambda: tc.simulate(
        tc.Model(tc.prism()), 0.1, controller=controller("lqr", "force_density"), step=2e-3,
        faults=[tc.StuckWinch(3, 0.0)],
    ), ValueError, r"winch 3 stuck from the start.* known then: give a time after"),
    (lambda: tc.StuckWinch(1, -0.2), ValueError, r"time is -0\.2, expected a time in s"),
    (lambda: tc.LostMeasurement(0.3, 0.2), ValueError, r"until is 0\.2 s, expected after time"),
])  # fmt: skip
def test_faults_that_do_not_fit_are_refused(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_stuck_faults_may_overlap_and_what_comes_after_the_end_does_nothing():
    twice = [tc.StuckWinch(3, 0.02, 0.06), tc.StuckWinch(3, 0.04, 0.08)]
    late = [tc.CutString(0, 5.0), tc.StuckWinch(1, 5.0), tc.LostMeasurement(5.0, 6.0)]
    pushed = plant("rest_length").to_nodes(0.01 * np.random.default_rng(0).normal(size=9))
    options = {"nodes": pushed, "rest_length": start()}
    run, one, none = (
        steered(faults, **options) for faults in (twice + late, [tc.StuckWinch(3, 0.02, 0.08)], [])
    )
    np.testing.assert_array_equal(run.nodes, one.nodes)
    assert np.abs(run.nodes - none.nodes).max() > 1e-6
    np.testing.assert_array_equal(steered(late, **options).nodes, none.nodes)


def test_a_winch_stuck_from_the_start_stands_where_it_was_said_to():
    run = steered([tc.StuckWinch(3, 0.0)], rest_length=1.01 * start())
    np.testing.assert_array_equal(run.control.applied[3], 1.01 * start()[3])
