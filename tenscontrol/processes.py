"""What ends with a process, however it ends: locks on files, and the workers that it started.

Nothing heavy is imported here: a worker watches its parent before it imports what it works with.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

if sys.platform == "win32":
    import msvcrt

    _FAR = 0x7FFFFFFE  # beyond what is written: nobody else can read a byte that is locked
else:
    import fcntl


@cache
def _held() -> set[int]:
    """Return the descriptors of files that are open, in one set for the process."""
    return set()


@contextmanager
def locked_file(path: Path) -> Iterator[tuple[int, bool | None]]:
    """Open or make a file to append to, lock it, and yield its descriptor and whether it is locked.

    False: another process or thread has the lock. None: this file system has no locks.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
    descriptor = os.open(path, flags, 0o666)
    _held().add(descriptor)
    try:
        yield descriptor, _locked(descriptor)
    finally:
        if descriptor in _held():  # else this is a fork, which has closed it
            _held().remove(descriptor)
            os.close(descriptor)


def _let_go() -> None:
    """Close the files in a process that was forked: it would keep the lock of a dead parent."""
    for descriptor in _held():
        os.close(descriptor)
    _held().clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)


def _locked(descriptor: int) -> bool | None:
    try:
        if sys.platform == "win32":
            os.lseek(descriptor, _FAR, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return None
    return True


def begin_work() -> None:
    """Leave Ctrl-C to the parent, and end with it, however it ends.

    What is left of a simulation after a signal must not pass for a whole run.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: os._exit(1))
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    from multiprocessing import connection, parent_process

    parent = parent_process()
    assert parent is not None  # this is a worker
    # A process that the parent has forked may keep the sentinel open after its end.
    while not connection.wait([parent.sentinel], timeout=1.0) and os.getppid() == parent.pid:
        pass
    os._exit(1)
