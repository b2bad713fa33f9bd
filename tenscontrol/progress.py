"""A progress bar over simulated time, or over whatever is counted."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tenscontrol.validation import truth


@contextmanager
def progress_bar(
    total: float, shown: bool, label: str = "simulating", unit: str = "s"
) -> Iterator[Callable[[float], None]]:
    """Yield a function that is told how far things are: the simulated time reached, s.

    The bar shows only on a terminal, the standard error. ``shown`` is what the user gives as
    ``progress``.
    """
    if not truth("progress", shown, "whether to show a progress bar") or not _has_terminal():
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
