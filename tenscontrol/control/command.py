"""A command of a controller: its decision, or a fallback in place of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from tenscontrol.arrays import FloatArray
from tenscontrol.short_repr import short_repr
from tenscontrol.status import Status


class ControlWarning(RuntimeWarning):
    """A closed loop that does not reach its reference, or cannot."""


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

    __repr__ = short_repr

    def __str__(self) -> str:
        """Return status, fallback and detail in one line."""
        return ": ".join(filter(None, (self.status, self.fallback, self.detail)))
