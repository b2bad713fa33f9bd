"""The finite-horizon problem of MPC as data.

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

from tenscontrol.validation import FloatArray, IntArray, freeze_arrays

if TYPE_CHECKING:
    from scipy.sparse import csc_array


@dataclass(frozen=True, eq=False)
class Rows:
    """Limited combinations of states and inputs, the same at each sample.

    Attributes
    ----------
    before, after : ndarray, shape (p, s)
        E and F.
    inputs : ndarray, shape (p, α)
        G.
    scale : ndarray, shape (p,)
        Unit of each row inside the program.
    penalty : ndarray, shape (p,)
        π per unit of the row; infinite for a hard limit.
    bounded : tuple of bool
        Whether any row is bounded from below, from above.
    """

    before: FloatArray
    after: FloatArray
    inputs: FloatArray
    scale: FloatArray
    penalty: FloatArray
    bounded: tuple[bool, bool]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def soft(self) -> IntArray:
        """Places of the rows that may be violated at a price."""
        return np.flatnonzero(np.isfinite(self.penalty))


@dataclass(frozen=True, eq=False)
class Course:
    """What changes from sample to sample along the horizon.

    Attributes
    ----------
    drift : ndarray, shape (N, s)
        d_k.
    input_reference : ndarray, shape (N, α)
        s_k.
    low, high : ndarray, shape (N, α)
        Bounds of v_k.
    shift : ndarray, shape (N, α)
        Change of the origin of v since the sample before.
    row_low, row_high : ndarray, shape (N, p)
        Bounds of y_k.
    """

    drift: FloatArray
    input_reference: FloatArray
    low: FloatArray
    high: FloatArray
    shift: FloatArray
    row_low: FloatArray
    row_high: FloatArray


@dataclass(frozen=True, eq=False)
class Ahead:
    """What is known of the horizon before anything is measured at its start.

    Attributes
    ----------
    before : ndarray, shape (α,)
        Input that the reference has before the first sample.
    reference : ndarray, shape (N, s)
        r_1 … r_N, moved to where the plant rests under the estimated load.
    origin : ndarray, shape (N, α)
        Inputs that v_0 … v_{N−1} are measured from.
    course : Course
    """

    before: FloatArray
    reference: FloatArray
    origin: FloatArray
    course: Course


@dataclass(frozen=True, eq=False)
class Horizon:
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

    @property
    def steady_course(self) -> Course:
        """The course on which nothing changes, for a problem without rows."""
        N = self.length
        still = np.zeros((N, len(self.low)))
        return Course(
            drift=np.tile(self.drift, (N, 1)),
            input_reference=still,
            low=np.tile(self.low, (N, 1)),
            high=np.tile(self.high, (N, 1)),
            shift=still,
            row_low=np.zeros((N, 0)),
            row_high=np.zeros((N, 0)),
        )


class Form(ABC):
    """One way to write the problem as ``min ½ xᵀ P x + qᵀ x, l ≤ A x ≤ u``."""

    P: csc_array
    A: csc_array

    @abstractmethod
    def vectors(
        self,
        state: FloatArray,
        reference: FloatArray,
        previous: FloatArray,
        course: Course | None = None,
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
        course : Course, optional
            What changes along the horizon; nothing if not given.
        """

    @abstractmethod
    def inputs(self, x: FloatArray, state: FloatArray, course: Course | None = None) -> FloatArray:
        """Return v_0 … v_{N−1}, shape (N, α), from a solution."""

    @abstractmethod
    def unknowns(
        self, plan: FloatArray, state: FloatArray, course: Course | None = None
    ) -> FloatArray:
        """Return x from v_0 … v_{N−1}, shape (N, α), without violations."""

    @abstractmethod
    def shifted(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a primal and dual solution moved on by one sample, to start the next from."""
