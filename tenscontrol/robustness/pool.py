"""Runs spread over an executor, a bounded number of them at a time."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager

from tenscontrol.robustness.errors import SweepError
from tenscontrol.robustness.record import Record
from tenscontrol.robustness.worker import ignore_interrupts

# Runs in flight for each process: one at work, one that waits for it.
_PER_PROCESS = 2

# Runs in flight on an executor whose width is not known, unless the user says otherwise.
_IN_FLIGHT = 64


@contextmanager
def workers(
    executor: Executor | None, processes: int | None, in_flight: int | None
) -> Iterator[tuple[Executor, int]]:
    """Yield the user's executor, or one of our own, and how many runs to have in flight.

    Our own is shut down at the end, the user's is left as it is.
    """
    if executor is not None:
        yield executor, in_flight or _IN_FLIGHT
        return
    width = processes or _processors()
    # Processes are started anew: a fork of a process that has threads can lock up.
    with ProcessPoolExecutor(
        width, multiprocessing.get_context("spawn"), initializer=ignore_interrupts
    ) as pool:
        yield pool, in_flight or _PER_PROCESS * width


def spread(
    executor: Executor,
    start: Callable[[int], tuple[object, ...]],
    runs: Iterable[int],
    in_flight: int,
    keep: Callable[[Record], None],
) -> None:
    """Do all runs, and keep the record of each as it comes.

    Whatever stops this, runs that have not begun are cancelled.
    """
    todo = iter(runs)
    pending: dict[Future[Record], int] = {}
    try:
        while True:
            _fill(executor, start, todo, in_flight, pending)
            if not pending:
                return
            done, _ = wait(pending, return_when=FIRST_COMPLETED)
            # Records first: what is done is kept, whatever became of the others.
            for future in sorted(done, key=lambda each: (_error(each) is not None, pending[each])):
                error = _error(future)
                if error is not None:
                    raise _stopped(error, pending[future], pending.values()) from error
                del pending[future]
                keep(future.result())
    finally:
        for future in pending:
            future.cancel()


def _fill(
    executor: Executor,
    start: Callable[[int], tuple[object, ...]],
    todo: Iterator[int],
    in_flight: int,
    pending: dict[Future[Record], int],
) -> None:
    while len(pending) < in_flight:
        run = next(todo, None)
        if run is None:
            return
        function, *arguments = start(run)
        try:
            pending[executor.submit(function, *arguments)] = run  # type: ignore[arg-type]
        except BrokenExecutor as error:
            raise _stopped(error, run, [run, *pending.values()]) from error


def _error(future: Future[Record]) -> BaseException | None:
    """Return why there is no record; None where there is one."""
    return CancelledError("cancelled by others") if future.cancelled() else future.exception()


def _stopped(error: BaseException, run: int, in_flight: Iterable[int]) -> SweepError:
    """Return the error that says which run, or runs, ended the sweep."""
    if isinstance(error, BrokenExecutor):
        suspects = sorted(in_flight)
        which = f"run {suspects[0]}" if len(suspects) == 1 else f"one of the runs {suspects}"
        return SweepError(
            f"a worker process died in {which}. Either the case ends the process or runs out of "
            "memory, or the script that calls sweep does so outside of "
            "`if __name__ == '__main__':`, which the start of processes needs"
        )
    return SweepError(f"run {run} stopped the sweep: {type(error).__name__}: {error}")


def _processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
