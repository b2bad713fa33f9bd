"""The runs of a sweep and their file: a header and a line of JSON for each run that is done.

A sweep that is made longer adds a line with its new number of runs, ``{"count": 400}``. Each line
ends in a check sum. Lines are only ever added, by one sweep at a time, and those of runs that were
done together are on the disk before the next is written: a power cut costs no more than the last.
"""

from __future__ import annotations

import errno
import json
import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from functools import cache
from io import BytesIO
from pathlib import Path
from types import UnionType
from typing import Any, Self, get_args, get_origin, get_type_hints
from zlib import crc32

import numpy as np

from tenscontrol import processes
from tenscontrol.files import read_file
from tenscontrol.parsing import parse_json
from tenscontrol.robustness.distributions import Distribution, Drawn, draw_run
from tenscontrol.validation import whole_number

_BEGIN = b'{"tenscontrol": "'  # of each header
_MOST_BYTES = 1_000_000_000  # of 3 million runs; each takes about four times its line

_kinds: Callable[[type], dict[str, Any]] = cache(get_type_hints)  # of fields, by name


@dataclass(frozen=True)
class Line:
    """A line of the file; its values are of the kinds that its fields are declared with."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not _fits(value, _kinds(type(self))[field.name]):
                raise TypeError(f"{field.name} is {value!r:.60}, expected {field.type}, finite")

    def line(self) -> str:
        """Return it as JSON with a check sum. Floats are written so that they come back."""
        text = json.dumps(vars(self), allow_nan=False)
        return f'{text[:-1]}, "check": "{crc32(text.encode()):08x}"}}'

    @classmethod
    def read(cls, text: str) -> Self:
        """Return what a line says, or raise an error of those in ``_FAULTS``."""
        found = dict(parse_json("the line", text))
        made = cls(**{name: value for name, value in found.items() if name != "check"})
        if made.line() != text:
            raise ValueError("it was changed after it was written: its checksum does not match")
        return made


@dataclass(frozen=True)
class Record(Line):
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


@dataclass(frozen=True)
class Longer(Line):
    """The sweep has so many runs from here on."""

    count: int


@dataclass(frozen=True)
class Header(Line):
    """What a sweep is: the same header, the same numbers. ``count`` is how many runs of them."""

    tenscontrol: str
    case: str
    seed: int
    count: int
    parameters: dict[str, dict[str, Any]]


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
        header = Header.read(lines.readline().decode().removesuffix("\n"))
    except _FAULTS as error:
        raise ValueError(
            f"{file} is not a sweep file: its first line is not a header ({error})"
        ) from None
    if wanted is not None:
        _refuse_another(file, header, wanted)
    sizes = {
        name: () if (size := each.get("size")) is None else (size,)
        for name, each in header.parameters.items()
    }
    records: dict[int, Record] = {}
    for number, ended in enumerate(lines, start=2):
        line = ended.removesuffix(b"\n")
        try:
            if line.startswith(b'{"count"'):
                longer = Longer.read(line.decode())
                count = whole_number("count", longer.count, least=header.count + 1)
                header = replace(header, count=count)
                continue
            record = Record.read(line.decode())
            run, parameters = record.run, record.parameters
            if run in records or not 0 <= run < header.count:
                raise ValueError(f"run is {run}, expected each of 0 to {header.count - 1} once")
            if sizes != {name: np.shape(each) for name, each in parameters.items()}:
                raise ValueError(f"parameters are {parameters!r:.99}, expected the shapes {sizes}")
            if drawn is not None and parameters != draw_run(drawn, header.seed, run):
                raise ValueError(
                    f"parameters are {parameters!r:.99}, expected those of the seed {header.seed}: "
                    "the file, or NumPy, has changed"
                )
            refuse_other_figures(record, records)
        except _FAULTS as error:
            raise ValueError(f"{file}, line {number} is not a run: {error}") from None
        records[run] = record
    if whole < len(content):
        warnings.warn(
            f"{file} ends in an incomplete line, which is ignored", RuntimeWarning, stacklevel=3
        )
    return header, dict(sorted(records.items())), whole


@contextmanager
def opened(
    file: Path | None, header: Header, drawn: Mapping[str, Distribution]
) -> Iterator[tuple[int, dict[int, Record], Callable[..., None]]]:
    """Yield count and records of an earlier, equal sweep, and a function that writes lines.

    The file is begun if there is none, or only a torn header in it. No other sweep may write to it.
    """
    if file is None:
        yield header.count, {}, lambda *lines: None
        return
    with processes.locked_file(file) as (descriptor, locked):
        if locked is False:
            text = "another sweep writes to this file: wait for its end, or give another file"
            raise BlockingIOError(errno.EAGAIN, text, str(file))
        if locked is None:
            text = f"the file system of {file} has no locks: let no other sweep write to it"
            warnings.warn(text, RuntimeWarning, stacklevel=4)

        def write(*lines: Line) -> None:
            left = "".join(f"{line.line()}\n" for line in lines).encode()
            size = os.fstat(descriptor).st_size
            try:
                while left:
                    left = left[os.write(descriptor, left) :]
                os.fsync(descriptor)
            except OSError as error:
                with suppress(OSError):  # else the torn line is dropped when it is read
                    os.ftruncate(descriptor, size)
                text = f"{error.strerror}; the runs so far are kept, and the same call "
                "continues the sweep"
                raise OSError(error.errno, text, str(file)) from None

        content = read_file(file, _MOST_BYTES)
        if b"\n" not in content and _BEGIN.startswith(content[: len(_BEGIN)]):
            if content:
                text = f"{file} has an incomplete header and no run; it is started again"
                warnings.warn(text, RuntimeWarning, stacklevel=4)
            os.ftruncate(descriptor, 0)
            write(header)
        found, records, size = read(file, header, drawn)
        os.ftruncate(descriptor, size)
        yield found.count, records, write


def refuse_other_figures(record: Record, records: Mapping[int, Record]) -> None:
    """Refuse figures of other names than those of the runs so far."""
    if record.figures is None:
        return
    earlier = next((each for each in records.values() if each.figures is not None), record)
    found, expected = sorted(record.figures), sorted(earlier.figures or ())
    if found != expected:
        raise ValueError(
            f"run {record.run} has the figures {found}, but run {earlier.run} has {expected}: "
            "a case returns the same ones in every run"
        )


# What reading a line raises.
_FAULTS = (TypeError, ValueError)


def _fits(value: object, kind: Any) -> bool:
    """Whether a value, and what is in it, is of the kind of a field, and finite."""
    if isinstance(kind, UnionType):
        return any(_fits(value, each) for each in get_args(kind))
    plain = get_origin(kind) or kind
    if plain is Any or not isinstance(value, plain):
        return plain is Any
    if isinstance(value, list | dict):
        inside = value.values() if isinstance(value, dict) else value
        return all(_fits(each, get_args(kind)[-1]) for each in inside)
    finite = not isinstance(value, float) or math.isfinite(value)
    return finite and isinstance(value, bool) == (plain is bool)


def _refuse_another(file: Path, found: Header, wanted: Header) -> None:
    """Refuse the file of another sweep, and say what is different; the count may be."""
    there, here = (
        vars(each) | {f"parameter {name!r}": value for name, value in each.parameters.items()}
        for each in (found, wanted)
    )
    for name in sorted({*there, *here} - {"count", "parameters"}):
        if there.get(name) != here.get(name):
            raise ValueError(
                f"{file} belongs to another sweep: {name} is {there.get(name)!r} there and "
                f"{here.get(name)!r} here. Give another file, or remove this one"
            )
