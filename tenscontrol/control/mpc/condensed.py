"""The problem of linear MPC without its states: a small, dense quadratic program.

This form and the sparse one have a pattern that never changes; only vectors do from sample to
sample. Inputs are measured in units of a level, and the cost is scaled so that its least
curvature by such an input is at least one: a residual ε of the solver then means an input
within about ε levels of the optimum, whatever the weights.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from tenscontrol.control.mpc.constraints import LimitRows, shifted
from tenscontrol.control.mpc.problem import Form, MPCProblem, StageData
from tenscontrol.validation import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csc_array


@final
class Condensed(Form):
    """Only the departures from the LQR law, and violations, are unknown: small and dense.

    With ``v_k = −K z_k + c_k`` and the LQR cost at the end, the Hessian in the
    c_k is block diagonal and the same at each sample (Rossiter, Kouvaritakis &
    Rice 1998, doi:10.1016/S0005-1098(97)00192-5). Measured by its Cholesky
    factor it is the identity, and an ADMM solver needs a few iterations where
    the problem in the v_k takes tens.
    """

    def __init__(self, problem: MPCProblem) -> None:
        from scipy.linalg import solve_triangular
        from scipy.sparse import block_diag, csc_array, diags_array, hstack, identity

        self._length, self._count = problem.length, problem.input_count
        N, states = problem.length, len(problem.drift)
        scale = problem.cost_scale
        free, forced, drifts = _prediction(problem)
        feedback = np.kron(np.eye(N), problem.feedback)
        # v = by_state z_0 + by_choice c + by_drift d: the law sees z_0 … z_{N−1}.
        before = [np.vstack([first, part[:-states]]) for first, part in (
            (np.eye(states), free),
            (np.zeros((states, forced.shape[1])), forced),
            (np.zeros((states, N * states)), drifts),
        )]  # fmt: skip
        by_state, by_choice, by_drift = (-feedback @ part for part in before)
        by_choice += np.eye(len(by_choice))
        weighted = _weigh(problem, forced)
        effort = np.kron(np.eye(N), problem.input_weight) @ by_choice
        hessian = scale * (forced.T @ weighted + by_choice.T @ effort)
        factor = np.linalg.cholesky(0.5 * (hessian + hessian.T))
        # c = unit x, with unitᵀ hessian unit = I.
        unit = solve_triangular(factor, np.eye(len(factor)), lower=True).T
        self._to_inputs = by_choice @ unit
        self._by_state, self._by_drift = by_state, by_drift
        limits = LimitRows(problem)
        self._limits, self._violations = limits, len(limits.price)
        on_choice = limits.on_inputs @ _trimmed(self._to_inputs)
        if problem.rows is not None:
            on_choice = on_choice + limits.on_states @ _trimmed(forced @ unit)
        self.A = csc_array(hstack([on_choice, limits.on_violations]))
        self.P = csc_array(block_diag([identity(len(unit)), diags_array(limits.price)]))
        self._moved_by_state = (
            limits.on_inputs @ by_state + limits.on_states @ free + limits.on_first.toarray()
        )
        self._moved_by_drift = limits.on_inputs @ by_drift + limits.on_states @ drifts
        slope = scale * unit.T
        self._from_reference = -slope @ weighted.T
        self._from_state = slope @ (weighted.T @ free + effort.T @ by_state)
        self._from_drift = slope @ (weighted.T @ drifts + effort.T @ by_drift)
        self._from_input_reference = -slope @ effort.T
        self._drift: FloatArray = np.zeros(0)
        self._by_this_drift = (self._drift, self._drift, self._drift)

    def vectors(
        self, state: FloatArray, data: StageData, previous: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See :meth:`Form.vectors`."""
        slope, motion, _ = self._drifted(data)
        q = self._from_state @ state + self._from_reference @ data.reference.ravel() + slope
        if data.input_reference.any():
            q += self._from_input_reference @ data.input_reference.ravel()
        low, high = self._limits.bounds(previous, data)
        offset = self._moved_by_state @ state + motion
        return np.concatenate([q, self._limits.price]), low - offset, high - offset

    def inputs(self, x: FloatArray, state: FloatArray, data: StageData) -> FloatArray:
        """See :meth:`Form.inputs`."""
        base = self._by_state @ state + self._drifted(data)[2]
        v = self._to_inputs @ x[: self._count] + base
        return np.asarray(v.reshape(self._length, -1))

    def _drifted(self, data: StageData) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what the drift does to q, to the limited rows and to v; kept while it stays."""
        if not np.array_equal(self._drift, data.drift):
            drift = data.drift.ravel()
            self._drift = data.drift.copy()
            self._by_this_drift = (
                self._from_drift @ drift, self._moved_by_drift @ drift, self._by_drift @ drift
            )  # fmt: skip
        return self._by_this_drift

    def shifted(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Form.shifted`."""
        # After the horizon the law is followed as it is.
        N = self._length
        return (
            shifted(x, N, [self._count // N, self._violations // N], repeat=False),
            shifted(y, N, self._limits.widths, repeat=False),
        )


def _prediction(problem: MPCProblem) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return S, G, H of ``Z = S z_0 + G C + H D`` with Z = [z_1; …; z_N] and v = −K z + c."""
    N, (states, inputs) = problem.length, problem.input_matrix.shape
    closed = problem.transition - problem.input_matrix @ problem.feedback
    free = np.zeros((N, states, states))
    forced = np.zeros((N, states, N, inputs))
    drifts = np.zeros((N, states, N, states))
    for k in range(N):
        before = np.eye(states) if k == 0 else free[k - 1]
        free[k] = closed @ before
        if k:
            # What c_j does to z_{k+1} is what c_{j−1} did to z_k.
            forced[k, :, 1:], drifts[k, :, 1:] = forced[k - 1, :, :-1], drifts[k - 1, :, :-1]
        forced[k, :, 0], drifts[k, :, 0] = before @ problem.input_matrix, before
    return (
        free.reshape(N * states, states),
        forced.reshape(N * states, N * inputs),
        drifts.reshape(N * states, N * states),
    )


def _weigh(problem: MPCProblem, forced: FloatArray) -> FloatArray:
    blocks = forced.reshape(problem.length, len(problem.drift), -1)
    weighted = np.einsum("ij,kjm->kim", problem.state_weight, blocks)
    weighted[-1] = problem.terminal_weight @ blocks[-1]
    return np.asarray(weighted.reshape(forced.shape))


def _trimmed(matrix: FloatArray) -> csc_array:
    """Return a block triangular matrix without the round-off above its diagonal blocks."""
    from scipy.sparse import csc_array

    return csc_array(np.where(np.abs(matrix) > 1e-14 * np.abs(matrix).max(), matrix, 0.0))
