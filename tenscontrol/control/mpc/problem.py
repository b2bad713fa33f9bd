"""The finite-horizon problem of MPC as data, with the interfaces of its programs.

    minimize    Σ (z_k − r_k)ᵀ Q (z_k − r_k) + Σ (v_k − s_k)ᵀ R (v_k − s_k)
                + Σ 2 (z_k − r_k)ᵀ N (v_k − s_k)
                + (z_N − r_N)ᵀ P (z_N − r_N) + Σ 2 πᵀ (e_k + ½ e_k²)
    subject to  z_{k+1} = Φ z_k + Γ v_k + d_k,   low_k ≤ v_k ≤ high_k,
                |v_k − v_{k−1} + shift_k| ≤ change,
                y_k = E z_k + F z_{k+1} + G v_k,   low_k − e_k ≤ y_k ≤ high_k + e_k,   e_k ≥ 0

Where a penalty π is infinite, the limit is hard: e = 0. A linear penalty above the multipliers of
the hard problem is exact: where the limit can be kept, it is (Kerrigan & Maciejowski 2000). The
square, in units of the row, changes nothing about that, and saves an ADMM solver most of its
iterations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.arrays import BoolArray, FloatArray, IntArray, freeze_arrays, frozen
from tenscontrol.plant.reference import Preview
from tenscontrol.plant.riccati import least_eigenvalue
from tenscontrol.plant.string_outputs import StringMap
from tenscontrol.properties import cached_property
from tenscontrol.status import Status

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Pair = tuple[FloatArray, FloatArray]
Triple = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class Rows:
    """Limited combinations of states and inputs, the same at each sample."""

    by_state: FloatArray  # E, (p, s)
    by_next_state: FloatArray  # F, (p, s)
    by_input: csr_array  # G, (p, α)
    scale: FloatArray  # (p,), unit of each row inside the program
    penalty: FloatArray  # (p,), π per unit of the row; infinite for a hard limit
    bounded: tuple[bool, bool]  # whether any row is bounded from above, from below

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def soft(self) -> IntArray:
        """Indices of the rows that may be violated at a price."""
        return np.flatnonzero(np.isfinite(self.penalty))


@dataclass(frozen=True, eq=False)
class RowBlock:
    """Rows of one kind: their matrices and their bounds."""

    by_state: FloatArray  # (p, s)
    by_next_state: FloatArray  # (p, s)
    by_input: csr_array  # (p, α)
    low: FloatArray  # (p,)
    high: FloatArray
    scale: FloatArray
    penalty: FloatArray
    quantity: str  # of the path, that bounds are measured from; "" for node positions
    offset: FloatArray  # (p,), of node positions: value at the operating point
    on_nodes: FloatArray  # (p, d n), of node positions, or (p, β) of forces of bars: C
    at_rest: tuple[FloatArray, FloatArray, FloatArray] | None = None  # of bars, see `along`

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def along(self, preview: Preview) -> FloatArray:
        """Return the values where a reference rests, shape (K, p), of strings or bars.

        Those of bars follow from the shape and from γ, which is known better than its slopes say.
        """
        if self.at_rest is None:
            return np.asarray(getattr(preview, self.quantity))
        gamma, by_force_density, by_state = self.at_rest
        moved = preview.rest[:, : by_state.shape[1]] @ by_state.T
        return self.offset + (preview.force_density - gamma) @ by_force_density.T + moved

    def at_sample_ends(self, inputs: int) -> RowBlock:
        """Return the rows where ``[z; v_before]`` is the state: ramps reach v at the end."""
        none = np.zeros((len(self.low), inputs))
        by_next_state = np.hstack([self.by_state + self.by_next_state, none])
        return replace(self, by_state=np.zeros_like(by_next_state), by_next_state=by_next_state)


def string_block(
    quantity: str,
    strings: StringMap,
    low: FloatArray,
    high: FloatArray,
    level: float,
    penalty: float,
) -> RowBlock:
    """Return limits on γ or tension at starts of samples, in units of ``level``, the price too."""
    name = "gamma" if quantity == "force_density" else quantity
    by_state, count = getattr(strings, f"{name}_by_state"), len(low)
    return RowBlock(
        by_state=by_state,
        by_next_state=np.zeros_like(by_state),
        by_input=getattr(strings, f"{name}_by_input"),
        low=low,
        high=high,
        scale=np.full(count, level),
        penalty=np.full(count, penalty / level),
        quantity=quantity,
        offset=np.zeros(count),
        on_nodes=np.zeros((count, 0)),
    )


class Constraints:
    """All rows of a problem; their bounds move along a path. States of the plant come first."""

    def __init__(self, blocks: list[RowBlock], states: int) -> None:
        self.blocks, self._states = tuple(blocks), states

    @property
    def key(self) -> tuple[tuple[str, int, bytes], ...]:
        """What the values of the rows depend on, bounds aside."""
        return tuple(
            (block.quantity, len(block.low), block.on_nodes.tobytes()) for block in self.blocks
        )

    def rows(self) -> Rows | None:
        """Return the rows of the program, or None if there are none."""
        from scipy.sparse import csr_array, vstack

        if not self.blocks:
            return None
        low, high = self.limits
        by_input = csr_array(vstack([block.by_input for block in self.blocks]))
        by_input.sort_indices()
        bounded = bool(np.isfinite(high).any()), bool(np.isfinite(low).any())
        return Rows(
            self._joined("by_state"),
            self._joined("by_next_state"),
            by_input,
            self._joined("scale"),
            self._joined("penalty"),
            bounded,
        )

    @property
    def limits(self) -> Pair:
        """Least and largest values of all rows, shape (p,) each."""
        return frozen(self._joined("low")), frozen(self._joined("high"))

    def _joined(self, name: str) -> FloatArray:
        none = [] if self.blocks else [np.zeros(0)]
        return np.concatenate(none + [getattr(block, name) for block in self.blocks])

    def bounds(self, preview: Preview, length: int) -> Pair:
        """Return bounds of the rows, shape (N, p) each, on a path at N samples and their end."""
        low, high = [np.zeros((length, 0))], [np.zeros((length, 0))]
        for block in self.blocks:
            base = np.tile(block.offset, (length, 1))
            if block.quantity:
                # What members have where the path rests, less what the rows make of that rest.
                by_state = (block.by_state + block.by_next_state)[:, : self._states]
                base = block.along(preview)[:length] - preview.rest[:length] @ by_state.T
            low.append(block.low - base)
            high.append(block.high - base)
        return np.hstack(low), np.hstack(high)


@dataclass(frozen=True, eq=False)
class StageData:
    """What changes from stage to stage, known before the state at the first is measured."""

    reference: FloatArray  # r_1 … r_N, (N, s), moved to where the plant rests under a load
    input_reference: FloatArray  # s_k, (N, α)
    drift: FloatArray  # d_k, (N, s)
    low: FloatArray  # bounds of v_k, (N, α)
    high: FloatArray
    shift: FloatArray  # (N, α), change of the origin of v since the sample before
    row_low: FloatArray  # bounds of y_k, (N, p)
    row_high: FloatArray
    origin: FloatArray  # (N, α), inputs that v_0 … v_{N−1} are measured from
    previous_origin: FloatArray  # (α,), the input that v_{−1} is measured from
    first_reference: FloatArray | None = None  # r_0, (s,), for a cross weight; None: zeros


@dataclass(frozen=True, eq=False)
class MPCProblem:
    """Data of the problem that never change."""

    transition: FloatArray  # Φ, (s, s)
    input_matrix: FloatArray  # Γ, (s, α)
    drift: FloatArray  # d, (s,)
    state_weight: FloatArray  # Q, (s, s)
    input_weight: FloatArray  # R, (α, α), or (α,) of a diagonal
    terminal_weight: FloatArray  # P, (s, s)
    low: FloatArray  # bounds of v, (α,)
    high: FloatArray
    change: FloatArray | None  # (α,), largest change of v from sample to sample; None for any
    length: int  # N
    level: float  # unit of v inside the program
    feedback: FloatArray  # K of the LQR with these weights, (α, s)
    rows: Rows | None = None  # limits beside those of the inputs
    cross_weight: FloatArray | None = None  # N, (s, α); None: zeros
    steady: bool = True  # whether P is the cost to go of the LQR with these weights

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @cached_property
    def cost_scale(self) -> float:
        """What the cost is multiplied by."""
        return 1.0 / (self.level**2 * least_eigenvalue(self.input_weight))

    @property
    def input_count(self) -> int:
        """Number of entries of all v together."""
        return int(self.length * self.input_matrix.shape[1])


@dataclass(frozen=True, eq=False)
class StageJacobians:
    """Functions along a plan to first order: their values there, and their slopes.

    Slopes are stored by columns: entry [k, j, i] is the derivative of value i by argument j. Those
    of the motion are by z_k, u_k and, where inputs are ramps, u_{k−1}; those of limited rows by
    z_k, u_k and z_{k+1}. They are views of memory that the next call may overwrite.

    Where there are ``slots``, they say where the slopes of each sample are: several samples may
    have the same, and only slots of ``fresh`` samples are others than in the last call.
    """

    values: FloatArray  # (N, m)
    slopes: tuple[FloatArray, ...]  # (N, columns, m) each
    slots: IntArray | None = None  # (N,); None: sample k has slot k
    fresh: BoolArray | None = None  # (N,); None: all

    def in_order(self) -> StageJacobians:
        """Return the same with slopes in the order of samples."""
        if self.slots is None:
            return self
        return StageJacobians(self.values, tuple(slope[self.slots] for slope in self.slopes))

    def from_zero(self, *arguments: FloatArray) -> StageJacobians:
        """Return the same in order, with values where all of these arguments are zero."""
        same, values = self.in_order(), self.values.copy()
        for slope, argument in zip(same.slopes, arguments, strict=True):
            values -= applied(slope, argument)
        return StageJacobians(values, same.slopes)


def applied(slopes: FloatArray, arguments: FloatArray) -> FloatArray:
    """Return what arguments, shape (K, columns), make of slopes stored by columns."""
    return np.asarray((arguments[:, None, :] @ slopes)[:, 0])


@dataclass(frozen=True, eq=False)
class SubproblemSolution:
    """Status, iterations of the solver, and the improved plan; None unless the status is OK.

    The plan is z_0 … z_N, shape (N + 1, s), and u_{−1} … u_{N−1}, shape (N + 1, α).
    """

    status: Status
    iterations: int
    plan: Pair | None


class Subproblem(ABC):
    """The quadratic program that improves a plan: a step of sequential quadratic programming.

    ``solver_name`` says what solves it.
    """

    solver_name: str

    def reset(self) -> None:
        """Forget the last solution, and all that was adapted to it."""
        self.forget()

    @abstractmethod
    def forget(self) -> None:
        """Forget the last solution."""

    @abstractmethod
    def shift(self) -> None:
        """Move the last solution, which the next one starts from, on by a sample."""

    @abstractmethod
    def linearize(
        self, states: FloatArray, inputs: FloatArray, motion: StageJacobians,
        rows: StageJacobians | None,
    ) -> bool:  # fmt: skip
        """Prepare the program along a plan; return False where data are not finite.

        The plan is that of :class:`SubproblemSolution`; rows are None where none are limited.
        """

    @abstractmethod
    def solve(
        self, state: FloatArray, data: StageData, previous: FloatArray, acting: FloatArray,
        deadline: float,
    ) -> SubproblemSolution:  # fmt: skip
        """Solve the program prepared last for a measured state, shape (s,), once.

        Changes are limited from ``previous``, the motion starts with the input ``acting``, shape
        (α,) each. ``deadline`` is as for :meth:`QPSolver.solve`.
        """


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """Status, iterations of the solver, and the first input, (α,); None unless the status is OK."""

    status: Status
    iterations: int
    input: FloatArray | None


class LinearProgram(ABC):
    """The quadratic program of linear MPC. ``solver_name`` says what solves it."""

    solver_name: str

    @abstractmethod
    def reset(self) -> None:
        """Forget the plan, the last solution, and all that was adapted to it."""

    @abstractmethod
    def forget(self) -> None:
        """Forget the last solution, from which the next solve would start; the plan stays."""

    @property
    @abstractmethod
    def plan(self) -> FloatArray:
        """Inputs that the last solved program planned, shape (N, α); none before the first."""

    @abstractmethod
    def solve(
        self, state: FloatArray, data: StageData, previous: FloatArray, deadline: float
    ) -> LinearSolution:
        """Solve for z_0, from the last solution moved on by a sample.

        Changes are limited from the input ``previous``, shape (α,). ``deadline`` is as for
        :meth:`QPSolver.solve`.
        """
