"""The finite-horizon problem of MPC, in two forms of the same quadratic program.

Both forms have a pattern that never changes; only vectors do from sample to sample.
Inputs are measured in units of a level, and the cost is scaled so that its least
curvature by such an input is at least one: a residual ε of the solver then means an input
within about ε levels of the optimum, whatever the weights.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from tenscontrol.control.mpc.limit_rows import LimitRows, moved
from tenscontrol.control.mpc.problem import Course, Form, Horizon
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

    def __init__(self, horizon: Horizon) -> None:
        from scipy.linalg import solve_triangular
        from scipy.sparse import block_diag, csc_array, diags_array, hstack, identity

        self._horizon = horizon
        N, states = horizon.length, len(horizon.drift)
        scale = horizon.cost_scale
        free, forced, drifts = _prediction(horizon)
        feedback = np.kron(np.eye(N), horizon.feedback)
        # v = by_state z_0 + by_choice c + by_drift d: the law sees z_0 … z_{N−1}.
        before = [np.vstack([first, part[:-states]]) for first, part in (
            (np.eye(states), free),
            (np.zeros((states, forced.shape[1])), forced),
            (np.zeros((states, N * states)), drifts),
        )]  # fmt: skip
        by_state, by_choice, by_drift = (-feedback @ part for part in before)
        by_choice += np.eye(len(by_choice))
        weighted = _weigh(horizon, forced)
        effort = np.kron(np.eye(N), horizon.input_weight) @ by_choice
        hessian = scale * (forced.T @ weighted + by_choice.T @ effort)
        factor = np.linalg.cholesky(0.5 * (hessian + hessian.T))
        # c = unit x, with unitᵀ hessian unit = I.
        unit = solve_triangular(factor, np.eye(len(factor)), lower=True).T
        self._to_inputs = by_choice @ unit
        self._from_inputs = np.linalg.inv(self._to_inputs)
        self._by_state, self._by_drift = by_state, by_drift
        limits = LimitRows(horizon)
        self._limits, self._violations = limits, len(limits.price)
        on_choice = limits.on_inputs @ _trimmed(self._to_inputs)
        if horizon.rows is not None:
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
        self,
        state: FloatArray,
        reference: FloatArray,
        previous: FloatArray,
        course: Course | None = None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See :meth:`Form.vectors`."""
        course = self._horizon.steady_course if course is None else course
        slope, motion, _ = self._drifted(course)
        q = self._from_state @ state + self._from_reference @ reference.ravel() + slope
        if course.input_reference.any():
            q += self._from_input_reference @ course.input_reference.ravel()
        low, high = self._limits.bounds(previous, course)
        offset = self._moved_by_state @ state + motion
        return np.concatenate([q, self._limits.price]), low - offset, high - offset

    def inputs(self, x: FloatArray, state: FloatArray, course: Course | None = None) -> FloatArray:
        """See :meth:`Form.inputs`."""
        v = self._to_inputs @ x[: self._horizon.input_count] + self._base(state, course)
        return np.asarray(v.reshape(self._horizon.length, -1))

    def unknowns(
        self, plan: FloatArray, state: FloatArray, course: Course | None = None
    ) -> FloatArray:
        """See :meth:`Form.unknowns`."""
        choice = self._from_inputs @ (plan.ravel() - self._base(state, course))
        return np.concatenate([choice, np.zeros(self._violations)])

    def _base(self, state: FloatArray, course: Course | None) -> FloatArray:
        course = self._horizon.steady_course if course is None else course
        return np.asarray(self._by_state @ state + self._drifted(course)[2])

    def _drifted(self, course: Course) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what the drift does to q, to the limited rows and to v; kept while it stays."""
        if not np.array_equal(self._drift, course.drift):
            drift = course.drift.ravel()
            self._drift = course.drift.copy()
            self._by_this_drift = (
                self._from_drift @ drift, self._moved_by_drift @ drift, self._by_drift @ drift
            )  # fmt: skip
        return self._by_this_drift

    def shifted(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Form.shifted`."""
        # After the horizon the law is followed as it is.
        N, count = self._horizon.length, len(self._horizon.low)
        widths = [count, self._violations // N]
        return moved(x, N, widths, repeat=False), moved(y, N, self._limits.widths, repeat=False)


@final
class Sparse(Form):
    """States, inputs and violations are unknown, the dynamics are constraints: large, sparse."""

    def __init__(self, horizon: Horizon) -> None:
        from scipy.sparse import (
            block_diag,
            csc_array,
            diags_array,
            eye,
            hstack,
            identity,
            kron,
            vstack,
        )

        self._horizon = horizon
        N, states = horizon.length, len(horizon.drift)
        scale, level = horizon.cost_scale, horizon.level
        tracking = [scale * horizon.state_weight] * (N - 1) + [scale * horizon.terminal_weight]
        effort = [scale * level**2 * horizon.input_weight] * N
        limits = LimitRows(horizon)
        self._limits, self._violations = limits, len(limits.price)
        squares = [diags_array(limits.price)]
        # Zeros inside the blocks are left out: the pattern is fixed all the same.
        self.P = csc_array(block_diag([csc_array(block) for block in tracking + effort] + squares))
        self._weights = csc_array(block_diag([csc_array(block) for block in tracking]))
        self._efforts = csc_array(block_diag([csc_array(block / level) for block in effort]))
        dynamics = hstack([
            identity(N * states) - kron(eye(N, k=-1), horizon.transition),
            -kron(identity(N), level * horizon.input_matrix),
            csc_array((N * states, self._violations)),
        ])  # fmt: skip
        rows = hstack([limits.on_states, level * limits.on_inputs, limits.on_violations])
        self.A = csc_array(vstack([dynamics, rows]))
        self._state_count = N * states

    def vectors(
        self,
        state: FloatArray,
        reference: FloatArray,
        previous: FloatArray,
        course: Course | None = None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See :meth:`Form.vectors`."""
        horizon = self._horizon
        course = horizon.steady_course if course is None else course
        tracking = -(self._weights @ reference.ravel())
        effort = -(self._efforts @ course.input_reference.ravel())
        q = np.concatenate([tracking, effort, self._limits.price])
        motion = course.drift.ravel().copy()
        motion[: len(state)] += horizon.transition @ state
        low, high = self._limits.bounds(previous, course)
        offset = self._limits.on_first @ state
        return q, np.concatenate([motion, low - offset]), np.concatenate([motion, high - offset])

    def inputs(self, x: FloatArray, state: FloatArray, course: Course | None = None) -> FloatArray:
        """See :meth:`Form.inputs`."""
        inputs = x[self._state_count :][: self._horizon.input_count]
        return self._horizon.level * inputs.reshape(self._horizon.length, -1)

    def unknowns(
        self, plan: FloatArray, state: FloatArray, course: Course | None = None
    ) -> FloatArray:
        """See :meth:`Form.unknowns`."""
        horizon = self._horizon
        course = horizon.steady_course if course is None else course
        states = np.empty((horizon.length, len(state)))
        for k, v in enumerate(plan):
            state = horizon.transition @ state + horizon.input_matrix @ v + course.drift[k]
            states[k] = state
        return np.concatenate(
            [states.ravel(), plan.ravel() / horizon.level, np.zeros(self._violations)]
        )

    def shifted(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Form.shifted`."""
        N, states, count = self._horizon.length, len(self._horizon.drift), len(self._horizon.low)
        widths = [states, count, self._violations // N]
        return (
            moved(x, N, widths, repeat=True),
            moved(y, N, [states, *self._limits.widths], repeat=False),
        )


def _prediction(horizon: Horizon) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return S, G, H of ``Z = S z_0 + G C + H D`` with Z = [z_1; …; z_N] and v = −K z + c."""
    N, (states, inputs) = horizon.length, horizon.input_matrix.shape
    closed = horizon.transition - horizon.input_matrix @ horizon.feedback
    free = np.zeros((N, states, states))
    forced = np.zeros((N, states, N, inputs))
    drifts = np.zeros((N, states, N, states))
    for k in range(N):
        before = np.eye(states) if k == 0 else free[k - 1]
        free[k] = closed @ before
        if k:
            # What c_j does to z_{k+1} is what c_{j−1} did to z_k.
            forced[k, :, 1:], drifts[k, :, 1:] = forced[k - 1, :, :-1], drifts[k - 1, :, :-1]
        forced[k, :, 0], drifts[k, :, 0] = before @ horizon.input_matrix, before
    return (
        free.reshape(N * states, states),
        forced.reshape(N * states, N * inputs),
        drifts.reshape(N * states, N * states),
    )


def _weigh(horizon: Horizon, forced: FloatArray) -> FloatArray:
    blocks = forced.reshape(horizon.length, len(horizon.drift), -1)
    weighted = np.einsum("ij,kjm->kim", horizon.state_weight, blocks)
    weighted[-1] = horizon.terminal_weight @ blocks[-1]
    return np.asarray(weighted.reshape(forced.shape))


def _trimmed(matrix: FloatArray) -> csc_array:
    """Return a block triangular matrix without the round-off above its diagonal blocks."""
    from scipy.sparse import csc_array

    return csc_array(np.where(np.abs(matrix) > 1e-14 * np.abs(matrix).max(), matrix, 0.0))
