"""Ctrl-C or SIGTERM ends a long loop at a safe point.

What is done by then is kept. A long loop runs within :func:`interruptible` and calls :func:`check`
between steps. Loops may be nested. Only signals that Python would act on by itself are taken over:
a program with handlers of its own keeps them. Signals come to the main
thread; loops in other threads run on.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # those of signal make words of numbers first
import _thread
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import FrameType
from typing import Any

from tenscontrol.warn import warn

# A loop that calls `check` less often is ended wherever it is, s.
_PATIENCE = 0.5

# Signals with the handlers that are taken over. On Windows nothing sends SIGTERM.
_TAKEN: tuple[tuple[int, Any], ...] = (
    (signal.SIGINT, signal.default_int_handler),
    *(((signal.SIGTERM, _signal.SIG_DFL),) if os.name == "posix" else ()),
)


class InterruptionWarning(RuntimeWarning):
    """A computation was ended by Ctrl-C or SIGTERM; the part that was done is returned."""


class Interruption:
    """What has come since the outermost :func:`interruptible` began."""

    def __init__(self) -> None:
        self.signal: int | None = None  # the first that came
        self.active = self.raised = self.at_once = self.finishing = False
        self.whole = self.terminated = self.sends = False
        self.loops = 0  # how many outermost ones have begun

    @property
    def status(self) -> int:
        """Exit status of a command that was ended so: 130 for Ctrl-C, 143 for SIGTERM."""
        return 128 + (self.signal or signal.SIGINT)

    def handle(self, number: int, _: FrameType | None) -> None:
        """Note a signal. The first waits for :func:`check`, a second one raises at once."""
        again, self.signal = self.signal is not None, self.signal or number
        if self.active and (again or self.at_once):
            self.raised = True
            raise KeyboardInterrupt
        if not self.finishing:
            # Not threading.Thread, whose lock this handler may have been called within.
            _thread.start_new_thread(self._insist, (self.loops,))

    def _insist(self, loop: int) -> None:
        """Send a signal again to a loop that has not ended by then, to no other."""
        time.sleep(_PATIENCE)
        self.sends = True
        is_at_work = self.active and self.loops == loop
        if is_at_work and self.signal is not None and not (self.raised or self.finishing):
            if os.name == "posix":  # so that a call that waits wakes up
                signal.pthread_kill(_main_thread(), self.signal)
            else:
                signal.raise_signal(self.signal)
        self.sends = False


_STATE = Interruption()


def _main_thread() -> int:
    return threading.main_thread().ident or 0


class _Flag:
    """Sets a flag of what has come, and puts it back at the end."""

    def __init__(self, of: Interruption, name: str, value: bool = True) -> None:
        self._of, self._name, self._value = of, name, value

    def __enter__(self) -> Interruption:
        self._before = getattr(self._of, self._name)
        setattr(self._of, self._name, self._value)
        return self._of

    def __exit__(self, *_: object) -> None:
        setattr(self._of, self._name, self._before)


class _Outermost:
    """Takes signals over, and gives back their handlers at the end."""

    def __init__(self, whole: bool) -> None:
        self._whole, self._former = whole, dict[int, Any]()

    def __enter__(self) -> Interruption:
        state = _STATE
        if state.terminated:
            state.terminated = False
            raise SystemExit(128 + signal.SIGTERM)
        state.signal, state.raised, state.whole = None, False, self._whole
        state.loops += 1
        try:
            state.active = True
            for number, default in _TAKEN:
                if _signal.getsignal(number) is default:
                    self._former[number] = _signal.signal(number, state.handle)
        except BaseException:  # a signal that came before its handler was set
            self.__exit__()
            raise
        return state

    def __exit__(self, *_: object) -> None:
        state = _STATE
        state.active = False  # from here on nothing is raised, so that all handlers are restored
        while state.sends:  # a signal that comes once they are would end the program
            time.sleep(0)
        for number, handler in self._former.items():
            _signal.signal(number, handler)
        state.terminated = state.signal == signal.SIGTERM


def _own() -> Interruption:
    """Return what has come to this thread: to all but the main one no signal does."""
    return _STATE if _thread.get_ident() == _main_thread() else Interruption()


def interruptible(whole: bool = False) -> AbstractContextManager[Interruption]:
    """Keep Ctrl-C and SIGTERM for :func:`check`; yield what has come.

    ``whole`` says that loops within are to raise, not to return a part of their result. A second
    signal raises KeyboardInterrupt at once, and so does the first half a second later if nothing
    checks. After SIGTERM the loop at work returns what it has; the next that begins raises
    SystemExit with status 143.
    """
    state = _own()
    if state is _STATE and not state.active:
        return _Outermost(whole)
    return _Flag(state, "whole", state.whole or whole)


@contextmanager
def keeping(result: str, count: Callable[[], int]) -> Iterator[None]:
    """Run a loop whose finished parts are its result; if it is ended, warn how many there are.

    KeyboardInterrupt goes on if there are none, or a loop around this one wants all of them.
    """
    passed_on = _STATE.active and _STATE.whole
    try:
        with interruptible(whole=True) as came:
            yield
        if passed_on or came.signal is None:
            return
    except KeyboardInterrupt:
        if passed_on or not count():
            raise
    warn(f"interrupted: {count()} {result}", InterruptionWarning)


def check() -> None:
    """Raise KeyboardInterrupt if a signal has come, in the main thread within a long loop."""
    if _STATE.signal is not None and _STATE.active and _thread.get_ident() == _main_thread():
        _STATE.raised = True
        raise KeyboardInterrupt


def at_once() -> AbstractContextManager[Interruption]:
    """Let a signal raise KeyboardInterrupt at once: around a call that waits, or polls signals."""
    return _Flag(_own(), "at_once")


def finishing(came: Interruption | None = None) -> AbstractContextManager[Interruption]:
    """Let a first signal raise nothing while a result is put together, however long it takes.

    ``came`` is what :func:`interruptible` yielded, where that is known.
    """
    return _Flag(_own() if came is None else came, "finishing")
