"""The quadratic program of one step of sequential quadratic programming, of fixed sparsity.

    minimize    Σ (z_k − r_k)ᵀ Q (z_k − r_k) + Σ (u_k − s_k)ᵀ R (u_k − s_k) + (z_N − r_N)ᵀ P (…)
                + Σ 2 πᵀ (e_k + ½ e_k²)
    subject to  z_{k+1} = A_k z_k + B_k u_k + c_k,   low ≤ u_k ≤ high,   |u_k − u_{k−1}| ≤ change,
                low − e_k ≤ E_k z_k + F_k z_{k+1} + G_k u_k + d_k ≤ high + e_k,   e_k ≥ 0

The values of A_k, B_k, E_k, F_k and G_k change from sample to sample, their places do not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.control.limits import LimitRows, moved
from tenscontrol.control.problem import Horizon
from tenscontrol.control.quadratic_program import QPSolution, QuadraticProgram
from tenscontrol.control.trajectory_model import Tangents
from tenscontrol.validation import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.sparse import csc_array


@dataclass(frozen=True, eq=False)
class Slots:
    """Where slopes go in the values of A: ``data[place] = factor * slope.ravel()[source]``."""

    place: IntArray
    source: IntArray
    factor: FloatArray

    def fill(self, data: FloatArray, slope: FloatArray) -> None:
        """Put the values of a slope into those of A."""
        data[self.place] = self.factor * slope.reshape(-1)[self.source]


class TrajectoryProgram:
    """The program, prepared by :meth:`linearize` and solved by :meth:`solve`.

    Unknowns are z_1 … z_N, u_0 … u_{N−1} and the violations, in units of one speed, of one
    input and of the rows.

    Parameters
    ----------
    horizon : Horizon
        Weights, change, level, rows and length. Where a matrix of the rows is zero, it stays so;
        their values are the first to be put in.
    bounds : tuple of ndarray, shape (α,) each
        Least and largest input.
    row_bounds : tuple of ndarray, shape (p,) each
        Least and largest value of the limited rows.
    units : ndarray, shape (s,)
        Units of the state.
    tolerance : float
    max_iterations : int

    Attributes
    ----------
    limits : LimitRows
        The rows after those of the dynamics, which are as many as entries of z_1 … z_N.
    slots : tuple
        Slots of A_k and B_k, and a list of those of E_k, G_k and F_k for each of ``limits.parts``.
    quadratic : QuadraticProgram
    """

    def __init__(
        self,
        horizon: Horizon,
        bounds: tuple[FloatArray, FloatArray],
        row_bounds: tuple[FloatArray, FloatArray],
        units: FloatArray,
        tolerance: float,
        max_iterations: int,
    ) -> None:
        from scipy.sparse import block_diag, csc_array, diags_array

        self._horizon, self.units = horizon, units
        self._row_bounds = row_bounds
        N, (s, a) = horizon.length, horizon.input_matrix.shape
        scale, level = horizon.cost_scale, horizon.level
        self.limits = LimitRows(self._horizon)
        weights = [horizon.state_weight] * (N - 1) + [horizon.terminal_weight]
        tracking = [scale * units[:, None] * weight * units for weight in weights]
        effort = [scale * level**2 * horizon.input_weight] * N
        squares = diags_array(self.limits.price)
        self._weights = csc_array(block_diag([csc_array(block) for block in tracking + effort]))
        self._P = csc_array(block_diag([self._weights, squares]))
        self._states = N * s
        self._pattern = self._places()
        self.slots = self._dynamic_slots(), self._row_slots()
        self.quadratic = QuadraticProgram(
            self._P, self._pattern, tolerance, max_iterations, equations=True
        )
        low, high = (np.tile(bound, (N, 1)) for bound in bounds)
        nothing = np.zeros((N, 0))
        self._course = replace(horizon.steady_course, low=low, high=high, row_low=nothing,
                               row_high=nothing)  # fmt: skip
        self._widths = [s, a, len(self.limits.price) // N], [s, *self.limits.widths]
        self._guess: tuple[FloatArray, FloatArray] | None = None

    def _places(self) -> csc_array:
        """Return A with ones where values go, so that no value that is 0 loses its place."""
        from scipy.sparse import csc_array, eye, hstack, identity, kron, vstack

        horizon, limits = self._horizon, self.limits
        N, (s, a) = horizon.length, horizon.input_matrix.shape
        dynamics = hstack([
            # Dense blocks added as such would give the identity theirs, full of zeros.
            identity(N * s) + csc_array(kron(eye(N, k=-1), np.ones((s, s)))),
            kron(identity(N), np.ones((s, a))),
            csc_array((N * s, len(limits.price))),
        ])  # fmt: skip
        rows = hstack([limits.on_states, horizon.level * limits.on_inputs, limits.on_violations])
        pattern = csc_array(vstack([dynamics, rows]))
        pattern.sort_indices()
        return pattern

    def _found(self, row: IntArray, column: IntArray) -> IntArray:
        """Return the places of entries in the order of columns."""
        pattern = self._pattern
        columns = np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.indptr))
        keys = columns * pattern.shape[0] + pattern.indices
        return np.asarray(np.searchsorted(keys, column * pattern.shape[0] + row))

    def _dynamic_slots(self) -> tuple[Slots, Slots]:
        """Return the slots of A_k and B_k; A_0 meets only what is known."""
        s, a = self._horizon.input_matrix.shape
        every, factor = np.arange(s), -1 / self.units
        return (
            self._filled(np.ones((s, s)), every, factor, 0, late=1),
            self._filled(np.ones((s, a)), every, factor, 0, late=None),
        )

    def _row_slots(self) -> list[tuple[Slots, Slots, Slots]]:
        """Return the slots of E_k, G_k and F_k, for each part of the limited rows."""
        rows, slots = self._horizon.rows, []
        for places, start in self.limits.parts:
            assert rows is not None  # there are parts
            factor, first = 1 / rows.scale[places], self._states + start
            slots.append((
                self._filled(rows.before, places, factor, first, late=1),
                self._filled(rows.inputs, places, factor, first, late=None),
                self._filled(rows.after, places, factor, first, late=0),
            ))  # fmt: skip
        return slots

    def _filled(
        self, pattern: FloatArray, taken: IntArray, factor: FloatArray, start: int, late: int | None
    ) -> Slots:
        """Return the slots of slopes of the N samples, by z_{k+1−late}, or by u_k for None.

        Parameters
        ----------
        pattern : ndarray, shape (m, columns)
            Zero where a slope has no place.
        taken : ndarray of int, shape (w,)
            Which of the m values are used.
        factor : ndarray, shape (w,)
            Of these rows.
        start : int
            First row; those of a sample follow those of the one before.
        late : int or None
        """
        horizon, (size, columns) = self._horizon, pattern.shape
        units = np.full(columns, horizon.level) if late is None else self.units
        first, behind = (self._states, 0) if late is None else (0, late)
        j, i = np.nonzero(pattern[taken].T)
        k = np.arange(behind, horizon.length)[:, None]
        place = self._found(start + k * len(taken) + i, first + (k - behind) * columns + j)
        source = (k * columns + j) * size + taken[i]
        scaled = np.tile(units[j] * factor[i], len(k))
        return Slots(place.ravel(), source.ravel(), scaled)

    @property
    def hessian(self) -> csc_array:
        """P of the program, sparse."""
        return self._P

    @property
    def pattern(self) -> csc_array:
        """A of the program with the values put in last."""
        return self._pattern.copy()

    def forget(self) -> None:
        """Start the next solve from nothing."""
        self._guess = None

    def reset(self) -> None:
        """Forget the last answer, and what the solver adapted to it."""
        self.forget()
        self.quadratic.reset()

    def linearize(self, motion: Tangents, rows: Tangents | None = None) -> None:
        """Put dynamics and limited rows in.

        Parameters
        ----------
        motion : Tangents
            A_k, B_k and c_k.
        rows : Tangents, optional
            E_k, G_k, F_k and d_k, where rows are limited.
        """
        data, course = self._pattern.data, self._course
        for slots, slope in zip(self.slots[0], motion.slopes, strict=True):
            slots.fill(data, slope)
        if rows is not None:
            for part in self.slots[1]:
                for slots, slope in zip(part, rows.slopes, strict=True):
                    slots.fill(data, slope)
            low, high = self._row_bounds
            course = replace(course, row_low=low - rows.offset, row_high=high - rows.offset)
            self._rows_first = rows.slopes[0][0].copy()
        self._course = course
        self.quadratic.update(data)
        self._first, self._offset = motion.slopes[0][0].copy(), motion.offset

    def vectors(
        self, state: FloatArray, reference: FloatArray, inputs: FloatArray, previous: FloatArray,
        drift: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
        """Return q, l and u.

        Parameters
        ----------
        state : ndarray, shape (s,)
            z_0.
        reference : ndarray, shape (N, s)
            r_1 … r_N.
        inputs : ndarray, shape (N, α)
            s_0 … s_{N−1}.
        previous : ndarray, shape (α,)
            u_{−1}.
        drift : ndarray, shape (s,), optional
            Added to every c_k.
        """
        level, course = self._horizon.level, self._course
        wanted = np.concatenate([(reference / self.units).ravel(), inputs.ravel() / level])
        motion = self._offset.copy() if drift is None else self._offset + drift
        motion[0] += state @ self._first
        motion /= self.units
        if course.row_low.shape[1]:
            known = state @ self._rows_first
            row_low, row_high = course.row_low.copy(), course.row_high.copy()
            row_low[0] -= known
            row_high[0] -= known
            course = replace(course, row_low=row_low, row_high=row_high)
        low, high = self.limits.bounds(previous, course)
        equal = motion.ravel()
        return (
            np.concatenate([-(self._weights @ wanted), self.limits.price]),
            np.concatenate([equal, low]),
            np.concatenate([equal, high]),
        )

    def solve(
        self, state: FloatArray, reference: FloatArray, inputs: FloatArray, previous: FloatArray,
        drift: FloatArray | None = None, deadline: float = np.inf,
    ) -> tuple[QPSolution, FloatArray, FloatArray]:  # fmt: skip
        """Return the answer, z_1 … z_N (N, s) and u_0 … u_{N−1} (N, α); arguments as above.

        The deadline is that of :meth:`QuadraticProgram.solve`.
        """
        vectors = self.vectors(state, reference, inputs, previous, drift)
        answer = self.quadratic.solve(*vectors, start=self._guess, deadline=deadline)
        N, count = self._horizon.length, self._horizon.input_count
        if answer.x is None or answer.y is None:
            self._guess = None
            return answer, np.zeros((N, 0)), np.zeros((N, 0))
        self._guess = answer.x, answer.y
        states, rest = np.split(answer.x, [self._states])
        planned = rest[:count].reshape(N, -1) * self._horizon.level
        return answer, states.reshape(N, -1) * self.units, planned

    def shift(self) -> None:
        """Move the last answer on by a sample, to start the next from."""
        if self._guess is not None:
            self._guess = self.moved(*self._guess)

    def moved(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a primal and dual solution moved on by a sample."""
        N, (wide, high) = self._horizon.length, self._widths
        return moved(x, N, wide, repeat=True), moved(y, N, high, repeat=False)
