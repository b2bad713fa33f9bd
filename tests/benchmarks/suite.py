"""Is a run of a stiff or extreme structure ever wrong without a warning? Every method on each.

Run: ``python -m tests.benchmarks.suite [--quick] [--only ground] [--csv docs/suite.csv]``.
``--quick`` runs a few cases, ``--only`` those with this in their name; ``--csv`` saves the table.
It takes some minutes, and ends with status 1 if a run is silently wrong.

The true motion of a case is known in closed form, or computed by two methods that have little in
common. A run is accurate, or says in a warning or an error that it is not, or is not started as too
long; else it is silently wrong.
"""

from __future__ import annotations

import csv
import sys
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol.accuracy.open_loop import state_change
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.equation import unpack_states
from tenscontrol.integrate import CVODES, DOP853, RK4, EnergyMomentum, Integrator
from tenscontrol.progress import progress_bar
from tenscontrol.simulation import (
    AccuracyWarning,
    HealthLimits,
    SimulationError,
    Trajectory,
    simulate,
)
from tenscontrol.structure.supports import random_moves
from tenscontrol.tables import aligned
from tests.benchmarks.command_line import options
from tests.benchmarks.extreme_cases import ASKED, TOLERANCE, Extreme, extremes, methods

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
    step = 0.03 / extreme.frequency
    return main, RK4(equation, step), f"dop853 at 1e-12, rk4 at {step:.1e} s"


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
    moves = random_moves(case.structure, np.random.default_rng(0))
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

    Errors are by the size: ``error`` up to the ``part`` of the duration that is compared;
    ``error_to_end`` to the end, or to where the truth is known; ``estimate`` is the run's own,
    ``growth`` that of a small perturbation of the start, ``reference_error`` that of the truth.
    ``reason`` has the words of the run. NaN: not known.
    """

    case: str
    method: str
    verdict: str
    error: float = float("nan")
    error_to_end: float = float("nan")
    estimate: float = float("nan")
    part: float = 0.0
    growth: float = float("nan")
    reference_error: float = float("nan")
    reason: str = ""

    @property
    def is_lost(self) -> bool:
        """Whether errors grew beyond what was asked without a word, after the time compared."""
        return self.verdict == "in part" and self.error_to_end > ASKED and not self.reason


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
        return Verdict(**row, verdict="too long", reason=reason)
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
            return Verdict(**row, verdict="stopped", reason=str(error)[:_LONGEST])
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
        part=outputs / extreme.outputs,
        reason="; ".join(warned)[:_LONGEST],
    )


# ---- the table ----


def cells(rows: Sequence[Verdict]) -> tuple[list[str], list[list[str]]]:
    """Return the head of the table, and a line for each case with a cell for each method."""
    names = list(dict.fromkeys(row.method for row in rows))
    lines = []
    for case in dict.fromkeys(row.case for row in rows):
        by_method = {row.method: row for row in rows if row.case == case}
        first = next(iter(by_method.values()))
        start = [case, f"{first.reference_error:.0e}", f"{first.growth:.0e}"]
        lines.append([*start, *(cell(by_method[name]) for name in names)])
    return ["case", "truth", "growth", *names], lines


def cell(row: Verdict) -> str:
    """Return what came of a run in a word or a number."""
    if row.verdict in ("accurate", "in part"):
        text = f"{row.error:.0e}" + (" (w)" if row.reason else "")
    elif row.verdict in ("warned", "SILENT"):
        word = "w" if row.verdict == "warned" else "SILENT"
        text = f"{word} {row.error:.0e}"
    else:
        return row.verdict
    return text if row.part > 0.999 else f"{text} to {row.part:.0%}"


def summary(rows: Sequence[Verdict]) -> str:
    """Return what was asked, how often each verdict came, and every silent failure."""
    found = Counter(row.verdict for row in rows)
    counts = ", ".join(f"{found[verdict]} {verdict}" for verdict in VERDICTS)
    lines = [
        f"Errors are the largest distance of a node from the truth, by the size of the "
        f"structure; asked for {ASKED:g}, at tolerance {TOLERANCE:g} or steps that fit.",
        "(w): accurate, and warned all the same; w: wrong, and warned. Growth is that of a "
        "perturbation of the start: where it is large, motions are compared for the part of "
        "the time given.",
        f"{len(rows)} runs: {counts}.",
    ]
    lost = [row for row in rows if row.is_lost]
    if lost:
        runs = ", ".join(f"{row.method} in {row.case}" for row in lost)
        lines.append(
            f"Past the part compared, errors grew beyond what was asked and the run did not "
            f"say so in {len(lost)}: {runs}."
        )
    lines += [
        f"SILENT: {row.case}, {row.method}: error {row.error:.1e}, its own estimate "
        f"{row.estimate:.1e}"
        for row in rows
        if row.verdict == "SILENT"
    ]
    return "\n".join(lines)


def judged(quick: bool = False, only: str = "") -> list[Verdict]:
    """Return what came of every method in each case, or in those with ``only`` in their name."""
    cases = [case for case in extremes(quick) if only in case.name]
    if not cases:
        groups = ", ".join(dict.fromkeys(case.group for case in extremes(quick)))
        raise SystemExit(f"--only is {only!r}, found in none of the cases: {groups}")
    rows: list[Verdict] = []
    with progress_bar(len(cases), True, "suite", "cases") as report:
        for done, case in enumerate(cases, 1):
            known = truth(case)
            rows += [judge(case, known, method) for method in methods()]
            report(done)
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 where a run was silently wrong, else 0."""
    given = options(__doc__, arguments, quick=False, only="", csv="")
    rows = judged(given.quick, given.only)
    head, lines = cells(rows)
    if given.csv:
        with Path(given.csv).open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([head, *lines])
    print(f"{aligned(head, lines)}\n\n{summary(rows)}")
    return int(any(row.verdict == "SILENT" for row in rows))


if __name__ == "__main__":
    sys.exit(main())
