"""The BLAS has one thread where its own would slow down matrices of some hundred rows."""

import copy
import os
import pickle
import subprocess
import sys
import warnings
from threading import Event, Thread

import numpy as np
import pytest
import scipy.linalg
from threadpoolctl import ThreadpoolController

import tenscontrol as tc
from tenscontrol.control import Command, Controller
from tenscontrol.dynamics.evaluator import Exclusive

BLAS = ThreadpoolController().select(user_api="blas")


def threads():
    """The threads that each BLAS may use."""
    return [library.num_threads for library in BLAS.lib_controllers]


def let_each_have(count):
    """Set the threads in a thread that ends: one that lives would keep the others out."""
    worker = Thread(target=lambda: [each.set_num_threads(count) for each in BLAS.lib_controllers])
    worker.start()
    worker.join()


@pytest.fixture(autouse=True)
def several():
    """Let each BLAS have three threads, whatever the machine and the environment say."""
    before = max(threads())
    let_each_have(3)
    if set(threads()) != {3}:
        pytest.skip("this BLAS does not say how many threads it has")
    yield
    let_each_have(before)


class Counting(Controller):
    """Notes how many threads the BLAS has while it decides."""

    def _decide(self, time, state):
        self.seen = threads()
        if time < 0:
            raise ArithmeticError
        return Command(self.plant.equilibrium_input)


def counting(structure):
    rest = tc.prestress(structure, min_force_density=5.0)
    plant = tc.linearize(tc.Model(structure), rest)
    many = np.full(len(structure.strings), 1e3)
    return Counting(plant, 0.02, np.zeros(len(many)), many)


@pytest.fixture(scope="module")
def large():
    return counting(tc.library.class2_tower(stages=5))


def test_a_command_of_a_large_plant_has_one_thread(large):
    for each in (large, copy.deepcopy(large), pickle.loads(pickle.dumps(large))):
        each.command(0.0, each.plant.nodes, np.zeros_like(each.plant.nodes))
        assert set(each.seen) == {1}
        assert set(threads()) == {3}


def test_afterwards_there_are_as_many_as_before_whatever_happens(large):
    with pytest.raises(ArithmeticError):
        large.command(-1.0, large.plant.nodes, np.zeros_like(large.plant.nodes))
    assert set(large.seen) == {1}
    assert set(threads()) == {3}


def test_small_plants_leave_the_threads_alone(prism):
    small = counting(prism)
    small.command(0.0, prism.nodes, np.zeros_like(prism.nodes))
    assert set(small.seen) == {3}


def test_small_plants_do_not_ask_for_the_threads():
    code = (
        "import sys, numpy as np, tenscontrol as tc\n"
        "prism = tc.prism()\n"
        "plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=20.0))\n"
        "plant.basis @ plant.basis.T\n"
        "print('threadpoolctl' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False"]


def test_a_run_has_one_thread_from_start_to_end(large):
    def own(time, nodes, velocities):
        seen.append(threads())
        return large.plant.equilibrium_input

    seen = []
    model = large.plant.model
    tc.simulate(model, 0.06, controller=large)
    assert set(large.seen) == {1}
    # A function of the user's own has the threads that the user gave.
    law = tc.FunctionController(model.structure, own, input="force_density", sample_time=0.02)
    tc.simulate(model, 0.06, controller=law)
    assert seen
    assert {count for each in seen for count in each} == {3}


def test_designs_have_one_thread(monkeypatch, large):
    seen = []
    solve = scipy.linalg.lu_factor

    def counted(*arguments, **keywords):
        seen.append(threads())
        return solve(*arguments, **keywords)

    monkeypatch.setattr(scipy.linalg, "lu_factor", counted)
    tc.LQR(large.plant, sample_time=0.02)
    assert seen
    assert {count for each in seen for count in each} == {1}
    assert set(threads()) == {3}


def test_contexts_are_nested_and_shared_by_threads():
    entered, leave = Event(), Event()
    seen = []

    def other():
        with Exclusive("one", 1000), Exclusive("another", 1000):
            seen.append(threads())
            entered.set()
            leave.wait()
            seen.append(threads())
        seen.append(threads())

    worker = Thread(target=other, daemon=True)
    with Exclusive("first", 1000), Exclusive("nested", 65):
        worker.start()
        entered.wait()
    # The first thread has left, and the other one is still within.
    assert set(threads()) == {1}
    with Exclusive("again", 1000):
        assert set(threads()) == {1}
    assert set(threads()) == {1}
    leave.set()
    worker.join()
    assert [set(each) for each in seen] == [{1}, {1}, {3}]
    with Exclusive("large", 65), Exclusive("small", 64):
        assert set(threads()) == {1}
    assert set(threads()) == {3}
    with Exclusive("small", 64):
        assert set(threads()) == {3}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
def test_a_fork_while_another_thread_is_within_goes_on():
    entered, leave = Event(), Event()

    def other():
        with Exclusive("one", 1000):
            entered.set()
            leave.wait()

    worker = Thread(target=other, daemon=True)
    worker.start()
    entered.wait()
    with warnings.catch_warnings(action="ignore", category=DeprecationWarning):  # of 3.12
        child = os.fork()
    if not child:
        with Exclusive("in the child", 1000):
            os._exit(int(set(threads()) != {1}))
    leave.set()
    worker.join()
    assert os.waitpid(child, 0)[1] == 0
