"""The file of a sweep: lines of JSON, the first of the sweep, each other of a finished run.

A sweep that is made longer adds a line with its new number of runs, ``{"count": 400}``. Lines are
only ever added, by one sweep at a time.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.files import append_file, opened_file, read_file, write_file
from tenscontrol.parsing import parse_json
from tenscontrol.robustness.distributions import Distribution, Drawn, draw_run
from tenscontrol.warn import warn

_MOST_BYTES = 1_000_000_000  # of 3 million runs; each takes about four times its line


@dataclass(frozen=True)
class Record:
    """One run, by its index from 0: what was drawn, and what came of it.

    Where the case raised, ``figures`` is None, ``error`` and ``message`` are kind and text.
    """

    run: int
    parameters: dict[str, Drawn]
    success: bool
    figures: dict[str, float] | None = None
    error: str | None = None
    message: str | None = None

    def numbers(self) -> tuple[Any, ...]:
        """Return all but the text of an error."""
        return self.run, self.parameters, self.success, self.figures, self.error


_KINDS = {"run": int, "parameters": dict, "success": bool, "figures": dict | None}


@dataclass(frozen=True)
class Header:
    """What a sweep is: the same header, the same numbers. ``count`` is how many runs of them."""

    tenscontrol: str
    case: str
    seed: int
    count: int
    parameters: dict[str, dict[str, Any]]


def as_lines(*entries: Mapping[str, Any]) -> str:
    """Return entries of a file as lines. Floats are written so that they come back."""
    return "".join(f"{json.dumps(dict(entry), allow_nan=False)}\n" for entry in entries)


def read(
    file: Path, wanted: Header | None = None, drawn: Mapping[str, Distribution] | None = None
) -> tuple[Header, dict[int, Record], int]:
    """Return header and records by run of a file, and how many of its bytes are whole lines.

    A last line that is torn, as a process that is killed leaves it, is dropped with a
    RuntimeWarning. Where a sweep is wanted, the file must be of that one, and its parameters those
    that are drawn.
    """
    content = read_file(file, _MOST_BYTES)
    whole = content.rfind(b"\n") + 1
    lines = BytesIO(content[:whole])
    try:
        header = Header(**_entry(lines.readline()))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{file} is not a sweep file: its first line is not a header ({error})"
        ) from None
    if wanted is not None:
        _refuse_another(file, header, wanted)
    records: dict[int, Record] = {}
    for number, line in enumerate(lines, start=2):
        try:
            entry = _entry(line)
            if "count" in entry:
                count = validation.whole_number("count", entry["count"], least=header.count + 1)
                header = replace(header, count=count)
                continue
            record = Record(**entry)
            _refuse_unfit(record, header, records, drawn)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{file}, line {number} is not a run: {error}") from None
        records[record.run] = record
    if whole < len(content):
        warn(f"{file} ends in an incomplete line, which is ignored", RuntimeWarning)
    return header, dict(sorted(records.items())), whole


def _entry(line: bytes) -> dict[str, Any]:
    return dict(parse_json("the line", line.decode()))


@contextmanager
def opened(
    file: Path | None, header: Header, drawn: Mapping[str, Distribution]
) -> Iterator[tuple[int, dict[int, Record], Callable[..., None]]]:
    """Yield count and records of an earlier, equal sweep, and a function that adds entries.

    The file is begun if there is none. No other sweep may write to it.
    """
    if file is None:
        yield header.count, {}, lambda *entries: None
        return
    if not file.exists():
        append_file(file, "")
    with opened_file(file, _MOST_BYTES):  # which refuses folders, pipes and devices
        pass
    with _locked(file):
        if not file.stat().st_size:
            write_file(file, as_lines(vars(header)))
        known, records, whole = read(file, header, drawn)
        os.truncate(file, whole)
        yield known.count, records, lambda *entries: append_file(file, as_lines(*entries))


@contextmanager
def _locked(file: Path) -> Iterator[None]:
    import filelock

    lock = filelock.FileLock(file.with_name(f".{file.name}.lock"))
    try:
        held = lock.acquire(timeout=0)
    except filelock.Timeout:
        text = "another sweep writes to this file: wait for its end, or give another file"
        raise BlockingIOError(errno.EAGAIN, text, str(file)) from None
    with held:
        yield


def refuse_other_figures(record: Record, records: Mapping[int, Record]) -> None:
    """Refuse figures of other names than those of the runs so far."""
    if record.figures is None:
        return
    earlier = next((other for other in records.values() if other.figures is not None), record)
    names, expected = sorted(record.figures), sorted(earlier.figures or ())
    if names != expected:
        raise ValueError(
            f"run {record.run} has the figures {names}, but run {earlier.run} has {expected}: "
            "a case returns the same ones in every run"
        )


def _refuse_unfit(
    record: Record,
    header: Header,
    records: Mapping[int, Record],
    drawn: Mapping[str, Distribution] | None,
) -> None:
    """Refuse a run of a file that is not one of its sweep."""
    for name, kind in _KINDS.items():
        if not isinstance(getattr(record, name), kind):
            raise TypeError(f"{name} is {getattr(record, name)!r:.60}")
    run, parameters = record.run, record.parameters
    if run in records or not 0 <= run < header.count:
        raise ValueError(f"run is {run}, expected each of 0 to {header.count - 1} once")
    sizes = {
        name: () if (size := settings.get("size")) is None else (size,)
        for name, settings in header.parameters.items()
    }
    if sizes != {name: np.shape(values) for name, values in parameters.items()}:
        raise ValueError(f"parameters are {parameters!r:.99}, expected the shapes {sizes}")
    if drawn is not None and parameters != draw_run(drawn, header.seed, run):
        raise ValueError(
            f"parameters are {parameters!r:.99}, expected those of the seed {header.seed}: "
            "the file, or NumPy, has changed"
        )
    refuse_other_figures(record, records)


def _refuse_another(file: Path, found: Header, wanted: Header) -> None:
    """Refuse the file of another sweep, and say what is different; the count may be."""
    in_file, asked = (
        vars(header) | {f"parameter {name!r}": value for name, value in header.parameters.items()}
        for header in (found, wanted)
    )
    for name in sorted({*in_file, *asked} - {"count", "parameters"}):
        if in_file.get(name) != asked.get(name):
            raise ValueError(
                f"{file} belongs to another sweep: {name} is {in_file.get(name)!r} there and "
                f"{asked.get(name)!r} here. Give another file, or remove this one"
            )
