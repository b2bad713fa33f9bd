"""Test suite of stiff and extreme structures: every method on each, none silently wrong.

``python -m tenscontrol.accuracy.suite`` runs it. The true motion of a case is known in closed form
or computed twice, each method is judged by it, and the result is a table.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol.accuracy.extreme_cases import ASKED, TOLERANCE, Extreme, extremes, methods
from tenscontrol.accuracy.open_loop import only_free, state_change
from tenscontrol.dynamics import unpack_states
from tenscontrol.files import write_file
from tenscontrol.integrate import CVODES, DOP853, EnergyMomentum, Integrator, Rattle6
from tenscontrol.interrupt import interruptible, keeping
from tenscontrol.progress import progress_bar
from tenscontrol.simulation import (
    AccuracyWarning,
    HealthLimits,
    SimulationError,
    Trajectory,
    simulate,
)
from tenscontrol.tables import aligned, markdown, write_csv
from tenscontrol.validation import FloatArray, frozen
from tenscontrol.validation import truth as checked_truth

#: What can come of a method; the last is what must not.
VERDICTS = ("accurate", "in part", "warned", "stopped", "refused", "too long", "unknown", "SILENT")

# What the runs are to warn of.
_LIMITS = HealthLimits(position_error=ASKED, crossings=None)

# Length at which reasons are cut off in what is kept.
_LONGEST = 200

# Perturbation of the start, as part of the size: far above round-off, and small to the end.
_PERTURBATION = 1e-10

# What round-off amounts to, as part of the size.
_ROUND_OFF = 1e-13

# The two computations must agree to this part of what is asked.
_AGREE = 0.1

# Beyond so many radians of the fastest motion the truth is computed by an implicit method first;
# not of contacts, which are fast for moments.
_EXPLICIT = 2.1e4


# ---- the true motion ----


@dataclass(frozen=True, eq=False)
class Truth:
    """The true motion, by a closed form or computed twice.

    ``nodes``, m, shape (d, n, T), are those at the times of the case. ``error`` is the largest
    distance between the two computations, by the size, for ``outputs`` times; ``growth``, shape
    (T,), that of a perturbation of the start; ``how`` says where the motion is from.
    """

    nodes: FloatArray
    error: float
    growth: FloatArray
    outputs: int
    how: str

    def comparable(self, error: float) -> int:
        """Return at how many times a run that makes this error, by the size, can be compared.

        Up to where the error, grown as a perturbation of the start grows, is the error asked for.
        """
        # Errors near what is asked are compared until they have grown tenfold.
        counted = min(max(error, _ROUND_OFF), 0.1 * ASKED)
        within = self.growth[: self.outputs] * counted <= ASKED
        return self.outputs if within.all() else int(np.argmin(within))


def truth(extreme: Extreme) -> Truth:
    """Return the true motion of a case; ArithmeticError if it runs away."""
    times = extreme.time
    if extreme.closed_form is not None:
        known = extreme.closed_form(times)
        return Truth(frozen(known), 0.0, frozen(np.ones(len(times))), len(times), "closed form")
    main, other, how = _methods(extreme)
    state = extreme.case.state
    first, second = _nodes(extreme, main, state), _nodes(extreme, other, state)
    perturbed = _nodes(extreme, main, state + _perturbation(extreme))
    growth = _apart(extreme, perturbed, first) / _PERTURBATION
    apart = _apart(extreme, first, second)
    good = (growth * _ROUND_OFF <= ASKED) & (apart <= _AGREE * ASKED)
    outputs = len(times) if good.all() else int(np.argmin(good))
    error = float(apart[outputs - 1]) if outputs else float(apart[0])
    return Truth(frozen(first), error, frozen(np.maximum(growth, 1.0)), outputs, how)


def _methods(extreme: Extreme) -> tuple[Integrator, Integrator, str]:
    """Return two methods that have little in common."""
    equation, smooth = (extreme.case.equation(derivatives=each) for each in (False, True))
    if extreme.angle > _EXPLICIT and equation.contacts is None:
        return (
            EnergyMomentum(smooth, step=2.5e-4 * extreme.case.duration),
            DOP853(equation, 1e-9, project=True),
            "energy_momentum in 4000 steps, dop853 at 1e-9",
        )
    main = DOP853(equation, 1e-12, project=True)
    if equation.velocity_dependent:
        return main, CVODES(smooth, 1e-11, project=True), "dop853 at 1e-12, cvodes at 1e-11"
    step = 0.3 / extreme.frequency
    return main, Rattle6(equation, step), f"dop853 at 1e-12, rattle6 at {step:.1e} s"


def _nodes(extreme: Extreme, integrator: Integrator, state: FloatArray) -> FloatArray:
    case = extreme.case
    span = integrator.advance(state, case.input_value, case.duration, extreme.outputs)
    return unpack_states(case.structure, span.states)[0]


def _apart(extreme: Extreme, nodes: FloatArray, others: FloatArray) -> FloatArray:
    """Return the largest distance of a node up to each time, by the size."""
    far = np.linalg.norm(nodes - others, axis=0).max(axis=0)
    return np.asarray(np.maximum.accumulate(far) / extreme.case.size)


def _perturbation(extreme: Extreme) -> FloatArray:
    """Return a small change of the state that stretches no bar."""
    case = extreme.case
    moves = only_free(case.structure, np.random.default_rng(0).standard_normal(case.nodes.shape))
    moves *= _PERTURBATION * case.size / np.linalg.norm(moves, axis=0).max()
    return state_change(case, moves)


# ---- what comes of a method ----


@dataclass(frozen=True)
class Verdict:
    """What came of one method in one case: one of :data:`VERDICTS`.

    ``"accurate"``: the error is no larger than asked. ``"in part"``: nor is it up to where the
    growth of a perturbation lets motions be compared. ``"warned"``: it is larger, and the run said
    so. ``"stopped"``: the run ended with an error; ``"refused"``: it did not begin; ``"too long"``:
    it would take too many evaluations. ``"unknown"``: there is no truth. ``"SILENT"``: wrong
    without a word.

    Errors are by the size: ``error`` up to the time ``compared``, s, which is ``part`` of the
    duration; ``error_to_end`` to the end, or to where the truth is known; ``estimate`` is the run's
    own, ``growth`` that of a small perturbation of the start, ``reference_error`` that of the
    truth. ``reason`` has the words of the run. NaN: not known.
    """

    case: str
    method: str
    verdict: str
    error: float = float("nan")
    error_to_end: float = float("nan")
    estimate: float = float("nan")
    asked: float = ASKED
    compared: float = 0.0
    part: float = 0.0
    growth: float = float("nan")
    reference_error: float = float("nan")
    evaluations: float = float("nan")
    reason: str = ""

    @property
    def is_lost(self) -> bool:
        """Whether errors grew beyond what was asked without a word, after the time compared."""
        return self.verdict == "in part" and self.error_to_end > self.asked and not self.reason


def judge(extreme: Extreme, known: Truth, method: str) -> Verdict:
    """Run one of :func:`methods` on a case whose truth is known, and return what came of it."""
    case = extreme.case
    row: dict[str, Any] = {
        "case": extreme.name,
        "method": method,
        "growth": float(known.growth[-1]),
        "reference_error": known.error,
    }
    expected, allowed = extreme.evaluations(method), extreme.allowed(method)
    if expected > allowed:
        reason = f"some {expected:.0e} evaluations, {allowed:.0e} are allowed"
        return Verdict(**row, verdict="too long", evaluations=expected, reason=reason)
    given: dict[str, Any] = {case.input: case.input_value}
    settings: dict[str, Any] = {**extreme.settings(method)}
    with warnings.catch_warnings(record=True, action="always") as caught:
        try:
            run = simulate(
                case.model,
                case.duration,
                case.nodes,
                case.velocities,
                **given,
                method=method.split(",")[0],
                output_step=case.duration / extreme.outputs,
                limits=_LIMITS,
                **settings,
            )
        except SimulationError as error:
            done = float(error.trajectory.evaluations)
            reason = str(error)[:_LONGEST]
            return Verdict(**row, verdict="stopped", evaluations=done, reason=reason)
        except (ValueError, ArithmeticError) as error:
            return Verdict(**row, verdict="refused", reason=str(error)[:_LONGEST])
    warned = [str(w.message) for w in caught if issubclass(w.category, AccuracyWarning)]
    return _compared(extreme, known, run, row, warned)


def _compared(
    extreme: Extreme, known: Truth, run: Trajectory, row: dict[str, Any], warned: list[str]
) -> Verdict:
    estimate = None if run.error is None else float(run.error.max())
    outputs = known.comparable(0.0 if estimate is None else estimate)
    known_nodes = known.nodes[:, :, : known.outputs]
    errors = _apart(extreme, run.nodes[:, :, 1 : known.outputs + 1], known_nodes)  # 0 is the start
    if not outputs:
        verdict = "warned" if warned else "unknown"
    elif errors[outputs - 1] > ASKED:
        verdict = "warned" if warned else "SILENT"
    else:
        verdict = "accurate" if outputs == extreme.outputs else "in part"
    return Verdict(
        **row,
        verdict=verdict,
        error=float(errors[outputs - 1]) if outputs else float("nan"),
        error_to_end=float(errors[-1]) if len(errors) else float("nan"),
        estimate=float("nan") if estimate is None else estimate,
        compared=float(extreme.time[outputs - 1]) if outputs else 0.0,
        part=outputs / extreme.outputs,
        evaluations=float(run.evaluations),
        reason="; ".join(warned)[:_LONGEST],
    )


# ---- the result ----


@dataclass(frozen=True)
class SuiteResult:
    """What came of every case with every method. Made by :func:`extreme_suite`."""

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
        return tuple(row for row in self.rows if row.verdict == "SILENT")

    @property
    def counts(self) -> dict[str, int]:
        """How often each verdict came."""
        found = Counter(row.verdict for row in self.rows)
        return {verdict: found[verdict] for verdict in VERDICTS}

    def table(self) -> str:
        """Return one line for each case and one column for each method, as text."""
        return f"{aligned(*self._cells())}\n\n{self.summary()}"

    def to_markdown(self) -> str:
        """Return the same in Markdown."""
        return f"{markdown(*self._cells())}\n\n{self.summary()}\n"

    def to_csv(self, path: str | Path) -> Path:
        """Write one line for each run, with its reason, and return where."""
        columns = [field.name for field in fields(Verdict) if field.name != "part"]
        return write_csv(path, columns, self.rows)

    def summary(self) -> str:
        """Return what was asked, the counts, and every silent failure with its numbers."""
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
            body.append([*cells, *(_cell(rows.get(name)) for name in self.methods)])
        return head, body


def _cell(row: Verdict | None) -> str:
    """Return what came of a run in a word or a number."""
    if row is None:  # interrupted before it
        return "-"
    if row.verdict in ("accurate", "in part"):
        text = f"{row.error:.0e}" + (" (w)" if row.reason else "")
    elif row.verdict in ("warned", "SILENT"):
        word = "w" if row.verdict == "warned" else "SILENT"
        text = f"{word} {row.error:.0e}"
    else:
        return row.verdict
    return text if row.part > 0.999 else f"{text} to {row.part:.0%}"


# ---- the suite ----


def extreme_suite(quick: bool = False, only: str = "", progress: bool = False) -> SuiteResult:
    """Run every method on stiff and extreme structures, and say what came of each.

    The true motion is known in closed form, or computed by two methods that have little in common.
    A run is accurate, or says in a warning or an error that it is not, or is not started as too
    long; else it is silently wrong. ``quick`` runs a few cases, ``only`` those with this in their
    name.

    >>> from tenscontrol.accuracy.suite import extreme_suite
    >>> found = extreme_suite(quick=True, only="free bar")
    >>> len(found.silent), found.methods[:3]
    (0, ('rk4', 'rattle', 'rattle4'))
    """
    checked_truth("quick", quick, "whether to run a few cases only")
    cases = [case for case in extremes(quick) if only in case.name]
    if not cases:
        groups = ", ".join(dict.fromkeys(case.group for case in extremes(quick)))
        raise ValueError(f"only is {only!r}, found in none of the cases: {groups}")
    rows: list[Verdict] = []
    names = methods()
    kept = keeping("runs are judged", rows.__len__)
    with kept, progress_bar(len(cases), progress, "suite", "cases") as report:
        for case in cases:
            known = truth(case)
            for method in names:
                rows.append(judge(case, known, method))
                report(len(rows) / len(names))
    return SuiteResult(tuple(rows))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the suite; return 0, 1 where a run was silently wrong, or 2 with a message on stderr.

    Ended by Ctrl-C or SIGTERM, it prints what is done and returns 130 or 143.
    """
    options = _parser().parse_args(arguments)
    with interruptible() as came:
        try:
            found = extreme_suite(options.quick, options.only, progress=True)
            if options.csv is not None:
                found.to_csv(options.csv)
            if options.markdown is not None:
                write_file(options.markdown, found.to_markdown())
        except (ValueError, ArithmeticError, OSError) as error:
            print(f"suite: {error}", file=sys.stderr)
            return 2
    print(found.table())
    return int(bool(found.silent)) if came.signal is None else came.status


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tenscontrol.accuracy.suite",
        description="Run every integration method on stiff and extreme structures, and print "
        "which is accurate, which warns, stops or is too long. Exit status 1 if a run is "
        "silently wrong.",
    )
    parser.add_argument("--quick", action="store_true", help="a few cases only")
    parser.add_argument("--only", default="", metavar="TEXT", help="cases with this in their name")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="save every run with its reason")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="save the table")
    return parser


if __name__ == "__main__":
    sys.exit(main())
