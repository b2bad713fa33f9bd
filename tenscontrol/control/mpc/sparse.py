"""The quadratic program of one step of sequential quadratic programming, of fixed sparsity.

    minimize    Σ (z_k − r_k)ᵀ Q (z_k − r_k) + Σ (u_k − s_k)ᵀ R (u_k − s_k) + (z_N − r_N)ᵀ P (…)
                + Σ 2 πᵀ (e_k + ½ e_k²)
    subject to  z_{k+1} = A_k z_k + B_k u_k + C_k u_{k−1} + c_k,
                low ≤ u_k ≤ high,   |u_k − u_{k−1}| ≤ change,
                low − e_k ≤ E_k z_k + F_k z_{k+1} + G_k u_k + d_k ≤ high + e_k,   e_k ≥ 0

The values of A_k, B_k, C_k, E_k, F_k and G_k change from sample to sample, their places do not.
C_k is there only where winches wind. Then P weighs ``[z_N; u_{N−1}]``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.control.mpc.limit_rows import LimitRows, moved
from tenscontrol.control.mpc.osqp_adapter import QPSolution, QuadraticProgram
from tenscontrol.control.mpc.problem import Horizon
from tenscontrol.control.mpc.stage_jacobians import Tangents
from tenscontrol.control.mpc.trajectory_places import TrajectoryPlaces
from tenscontrol.validation import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csc_array


class TrajectoryProgram:
    """The program, prepared by :meth:`linearize` and solved by :meth:`solve`.

    Unknowns are z_1 … z_N, u_0 … u_{N−1} and the violations, in units of one speed, of one
    input and of the rows. States and inputs are measured from zero, or from a plan.

    Parameters
    ----------
    horizon : Horizon
        Weights, change, level, rows and length. Where a matrix of the rows is zero, it stays so;
        their values are the first to be put in. With a terminal weight of ``[z_N; u_{N−1}]``
        the input before matters to the motion.
    bounds : tuple of ndarray, shape (α,) each
        Least and largest input.
    row_bounds : tuple of ndarray, shape (p,) each
        Least and largest value of the limited rows.
    units : ndarray, shape (s,)
        Units of the state.
    tolerance : float
    max_iterations : int
    even : bool
        Whether slopes in these units are of one size. If not, the solver scales them.

    Attributes
    ----------
    limits : LimitRows
        The rows after those of the dynamics, which are as many as entries of z_1 … z_N.
    places : TrajectoryPlaces
        Where slopes go.
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
        even: bool = True,
    ) -> None:
        from scipy.sparse import block_diag, csc_array, diags_array

        self._horizon, self.units = horizon, units
        self._row_bounds = row_bounds
        N, (s, a) = horizon.length, horizon.input_matrix.shape
        scale, level = horizon.cost_scale, horizon.level
        self.limits = LimitRows(self._horizon)
        weights = [horizon.state_weight] * (N - 1) + [horizon.terminal_weight[:s, :s]]
        tracking = [scale * units[:, None] * weight * units for weight in weights]
        effort = [scale * level**2 * horizon.input_weight] * N
        squares = diags_array(self.limits.price)
        self._weights = csc_array(block_diag([csc_array(block) for block in tracking + effort]))
        self._ramp = len(horizon.terminal_weight) > s
        if self._ramp:
            self._weights += self._by_last_input()
        self._P = csc_array(block_diag([self._weights, squares]))
        self._states = N * s
        self.places = TrajectoryPlaces(horizon, self.limits, units, self._ramp)
        self._pattern = self.places.pattern
        self.quadratic = QuadraticProgram(
            self._P, self._pattern, tolerance, max_iterations, equations=even
        )
        low, high = (np.tile(bound, (N, 1)) for bound in bounds)
        nothing = np.zeros((N, 0))
        self._course = replace(horizon.steady_course, low=low, high=high, row_low=nothing,
                               row_high=nothing)  # fmt: skip
        self._widths = [s, a, len(self.limits.price) // N], [s, *self.limits.widths]
        self._about: tuple[FloatArray, FloatArray] | None = None
        self._guess: tuple[FloatArray, FloatArray] | None = None

    def _by_last_input(self) -> csc_array:
        """Return what the terminal weight adds where it weighs u_{N−1}, which still winds then."""
        from scipy.sparse import csc_array

        horizon = self._horizon
        N, (s, a) = horizon.length, horizon.input_matrix.shape
        units = np.r_[self.units, np.full(a, horizon.level)]
        block = horizon.cost_scale * units[:, None] * horizon.terminal_weight * units
        block[:s, :s] = 0.0
        last = np.r_[(N - 1) * s + np.arange(s), N * s + (N - 1) * a + np.arange(a)]
        row, column = np.meshgrid(last, last, indexing="ij")
        return csc_array((block.ravel(), (row.ravel(), column.ravel())), self._weights.shape)

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

    def linearize(
        self,
        motion: Tangents,
        rows: Tangents | None = None,
        about: tuple[FloatArray, FloatArray] | None = None,
    ) -> None:
        """Put dynamics and limited rows in.

        Parameters
        ----------
        motion : Tangents
            A_k, B_k, C_k where winches wind, and c_k.
        rows : Tangents, optional
            E_k, G_k, F_k and d_k, where rows are limited.
        about : tuple of ndarray, shapes (N, s) and (N, α), optional
            A plan z_1 …, u_0 … that unknowns are measured from, zero if not given. The solver
            stops at an error relative to the unknowns: of rest lengths of stiff strings,
            themselves thousands of stretches, that is too much.
        """
        data, course = self._pattern.data, self._course
        for slots, slope in zip(self.places.motion, motion.slopes, strict=True):
            slots.fill(data, slope)
        if rows is not None:
            for part in self.places.rows:
                for slots, slope in zip(part, rows.slopes, strict=True):
                    slots.fill(data, slope)
            low, high = self._row_bounds
            known = rows.offset
            if about is not None:
                known = known + _moved(about[0], rows.slopes[2]) + _moved(about[1], rows.slopes[1])
                known[1:] += _moved(about[0][:-1], rows.slopes[0][1:])
            course = replace(course, row_low=low - known, row_high=high - known)
            self._rows_first = rows.slopes[0][0].copy()
        self._course = course
        self.quadratic.update(data)
        self._first, self._offset = motion.slopes[0][0].copy(), motion.offset
        if self._ramp:
            self._first_input = motion.slopes[2][0].copy()
        self._about = about
        if about is not None:
            self._measure_from(*about, motion)

    def _measure_from(self, states: FloatArray, inputs: FloatArray, motion: Tangents) -> None:
        """Let a plan be the zero of the unknowns."""
        offset = motion.offset - states + _moved(inputs, motion.slopes[1])
        offset[1:] += _moved(states[:-1], motion.slopes[0][1:])
        if self._ramp:
            offset[1:] += _moved(inputs[:-1], motion.slopes[2][1:])
        self._offset = offset
        if self._guess is not None:
            self._guess[0][: self._states + inputs.size] = 0.0

    def vectors(
        self, state: FloatArray, reference: FloatArray, inputs: FloatArray, previous: FloatArray,
        drift: FloatArray | None = None, standing: FloatArray | None = None,
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
            u_{−1} that changes are limited from.
        drift : ndarray, shape (s,), optional
            Added to every c_k.
        standing : ndarray, shape (α,), optional
            u_{−1} of the motion, needed where winches wind.
        """
        level, course = self._horizon.level, self._course
        if self._about is not None:
            states, planned = self._about
            reference, inputs = reference - states, inputs - planned
            shift = np.diff(planned, axis=0, prepend=planned[:1])
            course = replace(
                course, low=course.low - planned, high=course.high - planned, shift=shift
            )
            previous = previous - planned[0]
        wanted = np.concatenate([(reference / self.units).ravel(), inputs.ravel() / level])
        motion = self._offset.copy() if drift is None else self._offset + drift
        motion[0] += state @ self._first
        if standing is not None:
            motion[0] += standing @ self._first_input
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
        drift: FloatArray | None = None, standing: FloatArray | None = None,
        deadline: float = np.inf,
    ) -> tuple[QPSolution, FloatArray, FloatArray]:  # fmt: skip
        """Return the answer, z_1 … z_N (N, s) and u_0 … u_{N−1} (N, α); arguments as above.

        The deadline is that of :meth:`QuadraticProgram.solve`.
        """
        vectors = self.vectors(state, reference, inputs, previous, drift, standing)
        answer = self.quadratic.solve(*vectors, start=self._guess, deadline=deadline)
        N, count = self._horizon.length, self._horizon.input_count
        if answer.x is None or answer.y is None:
            self._guess = None
            return answer, np.zeros((N, 0)), np.zeros((N, 0))
        self._guess = answer.x, answer.y
        found, rest = np.split(answer.x, [self._states])
        states, planned = found.reshape(N, -1) * self.units, rest[:count].reshape(N, -1)
        planned = planned * self._horizon.level
        if self._about is not None:
            states, planned = states + self._about[0], planned + self._about[1]
        return answer, states, planned

    def shift(self) -> None:
        """Move the last answer on by a sample, to start the next from."""
        if self._guess is not None:
            self._guess = self.moved(*self._guess)

    def moved(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a primal and dual solution moved on by a sample."""
        N, (wide, high) = self._horizon.length, self._widths
        return moved(x, N, wide, repeat=True), moved(y, N, high, repeat=False)


def _moved(arguments: FloatArray, slopes: FloatArray) -> FloatArray:
    """Return what arguments, shape (K, columns), make of slopes stored by columns."""
    return np.asarray((arguments[:, None, :] @ slopes)[:, 0])
