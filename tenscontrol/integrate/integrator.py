"""What every integrator does: carry a state over a span of time while the input is held."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from dataclasses import dataclass, fields
from typing import TypeVar

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Equation, compiled
from tenscontrol.validation import FloatArray, positive_number

_Built = TypeVar("_Built")

# Told the time reached within the span, s.
Report = Callable[[float], None]


@dataclass(frozen=True)
class Work:
    """What an integration cost, and how often strings went slack or taut.

    Attributes
    ----------
    steps : int
        Steps taken.
    rejections : int
        Steps that were tried and thrown away, because their error was too large.
    evaluations : int
        Evaluations of the right-hand side, or of the forces.
    switches : int
        Strings that went slack or taut with the step made to end there, counted singly.
    unlocated : int
        Steps across a switch that was not located.
    """

    steps: int = 0
    rejections: int = 0
    evaluations: int = 0
    switches: int = 0
    unlocated: int = 0

    def __add__(self, other: Work) -> Work:
        return Work(
            **{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)}
        )


@dataclass(frozen=True, eq=False)
class Span:
    """States at equally spaced times of one span, its start left out.

    Attributes
    ----------
    states : ndarray, shape (states, outputs)
    work : Work
    """

    states: FloatArray
    work: Work


class IntegrationError(ArithmeticError):
    """An integration that could not go on.

    Attributes
    ----------
    time : float
        Time within the span up to which the states are good, s.
    span : Span
        What was reached, at as many output times as were.
    interrupted : bool
        Whether the user stopped it (Ctrl-C); nothing is wrong then.
    """

    def __init__(self, message: str, time: float, span: Span, interrupted: bool = False) -> None:
        super().__init__(message)
        self.time = time
        self.span = span
        self.interrupted = interrupted


def checked_tolerance(tolerance: object, least: float = 100 * float(np.finfo(float).eps)) -> float:
    """Return a tolerance, or raise: below ``least`` round-off would reject every step."""
    value = positive_number("tolerance", tolerance, "of size and speed")
    if value < least:
        raise ValueError(
            f"tolerance is {value:g}, expected at least {least:.1e}: "
            "double precision goes no further"
        )
    return value


def in_machine_code(equation: Equation, step: ca.Function, wanted: bool) -> tuple[ca.Function, str]:
    """Return steps in machine code, if that is wanted and there is a compiler, and what runs them.

    Where the forces are compiled loops already, the steps around them stay with CasADi.
    """
    if equation.form == "loops":
        return step, "machine code for the forces"
    code = compiled(step) if wanted else None
    return (step, "virtual machine") if code is None else (code.function, "machine code")


class Integrator(ABC):
    """Integrates ``ẋ = f(x, u)`` with u held.

    Parameters
    ----------
    equation : Equation
    """

    #: Name as users give it to ``simulate(method=...)``.
    name: str

    #: What runs the steps: ``"virtual machine"`` (CasADi's), ``"machine code"`` (compiled C), or
    #: ``"machine code for the forces"``.
    back_end = "virtual machine"

    def __init__(self, equation: Equation) -> None:
        self._equation = equation

    def _kept(self, build: Callable[[], _Built], *settings: Hashable) -> _Built:
        """Return what is built once for the equation, this class and these settings."""
        return self._equation.prepared.get((type(self), *settings), build)

    @abstractmethod
    def advance(
        self,
        state: FloatArray,
        held: FloatArray,
        duration: float,
        outputs: int,
        report: Report | None = None,
    ) -> Span:
        """Return the states at ``outputs`` equally spaced times, the last at ``duration``.

        Parameters
        ----------
        state : ndarray, shape (states,)
            x at the start.
        held : ndarray, shape (inputs,)
            u, constant over the span.
        duration : float
            Length of the span, s.
        outputs : int
            Number of states to return, at least 1.
        report : callable, optional
            Told the time reached, now and then.

        Returns
        -------
        Span

        Raises
        ------
        IntegrationError
            If the state grows beyond all bounds, the step size vanishes, or
            the user interrupts.
        """
