"""What came of the suite: every case with every method."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from tenscontrol.accuracy.suite.extreme import ASKED, TOLERANCE
from tenscontrol.accuracy.suite.verdict import VERDICTS, Verdict
from tenscontrol.tables import aligned, comma_separated, markdown

_COLUMNS = (
    "case",
    "method",
    "verdict",
    "error",
    "error_to_end",
    "estimate",
    "asked",
    "compared",
    "growth",
    "reference_error",
    "evaluations",
    "reason",
)


@dataclass(frozen=True)
class SuiteResult:
    """What came of every case with every method. Made by :func:`extreme_suite`.

    Attributes
    ----------
    rows : tuple of Verdict
        Case by case.
    """

    rows: tuple[Verdict, ...]

    @property
    def cases(self) -> tuple[str, ...]:
        """Names of the cases."""
        return tuple(dict.fromkeys(row.case for row in self.rows))

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods."""
        return tuple(dict.fromkeys(row.method for row in self.rows))

    @property
    def silent(self) -> tuple[Verdict, ...]:
        """Runs that were wrong without a word."""
        return tuple(row for row in self.rows if row.is_silent)

    @property
    def counts(self) -> dict[str, int]:
        """How often each verdict came."""
        found = Counter(row.verdict for row in self.rows)
        return {verdict: found[verdict] for verdict in VERDICTS}

    def table(self) -> str:
        """Return one line for each case and one column for each method, as text.

        Returns
        -------
        str
        """
        return f"{aligned(*self._cells())}\n\n{self.summary()}"

    def to_markdown(self) -> str:
        """Return the same in Markdown.

        Returns
        -------
        str
        """
        return f"{markdown(*self._cells())}\n\n{self.summary()}\n"

    def to_csv(self, path: str | Path) -> Path:
        """Write one line for each run, with its reason.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        Path
            Where it was written.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        path = Path(path)
        rows = [[getattr(row, name) for name in _COLUMNS] for row in self.rows]
        path.write_text(comma_separated(_COLUMNS, rows), encoding="utf-8")
        return path

    def summary(self) -> str:
        """Return what was asked, the counts, and every silent failure with its numbers.

        Returns
        -------
        str
        """
        counts = ", ".join(f"{count} {verdict}" for verdict, count in self.counts.items())
        lines = [
            f"Errors are the largest distance of a node from the truth, by the size of the "
            f"structure; asked for {ASKED:g}, at tolerance {TOLERANCE:g} or steps that fit.",
            "(w): accurate, and warned all the same; w: wrong, and warned. Growth is that of a "
            "perturbation of the start: where it is large, motions are compared for the part of "
            "the time given.",
            f"{len(self.rows)} runs: {counts}.",
        ]
        lost = [row for row in self.rows if row.is_lost]
        if lost:
            runs = ", ".join(f"{row.method} in {row.case}" for row in lost)
            lines.append(
                f"Past the part compared, errors grew beyond what was asked and the run did not "
                f"say so in {len(lost)}: {runs}."
            )
        lines += [
            f"SILENT: {row.case}, {row.method}: error {row.error:.1e}, its own estimate "
            f"{row.estimate:.1e}"
            for row in self.silent
        ]
        return "\n".join(lines)

    def _cells(self) -> tuple[list[str], list[list[str]]]:
        head = ["case", "truth", "growth", *self.methods]
        body = []
        for case in self.cases:
            rows = {row.method: row for row in self.rows if row.case == case}
            first = next(iter(rows.values()))
            cells = [case, f"{first.reference_error:.0e}", f"{first.growth:.0e}"]
            body.append([*cells, *(_cell(rows[name]) for name in self.methods)])
        return head, body


def _cell(row: Verdict) -> str:
    """Return what came of a run in a word or a number."""
    if row.verdict in ("accurate", "in part"):
        text = f"{row.error:.0e}" + (" (w)" if row.reason else "")
    elif row.verdict in ("warned", "SILENT"):
        word = "w" if row.verdict == "warned" else "SILENT"
        text = f"{word} {row.error:.0e}"
    else:
        return row.verdict
    return text if row.part > 0.999 else f"{text} to {row.part:.0%}"
