"""Threads: what builds takes one lock, what has a memory refuses a second thread."""

import copy
import copyreg
import gc
import pickle
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy import peers
from tenscontrol.accuracy.converged_motion import PiecewiseSolver
from tenscontrol.accuracy.open_loop import fastest_rate
from tenscontrol.dynamics.evaluator import BUILDING, Evaluator, Function, Prepared
from tests.accuracy.test_peers import prism_case
from tests.dynamics.building import unlocked_calls
from tests.fuzz import threads as fuzz
from tests.robustness.cases import Inline, loop_case

STILL = np.zeros((3, 6))


def elsewhere(function):
    """Return what a function returns in another thread."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(function).result(timeout=60)


def through_pickle(value):
    return pickle.loads(pickle.dumps(value))


@pytest.mark.parametrize("job", fuzz.JOBS.values(), ids=fuzz.JOBS)
def test_all_that_builds_holds_the_lock(job):
    with unlocked_calls() as found:
        job(0)
    assert found == set()


@pytest.mark.parametrize(
    "form", [pytest.param(form, id=form) for form in ("flat", "mapped", "loops")]
)
def test_equations_of_every_form_are_built_under_the_lock(form):
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(100.0))
    with unlocked_calls() as found:
        equation = model.equation("rest_length", form=form)
        assert equation.kinked_slope.n_in() == 2
    assert found == set()


def test_writing_c_code_holds_the_lock(tmp_path):
    controller = tc.MPC(fuzz.plant_of(fuzz.SHARED), sample_time=0.02, horizon=4)
    with unlocked_calls() as found:
        tc.generate_c(controller, tmp_path / "code")
    assert found == set()


def test_the_accuracy_of_a_case_holds_the_lock():
    case = prism_case(duration=0.05)
    with unlocked_calls() as found:
        fastest_rate(case)
        PiecewiseSolver(case)
        for peer in (peers.SciPy("Radau"), peers.CasADiCVODES(), peers.CasADiRK()):
            peer.prepare(case, peer.settings[0], np.linspace(0.025, 0.05, 2))
    assert found == set()


def test_the_look_for_unlocked_calls_sees_one():
    def unlocked():
        return fuzz.SHARED._symbols()

    with unlocked_calls() as found:
        unlocked()
    assert any("_symbols" in each for each in found)


class TestLock:
    def test_a_second_thread_waits(self):
        model, started, order = tc.Model(tc.prism()), threading.Event(), []

        def build():
            started.set()
            model.acceleration  # noqa: B018
            order.append("built")

        with ThreadPoolExecutor(1) as pool:
            with BUILDING:
                future = pool.submit(build)
                started.wait()
                order.append("let go")
            future.result(timeout=60)
        assert order == ["let go", "built"]

    def test_what_is_built_once_is_read_while_another_thread_builds(self):
        store = Prepared()
        store.get("a", lambda: 1)
        with BUILDING:
            assert elsewhere(lambda: store.get("a", lambda: 2)) == 1

    def test_a_function_that_was_never_made_is_dropped_in_silence(self):
        """Ctrl-C may end its making."""
        Function.__del__(Function.__new__(Function))
        Evaluator.__del__(Evaluator.__new__(Evaluator))

    @pytest.mark.parametrize("of", [Function, Evaluator])
    def test_what_is_dropped_is_freed_under_the_lock(self, of):
        Function._dropped.clear()
        x = ca.SX.sym("x")
        kept = [of(ca.Function("f", [x], [x + 0.5]))]
        last = Function("f", [x], [x])
        with BUILDING:
            elsewhere(kept.clear)
            assert Function._dropped
        del last
        assert not Function._dropped

    def test_garbage_is_collected_while_another_thread_builds(self):
        x = ca.SX.sym("x")
        loop = [Function("f", [x], [x * 0.5])]
        loop.append(loop)
        del loop
        with BUILDING:
            elsewhere(gc.collect)
            assert Function._dropped
        tc.Model(tc.prism()).dynamics  # noqa: B018
        assert not Function._dropped

    def test_casadi_and_pickle_are_left_as_they_are(self):
        assert "__del__" not in vars(ca.Function)
        assert ca.Function not in copyreg.dispatch_table
        assert isinstance(tc.Model(tc.prism()).dynamics, Function)

    @pytest.mark.parametrize(
        "copied", [copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))]
    )
    def test_pickles_wait_for_it(self, copied):
        function = tc.Model(tc.prism()).dynamics
        x, gamma = np.arange(36.0), np.ones(9)
        with ThreadPoolExecutor(1) as pool:
            with BUILDING:
                future = pool.submit(pickle.dumps, function)
                with pytest.raises(TimeoutError):
                    future.result(timeout=0.05)
            assert future.result(timeout=60)
        np.testing.assert_array_equal(copied(function)(x, gamma), function(x, gamma))

    @pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="no fork")
    def test_a_fork_waits_for_it(self):
        code = (
            "import os, threading, tenscontrol as tc\n"
            "from tenscontrol.dynamics import BUILDING\n"
            "held, free = threading.Event(), threading.Event()\n"
            "def hold():\n"
            "    with BUILDING:\n"
            "        held.set(); free.wait()\n"
            "threading.Thread(target=hold).start(); held.wait()\n"
            "threading.Timer(0.1, free.set).start()\n"
            "child = os.fork()\n"
            "tc.Model(tc.prism()).dynamics\n"
            "if child == 0: os._exit(0)\n"
            "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
        )
        run = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", code],
            capture_output=True, text=True, timeout=120, check=True,
        )  # fmt: skip
        assert run.stdout.strip() == "0"


REFUSED = "in use by another thread"


class TestMemory:
    @pytest.mark.parametrize("name", fuzz.TOGETHER)
    @pytest.mark.parametrize("method", ["command", "reset", "applied", "follow"])
    def test_a_controller_refuses_a_second_thread(self, name, method):
        controller = fuzz.TOGETHER[name]
        value = controller.plant.equilibrium_input
        given = {
            "command": (0.0, fuzz.PRISM.nodes, STILL), "reset": (), "applied": (value,),
            "follow": (fuzz.PRISM.nodes,),
        }[method]  # fmt: skip
        with controller.in_use:
            with pytest.raises(RuntimeError, match=f"{type(controller).__name__} is {REFUSED}"):
                elsewhere(lambda: getattr(controller, method)(*given))
            getattr(controller, method)(*given)  # the same thread may
        elsewhere(lambda: getattr(controller, method)(*given))

    def test_a_controller_of_ones_own_does_too(self):
        class Held(tc.control.Controller):
            def _decide(self, time, state):
                inside.set()
                go_on.wait()
                return tc.control.Command(self.plant.equilibrium_input)

        inside, go_on = threading.Event(), threading.Event()
        plant = fuzz.plant_of(fuzz.SHARED)
        controller = Held(plant, 0.02, np.zeros(9), np.full(9, 60.0))
        with ThreadPoolExecutor(1) as pool:
            first = pool.submit(controller.command, 0.0, fuzz.PRISM.nodes, STILL)
            inside.wait()
            with pytest.raises(RuntimeError, match=f"this Held is {REFUSED}"):
                controller.command(0.0, fuzz.PRISM.nodes, STILL)
            go_on.set()
            assert first.result().value.shape == (9,)

    def test_a_simulation_keeps_its_controller_and_filter(self):
        plant = fuzz.plant_of(fuzz.SHARED)
        sensors = tc.Sensors(structure=fuzz.PRISM, string_length=1e-3, node_position=5e-3)
        estimator = tc.KalmanFilter(plant, sensors, sample_time=0.02)
        controller = tc.LQR(plant, sample_time=0.02)
        found = []

        def look(time):
            for used in (controller, estimator):
                with pytest.raises(RuntimeError, match=REFUSED):
                    elsewhere(used.reset)
                found.append(used)
            return fuzz.lengths(0)

        decide = controller._decide
        controller._decide = lambda time, state: look(time) is None or decide(time, state)
        tc.simulate(fuzz.SHARED, 0.02, controller=controller, estimator=estimator, error="none")
        assert found == [controller, estimator]
        controller.reset(), elsewhere(estimator.reset)

    def test_a_copy_is_free(self):
        controller = fuzz.TOGETHER["NMPC"]
        with controller.in_use:
            copies = copy.deepcopy(controller), pickle.loads(pickle.dumps(controller))
            for each in copies:
                command = elsewhere(lambda each=each: each.command(0.0, fuzz.PRISM.nodes, STILL))
                assert command.value.shape == (9,)

    def test_an_evaluator_refuses_a_second_thread(self):
        x = ca.SX.sym("x")
        evaluator = Evaluator(ca.Function("f", [x], [x**2]))

        class Slow:
            def __array__(self, dtype=None, copy=None):
                with pytest.raises(RuntimeError, match=f"this Evaluator is {REFUSED}"):
                    elsewhere(lambda: evaluator(2.0))
                return np.array(3.0)

        assert evaluator(Slow())[0] == 9.0
        assert elsewhere(lambda: evaluator(2.0)[0].copy()) == 4.0


@pytest.fixture(scope="module")
def case():
    plant = fuzz.plant_of(fuzz.SHARED)
    Q, R = tc.energy_weights(plant)
    controller = tc.LQR(plant, Q, 0.1 * R, sample_time=0.02)
    law = tc.LinearStrings(100.0, damping=0.5)
    return loop_case(fuzz.PRISM, law, controller, duration=0.1, step=5e-3, tolerance=0.03)


def report(case, executor):
    drawn = {"stiffness": tc.Uniform(0.7, 1.3, size=9)}
    return tc.sweep(case, drawn, 4, seed=0, executor=executor)


def test_a_sweep_over_threads_gives_the_report_of_one(case):
    with ThreadPoolExecutor(4) as executor:
        assert report(case, executor) == report(case, Inline())


def test_a_sweep_over_threads_of_dask_does_too(case):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=4, processes=False, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        assert report(case, client.get_executor()) == report(case, Inline())


def test_runs_by_threads_give_the_numbers_of_one():
    command = [sys.executable, "-m", "tests.fuzz.threads", "--seconds", "0.2", "--designs", "2"]
    jobs = ("linearize", "mpc", "pickled", "rk4 shared", "cvodes shared")
    run = subprocess.run(
        [*command, "--jobs", *jobs], capture_output=True, text=True, timeout=540, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr
