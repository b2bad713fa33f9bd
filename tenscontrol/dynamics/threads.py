"""Threads: the lock under which CasADi builds, and objects that one thread uses at a time.

CasADi's Python wrapper lets other threads run during every call. It counts the references to the
elements of SX without a lock, and all expressions share their constants; so what makes, copies or
frees expressions, in any thread, takes the lock below. Evaluating functions needs no lock.
"""

from __future__ import annotations

import copyreg
import os
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property, wraps
from threading import Lock, RLock, get_ident
from typing import Any, Concatenate, ParamSpec, TypeVar

import casadi as ca

_Arguments = ParamSpec("_Arguments")
_Self = TypeVar("_Self")
_Value = TypeVar("_Value")

#: Held by the thread that builds with CasADi; never while it waits for an executor or a compiler.
BUILDING: Any = RLock()

# What threading.Condition uses of a lock as well.
_is_mine, _release, _restore = BUILDING._is_owned, BUILDING._release_save, BUILDING._acquire_restore  # noqa: SLF001

_SOLVING = Lock()

# CasADi's objects dropped by threads that did not hold the lock, until a thread that does frees
# them: waiting in ``__del__`` could wait for ever.
_dropped: deque[Any] = deque()


def builds(function: Callable[_Arguments, _Value]) -> Callable[_Arguments, _Value]:
    """Let one thread at a time call a function that builds with CasADi.

    Parameters
    ----------
    function : callable
    """

    @wraps(function)
    def locked(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Value:
        with BUILDING:
            _dropped.clear()
            return function(*args, **kwargs)

    return locked


@contextmanager
def paused() -> Iterator[None]:
    """Let other threads build meanwhile, whether this one holds the lock or not."""
    saved = _release() if _is_mine() else None
    try:
        yield
    finally:
        if saved is not None:
            _restore(saved)


@contextmanager
def solving() -> Iterator[None]:
    """Let other threads build while this one solves by IPOPT; only one may, by MUMPS's memory."""
    with paused(), _SOLVING:
        yield


class built(cached_property[_Value]):  # noqa: N801, as cached_property
    """A property that is built with CasADi at its first use."""

    def __get__(self, instance: object, owner: type[Any] | None = None) -> Any:
        """Return the value, built under the lock."""
        # Taken first: in Python 3.11 a cached_property has a lock of its own.
        with BUILDING:
            return super().__get__(instance, owner)


def _drop(self: Any) -> None:
    """Free an object of CasADi here if no other thread builds, else leave it to that thread."""
    if not _is_mine():
        _dropped.append(self.this)
        if BUILDING.acquire(blocking=False):
            try:
                _dropped.clear()
            finally:
                BUILDING.release()


for _class in (ca.SX, ca.MX, ca.Function, ca.FunctionBuffer):
    _class.__del__ = _drop


@builds
def _pickled(function: ca.Function) -> tuple[Any, ...]:
    return _unpickled, (function.serialize(),)


@builds
def _unpickled(data: str) -> ca.Function:
    return ca.Function.deserialize(data)


copyreg.pickle(ca.Function, _pickled)

if hasattr(os, "register_at_fork"):  # a forked child must not start in the middle of a build
    os.register_at_fork(
        before=BUILDING.acquire,
        after_in_parent=BUILDING.release,
        after_in_child=BUILDING.release,
    )


class Exclusive:
    """Refuses a second thread while one is inside; the same thread may enter again.

    Parameters
    ----------
    what : str
        The object that has a memory, for the message.
    """

    def __init__(self, what: str) -> None:
        self._what, self._user, self._depth = what, 0, 0

    def __enter__(self) -> None:
        """Take the object, or raise RuntimeError if another thread has it."""
        me = get_ident()
        if self._user != me:
            # No other thread can come between these two lines: nothing is called.
            if self._user:
                raise RuntimeError(
                    f"{self._what} is used by another thread at this moment: it has a memory. "
                    "Give each thread its own, for example a copy by copy.deepcopy or pickle"
                )
            self._user = me
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        """Leave the object to others."""
        self._depth -= 1
        if not self._depth:
            self._user = 0

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy as an object that nobody uses."""
        return Exclusive, (self._what,)


def exclusive(
    method: Callable[Concatenate[_Self, _Arguments], _Value],
) -> Callable[Concatenate[_Self, _Arguments], _Value]:
    """Let one thread at a time call a method of an object with an ``in_use``, an `Exclusive`.

    Parameters
    ----------
    method : callable
    """

    @wraps(method)
    def alone(self: _Self, /, *args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Value:
        with self.in_use:  # type: ignore[attr-defined]
            return method(self, *args, **kwargs)

    return alone
