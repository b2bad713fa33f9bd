"""Least distance programming: the point of a polyhedral set nearest to a target.

Small sets are given by directions, and programs in them are exact by non-negative least squares;
large ones by sparse equations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.statics.equilibrium_matrix import MemberForces, is_small, null_space

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_array
    from scipy.sparse.linalg import SuperLU

# In the scaled problem every quantity is of order one; round-off stays far below this.
_TOLERANCE = 1e-9
_ROUND_OFF = 1e-12
_EXACT = 1e-11

# Changes of the active set that least squares may take, for each inequality.
_CHANGES = 10

# Equations may be missed by this part of a multiplier, which takes dependent ones; each repetition
# takes the rest of what they are missed by.
_GIVE, _REPETITIONS = 1e-12, 40

# Iterations of the interior point, the mean of gap times force at which it ends, and the part of
# the way to a bound that it goes; active sets that are tried after it.
_ITERATIONS, _GAP, _WAY, _SETS = 100, 1e-13, 0.995, 30

# A bound above this many lower bounds and offsets is none.
_NO_BOUND = 1e9


def least_distance(G: FloatArray, h: FloatArray) -> FloatArray | None:
    """Return the y of least norm with ``G y ≥ h``, shape (k,), or None if there is none.

    By non-negative least squares (Lawson & Hanson, *Solving Least Squares
    Problems*, chapter 23): exact up to round-off. G and h are of order one.
    """
    from scipy.optimize import lsq_linear

    matrix = np.vstack([G.T, h[None, :]])
    goal = np.zeros(len(matrix))
    goal[-1] = 1.0
    # Not nnls: from SciPy 1.15 on it may end before the optimum, and not say so.
    answer = lsq_linear(
        matrix, goal, (0.0, np.inf), method="bvls", tol=_ROUND_OFF, max_iter=_CHANGES * len(h)
    )
    if answer.status <= 0:
        raise ArithmeticError(f"least squares of the prestress failed: {answer.message}")
    slack = matrix @ answer.x - goal
    if slack[-1] > -_TOLERANCE:
        return None
    return np.asarray(-slack[:-1] / slack[-1])


def nearest_between(
    directions: FloatArray,
    offset: FloatArray,
    target: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> FloatArray | None:
    """Return x, shape (k,), that minimizes ``‖D x + o − target‖``, ``lower ≤ D x + o ≤ upper``.

    ``D x`` is unique, so that a symmetric structure gets a symmetric answer. None if there is none.
    """
    scale = max(float(np.abs(array).max(initial=0.0)) for array in (offset, target, lower)) or 1.0
    off, rows, limits = (offset - target) / scale, directions, (offset - lower) / scale
    capped = np.zeros(len(offset), bool)
    while True:
        best = _nearest(directions, off, rows, limits)
        if best is None:
            return None
        best = scale * best
        over = offset + directions @ best - upper
        beyond = ~capped & (over > _TOLERANCE * scale)
        if not beyond.any():
            return best
        # Upper bounds take part once they are passed.
        capped |= beyond
        rows = np.vstack([rows, -directions[beyond]])
        limits = np.concatenate([limits, (upper - offset)[beyond] / scale])


def _nearest(D: FloatArray, off: FloatArray, C: FloatArray, c: FloatArray) -> FloatArray | None:
    """Minimize ``‖D x + off‖`` subject to ``C x + c ≥ 0``, scaled to order one; C has rows ±D."""
    # Round-off must not look like an equation.
    D, off, C, c = (np.where(np.abs(array) > _ROUND_OFF, array, 0.0) for array in (D, off, C, c))
    best = _least_squares(D, -off)
    if (c + C @ best >= -_TOLERANCE).all():
        return best
    free = can_be_positive(C, c)
    if free is None:
        return None
    if not free.all():
        # Entries that are zero everywhere become equations: what is left has an interior.
        start = _least_squares(C[~free], -c[~free])
        if np.abs(c[~free] + C[~free] @ start).max() > _TOLERANCE:
            return None
        along = null_space(C[~free])
        rest = _nearest(D @ along, off + D @ start, C[free] @ along, c[free] + C[free] @ start)
        return None if rest is None else np.asarray(start + along @ rest)
    # The feasible set has an interior.
    U, sizes, Vt = np.linalg.svd(D, full_matrices=False)
    keep = sizes > _TOLERANCE
    U, back = U[:, keep], Vt[keep].T / sizes[keep]
    best = -U.T @ off
    G = C @ back
    step = least_distance(G, -(c + G @ best))  # from the optimum without bounds
    return None if step is None else np.asarray(back @ (best + step))


def can_be_positive(
    D: FloatArray, offset: FloatArray, balance: Balance | None = None
) -> np.ndarray | None:
    """Return which entries of ``D x + o`` can be positive, or None if the set is empty."""
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, eye_array, hstack

    # The most entries of at least 1 in the cone over the set.
    m, k = D.shape
    equations = {}
    if balance is not None:
        A, b = balance.rows, balance.values
        nothing = csr_array((len(b), m))
        equations = {"A_eq": hstack([A, -b[:, None], nothing]), "b_eq": np.zeros(len(b))}
    answer = linprog(
        c=np.concatenate([np.zeros(k + 1), -np.ones(m)]),
        A_ub=hstack([-csr_array(D), csr_array(-offset[:, None]), eye_array(m)]),
        b_ub=np.zeros(m),
        bounds=[(None, None)] * k + [(1, None)] + [(0, 1)] * m,
        method="highs",
        **equations,
    )
    if answer.status == 2:
        return None
    if answer.status != 0:
        raise ArithmeticError(f"the linear program of the prestress failed: {answer.message}")
    return np.asarray(answer.x[k + 1 :] > 0.5)


def largest_share(
    D: FloatArray, offset: FloatArray, lower: FloatArray, upper: FloatArray,
    most: float | None = 1, balance: Balance | None = None,
) -> float:  # fmt: skip
    """Return the largest t with ``t lower ≤ D x + o ≤ upper`` for some x; −∞ if there is none.

    It is at most ``most``. If that is None, ``upper`` bounds it.
    """
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, hstack, vstack

    # Unknowns are x and t lower, in one unit.
    sizes = [float(np.abs(array).max(initial=0.0)) for array in (offset, lower, upper)]
    scale = max(sizes[:2] if most is not None else sizes[::2]) or 1.0
    unit = sizes[1] or 1.0
    capped = upper < _NO_BOUND * scale
    k, D = D.shape[1], csr_array(D)
    equations = {}
    if balance is not None:
        A, b = balance.rows, balance.values
        equations = {"A_eq": hstack([A, csr_array((len(b), 1))]), "b_eq": b / scale}
    answer = linprog(
        c=np.append(np.zeros(k), -1.0),
        A_ub=vstack(
            [
                hstack([-D, csr_array(lower[:, None] / unit)]),
                hstack([D[capped], csr_array((int(capped.sum()), 1))]),
            ]
        ),
        b_ub=np.concatenate([offset, (upper - offset)[capped]]) / scale,
        bounds=[(None, None)] * k + [(None, None if most is None else most * unit / scale)],
        method="highs" if balance is None else "highs-ipm",
        **equations,
    )
    return float(answer.x[-1]) * scale / unit if answer.status == 0 else -np.inf


@dataclass(frozen=True, eq=False)
class Balance:
    """Sparse equations ``A x = b`` of force densities x, those of strings first."""

    rows: csr_array  # A, (e, k)
    values: FloatArray  # b, (e,)
    dense: int = 0  # how many of the last rows have entries of all members

    def joined(self, row: FloatArray, value: float) -> Balance:
        """Return the equations with one more, of all members."""
        from scipy.sparse import csr_array, vstack

        more = vstack([self.rows, csr_array(row[None, :])], format="csr")
        return Balance(more, np.append(self.values, value), self.dense + 1)

    def nearest(
        self, target: FloatArray, lower: FloatArray, upper: FloatArray
    ) -> FloatArray | None:
        """Return x, shape (k,), nearest to a target in its first entries, these within bounds.

        Entries without a target are free. None if there is none. By a primal-dual interior point
        (Mehrotra 1992, doi:10.1137/0802028), one sparse factorization an iteration, and then with
        the bounds that it ends at as equations: exact to round-off where that set is right.
        """
        program = _Program.of(self, target, lower, upper)
        x, y = np.zeros(self.rows.shape[1]), np.zeros(len(self.values))
        if program.polished(x, y, 1) is None:  # a bound counts
            inside = program.interior()
            if inside is None:
                return None
            x, y = inside
        before = np.inf
        for _ in range(_REPETITIONS):
            better = program.polished(x, y)
            if better is None:
                return program.scale * x
            missed = program.missed(better[0])
            if missed >= before / 2:
                break
            (x, y), before = better, missed
        return program.scale * x


@dataclass(frozen=True, eq=False)
class BalancedForces:
    """All force densities ``D x + o`` that balance, those of strings first.

    Few are given by directions D; many by sparse equations of x, with D = 1 and o = 0.
    """

    directions: FloatArray  # D, (k, ·)
    offset: FloatArray  # o, (k,)
    balance: Balance | None

    @classmethod
    def of(cls, forces: MemberForces) -> BalancedForces:
        """Return those of movable members."""
        if is_small(forces.matrix):
            return cls(forces.states, forces.particular, None)
        from scipy.sparse import eye_array

        k = forces.matrix.shape[1]
        return cls(eye_array(k).tocsr(), np.zeros(k), Balance(forces.matrix.tocsr(), forces.load))

    def at_level(self, chosen: IntArray, level: float) -> BalancedForces | None:
        """Return those in which the chosen strings have the mean ``level``.

        None if no state of self-stress changes that mean.
        """
        if self.balance is not None:
            row = np.zeros(len(self.offset))
            row[chosen] = 1 / len(chosen)
            return replace(self, balance=self.balance.joined(row, level))
        states, particular = self.directions, self.offset
        mean = states[chosen].mean(axis=0)
        weight = float(np.linalg.norm(mean))
        if weight < _ROUND_OFF:
            return None
        start = mean * (level - particular[chosen].mean()) / weight**2
        directions = states @ np.linalg.svd(mean[None, :])[2][1:].T
        return BalancedForces(directions, particular + states @ start, None)

    def nearest(self, target: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray | None:
        """Return those whose γ are nearest to a target within bounds, or None if none are."""
        if self.balance is not None:
            return self.balance.nearest(target, low, high)
        D, offset, count = self.directions, self.offset, len(target)
        x = nearest_between(D[:count], offset[:count], target, low, high)
        return None if x is None else np.asarray(offset + D @ x)

    def largest_share(self, low: FloatArray, high: FloatArray, most: float | None = 1) -> float:
        """Return the largest part of the least γ, at most ``most``, that they can have."""
        D, offset = self.directions[: len(low)], self.offset[: len(low)]
        return largest_share(D, offset, low, high, most, self.balance)


class _Bordered:
    """Factors of [K, B; Bᵀ, −give] from those of K: B is dense and narrow, and would fill them."""

    def __init__(self, factors: SuperLU, border: FloatArray) -> None:
        self._factors, self._border, self._across = factors, border, factors.solve(border)
        self._left = -_GIVE * np.eye(border.shape[1]) - border.T @ self._across

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the solution for a right side."""
        count = len(self._border)
        inside = self._factors.solve(right[:count])
        last = np.linalg.solve(self._left, right[count:] - self._border.T @ inside)
        return np.append(inside - self._across @ last, last)


class _Program:
    """A quadratic program, scaled: its interior point and its active set."""

    def __init__(
        self, A: csc_array, b: FloatArray, target: FloatArray,
        bounds: tuple[FloatArray, FloatArray], scale: float, dense: int,
    ) -> None:  # fmt: skip
        self.A, self.b, self.target, self.bounds, self.scale = A, b, target, bounds, scale
        self._sparse = len(b) - dense  # rows that are, first
        self.side = np.zeros(len(target), np.int8)  # −1 at the lower bound, 1 at the upper one
        self._factors: tuple[bytes, _Bordered] | None = None

    @classmethod
    def of(
        cls, balance: Balance, target: FloatArray, lower: FloatArray, upper: FloatArray
    ) -> _Program:
        """Return the program in units in which rows and forces are of order one."""
        from scipy.sparse import diags_array

        size = np.sqrt(balance.rows.multiply(balance.rows).sum(axis=1))
        size = np.where(size > 0, size, 1.0)
        b = balance.values / size
        arrays = (b, target, np.where(np.isfinite(lower), lower, 0.0))
        scale = max(float(np.abs(array).max(initial=0.0)) for array in arrays) or 1.0
        A = (diags_array(1 / size) @ balance.rows).tocsc()
        bounds = lower / scale, upper / scale
        return cls(A, b / scale, target / scale, bounds, scale, balance.dense)

    def missed(self, x: FloatArray) -> float:
        """Return by how much x misses the equations, against its largest entry with a target."""
        most = max(1.0, float(np.abs(x[: len(self.target)]).max()))
        return float(np.abs(self.A @ x - self.b).max(initial=0.0) / most)

    def _factored(self, weight: FloatArray, A: csc_array) -> _Bordered:
        """Return the factors of [W, Aᵀ; A, −give], W a diagonal."""
        from scipy.sparse import block_array, diags_array
        from scipy.sparse.linalg import splu

        count, rows = self._sparse, A.tocsr()
        first = rows[:count]
        give = diags_array(np.full(count, -_GIVE))
        matrix = block_array([[diags_array(weight), first.T], [first, give]], format="csc")
        last = rows[count:].toarray().T
        return _Bordered(splu(matrix), np.vstack([last, np.zeros((count, last.shape[1]))]))

    def interior(self) -> tuple[FloatArray, FloatArray] | None:
        """Return x and the multipliers of the equations, and set the active set; None if none."""
        (lower, upper), k, count = self.bounds, self.A.shape[1], len(self.target)
        # Gaps to the bounds that there are, G γ − h = s ≥ 0, with forces z ≥ 0.
        below, above = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
        bounded, sign = np.append(below, above), np.repeat([1.0, -1.0], [len(below), len(above)])
        h = sign * np.append(lower[below], upper[above])
        x, y = np.zeros(k), np.zeros(len(self.b))
        x[:count] = self.target
        s, z = np.maximum(sign * x[bounded] - h, 1.0), np.ones(len(bounded))
        weight = np.where(np.arange(k) < count, 1.0, _GIVE)
        for _ in range(_ITERATIONS):
            slope = np.zeros(k)
            slope[:count] = x[:count] - self.target
            slope += self.A.T @ y - np.bincount(bounded, sign * z, minlength=k)
            short, gap = self.b - self.A @ x, sign * x[bounded] - h - s
            mean = float(s @ z / max(len(bounded), 1))
            size = max(1.0, float(np.abs(x[:count]).max()))
            if not np.isfinite(mean) or np.abs(y).max(initial=0.0) > 1 / _ROUND_OFF:
                return None
            if mean < _GAP * size and max(np.abs(short).max(), np.abs(gap).max()) < _EXACT * size:
                self.side[:] = 0
                np.add.at(self.side, bounded, np.where(z > s, -sign, 0).astype(np.int8))
                return x, y
            factors = self._factored(weight + np.bincount(bounded, z / s, minlength=k), self.A)

            def step(
                wanted: FloatArray, slope: FloatArray = slope, short: FloatArray = short,
                gap: FloatArray = gap, s: FloatArray = s, z: FloatArray = z,
                factors: _Bordered = factors,
            ) -> tuple[FloatArray, ...]:  # fmt: skip
                """Return the changes that make s z what is wanted."""
                push = (wanted - z * gap) / s - z
                right = np.bincount(bounded, sign * push, minlength=k) - slope
                change = factors.solve(np.append(right, short))
                ds = sign * change[bounded] + gap
                return change[:k], change[k:], ds, (wanted - z * ds) / s - z

            _, _, ds, dz = step(np.zeros(len(bounded)))
            way, push = _way(s, ds), _way(z, dz)
            centre = float((s + way * ds) @ (z + push * dz) / max(len(bounded), 1)) / (mean or 1.0)
            dx, dy, ds, dz = step(centre**3 * mean - ds * dz)
            way = min(1.0, _WAY * min(_way(s, ds), _way(z, dz)))
            x, y, s, z = x + way * dx, y + way * dy, s + way * ds, z + way * dz
        return None

    def polished(
        self, x: FloatArray, y: FloatArray, sets: int = _SETS
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return better x and multipliers, at bounds as equations, or None if no set is right.

        Block principal pivoting (Júdice & Pires 1994, doi:10.1016/0305-0548(94)90106-6).
        """
        count, (lower, upper) = len(self.target), self.bounds
        for _ in range(sets):
            solution, multipliers = self._at(x, y)
            gamma, size = solution[:count], max(1.0, float(np.abs(solution[:count]).max()))
            slope = gamma - self.target + (self.A.T @ multipliers)[:count]
            released = -self.side * slope < -_TOLERANCE * max(size, float(np.abs(slope).max()))
            over = (gamma > upper + _EXACT * size).astype(np.int8)
            over -= gamma < lower - _EXACT * size
            if not released.any() and not over.any():
                return solution, multipliers
            self.side = np.where(released, np.int8(0), self.side + over)
        return None

    def _at(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x and multipliers with the bounds of the active set as equations."""
        count, (lower, upper), k = len(self.target), self.bounds, self.A.shape[1]
        at_bound = np.zeros(k)
        at_bound[:count] = np.where(self.side < 0, lower, np.where(self.side > 0, upper, 0.0))
        free = np.ones(k, bool)
        free[:count] = self.side == 0
        A = self.A[:, free]
        key = self.side.tobytes()
        if self._factors is None or self._factors[0] != key:
            weight = np.where(np.arange(k) < count, 1.0, _GIVE)  # redundant bars: no change
            self._factors = key, self._factored(weight[free], A)
        wanted = _GIVE * x
        wanted[:count] = self.target
        right = self.b - self.A @ np.where(free, 0.0, at_bound) - _GIVE * y
        answer = self._factors[1].solve(np.concatenate([wanted[free], right]))
        solution = np.where(free, 0.0, at_bound)
        solution[free] = answer[: A.shape[1]]
        return solution, answer[A.shape[1] :]


def _way(values: FloatArray, change: FloatArray) -> float:
    """Return the part of a change, at most 1, after which no value is below zero."""
    falls = change < 0
    return float(min(1.0, (-values[falls] / change[falls]).min(initial=np.inf)))


def _least_squares(A: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(A, b, rcond=_TOLERANCE)[0])
