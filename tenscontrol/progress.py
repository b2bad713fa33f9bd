"""Progress of long runs: a bar, or a note where a run will take long."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from logging import getLogger
from time import perf_counter

from tenscontrol import validation

# A run of more than the first, s, is told how long it takes; it is estimated after the second.
_LONG, _ASK = 20.0, 5.0


@contextmanager
def progress_bar(
    total: float, shown: bool, label: str = "simulating", unit: str = "s"
) -> Iterator[Callable[[float], None]]:
    """Yield a function that is told how far things are: the simulated time reached, s.

    The bar shows only on a terminal, the standard error. ``shown`` is what the user gives as
    ``progress``.
    """
    if (
        not validation.truth("progress", shown, "whether to show a progress bar")
        or not _has_terminal()
    ):
        yield lambda reached: None
        return
    from tqdm import tqdm

    digits = 2 if unit == "s" else 0
    count = f"{{n:.{digits}f}}/{{total:.{digits}f}} {unit}"
    layout = f"{{desc}} {{percentage:3.0f}}%|{{bar}}| {count} [{{elapsed}}<{{remaining}}]"
    with tqdm(total=total, desc=label, bar_format=layout) as bar:

        def report(reached: float) -> None:
            bar.update(reached - bar.n)

        yield report


def _has_terminal() -> bool:
    """Whether messages go to a terminal; programs without a window of text have none."""
    stream = sys.stderr
    if stream is None or getattr(stream, "closed", False):
        return False
    return hasattr(stream, "isatty") and stream.isatty()


def long_run_note(start: float, end: float) -> Callable[[float], None]:
    """Return a function that is told the simulated time reached, s; it logs once if it takes long.

    How long depends on the machine, so it is no warning, which a user may have made an error. The
    logger ``"tenscontrol"`` has it as one; without any settings, Python writes that to stderr.
    """
    began, is_said = perf_counter(), False

    def report(reached: float) -> None:
        nonlocal is_said
        taken = perf_counter() - began
        if is_said or taken < _ASK or reached <= start:
            return
        whole = taken * (end - start) / (reached - start)
        if whole > _LONG:
            is_said = True
            getLogger("tenscontrol").warning(
                "simulate: %.3g s of %.3g s of motion took %.0f s; at this rate the run takes "
                "%s in all. progress=True shows a bar; Ctrl-C ends the run, with the motion up "
                "to there",
                reached - start, end - start, taken, _readable(whole),
            )  # fmt: skip

    return report


def _readable(seconds: float) -> str:
    for unit, length in (("days", 86_400.0), ("hours", 3_600.0), ("minutes", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.2g} {unit}"
    return f"{seconds:.0f} s"
