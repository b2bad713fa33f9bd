"""The finite-horizon problem of MPC as data, and the interface of what solves it.

    minimize    Σ (z_k − r_k)ᵀ Q (z_k − r_k) + Σ (v_k − s_k)ᵀ R (v_k − s_k)
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
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.control.status import Status
from tenscontrol.validation import FloatArray, IntArray, freeze_arrays

if TYPE_CHECKING:
    from scipy.sparse import csc_array


@dataclass(frozen=True, eq=False)
class Rows:
    """Limited combinations of states and inputs, the same at each sample.

    Attributes
    ----------
    by_state, by_next_state : ndarray, shape (p, s)
        E and F.
    by_input : ndarray, shape (p, α)
        G.
    scale : ndarray, shape (p,)
        Unit of each row inside the program.
    penalty : ndarray, shape (p,)
        π per unit of the row; infinite for a hard limit.
    bounded : tuple of bool
        Whether any row is bounded from below, from above.
    """

    by_state: FloatArray
    by_next_state: FloatArray
    by_input: FloatArray
    scale: FloatArray
    penalty: FloatArray
    bounded: tuple[bool, bool]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def soft(self) -> IntArray:
        """Indices of the rows that may be violated at a price."""
        return np.flatnonzero(np.isfinite(self.penalty))


@dataclass(frozen=True, eq=False)
class StageData:
    """What changes from stage to stage, known before the state at the first is measured.

    Attributes
    ----------
    reference : ndarray, shape (N, s)
        r_1 … r_N, moved to where the plant rests under an estimated load.
    input_reference : ndarray, shape (N, α)
        s_k.
    drift : ndarray, shape (N, s)
        d_k.
    low, high : ndarray, shape (N, α)
        Bounds of v_k.
    shift : ndarray, shape (N, α)
        Change of the origin of v since the sample before.
    row_low, row_high : ndarray, shape (N, p)
        Bounds of y_k.
    origin : ndarray, shape (N, α)
        Inputs that v_0 … v_{N−1} are measured from.
    previous_origin : ndarray, shape (α,)
        The input that v_{−1} is measured from.
    """

    reference: FloatArray
    input_reference: FloatArray
    drift: FloatArray
    low: FloatArray
    high: FloatArray
    shift: FloatArray
    row_low: FloatArray
    row_high: FloatArray
    origin: FloatArray
    previous_origin: FloatArray


@dataclass(frozen=True, eq=False)
class MPCProblem:
    """Data of the problem that never change.

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
    rows : Rows, optional
        Limits beside those of the inputs.
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
    rows: Rows | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)

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
        self, state: FloatArray, data: StageData, previous: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, l and u.

        Parameters
        ----------
        state : ndarray, shape (s,)
            z_0.
        data : StageData
        previous : ndarray, shape (α,)
            v_{−1}; matters only where the change is limited.
        """

    @abstractmethod
    def inputs(self, x: FloatArray, state: FloatArray, data: StageData) -> FloatArray:
        """Return v_0 … v_{N−1}, shape (N, α), from a solution."""

    @abstractmethod
    def shifted(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a primal and dual solution moved on by one sample, to start the next from."""


@dataclass(frozen=True, eq=False)
class QPSolution:
    """Answer to a quadratic program.

    Attributes
    ----------
    status : Status
    x, y : ndarray or None
        Primal and dual solution; None unless the status is ``OK``.
    iterations : int
    """

    status: Status
    x: FloatArray | None
    y: FloatArray | None
    iterations: int


class QPSolver(ABC):
    """Solver of ``min ½ xᵀ P x + qᵀ x  subject to  l ≤ A x ≤ u`` of one fixed pattern.

    Dual variables y have the sign of ``P x + q + Aᵀ y = 0``: positive at upper bounds.

    Parameters
    ----------
    P : sparse array, shape (k, k)
        Symmetric positive semidefinite; all of it.
    A : sparse array, shape (m, k)
    tolerance : float
        Absolute and relative tolerance of the residuals.
    max_iterations : int
    equations : bool
        Whether many rows of A are equations, and all are in units of their own already.
    """

    @abstractmethod
    def __init__(
        self,
        P: csc_array,
        A: csc_array,
        tolerance: float,
        max_iterations: int,
        *,
        equations: bool = False,
    ) -> None: ...

    @abstractmethod
    def update(self, A: FloatArray) -> None:
        """Put other values into A, in the order of its columns; the pattern stays.

        Parameters
        ----------
        A : ndarray, shape (nonzeros of A,)

        Raises
        ------
        ValueError
            If there are not as many values as A has nonzeros, or one is not finite.
        """

    @abstractmethod
    def solve(
        self,
        q: FloatArray,
        l: FloatArray,  # noqa: E741 - the letters of the problem
        u: FloatArray,
        start: tuple[FloatArray, FloatArray] | None = None,
        deadline: float = np.inf,
    ) -> QPSolution:
        """Solve for new vectors, from the last solution or from a given start.

        Parameters
        ----------
        q : ndarray, shape (k,)
        l, u : ndarray, shape (m,)
            May be infinite.
        start : pair of ndarray, shapes (k,) and (m,), optional
            Primal and dual vectors to start from.
        deadline : float
            When ``perf_counter`` says so, s, the solve is given up: before it
            begins, or at the end of an iteration.

        Returns
        -------
        QPSolution
            Data that are not finite, and bounds that cross, are answered by a status.

        Raises
        ------
        ValueError
            If a vector has the wrong length.
        """

    @abstractmethod
    def reset(self) -> None:
        """Forget the last solution, and all that was adapted to it."""
