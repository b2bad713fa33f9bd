"""Functions and objects of a user as controllers: what they are given, and what becomes of it."""

import traceback
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Command, Fallback, Status

SAMPLE, STEP = 0.02, 2e-3
OK, HELD = Status.OK, Fallback.PREVIOUS_INPUT_HELD


@cache
def tower():
    """A tower of class 2 on three fixed nodes, its model, plant and regulator; a pushed shape."""
    structure = tc.library.class2_tower()
    model = tc.Model(structure, strings=tc.LinearStrings(1000.0, damping=0.5))
    rest = tc.prestress(structure, min_force_density=50.0)
    plant = tc.linearize(model, rest, input="rest_length")
    q = np.random.default_rng(0).normal(size=plant.degrees_of_freedom)
    return SimpleNamespace(
        structure=structure,
        model=model,
        rest=rest,
        plant=plant,
        still=plant.rest_length,
        start=plant.to_nodes(0.01 * q),
    )


def simulated(controller, duration=0.2, **changes):
    """A run of the tower from the pushed shape."""
    scene = tower()
    settings = {"nodes": scene.start, "rest_length": scene.still, "step": STEP, **changes}
    return tc.simulate(scene.model, duration, controller=controller, **settings)


def hold(time, nodes, velocities):
    return tower().still


class Holds:
    """Holds the rest lengths, and notes what it is told."""

    input, sample_time = "rest_length", SAMPLE

    def __init__(self):
        self.resets, self.told, self.seen = 0, [], []

    def reset(self):
        self.resets += 1

    def applied(self, value):
        self.told.append(value)

    def command(self, time, nodes, velocities):
        self.seen.append((time, nodes.shape, velocities.shape))
        return tower().still


def same(one, other):
    for name in ("nodes", "velocities", "rest_length", "force_density"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.control.command, other.control.command)
    assert one.control.status == other.control.status
    assert one.control.fallback == other.control.fallback


# ---- what it is ----


@pytest.mark.parametrize("winches", [None, tc.Winches(rate=0.2, substeps=4)], ids=["", "winches"])
def test_a_wrapped_controller_gives_the_same_bits(winches):
    own = tc.LQR(tower().plant, sample_time=SAMPLE, winches=winches)
    run = simulated(own, winches=winches)
    # An object has its memory told; a bare function has none, and needs none without winches.
    same(run, simulated(tc.FunctionController(tower().structure, own), winches=winches))
    if winches is None:
        same(run, simulated(own.command, sample_time=SAMPLE))
        by_hand = simulated(lambda time, N, V: own.command(time, N, V).value, sample_time=SAMPLE)
        np.testing.assert_array_equal(run.nodes, by_hand.nodes)


def test_a_list_is_as_good_as_an_array():
    listed = simulated(lambda time, N, V: list(map(float, tower().still)), sample_time=SAMPLE)
    same(simulated(hold, sample_time=SAMPLE), listed)


def test_an_object_is_told_what_happens():
    held = Holds()
    run = simulated(held)
    assert (held.resets, len(held.seen), len(held.told)) == (1, 10, 11)
    assert held.seen[3] == (pytest.approx(3 * SAMPLE), (3, 9), (3, 9))
    np.testing.assert_array_equal(held.told[0], tower().still)
    np.testing.assert_array_equal(np.transpose(held.told[1:]), run.control.applied)
    simulated(held, nodes=None, start=run)
    assert (held.resets, len(held.seen)) == (1, 20)
    simulated(held)
    assert held.resets == 2


def test_going_on_is_one_run():
    lqr = tc.LQR(tower().plant, sample_time=SAMPLE)

    def law(time, nodes, velocities):
        return lqr.command(time, nodes, velocities).value + 0.01 * np.sin(20 * time)

    whole = simulated(law, duration=0.2, sample_time=SAMPLE)
    first = simulated(law, duration=0.1, sample_time=SAMPLE)
    second = simulated(
        law, duration=0.1, sample_time=SAMPLE, nodes=None, rest_length=None, start=first
    )
    np.testing.assert_array_equal(second.nodes[..., -1], whole.nodes[..., -1])


def test_going_on_knows_what_is_held():
    gamma = tower().rest.force_density
    model = tc.Model(tower().structure)
    settings = {"sample_time": SAMPLE, "step": STEP}
    first = tc.simulate(model, 0.1, controller=lambda *_: gamma, **settings)
    lost = tc.simulate(model, 0.1, controller=lambda *_: gamma * np.nan, start=first, **settings)
    np.testing.assert_array_equal(lost.control.applied, first.control.applied)


def test_names_and_representation():
    own = tc.FunctionController
    structure = tower().structure
    named = {
        "hold": own(structure, hold, input="rest_length"),
        "Holds": own(structure, Holds()),
        "Holds.command": own(structure, Holds().command, input="rest_length"),
        "<lambda>": own(structure, lambda *_: 1.0, input="force_density"),
        "LQR": own(structure, tc.LQR(tower().plant)),
    }
    assert {name: each.label for name, each in named.items()} == {name: name for name in named}
    assert repr(named["Holds"]) == "FunctionController(Holds, input 'rest_length', every 0.02 s)"
    for controller in (named["Holds"], tc.LQR(tower().plant, sample_time=SAMPLE)):
        assert simulated(controller).control.controller == repr(controller)


def test_it_commands_what_the_actuators_hold_unless_it_says_otherwise():
    gamma = tower().rest.force_density
    by_force = tc.Model(tower().structure)  # no string law: γ is held
    run = tc.simulate(by_force, 0.1, controller=lambda *_: gamma, sample_time=SAMPLE, step=STEP)
    np.testing.assert_array_equal(run.control.applied, np.tile(gamma[:, None], 5))
    law = tc.FunctionController(
        tower().structure, lambda *_: gamma, input="force_density", sample_time=SAMPLE, high=200.0
    )
    held = tc.simulate(tower().model, 0.1, controller=law, step=STEP)  # from the equilibrium
    np.testing.assert_allclose(held.control.applied, np.tile(tower().still[:, None], 5), rtol=1e-12)
    free = tc.FunctionController(tower().structure, lambda *_: gamma, input="force_density")
    with pytest.raises(ValueError, match=r"no limit on the γ that it commands on string 0"):
        simulated(free, sample_time=SAMPLE)


def test_a_subdivided_structure_shows_the_nodes_of_its_parent():
    seen = []

    def law(time, nodes, velocities):
        seen.append(nodes.shape)
        return tower().still

    cut = tc.subdivide(tower().structure, segments=3, node_mass=0.01)
    model = tc.Model(cut, strings=tc.LinearStrings(3000.0, damping=1.5))
    settings = {"sample_time": SAMPLE, "rest_length": tower().still, "step": STEP}
    run = tc.simulate(model, 0.04, controller=law, **settings)
    assert set(seen) == {(3, 9)}
    np.testing.assert_array_equal(run.rest_length[:3, -1], tower().still[0] / 3)
    # Of the segments, if it is asked for.
    every = tc.FunctionController(
        cut, lambda time, N, V: np.repeat(tower().still / 3, 3), input="rest_length"
    )
    settings["rest_length"] = np.repeat(tower().still / 3, 3)
    same(run, replace(tc.simulate(model, 0.04, controller=every, **settings), control=run.control))


def test_an_estimate_takes_the_place_of_the_motion():
    sensors = tc.Sensors(structure=tower().structure, node_position=1e-3)
    kalman = tc.KalmanFilter(tower().plant, sensors, sample_time=SAMPLE)
    seen = []

    def law(time, nodes, velocities):
        seen.append(nodes)
        return tower().still

    run = simulated(law, sample_time=SAMPLE, estimator=kalman, seed=3)
    np.testing.assert_array_equal(np.stack(seen, axis=-1), run.control.estimate.nodes)


# ---- what becomes of a command ----


def test_commands_are_kept_within_bounds():
    wild = simulated(lambda *_: np.r_[-1.0, tower().still[1:]], duration=SAMPLE, sample_time=SAMPLE)
    length = tower().structure.string_length(tower().structure.nodes)
    assert wild.control.command[0, 0] == 0.01 * length[0]
    assert wild.control.status == (Status.SATURATED,)
    law = tc.FunctionController(
        tower().structure, lambda *_: np.full(12, 9.0), input="rest_length", sample_time=SAMPLE,
        high=0.9, max_change=0.004,
    )  # fmt: skip
    run = simulated(law)
    moved = np.diff(run.control.command, prepend=tower().still[:, None])
    bounded = tower().still < 0.9
    np.testing.assert_allclose(moved[bounded, 0], 0.004, rtol=1e-9)
    assert run.control.command.max() == 0.9
    assert law.status_count == {Status.SATURATED: 10}


def test_negative_force_density_is_zero():
    law = tc.FunctionController(
        tower().structure, lambda *_: np.full(12, -1.0), input="force_density"
    )
    command = law.command(0.0, tower().structure.nodes, np.zeros((3, 9)))
    assert (command.value == 0).all()
    assert command.status is Status.SATURATED


@pytest.mark.parametrize("spoilt", [np.nan, np.inf])
def test_what_is_not_finite_is_not_used(spoilt):
    def law(time, nodes, velocities):
        return np.where(time > 0.05, spoilt, tower().still + 0.001)

    run = simulated(law, sample_time=SAMPLE)
    assert run.control.status_count == {OK: 3, Status.INPUT_NOT_FINITE: 7}
    assert run.control.fallback_count == {HELD: 7}
    np.testing.assert_array_equal(run.control.command, np.tile(tower().still[:, None] + 0.001, 10))


def test_without_a_first_command_the_start_is_held():
    never = simulated(lambda *_: np.full(12, np.nan), sample_time=SAMPLE)
    np.testing.assert_array_equal(never.control.applied, np.tile(tower().still[:, None], 10))
    with pytest.raises(ValueError, match=r"input not finite at the first sample.*rest_length") as e:
        simulated(lambda *_: np.full(12, np.nan), sample_time=SAMPLE, rest_length=None)
    assert "controller <lambda> raised ValueError" in e.value.__notes__[0]
    settings = {"input": "force_density", "sample_time": SAMPLE}
    gamma = tower().rest.force_density
    law = tc.FunctionController(
        tower().structure, lambda *_: gamma * np.nan, equilibrium_input=gamma, **settings
    )
    lost = law.command(0.0, tower().structure.nodes, np.zeros((3, 9)))
    assert lost.fallback is Fallback.EQUILIBRIUM_HELD
    np.testing.assert_array_equal(lost.value, gamma)


def test_lost_measurements_are_not_handed_on():
    calls = []

    def law(time, nodes, velocities):
        assert np.isfinite(nodes).all()
        calls.append(time)
        return tower().still

    run = simulated(law, sample_time=SAMPLE, faults=[tc.LostMeasurement(0.05, 0.11)])
    assert run.control.status_count == {OK: 7, Status.MEASUREMENT_NOT_FINITE: 3}
    assert len(calls) == 7
    law = tc.FunctionController(
        tower().structure, law, input="rest_length", sample_time=SAMPLE,
        equilibrium_input=tower().still,
    )  # fmt: skip
    nodes = tower().structure.nodes
    swapped = nodes[:, [3, 4, 5, 0, 1, 2, 6, 7, 8]]
    fast = np.zeros((3, 9))
    fast[0, 8] = 1e5
    for motion in ((swapped, np.zeros((3, 9))), (nodes, fast)):
        assert law.command(0.0, *motion).status is Status.MEASUREMENT_NOT_PLAUSIBLE
    assert len(calls) == 7


def test_winches_and_stuck_winches_are_those_of_the_loop():
    def law(time, nodes, velocities):
        return tower().still + 0.05

    fault = tc.StuckWinch(2, 0.05)
    run = simulated(law, sample_time=SAMPLE, winches=tc.Winches(rate=0.1), faults=[fault])
    moved = run.control.applied - tower().still[:, None]
    np.testing.assert_allclose(moved[0], 0.002 * np.arange(1, 11), rtol=1e-9)
    np.testing.assert_allclose(moved[2, 3:], 0.006, rtol=1e-9)
    assert run.control.rate_limited.min() >= 11


def test_a_status_of_its_own_is_kept():
    def law(time, nodes, velocities):
        return Command(tower().still, Status.UNREACHED, detail="as far as it goes")

    control = simulated(law, sample_time=SAMPLE).control
    assert set(control.status) == {Status.UNREACHED}
    assert set(control.detail) == {"as far as it goes"}


# ---- what is wrong ----


def failing(error, at):
    def law(time, nodes, velocities):
        if time >= at:
            raise error
        return tower().still

    return law


def test_an_exception_comes_with_the_motion_so_far():
    with pytest.raises(tc.simulation.SimulationError) as raised:
        simulated(failing(ZeroDivisionError("by my own fault"), 0.1), sample_time=SAMPLE)
    error = raised.value
    assert "stopped at 0.1 s of motion: the controller law raised ZeroDivisionError: by my own" in (
        str(error)
    )
    assert isinstance(error.__cause__, ZeroDivisionError)
    assert "in law" in "".join(traceback.format_exception(error))
    assert error.trajectory.time[-1] == pytest.approx(0.1)
    assert error.trajectory.control.status_count == {OK: 5}


def test_an_exception_at_the_first_sample_goes_through():
    with pytest.raises(KeyError, match="mine") as raised:
        simulated(failing(KeyError("mine"), 0.0), sample_time=SAMPLE)
    (note,) = raised.value.__notes__
    assert note == "the controller law raised KeyError: 'mine', at 0 s"


def test_memory_errors_are_no_data():
    with pytest.raises(MemoryError):
        simulated(failing(MemoryError(), 0.1), sample_time=SAMPLE)


RETURNED = {
    "nothing": (None, TypeError, r"the command of law is None, expected an array"),
    "a number": (1.0, ValueError, r"command of law has shape \(\), expected \(12,\): one rest len"),
    "too few": ([1.0] * 3, ValueError, r"command of law has shape \(3,\), expected \(12,\)"),
    "a column": (np.ones((12, 1)), ValueError, r"shape \(12, 1\), expected \(12,\)"),
    "text": ("slowly", TypeError, r"the command of law "),
    "complex": (np.ones(12) * 1j, TypeError, r"the command of law "),
    "a status": (Command(np.ones(12), "fine"), TypeError, r"status of the command of law is a str"),
}


@pytest.mark.parametrize("case", RETURNED)
def test_what_is_no_command_is_named(case):
    value, kind, message = RETURNED[case]

    def law(time, nodes, velocities):
        return value

    with pytest.raises(kind, match=message):
        simulated(law, sample_time=SAMPLE)


REFUSED = {
    "a class": (lambda: simulated(Holds), TypeError, r"controller is the class Holds.*Holds\("),
    "a number": (lambda: simulated(3.0), TypeError, r"controller is a float, expected"),
    "other arguments": (
        lambda: simulated(lambda t, x: x, sample_time=SAMPLE), TypeError,
        r"has the arguments \(t, x\), expected \(time, nodes, velocities\)"),
    "no sample time": (
        lambda: simulated(hold, step=None), ValueError, r"give sample_time, or a step"),
    "two sample times": (
        lambda: simulated(Holds(), sample_time=0.01), ValueError, r"sample time of its own, 0\.02"),
    "sample time text": (
        lambda: simulated(hold, sample_time="x"), TypeError, r"sample_time is 'x'"),
    "no input": (
        lambda: tc.FunctionController(tower().structure, hold), ValueError, r"input is not given"),
    "another input": (
        lambda: tc.FunctionController(tower().structure, hold, input="gamma"), ValueError,
        r"input is 'gamma'"),
    "no structure": (
        lambda: tc.FunctionController(hold, hold, input="rest_length"), TypeError,
        r"structure is a function, expected Structure"),
    "no function": (
        lambda: tc.FunctionController(tower().structure, 1, input="rest_length"), TypeError,
        r"function is a int, expected"),
    "rest lengths of zero": (
        lambda: tc.FunctionController(tower().structure, hold, input="rest_length", low=0.0),
        ValueError, r"low\[0\] is 0"),
    "γ below zero": (
        lambda: tc.FunctionController(tower().structure, hold, input="force_density", low=-1.0),
        ValueError, r"low\[0\] is -1.*can only pull"),
    "crossed bounds": (
        lambda: tc.FunctionController(tower().structure, hold, input="rest_length", low=2, high=1),
        ValueError, r"high\[0\] is 1, expected at least low\[0\] = 2"),
    "high of another count": (
        lambda: tc.FunctionController(tower().structure, hold, input="rest_length", high=[1, 2]),
        ValueError, r"high has shape \(2,\)"),
    "changes without samples": (
        lambda: tc.FunctionController(tower().structure, hold, input="rest_length", max_change=1),
        ValueError, r"max_change limits changes.*give sample_time"),
    "another structure": (
        lambda: simulated(tc.FunctionController(tc.prism(), hold, input="rest_length"),
                          sample_time=SAMPLE),
        ValueError, r"designed on Structure\(6 nodes.*but the model has"),
    "rest lengths where γ is held": (
        lambda: simulated(Holds(), input="force_density", rest_length=None), ValueError,
        r"commands rest lengths; input='force_density' cannot follow"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused(case):
    call, kind, message = REFUSED[case]
    with pytest.raises(kind, match=message):
        call()


def test_it_is_not_written_as_c_code(tmp_path):
    law = tc.FunctionController(tower().structure, Holds())
    with pytest.raises(TypeError, match=r"FunctionController of Holds.*only these"):
        tc.generate_c(law, tmp_path / "c")
    with pytest.raises(TypeError, match=r"controller is a function"):
        tc.generate_c(hold, tmp_path / "c")


def test_strings_that_reach_any_force_density_need_no_limit():
    structure = tower().structure
    model = tc.Model(structure, strings=tc.ElasticStrings(300.0, damping=0.5))
    gamma, sample = tower().rest.force_density, {"sample_time": SAMPLE, "step": STEP}
    free = tc.FunctionController(structure, lambda *_: gamma, input="force_density")
    run = tc.simulate(model, 0.1, controller=free, **sample)
    np.testing.assert_allclose(run.force_density[:, 0], gamma, rtol=1e-12)
