"""OSQP as a solver of quadratic programs."""

from __future__ import annotations

import ctypes
import signal
from time import perf_counter
from typing import TYPE_CHECKING, Any, final

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.control.mpc.qp_solver import QPSolution, QPSolver, check_values, refused
from tenscontrol.status import Status

if TYPE_CHECKING:
    from scipy.sparse import csc_array


# Every status that OSQP can return.
_STATUS = {
    "OSQP_SOLVED": Status.OK,
    "OSQP_SOLVED_INACCURATE": Status.INACCURATE,
    "OSQP_PRIMAL_INFEASIBLE": Status.INFEASIBLE,
    "OSQP_PRIMAL_INFEASIBLE_INACCURATE": Status.INFEASIBLE,
    "OSQP_DUAL_INFEASIBLE": Status.UNBOUNDED,
    "OSQP_DUAL_INFEASIBLE_INACCURATE": Status.UNBOUNDED,
    "OSQP_MAX_ITER_REACHED": Status.OUT_OF_ITERATIONS,
    "OSQP_TIME_LIMIT_REACHED": Status.OUT_OF_TIME,
    "OSQP_NON_CVX": Status.NOT_CONVEX,
    "OSQP_SIGINT": Status.INTERRUPTED,
    "OSQP_UNSOLVED": Status.UNSOLVED,
}


# Step of ADMM at the start.
_START_RHO = 1.0

# Refinements when OSQP solves for the bounds found active.
_REFINEMENTS = 10

# An answer is exact where its conditions are off by this part of their terms. Most active sets that
# are tried after that of OSQP. Where none is right, the tolerance gets finer by this factor.
_EXACT, _MOST_SETS, _FINER, _FINEST = 1e-11, 15, 0.01, 1e-11

# Added to equations in their own units, as rows may depend on one another; solves, at most so many,
# take it out until the answer changes by round-off.
_ADDED, _MOST_SOLVES, _ROUND_OFF = 1e-12, 30, 1e-14


@final
class OSQPSolver(QPSolver):
    """See :class:`QPSolver`. The matrices are factorised once; a solve changes q, l and u in place.

    ADMM stops within the tolerance. OSQP then polishes: it solves for the bounds found active.
    Where that breaks other bounds, or a multiplier has the wrong sign, the active set is changed
    there and solved for again. If that comes to no end, ADMM goes on to a finer tolerance. So
    answers are exact to round-off; within the last tolerance where ADMM is out of iterations or
    time, or where more bounds are active than there are unknowns and no set is right.

    With many equations ADMM is not over-relaxed, since equations gain from that only further
    iterations, and A is not scaled, which costs more than factorizing it where A is updated.
    """

    def __init__(
        self,
        P: csc_array,
        A: csc_array,
        tolerance: float,
        max_iterations: int,
        equations: bool = False,
    ) -> None:
        self.tolerance, self.max_iterations = tolerance, max_iterations
        # The caller may put other values into its A.
        self._made_of = P, A.copy(), tolerance, max_iterations, equations
        self._shape = A.shape
        self._nonzeros = A.nnz
        self._set_up()

    def _set_up(self) -> None:
        import osqp
        from scipy.sparse import csc_matrix, triu

        began = perf_counter()
        P, A, tolerance, max_iterations, equations = self._made_of
        rows, columns = A.shape
        self._P, self._A = P, A.copy()
        self._status = {status.value: _STATUS[status.name] for status in osqp.SolverStatus}
        self._solver = osqp.OSQP()
        # Python has no name for it; a library that hides it may lose a Ctrl-C in its last lines.
        library = ctypes.PyDLL(self._solver.ext.__file__)
        self._was_interrupted = getattr(library, "osqp_is_interrupted", int)
        self._solver.setup(
            P=csc_matrix(triu(P)),
            q=np.zeros(columns),
            A=csc_matrix(A),
            l=np.full(rows, -np.inf),
            u=np.full(rows, np.inf),
            verbose=False,
            eps_abs=tolerance,
            eps_rel=tolerance,
            max_iter=max_iterations,
            polishing=True,
            polish_refine_iter=_REFINEMENTS,
            # Iterations, not seconds, decide when ρ is adapted: the same data
            # give the same answer on every machine.
            rho=_START_RHO,  # both forms are scaled for it
            adaptive_rho=1,
            adaptive_rho_interval=50,
            check_termination=5,
            **({"alpha": 1.1, "scaling": 0} if equations else {}),
        )
        # OSQP scales a new A by what its vectors are then, and rounds P each time.
        self._scales, self._rescaled = not equations, False
        # OSQP counts as run time of the first solve the setup, of later ones the updates.
        self._fresh = True
        self._counted = perf_counter() - began

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what the program is made of; OSQP's own memory, and what it solved, stay here."""
        return OSQPSolver, self._made_of

    def update(self, A: FloatArray) -> None:
        """See :meth:`QPSolver.update`."""
        check_values(A, self._nonzeros)
        began = perf_counter()
        self._solver.update(Ax=A)
        self._A.data[:] = A
        self._rescaled = self._scales
        if not self._fresh:
            self._counted += perf_counter() - began

    def reset(self) -> None:
        """See :meth:`QPSolver.reset`."""
        if self._rescaled:
            self._set_up()
            return
        self._cold_start()
        self._solver.update_settings(rho=_START_RHO)

    def _cold_start(self) -> None:
        rows, columns = self._shape
        self._solver.warm_start(x=np.zeros(columns), y=np.zeros(rows))

    def solve(
        self,
        q: FloatArray,
        l: FloatArray,  # noqa: E741 - the letters of the problem
        u: FloatArray,
        start: tuple[FloatArray, FloatArray] | None = None,
        deadline: float = np.inf,
    ) -> QPSolution:
        """See :meth:`QPSolver.solve`.

        Of data that are refused OSQP would print a line, keep the old data, or be poisoned for
        good.
        """
        answer = refused(q, l, u, self._shape, deadline)
        if answer is not None:
            return answer
        self._solver.update(q=q, l=l, u=u)
        if start is not None:
            self._solver.warm_start(x=start[0], y=start[1])
        tolerance, iterations, best = self.tolerance, 0, None
        while True:
            status, result = self._admm(tolerance, self.max_iterations - iterations, deadline)
            iterations += result.info.iter
            if status in {Status.OK, Status.INACCURATE}:
                exact = self._active_set(q, l, u, (result.x, result.y), deadline)
                if exact is not None:
                    return QPSolution(Status.OK, *exact, iterations)
            if status is not Status.OK:
                # What OSQP leaves in x then is not a solution, and may warm-start nothing.
                self._cold_start()
                break
            best, tolerance = (result.x, result.y), tolerance * _FINER
            if tolerance < _FINEST or iterations >= self.max_iterations:
                break
        if best is None:
            return QPSolution(status, None, None, iterations)
        return QPSolution(Status.OK, *best, iterations)

    def _admm(self, tolerance: float, most: int, deadline: float) -> tuple[Status, Any]:
        """Return the status and result of OSQP from where it is."""
        settings = {"eps_abs": tolerance, "eps_rel": tolerance, "max_iter": most}
        if deadline < np.inf:
            left = max(deadline - perf_counter(), np.finfo(float).tiny)
            settings["time_limit"] = left + self._counted
        self._solver.update_settings(**settings)
        result = self._solver.solve(raise_error=False)
        self._fresh, self._counted = False, 0.0
        status = self._status[result.info.status_val]
        # OSQP took Ctrl-C to itself, be it after its last iteration: it goes to whom it was for.
        if status is Status.INTERRUPTED or self._was_interrupted():
            signal.raise_signal(signal.SIGINT)
        return status, result

    def _active_set(
        self,
        q: FloatArray,
        l: FloatArray,  # noqa: E741 - the letters of the problem
        u: FloatArray,
        start: tuple[FloatArray, FloatArray],
        deadline: float,
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return the exact solution near one, or None if the active sets come to no end.

        A row is active where A x + y is beyond a bound: y holds it there.
        """
        x, y = start
        for tried in range(_MOST_SETS + 1):
            beyond = self._A @ x + y
            within = np.clip(beyond, l, u)
            if self._is_optimal(q, x, within, beyond - within):
                return x, beyond - within
            if tried == _MOST_SETS or perf_counter() >= deadline:
                break
            active = np.flatnonzero((beyond != within) | (l == u))
            x, y = self._at_bounds(q, active, within[active], (x, y))
        return None

    def _is_optimal(self, q: FloatArray, x: FloatArray, rows: FloatArray, y: FloatArray) -> bool:
        """Return whether x has these rows, which are within bounds, and multipliers y."""
        slopes = self._P @ x, q, self._A.T @ y
        off, unit = _largest(self._A @ x - rows), max(1.0, _largest(rows))
        slope, slope_unit = _largest(slopes[0] + q + slopes[2]), max(1.0, _largest(*slopes))
        return off < _EXACT * unit and slope < _EXACT * slope_unit

    def _at_bounds(
        self,
        q: FloatArray,
        active: IntArray,
        bound: FloatArray,
        start: tuple[FloatArray, FloatArray],
    ) -> tuple[FloatArray, FloatArray]:
        """Return the least point where active rows are at bounds, and multipliers of all rows.

        Of rows that depend on one another, multipliers are those next to the start.
        """
        from scipy.sparse import block_array, csc_array, diags_array
        from scipy.sparse.linalg import splu

        rows = self._A.tocsr()[active]
        unit = 1 / np.sqrt(np.maximum(self._P.diagonal(), 1.0))
        row_unit = 1 / np.maximum(abs(rows * unit).max(axis=1).toarray(), _ADDED)
        units = np.concatenate([unit, row_unit])
        system = block_array([[self._P, rows.T], [rows, None]]) * units * units[:, None]
        added = diags_array(np.repeat([_ADDED, -_ADDED], [len(q), len(active)]))
        factors = splu(csc_array(system + added))
        right = np.concatenate([-q, bound]) * units
        both = np.concatenate([start[0], start[1][active]]) / units
        for _ in range(_MOST_SOLVES):
            step = factors.solve(right - system @ both)
            both += step
            if _largest(step[: len(q)]) <= _ROUND_OFF * _largest(both[: len(q)]):
                break
        both *= units
        y = np.zeros(self._shape[0])
        y[active] = both[len(q) :]
        return both[: len(q)], y


def _largest(*vectors: FloatArray) -> float:
    return max(float(np.abs(vector).max(initial=0.0)) for vector in vectors)
