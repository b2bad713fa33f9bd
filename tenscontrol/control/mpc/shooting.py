"""The motion of a plant over the samples of a horizon, with derivatives: RK4 and Radau IIA."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, final

import casadi as ca
import numpy as np

from tenscontrol.control.disturbance import solve_stacked
from tenscontrol.control.mpc.problem import Pair, StageJacobians, Triple, applied
from tenscontrol.dynamics import Evaluator, built, compiled
from tenscontrol.plant import (
    LinearPlant,
    acceleration_response,
    explicit_substeps,
    linked_accelerations,
    model_input,
    reduced_acceleration,
    reduced_motion,
    sampled_dynamics,
    sampled_motion,
    string_forces,
)
from tenscontrol.validation import FloatArray

# Radau IIA with three stages: Hairer & Wanner, Solving Ordinary Differential Equations II, IV.5.
_ROOT = 6**0.5
_NODES = np.array([(4 - _ROOT) / 10, (4 + _ROOT) / 10, 1.0])
_MATRIX = np.array([
    [(88 - 7 * _ROOT) / 360, (296 - 169 * _ROOT) / 1800, (-2 + 3 * _ROOT) / 225],
    [(296 + 169 * _ROOT) / 1800, (88 + 7 * _ROOT) / 360, (-2 - 3 * _ROOT) / 225],
    [(16 - _ROOT) / 36, (16 + _ROOT) / 36, 1 / 9],
])  # fmt: skip

# Up to so many coordinates a sample of one step is faster written out in machine code.
_MOST_WRITTEN = 12

# A single step is solved when the next one of Newton's method moves no coordinate by more than
# this part of the size of the structure.
_SOLVED = 1e-12
_MOST_ROUNDS = 20

# Then no equation is off by more than this, as accelerations that move places in a sample.
_BALANCED = 1e-9


def stage_jacobians(evaluator: Evaluator, *arguments: FloatArray) -> StageJacobians:
    """Return N values of ``(x, y, …) -> (value, slopes …)`` to first order, rows of arguments."""
    N = len(arguments[0])
    # One sample is a vector to an evaluator, several are columns.
    values, *slopes = evaluator(*(x.T if N > 1 else x[0] for x in arguments))
    offset = values.reshape(-1, N, order="F").T.copy()
    blocks = []
    for slope, argument in zip(slopes, arguments, strict=True):
        by_columns = slope.ravel(order="K").reshape(N, argument.shape[1], -1)
        offset -= applied(by_columns, argument)
        blocks.append(by_columns)
    return StageJacobians(offset, tuple(blocks))


def executable(function: ca.Function, machine_code: bool) -> tuple[ca.Function, str]:
    """Return a function, compiled where that is wished and can be, and what evaluates it."""
    code = compiled(function) if machine_code else None
    return (function, "virtual machine") if code is None else (code.function, "machine code")


class AccelerationSlopes:
    """q̈ of a plant and its derivatives, at a number of points at once.

    Of the maps from what the basis displaces to shapes with exact bar lengths, on to forces, and on
    to accelerations of nodes, each has a sparse Jacobian: its code grows with the members, and is
    that of one point. Only the products with the basis are dense.
    """

    def __init__(self, plant: LinearPlant, count: int, *, taut: bool, machine_code: bool) -> None:
        linked, patterns = linked_accelerations(plant, taut=taut)
        one, self.back_end = plant.prepared.get(
            ("accelerations", taut, machine_code), lambda: executable(linked, machine_code)
        )
        self._evaluate = Evaluator(one.map(count) if count > 1 else one)
        rows = plant.model.structure.free_rows
        identity = np.eye(plant.nodes.size)
        self._project = np.ascontiguousarray(plant.coordinates.project(identity)[:, rows].T)
        self._basis = np.ascontiguousarray(plant.basis.T)
        self._places, self._count = plant.nodes.ravel(order="F"), count
        # All points are multiplied at once; the first Jacobians by the same matrix.
        self._jacobians = [
            _transposed(pattern, count, apart)
            for pattern, apart in zip(patterns, (0, 1, 1), strict=True)
        ]

    def __call__(self, states: FloatArray, inputs: FloatArray) -> tuple[FloatArray, ...]:
        """Return q̈, (K, r), and its slopes by columns: by z, (K, 2r, r), and by u, (K, α, r)."""
        (r, m), K = self._basis.shape, self._count
        places, rates = (part @ self._basis for part in (states[:, :r], states[:, r:]))
        given = places + self._places, rates, inputs
        moved, *entries = self._evaluate(*(part.T if K > 1 else part[0] for part in given))
        for jacobian, values in zip(self._jacobians, entries, strict=True):
            jacobian.data = values.ravel(order="K")
        by_bodies, by_strings, by_lengths = self._jacobians
        whole = (by_bodies @ self._project).reshape(K, 3 * m, r)  # by N, Ṅ and F
        by_forces = by_strings @ whole[:, 2 * m :].reshape(K * m, r)
        by_forces = by_forces.reshape(K, -1, r)  # by N, Ṅ and u
        by_forces[:, : 2 * m] += whole[:, : 2 * m]
        by_places = by_lengths @ by_forces[:, : 2 * m].reshape(K * 2 * m, r)
        by_z = self._basis @ by_places.reshape(K, 2, m, r)
        value = moved.reshape(K, -1) if K == 1 else moved.T
        return value @ self._project, by_z.reshape(K, 2 * r, r), by_forces[:, 2 * m :]


def _transposed(pattern: ca.Sparsity, count: int, apart: int) -> Any:
    """Return transposed Jacobians of a number of points in a column, or ``apart`` on a diagonal."""
    from scipy.sparse import csr_array

    starts, rows = (np.array(part, np.int32) for part in (pattern.colind(), pattern.row()))
    points = np.arange(count, dtype=np.int32)[:, None]
    indices = (rows + apart * pattern.size1() * points).ravel()
    indptr = np.append(starts[:-1] + len(rows) * points, count * len(rows)).astype(np.int32)
    shape = count * pattern.size2(), pattern.size1() * (count if apart else 1)
    return csr_array((np.zeros(len(indices)), indices, indptr), shape=shape)


class RowSlopes:
    """Limited rows and their derivatives along a plan, of :func:`linked_rows`."""

    def __init__(
        self,
        plant: LinearPlant,
        linked: ca.Function,
        patterns: tuple[ca.Sparsity, ...],
        length: int,
    ) -> None:
        self._evaluate = Evaluator(linked.map(length) if length > 1 else linked)
        self._places = plant.nodes.ravel(order="F")
        self._basis = np.where(np.abs(plant.basis.T) > 1e-14, plant.basis.T, 0.0)
        # By places and rates at the start, by the input, by places and rates at the end.
        self._jacobians = [_transposed(pattern, length, 0) for pattern in patterns]
        self._rows, self._length = patterns[0].size2(), length

    @property
    def patterns(self) -> tuple[FloatArray, ...]:
        """Ones where a derivative by z, u and z⁺ can be other than zero, shape (p, ·) each."""
        for jacobian in self._jacobians:
            jacobian.data = np.ones(len(jacobian.indices))
        by_n, by_rates, by_u, by_later, by_faster = (
            jacobian[: self._rows].toarray() for jacobian in self._jacobians
        )
        reached = np.abs(self._basis).T > 0
        found = (
            np.hstack([by_n @ reached, by_rates @ reached]),
            by_u,
            np.hstack([by_later @ reached, by_faster @ reached]),
        )
        return tuple((part > 0).astype(float) for part in found)

    def __call__(self, states: FloatArray, inputs: FloatArray, later: FloatArray) -> StageJacobians:
        """Return rows to first order in z_k, u_k and z_{k+1}."""
        (r, _), N, p = self._basis.shape, self._length, self._rows
        given = []
        for z in (states, later):
            given += [z[:, :r] @ self._basis + self._places, z[:, r:] @ self._basis]
        given.insert(2, inputs)
        values, *entries = self._evaluate(*(x.T if N > 1 else x[0] for x in given))
        for jacobian, data in zip(self._jacobians, entries, strict=True):
            jacobian.data = data.ravel(order="K")
        by_u = self._jacobians[2].toarray().reshape(N, p, -1).swapaxes(1, 2)
        slopes = [np.zeros((N, 2 * r, p)), np.ascontiguousarray(by_u), np.zeros((N, 2 * r, p))]
        for i, (at, half) in zip((0, 1, 3, 4), ((0, 0), (0, r), (2, 0), (2, r)), strict=True):
            jacobian = self._jacobians[i]
            if jacobian.nnz:
                by_q = (jacobian @ self._basis.T).reshape(N, p, r)
                slopes[at][:, half : half + r] = by_q.swapaxes(1, 2)
        offset = values.reshape(-1, N, order="F").T.copy()
        for slope, argument in zip(slopes, (states, inputs, later), strict=True):
            offset -= applied(slope, argument)
        return StageJacobians(offset, tuple(slopes))


class Discretization(ABC):
    """What a sample does to the state: for one sample, and to first order for N of a plan at once.

    A plan may have more than states and inputs: the accelerations at the stages of implicit
    steps, shape (N, stages, r). Explicit steps have none. What is built of CasADi is kept with the
    plant, and each discretization evaluates it in memory of its own.
    """

    back_end: str  # "machine code" or "virtual machine"
    ramp: bool  # whether the input moves through a sample, so that the one before matters too

    @property
    @abstractmethod
    def sampled(self) -> ca.Function:
        """``(z, u) -> z⁺``, or ``(z, u_before, u) -> z⁺`` where inputs are ramps."""

    @abstractmethod
    def advance(self, state: FloatArray, previous: FloatArray, held: FloatArray) -> Pair:
        """Return the state a sample later, and the stages; NaN where a step has no solution."""

    @abstractmethod
    def predict(
        self, state: FloatArray, previous: FloatArray, held: FloatArray, load: FloatArray
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return z⁺ under a load, shape (r,), and ∂z⁺/∂load; None where the plant's is taken."""

    @abstractmethod
    def linearize(
        self, states: FloatArray, inputs: FloatArray, stages: FloatArray
    ) -> StageJacobians:
        """Return z_{k+1} to first order in z_k, u_k and, for ramps, u_{k−1}, along a plan."""

    @abstractmethod
    def load_response(self, load: FloatArray) -> FloatArray:
        """Return what constant accelerations do to z_{k+1} linearized last, (s,) or (N, s)."""

    @abstractmethod
    def corrected(self, stages: FloatArray, changes: Pair, load: FloatArray | None) -> FloatArray:
        """Return the stages linearized last, corrected to first order for changes and a load."""


@final
class RK4(Discretization):
    """RK4 in steps that resolve the fastest vibration; inputs jump at the starts of samples."""

    ramp = False

    def __init__(
        self, plant: LinearPlant, sample_time: float, length: int, machine_code: bool
    ) -> None:
        self._sampled = sampled_motion(plant, sample_time)
        self._count = explicit_substeps(plant, sample_time)
        self._plant, self._sample_time = plant, sample_time
        self._step, self._r = sample_time / self._count, plant.degrees_of_freedom
        self._written: Evaluator | None = None
        if machine_code and self._count == 1 and self._r <= _MOST_WRITTEN:
            key = "RK4", sample_time
            one, self.back_end = plant.prepared.get(key, lambda: executable(self.linearized, True))
            self._written = Evaluator(one.map(length))
        else:
            self._slopes = AccelerationSlopes(plant, length, taut=False, machine_code=machine_code)
            self.back_end = self._slopes.back_end
        self._advance = Evaluator(self._sampled)
        self._response = acceleration_response(plant, sample_time)
        self._no_stages = np.zeros((0, plant.degrees_of_freedom))

    @property
    def linearized(self) -> ca.Function:
        """``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)``, dense, for C code."""
        return sampled_dynamics(self._plant, self._sample_time)[1]

    @property
    def sampled(self) -> ca.Function:
        """See :attr:`Discretization.sampled`."""
        return self._sampled

    def advance(self, state: FloatArray, previous: FloatArray, held: FloatArray) -> Pair:
        """See :meth:`Discretization.advance`."""
        return self._advance(state, held)[0].copy(), self._no_stages

    def predict(
        self, state: FloatArray, previous: FloatArray, held: FloatArray, load: FloatArray
    ) -> tuple[FloatArray, None]:
        """See :meth:`Discretization.predict`."""
        return self._response @ load + self._advance(state, held)[0], None

    def linearize(
        self, states: FloatArray, inputs: FloatArray, stages: FloatArray
    ) -> StageJacobians:
        """See :meth:`Discretization.linearize`."""
        held = inputs[1:]
        if self._written is not None:
            return stage_jacobians(self._written, states, held)
        (N, s), r, h = states.shape, self._r, self._step
        q, v = states[:, :r], states[:, r:]
        # Derivatives of places and speeds by z and u, by columns: at first of z by itself.
        start = np.broadcast_to(np.eye(s + held.shape[1], s), (N, s + held.shape[1], s))
        places, speeds = start[:, :, :r], start[:, :, r:]
        weights = list(zip((1.0, 2.0, 2.0, 1.0), (0.0, 0.5 * h, 0.5 * h, h), strict=True))
        for step in range(self._count):
            end_q, end_v, end_places, end_speeds = (x.copy() for x in (q, v, places, speeds))
            rate, slope, rates, slopes = v, np.zeros_like(v), speeds, np.zeros_like(speeds)
            for weight, ahead in weights:
                there = places + ahead * rates
                at, rate, rates = q + ahead * rate, v + ahead * slope, speeds + ahead * slopes
                slope, by_z, by_u = self._slopes(np.hstack([at, rate]), held)
                if step == 0 and not ahead:
                    slopes = np.concatenate([by_z, by_u], axis=1)
                else:
                    slopes = np.concatenate([there, rates], axis=2) @ by_z
                    slopes[:, s:] += by_u
                end_q += h / 6 * weight * rate
                end_v += h / 6 * weight * slope
                end_places += h / 6 * weight * rates
                end_speeds += h / 6 * weight * slopes
            q, v, places, speeds = end_q, end_v, end_places, end_speeds
        by_all = np.concatenate([places, speeds], axis=2)
        parts = by_all[:, :s], by_all[:, s:]
        offset = np.hstack([q, v]) - applied(parts[0], states) - applied(parts[1], held)
        return StageJacobians(offset, parts)

    def load_response(self, load: FloatArray) -> FloatArray:
        """See :meth:`Discretization.load_response`."""
        return np.asarray(self._response @ load)

    def corrected(self, stages: FloatArray, changes: Pair, load: FloatArray | None) -> FloatArray:
        """See :meth:`Discretization.corrected`: there is nothing to correct."""
        return stages


@final
class RadauIIA(Discretization):
    """One step of Radau IIA with three stages: of order 5, and stable however stiff strings are.

    With K_i the accelerations at the stages, at times c_i h of the sample,

        V_i = v + h Σ A_ij K_j,   Q_i = q + c_i h v + h² Σ (A²)_ij K_j,   K_i = a(Q_i, V_i, u_i)

    and the last stage is the end. Along a plan K is lifted: each program takes one Newton step on
    the equations of the stages along with the linearization, and states, inputs and K converge
    together (Quirynen, Gros, Houska & Diehl 2017, Lifted collocation integrators for direct
    optimal control in ACADO toolkit). Vibrations too fast for a sample die out in it.

    Strings push where they would be slack, as in the linear plant; limits on γ keep them from
    it. With forces that end where a string goes slack, Newton's method fails from 0.1 mm off
    already where strings have 1e6 N/m.

    The stages of a ramp see ``u_i = u_before + c_i (u − u_before)``.
    """

    def __init__(
        self, plant: LinearPlant, sample_time: float, length: int, ramp: bool, machine_code: bool
    ) -> None:
        self._along, self._once = (
            AccelerationSlopes(plant, count, taut=True, machine_code=machine_code)
            for count in (3 * length, 3)
        )
        self.back_end = self._along.back_end
        self._taut = Evaluator(plant.prepared.get("taut", lambda: _taut_force_density(plant)))
        self.ramp, self._plant = ramp, plant
        self._sample_time, self._r = sample_time, plant.degrees_of_freedom
        self._share = _NODES[:, None] if self.ramp else np.ones((3, 1))
        # What the accelerations at the stages do to places and speeds there.
        self._to_place, self._to_speed = sample_time**2 * _MATRIX @ _MATRIX, sample_time * _MATRIX
        self._size = float(np.ptp(plant.nodes, axis=1).max())
        # What they do to the end, as columns of M⁻ᵀ of the equations M K = … are combined.
        self._to_end = np.stack([self._to_place[2], self._to_speed[2]])
        # Of the plan linearized last: M⁻ᵀ, the equations' left, and slopes of q̈ by z and u.
        self._linear: tuple[FloatArray, ...] = ()
        self._by_load: FloatArray = np.zeros((0, self._r, 0))

    @built
    def sampled(self) -> ca.Function:
        """See :attr:`Discretization.sampled`: CasADi's Newton method, no number where it fails."""
        key = "Radau IIA sampled", self._sample_time, self.ramp
        return self._plant.prepared.get(key, self._build_sampled)

    def _build_sampled(self) -> ca.Function:
        acceleration = reduced_acceleration(self._plant, taut=True)
        r, h = self._r, self._sample_time
        names = ("z", "before", "u") if self.ramp else ("z", "u")
        sizes = [acceleration.size1_in(0 if name == "z" else 1) for name in names]
        known = [ca.SX.sym(name, size) for name, size in zip(names, sizes, strict=True)]
        # Unknown are the accelerations times h², as they move places.
        z, before, u, moves = known[0], known[-2], known[-1], ca.SX.sym("moves", r, 3)
        speeds = ca.repmat(z[r:], 1, 3) + ca.mtimes(moves, self._to_speed.T / h**2)
        places = ca.repmat(z[:r], 1, 3) + ca.mtimes(z[r:], h * _NODES[None])
        points = ca.vertcat(places + ca.mtimes(moves, self._to_place.T / h**2), speeds)
        inputs = ca.repmat(u, 1, 3)
        if self.ramp:
            inputs = before + ca.mtimes(u - before, self._share.T)
        left = moves - h**2 * acceleration(points, inputs)
        equations = {"x": ca.vec(moves), "p": ca.vertcat(*known), "g": ca.vec(left)}
        options = {"abstol": 0.0, "abstolStep": _SOLVED * self._size, "max_iter": _MOST_ROUNDS}
        solver = ca.rootfinder("stages", "newton", equations, options)
        unknown = [equations["x"], equations["p"]]
        # CasADi hands on what its method leaves, whether or not it solves the equations.
        worst = ca.sqrt(ca.sumsqr(equations["g"]))
        valid = ca.if_else(worst <= _BALANCED * self._size, points[:, 2], np.nan)
        end = ca.Function("end", unknown, [valid])
        given = [ca.MX.sym(name, size) for name, size in zip(names, sizes, strict=True)]
        whole = ca.vertcat(*given)
        return ca.Function("sampled", given, [end(solver(0, whole), whole)], [*names], ["end"])

    def advance(self, state: FloatArray, previous: FloatArray, held: FloatArray) -> Pair:
        """See :meth:`Discretization.advance`."""
        return self._single(state, previous, held, np.zeros(self._r))[:2]

    def predict(
        self, state: FloatArray, previous: FloatArray, held: FloatArray, load: FloatArray
    ) -> Pair:
        """See :meth:`Discretization.predict`: no number where strings go slack."""
        r = self._r
        end, _, system = self._single(state, previous, held, load)
        for z, u in ((state, previous), (end, held)):
            if not self._taut(z, u)[0].min() >= 0:
                end = np.full_like(end, np.nan)
        inverse = solve_stacked(system, np.eye(3 * r)[None])
        return end, self._at_end(inverse).sum(axis=1)[0].T

    def _single(
        self, state: FloatArray, previous: FloatArray, held: FloatArray, load: FloatArray
    ) -> Triple:
        """Return end, stages and (∂G/∂K)ᵀ of a step; no numbers where Newton's method fails."""
        states, inputs = state[None], np.array([previous, held])
        stages = np.zeros((1, 3, self._r))
        for _ in range(_MOST_ROUNDS):
            system, left = self._equations(self._once, states, inputs, stages)[:2]
            change = solve_stacked(system.swapaxes(1, 2), (np.tile(load, 3) - left)[..., None])
            change = change.reshape(stages.shape)
            stages = stages + change
            if np.abs(self._to_place @ change).max() <= _SOLVED * self._size:
                return self._ends(states, stages)[0], stages[0], system
        stages = np.full_like(stages, np.nan)
        return self._ends(states, stages)[0], stages[0], system

    def linearize(
        self, states: FloatArray, inputs: FloatArray, stages: FloatArray
    ) -> StageJacobians:
        """See :meth:`Discretization.linearize`."""
        (N, s), r, h = states.shape, self._r, self._sample_time
        system, left, by_z, by_u = self._equations(self._along, states, inputs, stages)
        inverse = solve_stacked(system, np.broadcast_to(np.eye(3 * r), system.shape))
        to_end = self._at_end(inverse)
        self._linear = inverse, left, by_z, by_u
        self._by_load = to_end.sum(axis=1)
        by_points, by_inputs = by_z @ to_end, by_u @ to_end
        by_state = by_points.sum(axis=1)
        by_state[:, r:] += np.tensordot(by_points[:, :, :r], h * _NODES, (1, 0))
        by_state[:, np.arange(s), np.arange(s)] += 1.0
        by_state[:, np.arange(r, s), np.arange(r)] += h
        share = self._share[:, :, None]
        slopes = [by_state, (share * by_inputs).sum(axis=1)]
        if self.ramp:
            slopes.append(((1 - share) * by_inputs).sum(axis=1))
        offset = self._ends(states, stages) - applied(to_end.reshape(N, 3 * r, s), left)
        for slope, argument in zip(slopes, (states, inputs[1:], inputs[:-1]), strict=False):
            offset -= applied(slope, argument)
        return StageJacobians(offset, tuple(slopes))

    def _at_end(self, inverse: FloatArray) -> FloatArray:
        """Return what right-hand sides of each stage do to z⁺, by columns, (N, 3, r, 2r)."""
        N, r = len(inverse), self._r
        found = self._to_end @ inverse.reshape(N, 3 * r, 3, r)
        return np.asarray(found.reshape(N, 3, r, 2 * r))

    def load_response(self, load: FloatArray) -> FloatArray:
        """See :meth:`Discretization.load_response`."""
        return np.asarray(load @ self._by_load)

    def corrected(self, stages: FloatArray, changes: Pair, load: FloatArray | None) -> FloatArray:
        """See :meth:`Discretization.corrected`."""
        inverse, left, by_z, by_u = self._linear
        states, inputs = changes
        points = np.repeat(states[:, None], 3, axis=1)
        points[:, :, : self._r] += self._sample_time * _NODES[:, None] * states[:, None, self._r :]
        at_stages = inputs[:-1, None] + self._share * np.diff(inputs, axis=0)[:, None]
        sides = (points[:, :, None] @ by_z + at_stages[:, :, None] @ by_u)[:, :, 0]
        sides -= left.reshape(sides.shape)
        if load is not None:
            sides += load
        return stages + applied(inverse, sides.reshape(left.shape)).reshape(stages.shape)

    def _ends(self, states: FloatArray, stages: FloatArray) -> FloatArray:
        """Return the states at the ends of samples, shape (N, s)."""
        q, v = states[:, : self._r], states[:, self._r :]
        return np.hstack([
            q + self._sample_time * v + self._to_place[2] @ stages, v + self._to_speed[2] @ stages
        ])  # fmt: skip

    def _equations(
        self, slopes: AccelerationSlopes, states: FloatArray, inputs: FloatArray, stages: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Return (∂G/∂K)ᵀ, (N, 3r, 3r), G, (N, 3r), and the slopes of a at the stages by columns.

        The equations are solved where G = K − a is 0.
        """
        N, r = len(states), self._r
        q, v = states[:, None, :r], states[:, None, r:]
        speeds = v + self._to_speed @ stages
        places = q + self._sample_time * _NODES[:, None] * v + self._to_place @ stages
        at_stages = inputs[:-1, None] + self._share * np.diff(inputs, axis=0)[:, None]
        points = np.concatenate([places, speeds], axis=2).reshape(3 * N, -1)
        values, by_z, by_u = slopes(points, at_stages.reshape(3 * N, -1))
        by_z, by_u = by_z.reshape(N, 3, 2 * r, r), by_u.reshape(N, 3, -1, r)
        # Unknown [j, row] by equation [i, column].
        by_q, by_v = (part.swapaxes(1, 2)[:, None] for part in (by_z[:, :, :r], by_z[:, :, r:]))
        system = by_q * -self._to_place.T[:, None, :, None]
        system -= by_v * self._to_speed.T[:, None, :, None]
        system = system.reshape(N, 3 * r, 3 * r)
        system[:, np.arange(3 * r), np.arange(3 * r)] += 1.0
        return system, (stages - values.reshape(N, 3, r)).reshape(N, 3 * r), by_z, by_u


def _taut_force_density(plant: LinearPlant) -> ca.Function:
    """Return ``(z, u) -> γ``, negative where a string is slack."""
    z, u = ca.SX.sym("z", plant.B.shape[0]), ca.SX.sym("u", plant.B.shape[1])
    motion = reduced_motion(plant, z)
    gamma = string_forces(plant, plant.input, *motion, model_input(plant, u))[0]
    return ca.Function("taut", [z, u], [ca.densify(gamma)])
