"""JSON and TOML of strangers, parsed within bounds of depth, memory and time."""

from __future__ import annotations

import json
import re
import sys
import tomllib
from dataclasses import dataclass
from typing import Any

from tenscontrol import validation

# Bytes of a number, a short text or a list with its place; what a table of one key has beyond it.
_EACH_VALUE, _EACH_TABLE = 60, 200


def parse_json(name: str, text: str) -> Any:
    """Return what a text in JSON says, or raise a ValueError that begins with its name."""
    _refuse_many(name, text)
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError(f"{name}: not JSON that is read: lists are nested too deep") from None
    except ValueError as error:
        raise ValueError(f"{name}: not JSON: {error}") from error


def _refuse_many(name: str, text: str) -> None:
    """Refuse a text that would become too much memory: ``[],[],`` becomes 25 times its length."""
    tables = text.count("{")
    values = text.count(",") + text.count("[") + tables  # those within one are one more than commas
    taken = sys.getsizeof(text) + _EACH_VALUE * values + _EACH_TABLE * tables
    validation.refuse_memory(f"{name}: it has {values:,} values and lists", taken, "bytes", 1.0)


@dataclass(frozen=True)
class TomlLimits:
    """How much a text in TOML may have: keys and tables, lists, and levels of them."""

    what: str
    keys: int
    lists: int
    levels: int

    def __str__(self) -> str:
        return (
            f"{self.what} has at most {self.keys:,} keys and tables, {self.lists:,} lists and "
            f"{self.levels} levels of them"
        )


def parse_toml(
    name: str, text: str, limits: TomlLimits
) -> tuple[dict[str, Any], list[tuple[int, str]]]:
    """Return what a text in TOML says, and its headings as :func:`headings` finds them.

    Raises a ValueError that begins with the name, and the line if it is known.
    """
    written = headings(name, text, limits)
    _refuse_many(name, text)
    try:
        return tomllib.loads(text), written
    except ValueError as error:
        position = re.search(r" ?\(at (?:line (\d+), column \d+|end of document)\)", str(error))
        where = ""
        if position:
            where = f":{position.group(1) or max(1, len(text.splitlines()))}"
        elif digits := re.search(r"\d{4000}", text):  # Python reads no whole number as long
            where = f":{text.count(chr(10), 0, digits.start()) + 1}"
        raise ValueError(f"{name}{where}: not TOML: {error}") from error


# Texts, comments, and the signs that end keys, values and headers. A text that does not end goes
# on to the end of its line or of the file, so that nothing is read twice.
_TOKEN = re.compile(
    r'"""(?:[^"\\]+|\\.|"(?!""))*+(?:"""+|\Z)'
    r"|'''.*?(?:'''+|\Z)"
    r'|"(?:[^"\\\n]+|\\.)*+"?'
    r"|'[^'\n]*'?|#[^\n]*|[\[\]{}=\n]",
    re.DOTALL,
)


def headings(name: str, text: str, limits: TomlLimits) -> list[tuple[int, str]]:
    """Return line, from 1, and text of each table header and each key before a value.

    Before tomllib reads it: raise where there are more keys or levels than it reads at once.
    """
    lines: list[tuple[int, str]] = []
    line, depth, begin, end, in_value, keys, lists, dots = 1, 0, 0, 0, False, 0, 0, 0
    for token in _TOKEN.finditer(text + "\n"):
        sign, start = token.group(), token.start()
        # Numbers have a point each and commas between them; what has more is a key.
        dots += text.count(".", end, start) - text.count(",", end, start)
        end = token.end()
        if keys > limits.keys or lists > limits.lists or max(depth, dots) > limits.levels:
            raise ValueError(f"{name}:{line}: exceeds the limits: {limits}")
        if sign == "=":
            keys += 1
            if depth == 0 and not in_value:
                lines.append((line, text[begin:start].strip()))
                in_value = True
        elif sign in "[{":
            depth += 1
            keys += sign == "{"
            lists += sign == "["
        elif sign in "]}":
            depth -= 1
            if depth == 0 and not in_value:
                keys += 1
                lines.append((line, text[begin:end].strip()))
        elif sign == "\n" and depth == 0:
            begin, in_value = end, False
        if sign in "=[]{}\n":
            dots = 0
        line += sign.count("\n")
    return lines
