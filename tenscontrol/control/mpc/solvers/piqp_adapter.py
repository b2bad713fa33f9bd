"""PIQP as a solver of quadratic programs: a sparse interior point that goes along the stages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, final

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.control.mpc.solvers.solver import QPSolution, QPSolver, check_values, refused
from tenscontrol.status import Status

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csc_matrix, csr_array

# Every status that PIQP can return, by its name.
_STATUS = {
    "PIQP_SOLVED": Status.OK,
    "PIQP_MAX_ITER_REACHED": Status.OUT_OF_ITERATIONS,
    "PIQP_PRIMAL_INFEASIBLE": Status.INFEASIBLE,
    "PIQP_DUAL_INFEASIBLE": Status.UNBOUNDED,
    "PIQP_NUMERICS": Status.UNSOLVED,
    "PIQP_UNSOLVED": Status.UNSOLVED,
    "PIQP_INVALID_SETTINGS": Status.UNSOLVED,
}


@final
class PIQPSolver(QPSolver):
    """See :class:`QPSolver`. For large programs of many stages; needs the package piqp.

    An interior point gains nothing from a start, so that all solves are alike: the same data give
    the same answer whatever was solved before. PIQP has no clock: a deadline is looked at before
    a solve alone, and ``max_iterations`` bounds the solve, in which some 10 to 20 are needed.

    Rows whose bounds are equal at the first solve are equations, with one unknown they are its
    bounds; where that changes, the program is set up anew.
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
        _piqp()
        self._made_of = P, A.copy(), tolerance, max_iterations
        self._shape, self._nonzeros = A.shape, A.nnz
        self._order = _by_stages(P, A)
        self._place = np.argsort(self._order)
        self.reset()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what the program is made of; PIQP's own memory stays here."""
        return PIQPSolver, self._made_of

    def update(self, A: FloatArray) -> None:
        """See :meth:`QPSolver.update`."""
        check_values(A, self._nonzeros)
        self._values, self._changed = A.copy(), True

    def reset(self) -> None:
        """See :meth:`QPSolver.reset`."""
        self._values, self._changed = self._made_of[1].data, False
        self._solver: Any = None
        self._equal: np.ndarray = np.zeros(0, bool)

    def _set_up(self, equal: np.ndarray) -> None:
        """Split the rows into equations, bounds of unknowns and the rest."""
        from scipy.sparse import csc_array

        A = self._made_of[1]
        rows, columns = self._shape
        column = np.repeat(np.arange(columns), np.diff(A.indptr))
        alone = (np.bincount(A.indices, minlength=rows) == 1) & ~equal
        # Of several rows that bound an unknown, and have no zero in them, the first.
        mine = np.flatnonzero(alone[A.indices] & (A.data != 0))
        _, first = np.unique(column[mine], return_index=True)
        self._by_bound = mine[first]
        self._bounds = A.indices[self._by_bound]
        self._bounded = self._place[column[self._by_bound]]
        is_bound = np.zeros(rows, bool)
        is_bound[self._bounds] = True
        self._equal = equal
        self._equations = np.flatnonzero(equal)
        self._others = np.flatnonzero(~equal & ~is_bound)
        numbers = csc_array((np.arange(1.0, A.nnz + 1), A.indices, A.indptr), shape=A.shape)
        in_order = numbers.tocsr()[:, self._order]
        self._parts = [self._part(in_order, part) for part in (self._equations, self._others)]
        self._solver = None

    @staticmethod
    def _part(numbers: csr_array, rows: np.ndarray) -> tuple[csc_matrix, np.ndarray]:
        """Return some rows of A, and where their values come from: A with numbers as its values."""
        from scipy.sparse import csc_matrix

        part = csc_matrix(numbers[rows].tocsc())
        part.sort_indices()
        return part, part.data.astype(np.int64) - 1

    def solve(
        self,
        q: FloatArray,
        l: FloatArray,  # noqa: E741 - the letters of the problem
        u: FloatArray,
        start: tuple[FloatArray, FloatArray] | None = None,
        deadline: float = np.inf,
    ) -> QPSolution:
        """See :meth:`QPSolver.solve`. A start counts for nothing."""
        answer = refused(q, l, u, self._shape, deadline)
        if answer is not None:
            return answer
        if not np.array_equal(l == u, self._equal):
            self._set_up(l == u)
        # A factor below zero turns a bound round.
        factor = self._values[self._by_bound]
        if (factor == 0).any():
            return QPSolution(Status.BAD_DATA, None, None, 0)
        low, high = l[self._bounds] / factor, u[self._bounds] / factor
        least, most = np.full(len(q), -np.inf), np.full(len(q), np.inf)
        least[self._bounded] = np.minimum(low, high)
        most[self._bounded] = np.maximum(low, high)
        given = {
            "c": q[self._order], "b": l[self._equations], "h_l": l[self._others],
            "h_u": u[self._others], "x_l": least, "x_u": most,
        }  # fmt: skip
        if self._changed or self._solver is None:
            for part, source in self._parts:
                part.data = self._values[source]
            given |= {"A": self._parts[0][0], "G": self._parts[1][0]}
        status = self._run(given)
        result = self._solver.result
        if status is not Status.OK:
            self._solver = None
            return QPSolution(status, None, None, result.info.iter)
        y = np.zeros(len(l))
        y[self._equations] = result.y
        y[self._others] = result.z_u - result.z_l
        y[self._bounds] = (result.z_bu - result.z_bl)[self._bounded] / factor
        return QPSolution(status, np.array(result.x)[self._place], y, result.info.iter)

    def _run(self, given: dict[str, Any]) -> Status:
        from scipy.sparse import csc_matrix

        P, _, tolerance, max_iterations = self._made_of
        if self._solver is None:
            piqp = _piqp()
            self._solver = piqp.SparseSolver()
            settings = self._solver.settings
            settings.kkt_solver = piqp.KKTSolver.sparse_multistage
            settings.eps_abs = settings.eps_rel = tolerance
            settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = tolerance
            settings.max_iter = max_iterations
            in_order = csc_matrix(P.tocsc()[self._order][:, self._order])
            in_order.sort_indices()
            self._solver.setup(in_order, **given)
        else:
            self._solver.update(**given)
        self._changed = False
        return _STATUS[self._solver.solve().name]


def _by_stages(P: csc_array, A: csc_array) -> np.ndarray:
    """Return the order of the unknowns in which those that meet in a row are near each other."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    met = csr_array(abs(P) + abs(A).T @ abs(A))
    return np.asarray(reverse_cuthill_mckee(met, symmetric_mode=True), dtype=np.int64)


def _piqp() -> Any:
    """Return the package, or raise saying how to get it."""
    try:
        import piqp
    except ImportError as error:
        raise ImportError(
            "solver is 'piqp', and the package piqp is not installed: "
            "pip install 'tenscontrol[piqp]', or take solver='osqp'"
        ) from error
    return piqp
