"""Least squares within bounds, of matrices that change but not in shape."""

from __future__ import annotations

import numpy as np

from tenscontrol.control.mpc import OSQPSolver, QPSolution
from tenscontrol.validation import FloatArray


class BoundedLeastSquares:
    """``min ½ price |x − c|² + ½ |J x − d|²`` with ``low ≤ x ≤ high``, by OSQP.

    The residual is a variable of the program, so that J stands in its constraints: a new J
    changes values in place, and the pattern stays.

    Parameters
    ----------
    rows, columns : int
        Shape of J.
    price : float
        Above 0: it chooses among the x that do equally well.
    tolerance : float
        OSQP's absolute and relative tolerance, before the answer is polished.
    max_iterations : int
    """

    def __init__(
        self, rows: int, columns: int, price: float, tolerance: float, max_iterations: int
    ) -> None:
        from scipy.sparse import csc_array, diags_array, eye_array, hstack, vstack

        self._price, self._columns = price, columns
        P = csc_array(diags_array(np.r_[np.full(columns, price), np.ones(rows)]))
        bounds = hstack([eye_array(columns), csc_array((columns, rows))])
        law = hstack([csc_array(np.ones((rows, columns))), -eye_array(rows)])
        A = csc_array(vstack([bounds, law]))
        self._made_of = P, A, tolerance, max_iterations
        self.reset()

    def forget(self) -> None:
        """Start the next solve from the centre."""
        self._guess: tuple[FloatArray, FloatArray] | None = None

    def reset(self) -> None:
        """Forget the last answer, and what the solver adapted to it and to the matrices before."""
        self.forget()
        # Where A is updated, OSQP scales it anew by what the cost was then: only a new one forgets.
        self._program = OSQPSolver(*self._made_of, polish=True)

    def solve(
        self, J: FloatArray, d: FloatArray, c: FloatArray, low: FloatArray, high: FloatArray
    ) -> QPSolution:
        """Return the answer; x are its first entries, the residual ``J x − d`` the others.

        Parameters
        ----------
        J : ndarray, shape (rows, columns)
            Finite.
        d : ndarray, shape (rows,)
        c, low, high : ndarray, shape (columns,)
        """
        # The nonzeros of A column by column: one bound and a column of J each, then −1.
        by_x = np.vstack([np.ones(self._columns), J]).ravel(order="F")
        self._program.update(np.concatenate([by_x, np.full(len(d), -1.0)]))
        start = self._guess
        if start is None:
            start = np.r_[c, J @ c - d], np.zeros(len(c) + len(d))
        answer = self._program.solve(
            np.r_[-self._price * c, np.zeros(len(d))], np.r_[low, d], np.r_[high, d], start=start
        )
        self._guess = None
        if answer.x is not None and answer.y is not None:
            self._guess = answer.x, answer.y
        return answer

    def unbounded(self, J: FloatArray, d: FloatArray, c: FloatArray) -> FloatArray:
        """Return x without bounds, shape (columns,), by the normal equations.

        Parameters
        ----------
        J : ndarray, shape (rows, columns)
        d : ndarray, shape (rows,)
        c : ndarray, shape (columns,)
        """
        normal = J.T @ J + self._price * np.eye(self._columns)
        return c + np.linalg.solve(normal, J.T @ (d - J @ c))
