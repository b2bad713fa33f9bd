"""The interface of what solves quadratic programs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.short_repr import short_repr
from tenscontrol.status import Status

if TYPE_CHECKING:
    from scipy.sparse import csc_array

# Numbers of a program are below this; a bound beyond it is none.
_LARGEST = 1e20

# Of a program, where none are asked for.
MOST_ITERATIONS = 4000


@dataclass(frozen=True, eq=False)
class QPSolution:
    """Solution of a quadratic program, with its status.

    Attributes
    ----------
    status : Status
    x, y : ndarray or None
        Primal and dual solution; None unless the status is ``OK``.
    iterations : int
    """

    status: Status
    x: FloatArray | None
    y: FloatArray | None
    iterations: int

    __repr__ = short_repr


class QPSolver(ABC):
    """Interface of solvers of ``min ½ xᵀ P x + qᵀ x  subject to  l ≤ A x ≤ u``.

    Dual variables y have the sign of ``P x + q + Aᵀ y = 0``: positive at upper bounds.

    Parameters
    ----------
    P : sparse array, shape (k, k)
        Symmetric positive semidefinite; all of it.
    A : sparse array, shape (m, k)
    tolerance : float
        Absolute and relative tolerance of the residuals.
    max_iterations : int
    equations : bool
        Whether many rows of A are equations, and all are in units of their own already.
    """

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"

    @abstractmethod
    def __init__(
        self,
        P: csc_array,
        A: csc_array,
        tolerance: float,
        max_iterations: int,
        *,
        equations: bool = False,
    ) -> None: ...

    @abstractmethod
    def update(self, A: FloatArray) -> None:
        """Put other values into A, in the order of its columns; the pattern stays.

        Parameters
        ----------
        A : ndarray, shape (nonzeros of A,)

        Raises
        ------
        ValueError
            If there are not as many values as A has nonzeros, or one is not finite.
        """

    @abstractmethod
    def solve(
        self,
        q: FloatArray,
        l: FloatArray,  # noqa: E741 - the letters of the problem
        u: FloatArray,
        start: tuple[FloatArray, FloatArray] | None = None,
        deadline: float = np.inf,
    ) -> QPSolution:
        """Solve for new vectors, from the last solution or from a given start.

        Parameters
        ----------
        q : ndarray, shape (k,)
        l, u : ndarray, shape (m,)
            May be infinite.
        start : pair of ndarray, shapes (k,) and (m,), optional
            Primal and dual vectors to start from.
        deadline : float
            When ``perf_counter`` says so, s, the solve is given up: before it
            begins, or at the end of an iteration.

        Returns
        -------
        QPSolution
            Data that are not finite, and bounds that cross, are answered by a status.

        Raises
        ------
        ValueError
            If a vector has the wrong length.
        """

    @abstractmethod
    def reset(self) -> None:
        """Forget the last solution, and all that was adapted to it."""


def refused(
    q: FloatArray,
    l: FloatArray,  # noqa: E741 - the letters of the problem
    u: FloatArray,
    shape: tuple[int, int],
    deadline: float,
) -> QPSolution | None:
    """Return the answer to vectors that no solver should be given, or too late; None if fine.

    A has this shape. A solver takes 1e30 for infinite, and loses its digits long before. What is
    not a number may poison it for good.
    """
    for name, vector, size in (("q", q, shape[1]), ("l", l, shape[0]), ("u", u, shape[0])):
        if vector.shape != (size,):
            raise ValueError(f"{name} has shape {vector.shape}, expected ({size},)")
    # What is not a number is the largest and the least, and comparisons with it are false.
    usable = (
        np.abs(q).max(initial=0.0) < _LARGEST
        and l.max(initial=0.0) < _LARGEST
        and u.min(initial=0.0) > -_LARGEST
    )
    if not usable:
        return QPSolution(Status.BAD_DATA, None, None, 0)
    if not (l <= u).all():
        return QPSolution(Status.INFEASIBLE, None, None, 0)
    if deadline < np.inf and deadline <= perf_counter():
        return QPSolution(Status.OUT_OF_TIME, None, None, 0)
    return None


def check_values(A: FloatArray, nonzeros: int) -> None:
    """Raise for values of A that are too many, too few or not finite."""
    if A.shape != (nonzeros,) or not np.isfinite(A).all():
        raise ValueError(f"A needs {nonzeros} finite values, got shape {A.shape}")
