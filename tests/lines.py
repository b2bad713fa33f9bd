"""Lines of the package and of its tests by folder, beside those of an earlier state.

Run: ``python -m tests.lines``. ``--write NAME`` makes the present counts those that later ones are
printed beside, as is done at a release. Nothing is asserted on them: they show where the package
grows.
"""

from __future__ import annotations

import argparse
import ast
import csv
import io
import tokenize
from collections import Counter
from pathlib import Path

PROJECT = Path(__file__).parent.parent
KEPT = Path(__file__).with_suffix(".csv")
KINDS = ("code", "docstrings", "comments", "C")


def main(arguments: list[str] | None = None) -> None:
    """Print the table, or keep its counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", metavar="NAME", help="keep the counts under this name")
    given = parser.parse_args(arguments)
    now = counts(PROJECT)
    if given.write:
        with KEPT.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow([given.write, "files", *KINDS])
            for folder, count in sorted(now.items()):
                writer.writerow([folder, count["files"], *(count[kind] for kind in KINDS)])
        return
    with KEPT.open(encoding="utf-8", newline="") as file:
        (name, *columns), *rows = csv.reader(file)
    before = {row[0]: Counter(dict(zip(columns, map(int, row[1:]), strict=True))) for row in rows}
    print(f"lines now (and in {name})")
    print(f"{'':22}" + "".join(f"{column:>16}" for column in columns))
    for folder in [*sorted(now.keys() | before.keys()), "all"]:
        pair = [each.get(folder, Counter()) for each in (now, before)]
        if folder == "all":
            pair = [sum(each.values(), Counter()) for each in (now, before)]
        cells = (f"{pair[0][column]} ({pair[1][column]})" for column in columns)
        print(f"{folder:22}" + "".join(f"{cell:>16}" for cell in cells))


def counts(project: Path) -> dict[str, Counter[str]]:
    """Return files and lines by kind of each folder of the package, and of all tests."""
    folders: dict[str, Counter[str]] = {}
    for path in sorted([*project.glob("tenscontrol/**/*"), *project.glob("tests/**/*")]):
        if path.suffix not in (".py", ".c", ".h"):
            continue
        parts = path.relative_to(project).parts
        folder = parts[0] if parts[0] == "tests" or len(parts) == 2 else "/".join(parts[:2])
        text = path.read_text(encoding="utf-8")
        lines = _of_python(text) if path.suffix == ".py" else Counter(C=len(_written(text)))
        folders.setdefault(folder, Counter()).update(lines, files=1)
    return folders


def _written(text: str) -> set[int]:
    """Return the lines that are not blank."""
    return {number for number, line in enumerate(text.splitlines(), 1) if line.strip()}


def _of_python(text: str) -> Counter[str]:
    """Return lines of code, docstrings and comments; a line that has two is code."""
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        if isinstance(node, documented) and ast.get_docstring(node, clean=False) is not None:
            first = node.body[0]
            docstrings.update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    comments = {
        token.start[0]
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type == tokenize.COMMENT and token.line.lstrip().startswith("#")
    }
    written = _written(text)
    return Counter(
        code=len(written - docstrings - comments),
        docstrings=len(written & docstrings),
        comments=len((written & comments) - docstrings),
    )


if __name__ == "__main__":
    main()
