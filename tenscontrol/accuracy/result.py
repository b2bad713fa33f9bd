"""Error against run time: the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from tenscontrol.accuracy.case import Case
from tenscontrol.accuracy.converged_motion import ConvergedMotion
from tenscontrol.accuracy.growth import Predictability
from tenscontrol.accuracy.ratios import Ratios, time_to_reach
from tenscontrol.accuracy.runs import NOT_KNOWN, Measurement
from tenscontrol.tables import aligned, comma_separated, markdown, shown
from tenscontrol.validation import choice, frozen, positive_number

# An error below so many times that of the reference is not resolved.
_RESOLVED = 3.0

_HEAD = (
    "method",
    "setting",
    "error m",
    "of size",
    "at end m",
    "time s",
    "build s",
    "evals",
    "steps",
    "rejected",
    "switches",
    "energy",
    "momentum",
    "angular",
    "bars m",
)


@dataclass(frozen=True, eq=False)
class WorkPrecision:
    """Error against run time of methods on one case. Made by :func:`work_precision`.

    Attributes
    ----------
    case : Case
        As compared: its duration is cut where the motion cannot be predicted longer.
    rows : tuple of Measurement
        One for each run, also for those that failed.
    reference : ConvergedMotion
        What errors are measured against.
    predictability : Predictability or None
        How perturbations grow; None where the reference was given.
    refused : tuple of (str, str)
        Peers that do not take part, with their reason.
    """

    case: Case
    rows: tuple[Measurement, ...]
    reference: ConvergedMotion
    predictability: Predictability | None
    refused: tuple[tuple[str, str], ...]

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of our own methods that were run."""
        return tuple(dict.fromkeys(row.method for row in self.rows if not row.is_peer))

    @property
    def peers(self) -> tuple[str, ...]:
        """Names of the peers that were run."""
        return tuple(dict.fromkeys(row.method for row in self.rows if row.is_peer))

    @property
    def failures(self) -> tuple[Measurement, ...]:
        """The runs that failed."""
        return tuple(row for row in self.rows if row.failure)

    def of(self, method: str) -> tuple[Measurement, ...]:
        """Return the runs of one method.

        Parameters
        ----------
        method : str
            Or a peer.

        Returns
        -------
        tuple of Measurement

        Raises
        ------
        ValueError
            If it was not run.
        """
        choice("method", method, (*self.methods, *self.peers))
        return tuple(row for row in self.rows if row.method == method)

    def is_resolved(self, row: Measurement) -> bool:
        """Return whether the error of a run is well above that of the reference.

        Parameters
        ----------
        row : Measurement

        Returns
        -------
        bool
        """
        return row.error > _RESOLVED * self.reference.error

    def time_at(self, method: str, error: float) -> float:
        """Return the run time at which a method has an error, s.

        It is interpolated between the logarithms of the runs; to a larger
        error than all of them it is that of the fastest.

        Parameters
        ----------
        method : str
            Or a peer.
        error : float
            m.

        Returns
        -------
        float
            NaN where the method does not reach the error.
        """
        error = positive_number("error", error, "m")
        return time_to_reach(self.of(method), error, self.reference.error)

    def fastest(self, error: float) -> tuple[str, float]:
        """Return which of our methods is fastest at an error, and its run time.

        Parameters
        ----------
        error : float
            m.

        Returns
        -------
        method : str
            Empty where none reaches the error.
        time : float
            s; NaN where none does.
        """
        times = {name: self.time_at(name, error) for name in self.methods}
        known = {name: time for name, time in times.items() if np.isfinite(time)}
        if not known:
            return "", NOT_KNOWN
        name = min(known, key=lambda each: known[each])
        return name, known[name]

    def ratios(
        self,
        errors: Sequence[float] = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9),
        against: Sequence[str] | None = None,
    ) -> Ratios:
        """Return how many times as long others take as our fastest, at equal error.

        Parameters
        ----------
        errors : sequence of float
            m.
        against : sequence of str, optional
            Peers, or methods of our own; all peers if not given.

        Returns
        -------
        Ratios
        """
        names = self.peers if against is None else tuple(against)
        best = [self.fastest(error) for error in errors]
        others = np.array([[self.time_at(name, error) for name in names] for error in errors])
        others = others.reshape(len(best), len(names))
        time = np.array([each for _, each in best])
        return Ratios(
            errors=tuple(float(error) for error in errors),
            best=tuple(name for name, _ in best),
            time=frozen(time),
            against=names,
            ratio=frozen(others / time[:, None]),
            reached=frozen(np.isfinite(others)),
        )

    def summary(self) -> str:
        """Return what was compared, against what, and who did not take part, as text.

        Returns
        -------
        str
        """
        lines = [repr(self.case)]
        lines += [self.case.note] * bool(self.case.note)
        if self.predictability is not None:
            lines.append(self.predictability.summary())
        lines.append(self.reference.summary())
        if any(row.back_end == "machine code" for row in self.rows):
            lines.append("our own methods that can be compiled are in machine code")
        lines += [f"{name} does not take part: {why}" for name, why in self.refused]
        return "\n".join(lines)

    def table(self) -> str:
        """Return all runs as text, with what was compared above and what failed below.

        Errors marked ≲ are not resolved by the reference. Energy is as part of
        what the motion exchanges, momentum in kg m/s, angular momentum in
        kg m²/s; ``bars m`` is how far a bar is off its length.

        Returns
        -------
        str
        """
        failed = [f"{row.method} at {row.setting:g} failed: {row.failure}" for row in self.failures]
        parts = [self.summary(), aligned(_HEAD, [self._cells(row) for row in self.rows])]
        return "\n\n".join([*parts, *(["\n".join(failed)] if failed else [])])

    def to_markdown(self) -> str:
        """Return the same as :meth:`table` in Markdown.

        Returns
        -------
        str
        """
        failed = [f"- {row.method} at {row.setting:g}: {row.failure}" for row in self.failures]
        above = "\n".join(f"- {line}" for line in self.summary().splitlines())
        title = self.case.name or "Accuracy"
        parts = [f"# {title}", above, markdown(_HEAD, [self._cells(row) for row in self.rows])]
        return "\n\n".join([*parts, *(["Failed:", "\n".join(failed)] if failed else [])]) + "\n"

    def to_csv(self, path: str | Path) -> Path:
        """Write all runs with all figures in full precision.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        Path
        """
        names = [field.name for field in fields(Measurement)]
        rows = [[getattr(row, name) for name in names] for row in self.rows]
        path = Path(path)
        path.write_text(comma_separated(names, rows), encoding="utf-8")
        return path

    def _cells(self, row: Measurement) -> list[str]:
        if row.failure:
            error = "failed"
        else:
            error = ("" if self.is_resolved(row) else "≲") + shown(row.error)
        floats = (row.relative_error, row.end_error, row.time, row.build_time)
        counts = (row.evaluations, row.steps, row.rejections, row.switches)
        health = (row.energy_error, row.momentum_drift, row.angular_momentum_drift)
        return [
            row.method,
            f"{row.setting:.3g}",
            error,
            *(shown(value) for value in floats),
            *(shown(value) for value in counts),
            *(shown(value) for value in (*health, row.bar_length_drift)),
        ]

    def __repr__(self) -> str:
        return (
            f"WorkPrecision({len(self.rows)} runs of {len(self.methods)} methods and "
            f"{len(self.peers)} peers, {len(self.failures)} failed)"
        )
