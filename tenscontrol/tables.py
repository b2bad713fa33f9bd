"""Results as text: aligned columns, CSV, Markdown."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from io import StringIO
from math import isnan
from pathlib import Path

from tenscontrol import validation
from tenscontrol.files import write_file

Cell = str | float | int | None


def shown(value: Cell, form: str = ".1e") -> str:
    """Return a cell as people read it, floats in a format; what is not known is a dash."""
    if value is None or (isinstance(value, float) and isnan(value)):
        return "-"
    return format(value, form) if isinstance(value, float) else str(value)


def percent(part: float, digits: int = 2) -> str:
    """Return a part of 1 as percent: 1 is 100 %, however few digits are asked for."""
    value = float(f"{100 * part:.{digits}g}")
    return f"{value:.0f} %" if abs(value) >= 100 else f"{value:g} %"


def aligned(head: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return columns of text; the first ``left`` are flush left, the others right."""
    width = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    lines = [
        "  ".join(
            cell.ljust(width[i]) if i < left else cell.rjust(width[i]) for i, cell in enumerate(row)
        ).rstrip()
        for row in (head, *rows)
    ]
    return "\n".join(lines)


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a table in Markdown; the first ``left`` columns are flush left."""
    rule = [":--" if i < left else "--:" for i in range(len(head))]
    escaped = [[cell.replace("|", "\\|") for cell in row] for row in (head, rule, *rows)]
    return "\n".join(f"| {' | '.join(row)} |" for row in escaped)


def write_csv(path: str | Path, columns: Sequence[str], records: Sequence[object]) -> Path:
    """Write attributes of records as CSV with full precision; what is not known is left empty."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for record in records:
        cells = [getattr(record, name) for name in columns]
        writer.writerow(["" if isinstance(x, float) and isnan(x) else x for x in cells])
    return write_file(validation.file_path("path", path), text.getvalue())
