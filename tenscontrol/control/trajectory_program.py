"""The quadratic program of one step of sequential quadratic programming, of fixed sparsity.

    minimize    Σ (z_k − r_k)ᵀ Q (z_k − r_k) + Σ (u_k − s_k)ᵀ R (u_k − s_k) + (z_N − r_N)ᵀ P (…)
    subject to  z_{k+1} = A_k z_k + B_k u_k + c_k,   low ≤ u_k ≤ high,   |u_k − u_{k−1}| ≤ change

The values of A_k and B_k change from sample to sample, their places do not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.control.limits import moved
from tenscontrol.control.problem import Horizon
from tenscontrol.control.quadratic_program import QPSolution, QuadraticProgram
from tenscontrol.validation import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csc_array


class TrajectoryProgram:
    """The program, prepared by :meth:`linearize` and solved by :meth:`solve`.

    Unknowns are z_1 … z_N and u_0 … u_{N−1}, in units of one speed and of one input.

    Parameters
    ----------
    horizon : Horizon
        Weights, change, level and length; its dynamics are the first to be put in.
    bounds : tuple of ndarray, shape (α,) each
        Least and largest input.
    units : ndarray, shape (s,)
        Units of the state.
    tolerance : float
    max_iterations : int
    """

    def __init__(
        self,
        horizon: Horizon,
        bounds: tuple[FloatArray, FloatArray],
        units: FloatArray,
        tolerance: float,
        max_iterations: int,
    ) -> None:
        from scipy.sparse import block_diag, csc_array, eye, identity, kron

        self._horizon, self._bounds, self.units = horizon, bounds, units
        N, s, a = horizon.length, len(units), len(horizon.low)
        scale, level = horizon.cost_scale, horizon.level
        weights = [horizon.state_weight] * (N - 1) + [horizon.terminal_weight]
        tracking = [scale * units[:, None] * weight * units for weight in weights]
        effort = [scale * level**2 * horizon.input_weight] * N
        self._P = csc_array(block_diag([csc_array(block) for block in tracking + effort]))
        ones_z, ones_u = np.ones((s, s)), np.ones((s, a))
        rows = N * s
        # Built of ones where values go, so that no value that happens to be 0 loses its place.
        places_z = kron(eye(N, k=-1), ones_z).tocoo()
        places_u = kron(identity(N), ones_u).tocoo()
        limits = [identity(N * a)]
        if horizon.change is not None:
            limits.append(kron(identity(N) - eye(N, k=-1), identity(a)))
        fixed = [np.arange(rows), np.arange(rows)], np.ones(rows)
        blocks = [(fixed[0][0], fixed[0][1], fixed[1])]
        start = rows
        for limit in limits:
            part = limit.tocoo()
            blocks.append((part.row + start, part.col + rows, part.data))
            start += part.shape[0]
        count = sum(len(block[2]) for block in blocks)
        blocks += [
            (places_z.row, places_z.col, places_z.data),
            (places_u.row, places_u.col + rows, places_u.data),
        ]
        row, column, value = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        # Numbering the entries tells where each ends up in the order of columns.
        numbered = csc_array((np.arange(1.0, len(value) + 1), (row, column)))
        self._order = numbered.data.astype(int) - 1
        self._values = value
        self._slots = (
            slice(count, count + len(places_z.data)),
            slice(count + len(places_z.data), None),
        )
        self._taken = (
            (places_z.row // s, places_z.row % s, places_z.col % s),
            (places_u.row // s, places_u.row % s, places_u.col % a),
        )
        shape = numbered.shape
        pattern = csc_array((value[self._order], numbered.indices, numbered.indptr), shape=shape)
        self._pattern = pattern
        self._program = QuadraticProgram(self._P, pattern, tolerance, max_iterations)
        self._rows = rows
        self._guess: tuple[FloatArray, FloatArray] | None = None
        self.forget()

    @property
    def hessian(self) -> csc_array:
        """P of the program, sparse."""
        return self._P

    @property
    def pattern(self) -> csc_array:
        """A of the program with the values put in last."""
        matrix = self._pattern.copy()
        matrix.data = self._values[self._order]
        return matrix

    def forget(self) -> None:
        """Start the next solve from nothing."""
        self._guess = None

    def linearize(self, by_state: FloatArray, by_input: FloatArray, offset: FloatArray) -> None:
        """Put dynamics in: A_k (N, s, s), B_k (N, s, α) and c_k (N, s)."""
        by_state = by_state * self.units / self.units[:, None]
        by_input = self._horizon.level * by_input / self.units[:, None]
        for slot, values, taken in zip(self._slots, (by_state, by_input), self._taken, strict=True):
            self._values[slot] = -values[taken]
        self._program.update(self._values[self._order])
        self._first, self._offset = by_state[0], offset / self.units

    def vectors(
        self, state: FloatArray, reference: FloatArray, inputs: FloatArray, previous: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, l and u for z_0, r_1 … r_N (N, s), s_0 … (N, α) and u_{−1} (α,)."""
        N, level = self._horizon.length, self._horizon.level
        wanted = np.concatenate([(reference / self.units).ravel(), inputs.ravel() / level])
        motion = self._offset.copy()
        motion[0] += self._first @ (state / self.units)
        low, high = ([motion.ravel(), np.tile(bound / level, N)] for bound in self._bounds)
        if self._horizon.change is not None:
            reach = np.tile(self._horizon.change / level, (N, 1))
            middle = np.zeros_like(reach)
            middle[0] = previous / level
            low.append((middle - reach).ravel())
            high.append((middle + reach).ravel())
        return -(self._P @ wanted), np.concatenate(low), np.concatenate(high)

    def solve(
        self,
        state: FloatArray,
        reference: FloatArray,
        inputs: FloatArray,
        previous: FloatArray,
        deadline: float = np.inf,
    ) -> tuple[QPSolution, FloatArray, FloatArray]:
        """Return the answer, z_1 … z_N (N, s) and u_0 … u_{N−1} (N, α); arguments as above.

        The deadline is that of :meth:`QuadraticProgram.solve`.
        """
        vectors = self.vectors(state, reference, inputs, previous)
        answer = self._program.solve(*vectors, start=self._guess, deadline=deadline)
        N = self._horizon.length
        if answer.x is None or answer.y is None:
            self._guess = None
            return answer, np.zeros((N, 0)), np.zeros((N, 0))
        self._guess = answer.x, answer.y
        states = answer.x[: self._rows].reshape(N, -1) * self.units
        return answer, states, answer.x[self._rows :].reshape(N, -1) * self._horizon.level

    def shift(self) -> None:
        """Move the last answer on by a sample, to start the next from."""
        if self._guess is None:
            return
        N, s, a = self._horizon.length, len(self.units), len(self._horizon.low)
        widths = [s, a], [s] + [a] * (1 if self._horizon.change is None else 2)
        self._guess = (
            moved(self._guess[0], N, widths[0], repeat=True),
            moved(self._guess[1], N, widths[1], repeat=False),
        )
