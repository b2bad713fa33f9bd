"""Children that are forked while another thread is within a lock, or computes a property."""

import os
import signal
import warnings
from threading import Event, Thread

import pytest

from tenscontrol.dynamics.evaluator import Prepared, ProcessLock
from tenscontrol.properties import cached_property

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")


def status_of_a_fork(child, within):
    """Return the status of a child that does something, forked while a thread is within.

    ``within`` takes a function that is to be called where the thread shall wait.
    """
    entered, leave = Event(), Event()

    def wait():
        entered.set()
        leave.wait()

    worker = Thread(target=within, args=(wait,), daemon=True)
    worker.start()
    assert entered.wait(60)
    with warnings.catch_warnings(action="ignore", category=DeprecationWarning):  # of 3.12
        process = os.fork()
    if not process:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(5)  # what hangs is ended
        child()
        os._exit(0)
    leave.set()
    worker.join()
    return os.waitpid(process, 0)[1]


def test_a_property_that_another_thread_computes():
    class Slow:
        def __init__(self, wait=lambda: None):
            self.wait = wait

        @cached_property
        def value(self):
            self.wait()
            return 1

    assert status_of_a_fork(lambda: Slow().value, lambda wait: Slow(wait).value) == 0


def test_a_lock_that_another_thread_holds():
    lock = ProcessLock()

    def hold(wait):
        with lock:
            wait()

    def take():
        with lock:
            pass

    assert status_of_a_fork(take, hold) == 0
    with lock:  # and it is one
        other = Thread(target=take, daemon=True)
        other.start()
        other.join(0.05)
        assert other.is_alive()
    other.join(60)
    assert not other.is_alive()


def test_what_is_prepared_while_another_thread_looks_it_up():
    store = Prepared()

    class Key:
        """A key whose comparison waits: a lookup that a fork comes in the middle of."""

        wait = staticmethod(lambda: None)

        def __hash__(self):
            return 1

        def __eq__(self, other):
            self.wait(), other.wait()
            return True

    key = Key()
    store.get(key, lambda: "kept")

    def look(wait):
        other = Key()
        other.wait = wait
        assert store.get(other, lambda: None) == "kept"

    assert status_of_a_fork(lambda: store.get(key, lambda: None), look) == 0


def test_threads_agree_on_the_value_of_a_property():
    started, go_on = Event(), Event()

    class Object:
        made = 0

        @cached_property
        def value(self):
            self.made += 1
            if self.made == 1:
                started.set()
                go_on.wait(60)
            return [self.made]

    one = Object()
    found = []
    first = Thread(target=lambda: found.append(one.value))
    first.start()
    started.wait(60)
    now = one.value
    go_on.set()
    first.join()
    assert found[0] is now
