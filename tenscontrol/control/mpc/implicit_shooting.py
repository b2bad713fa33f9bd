"""Motion by one implicit step a sample, whose stages are found along with the plan."""

from __future__ import annotations

from functools import cached_property
from typing import final

import casadi as ca
import numpy as np

from tenscontrol.control.mpc.shooting import Motion
from tenscontrol.control.mpc.stage_jacobians import Tangents
from tenscontrol.control.solved import solved
from tenscontrol.dynamics import Evaluator
from tenscontrol.plant import (
    LinearPlant,
    acceleration_slopes,
    model_input,
    reduced_acceleration,
    reduced_motion,
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

# A single step is solved when the next one of Newton's method moves no coordinate by more than
# this part of the size of the structure.
_SOLVED = 1e-12
_MOST_ROUNDS = 20

# Then no equation is off by more than this, as accelerations that move places in a sample.
_BALANCED = 1e-9


@final
class ImplicitMotion(Motion):
    """By one step of Radau IIA with three stages: of order 5, and stable however stiff strings are.

    With K_i the accelerations at the stages, at times c_i h of the sample,

        V_i = v + h Σ A_ij K_j,   Q_i = q + c_i h v + h² Σ (A²)_ij K_j,   K_i = a(Q_i, V_i, u_i)

    and the last stage is the end. Along a plan K is lifted: each program takes one Newton step on
    the equations of the stages along with the linearization, and states, inputs and K converge
    together (Quirynen, Gros, Houska & Diehl 2017, Lifted collocation integrators for direct
    optimal control in ACADO toolkit). Vibrations too fast for a sample die out in it.

    Strings push where they would be slack, as in the linear plant; limits on γ keep them from
    it. With forces that end where a string goes slack, Newton's method fails from 0.1 mm off
    already where strings have 1e6 N/m.

    Winches that wind move in p equal parts, the first of them at the start. The stages see the line
    ``u_i = u_before + (c_i + (1 − c_i)/p) (u − u_before)``, which has the mean and the end
    of the parts, and is the jump where p is 1.

    Parameters
    ----------
    plant : LinearPlant
    sample_time : float
        Sample time h, s.
    length : int
        N.
    substeps : int
        p.
    machine_code : bool
        Whether to compile the derivatives where there is a C compiler.
    """

    def __init__(
        self, plant: LinearPlant, sample_time: float, length: int, substeps: int, machine_code: bool
    ) -> None:
        self._acceleration = reduced_acceleration(plant, taut=True)
        slopes = acceleration_slopes(self._acceleration)
        super().__init__(slopes.map(3 * length), machine_code)
        self._once = Evaluator(slopes.map(3))
        z, u = ca.SX.sym("z", plant.B.shape[0]), ca.SX.sym("u", plant.B.shape[1])
        gamma = string_forces(plant, plant.input, *reduced_motion(plant, z), model_input(plant, u))[
            0
        ]
        self._taut = Evaluator(ca.Function("taut", [z, u], [ca.densify(gamma)]))
        self.ramp = substeps > 1
        self._sample_time, self._r = sample_time, plant.degrees_of_freedom
        self._share = (_NODES + (1 - _NODES) / substeps)[:, None]
        # What the accelerations at the stages do to places and speeds there.
        self._to_place, self._to_speed = sample_time**2 * _MATRIX @ _MATRIX, sample_time * _MATRIX
        self._size = float(np.ptp(plant.nodes, axis=1).max())
        # Of the plan linearized last: Newton's step of K, its derivative, and that of z⁺ by a load.
        self._change: FloatArray = np.zeros((0, 3, self._r))
        self._response: FloatArray = np.zeros((0, 3 * self._r, 0))
        self._by_load: FloatArray = np.zeros((0, self._r, 0))

    @cached_property
    def sampled(self) -> ca.Function:
        """See :attr:`Motion.sampled`: by CasADi's Newton method, not a number where it fails."""
        r, h = self._r, self._sample_time
        names = ("z", "before", "u") if self.ramp else ("z", "u")
        sizes = [self._acceleration.size1_in(0 if name == "z" else 1) for name in names]
        known = [ca.SX.sym(name, size) for name, size in zip(names, sizes, strict=True)]
        # Unknown are the accelerations times h², as they move places.
        z, before, u, moves = known[0], known[-2], known[-1], ca.SX.sym("moves", r, 3)
        speeds = ca.repmat(z[r:], 1, 3) + ca.mtimes(moves, self._to_speed.T / h**2)
        places = ca.repmat(z[:r], 1, 3) + ca.mtimes(z[r:], h * _NODES[None])
        points = ca.vertcat(places + ca.mtimes(moves, self._to_place.T / h**2), speeds)
        inputs = ca.repmat(u, 1, 3)
        if self.ramp:
            inputs = before + ca.mtimes(u - before, self._share.T)
        left = moves - h**2 * self._acceleration(points, inputs)
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

    def advance(
        self, state: FloatArray, before: FloatArray, held: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Motion.advance`."""
        return self._single(state, before, held, np.zeros(self._r))[:2]

    def expected(
        self, state: FloatArray, before: FloatArray, held: FloatArray, load: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Motion.expected`: where strings go slack, the prediction says nothing."""
        r = self._r
        end, _, system = self._single(state, before, held, load)
        for motion, acting in ((state, before), (end, held)):
            if not self._taut(motion, acting)[0].min() >= 0:
                end = np.full_like(end, np.nan)
        by_load = solved(system, np.tile(np.eye(r), (3, 1))[None]).reshape(3, r * r)
        push = np.stack([self._to_place[2], self._to_speed[2]]) @ by_load
        return end, push.reshape(2 * r, r)

    def _single(
        self, state: FloatArray, before: FloatArray, held: FloatArray, load: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return end, stages and ∂G/∂K of a step; no numbers where Newton's method fails."""
        states, acting = state[None], np.array([before, held])
        stages = np.zeros((1, 3, self._r))
        for _ in range(_MOST_ROUNDS):
            system, left = self._equations(self._once, states, acting, stages)[:2]
            change = solved(system, (load - left).reshape(1, -1, 1)).reshape(stages.shape)
            stages = stages + change
            if np.abs(self._to_place @ change).max() <= _SOLVED * self._size:
                return self._ends(states, stages)[0], stages[0], system
        stages = np.full_like(stages, np.nan)
        return self._ends(states, stages)[0], stages[0], system

    def tangents(self, states: FloatArray, acting: FloatArray, stages: FloatArray) -> Tangents:
        """See :meth:`Motion.tangents`."""
        (N, s), r, a, h = states.shape, self._r, acting.shape[1], self._sample_time
        system, left, by_q, by_v, by_u = self._equations(self._evaluator, states, acting, stages)
        share = self._share[:, :, None]
        sides = [-left[..., None], by_q, h * _NODES[:, None, None] * by_q + by_v, share * by_u]
        if self.ramp:
            sides.append((1 - share) * by_u)
        sides.append(np.broadcast_to(np.eye(r), (N, 3, r, r)))
        answer = solved(system, np.concatenate(sides, axis=3).reshape(N, 3 * r, -1))
        self._change, self._response = answer[:, :, 0].reshape(N, 3, r), answer[:, :, 1:]
        # By columns: entry [k, j, i], i first the places and then the speeds at the end.
        last = np.stack([self._to_place[2], self._to_speed[2]])
        by_all = np.einsum("tj,njrc->nctr", last, self._response.reshape(N, 3, r, -1))
        by_all = by_all.reshape(N, -1, s)
        by_all[:, np.arange(s), np.arange(s)] += 1.0
        by_all[:, np.arange(r, s), np.arange(r)] += h
        widths = np.cumsum([s, a, a] if self.ramp else [s, a])
        *slopes, self._by_load = np.split(by_all, widths, axis=1)
        offset = self._ends(states, stages + self._change)
        for slope, argument in zip(slopes, (states, acting[1:], acting[:-1]), strict=False):
            offset -= (argument[:, None, :] @ slope)[:, 0]
        return Tangents(offset, tuple(slopes))

    def pushed(self, load: FloatArray) -> FloatArray:
        """See :meth:`Motion.pushed`."""
        return np.asarray(load @ self._by_load)

    def corrected(
        self,
        stages: FloatArray,
        states: FloatArray,
        acting: FloatArray,
        load: FloatArray | None = None,
    ) -> FloatArray:
        """See :meth:`Motion.corrected`."""
        changes = [states, acting[1:], acting[:-1]] if self.ramp else [states, acting[1:]]
        changes.append(np.zeros((len(states), self._r)))
        if load is not None:
            changes[-1][:] = load
        moved = self._response @ np.hstack(changes)[:, :, None]
        return stages + self._change + moved.reshape(stages.shape)

    def _ends(self, states: FloatArray, stages: FloatArray) -> FloatArray:
        """Return the states at the ends of samples, shape (N, s)."""
        q, v = states[:, : self._r], states[:, self._r :]
        return np.hstack([
            q + self._sample_time * v + self._to_place[2] @ stages, v + self._to_speed[2] @ stages
        ])  # fmt: skip

    def _equations(
        self, evaluator: Evaluator, states: FloatArray, acting: FloatArray, stages: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Return ∂G/∂K, G and the derivatives of a, where G = K − a is zero at solved stages.

        Shapes (N, 3r, 3r), (N, 3, r) and (N, 3, r, columns).
        """
        N, r = len(states), self._r
        q, v = states[:, None, :r], states[:, None, r:]
        speeds = v + self._to_speed @ stages
        places = q + self._sample_time * _NODES[:, None] * v + self._to_place @ stages
        inputs = acting[:-1, None] + self._share * np.diff(acting, axis=0)[:, None]
        points = np.concatenate([places, speeds], axis=2).reshape(3 * N, -1)
        values, *slopes = evaluator(points.T, inputs.reshape(3 * N, -1).T)
        left = stages - values.ravel(order="K").reshape(N, 3, r)
        by_q, by_v, by_u = (
            slope.ravel(order="K").reshape(N, 3, -1, r).swapaxes(2, 3) for slope in slopes
        )
        # Equation [i, row] by unknown [j, column].
        system = by_q[:, :, :, None, :] * -self._to_place[:, None, :, None]
        system -= by_v[:, :, :, None, :] * self._to_speed[:, None, :, None]
        system = system.reshape(N, 3 * r, 3 * r)
        system[:, np.arange(3 * r), np.arange(3 * r)] += 1.0
        return system, left, by_q, by_v, by_u
