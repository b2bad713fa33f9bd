"""Plain tables: a CSV file of nodes and one of members."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from io import StringIO
from pathlib import Path

import numpy as np

from tenscontrol import validation
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.string_laws import LinearStrings
from tenscontrol.exchange.imported import Imported
from tenscontrol.files import read_text
from tenscontrol.structure.structure import Structure

_OF_NODES = ("name", "x", "y", "z", "mass", "fixed")
_OF_MEMBERS = ("kind", "start", "end", "mass", "stiffness", "rest_length", "damping", "group")
_KINDS = {"bar": True, "rod": True, "strut": True, "string": False, "cable": False}

# A file, and what is made of each row and each cell beside its letters; digits of a number of one.
_MOST_BYTES, _EACH_ROW, _EACH_CELL, _DIGITS = 1_000_000_000, 600, 100, 18


def from_csv(nodes: object, members: object) -> Imported:
    r"""Return the model of two CSV files: nodes, and pairs of nodes that are bars or strings.

    Both begin with a row of column names, in any order; columns in brackets may be left out.

    - nodes: ``x``, ``y`` [, ``z``, m; ``name``; ``mass``, kg; ``fixed``: the axes that are held,
      such as ``xyz``, or ``all``]
    - members: ``kind``, ``start``, ``end`` [, ``mass`` of bars, kg; ``stiffness``, N/m;
      ``rest_length``, m; ``damping``, N s/m; ``group`` of strings]

    A kind is ``bar``, ``rod`` or ``strut``, or else ``string`` or ``cable``. Nodes are called by
    name, or by number from 0. A bar without a mass has 1 kg. An empty cell is a column left out.

    Parameters
    ----------
    nodes, members : str or path

    Returns
    -------
    Imported
        With a string law if every string has a stiffness, and rest lengths where all have one.

    Raises
    ------
    OSError
        If a file cannot be read.
    ValueError
        If a cell does not fit, or the file asks for more than 4 GB: the message has file, row and
        column.

    Examples
    --------
    >>> import pathlib, tempfile, tenscontrol as tc
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> _ = (folder / "nodes.csv").write_text("x,y\n0,0\n1,0\n1,1\n0,1\n")
    >>> _ = (folder / "members.csv").write_text(
    ...     "kind,start,end\nbar,0,2\nbar,1,3\n"
    ...     "string,0,1\nstring,1,2\nstring,2,3\nstring,3,0\n")
    >>> tc.exchange.from_csv(folder / "nodes.csv", folder / "members.csv").structure
    Structure(4 nodes, 2 bars, 4 strings)
    """
    points = _Table("nodes", nodes, _OF_NODES, ("x", "y"))
    pairs = _Table("members", members, _OF_MEMBERS, ("kind", "start", "end"))
    axes = "xyz" if "z" in points.columns else "xy"
    N = np.array([[points.number(row, axis) for axis in axes] for row in points.rows]).T
    names = {row["name"]: i for i, row in enumerate(points.rows) if row.get("name")}
    fixed: list[int | tuple[int, str]] = []
    for i, row in enumerate(points.rows):
        held = row.get("fixed", "").lower()
        if held == "all" or sorted(held) == list(axes):
            fixed.append(i)
        else:
            fixed += [
                (i, validation.choice(points.cell(row, "fixed"), axis, axes))
                for axis in dict.fromkeys(held)
            ]
    mass = [points.number(row, "mass", 0.0) for row in points.rows]
    bars: list[_Row] = []
    strings: list[_Row] = []
    for row in pairs.rows:
        kind = validation.choice(pairs.cell(row, "kind"), row["kind"].lower(), _KINDS)
        (bars if _KINDS[kind] else strings).append(row)
    ends = [
        [[_node(pairs, row, side, names, len(points.rows)) for side in ("start", "end")]
         for row in rows]
        for rows in (bars, strings)
    ]  # fmt: skip
    structure = Structure(
        N,
        np.array(ends[0], dtype=int).reshape(-1, 2),
        np.array(ends[1], dtype=int).reshape(-1, 2),
        [pairs.number(row, "mass", 1.0) for row in bars],
        string_groups=[row.get("group") or "string" for row in strings],
        fixed=fixed,
        point_mass=mass if any(mass) else None,
    )
    law = rest = None
    if _have(pairs, strings, "stiffness"):
        law = LinearStrings(
            [pairs.number(row, "stiffness") for row in strings],
            [pairs.number(row, "damping", 0.0) for row in strings],
        )
    if _have(pairs, strings, "rest_length"):
        rest = np.array([pairs.number(row, "rest_length") for row in strings])
    return Imported(Model(structure, law), rest)


class _Row(dict[str, str]):
    """The cells of a row by column, and its number in the file, from 1."""

    def __init__(self, number: int, cells: Iterable[tuple[str, str]]) -> None:
        super().__init__(cells)
        self.number = number


class _Table:
    """The rows of a file, with the place of each cell for messages."""

    def __init__(
        self, name: str, source: object, known: Sequence[str], needed: Sequence[str]
    ) -> None:
        self.path: Path = validation.file_path(name, source)
        text = read_text(self.path, _MOST_BYTES)
        counts = text.count("\n") + text.count("\r") + 1, text.count(",")
        taken = 2 * len(text) + _EACH_ROW * counts[0] + _EACH_CELL * counts[1]
        rows = f"{self.path}: it has {counts[0]:,} rows and {sum(counts):,} cells"
        validation.refuse_memory(rows, taken, "bytes", 1.0)
        self.columns: list[str] = []
        self.rows: list[_Row] = []
        reader = csv.reader(StringIO(text, newline=""))
        try:
            for i, line in enumerate(reader, 1):
                cells = [cell.strip() for cell in line]
                if not any(cells):
                    continue
                if not self.columns:
                    self.columns = self._checked(cells, known, needed)
                elif len(cells) != len(self.columns):
                    count = len(self.columns)
                    raise ValueError(f"{self.path}, row {i}: {len(cells)} cells, expected {count}")
                else:
                    self.rows.append(_Row(i, zip(self.columns, cells, strict=True)))
        except csv.Error as error:
            raise ValueError(f"{self.path}, line {reader.line_num}: not CSV: {error}") from None
        if not self.columns:
            self._checked([], known, needed)
        if not self.rows:
            raise ValueError(f"{self.path} has no rows below its column names")

    def _checked(self, cells: list[str], known: Sequence[str], needed: Sequence[str]) -> list[str]:
        """Return the names of the columns, or refuse what is none, is missing or is there twice."""
        columns = [cell.lower() for cell in cells]
        for column in columns:
            validation.choice(f"a column of {self.path}", column, known)
        missing = [column for column in needed if column not in columns]
        if missing or len(set(columns)) < len(columns):
            raise ValueError(
                f"{self.path} has the columns {', '.join(columns) or 'none'}, expected "
                f"{', '.join(needed)} in its first row, each once"
            )
        return columns

    def cell(self, row: _Row, column: str) -> str:
        """Return the place of a cell."""
        return f"{self.path}, row {row.number}: {column}"

    def number(self, row: _Row, column: str, default: float | None = None) -> float:
        """Return the number in a cell, or the default where there is none."""
        text = row.get(column, "")
        if not text and default is not None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise ValueError(f"{self.cell(row, column)} is {text!r:.60}, expected a number")
        return value


def _node(table: _Table, row: _Row, side: str, names: dict[str, int], count: int) -> int:
    text = row[side]
    if text in names:
        return names[text]
    if text.isdecimal() and len(text) <= _DIGITS and int(text) < count:
        return int(text)
    raise ValueError(
        f"{table.cell(row, side)} is {text!r:.60}, expected the name of a node, or a number from 0 "
        f"to {count - 1}"
    )


def _have(table: _Table, rows: Sequence[_Row], column: str) -> bool:
    """Whether all rows have a value in a column; ValueError if only some have."""
    is_given = [bool(row.get(column)) for row in rows]
    if any(is_given) and not all(is_given):
        bare = rows[is_given.index(False)]
        raise ValueError(f"{table.cell(bare, column)} is empty, and other strings have one")
    return bool(is_given) and all(is_given)
