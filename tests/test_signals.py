"""Ctrl-C and SIGTERM: kept for a safe point, never lost, and handlers of others left alone."""

# ruff: noqa: PT012 - what raises is the point of a block here
import os
import signal
import threading
import time

import pytest

from tenscontrol.interrupt import at_once, check, finishing, interruptible

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

BOTH = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["INT", "TERM"])


@pytest.fixture(autouse=True)
def usual_handlers():
    """Python's own, and none that a test leaves behind."""
    before = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    yield
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    for each, handler in before.items():
        signal.signal(each, handler)


def forget_sigterm():
    """The next loop after SIGTERM ends the program."""
    with pytest.raises(SystemExit) as info, interruptible():
        pytest.fail("a loop began after SIGTERM")
    assert info.value.code == 143
    with interruptible():
        check()


@BOTH
def test_a_signal_waits_for_a_check(number):
    done = []
    with pytest.raises(KeyboardInterrupt), interruptible() as came:
        check()
        signal.raise_signal(number)
        done.append("the step")
        check()
        done.append("the next step")
    assert done == ["the step"]
    assert came.signal == number
    assert came.status == 128 + number
    if number == signal.SIGTERM:
        forget_sigterm()


def test_a_second_signal_raises_at_once():
    with pytest.raises(KeyboardInterrupt), interruptible():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        pytest.fail("the second was kept")


@BOTH
def test_a_loop_that_never_checks_is_ended(number):
    """Also one that waits in a call of the system."""
    with pytest.raises(KeyboardInterrupt), interruptible():
        signal.raise_signal(number)
        time.sleep(600)
    if number == signal.SIGTERM:
        forget_sigterm()


def test_a_result_is_finished():
    with interruptible() as came, finishing():
        signal.raise_signal(signal.SIGINT)
        time.sleep(0.6)
    assert came.signal == signal.SIGINT


def test_a_call_that_waits_is_ended_at_once():
    with pytest.raises(KeyboardInterrupt), interruptible(), at_once():
        signal.raise_signal(signal.SIGINT)
        pytest.fail("it was kept")


def test_nested_loops_are_one():
    with interruptible() as outer:
        with interruptible() as inner:
            signal.raise_signal(signal.SIGINT)
            with pytest.raises(KeyboardInterrupt):
                check()
        assert inner is outer
        with pytest.raises(KeyboardInterrupt):
            check()
    with interruptible() as next_one:
        check()
        assert next_one.signal is None


def test_handlers_of_a_program_stay():
    came = []
    signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    with interruptible():
        signal.raise_signal(signal.SIGINT)
        check()
    assert came == [signal.SIGINT]
    signal.signal(signal.SIGINT, signal.default_int_handler)


def test_loops_of_other_threads_run_on():
    def loop():
        with interruptible() as mine:
            entered.set()
            sent.wait(60)
            check()
            found.append(mine.signal)

    entered, sent, found = threading.Event(), threading.Event(), []
    thread = threading.Thread(target=loop)
    with interruptible() as came:
        thread.start()
        entered.wait(60)
        signal.raise_signal(signal.SIGINT)
        sent.set()
        thread.join(60)
        assert came.signal == signal.SIGINT
    assert found == [None]
