"""Statuses of commands and of estimates."""

from __future__ import annotations

from enum import StrEnum


class Status(StrEnum):
    """Status of a command or an estimate: ok, or why it is not. Compare with ``is``.

    In C code a status is its position here, counted from 0.
    """

    OK = "ok"
    # Of a command.
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
    # Of an estimate: what became of the readings.
    PARTLY_USED = "partly used"
    LOST = "lost"
    REFUSED = "refused"
    WAITING = "waiting"
    RESTARTED = "started anew"


#: Statuses that only estimates have.
OF_ESTIMATES = frozenset(
    {Status.PARTLY_USED, Status.LOST, Status.REFUSED, Status.WAITING, Status.RESTARTED}
)

#: Statuses of a quadratic program that was not solved.
UNSOLVED = frozenset(
    {
        Status.INACCURATE, Status.INFEASIBLE, Status.UNBOUNDED, Status.OUT_OF_ITERATIONS,
        Status.OUT_OF_TIME, Status.NOT_CONVEX, Status.INTERRUPTED, Status.UNSOLVED, Status.BAD_DATA,
    }
)  # fmt: skip
