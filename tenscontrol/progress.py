"""Progress of long work: a bar, or a note that says how long it will take."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from logging import getLogger
from time import perf_counter

from tenscontrol import validation

# Work that takes more than the first, s, is announced; it is estimated after the second.
_LONG, _ASK = 20.0, 5.0


def progress_bar(
    total: float, shown: bool, label: str = "simulating", unit: str = "s", start: float = 0.0
) -> AbstractContextManager[Callable[[float], None]]:
    """Return a context with a function that is told how far things are, from start to ``total``.

    A bar shows only on a terminal, the standard error. ``shown`` is what the user gives as
    ``progress``. Where there is no bar, work that takes long is announced once.
    """
    if validation.truth("progress", shown, "whether to show a progress bar") and _has_terminal():
        return _bar(total, label, unit, start)
    return nullcontext(_long_work_note(start, total, label))


@contextmanager
def _bar(total: float, label: str, unit: str, start: float) -> Iterator[Callable[[float], None]]:
    from tqdm import tqdm

    digits = 2 if unit == "s" else 0
    count = f"{{n:.{digits}f}}/{{total:.{digits}f}} {unit}"
    layout = f"{{desc}} {{percentage:3.0f}}%|{{bar}}| {count} [{{elapsed}}<{{remaining}}]"
    with tqdm(total=total, initial=start, desc=label, bar_format=layout) as bar:

        def report(reached: float) -> None:
            bar.update(reached - bar.n)

        yield report


def _has_terminal() -> bool:
    """Whether messages go to a terminal; programs without a window of text have none."""
    stream = sys.stderr
    if stream is None or getattr(stream, "closed", False):
        return False
    return hasattr(stream, "isatty") and stream.isatty()


def _long_work_note(start: float, end: float, label: str) -> Callable[[float], None]:
    """Return a function that is told how far things are; it logs once if they take long.

    How long depends on the machine, so it is no warning, which a user may have made an error. The
    logger ``"tenscontrol"`` has it as one; without any settings, Python writes that to stderr.
    """
    began, last, is_said = perf_counter(), start, False

    def report(reached: float) -> None:
        nonlocal began, last, is_said
        if reached < last:  # it is done once more
            began = perf_counter()
        taken, last = perf_counter() - began, reached
        if is_said or taken < _ASK or reached <= start:
            return
        share = (reached - start) / (end - start)
        if taken > share * _LONG:
            is_said = True
            getLogger("tenscontrol").warning(
                "%s: %.2g %% took %.0f s; at this rate it takes %s in all. progress=True shows a "
                "bar on a terminal; Ctrl-C ends it",
                label, 100 * share, taken, _readable(taken / share),
            )  # fmt: skip

    return report


def _readable(seconds: float) -> str:
    for unit, length in (("days", 86_400.0), ("hours", 3_600.0), ("minutes", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.2g} {unit}"
    return f"{seconds:.0f} s"
