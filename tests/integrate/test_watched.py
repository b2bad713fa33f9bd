"""The method that watches others: pauses, changes of the method, failures."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.integrate import (
    DOP853,
    IntegrationError,
    IntegrationInterrupt,
    IntegrationPause,
    Integrator,
    Span,
    Watched,
    Work,
)
from tenscontrol.integrate.methods import METHODS
from tenscontrol.integrate.watched import WATCHED
from tests.dynamics.scenes import paper_force_density, rest_lengths
from tests.marks import needs_core
from tests.without_core import without_core

PRISM = tc.prism()
LENGTHS = rest_lengths(PRISM, paper_force_density(9.0), 100.0)
EQUATION = tc.Model(PRISM, strings=tc.LinearStrings(100.0)).equation("rest_length")
START = pack_state(PRISM, PRISM.nodes, np.zeros((3, 6)))
DURATION = 1.0

# With these they take some work: each looks at its evaluations only now and then.
TOLERANCES = {"dop853": 1e-12, "cvodes": 1e-8, "energy_momentum": 1e-7}


def by(name, tolerance=None):
    tolerance = TOLERANCES[name] if tolerance is None else tolerance
    return METHODS[name].integrator(EQUATION, tolerance, "tolerance")


def watched(make=by, first="dop853", duration=DURATION):
    return Watched(EQUATION, first, make, duration)


@pytest.fixture(scope="module")
def exact():
    return by("dop853", 1e-13).advance(START, LENGTHS, DURATION, 10).states


# ---- pauses ----


@pytest.mark.parametrize(("name", "error"), [*zip(WATCHED, (1e-6, 1e-4, 1e-2), strict=True)])
def test_a_motion_with_pauses_is_that_without(name, error, exact):
    """Through switches; a pause is where the evaluations are used up."""
    method = by(name)
    method.limit = method.advance(START, LENGTHS, DURATION, 1).work.evaluations / 5
    state, time, pauses = START, 0.0, []
    while time < DURATION:
        try:
            state = method.advance(state, LENGTHS, DURATION - time, 1).states[:, -1]
            time = DURATION
        except IntegrationPause as pause:
            pauses.append(pause)
            state, time = pause.state, time + pause.time
    assert len(pauses) >= 2
    assert all(pause.time > 0 for pause in pauses)
    assert all(pause.span.work.evaluations >= method.limit for pause in pauses)
    assert np.abs(state - exact[:, -1]).max() < error


@pytest.mark.parametrize("name", WATCHED)
def test_outputs_before_a_pause_are_told(name, exact):
    method = by(name)
    method.limit = method.advance(START, LENGTHS, DURATION, 10).work.evaluations / 2
    with pytest.raises(IntegrationPause) as info:
        method.advance(START, LENGTHS, DURATION, 10)
    pause = info.value
    count = int(10 * pause.time / DURATION)
    assert 0 < count < 10
    assert pause.span.states.shape == (36, count)
    assert np.abs(pause.span.states - exact[:, :count]).max() < 1e-3
    drift = np.linalg.norm(PRISM.bar_vectors(pause.state[:18].reshape(6, 3).T), axis=0)
    np.testing.assert_allclose(drift, PRISM.bar_length, rtol=1e-12)


def keeping(name):
    method = by(name)
    method.keeps_steps = True
    return method


@needs_core
def test_ends_of_steps_are_kept_over_pauses(monkeypatch):
    monkeypatch.setattr("tenscontrol.integrate.watched._FREE", 1e2)
    pauses, advance = [], DOP853.advance

    def counted(*given):
        try:
            return advance(*given)
        except IntegrationPause as pause:
            pauses.append(pause)
            raise

    monkeypatch.setattr(DOP853, "advance", counted)
    span = watched(keeping).advance(START, LENGTHS, DURATION, 3)
    ends = span.ends
    assert len(pauses) >= 2
    assert len(ends.time) == ends.states.shape[1] == span.work.steps
    assert (np.diff(ends.time) > 0).all()
    assert ends.time[-1] == pytest.approx(DURATION, rel=1e-12)
    np.testing.assert_array_equal(ends.states[:, -1], span.states[:, -1])
    for k in (len(ends.time) // 3, len(ends.time) // 2):
        there = by("dop853").advance(START, LENGTHS, float(ends.time[k]), 1).states[:, 0]
        np.testing.assert_allclose(ends.states[:, k], there, atol=1e-8)


# ---- changes of the method ----


@pytest.fixture
def no_grace(monkeypatch):
    """Compare methods soon, and count an evaluation of the method of order 8 as a thousand."""
    for name in ("_FREE", "_LEAST_TRIAL", "_MAKING", "_MAKING_A_STATE"):
        monkeypatch.setattr(f"tenscontrol.integrate.watched.{name}", 5e3)
    monkeypatch.setattr(DOP853, "cost", 1e3)


def looser(name):
    return by(name, 1e-12 if name == "dop853" else 1e-6)


@pytest.mark.usefixtures("no_grace")
def test_a_slow_method_is_left(exact):
    method = watched(looser)
    span = method.advance(START, LENGTHS, DURATION, 10)
    assert method.changes
    change = method.changes[0]
    assert change.method in WATCHED[1:]
    assert 0 < change.time < DURATION / 2
    assert change.reason.endswith("times as far as dop853")
    assert np.abs(span.states - exact).max() < 1e-2
    assert span.work.rejections > 0  # the trials that were given up


@pytest.mark.usefixtures("no_grace")
def test_ends_of_some_steps_alone_are_not_told():
    """CVODES keeps none."""

    def keeping_some(name):
        return keeping(name) if name == "dop853" else looser(name)

    method = watched(keeping_some)
    assert method.advance(START, LENGTHS, DURATION, 10).ends is None
    assert method.changes[0].method in WATCHED[1:]


@pytest.mark.usefixtures("no_grace")
def test_numbers_are_the_same_each_time():
    motions = []
    for _ in range(2):
        method = watched(looser)
        motions.append((method.advance(START, LENGTHS, DURATION, 10), method.changes))
    np.testing.assert_array_equal(motions[0][0].states, motions[1][0].states)
    assert motions[0][0].work == motions[1][0].work
    assert motions[0][1] == motions[1][1] != ()


@pytest.mark.usefixtures("no_grace")
def test_spans_count_together(exact):
    """Short samples, as under a controller: the budget is that of the whole motion."""
    method, state = watched(looser), START
    for _ in range(50):
        state = method.advance(state, LENGTHS, DURATION / 50, 1).states[:, -1]
    assert method.changes
    assert 0 < method.changes[0].time < DURATION
    assert np.abs(state - exact[:, -1]).max() < 1e-2


@pytest.mark.usefixtures("no_grace")
def test_a_part_again_takes_no_more_than_the_motion_did(exact, monkeypatch):
    """Implicit steps of a part may be many where explicit ones are few."""
    method = watched(looser)
    method.advance(START, LENGTHS, DURATION, 10)
    last, _ = method._made[method.changes[-1].method]
    limits = []

    def pause(*_):
        limits.append(last.limit)
        raise IntegrationPause(0.0, START, Span(np.empty((36, 0)), Work()))

    monkeypatch.setattr(last, "advance", pause)
    for _ in range(2):  # the second time the other method goes first
        span = method.advance(START, LENGTHS, DURATION / 10, 1)
        assert np.abs(span.states[:, 0] - exact[:, 0]).max() < 1e-2
    assert limits == [method._spent / last.cost]


def test_what_is_cheap_is_left_alone():
    method = watched()
    alone = by("dop853").advance(START, LENGTHS, DURATION, 10)
    span = method.advance(START, LENGTHS, DURATION, 10)
    np.testing.assert_array_equal(span.states, alone.states)
    assert span.work == alone.work
    assert method.changes == ()


# ---- failures ----


class Failing(Integrator):
    """A method that does not get past a time."""

    name = "failing"

    def __init__(self, until):
        super().__init__(EQUATION)
        self._within, self._left = by("dop853"), until

    def advance(self, state, held, duration, outputs, report=None):
        self._checked(state, held, duration, outputs, report)
        steps = int(min(1.0, self._left / duration) * outputs + 1e-9)
        if steps == outputs:
            self._left -= duration
            return self._within.advance(state, held, duration, outputs)
        span = Span(np.empty((36, 0)), Work())
        if steps:
            span = self._within.advance(state, held, duration * steps / outputs, steps)
        raise IntegrationError("it is stuck", self._left, span)


def test_another_method_gets_past_a_failure(exact):
    method = watched(lambda name: Failing(0.46) if name == "dop853" else by(name))
    span = method.advance(START, LENGTHS, DURATION, 10)
    (change,) = method.changes
    assert change.time == pytest.approx(0.4)
    assert change.reason == "it is stuck"
    assert np.abs(span.states - exact).max() < 1e-3


def test_a_failure_of_all_methods_is_one_failure(exact):
    method = watched(lambda name: Failing(0.46))
    with pytest.raises(IntegrationError, match=r"it is stuck\. Of the other methods") as info:
        method.advance(START, LENGTHS, DURATION, 10)
    assert info.value.time == pytest.approx(0.46)
    assert np.abs(info.value.span.states - exact[:, :4]).max() < 1e-6


def test_an_interruption_returns_the_motion_up_to_it(exact):
    def stop(time):
        if time > 0.6:
            raise KeyboardInterrupt

    with pytest.raises(IntegrationInterrupt) as info:
        watched(first="cvodes").advance(START, LENGTHS, DURATION, 10, stop)
    states = info.value.span.states
    assert 0 < states.shape[1] < 10
    assert np.abs(states - exact[:, : states.shape[1]]).max() < 1e-2


def test_arguments_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="first is 'rk4', expected one of"):
        watched(first="rk4")
    with pytest.raises(ValueError, match=r"duration is 0\.0"):
        watched(duration=0.0)


# ---- runs ----


def stiff_and_damped():
    """Strings of 1 MN/m, damped nearly critically: an explicit method follows what is at rest."""
    law = tc.LinearStrings(1e6, 1e4)
    lengths = rest_lengths(PRISM, paper_force_density(45.0), 1e6)
    return tc.Model(PRISM, strings=law), lengths


@without_core()  # where an explicit step costs a hundredth, none is too short
def test_a_run_says_which_methods_it_took(tmp_path):
    model, lengths = stiff_and_damped()
    spin = np.cross([1.0, 0.0, 0.0], PRISM.nodes.T).T
    given = {"velocities": spin, "rest_length": lengths, "output_step": 0.1}
    run = tc.simulate(model, 1.0, **given)
    assert run.choice.methods == ("dop853", run.choice.changes[0].method)
    assert 0 < run.choice.changes[0].time < 0.5
    exact = tc.simulate(model, 1.0, method="cvodes", tolerance=1e-8, **given)
    assert np.abs(run.nodes - exact.nodes).max() < 1e-2
    assert f"by dop853, then {run.choice.changes[0].method}" in run.summary()
    assert run.choice.changes[0].reason in run.summary()
    assert tc.load_run(run.save(tmp_path / "run.npz")).choice == run.choice
    how = tc.Integration(output_step=0.1)
    scene = tc.Scene(model, 1.0, rest_length=lengths, integration=how)
    batch = tc.simulate_many(scene, {"velocities": np.array([spin, spin])})
    np.testing.assert_array_equal(batch.nodes[1], run.nodes)
    assert batch.trajectory(1).choice.changes == run.choice.changes
