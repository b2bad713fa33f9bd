"""The finite-horizon problem of MPC, in two forms of the same quadratic program.

    minimize    Σ (z_k − r_k)ᵀ Q (z_k − r_k) + Σ v_kᵀ R v_k + (z_N − r_N)ᵀ P (z_N − r_N)
    subject to  z_{k+1} = Φ z_k + Γ v_k + d,   low ≤ v_k ≤ high,   |v_k − v_{k−1}| ≤ change

Both forms have a pattern that never changes; only vectors do from sample to sample.
Inputs are measured in units of a level, and the cost is scaled so that its least
curvature by such an input is at least one: a residual ε of the solver then means an input
within about ε levels of the optimum, whatever the weights.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from tenscontrol.validation import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csc_array


@dataclass(frozen=True, eq=False)
class Horizon:
    """Data of the problem.

    Attributes
    ----------
    transition, input_matrix, drift : ndarray
        Φ (s, s), Γ (s, α) and d (s,).
    state_weight, input_weight, terminal_weight : ndarray
        Q (s, s), R (α, α) and P (s, s).
    low, high : ndarray, shape (α,)
        Bounds of v.
    change : ndarray, shape (α,), or None
        Largest change of v from sample to sample; None for no limit.
    length : int
        N.
    level : float
        Unit of v inside the program.
    feedback : ndarray, shape (α, s)
        K of the LQR with these weights.
    """

    transition: FloatArray
    input_matrix: FloatArray
    drift: FloatArray
    state_weight: FloatArray
    input_weight: FloatArray
    terminal_weight: FloatArray
    low: FloatArray
    high: FloatArray
    change: FloatArray | None
    length: int
    level: float
    feedback: FloatArray

    @property
    def cost_scale(self) -> float:
        """What the cost is multiplied by."""
        return 1.0 / (self.level**2 * float(np.linalg.eigvalsh(self.input_weight).min()))

    @property
    def input_count(self) -> int:
        """Number of entries of all v together."""
        return int(self.length * self.input_matrix.shape[1])


class Form(ABC):
    """One way to write the problem as ``min ½ xᵀ P x + qᵀ x, l ≤ A x ≤ u``."""

    P: csc_array
    A: csc_array

    @abstractmethod
    def vectors(
        self, state: FloatArray, reference: FloatArray, previous: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, l and u.

        Parameters
        ----------
        state : ndarray, shape (s,)
            z_0.
        reference : ndarray, shape (N, s)
            r_1 … r_N.
        previous : ndarray, shape (α,)
            v_{−1}; matters only where the change is limited.
        """

    @abstractmethod
    def inputs(self, x: FloatArray, state: FloatArray) -> FloatArray:
        """Return v_0 … v_{N−1}, shape (N, α), from a solution."""

    @abstractmethod
    def unknowns(self, plan: FloatArray, state: FloatArray) -> FloatArray:
        """Return x from v_0 … v_{N−1}, shape (N, α)."""

    @abstractmethod
    def shifted(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a primal and dual solution moved on by one sample, to start the next from."""


@final
class Condensed(Form):
    """Only the departures from the LQR law are unknown: small and dense.

    With ``v_k = −K z_k + c_k`` and the LQR cost at the end, the Hessian in the
    c_k is block diagonal and the same at each sample (Rossiter, Kouvaritakis &
    Rice 1998, doi:10.1016/S0005-1098(97)00192-5). Measured by its Cholesky
    factor it is the identity, and an ADMM solver needs a few iterations where
    the problem in the v_k takes tens.
    """

    def __init__(self, horizon: Horizon) -> None:
        from scipy.linalg import solve_triangular
        from scipy.sparse import csc_array, identity

        self._horizon = horizon
        N, states = horizon.length, len(horizon.drift)
        free, forced, drift = _prediction(horizon)
        feedback = np.kron(np.eye(N), horizon.feedback)
        # v = by_state z_0 + by_choice c + by_drift: the law sees z_0 … z_{N−1}.
        before = [np.vstack([first, part[:-states]]) for first, part in (
            (np.eye(states), free),
            (np.zeros((states, forced.shape[1])), forced),
            (np.zeros((states, 1)), drift[:, None]),
        )]  # fmt: skip
        by_state, by_choice, by_drift = (-feedback @ part for part in before)
        by_choice += np.eye(len(by_choice))
        weighted = _weigh(horizon, forced)
        effort = np.kron(np.eye(N), horizon.input_weight) @ by_choice
        hessian = horizon.cost_scale * (forced.T @ weighted + by_choice.T @ effort)
        factor = np.linalg.cholesky(0.5 * (hessian + hessian.T))
        # c = unit x, with unitᵀ hessian unit = I.
        unit = solve_triangular(factor, np.eye(len(factor)), lower=True).T
        self.P = csc_array(identity(len(unit)))
        self._to_inputs = by_choice @ unit
        self._from_inputs = np.linalg.inv(self._to_inputs)
        self._by_state, self._by_drift = by_state, by_drift.ravel()
        limits = _limit_matrix(horizon)
        self.A = csc_array(limits @ _trimmed(self._to_inputs) / horizon.level)
        self._limits = limits
        slope = horizon.cost_scale * unit.T
        self._from_reference = -slope @ weighted.T
        self._from_state = slope @ (weighted.T @ free + effort.T @ by_state)
        self._constant = slope @ (weighted.T @ drift + effort.T @ self._by_drift)

    def vectors(
        self, state: FloatArray, reference: FloatArray, previous: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See :meth:`Form.vectors`."""
        q = self._from_state @ state + self._from_reference @ reference.ravel() + self._constant
        low, high = _input_limits(self._horizon, previous)
        offset = self._limits @ (self._by_state @ state + self._by_drift) / self._horizon.level
        return q, low - offset, high - offset

    def inputs(self, x: FloatArray, state: FloatArray) -> FloatArray:
        """See :meth:`Form.inputs`."""
        v = self._to_inputs @ x + self._by_state @ state + self._by_drift
        return np.asarray(v.reshape(self._horizon.length, -1))

    def unknowns(self, plan: FloatArray, state: FloatArray) -> FloatArray:
        """See :meth:`Form.unknowns`."""
        choice = plan.ravel() - self._by_state @ state - self._by_drift
        return np.asarray(self._from_inputs @ choice)

    def shifted(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Form.shifted`."""
        # After the horizon the law is followed as it is.
        blocks = (self._horizon.length, len(self._horizon.low))
        return _moved(x, blocks, repeat=False), _moved(y, blocks, repeat=False)


@final
class Sparse(Form):
    """States and inputs are unknown, the dynamics are constraints: large and sparse."""

    def __init__(self, horizon: Horizon) -> None:
        from scipy.sparse import block_diag, csc_array, eye, hstack, identity, kron, vstack

        self._horizon = horizon
        N, states = horizon.length, len(horizon.drift)
        scale, level = horizon.cost_scale, horizon.level
        tracking = [scale * horizon.state_weight] * (N - 1) + [scale * horizon.terminal_weight]
        effort = [scale * level**2 * horizon.input_weight] * N
        # Zeros inside the blocks are left out: the pattern is fixed all the same.
        self.P = csc_array(block_diag([csc_array(block) for block in tracking + effort]))
        self._weights = csc_array(block_diag([csc_array(block) for block in tracking]))
        dynamics = hstack([
            identity(N * states) - kron(eye(N, k=-1), horizon.transition),
            -kron(identity(N), level * horizon.input_matrix),
        ])  # fmt: skip
        limits = _limit_matrix(horizon)
        empty = csc_array((limits.shape[0], N * states))
        self.A = csc_array(vstack([dynamics, hstack([empty, limits])]))
        self._state_count = N * states

    def vectors(
        self, state: FloatArray, reference: FloatArray, previous: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See :meth:`Form.vectors`."""
        horizon = self._horizon
        tracking = -(self._weights @ reference.ravel())
        q = np.concatenate([tracking, np.zeros(horizon.input_count)])
        motion = np.tile(horizon.drift, horizon.length)
        motion[: len(state)] += horizon.transition @ state
        low, high = _input_limits(horizon, previous)
        return q, np.concatenate([motion, low]), np.concatenate([motion, high])

    def inputs(self, x: FloatArray, state: FloatArray) -> FloatArray:
        """See :meth:`Form.inputs`."""
        return self._horizon.level * x[self._state_count :].reshape(self._horizon.length, -1)

    def unknowns(self, plan: FloatArray, state: FloatArray) -> FloatArray:
        """See :meth:`Form.unknowns`."""
        horizon = self._horizon
        states = np.empty((horizon.length, len(state)))
        for k, v in enumerate(plan):
            state = horizon.transition @ state + horizon.input_matrix @ v + horizon.drift
            states[k] = state
        return np.concatenate([states.ravel(), plan.ravel() / horizon.level])

    def shifted(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Form.shifted`."""
        states = (self._horizon.length, len(self._horizon.drift))
        inputs = (self._horizon.length, len(self._horizon.low))
        split = self._state_count
        moved = [
            np.concatenate([_moved(v[:split], states, repeat), _moved(v[split:], inputs, repeat)])
            for v, repeat in ((x, True), (y, False))
        ]
        return moved[0], moved[1]


def _moved(vector: FloatArray, blocks: tuple[int, int], repeat: bool) -> FloatArray:
    """Drop the first block of each run of blocks, and repeat the last or append zeros."""
    runs = vector.reshape(-1, *blocks)
    moved = np.concatenate([runs[:, 1:], runs[:, -1:] if repeat else 0.0 * runs[:, -1:]], axis=1)
    return np.asarray(moved.ravel())


def _prediction(horizon: Horizon) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return S, G, D of ``Z = S z_0 + G C + D`` with Z = [z_1; …; z_N] and v = −K z + c."""
    N, (states, inputs) = horizon.length, horizon.input_matrix.shape
    closed = horizon.transition - horizon.input_matrix @ horizon.feedback
    free = np.zeros((N, states, states))
    forced = np.zeros((N, states, N, inputs))
    drift = np.zeros((N, states))
    for k in range(N):
        before = np.eye(states) if k == 0 else free[k - 1]
        free[k] = closed @ before
        drift[k] = horizon.drift + (closed @ drift[k - 1] if k else 0.0)
        if k:
            # What c_j does to z_{k+1} is what c_{j−1} did to z_k.
            forced[k, :, 1:] = forced[k - 1, :, :-1]
        forced[k, :, 0] = free[k - 1] @ horizon.input_matrix if k else horizon.input_matrix
    return (
        free.reshape(N * states, states),
        forced.reshape(N * states, N * inputs),
        drift.ravel(),
    )


def _weigh(horizon: Horizon, forced: FloatArray) -> FloatArray:
    blocks = forced.reshape(horizon.length, len(horizon.drift), -1)
    weighted = np.einsum("ij,kjm->kim", horizon.state_weight, blocks)
    weighted[-1] = horizon.terminal_weight @ blocks[-1]
    return np.asarray(weighted.reshape(forced.shape))


def _limit_matrix(horizon: Horizon) -> csc_array:
    """Return the matrix whose rows are limited: inputs and, if asked for, their changes."""
    from scipy.sparse import csc_array, identity, vstack

    inputs = identity(horizon.input_count)
    if horizon.change is None:
        return csc_array(inputs)
    return csc_array(vstack([inputs, _differences(horizon.length, len(horizon.low))]))


def _trimmed(matrix: FloatArray) -> csc_array:
    """Return a block triangular matrix without the round-off above its diagonal blocks."""
    from scipy.sparse import csc_array

    return csc_array(np.where(np.abs(matrix) > 1e-14 * np.abs(matrix).max(), matrix, 0.0))


def _differences(length: int, inputs: int) -> csc_array:
    """Return the matrix of v_k − v_{k−1}; its first rows give v_0 alone."""
    from scipy.sparse import csc_array, eye, identity, kron

    return csc_array(kron(identity(length) - eye(length, k=-1), identity(inputs)))


def _input_limits(horizon: Horizon, previous: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the limits on inputs and, if asked for, on their changes, in levels."""
    low = np.tile(horizon.low, horizon.length) / horizon.level
    high = np.tile(horizon.high, horizon.length) / horizon.level
    if horizon.change is None:
        return low, high
    step = np.tile(horizon.change, horizon.length) / horizon.level
    offset = np.zeros_like(step)
    offset[: len(previous)] = previous / horizon.level
    return np.concatenate([low, offset - step]), np.concatenate([high, offset + step])
