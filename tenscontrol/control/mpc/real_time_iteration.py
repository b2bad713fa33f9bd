"""Real-time iteration: a plan linearized along itself, moved on and improved by one program."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import BoolArray, FloatArray, IntArray
from tenscontrol.control.disturbance import LoadObserver
from tenscontrol.control.mpc.core_motion import CoreRows, core_rows
from tenscontrol.control.mpc.problem import (
    Constraints,
    MPCProblem,
    Pair,
    Rows,
    StageData,
    StageJacobians,
    Subproblem,
    SubproblemSolution,
)
from tenscontrol.control.mpc.settings import MPCSettings
from tenscontrol.control.mpc.shooting import (
    RK4,
    Discretization,
    RadauIIA,
    accelerations,
    executable,
    repeated,
    transposed_jacobians,
)
from tenscontrol.dynamics.evaluator import Evaluator, Function
from tenscontrol.plant.linear_plant import LinearPlant, state_units
from tenscontrol.plant.reduced_dynamics import (
    exact_motion,
    explicit_substeps,
    near_symbol,
    reduced_acceleration,
    reduced_motion,
    settled,
    with_jacobian,
)
from tenscontrol.plant.string_outputs import model_input, string_forces
from tenscontrol.status import Status

# At a shape that changes its stiffness by a tenth these leave 1e-5 of what was off.
NEWTON_STEPS = 5

# With derivatives of their own the shapes of stiff strings take fewer.
_OWN_STEPS = 2

# Where rest lengths are held, and a sample takes more steps of RK4 than this, one implicit step
# takes their place, at less than half the cost. Where strings are soft, RK4 knows slack ones too.
_MOST_EXPLICIT = 4


class TrajectoryModel:
    """The motion of a plant over N samples, and the values of limited rows, with derivatives.

    Steps are implicit where inputs are ramps or strings are stiff.
    """

    def __init__(
        self,
        plant: LinearPlant,
        settings: MPCSettings,
        constraints: Constraints,
        machine_code: bool,
    ) -> None:
        sample_time, length, winches = settings.sample_time, settings.horizon, settings.winches
        ramp = winches is not None and winches.ramp
        stiff = (
            plant.input == "rest_length" and explicit_substeps(plant, sample_time) > _MOST_EXPLICIT
        )
        self.implicit = stiff or ramp
        self.discretization: Discretization
        if plant.model.contacts is not None:
            _refuse_ramps(winches)
            self.implicit = False  # one step a sample would pass over an impact
        if self.implicit:
            self.discretization = RadauIIA(plant, sample_time, length, ramp, machine_code)
        else:
            self.discretization = RK4(plant, sample_time, length, machine_code)
        self.back_end = self.discretization.back_end
        self._plant, self._sample_time = plant, sample_time
        self._accelerations = accelerations(
            plant, length, taut=self.implicit, machine_code=machine_code
        )
        self._constraints = constraints
        self._rows: CoreRows | RowSlopes | None = None
        at_end = self.discretization.ramp
        if constraints.blocks:
            self._rows = core_rows(plant, constraints.blocks, at_end)
        if constraints.blocks and self._rows is None:

            def build() -> tuple[ca.Function, tuple[ca.Sparsity, ...]]:
                linked, patterns = linked_rows(plant, constraints, at_end)
                return executable(linked, machine_code)[0], patterns

            key = "linked rows", constraints.key, at_end, machine_code
            self._rows = RowSlopes(plant, *plant.prepared.get(key, build), length)

    @property
    def acceleration(self) -> ca.Function:
        """``(z, u) -> q̈``, for C code."""
        return reduced_acceleration(self._plant, taut=self.implicit)

    @property
    def limited(self) -> ca.Function | None:
        """``(z, u, z⁺) -> (y, ∂y/∂z, ∂y/∂u, ∂y/∂z⁺)`` of limited rows, dense, for C code."""
        if not self._constraints.blocks:
            return None
        at_end = self.discretization.ramp

        def build() -> ca.Function:
            rows = limited_rows(self._plant, self._constraints, at_end)
            given = rows.sx_in()
            return Function(rows.name(), given, [ca.densify(output) for output in rows(*given)])

        key = "limited rows", self._constraints.key, at_end
        return self._plant.prepared.get(key, build)

    def units(self, level: float) -> FloatArray:
        """Return units of the state in a program, shape (s,), with ``level`` that of an input.

        Implicit steps do not resolve fast vibrations. Where strings are stiff, one unit is then
        what a level holds, and the speed that moves it in a sample.
        """
        units, size = state_units(self._plant)
        if not self.implicit:
            return units
        held = units[: len(units) // 2] * level / size
        return np.asarray(np.minimum(units, np.concatenate([held, held / self._sample_time])))

    def with_pattern(self, rows: Rows | None) -> Rows | None:
        """Return limited rows with ones where a derivative can be other than zero."""
        from scipy.sparse import csr_array

        if rows is None or self._rows is None:
            return None
        by_state, by_input, by_next_state = self._rows.patterns
        return replace(
            rows, by_state=by_state, by_input=csr_array(by_input), by_next_state=by_next_state
        )

    def at_rest(self, reference: FloatArray, inputs: FloatArray, observer: LoadObserver) -> Pair:
        """Return references (N, s) and inputs (N, α) moved to rest under the estimated load.

        Newton's method on the accelerations of the nonlinear plant, with the derivatives of
        the linear one, or where strings are stiff with their own.
        """
        r = reference.shape[1] // 2
        reference, inputs, still = reference.copy(), inputs.copy(), np.zeros_like(reference[:, :r])
        for _ in range(_OWN_STEPS if self.implicit else NEWTON_STEPS):
            states = np.hstack([reference[:, :r], still])
            values, entries = self._accelerations.values(states, inputs)
            left = values + observer.acceleration
            if self.implicit:
                by_z, by_u = self._accelerations.slopes(entries, np.arange(len(states)))
                by_q, by_u = (slope.swapaxes(1, 2) for slope in (by_z[:, :r], by_u))
                shift, effort = observer.model.rest_of(left, by_q, by_u)
            else:
                shift, effort = observer.model.rest(left)
            reference[:, :r] += shift
            inputs += effort
        return reference, inputs

    def reach(self, level: float) -> FloatArray:
        """Return the moves of a state and inputs that change slopes by their size, (s + α,).

        Ramps have two inputs, (s + 2α,).

        Places move by the size of the structure, or where rest lengths are held by ``level``, of an
        input, as strings then are as much longer.
        """
        plant = self._plant
        r, a = plant.degrees_of_freedom, plant.B.shape[1]
        size = float(np.ptp(plant.nodes, axis=1).max())
        length = min(size, level) if plant.input == "rest_length" else size
        speed = size / self._sample_time
        acting = 2 if self.discretization.ramp else 1
        return np.repeat([length, speed, level], [r, r, acting * a])

    def linearize(
        self, states: FloatArray, inputs: FloatArray, stages: FloatArray,
        slots: IntArray | None = None, fresh: BoolArray | None = None,
    ) -> tuple[StageJacobians, StageJacobians | None]:  # fmt: skip
        """Return the motion along a plan, and the limited rows or None, to first order.

        Slots, and which samples are fresh, are as for :meth:`Discretization.linearize`.
        """
        here, later = np.ascontiguousarray(states[:-1]), np.ascontiguousarray(states[1:])
        motion = self.discretization.linearize(here, inputs, stages, slots, fresh)
        rows = None if self._rows is None else self._rows(here, inputs[1:], later)
        return motion, rows


def _refuse_ramps(winches: Winches | None) -> None:
    """Raise if winches wind through samples: explicit steps have inputs that are held."""
    if winches is not None and winches.ramp:
        raise ValueError(
            "winches ramp through a sample, and NMPC predicts contact with the ground with inputs "
            "that are held over it: leave out ramp and substeps; the rate bounds the changes from "
            "sample to sample"
        )


def limited_rows(plant: LinearPlant, constraints: Constraints, at_end: bool = False) -> ca.Function:
    """Return ``(z, u, z⁺) -> (y, ∂y/∂z, ∂y/∂u, ∂y/∂z⁺)`` of the rows that are limited.

    Force densities are those of strings that pull, and negative beyond, so that a slack string
    still says which way it gets taut. Strings are limited at the start of a sample, or at its end,
    where ramps have brought rest lengths to u.
    """
    s, a = plant.B.shape
    z, u, later = ca.SX.sym("z", s), ca.SX.sym("u", a), ca.SX.sym("later", s)
    near, ahead = near_symbol(plant), near_symbol(plant)
    motion = reduced_motion(plant, later, ahead) if at_end else reduced_motion(plant, z, near)
    y = _row_values(plant, constraints, motion, u, reduced_motion(plant, later, ahead)[0])
    outputs = [y, *(ca.jacobian(y, by) for by in (z, u, later))]
    outputs = settled(plant, later, ahead, settled(plant, z, near, outputs))
    return Function("rows", [z, u, later], ca.cse(outputs))


def linked_rows(
    plant: LinearPlant, constraints: Constraints, at_end: bool
) -> tuple[ca.Function, tuple[ca.Sparsity, ...]]:
    """Return the rows of :func:`limited_rows` and their sparse Jacobians, and patterns of these.

    The function is ``(n, ṅ, u, n⁺, ṅ⁺) -> (y, entries of ∂y/∂n, ∂y/∂ṅ, ∂y/∂u, ∂y/∂n⁺, ∂y/∂ṅ⁺)``
    of what the basis displaces, by rows; patterns are of the transposed.
    """
    m, a = plant.nodes.size, plant.B.shape[1]
    sizes = {"n": m, "rates": m, "u": a, "later": m, "faster": m}
    n, rates, u, later, faster = given = [ca.SX.sym(name, k) for name, k in sizes.items()]
    N, V, L = (ca.SX.sym(name, *plant.nodes.shape) for name in "NVL")
    values = _row_values(plant, constraints, (N, V), u, L)
    end = exact_motion(plant, later, faster)
    motion = end if at_end else exact_motion(plant, n, rates)
    y, by_all = with_jacobian(values, N, V, u, L)(*motion[:2], u, end[0])
    by_motion = ca.mtimes(by_all[:, : 2 * m], motion[2])
    by_end = ca.mtimes(by_all[:, 2 * m + a :], end[2][:m, :])
    none = ca.SX(*by_motion.shape)
    start, end_part = (none, by_motion + by_end) if at_end else (by_motion, by_end)
    by_u = by_all[:, 2 * m : 2 * m + a]
    jacobians = [start[:, :m], start[:, m:], by_u, end_part[:, :m], end_part[:, m:]]
    transposed = [jacobian.T for jacobian in jacobians]
    entries = [ca.densify(jacobian.nz[:]) for jacobian in transposed]
    function = Function("rows", given, ca.cse([y, *entries]))
    return function, tuple(jacobian.sparsity() for jacobian in transposed)


def _row_values(
    plant: LinearPlant, constraints: Constraints, motion: tuple[ca.SX, ca.SX], u: ca.SX, end: ca.SX
) -> ca.SX:
    """Return the limited rows: of strings at a motion, of nodes at the end of a sample."""
    forces = string_forces(plant, plant.input, *motion, model_input(plant, u))
    kinds = {"force_density": forces[0], "tension": forces[1]}
    return ca.vertcat(*(
        kinds[block.quantity] if block.quantity
        else ca.mtimes(ca.sparsify(ca.DM(block.on_nodes)), ca.vec(end))
        for block in constraints.blocks
    ))  # fmt: skip


class RowSlopes:
    """Limited rows and their derivatives along a plan, of :func:`linked_rows`."""

    def __init__(
        self,
        plant: LinearPlant,
        linked: ca.Function,
        patterns: tuple[ca.Sparsity, ...],
        length: int,
    ) -> None:
        self._evaluate = Evaluator(repeated(linked, length))
        self._places = plant.nodes.ravel(order="F")
        self._basis = np.where(np.abs(plant.basis.T) > 1e-14, plant.basis.T, 0.0)
        # By places and rates at the start, by the input, by places and rates at the end.
        self._jacobians = [transposed_jacobians(pattern, length, 0) for pattern in patterns]
        self._rows, self._length = patterns[0].size2(), length
        r, p, by_u = len(self._basis), patterns[0].size2(), self._jacobians[2]
        self._slopes = tuple(np.zeros((length, k, p)) for k in (2 * r, patterns[2].size1(), 2 * r))
        sample, row = np.divmod(np.repeat(np.arange(length * p), np.diff(by_u.indptr)), p)
        self._by_input = sample, by_u.indices, row

    @property
    def patterns(self) -> tuple[FloatArray, ...]:
        """Ones where a derivative by z, u and z⁺ can be other than zero, shape (p, ·) each."""
        for jacobian in self._jacobians:
            jacobian.data = np.ones(len(jacobian.indices))
        by_n, by_rates, by_u, by_later, by_faster = (
            jacobian[: self._rows].toarray() for jacobian in self._jacobians
        )
        reached = np.abs(self._basis).T > 0
        reached_slopes = (
            np.hstack([by_n @ reached, by_rates @ reached]),
            by_u,
            np.hstack([by_later @ reached, by_faster @ reached]),
        )
        return tuple((pattern > 0).astype(float) for pattern in reached_slopes)

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
        self._slopes[1][self._by_input] = self._jacobians[2].data
        for i, (index, half) in zip((0, 1, 3, 4), ((0, 0), (0, r), (2, 0), (2, r)), strict=True):
            jacobian = self._jacobians[i]
            if jacobian.nnz:
                by_q = (jacobian @ self._basis.T).reshape(N, p, r)
                self._slopes[index][:, half : half + r] = by_q.swapaxes(1, 2)
        return StageJacobians(values.reshape(-1, N, order="F").T, self._slopes)


class RealTimeIterate:
    """States z_0 … z_N and inputs u_0 … u_{N−1}, and the program that improves them.

    Accelerations at the stages of implicit steps are part of it, and u_{−1}, which still acts
    where inputs are ramps. ``inputs`` is None before there is a plan; ``linearized`` says whether
    the program is linearized along the plan, and ``fresh`` how many samples were for that.

    Derivatives are in slots, which samples may share. A sample keeps its slot until its state or an
    input has moved, since the slot was filled, by more than a part, the tolerance, of what changes
    derivatives by their size. Then it takes another slot, if one was filled as near to it.
    """

    def __init__(
        self, model: TrajectoryModel, program: Subproblem, problem: MPCProblem, bounds: Pair,
        tolerance: float = 0.0,
    ) -> None:  # fmt: skip
        self._model, self.program, self._problem = model, program, problem
        self._discretization = model.discretization
        self._low, self._high = bounds
        self._tolerance, self._reach = tolerance, model.reach(problem.level)
        self.clear()

    def __getstate__(self) -> dict[str, object]:
        """Pickle the plan; a program prepared in compiled memory is prepared anew."""
        return vars(self) | {"linearized": False, "_at": np.full_like(self._at, np.nan)}

    @property
    def inputs(self) -> FloatArray | None:
        """Planned inputs, shape (N, α); None before there is a plan."""
        return None if self._inputs is None else self._inputs[1:]

    @property
    def next_state(self) -> FloatArray:
        """The planned state a sample ahead, shape (s,)."""
        return np.asarray(self._states[1])

    def clear(self) -> None:
        """Forget the plan."""
        self._states: FloatArray = np.zeros((0, 0))
        self._stages: FloatArray = np.zeros((0, 0, 0))
        self._inputs: FloatArray | None = None  # u_{−1} … u_{N−1}
        self._slots: IntArray = np.arange(self._problem.length)
        # Where slots were filled, in parts of what changes derivatives; NaN: they are empty.
        self._at: FloatArray = np.full((self._problem.length, len(self._reach)), np.nan)
        self.fresh = 0
        self.linearized, self._shifted = False, True
        self.program.forget()

    def reset(self) -> None:
        """Forget the plan, and what the solver adapted to its programs."""
        self.clear()
        self.program.reset()

    def begin(self, state: FloatArray, previous_input: FloatArray, data: StageData) -> None:
        """Plan with the law of the linear plant, kept within bounds, on the nonlinear one.

        Far from its operating point that law may lead stiff strings to where their steps are not
        solved. Then the plan is the reference itself, whose stages the programs find.
        """
        reference, origin = data.reference, data.input_reference
        start, states, inputs = state, [state], [previous_input]
        stages: list[FloatArray] = []
        aims, previous_aim = np.vstack([reference[:1], reference[:-1]]), origin[0]
        for aim, held in zip(aims, origin, strict=True):
            off = states[-1] - aim
            if self._discretization.ramp:
                off, previous_aim = np.concatenate([off, inputs[-1] - previous_aim]), held
            desired_input = held - self._problem.feedback @ off
            inputs.append(np.clip(desired_input, self._low, self._high))
            state, within = self._discretization.advance(
                states[-1], inputs[-2], inputs[-1], stages[-1] if stages else None, planned=False
            )
            states.append(state)
            stages.append(within)
        self._states, self._inputs = np.array(states), np.array(inputs)
        self._stages = np.array(stages)
        if self._stages.size and not np.isfinite(self._states).all():
            self._states = np.vstack([start, reference])
            self._inputs = np.vstack([previous_input, np.clip(origin, self._low, self._high)])
            self._stages = np.zeros_like(self._stages)
        self._shifted, self.linearized = True, False
        self._at[:] = np.nan

    def prepare(self) -> None:
        """Move the plan on where due, and linearize along it where the dynamics have values."""
        self.shift()
        inputs = self._planned()
        fresh = self._choose_slots(inputs)
        self.fresh += int(fresh.sum())
        motion, rows = self._model.linearize(self._states, inputs, self._stages, self._slots, fresh)
        # A plan may lead where the dynamics have no value: there is nothing to prepare then.
        self.linearized = self.program.linearize(self._states, inputs, motion, rows)
        if not self.linearized:
            self._at[:] = np.nan

    def _choose_slots(self, inputs: FloatArray) -> BoolArray:
        """Give samples the slots of their derivatives; return which are to be filled, (N,)."""
        N = len(self._slots)
        if not self._tolerance:
            return np.ones(N, bool)
        before = inputs[:-1] if self._discretization.ramp else inputs[:-1, :0]
        points = np.hstack([self._states[:-1], inputs[1:], before]) / self._reach
        own = np.abs(points - self._at[self._slots]).max(axis=1) <= self._tolerance
        if own.all():
            return np.zeros(N, bool)
        off = np.abs(points[:, None] - self._at).max(axis=2)  # of samples from slots
        off[np.isnan(off)] = np.inf
        self._slots = np.where(own, self._slots, off.argmin(axis=1))
        fresh = np.zeros(N, bool)
        # Samples that are farthest from all slots are linearized first: they may serve others.
        while (far := np.where(own, 0.0, off.min(axis=1))).max() > self._tolerance:
            k = int(far.argmax())
            slot = np.setdiff1d(np.arange(N), self._slots[far <= self._tolerance])[0]
            self._at[slot], off[:, slot] = points[k], np.abs(points - points[k]).max(axis=1)
            self._slots[k], own[k], fresh[k] = slot, True, True
            self._slots[~own] = off[~own].argmin(axis=1)
        return fresh

    def shift(self) -> None:
        """Move the plan on by a sample, once."""
        if self._shifted:
            return
        inputs = self._planned()
        last = np.minimum(np.maximum(inputs[-1], self._low), self._high)
        last_stages = self._stages[-1] if self._stages.size else None
        end, within = self._discretization.advance(self._states[-1], inputs[-1], last, last_stages)
        self._states = np.concatenate([self._states[1:], end[None]])
        self._inputs = np.concatenate([inputs[1:], last[None]])
        if self._stages.size:
            self._stages = np.concatenate([self._stages[1:], within[None]])
        if self._tolerance:
            self._slots = np.append(self._slots[1:], self._slots[-1])
        self.program.shift()
        self._shifted = True

    def iterate(
        self, state: FloatArray, data: StageData, previous: FloatArray,
        previous_input: FloatArray, load: FloatArray | None, deadline: float,
    ) -> tuple[SubproblemSolution, float]:  # fmt: skip
        """Solve the program once; return its answer, and the largest change in units of an input.

        Changes are limited from ``previous``, the motion starts with ``previous_input``, shape
        (α,) each; the load is accelerations, shape (r,). Where the program is not solved, the plan
        stays, unless the dynamics have no value along it.
        """
        planned = self._planned()
        if not self.linearized:
            self.prepare()
        if not self.linearized:
            self.clear()
            return SubproblemSolution(Status.BAD_DATA, 0, None), np.inf
        if load is not None:
            drift = self._discretization.load_response(load)
            data = replace(data, drift=np.broadcast_to(drift, data.drift.shape))
        answer = self.program.solve(state, data, previous, previous_input, deadline)
        self.linearized = False
        if answer.plan is None:
            return answer, np.inf
        states, inputs = answer.plan
        if self._stages.size:
            changes = (states - self._states)[:-1], inputs - planned
            self._stages = self._discretization.corrected(self._stages, changes, load)
        change = float(np.abs(inputs[1:] - planned[1:]).max()) / self._problem.level
        self._states, self._inputs = answer.plan
        return answer, change

    def release(self, solved: bool) -> None:
        """Let the next sample move the plan on; from a new start where a program was not solved."""
        self.linearized, self._shifted = False, False
        if not solved:
            self.program.forget()

    def _planned(self) -> FloatArray:
        assert self._inputs is not None  # callers see to it
        return self._inputs
