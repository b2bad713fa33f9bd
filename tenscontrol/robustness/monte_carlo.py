"""Monte Carlo studies: many runs of one case with random parameters."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from typing import Any

from tenscontrol import validation
from tenscontrol._version import __version__
from tenscontrol.interrupt import interruptible
from tenscontrol.progress import progress_bar
from tenscontrol.robustness import store
from tenscontrol.robustness.closed_loop_case import ClosedLoopCase, Outcome
from tenscontrol.robustness.distributions import Distribution
from tenscontrol.robustness.experiment_design import parameters_of_runs
from tenscontrol.robustness.pool import do_runs, spread, workers
from tenscontrol.robustness.store import Record
from tenscontrol.robustness.sweep_report import SweepError, SweepReport, collected
from tenscontrol.warn import warn

# Runs from which they go together: what is compiled for that takes seconds the first time.
_WORTHWHILE = 48


def sweep(
    case: Callable[..., Outcome],
    parameters: Mapping[str, Any],
    count: int | None = None,
    *,
    seed: int,
    executor: Executor | None = None,
    processes: int | None = None,
    in_flight: int | None = None,
    file: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> SweepReport:
    """Run a Monte Carlo study: many runs with random or given parameters, and how many succeed.

    The random numbers of a run depend on the seed and the index of the run only. On one machine,
    any executor with any number of workers gives the same report, bit by bit.

    Parameters
    ----------
    case : callable
        ``case(parameters, rng) -> Outcome``, once a run: ``parameters`` is a dict
        of what was drawn, floats or read-only arrays (size,); ``rng`` is the run's
        own :class:`numpy.random.Generator`, for noise. It is pickled, and loaded
        anew for each run, or for the runs that a :class:`ClosedLoopCase` does together. A run in
        which it raises is a failure and is kept as such; :class:`SweepError` stops the sweep.
    parameters : mapping of str to Distribution or array_like
        What to draw for each run: :class:`Uniform`, :class:`Normal`, :class:`OneOf`; or what each
        run gets, shape (runs,) or (runs, size), as :func:`grid` returns it.
    count : int, optional
        Number of runs. Not needed where values are given for each run, and at most as many.
    seed : int
        What the random numbers start from, at least 0.
    executor : concurrent.futures.Executor, optional
        Where the runs are done; it is not shut down. Dask's is
        ``Client(...).get_executor()``. If not given, new processes, which a script
        may start only inside ``if __name__ == "__main__":``.
    processes : int, optional
        Number of new processes, where no executor is given; all processors if not given.
    in_flight : int, optional
        How many runs, or groups of runs that go together, are handed out at a time, at least the
        number of workers. Two a process if not given, 64 on an executor that is given.
    file : path, optional
        Each run is written to it as soon as it is done. If the file exists, the sweep continues it:
        all parameters and one of its runs must be reproduced. ``count`` may differ from that of
        the file: a larger one adds runs, and with a smaller one the first ``count`` runs are
        reported while the file keeps all.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal.

    Returns
    -------
    SweepReport

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, the case cannot be
        pickled, the file is of another sweep (the message says what differs), or one of its lines
        is no run of it.
    OSError
        If the file cannot be read or written, or another sweep writes to it. It keeps all runs
        that were written.
    SweepError
        If a worker process dies, the case returns no :class:`Outcome`, or a run of the file is not
        reproduced. It carries the report of the runs done.

    Warns
    -----
    RuntimeWarning
        If the user interrupts: the report of the runs done is returned, and running ones are
        abandoned, except on an executor that was given. If the last line of the file is
        incomplete: it is ignored.

    Examples
    --------
    How often does a regulator hold a prism whose strings are up to 30 % stiffer or softer
    than it was told?

    >>> from concurrent.futures import ThreadPoolExecutor
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> rest = tc.prestress(prism, force_density=10.0)
    >>> model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    >>> plant = tc.linearize(model, rest, input="rest_length")
    >>> Q, R = tc.energy_weights(plant)
    >>> scene = tc.Scene(
    ...     model, 0.5, controller=tc.LQR(plant, Q, 0.1 * R, sample_time=0.02),
    ...     integration=tc.Integration(step=5e-3))
    >>> case = tc.ClosedLoopCase(scene, tolerance=0.03)
    >>> with ThreadPoolExecutor(1) as executor:
    ...     report = tc.sweep(
    ...         case, {"stiffness": tc.Uniform(0.7, 1.3, size=9)}, 4, seed=0, executor=executor)
    >>> report
    SweepReport(ClosedLoopCase, 4 of 4 runs, seed 0)

    On a grid, how far does the factor move it?

    >>> with ThreadPoolExecutor(1) as executor:
    ...     report = tc.sweep(
    ...         case, tc.grid({"stiffness": [0.3, 0.6, 1.0]}), seed=0, executor=executor)
    >>> report.parameters["stiffness"].tolist(), report.figure("final_error").round(4).tolist()
    ([0.3, 0.6, 1.0], [0.0, 0.0, 0.0])
    """
    pickled = _pickled(case)
    distributions, count = parameters_of_runs(parameters, count)
    seed = validation.whole_number("seed", seed, 0, validation.LARGEST_SEED)
    validation.truth("progress", progress, "whether to show a progress bar")
    processes, in_flight = _checked_workers(executor, processes, in_flight)
    name = str(getattr(case, "__qualname__", type(case).__qualname__))
    settings = {name: distribution.settings() for name, distribution in distributions.items()}
    header = store.Header(__version__, name, seed, count, settings)
    path = None if file is None else validation.file_path("file", file)
    at_a_time, back_end = _runs_together(case, distributions, count)
    with store.opened(path, header, distributions) as (known_count, records, write):
        beyond = sum(run >= count for run in records)  # the file may be that of a longer sweep
        try:
            with (
                interruptible(whole=True),
                progress_bar(count, progress, label="sweep", unit="runs") as report,
                workers(executor, processes, in_flight) as pool,
            ):

                def keep(done: list[Record]) -> None:
                    for record in done:
                        if record.run in records:
                            _refuse_other_numbers(record, records[record.run])
                            return
                        try:
                            store.refuse_other_figures(record, records)
                        except ValueError as error:
                            raise SweepError(str(error)) from None
                    write(*map(vars, done))
                    records.update({record.run: record for record in done})
                    report(len(records) - beyond)

                def start(runs: list[int]) -> tuple[Any, ...]:
                    return do_runs, pickled, distributions, seed, runs

                # One run of the file is done again: it tells whether the case is still the same,
                # before anything is added to the file.
                spread(pool, start, list(records)[:1], keep)
                if count > known_count:
                    write({"count": count})
                left = [run for run in range(count) if run not in records]
                spread(pool, start, left, keep, at_a_time)
        except SweepError as error:
            partial_report = collected(header, records, back_end)
            raise SweepError(str(error), partial_report) from error.__cause__
        except KeyboardInterrupt:
            warn(
                f"the sweep was interrupted with {len(records) - beyond} of {count} runs done",
                RuntimeWarning,
            )
    return collected(header, records, back_end)


def _checked_workers(
    executor: Executor | None, processes: int | None, in_flight: int | None
) -> tuple[int | None, int | None]:
    """Return numbers of processes and of runs handed in, checked."""
    if executor is not None:
        validation.instance(
            "executor", executor, Executor, "of concurrent.futures; Dask's is client.get_executor()"
        )
        if processes is not None:
            raise ValueError(
                "processes and executor are both given, expected one: an executor "
                "has its own workers"
            )
    if processes is not None:
        processes = validation.whole_number("processes", processes, least=1)
    if in_flight is not None:
        in_flight = validation.whole_number("in_flight", in_flight, least=1)
    return processes, in_flight


def _runs_together(
    case: object, distributions: Mapping[str, Distribution], count: int
) -> tuple[int, str]:
    """Return how many runs go together, and how that is said."""
    if not isinstance(case, ClosedLoopCase):
        return 1, "one by one: the case is a function"
    why, at_a_time = case.alone(distributions), case.at_a_time
    if why is None and (count < _WORTHWHILE or at_a_time == 1):
        why = "too few runs" if at_a_time > 1 else "a run fills the memory for several"
    if why is not None:
        return 1, f"one by one: {why}"
    return at_a_time, f"up to {at_a_time} together, in compiled loops"


def _pickled(case: object) -> bytes:
    if not callable(case):
        raise validation.wrong_kind("case", case, "a function case(parameters, rng)")
    try:
        return pickle.dumps(case)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise TypeError(
            f"case cannot be pickled, so it cannot be sent to a worker: {error}. Make it a "
            "function at "
            "the top of a module, or an object of a class there whose attributes can be pickled"
        ) from error


def _refuse_other_numbers(now: Record, then: Record) -> None:
    if now.numbers() != then.numbers():
        raise SweepError(
            f"run {now.run} of the file gave {then.numbers()[1:]}, and now {now.numbers()[1:]}: "
            "the case, a library or the machine has changed. Give another file"
        )
