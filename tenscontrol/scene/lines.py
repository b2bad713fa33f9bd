"""On which line of a TOML text each table and key stands. tomllib does not say."""

from __future__ import annotations

from tomllib import loads
from typing import Any

# Table names and keys, and numbers of entries, from the outside in.
Path = tuple[str | int, ...]

_QUOTES = ('"""', "'''", '"', "'")


def key_lines(text: str) -> dict[Path, int]:
    """Return the line, from 1, of each table header and key.

    Keys within inline tables and arrays are not listed: they belong to the
    key before the ``=``.

    Parameters
    ----------
    text : str
        TOML that tomllib has accepted.

    Returns
    -------
    dict of tuple to int
        By the way to the key: ``("loads", "forces", 0, "node")``.
    """
    found: dict[Path, int] = {}
    count: dict[Path, int] = {}
    table: Path = ()
    at = 0
    while at < len(text):
        if text[at] in " \t\r\n":
            at += 1
        elif text[at] == "#":
            at = _line_end(text, at)
        elif text[at] == "[":
            double = text.startswith("[[", at)
            line, begin = _line(text, at), at + 1 + double
            at = _end(text, begin, "]")
            table = _within(_parts(text[begin:at]), count)
            if double:
                count[table] = count.get(table, -1) + 1
                found.setdefault(table, line)
                table = (*table, count[table])
            _note(found, table, line)
            at = _line_end(text, at)
        else:
            line, begin = _line(text, at), at
            at = _end(text, begin, "=")
            _note(found, (*table, *_parts(text[begin:at])), line)
            at = _end(text, at + 1, "\n")
    return found


def _note(found: dict[Path, int], path: Path, line: int) -> None:
    """Keep the first line of a path and of every table on the way to it."""
    for depth in range(1, len(path) + 1):
        found.setdefault(path[:depth], line)


def _within(path: Path, count: dict[Path, int]) -> Path:
    """Return the path with the number of the latest entry after each array of tables."""
    full: Path = ()
    for depth, part in enumerate(path, start=1):
        full = (*full, part)
        if depth < len(path) and full in count:
            full = (*full, count[full])
    return full


def _parts(dotted: str) -> Path:
    """Return the parts of a key such as ``strings.'top left'``, as tomllib reads it."""
    value: Any = loads(f"{dotted.strip()} = 0")
    parts: list[str] = []
    while isinstance(value, dict):
        ((part, value),) = value.items()
        parts.append(part)
    return tuple(parts)


def _end(text: str, at: int, stop: str) -> int:
    """Return where ``stop`` comes next, outside of quotes, comments and brackets."""
    depth = 0
    while at < len(text):
        if depth == 0 and text[at] == stop:
            return at
        quote = next((q for q in _QUOTES if text.startswith(q, at)), None)
        if quote:
            at = _past_quotes(text, at + len(quote), quote)
            continue
        if text[at] == "#":
            at = _line_end(text, at)
            continue
        depth += (text[at] in "[{") - (text[at] in "]}")
        at += 1
    return at


def _past_quotes(text: str, at: int, quote: str) -> int:
    """Return the place after the end of a string that began before ``at``."""
    while at < len(text) and not text.startswith(quote, at):
        at += 2 if text[at] == "\\" and quote[0] == '"' else 1
    at += len(quote)
    while len(quote) == 3 and text[at : at + 1] == quote[0]:  # quotes may end a long string
        at += 1
    return at


def _line_end(text: str, at: int) -> int:
    end = text.find("\n", at)
    return len(text) if end < 0 else end


def _line(text: str, at: int) -> int:
    return text.count("\n", 0, at) + 1
