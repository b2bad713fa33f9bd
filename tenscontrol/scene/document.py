"""A scene file as read: its tables, checked, and the line of each key."""

from __future__ import annotations

import errno
import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from tenscontrol.files import read_text
from tenscontrol.parsing import TomlLimits, parse_toml
from tenscontrol.scene.schema import RENAMED, TABLES, Keys

# A scene of 30,000 bars given by their numbers is below this, and is read in a few seconds.
_MOST_BYTES = 10_000_000
_LIMITS = TomlLimits("a scene file", keys=100_000, lists=250_000, levels=16)

# Table names and keys, and numbers of entries of lists, from the outside in.
KeyPath = tuple[str | int, ...]


class SceneError(ValueError):
    """A scene file that cannot be used. The message gives file, line and key."""


@dataclass(frozen=True)
class Document:
    """The tables of a scene file as tomllib read them, and the line of each key."""

    file: str
    values: Mapping[str, Any]
    lines: Mapping[KeyPath, int]

    def error(self, path: KeyPath, message: str) -> SceneError:
        """Return an error that names file and line."""
        while path and path not in self.lines:
            path = path[:-1]
        line = f":{self.lines[path]}" if path else ""
        return SceneError(f"{self.file}{line}: {message}")

    def table(self, name: str, keys: Keys | None = None, note: str = "") -> Table:
        """Return a table, empty if the file has none; with the keys of one kind if given."""
        known = TABLES[name].keys if keys is None else keys
        return Table(self, (name,), f"[{name}]{note}", self.values.get(name, {}), known)

    def nested(self, name: str, own: str) -> Table:
        """Return a table within a table, whose name is the file's own: ``[name.own]``."""
        title = f"[{name}.{own[:60]}]"
        return Table(self, (name, own), title, self.values[name][own], TABLES[name].keys)

    def entries(self, name: str) -> Iterator[Table]:
        """Return the tables of a list, or the one that is written without being a list."""
        given = self.values.get(name, [])
        if isinstance(given, dict):
            yield self.table(name)
            return
        for i, values in enumerate(given):
            yield Table(self, (name, i), f"[[{name}]] number {i + 1}", values, TABLES[name].keys)

    def has(self, name: str) -> bool:
        """Whether the file has this table."""
        return name in self.values


class Table:
    """One table of a scene file; its keys and the kinds of its values are checked."""

    def __init__(
        self, document: Document, path: KeyPath, title: str, values: Mapping[str, Any], keys: Keys
    ) -> None:
        self.document, self.path, self.title = document, path, title
        self.values, self.keys = values, keys
        for key, value in values.items():
            if (*path, key) in RENAMED:
                written = RENAMED[(*path, key)]
                raise self.error(key, f"{title} has no key {key!r} any more; write {written}")
            if key not in keys:
                raise self.error(key, f"{title} has no key {key[:60]!r}{_hint(key[:60], keys)}")
            fault = keys[key].kind.fault(key, value, keys[key].unit)
            if fault:
                raise self.error(key, f"in {title}, {fault}")

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def error(self, key: str | None, message: str) -> SceneError:
        """Return an error at a key, or at the table."""
        return self.document.error(self.path if key is None else (*self.path, key), message)

    def get(self, key: str, default: Any = None) -> Any:
        """Return a value, or the default if it is absent."""
        return self.values.get(key, default)

    def need(self, key: str) -> Any:
        """Return a value, or raise if it is absent."""
        if key not in self.values:
            wanted = self.keys[key]
            unit = f" in {wanted.unit}" if wanted.unit else ""
            raise self.error(None, f"{self.title} lacks the key {key}: {wanted.kind.text}{unit}")
        return self.values[key]

    def need_required(self) -> None:
        """Raise if a key is absent without which the table makes nothing."""
        for key, known in self.keys.items():
            if known.required:
                self.need(key)

    def choice(self, key: str, options: tuple[str, ...], default: str | None = None) -> str:
        """Return a word that is one of the options."""
        value = str(self.need(key) if default is None else self.get(key, default))
        if value not in options:
            now = RENAMED.get((*self.path, key, value))
            finding = f"in {self.title}, {key} is {value!r}"
            if now:
                raise self.error(key, f"{finding}, which is now called {now!r}")
            words = ", ".join(repr(option) for option in options)
            near = get_close_matches(value, options, n=1)
            meant = f"did you mean {near[0]!r}? It is one of" if near else "expected one of"
            raise self.error(key, f"{finding}; {meant} {words}")
        return value

    def chosen(
        self, key: str, kinds: Mapping[str, Keys], default: str | None = None
    ) -> tuple[str, Table]:
        """Return the word at a key, and the table with the keys that go with this word."""
        kind = self.choice(key, tuple(kinds), default)
        title = f"{self.title} with {key} = {kind!r}"
        return kind, Table(self.document, self.path, title, self.values, kinds[kind])

    def given(self, *keys: str) -> dict[str, Any]:
        """Return those of the keys that have a value."""
        return {key: self.values[key] for key in keys if key in self.values}

    def without(self, *keys: str) -> dict[str, Any]:
        """Return the values of all other keys."""
        return {key: value for key, value in self.values.items() if key not in keys}

    def index(self, key: str, count: int, things: str, said: str | None = None) -> int:
        """Return the number of one of ``count`` things, counted from 0."""
        number: int = self.need(key)
        if not 0 <= number < count:
            raise self.error(
                key,
                f"{said or f'in {self.title}, {key} is'} {number}, expected 0 to {count - 1}: "
                f"there are {count} {things}, counted from 0",
            )
        return int(number)  # a float may stand for one

    @contextmanager
    def checked(self, fallback: str | None = None, note: str = "") -> Iterator[None]:
        """Turn errors raised inside into scene errors, at the key with which they begin."""
        try:
            yield
        except SceneError:
            raise
        except (TypeError, ValueError, ArithmeticError) as error:
            message = str(error)
            words = re.match(r"\w+", message)
            first = words.group() if words else ""
            key = first if first in self.values else fallback
            raise self.error(key, f"in {self.title}, {note}{message}") from error


def read_document(file: str | Path) -> Document:
    """Return the tables of a scene file, or raise a SceneError where it is not one."""
    name = str(Path(file))
    try:
        values, written = parse_toml(name, read_text(Path(file), _MOST_BYTES), _LIMITS)
    except OSError as error:
        also = f"; {_LIMITS}" if error.errno == errno.EFBIG else ""
        raise SceneError(f"{name}: {error.strerror}{also}") from error
    except ValueError as error:
        message = str(error)
        if not message.startswith(name):  # a NUL in the name
            message = f"{name}: cannot be read: {error}"
        raise SceneError(message) from error
    document = Document(name, values, key_lines(written))
    for table, value in values.items():
        if table not in TABLES:
            hint = _hint(table[:60], TABLES, "The tables")
            raise document.error((table,), f"a scene has no table [{table[:60]}]{hint}")
        form = TABLES[table]
        if form.is_list and not (form.may_be_one and isinstance(value, dict)):
            if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
                raise document.error((table,), f"{table} is no list of tables; write [[{table}]]")
        elif not isinstance(value, dict):
            raise document.error((table,), f"{table} is no table; write [{table}] on a line")
    for table in ("structure", "run"):
        if table not in values:
            raise document.error((), f"the table [{table}] is missing; every scene has one")
    return document


def _hint(key: str, known: Mapping[str, Any], what: str = "The keys") -> str:
    """Return what to write in place of an unknown name."""
    plain = [name for name in known if key.startswith(f"{name}_")]
    near = get_close_matches(key, known, n=1)
    listed = f"{what} are: {', '.join(known)}"
    if plain and what == "The keys":
        name = max(plain, key=len)
        unit = known[name].unit
        return (
            f"; did you mean {name!r}{f', in {unit}' if unit else ''}? "
            f"Quantities are in SI units, and keys do not name units. {listed}"
        )
    return f"; did you mean {near[0]!r}? {listed}" if near else f". {listed}"


# ---- lines of keys, which tomllib does not tell ----


def key_lines(found: list[tuple[int, str]]) -> dict[KeyPath, int]:
    """Return the line of each table and key, from the headings of a text that tomllib accepts.

    Paths are like ``("loads", "forces", 0, "node")``. Keys within inline tables belong to the key
    before.
    """
    lines: dict[KeyPath, int] = {}
    last_entry: dict[KeyPath, int] = {}  # of each array of tables
    table: KeyPath = ()
    for line, heading in found:
        if not heading.startswith("["):
            _note(lines, (*table, *_parts(heading)), line)
            continue
        brackets = 2 if heading.startswith("[[") else 1
        table = _within(_parts(heading[brackets:-brackets].strip()), last_entry)
        if brackets == 2:
            last_entry[table] = last_entry.get(table, -1) + 1
            lines.setdefault(table, line)
            table = (*table, last_entry[table])
        _note(lines, table, line)
    return lines


def _note(found: dict[KeyPath, int], path: KeyPath, line: int) -> None:
    """Keep the first line of a path and of every table on the way to it."""
    for depth in range(1, len(path) + 1):
        found.setdefault(path[:depth], line)


def _within(path: KeyPath, last_entry: Mapping[KeyPath, int]) -> KeyPath:
    """Return the path with the number of the latest entry after each array of tables."""
    full: KeyPath = ()
    for depth, key in enumerate(path, start=1):
        full = (*full, key)
        if depth < len(path) and full in last_entry:
            full = (*full, last_entry[full])
    return full


def _parts(dotted: str) -> KeyPath:
    """Return the parts of a key such as ``strings.'top left'``, as tomllib reads it."""
    if re.fullmatch(r"[\w-]+(\.[\w-]+)*", dotted, re.ASCII):
        return tuple(dotted.split("."))
    value: Any = tomllib.loads(f"{dotted} = 0")
    parts: list[str] = []
    while isinstance(value, dict):
        ((key, value),) = value.items()
        parts.append(key)
    return tuple(parts)
