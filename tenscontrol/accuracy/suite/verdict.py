"""What comes of one method in one case."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscontrol.accuracy.suite.extreme import ASKED, Extreme
from tenscontrol.accuracy.suite.truth import Truth
from tenscontrol.simulation import (
    AccuracyWarning,
    HealthLimits,
    SimulationError,
    Trajectory,
    simulate,
)
from tenscontrol.validation import FloatArray

#: What can come of a method; the last is what must not.
VERDICTS = ("accurate", "in part", "warned", "stopped", "refused", "too long", "unknown", "SILENT")

# What the runs are told to warn of.
_LIMITS = HealthLimits(position_error=ASKED)

# Length at which reasons are cut off in what is kept.
_LONGEST = 200


@dataclass(frozen=True)
class Verdict:
    """What came of one method in one case.

    Attributes
    ----------
    case, method : str
    verdict : str
        One of :data:`VERDICTS`.
        ``"accurate"``: the error is no larger than asked. ``"in part"``: nor is
        it up to where the growth of a perturbation lets motions be compared,
        before the end; beyond, errors grow, of which the run may know nothing. ``"warned"``: it is
        larger, and the run said so. ``"stopped"``: the run ended with an
        error; ``"refused"``: it did not begin. ``"too long"``: not run, for it
        would take too many evaluations. ``"unknown"``: there is no truth to
        compare with. ``"SILENT"``: wrong without a word.
    error : float
        Largest distance of a node from the truth, by the size; NaN without a run.
    error_to_end : float
        The same to the end, or to where the truth is known.
    estimate : float
        The run's own estimate, ``run.health.position_error``; NaN without one.
    asked : float
    compared : float
        Time up to which the comparison means something, s.
    part : float
        The same as part of the duration.
    growth : float
        How much a small perturbation of the start grows by the end.
    reference_error : float
        Error of the truth itself, by the size.
    evaluations : float
        Taken, or expected where it was not run.
    reason : str
        The words of the run, or why it was not run; empty if there are none.
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

    @property
    def is_silent(self) -> bool:
        """Whether the run was wrong without a word."""
        return self.verdict == "SILENT"


def judge(extreme: Extreme, known: Truth, method: str) -> Verdict:
    """Run a method on a case and return what came of it.

    Parameters
    ----------
    extreme : Extreme
    known : Truth
        Of the case.
    method : str
        One of :func:`methods`.

    Returns
    -------
    Verdict
    """
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
    given: dict[str, Any] = {case.input: case.value}
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
    told = [str(w.message) for w in caught if issubclass(w.category, AccuracyWarning)]
    return _compared(extreme, known, run, row, told)


def _compared(
    extreme: Extreme, known: Truth, run: Trajectory, row: dict[str, Any], told: list[str]
) -> Verdict:
    estimate = run.position_error
    outputs = known.comparable(0.0 if estimate is None else estimate)
    errors = _errors(extreme, known, run)
    if not outputs:
        verdict = "warned" if told else "unknown"
    elif errors[outputs - 1] > ASKED:
        verdict = "warned" if told else "SILENT"
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
        reason="; ".join(told)[:_LONGEST],
    )


def _errors(extreme: Extreme, known: Truth, run: Trajectory) -> FloatArray:
    """Return the largest error up to each time at which the truth is known, by the size."""
    # The start comes first in a run.
    far = run.nodes[:, :, 1 : known.outputs + 1] - known.nodes[:, :, : known.outputs]
    errors = np.linalg.norm(far, axis=0).max(axis=0) / extreme.case.size
    return np.asarray(np.maximum.accumulate(errors))
