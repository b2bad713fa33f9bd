"""Errors and warnings of a run: it stops, or its motion passes a limit."""

from __future__ import annotations

from tenscontrol.integrate.methods import Choice
from tenscontrol.simulation.health import (
    AccuracyWarning,
    BarCrossingWarning,
    HealthLimits,
    StrengthWarning,
)
from tenscontrol.simulation.strength import strength
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.warn import warn


class SimulationError(ArithmeticError):
    """A simulation that stopped before its end; it carries the motion up to there.

    Attributes
    ----------
    trajectory : Trajectory
        The motion up to the time of the failure.
    """

    def __init__(self, message: str, trajectory: Trajectory) -> None:
        super().__init__(message)
        self.trajectory = trajectory


def check_health(run: Trajectory, limits: HealthLimits) -> None:
    """Warn or raise where the motion passes a limit."""
    health = run.health_of(limits.names)
    passed = limits.passed(health)
    # What real members do not do, though the motion of the model is right.
    impossible: list[tuple[str | None, type[Warning]]] = [
        (passed.pop("crossings", None), BarCrossingWarning)
    ]
    if limits.sections is not None:
        failure = strength(run, limits.sections).failure(limits.margin)
        impossible.append((failure, StrengthWarning))
    for sentence, category in impossible:
        if sentence and limits.action == "raise":
            raise SimulationError(sentence, run)
        if sentence:
            warn(sentence, category)
    if not passed:
        return
    text = "; ".join(passed.values())
    # How deep nodes sink, a fall, and steps of motors are no errors of the integration.
    if passed.keys() - {"penetration", "fall", "rest_length_error"}:
        text += f": the motion may not be accurate. Try {finer(run.choice)}"
    if health.trusted_until is not None and health.trusted_until < run.time[-1]:
        text += "; a motion that magnifies errors can only be foretold for a time, see run.error"
    if limits.action == "raise":
        raise SimulationError(text, run)
    warn(text, AccuracyWarning)


def finer(used: Choice) -> str:
    """Return what to try where a motion is not accurate."""
    return (
        "a smaller tolerance" if used.setting == "tolerance" else f"a step below {used.value:g} s"
    )
