"""A progress bar over simulated time, or over whatever is counted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tenscontrol.validation import truth


@contextmanager
def progress_bar(
    total: float, shown: bool, label: str = "simulating", unit: str = "s"
) -> Iterator[Callable[[float], None]]:
    """Yield a function that is told how far things are: the simulated time reached, s.

    The bar shows only on a terminal. ``shown`` is what the user gives as ``progress``.
    """
    if not truth("progress", shown, "whether to show a progress bar"):
        yield lambda reached: None
        return
    from tqdm import tqdm

    digits = 2 if unit == "s" else 0
    count = f"{{n:.{digits}f}}/{{total:.{digits}f}} {unit}"
    layout = f"{{desc}} {{percentage:3.0f}}%|{{bar}}| {count} [{{elapsed}}<{{remaining}}]"
    with tqdm(total=total, desc=label, bar_format=layout, disable=None) as bar:

        def report(reached: float) -> None:
            bar.update(reached - bar.n)

        yield report
