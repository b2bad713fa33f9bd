"""Report of a sweep, also of one that stops."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, field
from typing import final

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.robustness import store
from tenscontrol.robustness.store import Record
from tenscontrol.tables import aligned

_QUANTILES = (0.05, 0.5, 0.95)


class SweepError(RuntimeError):
    """A sweep that stopped before its end; it carries the report so far.

    A case raises it to stop the whole sweep, where not the run is at fault but
    the sweep: a parameter that it does not know, say.

    Attributes
    ----------
    report : SweepReport or None
        The runs that are done; None where it was raised by a case.
    """

    def __init__(self, message: str, report: SweepReport | None = None) -> None:
        super().__init__(message)
        self.report = report


@final
@dataclass(frozen=True)
class SweepFailure:
    """A run in which the case raised an error.

    Attributes
    ----------
    run : int
        Index of the run.
    error : str
        Kind of the error: ``"SimulationError"``.
    message : str
        Its text.
    """

    run: int
    error: str
    message: str


@final
@dataclass(frozen=True)
class SweepReport:
    """The runs of a sweep. Made by :func:`sweep`, or read from its file by :meth:`load`.

    Two reports are equal where all their numbers are.

    Attributes
    ----------
    case : str
        Name of the case.
    seed : int
        What the random numbers start from.
    count : int
        Number of runs asked for.
    back_end : str
        How the runs were done: some together in compiled loops, or one by one, and why. Empty
        where the report was read from a file. No part of the comparison.
    """

    case: str
    seed: int
    count: int
    _records: tuple[Record, ...]
    back_end: str = field(default="", compare=False)

    @classmethod
    def load(cls, file: str | os.PathLike[str]) -> SweepReport:
        """Return the report of the runs that are in a file.

        Parameters
        ----------
        file : path
            Written by :func:`sweep`, which may still be at work.

        Returns
        -------
        SweepReport
            Of all runs in the file; ``count`` is the largest that was asked for.

        Raises
        ------
        OSError, ValueError
            If the file cannot be read, or a line of it is not as :func:`sweep` wrote it.

        Warns
        -----
        RuntimeWarning
            If the last line is torn; that run is left out.
        """
        header, records, _ = store.read(validation.file_path("file", file))
        return cls(header.case, header.seed, header.count, tuple(records.values()))

    def __len__(self) -> int:
        return len(self._records)

    def __repr__(self) -> str:
        return f"SweepReport({self.case}, {len(self)} of {self.count} runs, seed {self.seed})"

    @property
    def runs(self) -> IntArray:
        """Indices of the runs that are done, ascending, shape (m,)."""
        return frozen(np.array([record.run for record in self._records], dtype=np.int64))

    @property
    def is_complete(self) -> bool:
        """Whether all runs asked for are done."""
        return len(self) == self.count

    @property
    def parameters(self) -> dict[str, FloatArray]:
        """Parameters drawn, by name: one row for each run, shape (m,) or (m, size)."""
        rows = [record.parameters for record in self._records]
        names = rows[0] if rows else {}
        return {name: frozen(np.array([row[name] for row in rows])) for name in names}

    @property
    def success(self) -> np.ndarray:
        """Whether each run was a success, shape (m,); one that raised is none."""
        return frozen(np.array([record.success for record in self._records], dtype=bool))

    @property
    def completed(self) -> np.ndarray:
        """Whether each run was completed without an error, shape (m,)."""
        return frozen(np.array([record.error is None for record in self._records], dtype=bool))

    @property
    def figures(self) -> dict[str, FloatArray]:
        """The figures by name, one entry for each completed run, in their order."""
        rows = [record.figures for record in self._records if record.figures is not None]
        names = rows[0] if rows else {}
        return {name: frozen(np.array([row[name] for row in rows])) for name in names}

    @property
    def failures(self) -> tuple[SweepFailure, ...]:
        """The runs that raised."""
        return tuple(
            SweepFailure(record.run, record.error, record.message or "")
            for record in self._records
            if record.error is not None
        )

    @property
    def columns(self) -> dict[str, FloatArray]:
        """Every number that was drawn, by its name: ``"mass"`` or ``"mass[1]"``, shape (m,)."""
        by_name = {}
        for name, values in self.parameters.items():
            if values.ndim == 1:
                by_name[name] = values
            else:
                by_name |= {f"{name}[{i}]": frozen(row) for i, row in enumerate(values.T)}
        return by_name

    @property
    def success_rate(self) -> float:
        """Share of the runs done that were a success."""
        self._refuse_empty()
        return float(np.mean(self.success))

    def confidence_interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the confidence interval of the rate of success.

        Parameters
        ----------
        level : float
            Probability, between 0 and 1.

        Returns
        -------
        low, high : float
            Parts of the runs, from 0 to 1.

        Raises
        ------
        TypeError, ValueError
            If ``level`` is not between 0 and 1, or no run is done.

        Notes
        -----
        The exact interval of Clopper and Pearson, *Biometrika* 26 (1934), from quantiles of the
        beta distribution. It covers the true rate at least as often as its level says, for any
        number of runs. It knows only the chance of the draw: not whether the parameters vary as
        much in the world as in the sweep.
        """
        from scipy.special import betaincinv

        self._refuse_empty()
        level = validation.positive_number("level", level, "parts of 1")
        if level >= 1:
            raise ValueError(f"level is {level:g}, expected less than 1; 0.95 is usual")
        good, done = int(self.success.sum()), len(self)
        tail = (1 - level) / 2
        low = 0.0 if good == 0 else float(betaincinv(good, done - good + 1, tail))
        high = 1.0 if good == done else float(betaincinv(good + 1, done - good, 1 - tail))
        return low, high

    def rank_correlation(self, figure: str) -> dict[str, float]:
        """Return the rank correlation of each number drawn with a figure, over completed runs.

        Spearman's rank correlation: 1 where the figure always rises with the
        number, −1 where it always falls, near 0 where the number hardly matters
        by itself. Numbers that are the same in all runs are left out.

        Parameters
        ----------
        figure : str

        Returns
        -------
        dict of str to float
            By the names of :attr:`columns`, the strongest first.

        Raises
        ------
        ValueError
            If there is no such figure, it is the same in all runs, or fewer than
            three runs were completed.
        """
        values = self.figure(validation.choice("figure", figure, self.figures))
        if len(values) < 3 or np.ptp(values) == 0:
            raise ValueError(
                f"figure {figure!r} has {len(np.unique(values))} values in {len(values)} completed "
                "runs, expected different ones in at least 3"
            )
        ranks, completed = _ranks(values), self.completed
        drawn = {name: column[completed] for name, column in self.columns.items()}
        correlations = {
            name: float(np.corrcoef(_ranks(column), ranks)[0, 1])
            for name, column in drawn.items()
            if np.ptp(column) > 0
        }
        return dict(sorted(correlations.items(), key=lambda item: -abs(item[1])))

    def figure(self, name: str) -> FloatArray:
        """Return a figure of the completed runs, shape (c,).

        Parameters
        ----------
        name : str

        Returns
        -------
        ndarray

        Raises
        ------
        ValueError
            If there is no such figure.
        """
        figures = self.figures
        return figures[validation.choice("name", name, figures)]

    def table(self) -> str:
        """Return the spread of each figure over the completed runs, as text."""
        head = ["figure", "least", *(f"{100 * q:g} %" for q in _QUANTILES), "most"]
        rows = [
            [name, *(f"{x:.4g}" for x in np.quantile(values, [0.0, *_QUANTILES, 1.0]))]
            for name, values in self.figures.items()
        ]
        return aligned(head, rows)

    def summary(self) -> str:
        """Return the rate of success, the failures by kind and the figures, as text."""
        lines = [f"{self.case}, seed {self.seed}: {len(self)} of {self.count} runs done"]
        if not len(self):
            return lines[0]
        if self.back_end:
            lines.append(f"runs     {self.back_end}")
        low, high = self.confidence_interval()
        lines.append(
            f"success  {self.success.sum()} of {len(self)}: {self.success_rate:.3f}, "
            f"95 % interval {low:.3f} to {high:.3f}"
        )
        for error, count in Counter(failure.error for failure in self.failures).most_common():
            first = next(failure for failure in self.failures if failure.error == error)
            lines.append(f"failed   {count} by {error}; run {first.run}: {first.message}")
        if self.figures:
            lines.append(self.table())
        return "\n".join(lines)

    def _refuse_empty(self) -> None:
        if not self._records:
            raise ValueError("no run is done, so there is no rate of success")


def collected(header: store.Header, records: dict[int, Record], back_end: str = "") -> SweepReport:
    """Return the report of the first runs, as many as the header says, in their order."""
    ordered = tuple(records[run] for run in sorted(records) if run < header.count)
    return SweepReport(header.case, header.seed, header.count, ordered, back_end)


def _ranks(values: FloatArray) -> FloatArray:
    """Return the place of each value in ascending order, from 1; equal ones share the mean."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(counts) - (counts - 1) / 2)[which.ravel()])
