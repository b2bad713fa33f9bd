"""A progress bar over simulated time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress_bar(duration: float, shown: bool) -> Iterator[Callable[[float], None]]:
    """Yield a function that is told the simulated time reached, s.

    The bar shows only on a terminal.
    """
    if not shown:
        yield lambda time: None
        return
    from tqdm import tqdm

    layout = "{desc} {percentage:3.0f}%|{bar}| {n:.2f}/{total:.2f} s [{elapsed}<{remaining}]"
    with tqdm(total=duration, desc="simulating", bar_format=layout, disable=None) as bar:

        def report(time: float) -> None:
            bar.update(time - bar.n)

        yield report
