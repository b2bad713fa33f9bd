"""A command of a controller, its status and its fallback."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from tenscontrol.validation import FloatArray


class Status(StrEnum):
    """Status of a command: ok, or why it is not. Compare with ``is``."""

    OK = "ok"
    SATURATED = "saturated"
    UNREACHED = "error dynamics not reached"
    MEASUREMENT_NOT_FINITE = "measurement not finite"
    MEASUREMENT_NOT_PLAUSIBLE = "measurement not plausible"
    INPUT_NOT_FINITE = "input not finite"
    # Of a quadratic program that was not solved.
    INACCURATE = "solved inaccurately"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    OUT_OF_ITERATIONS = "out of iterations"
    OUT_OF_TIME = "out of time"
    NOT_CONVEX = "not convex"
    INTERRUPTED = "interrupted"
    UNSOLVED = "unsolved"
    BAD_DATA = "data not finite or too large"


class ControlWarning(RuntimeWarning):
    """A closed loop that does not reach its reference, or cannot."""


#: Statuses of a quadratic program that was not solved.
UNSOLVED = frozenset(
    {
        Status.INACCURATE, Status.INFEASIBLE, Status.UNBOUNDED, Status.OUT_OF_ITERATIONS,
        Status.OUT_OF_TIME, Status.NOT_CONVEX, Status.INTERRUPTED, Status.UNSOLVED, Status.BAD_DATA,
    }
)  # fmt: skip


class Fallback(StrEnum):
    """The command that replaces a decision of the controller."""

    PLAN_CONTINUED = "plan continued"
    PREVIOUS_INPUT_HELD = "previous input held"
    EQUILIBRIUM_HELD = "equilibrium held"


@dataclass(frozen=True, eq=False)
class Command:
    """The command of a controller for one sample, with its status.

    Attributes
    ----------
    value : ndarray, shape (α,)
        γ, N/m, or rest lengths, m, as the controller's ``input`` says. Finite
        and within the controller's bounds, always; where the change is limited,
        no farther than that from the previous input.
    status : Status
        ``Status.OK``, or why the command is not what the controller wanted.
    fallback : Fallback or None
        What was commanded instead; None if the command is the controller's decision.
    detail : str
        Figures that explain the status.
    """

    value: FloatArray
    status: Status = Status.OK
    fallback: Fallback | None = None
    detail: str = ""

    def __str__(self) -> str:
        """Return status, fallback and detail in one line."""
        return ": ".join(filter(None, (self.status, self.fallback, self.detail)))
