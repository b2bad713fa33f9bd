"""Runs of a sweep on an executor: what the caller and what the workers do."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from threading import Thread, local
from typing import Any, final

import numpy as np

from tenscontrol.arrays import frozen
from tenscontrol.interrupt import check, finishing
from tenscontrol.robustness.closed_loop_case import Outcome
from tenscontrol.robustness.distributions import CASE, Distribution, Drawn, draw_run, generator
from tenscontrol.robustness.store import Record
from tenscontrol.robustness.sweep_report import SweepError

# Runs in flight for each process: one at work, one that waits for it.
_PER_PROCESS = 2

# Runs in flight on an executor whose width is not known, unless the user says otherwise.
_IN_FLIGHT = 64

# Runs that are handed out together, where there are so many: each call costs some of a run.
_FEWEST = 16

_POLL = 0.05  # s until an interrupt is looked for

_here = local()  # the last case that a thread of a worker did several runs of


@final
@dataclass(frozen=True)
class Workers:
    """Where runs are done, ``in_flight`` at a time: a user's executor, or processes of ours."""

    executor: Executor
    in_flight: int
    ours: bool


@final
class _Spawned(SpawnContext):
    """Starts processes anew and keeps them; a fork of one that has threads can lock up."""

    def __init__(self) -> None:
        self._started = list[SpawnProcess]()

    def Process(self, *arguments: Any, **options: Any) -> SpawnProcess:  # type: ignore[override]  # noqa: N802
        process = super().Process(*arguments, **options)
        self._started.append(process)
        return process

    def kill(self) -> None:
        """End all of them at once, also those that have not yet begun to work."""
        for process in self._started:
            if process.pid is not None:
                process.kill()


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Hold Ctrl-C back, where the system can: on Windows it cannot."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def workers(
    executor: Executor | None, processes: int | None, in_flight: int | None
) -> Iterator[Workers]:
    """Yield the user's executor as it is, or processes of our own, ended afterwards."""
    if executor is not None:
        yield Workers(executor, in_flight or _IN_FLIGHT, ours=False)
        return
    affinity = getattr(os, "sched_getaffinity", None)  # what this process may use, where it is told
    width = processes or (len(affinity(0)) if affinity else os.cpu_count() or 1)
    context = _Spawned()
    watched, held = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(width, context, _begin_work, (watched,))
    with held, watched:
        try:
            yield Workers(pool, in_flight or _PER_PROCESS * width, ours=True)
        except BaseException:
            context.kill()
            raise
        finally:
            pool.shutdown()


def spread(
    pool: Workers,
    start: Callable[[list[int]], tuple[Any, ...]],
    runs: list[int],
    keep: Callable[[list[Record]], None],
    at_a_time: int = 1,
) -> None:
    """Do all runs, and keep their records as they come; if stopped, give up the others.

    Runs are handed out one by one, or up to ``at_a_time`` together so that all workers have some.
    """
    size = min(at_a_time, max(_FEWEST, -(-len(runs) // pool.in_flight)))
    todo = iter(runs[i : i + size] for i in range(0, len(runs), size))
    pending: dict[Future[list[Record]], list[int]] = {}
    over = False
    try:
        while True:
            check()
            _fill(pool, start, todo, pending)
            if not pending:
                over = True
                return
            # Ctrl-C must not raise within: the locks that it takes would be kept for ever.
            done, _ = wait(pending, _POLL, FIRST_COMPLETED)
            # Records first: what is done is kept, whatever became of the others.
            for future in sorted(done, key=lambda task: (_error(task) is not None, pending[task])):
                error = _error(future)
                if error is not None:
                    raise _stopped(error, pending[future], pending.values()) from error
                del pending[future]
                with finishing():  # in file and report, or in neither
                    keep(future.result())
    except KeyboardInterrupt:
        for future in sorted(pending, key=pending.__getitem__):
            if future.done() and _error(future) is None:
                keep(future.result())
        raise
    finally:
        # Not of processes of ours: where they end, Python 3.11 fails at a cancelled future.
        if not over and not pool.ours:
            for future in pending:
                future.cancel()


def _fill(
    pool: Workers,
    start: Callable[[list[int]], tuple[Any, ...]],
    todo: Iterator[list[int]],
    pending: dict[Future[list[Record]], list[int]],
) -> None:
    while len(pending) < pool.in_flight:
        runs = next(todo, None)
        if runs is None:
            return
        try:
            # This may start a process. It inherits the mask: Ctrl-C, which the terminal sends to
            # all processes, would else end it before it can ignore that.
            with _interrupts_blocked() if pool.ours else nullcontext():
                pending[pool.executor.submit(*start(runs))] = runs
        except BrokenExecutor as error:
            raise _stopped(error, runs, [runs, *pending.values()]) from error


def _error(future: Future[list[Record]]) -> BaseException | None:
    """Return why there is no record; None where there is one."""
    return CancelledError("cancelled by others") if future.cancelled() else future.exception()


def _stopped(error: BaseException, runs: list[int], in_flight: Iterable[list[int]]) -> SweepError:
    """Return the error that says which run, or runs, ended the sweep."""
    died = isinstance(error, BrokenExecutor)
    suspects = sorted(run for some in in_flight for run in some) if died else runs
    which = f"run {suspects[0]}" if len(suspects) == 1 else f"one of the runs {suspects}"
    if died:
        return SweepError(
            f"a worker process died in {which}. Either the case ends the process or runs out of "
            "memory, or the script that calls sweep does so outside of "
            "`if __name__ == '__main__':`, which the start of processes needs"
        )
    return SweepError(f"{which} stopped the sweep: {type(error).__name__}: {error}")


# ---- in a worker ----


def _begin_work(watched: Connection) -> None:
    """Leave Ctrl-C to the parent, and end where it ends, however it does.

    What is left of a simulation after a signal must not pass for a whole run.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: os._exit(1))
    Thread(target=_end_with, args=(watched,), daemon=True).start()


def _end_with(watched: Connection) -> None:
    try:
        watched.poll(None)  # nothing is ever sent
    finally:
        os._exit(1)


def do_runs(
    case: bytes, parameters: Mapping[str, Distribution], seed: int, runs: list[int]
) -> list[Record]:
    """Return the records of some runs, the same whichever worker does them, and when.

    The case comes pickled and is loaded anew for each run, so that nothing that one run leaves in
    it reaches another; runs that go together are of a case that keeps nothing. The random numbers
    hang on the seed and the index alone.
    """
    drawn = [draw_run(parameters, seed, run) for run in runs]
    given = [
        {
            name: frozen(np.array(value)) if isinstance(value, list) else value
            for name, value in values.items()
        }
        for values in drawn
    ]
    done: list[Callable[[], Outcome] | None] = [None] * len(runs)
    if len(runs) > 1:
        done = _shared(case).together(given)
    records = []
    for run, numbers, values, outcome in zip(runs, drawn, given, done, strict=True):
        if outcome is None:
            outcome = partial(_loaded(case), values, generator(seed, run, CASE))
        records.append(_record(run, numbers, outcome))
    return records


def _record(run: int, drawn: dict[str, Drawn], do: Callable[[], Outcome]) -> Record:
    try:
        outcome = do()
    except (SweepError, MemoryError):
        raise  # the sweep is wrong, or the machine too small: the next runs would be no better
    except Exception as error:  # noqa: BLE001  # the only place: a run that fails is data
        # Whatever a case raises is what the sweep was run to find: it is kept as data, with its
        # kind and text, and counts as no success. What is no Exception, like Ctrl-C, goes on.
        kind = type(error).__name__
        return Record(run, drawn, success=False, error=kind, message=str(error))
    if not isinstance(outcome, Outcome):
        raise SweepError(
            f"the case returned a {type(outcome).__name__}, expected Outcome: end it with "
            "return Outcome(success=..., figures={...})"
        )
    return Record(run, drawn, outcome.success, outcome.figures)


def _shared(case: bytes) -> Any:
    """Return the case that this thread does runs of together, with all that was built for it."""
    if getattr(_here, "pickled", None) != case:
        _here.case, _here.pickled = _loaded(case), case
    return _here.case


def _loaded(case: bytes) -> Any:
    try:
        function = pickle.loads(case)
    except (AttributeError, ImportError) as error:
        raise SweepError(
            f"a worker cannot load the case: {error}. Define it in a module that workers can "
            "import, or in the script itself above `if __name__ == '__main__':`"
        ) from None
    return function
