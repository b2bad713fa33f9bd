"""A scene file as it was read: its tables, checked, and the line of each key."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from tenscontrol.scene.keys import LISTS, RENAMED, TABLES, Keys
from tenscontrol.scene.lines import Path as KeyPath
from tenscontrol.scene.lines import key_lines


class SceneError(ValueError):
    """A scene file that cannot be used. The message gives file, line and key."""


@dataclass(frozen=True)
class Document:
    """The tables of a scene file and the line of each key.

    Parameters
    ----------
    file : str
    values : dict
        As tomllib read them.
    lines : dict of tuple to int
    """

    file: str
    values: Mapping[str, Any]
    lines: Mapping[KeyPath, int]

    def error(self, path: KeyPath, message: str) -> SceneError:
        """Return an error that names file and line."""
        while path and path not in self.lines:
            path = path[:-1]
        line = f":{self.lines[path]}" if path else ""
        return SceneError(f"{self.file}{line}: {message}")

    def table(self, name: str, keys: Keys | None = None, which: str = "") -> Table:
        """Return a table, empty if the file has none, with its keys checked.

        Parameters
        ----------
        name : str
        keys : mapping, optional
            The keys that it may have; all of this name if not given.
        which : str
            What messages say of the choice that gave these keys.
        """
        known = TABLES[name] if keys is None else keys
        return Table(self, (name,), f"[{name}]{which}", self.values.get(name, {}), known)

    def has(self, name: str) -> bool:
        """Whether the file has this table."""
        return name in self.values


class Table:
    """One table of a scene file, its keys and the kinds of its values checked.

    Parameters
    ----------
    document : Document
    path : tuple
        The way to it.
    title : str
        What messages call it.
    values : dict
    keys : mapping
        What it may have.

    Raises
    ------
    SceneError
        If a key is unknown, or a value of another kind.
    """

    def __init__(
        self,
        document: Document,
        path: KeyPath,
        title: str,
        values: Mapping[str, Any],
        keys: Keys,
    ) -> None:
        self.document, self.path, self.title = document, path, title
        self.values, self.keys = values, keys
        for key, value in values.items():
            renamed = RENAMED.get((*path, key))  # type: ignore[arg-type]  # names, no numbers
            if renamed is not None:
                raise self.error(key, f"{title} has no key {key!r} any more; write {renamed}")
            if key not in keys:
                raise self.error(key, f"{title} has no key {key!r}{_hint(key, keys)}")
            kind, unit = keys[key]
            fault = kind.fault(key, value, unit)
            if fault:
                raise self.error(key, f"in {title}, {fault}")

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def error(self, key: str | None, message: str) -> SceneError:
        """Return an error at a key, or at the table."""
        return self.document.error(self.path if key is None else (*self.path, key), message)

    def get(self, key: str, default: Any = None) -> Any:
        """Return a value, or what stands for one that is absent."""
        return self.values.get(key, default)

    def need(self, key: str) -> Any:
        """Return a value, or raise if it is absent."""
        if key not in self.values:
            kind, unit = self.keys[key]
            wanted = kind.text + (f" in {unit}" if unit else "")
            raise self.error(None, f"{self.title} lacks the key {key}: {wanted}")
        return self.values[key]

    def choice(self, key: str, options: tuple[str, ...], default: str | None = None) -> str:
        """Return a word that is one of the options."""
        value = str(self.need(key) if default is None else self.get(key, default))
        renamed = RENAMED.get((*self.path, key, value))  # type: ignore[arg-type]
        if renamed is not None:
            raise self.error(
                key, f"in {self.title}, {key} is {value!r}, which is now called {renamed!r}"
            )
        if value not in options:
            words = ", ".join(repr(option) for option in options)
            near = get_close_matches(value, options, n=1)
            meant = f"did you mean {near[0]!r}? It is one of" if near else "expected one of"
            raise self.error(key, f"in {self.title}, {key} is {value!r}; {meant} {words}")
        return value

    def given(self, *keys: str) -> dict[str, Any]:
        """Return those of the keys that have a value."""
        return {key: self.values[key] for key in keys if key in self.values}

    @contextmanager
    def checked(self, fallback: str | None = None, note: str = "") -> Iterator[None]:
        """Give the errors of what is done inside the line of the key that they speak of."""
        try:
            yield
        except SceneError:
            raise
        except (TypeError, ValueError, OverflowError) as error:
            message = str(error)
            words = re.match(r"\w+", message)
            first = words.group() if words else ""
            key = first if first in self.values else fallback
            raise self.error(key, f"in {self.title}, {note}{message}") from error


def read_document(file: str | Path) -> Document:
    """Return the tables of a scene file.

    Parameters
    ----------
    file : str or Path

    Returns
    -------
    Document

    Raises
    ------
    SceneError
        If the file cannot be read, is not TOML, or has other tables than a scene.
    """
    name = str(file)
    try:
        raw = Path(file).read_bytes()
    except OSError as error:
        raise SceneError(f"{name}: cannot be read: {error.strerror or error}") from error
    try:
        text = raw.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise SceneError(f"{name}:{line}: not UTF-8 text: {error.reason}") from error
    try:
        values = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        found = re.search(r" ?\(at (?:line (\d+), column \d+|end of document)\)", str(error))
        where = ""
        if found:
            where = f":{found.group(1) or max(1, len(text.splitlines()))}"
        raise SceneError(f"{name}{where}: not TOML: {error}") from error
    document = Document(name, values, key_lines(text))
    for table, value in values.items():
        if table not in TABLES:
            raise document.error(
                (table,), f"a scene has no table [{table}]{_hint(table, TABLES, 'The tables')}"
            )
        if table in LISTS:
            if not isinstance(value, list) or not all(isinstance(each, dict) for each in value):
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
        unit = known[name][1]
        return (
            f"; did you mean {name!r}{f', in {unit}' if unit else ''}? "
            f"Quantities are in SI units, and no key names another. {listed}"
        )
    return f"; did you mean {near[0]!r}? {listed}" if near else f". {listed}"
