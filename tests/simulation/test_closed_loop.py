"""The loop: what a controller sees, what actuators hold, what is recorded."""

from math import ceil

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Status
from tenscontrol.control.controller import Controller
from tests.dynamics.scenes import paper_force_density, rest_lengths


class Script(Controller):
    """Plays commands from a list, the last one again and again, and notes what it saw."""

    def __init__(self, plant, values, step=None, statuses=("ok",), largest=90.0):
        count = len(plant.model.structure.strings)
        super().__init__(plant, step, np.zeros(count), np.full(count, largest))
        self.values, self.statuses = values, statuses
        self.resets = 0
        self.seen = []

    def command(self, time, nodes, velocities):
        self.seen.append((time, nodes.copy(), velocities.copy()))
        return super().command(time, nodes, velocities)

    def reset(self):
        self.resets += 1
        self.seen = []

    def _decide(self, time, state):
        turn = len(self.seen) - 1
        value = self.values[min(turn, len(self.values) - 1)]
        status = Status(self.statuses[turn % len(self.statuses)])
        return tc.control.Command(np.asarray(value, float), status)

    def _fall_back(self, status):
        return tc.control.Command(np.asarray(self.values[-1], float), status)


class Damper(Script):
    """Force densities against the velocities that they push: ``γ = γ0 - g Bᵀ q̇``."""

    def _decide(self, time, state):
        r = len(state) // 2
        push = self.plant.B[r:].T @ state[r:]
        return tc.control.Command(self.plant.force_density - self.values[0] * push)


@pytest.fixture(scope="module")
def model():
    return tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))


@pytest.fixture(scope="module")
def by_force(model, rest):
    """A plant commanded by force density."""
    return tc.linearize(model, rest, "force_density")


@pytest.fixture(scope="module")
def by_length(model, rest):
    """A plant commanded by rest length."""
    return tc.linearize(model, rest, "rest_length")


def steps_of(run, sample):
    """Which sample each state after the first belongs to: the one that it ends or lies in."""
    return np.ceil(run.time[1:] / sample - 1e-9).astype(int) - 1


# ---- what the controller sees ----


@pytest.mark.parametrize("method", [{"step": 1e-3}, {"tolerance": 1e-8, "output_step": 5e-3}])
def test_the_controller_sees_the_motion_at_every_sample(model, by_length, method):
    controller = Script(by_length, [0.7 * np.ones(9), 0.8 * np.ones(9)], step=0.02)
    run = tc.simulate(model, 0.2, controller=controller, **method)
    assert len(controller.seen) == 10
    for k, (time, nodes, velocities) in enumerate(controller.seen):
        assert time == pytest.approx(0.02 * k, abs=1e-15)
        at = np.argmin(np.abs(run.time - time))
        assert run.time[at] == pytest.approx(time, abs=1e-12)
        np.testing.assert_array_equal(run.nodes[:, :, at], nodes)
        np.testing.assert_array_equal(run.velocities[:, :, at], velocities)


def test_the_controller_is_reset_before_it_is_asked(model, by_length):
    controller = Script(by_length, [0.7 * np.ones(9), 0.8 * np.ones(9)], step=0.02)
    first = tc.simulate(model, 0.1, controller=controller, step=1e-3)
    second = tc.simulate(model, 0.1, controller=controller, step=1e-3)
    assert controller.resets == 2
    np.testing.assert_array_equal(first.nodes, second.nodes)


@pytest.mark.parametrize(
    ("duration", "commands"), [(0.1, 5), (0.11, 6), (0.02, 1), (0.013, 1), (0.3, 15)]
)
def test_a_last_sample_may_be_cut_short(model, by_length, duration, commands):
    controller = Script(by_length, [0.7 * np.ones(9)], step=0.02)
    run = tc.simulate(model, duration, controller=controller, step=1e-3)
    assert len(controller.seen) == len(run.control.time) == commands == ceil(duration / 0.02 - 1e-9)
    assert run.time[-1] == pytest.approx(duration, rel=1e-12)
    assert (np.diff(run.time) > 1e-6).all()


@pytest.mark.parametrize(("given", "expected"), [({"sample_time": 0.01}, 10), ({}, 100)])
def test_a_law_in_continuous_time_runs_at_the_sample_time_or_every_step(
    model, by_length, given, expected
):
    controller = Script(by_length, [0.7 * np.ones(9)], step=None)
    tc.simulate(model, 0.1, controller=controller, step=1e-3, **given)
    assert len(controller.seen) == expected


# ---- what actuators hold ----


@pytest.mark.parametrize("hold", ["rest_length", "force_density"])
def test_a_constant_command_is_an_open_loop(model, by_force, by_length, hold):
    gamma = paper_force_density(45.0)
    value = gamma if hold == "force_density" else rest_lengths(model.structure, gamma, 100.0)
    plant = by_force if hold == "force_density" else by_length
    closed = tc.simulate(
        model, 0.5, controller=Script(plant, [value], step=0.02), input=hold, step=1e-3
    )
    opened = tc.simulate(model, 0.5, step=1e-3, **{hold: value})
    np.testing.assert_allclose(closed.time, opened.time, rtol=0, atol=1e-12)
    np.testing.assert_allclose(closed.nodes, opened.nodes, rtol=0, atol=1e-12)


def test_held_force_densities_are_the_commands(model, by_force):
    commands = [np.full(9, 10.0 + k) for k in range(5)]
    controller = Script(by_force, commands, step=0.02)
    run = tc.simulate(model, 0.1, controller=controller, input="force_density", step=1e-3)
    assert run.rest_length is None
    sample = steps_of(run, 0.02)
    np.testing.assert_array_equal(run.force_density[:, 1:], np.column_stack(commands)[:, sample])
    np.testing.assert_array_equal(run.control.applied, np.column_stack(commands))
    np.testing.assert_array_equal(run.control.winch_rate, 0.0)


def test_without_a_string_law_force_densities_are_held(prism, rest):
    model = tc.Model(prism)
    plant = tc.linearize(model, rest)
    run = tc.simulate(model, 0.1, controller=Script(plant, [np.full(9, 12.0)], 0.02), step=1e-3)
    np.testing.assert_array_equal(run.force_density, 12.0)


def test_a_winch_gives_the_commanded_force_density_at_the_sample_only(model, by_force):
    """Between samples it holds its rest length, and γ moves with the structure."""
    commands = [paper_force_density(20.0 + 2 * k) for k in range(10)]
    controller = Script(by_force, commands, step=0.02)
    run = tc.simulate(model, 0.2, controller=controller, step=1e-3)
    applied = run.control.applied
    for k, (_, nodes, _) in enumerate(controller.seen):
        length = model.structure.string_length(nodes)
        np.testing.assert_allclose(100.0 * (1 - applied[:, k] / length), commands[k], rtol=1e-12)
    sample = steps_of(run, 0.02)
    np.testing.assert_array_equal(run.rest_length[:, 1:], applied[:, sample])
    wanted = np.column_stack(commands)[:, sample]
    assert np.abs(run.force_density[:, 1:] - wanted).max() > 0.5


def test_the_two_holds_are_different_loops(model, by_force):
    def final(hold):
        controller = Script(by_force, [paper_force_density(45.0)], step=0.1)
        run = tc.simulate(model, 0.5, controller=controller, input=hold, step=1e-3)
        return run.nodes[:, :, -1]

    assert np.abs(final("rest_length") - final("force_density")).max() > 1e-3


def test_the_holds_agree_where_samples_are_short(model, by_force):
    """γ asked for at every instant is γ held: the difference falls with the sample time."""
    gamma = paper_force_density(45.0)
    held = tc.simulate(model, 0.2, force_density=gamma, step=1e-3).nodes[:, :, -1]
    gaps = []
    for sample in (4e-3, 2e-3, 1e-3):
        controller = Script(by_force, [gamma], step=sample)
        run = tc.simulate(model, 0.2, controller=controller, step=1e-3)
        gaps.append(np.abs(run.nodes[:, :, -1] - held).max())
    orders = np.diff(np.log(gaps)) / np.log(0.5)
    np.testing.assert_allclose(orders, 1.0, atol=0.1)


# ---- winches ----


def test_winches_ramp_at_their_rate_and_stop_at_the_command(model, by_length):
    start = by_length.rest_length
    wanted = start - np.linspace(0.0, 0.04, 9)
    run = tc.simulate(
        model,
        0.2,
        rest_length=start,
        controller=Script(by_length, [wanted], step=0.02),
        winches=tc.Winches(rate=0.25),
        step=1e-3,
    )
    move = 0.25 * 0.02 * np.arange(1, 11)
    expected = np.maximum(wanted[:, None], start[:, None] - move)
    np.testing.assert_allclose(run.control.applied, expected, rtol=0, atol=1e-14)
    late = (expected > wanted[:, None] + 1e-12).sum(axis=0)
    np.testing.assert_array_equal(run.control.rate_limited, late)
    assert late[0] == 7
    assert late[-1] == 0
    assert np.abs(run.control.winch_rate).max() <= 0.25 * (1 + 1e-12)
    np.testing.assert_array_equal(run.control.command, np.tile(wanted[:, None], (1, 10)))


def test_winches_stay_within_their_range(model, by_length):
    run = tc.simulate(
        model,
        0.1,
        rest_length=0.7,
        controller=Script(by_length, [np.r_[np.full(4, 0.3), np.full(5, 0.9)]], step=0.02),
        winches=tc.Winches(shortest=0.65, longest=0.75),
        step=1e-3,
    )
    np.testing.assert_array_equal(run.control.applied[:4], 0.65)
    np.testing.assert_array_equal(run.control.applied[4:], 0.75)
    np.testing.assert_array_equal(run.control.range_limited, 9)
    np.testing.assert_array_equal(run.control.rate_limited, 0)


def test_winch_rates_on_record_are_changes_over_the_sample_time(model, by_length):
    commands = [np.full(9, 0.70), np.full(9, 0.72), np.full(9, 0.71)]
    controller = Script(by_length, commands, step=0.02)
    run = tc.simulate(model, 0.06, controller=controller, step=1e-3)
    expected = np.tile([0.0, 1.0, -0.5], (9, 1))
    np.testing.assert_allclose(run.control.winch_rate, expected, rtol=0, atol=1e-12)


def test_a_force_command_through_slow_winches_gives_less_force(model, by_force, by_length):
    """Asked to double γ at once, a winch of 0.1 m/s winds by 2 mm in the first sample."""
    start = by_length.rest_length
    controller = Script(by_force, [2 * by_force.force_density], step=0.02)
    run = tc.simulate(
        model,
        0.02,
        rest_length=start,
        controller=controller,
        winches=tc.Winches(rate=0.1),
        step=1e-3,
    )
    np.testing.assert_allclose(run.control.applied[:, 0], start - 0.002, rtol=0, atol=1e-15)
    assert run.control.rate_limited[0] == 9
    assert (run.force_density[:, -1] < 1.1 * by_force.force_density).all()


# ---- the record ----


def test_statuses_are_counted(model, by_length):
    controller = Script(
        by_length, [0.7 * np.ones(9)], step=0.02, statuses=("ok", "ok", "infeasible")
    )
    with pytest.warns(tc.control.ControlWarning, match=r"30 % of the programs were not solved"):
        run = tc.simulate(model, 0.2, controller=controller, step=1e-3)
    assert run.control.status_count == {"ok": 7, "infeasible": 3}
    assert run.control.status[:3] == ("ok", "ok", "infeasible")
    assert "7 ok, 3 infeasible" in run.summary()


def test_the_record_has_one_column_a_sample_and_is_read_only(model, by_length):
    run = tc.simulate(model, 0.1, controller=Script(by_length, [0.7 * np.ones(9)], 0.02), step=1e-3)
    record = run.control
    np.testing.assert_allclose(record.time, 0.02 * np.arange(5), rtol=0, atol=1e-15)
    for name in ("command", "applied", "winch_rate"):
        assert getattr(record, name).shape == (9, 5)
    for name in ("time", "command", "applied", "winch_rate", "rate_limited", "computing_time"):
        assert not getattr(record, name).flags.writeable
    assert (record.computing_time >= 0).all()


def test_momentum_is_kept_whatever_the_controller_does(model, by_length):
    """Strings are internal. A step keeps linear momentum exactly, angular as well as the motion."""
    commands = list(np.random.default_rng(0).uniform(0.6, 0.8, size=(25, 9)))
    run = tc.simulate(model, 0.5, controller=Script(by_length, commands, 0.02), step=1e-3)
    assert np.abs(run.momentum).max() < 1e-12
    assert np.abs(run.angular_momentum).max() < 1e-8


@pytest.mark.parametrize("hold", ["rest_length", "force_density"])
def test_a_feedback_against_the_velocities_settles_the_prism(model, by_force, hold):
    displacement = 0.05 * np.random.default_rng(0).normal(size=18)
    start = by_force.to_nodes(by_force.basis.T @ displacement)
    quiet, damped = (
        tc.simulate(
            model, 3.0, start, controller=Damper(by_force, [gain], 0.01), input=hold, step=2e-3
        )
        for gain in (0.0, 4.0)
    )
    late = damped.time > 2.0
    assert damped.kinetic_energy[late].max() < 0.25 * quiet.kinetic_energy[late].max()


def test_commands_are_within_the_bounds(model, by_force):
    controller = Script(by_force, [np.linspace(-20.0, 200.0, 9)], step=0.02, largest=60.0)
    run = tc.simulate(model, 0.04, controller=controller, input="force_density", step=1e-3)
    assert (run.control.command.min(), run.control.command.max()) == (0.0, 60.0)
    assert run.force_density.min() == 0.0


def wound_prism(prism):
    """A model, an MPC, a disturbed start, and the rest lengths of the undisturbed shape."""
    rest = tc.prestress(prism, 30 / np.sqrt(3))
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    plant = tc.linearize(model, rest)
    mpc = tc.MPC(plant, horizon=10, sample_time=0.02, max_force_density=80.0)
    start = plant.to_nodes(np.r_[0.03, np.zeros(8)])
    stood = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    return model, mpc, start, stood


def test_the_first_move_of_the_winches_counts_from_where_they_stood(prism):
    model, mpc, start, stood = wound_prism(prism)
    run = tc.simulate(model, 0.1, start, controller=mpc, rest_length=stood, step=1e-3)
    first = (run.control.applied[:, 0] - stood) / 0.02
    np.testing.assert_allclose(run.control.winch_rate[:, 0], first)
    assert np.abs(first).max() > 0.1


def test_winches_at_their_limits_are_in_the_summary(prism):
    model, mpc, start, stood = wound_prism(prism)
    winches = tc.Winches(rate=0.01, shortest=0.7)
    run = tc.simulate(
        model, 0.2, start, controller=mpc, rest_length=stood, winches=winches, step=1e-3
    )
    slow = int((run.control.rate_limited > 0).sum())
    assert slow > 0
    assert f"winches           too slow in {slow} samples" in run.summary()
    with pytest.raises(
        ValueError, match=r"rest_length\[0\] is 0\.7\d* m, expected at least 0\.8 m"
    ):
        tc.simulate(
            model, 0.1, start, controller=mpc, rest_length=stood, step=1e-3,
            winches=tc.Winches(shortest=0.8),
        )  # fmt: skip


def test_a_controller_for_other_strings_is_refused_even_if_the_number_agrees(prism):
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, 30 / np.sqrt(3)))
    mpc = tc.MPC(plant, horizon=5, sample_time=0.02, max_force_density=80.0)
    turned = tc.Structure(prism.nodes, prism.bars, prism.strings[::-1], 1.0)
    with pytest.raises(ValueError, match="with other bars, strings or fixed nodes"):
        tc.simulate(tc.Model(turned), 0.1, controller=mpc, step=1e-3)


def test_a_span_of_almost_nothing_is_one_sample(prism):
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, 30 / np.sqrt(3)))
    run = tc.simulate(
        tc.Model(prism),
        1e-12,
        controller=tc.MPC(plant, horizon=5, sample_time=0.02, max_force_density=80.0),
        step=1e-3,
    )
    assert len(run.control.time) == 1


def test_work_is_counted_over_all_samples(prism):
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, 30 / np.sqrt(3)))
    run = tc.simulate(
        tc.Model(prism),
        0.2,
        controller=tc.MPC(plant, horizon=5, sample_time=0.02, max_force_density=80.0),
        step=1e-3,
    )
    assert run.steps == 200
    assert run.evaluations == 800
