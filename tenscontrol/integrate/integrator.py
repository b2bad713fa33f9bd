"""What every integrator does: carry a state over a span of time while the input is held."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from tenscontrol.validation import FloatArray

# Told the time reached within the span, s.
Report = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Span:
    """States at equally spaced times of one span, its start left out.

    Attributes
    ----------
    states : ndarray, shape (states, outputs)
    steps : int
        Steps taken.
    evaluations : int
        Evaluations of the right-hand side.
    """

    states: FloatArray
    steps: int
    evaluations: int


class IntegrationError(ArithmeticError):
    """An integration that could not go on.

    Attributes
    ----------
    time : float
        Time within the span up to which the states are good, s.
    span : Span
        What was reached, at as many output times as were.
    """

    def __init__(self, message: str, time: float, span: Span) -> None:
        super().__init__(message)
        self.time = time
        self.span = span


class Integrator(ABC):
    """Integrates ``ẋ = f(x, u)`` with u held.

    Parameters
    ----------
    equation : casadi.Function
        ``(x, u) -> xdot``, dense column vectors.
    """

    #: Name as users give it to ``simulate(method=...)``.
    name: str

    def __init__(self, equation: ca.Function) -> None:
        self._equation = equation

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
            If the state grows beyond all bounds or the step size vanishes.
        """
