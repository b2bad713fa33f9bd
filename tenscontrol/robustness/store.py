"""The runs of a sweep and their file: a header and a line of JSON for each run that is done.

A sweep that is made longer adds a line with its new number of runs, ``{"count": 400}``. Lines are
only ever added, so that no power cut costs more than the last one.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import IO, Any

from tenscontrol._version import __version__
from tenscontrol.robustness.distributions import Distribution, Drawn


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

    def line(self) -> str:
        """Return the record as a line of JSON. Floats are written so that they come back."""
        return json.dumps(asdict(self), allow_nan=False)

    def numbers(self) -> tuple[Any, ...]:
        """Return all but the text of an error."""
        return self.run, self.parameters, self.success, self.figures, self.error


@dataclass(frozen=True)
class Header:
    """What a sweep is: the same header, the same numbers. ``count`` is how many runs of them."""

    tenscontrol: str
    case: str
    seed: int
    count: int
    parameters: dict[str, dict[str, Any]]


def make_header(case: str, seed: int, count: int, parameters: Mapping[str, Distribution]) -> Header:
    """Return the header of a sweep of this version of the package."""
    settings = {name: each.settings() for name, each in parameters.items()}
    return Header(__version__, case, seed, count, settings)


def read(file: Path) -> tuple[Header, list[Record], int]:
    """Return header and records of a file, and how many of its bytes are whole lines.

    A last line that is torn, as a process that is killed leaves it, is dropped with a
    RuntimeWarning.
    """
    whole, _, torn = file.read_bytes().rpartition(b"\n")
    first, *lines = whole.decode("utf-8").split("\n")
    try:
        header = Header(**json.loads(first))
    except (ValueError, TypeError) as error:
        raise ValueError(
            f"{file} is no file of a sweep: its first line is not a header ({error})"
        ) from None
    records: dict[int, Record] = {}
    for number, line in enumerate(lines, start=2):
        try:
            found = json.loads(line)
            if isinstance(found, dict) and found.keys() == {"count"}:
                count = found["count"]
                if not isinstance(count, int) or count <= header.count:
                    raise ValueError(
                        f"count is {count!r}, expected a whole number above {header.count}"
                    )
                header = replace(header, count=count)
                continue
            record = Record(**found)
            if not isinstance(record.run, int):
                raise TypeError(f"run is {record.run!r}, expected a whole number")
        except (ValueError, TypeError) as error:
            raise ValueError(f"{file}, line {number} is not a run: {error}") from None
        if record.run in records or not 0 <= record.run < header.count:
            raise ValueError(
                f"{file}, line {number} is run {record.run}, expected each of 0 to "
                f"{header.count - 1} once"
            )
        records[record.run] = record
    if torn:
        warnings.warn(
            f"{file} ends in a torn line, which is dropped as if it had not been written",
            RuntimeWarning,
            stacklevel=3,
        )
    return header, [records[run] for run in sorted(records)], len(whole) + 1


def resume(file: Path, header: Header) -> tuple[int, list[Record]]:
    """Return count and records of an earlier, equal sweep; the file is begun, or ready for more."""
    if not file.exists():
        file.write_text(json.dumps(asdict(header), allow_nan=False) + "\n", "utf-8", newline="\n")
        return header.count, []
    found, records, size = read(file)
    _refuse_another(file, found, header)
    with file.open("r+b") as stream:
        stream.truncate(size)
    return found.count, records


@contextmanager
def appending(file: Path | None) -> Iterator[Callable[[str], None]]:
    """Yield a function that writes a line down at once, or nowhere."""
    if file is None:
        yield lambda line: None
        return
    stream: IO[str]
    with file.open("a", encoding="utf-8", newline="\n") as stream:

        def write(line: str) -> None:
            stream.write(line + "\n")
            stream.flush()

        yield write


def longer(count: int) -> str:
    """Return the line that makes a sweep longer, to so many runs."""
    return json.dumps({"count": count})


def _refuse_another(file: Path, found: Header, wanted: Header) -> None:
    """Refuse the file of another sweep, and say what is different."""
    for name, here, there in _pairs(asdict(wanted), asdict(found)):
        if here != there:
            raise ValueError(
                f"{file} is of another sweep: {name} is {there!r} there and {here!r} here. "
                "Give another file, or remove this one"
            )


def _pairs(here: dict[str, Any], there: dict[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """Yield what is to be equal, parameter by parameter: all but the number of runs."""
    for name in here:
        if name not in ("count", "parameters"):
            yield name, here[name], there[name]
    for key in sorted({*here["parameters"], *there["parameters"]}):
        yield f"parameter {key!r}", here["parameters"].get(key), there["parameters"].get(key)
