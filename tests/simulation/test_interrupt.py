"""Ctrl-C and SIGTERM in simulations: the motion up to there comes back, with its records."""

import os
import signal
import threading
import time
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import csc_array

import tenscontrol as tc
from tenscontrol import interrupt
from tenscontrol.control import Command, Controller, Status
from tenscontrol.control.mpc.osqp_solver import OSQPSolver
from tenscontrol.interrupt import InterruptionWarning, finishing, interruptible
from tenscontrol.simulation import assembly, error_estimate, plant_run, scene
from tests.dynamics.scenes import paper_force_density, rest_lengths

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

SAMPLE = 0.02
METHODS = [
    ("rk4", {"step": 1e-3}),
    ("dop853", {"tolerance": 1e-9}),
    ("cvodes", {"tolerance": 1e-9}),
    ("energy_momentum", {"step": 1e-3}),
]


@pytest.fixture(scope="module")
def example():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    rest = tc.prestress(prism, force_density=17.3205)
    plant = tc.linearize(model, rest, input="rest_length")
    return SimpleNamespace(model=model, lengths=lengths, rest=rest, plant=plant)


class Told:
    """In place of a progress bar: sends a signal once so much of the motion is done."""

    def __init__(self, moment, number):
        self.moment, self.number, self.done = moment, number, False

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def __call__(self, reached):
        if reached >= self.moment and not self.done:
            self.done = True
            signal.raise_signal(self.number)


def end_sigterm(example):
    """The next run after SIGTERM ends the program."""
    with pytest.raises(SystemExit):
        tc.simulate(example.model, 0.01, rest_length=example.lengths, step=1e-3)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["INT", "TERM"])
@pytest.mark.parametrize(("method", "options"), METHODS, ids=[name for name, _ in METHODS])
def test_open_loop(example, monkeypatch, method, options, number):
    told = Told(0.5, number)
    monkeypatch.setattr(scene, "progress_bar", lambda *_, **__: told)
    with pytest.warns(InterruptionWarning, match=r"stopped at .* s of motion: interrupted"):
        run = tc.simulate(
            example.model, 50.0, rest_length=example.lengths, method=method, output_step=0.01,
            progress=True, **options,
        )  # fmt: skip
    assert 0.5 <= run.time[-1] < 10
    assert run.nodes.shape[2] == len(run.time) == len(run.energy)
    assert np.isfinite(run.nodes).all()
    assert "interrupted" in run.stopped
    if number == signal.SIGTERM:
        end_sigterm(example)


def test_a_key_that_is_lost_while_a_run_is_built_still_ends_it(example, monkeypatch):
    def lost(*arguments, **named):
        with suppress(KeyboardInterrupt):  # CasADi does so in its conversions
            signal.raise_signal(signal.SIGINT)
        return initial_state(*arguments, **named)

    initial_state = scene.initial_state
    monkeypatch.setattr(scene, "initial_state", lost)
    with pytest.warns(InterruptionWarning, match=r"stopped at 0 s of motion: interrupted"):
        run = tc.simulate(example.model, 5.0, rest_length=example.lengths, step=1e-3)
    assert run.time.tolist() == [0.0]


class Pressed(Controller):
    """Holds the equilibrium; a key is pressed while it computes its tenth command."""

    def __init__(self, plant, press):
        count = plant.B.shape[1]
        super().__init__(plant, SAMPLE, np.full(count, 1e-3), np.full(count, 10.0))
        self.press, self.calls = press, 0

    def _decide(self, time, state):
        self.calls += 1
        if self.calls == 10:
            self.press()
        return Command(self.plant.equilibrium_input)


def twice():
    signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGINT)


def key_by_hand():
    raise KeyboardInterrupt


@pytest.mark.parametrize("estimated", [False, True], ids=["measured", "estimated"])
@pytest.mark.parametrize(
    "press", [lambda: signal.raise_signal(signal.SIGINT), twice, key_by_hand], ids=[1, 2, "raised"]
)
def test_in_a_command(example, press, estimated):
    """The sample whose command is interrupted has not begun; also with the second key."""
    estimator = None
    if estimated:
        kinds = {"string_length": 1e-3, "bar_direction": 1e-2, "node_position": 2e-3}
        sensors = tc.Sensors(structure=example.model.structure, **kinds)
        estimator = tc.KalmanFilter(example.plant, sensors, sample_time=SAMPLE)
    with pytest.warns(InterruptionWarning, match=r"stopped at 0\.18 s"):
        run = tc.simulate(
            example.model, 5.0, controller=Pressed(example.plant, press), estimator=estimator,
            step=1e-3,
        )  # fmt: skip
    assert run.time[-1] == pytest.approx(9 * SAMPLE)
    assert len(run.control.time) == len(run.control.status) == 9
    if estimated:
        assert run.control.estimate.nodes.shape[2] == len(run.control.estimate.status) == 9


def test_osqp_gives_the_key_back():
    """It has a handler of its own while it solves."""
    P, A = csc_array(np.diag([1.0, 1e-3])), csc_array(np.array([[1.0, 1.0], [1.0, -1.0]]))
    solver = OSQPSolver(P, A, tolerance=1e-30, max_iterations=20_000_000)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    with interruptible() as came:
        timer.start()
        found = solver.solve(np.ones(2), np.array([-1.0, 0.3]), np.array([1.0, 0.7]), None)
        timer.join()
    assert came.signal == signal.SIGINT
    assert found.status is Status.INTERRUPTED


@pytest.fixture
def pressed_in(monkeypatch):
    """A key is pressed when a function of the loop is called, once."""

    def press(module, name):
        original = getattr(module, name)

        def pressed(*arguments, **named):
            monkeypatch.setattr(module, name, original)
            signal.raise_signal(signal.SIGINT)
            return original(*arguments, **named)

        monkeypatch.setattr(module, name, pressed)

    return press


def test_a_key_while_the_trajectory_is_made(example, pressed_in):
    """The motion is complete, and is finished."""
    pressed_in(assembly, "MotionFunctions")
    with pytest.warns(InterruptionWarning, match="complete"):
        run = tc.simulate(example.model, 1.0, rest_length=example.lengths, step=1e-3)
    assert run.time[-1] == 1.0
    assert run.stopped is None


def test_a_key_while_the_error_is_estimated(example, pressed_in):
    pressed_in(error_estimate, "Motion")
    with pytest.warns(InterruptionWarning, match="complete"):
        run = tc.simulate(example.model, 1.0, rest_length=example.lengths, step=1e-3)
    assert run.time[-1] == 1.0
    assert run.error is None


def test_a_key_is_sent_again_to_the_loop_it_came_to_alone(monkeypatch):
    monkeypatch.setattr(interrupt, "_PATIENCE", 0.2)
    with interruptible():
        signal.raise_signal(signal.SIGINT)
    time.sleep(0.1)
    with interruptible() as came:
        with finishing(came):
            signal.raise_signal(signal.SIGINT)
        end = time.perf_counter() + 0.3
        while time.perf_counter() < end:
            pass
    assert came.signal == signal.SIGINT


def test_before_the_first_step_there_is_no_motion(example, monkeypatch):
    original = plant_run.PlantRun._prepare

    def pressed(self, *arguments):
        twice()
        return original(self, *arguments)

    monkeypatch.setattr(plant_run.PlantRun, "_prepare", pressed)
    with pytest.raises(KeyboardInterrupt):
        tc.simulate(example.model, 1.0, rest_length=example.lengths, step=1e-3)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_results_put_together_in_other_threads_leave_signals_alone():
    begun, over = threading.Event(), threading.Event()

    def other():
        with finishing():
            begun.set()
            over.wait(60)

    thread = threading.Thread(target=other)
    thread.start()
    begun.wait(60)
    try:
        with interruptible():
            signal.raise_signal(signal.SIGINT)
            with pytest.raises(KeyboardInterrupt):
                time.sleep(60)  # nothing checks, so it is ended
    finally:
        over.set()
        thread.join()
