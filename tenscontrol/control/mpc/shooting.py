"""The motion of a plant over the samples of a horizon, with derivatives: RK4 and Radau IIA."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, TypeAlias, final

import casadi as ca
import numpy as np

from tenscontrol.arrays import BoolArray, FloatArray, IntArray
from tenscontrol.control.mpc.core_motion import CoreMotion, core_motion
from tenscontrol.control.mpc.problem import (
    Pair,
    StageJacobians,
    Triple,
)
from tenscontrol.dynamics.evaluator import Evaluator, Function, builds, built
from tenscontrol.dynamics.machine_code import compiled, if_compiled
from tenscontrol.plant.linear_plant import LinearPlant, acceleration_response
from tenscontrol.plant.reduced_dynamics import (
    linked_accelerations,
    possible_substeps,
    reduced_acceleration,
    reduced_motion,
    sampled_dynamics,
    sampled_motion,
)
from tenscontrol.plant.string_outputs import model_input, string_forces

# Radau IIA with three stages: Hairer & Wanner, Solving Ordinary Differential Equations II, IV.5.
_ROOT = 6**0.5
_NODES = np.array([(4 - _ROOT) / 10, (4 + _ROOT) / 10, 1.0])
_MATRIX = np.array([
    [(88 - 7 * _ROOT) / 360, (296 - 169 * _ROOT) / 1800, (-2 + 3 * _ROOT) / 225],
    [(296 + 169 * _ROOT) / 1800, (88 + 7 * _ROOT) / 360, (-2 - 3 * _ROOT) / 225],
    [(16 - _ROOT) / 36, (16 + _ROOT) / 36, 1 / 9],
])  # fmt: skip

# Points are differentiated in parts with so many numbers in the largest of their matrices, which
# then stay in the cache of a processor, and in memory that was used before.
_IN_CACHE = 60_000

# A single step is solved when the next one of Newton's method moves no coordinate by more than
# this part of the size of the structure.
_SOLVED = 1e-12
_MOST_ROUNDS = 20

# The same where a plan begins: the first program takes a Newton step on the stages of all samples.
_BEGUN = 1e-6

# Derivatives from elsewhere are kept while each round moves by less than this part of the last;
# else the method begins again from no stages, with its own.
_QUICK = 0.1

# Then no equation is off by more than this, as accelerations that move places in a sample.
_BALANCED = 1e-9


@builds
def repeated(function: ca.Function, count: int) -> ca.Function:
    """Return a function of so many columns."""
    return function.map(count) if count > 1 else function


def executable(function: ca.Function, machine_code: bool) -> tuple[ca.Function, str]:
    """Return a function, compiled where that is wished and can be, and what evaluates it."""
    code = if_compiled(lambda: compiled(function)) if machine_code else None
    return (function, "virtual machine") if code is None else (code, "machine code")


def accelerations(
    plant: LinearPlant, count: int, *, taut: bool, machine_code: bool
) -> Accelerations:
    """Return q̈ and its derivatives at a number of points, by the core where that has them."""
    core = core_motion(plant, taut=taut)
    return core or AccelerationSlopes(plant, count, taut=taut, machine_code=machine_code)


class AccelerationSlopes:
    """q̈ of a plant and its derivatives, at a number of points at once, by CasADi.

    Of the maps from what the basis displaces to shapes with exact bar lengths, on to forces, and on
    to accelerations of nodes, each has a sparse Jacobian: its code grows with the members, and is
    that of one point. Only the products with the basis are dense.
    """

    def __init__(self, plant: LinearPlant, count: int, *, taut: bool, machine_code: bool) -> None:
        linked, patterns = linked_accelerations(plant, taut=taut)
        one, self.back_end = plant.prepared.get(
            ("accelerations", taut, machine_code), lambda: executable(linked, machine_code)
        )
        self._evaluate = Evaluator(repeated(one, count))
        rows = plant.model.structure.free_rows
        identity = np.eye(plant.nodes.size)
        self._project = np.ascontiguousarray(plant.coordinates.project(identity)[:, rows].T)
        self._basis = np.ascontiguousarray(plant.basis.T)
        self._places, self._count = plant.nodes.ravel(order="F"), count
        self._patterns = patterns
        # Of as many points as are differentiated together.
        self._jacobians: dict[int, list[Any]] = {}

    def values(self, states: FloatArray, inputs: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Return q̈, (K, r), and entries of Jacobians, (K, ·) each, which the next call changes."""
        r, K = len(self._basis), self._count
        places, rates = (half @ self._basis for half in (states[:, :r], states[:, r:]))
        given = places + self._places, rates, inputs
        moved, *entries = (
            array.ravel(order="K").reshape(K, array.size // K)
            for array in self._evaluate(*(array.T if K > 1 else array[0] for array in given))
        )
        return moved @ self._project, entries

    def slopes(self, entries: list[FloatArray], points: IntArray) -> Pair:
        """Return slopes of q̈ at k of the points, by columns: by z, (k, 2r, r), and u, (k, α, r)."""
        (r, m), k = self._basis.shape, len(points)
        if k not in self._jacobians:
            # All points are multiplied at once; the first Jacobians by the same matrix.
            self._jacobians[k] = [
                transposed_jacobians(pattern, k, apart)
                for pattern, apart in zip(self._patterns, (0, 1, 1), strict=True)
            ]
        for jacobian, values in zip(self._jacobians[k], entries, strict=True):
            jacobian.data = values[points].ravel()
        by_bodies, by_strings, by_lengths = self._jacobians[k]
        whole = (by_bodies @ self._project).reshape(k, 3 * m, r)  # by N, Ṅ and F
        by_forces = by_strings @ whole[:, 2 * m :].reshape(k * m, r)
        by_forces = by_forces.reshape(k, -1, r)  # by N, Ṅ and u
        by_forces[:, : 2 * m] += whole[:, : 2 * m]
        by_places = by_lengths @ by_forces[:, : 2 * m].reshape(k * 2 * m, r)
        by_z = self._basis @ by_places.reshape(k, 2, m, r)
        return by_z.reshape(k, 2 * r, r), by_forces[:, 2 * m :]

    def __call__(self, states: FloatArray, inputs: FloatArray) -> Triple:
        """Return q̈ and its slopes at all points."""
        values, entries = self.values(states, inputs)
        return values, *self.slopes(entries, np.arange(self._count))


Accelerations: TypeAlias = CoreMotion | AccelerationSlopes


def transposed_jacobians(pattern: ca.Sparsity, count: int, apart: int) -> Any:
    """Return transposed Jacobians of a number of points in a column, or ``apart`` on a diagonal."""
    from scipy.sparse import csr_array

    starts, rows = (np.array(indices, np.int32) for indices in (pattern.colind(), pattern.row()))
    points = np.arange(count, dtype=np.int32)[:, None]
    indices = (rows + apart * pattern.size1() * points).ravel()
    indptr = np.append(starts[:-1] + len(rows) * points, count * len(rows)).astype(np.int32)
    shape = count * pattern.size2(), pattern.size1() * (count if apart else 1)
    return csr_array((np.zeros(len(indices)), indices, indptr), shape=shape)


def by_slot(slots: IntArray) -> Iterator[tuple[int, IntArray]]:
    """Yield each slot with the samples that have it."""
    for slot in np.unique(slots).tolist():
        yield slot, np.flatnonzero(slots == slot)


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
    def advance(
        self, state: FloatArray, previous: FloatArray, held: FloatArray,
        stages: FloatArray | None = None, planned: bool = True,
    ) -> Pair:  # fmt: skip
        """Return the state a sample later, and the stages; NaN where a step has no solution.

        Stages are sought from none, or from others, (stages, r): those of the last sample of the
        plan, or else, to begin a plan, of the call before. Those are found less exactly.
        """

    @abstractmethod
    def predict(
        self, state: FloatArray, previous: FloatArray, held: FloatArray, load: FloatArray
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return z⁺ under a load, shape (r,), and ∂z⁺/∂load; None where the plant's is taken."""

    @abstractmethod
    def linearize(
        self, states: FloatArray, inputs: FloatArray, stages: FloatArray,
        slots: IntArray | None = None, fresh: BoolArray | None = None,
    ) -> StageJacobians:  # fmt: skip
        """Return z_{k+1} to first order in z_k, u_k and, for ramps, u_{k−1}, along a plan.

        Slopes of each sample are in its slot, (N,) of 0 … N − 1, which samples may share. Those of
        ``fresh`` samples, (N,), are found; of the others they are what was found before. By default
        each sample has a slot of its own, and all are fresh.
        """

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
        self._count = possible_substeps(plant, sample_time)
        self._plant, self._sample_time = plant, sample_time
        h = self._step = sample_time / self._count
        self._r = plant.degrees_of_freedom
        # Of the stages of a step: weight, and how far ahead, s.
        self._weights = [(1.0, 0.0), (2.0, 0.5 * h), (2.0, 0.5 * h), (1.0, h)]
        self._slopes = accelerations(plant, length, taut=False, machine_code=machine_code)
        self.back_end = self._slopes.back_end
        s, a = plant.B.shape
        self._by_all = np.zeros((length, s, s)), np.zeros((length, a, s))
        if isinstance(self._slopes, AccelerationSlopes):
            together = self._together = min(length, max(1, _IN_CACHE // (s * (s + a))))
            self._chain = np.empty((3, together, s, s + a))
            self._half_chain = np.empty((2, together, s // 2, s + a))
            self._advance = Evaluator(self.sampled)
        self._response = acceleration_response(plant, sample_time)
        self._no_stages = np.zeros((0, plant.degrees_of_freedom))

    @property
    def linearized(self) -> ca.Function:
        """``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)``, dense, for C code."""
        return sampled_dynamics(self._plant, self._sample_time)[1]

    @property
    def sampled(self) -> ca.Function:
        """See :attr:`Discretization.sampled`."""
        return sampled_motion(self._plant, self._sample_time)

    def advance(
        self, state: FloatArray, previous: FloatArray, held: FloatArray,
        stages: FloatArray | None = None, planned: bool = True,
    ) -> Pair:  # fmt: skip
        """See :meth:`Discretization.advance`."""
        if isinstance(self._slopes, CoreMotion):
            end = self._slopes.samples(state[None], held[None], self._count, self._step)
            return end[0], self._no_stages
        return self._advance(state, held)[0].copy(), self._no_stages

    def predict(
        self, state: FloatArray, previous: FloatArray, held: FloatArray, load: FloatArray
    ) -> tuple[FloatArray, None]:
        """See :meth:`Discretization.predict`."""
        return self._response @ load + self.advance(state, previous, held)[0], None

    def linearize(
        self, states: FloatArray, inputs: FloatArray, stages: FloatArray,
        slots: IntArray | None = None, fresh: BoolArray | None = None,
    ) -> StageJacobians:  # fmt: skip
        """See :meth:`Discretization.linearize`."""
        held = inputs[1:]
        slots = np.arange(len(states)) if slots is None else slots
        fresh = np.ones(len(states), bool) if fresh is None else fresh
        samples = np.flatnonzero(fresh)
        if isinstance(self._slopes, CoreMotion):
            end = self._linearized_in_core(self._slopes, states, held, slots, samples)
        else:
            end = self._linearized_by_stages(self._slopes, states, held, slots, samples)
        return StageJacobians(end, self._by_all, slots, fresh)

    def _linearized_in_core(
        self, core: CoreMotion, states: FloatArray, held: FloatArray, slots: IntArray,
        samples: IntArray,
    ) -> FloatArray:  # fmt: skip
        """Return ends of all samples, and put slopes of some into their slots."""
        steps = self._count, self._step
        if np.array_equal(slots[samples], np.arange(len(states))):
            return core.samples(states, held, *steps, self._by_all)
        by_z, by_u = (np.empty((len(samples), *slopes.shape[1:])) for slopes in self._by_all)
        core.samples(states[samples], held[samples], *steps, (by_z, by_u))
        self._by_all[0][slots[samples]], self._by_all[1][slots[samples]] = by_z, by_u
        return core.samples(states, held, *steps)

    def _linearized_by_stages(
        self, slopes: AccelerationSlopes, states: FloatArray, held: FloatArray, slots: IntArray,
        samples: IntArray,
    ) -> FloatArray:  # fmt: skip
        """Return ends of all samples, and put slopes of some into their slots."""
        r, h, s = self._r, self._step, states.shape[1]
        end, entries = states, []
        for _ in range(self._count):
            z, slope = end, np.zeros_like(end)
            for weight, ahead in self._weights:
                stage = z + ahead * slope
                values, by_stage = slopes.values(stage, held)
                entries.append([slope[samples] for slope in by_stage])
                slope = np.hstack([stage[:, r:], values])
                end = end + h / 6 * weight * slope
        for first in range(0, len(samples), self._together):
            points = np.arange(first, min(first + self._together, len(samples)))
            by_all = self._chained(slopes, entries, points).swapaxes(1, 2)
            filled = slots[samples[points]]
            self._by_all[0][filled], self._by_all[1][filled] = by_all[:, :s], by_all[:, s:]
        return end

    def _chained(
        self, slopes: AccelerationSlopes, entries: list[list[FloatArray]], points: IntArray
    ) -> FloatArray:
        """Return derivatives of z⁺ by z and u, by rows, from entries at stages of all steps.

        They are in memory that the next call takes. Of a stage, those of places are the first rows,
        whose slopes are those of speeds; ``slope`` are those of accelerations.
        """
        r, h, stages, which = self._r, self._step, iter(entries), slice(len(points))
        start, stage, end = (array[which] for array in self._chain)
        slope, move = (array[which] for array in self._half_chain)
        end[:] = np.eye(*end.shape[1:])
        for _ in range(self._count):
            start[:] = stage[:] = end
            for weight, ahead in self._weights:
                if ahead:
                    np.multiply(stage[:, r:], ahead, out=stage[:, :r])
                    np.multiply(slope, ahead, out=stage[:, r:])
                    stage += start
                by_z, by_u = slopes.slopes(next(stages), points)
                np.matmul(by_z.swapaxes(1, 2), stage, out=slope)
                slope[:, :, 2 * r :] += by_u.swapaxes(1, 2)
                for rows, rate in ((end[:, :r], stage[:, r:]), (end[:, r:], slope)):
                    rows += np.multiply(rate, h / 6 * weight, out=move)
        return np.asarray(end)

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
            accelerations(plant, count, taut=True, machine_code=machine_code)
            for count in (3 * length, 3)
        )
        self._together = max(1, _IN_CACHE // (9 * plant.basis.size))
        self.back_end = self._along.back_end
        self._taut = Evaluator(plant.prepared.get("taut", lambda: _taut_force_density(plant)))
        self.ramp, self._plant = ramp, plant
        self._sample_time, self._r = sample_time, plant.degrees_of_freedom
        self._share = _NODES[:, None] if self.ramp else np.ones((3, 1))
        # What the accelerations at the stages do to places and speeds there.
        self._to_place, self._to_speed = sample_time**2 * _MATRIX @ _MATRIX, sample_time * _MATRIX
        self._size = float(np.ptp(plant.nodes, axis=1).max())
        # Places and speeds at the stages by those at the start and by these accelerations.
        to_stages = np.zeros((3, 2, 5))
        to_stages[:, 0, 0] = to_stages[:, 1, 1] = 1.0
        to_stages[:, 0, 1] = sample_time * _NODES
        to_stages[:, 0, 2:], to_stages[:, 1, 2:] = self._to_place, self._to_speed
        self._to_stages = to_stages.reshape(6, 5)
        # What they do to the end, by columns.
        to_end = np.stack([self._to_place[2], self._to_speed[2]], axis=1)
        to_end = np.kron(to_end, np.eye(self._r))
        s, a = plant.B.shape
        self._plan = _StageEquations(length, s, a, to_end)
        self._single = _StageEquations(1, s, a, to_end)
        self._slopes = [np.zeros((length, k, s)) for k in ((s, a, a) if ramp else (s, a))]
        self._slots = np.arange(length)  # of the plan linearized last

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
        end = Function("end", unknown, [valid])
        given = [ca.MX.sym(name, size) for name, size in zip(names, sizes, strict=True)]
        whole = ca.vertcat(*given)
        return Function("sampled", given, [end(solver(0, whole), whole)], [*names], ["end"])

    def advance(
        self, state: FloatArray, previous: FloatArray, held: FloatArray,
        stages: FloatArray | None = None, planned: bool = True,
    ) -> Pair:  # fmt: skip
        """See :meth:`Discretization.advance`."""
        near = (self._plan, int(self._slots[-1])) if planned else (self._single, 0)
        solved = _SOLVED if planned else _BEGUN
        return self._step(state, previous, held, np.zeros(self._r), stages, near, solved)

    def predict(
        self, state: FloatArray, previous: FloatArray, held: FloatArray, load: FloatArray
    ) -> Pair:
        """See :meth:`Discretization.predict`: no number where strings go slack."""
        end, _ = self._step(state, previous, held, load)
        for z, u in ((state, previous), (end, held)):
            if not self._taut(z, u)[0].min() >= 0:
                end = np.full_like(end, np.nan)
        self._single.find_ends(0)
        by_stages = self._single.to_end[0].reshape(-1, 3, self._r)
        return end, by_stages.sum(axis=1)

    def _step(
        self, state: FloatArray, previous: FloatArray, held: FloatArray, load: FloatArray,
        stages: FloatArray | None = None, near: tuple[_StageEquations, int] | None = None,
        solved: float = _SOLVED,
    ) -> Pair:  # fmt: skip
        """Return end and stages of a step; no numbers where Newton's method fails.

        From stages that are given, the derivatives of equations in a slot near them may do, and
        where less is to be solved the first ones.
        """
        states, inputs = state[None], np.array([previous, held])
        iterate = np.zeros((1, 3, self._r)) if stages is None else stages[None]
        equations, slot = near or (self._single, 0)
        quick, moved, keep = stages is not None, np.inf, solved > _SOLVED
        at_stages = np.tile(load, 3)
        for _ in range(_MOST_ROUNDS):
            left, entries = self._left(self._once, states, inputs, iterate)
            if not quick:
                equations, slot = self._single, 0
                self._differentiate(self._once, entries, np.arange(1), equations, np.arange(1))
            change = equations.solved(slot, at_stages - left[0]).reshape(iterate.shape)
            last, moved = moved, np.abs(self._to_place @ change).max()
            if quick and not moved < max(_QUICK * last, solved * self._size):
                quick, keep, iterate = False, False, np.zeros_like(iterate)
                continue
            iterate, quick = iterate + change, quick or keep
            if moved <= solved * self._size:
                return self._ends(states, iterate)[0], iterate[0]
        iterate = np.full_like(iterate, np.nan)
        return self._ends(states, iterate)[0], iterate[0]

    def linearize(
        self, states: FloatArray, inputs: FloatArray, stages: FloatArray,
        slots: IntArray | None = None, fresh: BoolArray | None = None,
    ) -> StageJacobians:  # fmt: skip
        """See :meth:`Discretization.linearize`."""
        r, h, plan = self._r, self._sample_time, self._plan
        slots = self._slots = np.arange(len(states)) if slots is None else slots
        fresh = np.ones(len(states), bool) if fresh is None else fresh
        self._remaining, entries = self._left(self._along, states, inputs, stages)
        filled = slots[fresh]
        self._differentiate(self._along, entries, np.flatnonzero(fresh), plan, filled)
        share = self._share[None, :, :]
        for slot in filled.tolist():
            plan.find_ends(slot)
            by_stages, by_input = plan.to_end[slot].T, plan.by_input[slot]
            np.matmul(plan.by_state[slot], by_stages, out=self._slopes[0][slot])
            np.matmul((share * by_input).reshape(-1, 3 * r), by_stages, out=self._slopes[1][slot])
            if self.ramp:
                by_before = ((1 - share) * by_input).reshape(-1, 3 * r)
                np.matmul(by_before, by_stages, out=self._slopes[2][slot])
            places = np.arange(r)
            for half, row, size in ((0, 0, 1.0), (0, r, h), (r, r, 1.0)):
                self._slopes[0][slot, row + places, half + places] += size
        ends = self._ends(states, stages)
        for slot, mine in by_slot(slots):
            ends[mine] -= self._remaining[mine] @ plan.to_end[slot].T
        return StageJacobians(ends, tuple(self._slopes), slots, fresh)

    def load_response(self, load: FloatArray) -> FloatArray:
        """See :meth:`Discretization.load_response`."""
        by_stages = self._plan.to_end.reshape(-1, 2 * self._r, 3, self._r)
        return np.asarray((load @ by_stages.sum(axis=2).swapaxes(1, 2))[self._slots])

    def corrected(self, stages: FloatArray, changes: Pair, load: FloatArray | None) -> FloatArray:
        """See :meth:`Discretization.corrected`."""
        (states, inputs), plan = changes, self._plan
        at_stages = inputs[:-1] + self._share[:, None] * np.diff(inputs, axis=0)  # (3, N, α)
        sides, moves = -self._remaining, np.empty_like(self._remaining)
        if load is not None:
            sides += np.tile(load, 3)
        for slot, mine in by_slot(self._slots):
            by_input = at_stages[:, mine] @ plan.by_input[slot].swapaxes(0, 1)
            side = sides[mine] + states[mine] @ plan.by_state[slot]
            side += by_input.swapaxes(0, 1).reshape(side.shape)
            moves[mine] = plan.solved(slot, side.T).T
        return stages + moves.reshape(stages.shape)

    def _ends(self, states: FloatArray, stages: FloatArray) -> FloatArray:
        """Return the states at the ends of samples, shape (N, s)."""
        return self._points(self._to_stages[4:], states, stages)

    def _points(self, by_all: FloatArray, states: FloatArray, stages: FloatArray) -> FloatArray:
        """Return states at stages of N samples, one row each."""
        N, r = len(states), self._r
        start = np.concatenate([states.reshape(N, 2, r), stages], axis=1)
        return np.asarray((by_all @ start).reshape(-1, 2 * r))

    def _left(
        self, slopes: Accelerations, states: FloatArray, inputs: FloatArray, stages: FloatArray
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Return G = K − a, (N, 3r), 0 where the stages are solved, and entries of Jacobians."""
        N, r = stages.shape[0], self._r
        points = self._points(self._to_stages, states, stages)
        if self.ramp:
            moves = self._share * (inputs[1:] - inputs[:-1])[:, None]
            at_stages = (inputs[:-1, None] + moves).reshape(3 * N, -1)
        else:
            at_stages = inputs[1:].repeat(3, axis=0)
        values, entries = slopes.values(points, at_stages)
        return stages.reshape(N, 3 * r) - values.reshape(N, 3 * r), entries

    def _differentiate(
        self, slopes: Accelerations, entries: list[FloatArray], samples: IntArray,
        equations: _StageEquations, slots: IntArray,
    ) -> None:  # fmt: skip
        """Put the derivatives of samples into slots of the equations, and factorize them."""
        r, together = self._r, self._together
        for first in range(0, len(samples), together):
            block = slots[first : first + together]
            points = 3 * samples[first : first + together, None] + np.arange(3)
            by_z, by_u = slopes.slopes(entries, points.ravel())
            by_z = by_z.reshape(len(block), 3, 2 * r, r)
            # Unknown [j, row] by equation [i, column].
            by_q, by_v = by_z[:, :, :r].swapaxes(1, 2), by_z[:, :, r:].swapaxes(1, 2)
            system = by_q[:, None] * -self._to_place.T[:, None, :, None]
            system -= by_v[:, None] * self._to_speed.T[:, None, :, None]
            system = system.reshape(-1, 3 * r, 3 * r)
            system[:, np.arange(3 * r), np.arange(3 * r)] += 1.0
            by_state = equations.by_state.reshape(-1, 2, r, 3, r)
            by_state[block, 0] = by_q
            by_state[block, 1] = by_v + self._sample_time * _NODES[:, None] * by_q
            equations.by_input[block] = by_u.reshape(len(block), 3, -1, r).swapaxes(1, 2)
            for slot, matrix in zip(block.tolist(), system, strict=True):
                equations.factorize(slot, matrix)


class _StageEquations:
    """Equations of the stages to first order, ``dK M = dz Z + du U``, of samples in slots."""

    def __init__(self, count: int, s: int, a: int, to_end: FloatArray) -> None:
        size = 3 * s // 2
        self.by_state = np.zeros((count, s, size))  # Z, by places and speeds at the start
        self.by_input = np.zeros((count, a, 3, s // 2))  # U, of each stage
        self.to_end = np.zeros((count, s, size))  # what right-hand sides do to the end
        self._factors = np.full((count, size, size), np.nan)  # of M, with rows exchanged
        self._rows = np.zeros((count, size), np.intc)
        self._combined = np.asfortranarray(to_end)

    def factorize(self, slot: int, matrix: FloatArray) -> None:
        """Take M, shape (3r, 3r), where unknowns are rows, which is overwritten."""
        from scipy.linalg.lapack import dgetrf

        factors, self._rows[slot], singular = dgetrf(matrix.T, overwrite_a=True)
        self._factors[slot] = np.nan if singular else factors.T

    def solved(self, slot: int, sides: FloatArray) -> FloatArray:
        """Return dK for right-hand sides, a column or several, shape (3r, …)."""
        from scipy.linalg.lapack import dgetrs

        return np.asarray(dgetrs(self._factors[slot].T, self._rows[slot], sides)[0])

    def find_ends(self, slot: int) -> None:
        """Find what right-hand sides do to the end."""
        from scipy.linalg.lapack import dgetrs

        self.to_end[slot] = dgetrs(
            self._factors[slot].T, self._rows[slot], self._combined, trans=1
        )[0].T  # fmt: skip


def _taut_force_density(plant: LinearPlant) -> ca.Function:
    """Return ``(z, u) -> γ``, negative where a string is slack."""
    z, u = ca.SX.sym("z", plant.B.shape[0]), ca.SX.sym("u", plant.B.shape[1])
    motion = reduced_motion(plant, z)
    gamma = string_forces(plant, plant.input, *motion, model_input(plant, u))[0]
    return Function("taut", [z, u], [ca.densify(gamma)])
