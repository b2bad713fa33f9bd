"""The exact optimum of a quadratic program, by elimination of the rows that a solution is at."""

import numpy as np
from scipy.optimize import linprog, nnls
from scipy.sparse import block_array, csc_array, diags_array, eye_array, vstack
from scipy.sparse.linalg import splu

# A row is active where a solution is so near to its bound.
_NEAR = 1e-8

# Added to the equations of rows that may depend on others; refinement takes it out.
_ADDED = 1e-9

# Unknowns but states, beyond which no optimum is found without a point near by.
_MOST = 150


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


class UncertainError(Exception):
    """The optimum of a program is not known in long double."""


def certain_inputs(program, near):
    """Return the inputs, (α, N), at the optimum of a :class:`QuadraticProgram`, in long double.

    By the rows that are active at inputs near by, if the conditions of the optimum then hold. If
    not, without those: the states are eliminated, and a dual active set on orthogonal factors
    solves the rest (D. Goldfarb & A. Idnani, *Mathematical Programming* 27, 1983).
    """
    x = _from_active(program, point_of_inputs(program, near))
    if x is None:
        free = len(program.q) - program.first
        if free > _MOST:
            raise UncertainError(f"{free} unknowns")
        x = _by_dual_active_set(program)
    return program.inputs(x.astype(float))


def _from_active(program, near):
    """Return the optimum by the rows that are active at a point; None if it is not certain."""
    P, A = (csc_array(matrix) for matrix in (program.P, program.A))
    exact_A = A.astype(np.longdouble).tocsr()
    q, low, high = (np.asarray(v, np.longdouble) for v in (program.q, program.l, program.u))
    product = A @ near
    margin = _NEAR * (1 + np.abs(product))
    side = np.where(product > high - margin, 1, 0) - np.where(product < low + margin, 1, 0)
    side[low == high] = 2
    for _ in range(10):
        taken = np.flatnonzero(side)
        bound = np.where(side > 0, high, low)[taken]
        active = A[taken]
        system = csc_array(block_array([[P, active.T], [active, None]]))
        both, step = _solved(system, np.concatenate([-q, bound]), len(q))
        count = program.origin.size
        x, y = both[: len(q)], np.zeros(len(low), np.longdouble)
        y[taken] = both[len(q) :]
        product = exact_A @ x
        over = np.maximum(product - high, low - product) / (1 + np.abs(product))
        wrong = np.where(np.abs(side) == 1, -side * y, 0)
        if not np.abs(step[program.first :][:count]).max() < 1e-12:
            return None
        if over.max() < 1e-14 and wrong.max() < 1e-12:
            return x
        if over.max() < 1e-14 and _has_multipliers(program, x.astype(float), side):
            return x
        side[wrong > 1e-12] = 0
        more = (over > 1e-14) & (side == 0)
        side[more] = np.where(product > high, 1, -1)[more]
    return None


def _has_multipliers(program, x, side):
    """Return whether multipliers of the signs of sides exist: where rows depend on others."""
    s, free = program.first, len(x) - program.first
    if free > _MOST:
        return False
    A, slope = program.A.tocsr(), program.P @ x + program.q
    motion = splu(csc_array(A[:s, :s]))
    by_free = np.vstack([-motion.solve(A[:s, s:].toarray()), np.eye(free)])
    taken = np.flatnonzero(np.abs(side) == 1)
    outward = side[taken, None] * (A[taken] @ by_free)
    size = np.maximum(np.linalg.norm(outward, axis=1), np.finfo(float).tiny)
    _, left = nnls((outward / size[:, None]).T, -(slope @ by_free), maxiter=100 * free)
    return left < 1e-10


def _solved(system, right, count):
    """Return the solution of ``[P Aᵀ; A 0]`` in long double and what it may be off by."""
    unit = np.ones(len(right))
    for _ in range(10):
        largest = (abs(system) * unit).max(axis=1).toarray().ravel() * unit
        unit /= np.sqrt(np.where(largest > 0, largest, 1.0))
    factors = splu(
        csc_array(
            unit[:, None] * system * unit
            + diags_array(np.where(np.arange(len(right)) < count, _ADDED, -_ADDED))
        )
    )
    exact, x = system.astype(np.longdouble).tocsr(), np.zeros(len(right), np.longdouble)
    for _ in range(60):
        step = unit * factors.solve((unit * (right - exact @ x)).astype(float))
        x += step
    return x, step


def is_feasible_program(program):
    """Return whether any point keeps the rows of a program."""
    A, equal = program.A.tocsr(), program.l == program.u
    above, below = np.isfinite(program.u) & ~equal, np.isfinite(program.l) & ~equal
    rows = vstack([A[above], -A[below]])
    bounds = np.concatenate([program.u[above], -program.l[below]])
    unit = np.maximum(1.0, np.abs(bounds).max(initial=1.0))
    found = linprog(
        np.zeros(len(program.q)), rows, bounds / unit, A[equal], program.l[equal] / unit,
        bounds=(None, None),
    )  # fmt: skip
    if found.status not in (0, 2):
        raise UncertainError(found.message)
    return found.status == 0


def _by_dual_active_set(program):
    A, s = program.A.toarray().astype(np.longdouble), program.first
    T = np.zeros((A.shape[1], 1 + A.shape[1] - s), np.longdouble)  # unknowns by 1 and what is free
    T[s:, 1:] = np.eye(A.shape[1] - s)
    for i in range(s):
        others = np.flatnonzero(A[i] * (np.arange(A.shape[1]) != i))
        T[i] = -(A[i, others] @ T[others]) / A[i, i]
        T[i, 0] += program.l[i] / A[i, i]
    P, rows = program.P.toarray().astype(np.longdouble), A[s:] @ T
    start, T = T[:, 0], T[:, 1:]
    low, high, rows = program.l[s:] - rows[:, 0], program.u[s:] - rows[:, 0], rows[:, 1:]
    L = _cholesky(T.T @ P @ T)
    target = -_forward(L, T.T @ (program.q + P @ start))
    rows = _forward(L, rows.T).T
    rows, bounds = np.concatenate([rows, -rows]), np.concatenate([high, -low])
    size = np.sqrt((rows**2).sum(axis=1))
    kept = (size > 0) & np.isfinite(bounds)
    rows, bounds = rows[kept] / size[kept, None], bounds[kept] / size[kept]
    y = _nearest_within(target, rows, bounds)
    return start + T @ _forward(L[::-1, ::-1].T, y[::-1])[::-1]


def _cholesky(H):
    L = H.copy()
    for i in range(len(L)):
        L[i:, i] /= np.sqrt(L[i, i])
        L[i + 1 :, i + 1 :] -= np.outer(L[i + 1 :, i], L[i + 1 :, i])
        L[i, i + 1 :] = 0
    return L


def _forward(L, right):
    x = right.copy()
    for i in range(len(L)):
        x[i] /= L[i, i]
        x[i + 1 :] -= np.multiply.outer(L[i + 1 :, i], x[i])
    return x


def _nearest_within(target, rows, bounds):
    """Return the point nearest to a target whose products with unit rows keep their bounds."""
    x, active, y = target.copy(), [], np.zeros(0, np.longdouble)
    Q, R = _orthogonal(rows[active])
    for _ in range(4 * len(rows)):
        off = (rows @ x - bounds) / (1 + np.abs(bounds))
        off[active] = -np.inf
        worst, own = int(off.argmax()), np.longdouble(0)
        if off[worst] <= 1e-17:
            return x
        while worst not in active:
            along, across = Q.T @ rows[worst], rows[worst] - Q @ (Q.T @ rows[worst])
            across -= Q @ (Q.T @ across)
            square = across @ across
            falls = _forward(R[::-1, ::-1], along[::-1])[::-1]
            ratios = np.where(falls > 0, y / np.where(falls > 0, falls, 1), np.inf)
            full = (rows[worst] @ x - bounds[worst]) / square if square > 1e-28 else np.inf
            step = min([full, *ratios])
            if not np.isfinite(step):
                raise UncertainError("no point keeps all rows")
            x = x - (step * across if square > 1e-28 else 0)
            y, own = y - step * falls, own + step
            if step == full:
                active, y = [*active, worst], np.append(y, own)
            else:
                first = int(ratios.argmin())
                active, y = active[:first] + active[first + 1 :], np.delete(y, first)
            Q, R = _orthogonal(rows[active])
    raise UncertainError("too many changes")


def _orthogonal(rows):
    """Return Q, R of the transpose of rows, by Gram and Schmidt, twice."""
    Q, R = np.zeros(rows.T.shape, np.longdouble), np.zeros((len(rows),) * 2, np.longdouble)
    for k, row in enumerate(rows):
        left = row.copy()
        for _ in range(2):
            products = Q.T @ left
            R[:, k] += products
            left = left - Q @ products
        R[k, k] = np.sqrt(left @ left)
        Q[:, k] = left / R[k, k]
    return Q, R
