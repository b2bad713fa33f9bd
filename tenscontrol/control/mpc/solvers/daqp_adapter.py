"""DAQP as a solver of quadratic programs: a dense dual active set, exact to round-off."""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING, Any, final

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.control.mpc.solvers.solver import QPSolution, QPSolver, check_values, refused
from tenscontrol.status import Status

if TYPE_CHECKING:
    from scipy.sparse import csc_array

# Every exit flag of DAQP.
_STATUS = {
    5: Status.INACCURATE,  # an integer solution that may not be the best
    4: Status.INACCURATE,  # beyond the tolerance after cycling
    3: Status.INACCURATE,  # the first levels of a hierarchy alone
    2: Status.OK,  # a soft row is violated
    1: Status.OK,
    -1: Status.INFEASIBLE,
    -2: Status.UNSOLVED,  # cycling
    -3: Status.UNBOUNDED,
    -4: Status.OUT_OF_ITERATIONS,
    -5: Status.NOT_CONVEX,
    -6: Status.INFEASIBLE,  # equations contradict each other
    -7: Status.OUT_OF_TIME,
    -8: Status.UNSOLVED,  # unsupported
}

# Bits of a row's state in DAQP (the last: soft, and not violated), and the least multiplier of one
# that is active.
_ACTIVE, _LOWER, _SOFT, _KEPT = 1, 2, 8, 32
_INACTIVE = 1e-12

# Rows are kept to this, in their units: an active set has no use for less.
_TOLERANCE = 1e-10


@final
class DAQPSolver(QPSolver):
    """See :class:`QPSolver`. Best for small, dense programs: its rows are stored in full.

    The active set of the last solution, or of a given start, is where a solve begins. Answers are
    exact to round-off: ``tolerance`` matters only below 1e-10. ``equations`` means nothing to it.
    DAQP looks at the clock every 32 iterations.

    Violations of soft rows (a diagonal entry of P, a row ``e ≥ 0``, and an entry of ±1 in a row
    bounded from one side, or in two such rows that are alike but for the side) are no unknowns for
    DAQP, which has the price of a row instead. Where the data of a program are not those of
    violations, they become unknowns like all others, until a reset.
    """

    def __init__(
        self,
        P: csc_array,
        A: csc_array,
        tolerance: float,
        max_iterations: int,
        *,
        equations: bool = False,
    ) -> None:
        self._made_of = P, A.copy(), tolerance, max_iterations
        self._shape, self._nonzeros = A.shape, A.nnz
        self._tolerance, self._max_iterations = min(tolerance, _TOLERANCE), max_iterations
        self._found = _violations(P, A)
        # The vector that is expected: no slope, and soft rows with one price for both powers.
        self._usual_q = np.zeros(A.shape[1])
        self._usual_q[self._found[0]] = P.diagonal()[self._found[0]]
        self._values = self._made_of[1].data
        self._prepare(*self._found)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what the program is made of; DAQP's own memory, and what it solved, stay here."""
        return DAQPSolver, self._made_of

    def _prepare(
        self, unknown: IntArray, bound: IntArray, below: IntArray, above: IntArray
    ) -> None:
        """Lay out the program for DAQP, with violations as given."""
        P, A, *_ = self._made_of
        rows, columns = self._shape
        self._violation, self._bound, self._below, self._above = unknown, bound, below, above
        self._free = np.setdiff1d(np.arange(columns), unknown)
        # Each row of DAQP has its bounds from two rows of A, which are mostly one.
        is_row = np.ones(rows, bool)
        is_row[bound] = False
        both = (below >= 0) & (above >= 0)
        is_row[above[both]] = False
        self._low_row = np.flatnonzero(is_row)  # all of them, in order, where none is soft
        number = np.zeros(rows, np.int64)
        number[self._low_row] = np.arange(len(self._low_row))
        number[above[both]] = number[below[both]]
        self._high_row = self._low_row.copy()
        self._high_row[number[below[both]]] = above[both]
        self._soft = number[np.where(below >= 0, below, above)]
        self._price = P.diagonal()[unknown]
        # Where the values of A go, those of violations aside.
        row, column = A.indices, np.repeat(np.arange(columns), np.diff(A.indptr))
        place = np.zeros(columns, np.int64)
        place[self._free] = np.arange(len(self._free))
        linked = np.isin(column, unknown)
        self._kept, self._linked = np.flatnonzero(~linked), np.flatnonzero(linked)
        self._place = number[row[self._kept]], place[column[self._kept]]
        # The states of rows none of which is active.
        self._none = np.zeros(len(self._low_row), np.intc)
        self._none[self._soft] = _SOFT
        self._hessian = P.toarray()[np.ix_(self._free, self._free)]
        self._fill()
        self._forget()

    def _prepare_without_violations(self) -> None:
        none = np.zeros(0, np.int64)
        self._prepare(none, none, none, none)

    def _forget(self) -> None:
        """Set up anew, so that the next solve need not, for the vector that is expected."""
        self._model: Any = None
        self._set_up(self._usual_q)
        # The slope and the multipliers of DAQP's rows where the next solve begins.
        self._last: tuple[FloatArray, FloatArray] | None = None

    def _fill(self) -> None:
        self._matrix = np.zeros((len(self._low_row), len(self._free)))
        self._matrix[self._place] = self._values[self._kept]

    def update(self, A: FloatArray) -> None:
        """See :meth:`QPSolver.update`."""
        check_values(A, self._nonzeros)
        linked = np.array_equal(A[self._linked], self._values[self._linked])
        self._values, self._changed = A.copy(), True
        self._fill()
        # Rows of two sides that are no longer alike are no rows of violations either.
        if not linked or not np.array_equal(self._matrix[self._place], A[self._kept]):
            self._prepare_without_violations()

    def reset(self) -> None:
        """See :meth:`QPSolver.reset`."""
        first = self._made_of[1].data
        changed, self._values = self._values is not first, first
        if self._violation is not self._found[0]:
            self._prepare(*self._found)
            return
        if changed:
            self._fill()
        self._forget()

    def _set_up(self, q: FloatArray) -> int:
        """Make a model without bounds; return DAQP's exit flag."""
        import daqp

        rows = len(self._low_row)
        infinite = np.full(rows, np.inf)
        model = daqp.Model()
        slope = q[self._free].copy()
        self._sloped, self._timed = bool(slope.any()), False
        # Without a slope DAQP does not transform the bounds at each solve.
        flag: int = model.setup(
            self._hessian, slope if self._sloped else None, self._matrix, infinite, -infinite,
            self._none,
        )[0]  # fmt: skip
        model.settings = {
            "primal_tol": self._tolerance,
            "iter_limit": self._max_iterations + 1,  # it counts from 1 and stops before
        }
        self._q, self._changed = q.copy(), False
        if flag < 0:
            return flag
        self._model = model
        if len(self._soft):
            softness, price = np.zeros(rows), np.zeros(rows)
            softness[self._soft], price[self._soft] = 1 / self._price, q[self._violation]
            model.soft_weights(softness, softness, price, price)
        return flag

    def _are_violations(self, q: FloatArray, l: FloatArray, u: FloatArray) -> bool:  # noqa: E741
        """Whether the vectors are those of violations where the pattern is."""
        below, above = self._below[self._below >= 0], self._above[self._above >= 0]
        return not (
            l[self._bound].any()
            or (q[self._violation] <= 0).any()
            or np.isfinite(u[self._bound]).any()
            or np.isfinite(u[below]).any()
            or np.isfinite(l[above]).any()
        )

    def solve(
        self,
        q: FloatArray,
        l: FloatArray,  # noqa: E741 - the letters of the problem
        u: FloatArray,
        start: tuple[FloatArray, FloatArray] | None = None,
        deadline: float = np.inf,
    ) -> QPSolution:
        """See :meth:`QPSolver.solve`. Of a start, the active set counts."""
        answer = refused(q, l, u, self._shape, deadline)
        if answer is not None:
            return answer
        if len(self._violation) and not self._are_violations(q, l, u):
            self._prepare_without_violations()
        if start is not None:
            self._last = q, self._of_rows(start[1])
        flag, given = 0, {}
        if not np.array_equal(q, self._q):
            # DAQP has prices of rows, and no slope at all where there is none, from its setup on.
            if self._sloped and np.array_equal(q[self._violation], self._q[self._violation]):
                given["f"], self._q = q[self._free].copy(), q.copy()
            else:
                self._model = None
        if self._model is None:
            flag = self._set_up(q)
        if self._changed:
            given["A"], self._changed = self._matrix, False
        if flag >= 0:
            low, high = (l[self._low_row], u[self._high_row]) if len(self._soft) else (l, u)
            active = self._states(*self._last) if self._last else self._none
            flag = self._model.update(bupper=high, blower=low, sense=active, **given)
        if flag < 0:
            return self._failed(flag, 0)
        if deadline < np.inf or self._timed:
            limit = max(deadline - perf_counter(), np.finfo(float).tiny)
            self._timed = deadline < np.inf
            self._model.settings = {"time_limit": limit if self._timed else 0.0}
        x, _, flag, info = self._model.solve()
        if _STATUS[flag] is not Status.OK:
            return self._failed(flag, info["iterations"])
        return self._answer(q, x, info["lam"], info["iterations"])

    def _failed(self, flag: int, iterations: int) -> QPSolution:
        # What DAQP leaves then may start nothing.
        self._model, self._last, self._changed = None, None, False
        return QPSolution(_STATUS[flag], None, None, iterations)

    def _of_rows(self, y: FloatArray) -> FloatArray:
        """Return the multipliers of DAQP's rows, of which some have both bounds of a soft row."""
        if not len(self._soft):
            return y
        return np.asarray(np.maximum(y[self._high_row], 0) + np.minimum(y[self._low_row], 0))

    def _states(self, q: FloatArray, multiplier: FloatArray) -> np.ndarray:
        active = self._none.copy()
        if multiplier.any():
            active[multiplier > _INACTIVE] |= _ACTIVE
            active[multiplier < -_INACTIVE] |= _ACTIVE | _LOWER
            kept = np.abs(multiplier[self._soft]) <= q[self._violation]
            active[self._soft[kept]] |= _KEPT
        return active

    def _answer(
        self, q: FloatArray, found: FloatArray, multiplier: FloatArray, iterations: int
    ) -> QPSolution:
        rows, columns = self._shape
        self._last = q, multiplier
        if not len(self._soft):
            return QPSolution(Status.OK, found, multiplier, iterations)
        x, y = np.zeros(columns), np.zeros(rows)
        x[self._free] = found
        y[self._high_row] = np.maximum(multiplier, 0)
        y[self._low_row] += np.minimum(multiplier, 0)
        paid = np.abs(multiplier[self._soft]) - q[self._violation]
        x[self._violation] = np.maximum(paid, 0) / self._price
        y[self._bound] = np.minimum(paid, 0)
        return QPSolution(Status.OK, x, y, iterations)


def _violations(P: csc_array, A: csc_array) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Return the unknowns that are violations, the rows of their bounds, and where they are ±1.

    Row −1 is none. All are empty where one unknown that might be a violation is not.
    """
    none = np.zeros(0, np.int64)
    rows, columns = A.shape
    diagonal, column = P.diagonal(), np.repeat(np.arange(columns), np.diff(A.indptr))
    alone = np.bincount(A.indices, minlength=rows)[A.indices] == 1
    is_bound = alone & (A.data == 1) & ((np.diff(P.indptr) == 1) & (diagonal > 0))[column]
    unknown = np.unique(column[is_bound])
    linked = np.isin(column, unknown) & ~is_bound
    # A bound alone is not yet that of a violation.
    unknown = np.intersect1d(unknown, column[linked])
    mine = np.isin(column, unknown)
    is_bound, linked = is_bound & mine, linked & mine
    if not len(unknown) or is_bound.sum() != len(unknown):
        return none, none, none, none
    number = np.zeros(columns, np.int64)
    number[unknown] = np.arange(len(unknown))
    below, above = np.full(len(unknown), -1), np.full(len(unknown), -1)
    bound = np.zeros(len(unknown), np.int64)
    bound[number[column[is_bound]]] = A.indices[is_bound]
    row, sign, owner = A.indices[linked], A.data[linked], number[column[linked]]
    below[owner[sign == 1]] = row[sign == 1]
    above[owner[sign == -1]] = row[sign == -1]
    once = len(np.unique(row)) == len(row) == (below >= 0).sum() + (above >= 0).sum()
    both = (below >= 0) & (above >= 0)
    rest = A.toarray()
    rest[:, unknown] = 0.0
    if not once or not np.array_equal(rest[below[both]], rest[above[both]]):
        return none, none, none, none
    return unknown, bound, below, above


def least_distance(
    matrix: FloatArray, low: FloatArray, high: FloatArray, price: FloatArray,
    tolerance: float, max_iterations: int, deadline: float,
) -> tuple[Status, FloatArray, int]:  # fmt: skip
    """Return status, multipliers y and iterations of ``min ½ |x|², low ≤ M x ≤ high``.

    The answer is x = −Mᵀ y. A violation s of a soft row costs ``price (s + ½ s²)``; the price is
    infinite for hard rows.
    """
    import daqp

    if (low > high).any():
        return Status.INFEASIBLE, np.zeros(0), 0
    # In the span of the rows, which has few directions.
    factor = np.asarray(np.linalg.qr(matrix.T, mode="r"))
    soft, size = np.isfinite(price), len(factor)
    model, sense = daqp.Model(), np.where(soft, _SOFT, 0).astype(np.intc)
    flag: int = model.setup(np.eye(size), np.zeros(size), factor.T.copy(), high, low, sense)[0]
    if flag < 0:
        return _STATUS[flag], np.zeros(0), 0
    left = 0.0 if deadline == np.inf else max(deadline - perf_counter(), np.finfo(float).tiny)
    model.settings = {
        "primal_tol": 0.1 * tolerance, "dual_tol": 0.01 * tolerance, "time_limit": left,
        "iter_limit": max_iterations + 1,
    }  # fmt: skip
    if soft.any():
        cost, softness = np.where(soft, price, 0.0), np.where(soft, 1 / price, 0.0)
        model.soft_weights(softness, softness, cost, cost)
    _, _, flag, info = model.solve()
    return _STATUS[flag], info["lam"], info["iterations"]
