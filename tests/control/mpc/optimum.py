"""The exact optimum of a quadratic program, by elimination of the rows that a solution is at."""

import numpy as np
from scipy.optimize import linprog, nnls
from scipy.sparse import block_array, csc_array, eye_array
from scipy.sparse.linalg import splu

# A row is active where a solution is so near to its bound.
_NEAR = 1e-8

# Added to the equations of rows that may depend on others; refinement takes it out.
_ADDED = 1e-9


def exact_optimum(P, q, A, low, high, near):
    """Return the optimum of ``½ xᵀ P x + qᵀ x, low ≤ A x ≤ high``, from a solution near it.

    Its conditions are checked: the rows hold, and multipliers of the right signs exist.
    """
    P, A = csc_array(P), csc_array(A)
    product = A @ near
    margin = _NEAR * (1 + np.abs(product))
    above, below = product > high - margin, product < low + margin
    taken = np.flatnonzero(above | below)
    active, bound = A[taken], np.where(above, high, low)[taken]
    system = csc_array(block_array([[P, active.T], [active, None]]))
    added = np.r_[np.full(len(q), _ADDED), np.full(len(taken), -_ADDED)]
    factors = splu(csc_array(system + eye_array(len(added)) * added))
    right, both = np.concatenate([-q, bound]), np.zeros(len(added))
    for _ in range(30):
        both += factors.solve(right - system @ both)
    x, y = both[: len(q)], both[len(q) :]
    product, unit = A @ x, max(1.0, np.abs(q).max())
    over = np.maximum(product - high, low - product)
    assert over.max(initial=0.0) < 1e-8, f"a row is violated by {over.max():.1e}"
    slope = P @ x + q
    off = np.abs(slope + active.T @ y).max()
    assert off < 1e-8 * unit, f"the slope is off by {off:.1e}"
    wrong = np.where(above[taken], 0.0, np.maximum(y, 0)) + np.where(
        below[taken], 0.0, np.maximum(-y, 0)
    )
    if wrong.max(initial=0.0) > 1e-8 * unit:  # of rows that depend on others, there are more
        outward = np.vstack([A[above].toarray(), -A[below].toarray()])
        _, left = nnls(outward.T, -slope, maxiter=100 * len(slope))
        assert left < 1e-7 * unit, f"multipliers leave {left:.1e} of the slope"
    return x


def is_feasible(A, low, high):
    """Return whether any point keeps all rows."""
    if not len(A):
        return True
    rows = np.vstack([A[np.isfinite(high)], -A[np.isfinite(low)]])
    bounds = np.concatenate([high[np.isfinite(high)], -low[np.isfinite(low)]])
    found = linprog(np.zeros(A.shape[1]), rows, bounds, bounds=(None, None))
    assert found.status in (0, 2)
    return found.status == 0


def point_of_inputs(program, inputs):
    """Return the unknowns of a :class:`QuadraticProgram` whose inputs, (α, N), are these."""
    A, equations, count = program.A, slice(0, program.first), inputs.size
    x = np.zeros(A.shape[1])
    x[program.first : program.first + count] = ((inputs - program.origin) / program.unit).T.ravel()
    motion = csc_array(csc_array(A[equations])[:, equations])
    x[equations] = splu(motion).solve((program.l - A @ x)[equations])
    fill_violations(x, A, program.l, program.u, program.first + count)
    return x


def fill_violations(x, A, low, high, first):
    """Set the violations, which are the unknowns from ``first`` on, to what the rows ask for."""
    off, factor = A @ x, csc_array(csc_array(A)[:, first:]).tocoo()
    for row, i, entry in zip(*factor.coords, factor.data, strict=True):
        for bound in (low[row], high[row]):
            if np.isfinite(bound):
                x[first + i] = max(x[first + i], (bound - off[row]) / entry)
