"""OSQP as a solver of quadratic programs."""

from __future__ import annotations

import ctypes
import signal
from time import perf_counter
from typing import TYPE_CHECKING, Any, final

import numpy as np

from tenscontrol.arrays import FloatArray
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


@final
class OSQPSolver(QPSolver):
    """See :class:`QPSolver`. The matrices are factorised once; a solve changes q, l and u in place.

    An answer that is polished is refined by solving for the bounds found active: to round-off,
    where they are the right ones. With many equations ADMM is not over-relaxed, since equations
    gain from that only further iterations, and A is not scaled, which costs more than factorizing
    it where A is updated.
    """

    def __init__(
        self,
        P: csc_array,
        A: csc_array,
        tolerance: float,
        max_iterations: int,
        polish: bool = False,
        equations: bool = False,
    ) -> None:
        self.tolerance, self.max_iterations = tolerance, max_iterations
        # The caller may put other values into its A.
        self._made_of = P, A.copy(), tolerance, max_iterations, polish, equations
        self._shape = A.shape
        self._nonzeros = A.nnz
        self._set_up()

    def _set_up(self) -> None:
        import osqp
        from scipy.sparse import csc_matrix, triu

        began = perf_counter()
        P, A, tolerance, max_iterations, polish, equations = self._made_of
        rows, columns = A.shape
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
            polishing=polish,
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
        if deadline < np.inf:
            left = max(deadline - perf_counter(), np.finfo(float).tiny)
            self._solver.update_settings(time_limit=left + self._counted)
        self._solver.update(q=q, l=l, u=u)
        if start is not None:
            self._solver.warm_start(x=start[0], y=start[1])
        result = self._solver.solve(raise_error=False)
        self._fresh, self._counted = False, 0.0
        status = self._status[result.info.status_val]
        # OSQP took Ctrl-C to itself, be it after its last iteration: it goes to whom it was for.
        if status is Status.INTERRUPTED or self._was_interrupted():
            signal.raise_signal(signal.SIGINT)
        if status is not Status.OK:
            # What OSQP leaves in x then is not a solution, and may warm-start nothing.
            self._cold_start()
            return QPSolution(status, None, None, result.info.iter)
        return QPSolution(status, result.x, result.y, result.info.iter)
