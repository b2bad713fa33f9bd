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
    def inputs(self, x: FloatArray) -> FloatArray:
        """Return v_0 … v_{N−1}, shape (N, α), from a solution."""

    @abstractmethod
    def guess(self, plan: FloatArray, state: FloatArray) -> FloatArray:
        """Return x for planned inputs, shape (N, α), from the state z_0."""


@final
class Condensed(Form):
    """Only the inputs are unknown: small and dense."""

    def __init__(self, horizon: Horizon) -> None:
        from scipy.sparse import csc_array, identity, vstack

        self._horizon = horizon
        N = horizon.length
        free, forced, drift = _prediction(horizon)
        weighted = _weigh(horizon, forced)
        hessian = forced.T @ weighted + np.kron(np.eye(N), horizon.input_weight)
        scale = horizon.cost_scale * horizon.level
        self.P = csc_array(0.5 * scale * horizon.level * (hessian + hessian.T))
        rows = [identity(horizon.input_count, format="csc")]
        if horizon.change is not None:
            rows.append(_differences(N, len(horizon.low)))
        self.A = csc_array(vstack(rows))
        self._from_reference = -scale * weighted.T
        self._from_state = -self._from_reference @ free
        self._constant = -self._from_reference @ drift

    def vectors(
        self, state: FloatArray, reference: FloatArray, previous: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See :meth:`Form.vectors`."""
        q = self._from_state @ state + self._from_reference @ reference.ravel() + self._constant
        return q, *_input_limits(self._horizon, previous)

    def inputs(self, x: FloatArray) -> FloatArray:
        """See :meth:`Form.inputs`."""
        return self._horizon.level * x.reshape(self._horizon.length, -1)

    def guess(self, plan: FloatArray, state: FloatArray) -> FloatArray:
        """See :meth:`Form.guess`."""
        return plan.ravel() / self._horizon.level


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
        dynamics = hstack(
            [
                identity(N * states) - kron(eye(N, k=-1), horizon.transition),
                -kron(identity(N), level * horizon.input_matrix),
            ]
        )
        inputs = [identity(horizon.input_count)]
        if horizon.change is not None:
            inputs.append(_differences(N, len(horizon.low)))
        limits = vstack(inputs)
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

    def inputs(self, x: FloatArray) -> FloatArray:
        """See :meth:`Form.inputs`."""
        return self._horizon.level * x[self._state_count :].reshape(self._horizon.length, -1)

    def guess(self, plan: FloatArray, state: FloatArray) -> FloatArray:
        """See :meth:`Form.guess`."""
        horizon = self._horizon
        states = np.empty((horizon.length, len(state)))
        for k, v in enumerate(plan):
            state = horizon.transition @ state + horizon.input_matrix @ v + horizon.drift
            states[k] = state
        return np.concatenate([states.ravel(), plan.ravel() / horizon.level])


def _prediction(horizon: Horizon) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return S, G, D of ``Z = S z_0 + G V + D`` with Z = [z_1; …; z_N]."""
    N, (states, inputs) = horizon.length, horizon.input_matrix.shape
    free = np.zeros((N, states, states))
    forced = np.zeros((N, states, N, inputs))
    drift = np.zeros((N, states))
    for k in range(N):
        before = np.eye(states) if k == 0 else free[k - 1]
        free[k] = horizon.transition @ before
        drift[k] = horizon.drift + (horizon.transition @ drift[k - 1] if k else 0.0)
        if k:
            # What v_j does to z_{k+1} is what v_{j−1} did to z_k.
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
    return weighted.reshape(forced.shape)


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
