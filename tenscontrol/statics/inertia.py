"""Sparse symmetric matrices: LDLᵀ factors, inertia (signs of the eigenvalues), null space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.properties import cached_property

if TYPE_CHECKING:
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import SuperLU

# Added to a diagonal of 1, so that no pivot is exactly zero.
_SHIFT = 1e-13

# Pivots below this part of their diagonal entry may be zero: the vectors behind them are looked at.
_DOUBTFUL = 1e-3

# Vectors beside them, which show how near to singular the rest is, and inverse iterations.
_MORE, _ITERATIONS = 2, 3

# Numbers in the vectors of a null space: so many take minutes.
_MOST_ENTRIES = 30_000_000

# A field of displacements whose values at some nodes are this much smaller than elsewhere is not
# held there.
_HELD = 1e-9


@dataclass(frozen=True, eq=False)
class Factors:
    """LDLᵀ of D A D + a tiny shift, D the inverse roots of the diagonal, no pivoting."""

    scale: FloatArray  # (n,), D
    lu: SuperLU
    held: FloatArray  # (n,), what was added to the diagonal of A, parts of it: 1 or 0

    @cached_property
    def pivots(self) -> FloatArray:
        """The diagonal of the factors in the order of the rows of A, parts of its diagonal."""
        return np.asarray(self.lu.U.diagonal()[self.lu.perm_c])

    @cached_property
    def doubtful(self) -> IntArray:
        """Rows whose pivots may be zero."""
        return np.flatnonzero(np.abs(self.pivots) < _DOUBTFUL)

    @property
    def order(self) -> IntArray:
        """Rows in the order of elimination."""
        return np.argsort(self.lu.perm_c)

    @property
    def is_symmetric(self) -> bool:
        """Whether all pivots are on the diagonal."""
        return np.array_equal(self.lu.perm_r, self.lu.perm_c)

    @property
    def is_semidefinite(self) -> bool:
        """Whether no pivot is negative but those that may be zero, nor off the diagonal."""
        return bool(self.is_symmetric and self.pivots.min() > -_DOUBTFUL)


def factorized(matrix: csc_array, held: IntArray | None = None, least: float = 0.0) -> Factors:
    """Return the factors of a symmetric matrix, with a stiffness as its diagonal at ``held`` rows.

    By Sylvester's law, as many pivots are negative as eigenvalues are. A diagonal entry of no more
    than ``least`` counts as none.
    """
    from scipy.sparse import csc_array, diags_array
    from scipy.sparse.linalg import splu

    size = np.abs(matrix.diagonal())
    scale = 1 / np.sqrt(np.where(size > least, size, size.max(initial=0.0) or 1.0))
    scaled = diags_array(scale) @ matrix @ diags_array(scale)
    holding = np.zeros(len(scale))
    if held is not None:
        holding[held] = 1.0
    lu = splu(
        csc_array(scaled + diags_array(_SHIFT + holding)), permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0, options={"SymmetricMode": True},
    )  # fmt: skip
    return Factors(scale, lu, holding)


def held_factors(matrix: csc_array, fields: FloatArray, least: float = 0.0) -> Factors:
    """Return the factors of a symmetric matrix whose null space includes ``fields``, shape (n, k).

    As many rows are held as take the fields away. They are among the last to be eliminated: what
    is eliminated before hangs free, so that a pivot is the stiffness of a place, not of the whole.
    """
    from scipy.linalg import qr

    factors = factorized(matrix, least=least)
    count = fields.shape[1]
    if count == 0:
        return factors
    last = factors.order[::-1]
    size = 4 * count
    while True:
        rows = last[:size]
        near = fields[rows] / np.maximum(np.abs(fields).max(axis=0), np.finfo(float).tiny)
        Q, R, _ = qr(near, mode="economic", pivoting=True)
        sizes = np.abs(np.diagonal(R))
        if len(sizes) == count and sizes[-1] > _HELD * sizes[0]:
            break
        if size >= len(last):
            raise ArithmeticError("the rigid-body motions are not independent")
        size *= 2
    _, _, chosen = qr(Q.T, mode="economic", pivoting=True)
    return factorized(matrix, rows[chosen[:count]], least)


def nearly_null(factors: Factors, more: int = _MORE) -> FloatArray:
    """Return orthonormal vectors, shape (n, ·), whose span has the null space in it.

    One for each doubtful pivot, and some ``more``, by inverse iteration.
    """
    doubtful, n = factors.doubtful, len(factors.pivots)
    count = min(len(doubtful) + more, n)
    if count == 0:
        return np.zeros((n, 0))
    if n * count > _MOST_ENTRIES:
        raise ValueError(
            f"the structure has {n} free coordinates and possibly {len(doubtful)} mechanisms, "
            "which are computed as a dense matrix; expected at most "
            f"{_MOST_ENTRIES // n}. Give it more strings, or fewer members"
        )
    vectors = np.cos(np.outer(np.arange(1.0, n + 1) ** 2, np.arange(1.0, count + 1)))  # any
    vectors[:, : min(len(doubtful), count)] = 0.0
    vectors[doubtful[:count], np.arange(min(len(doubtful), count))] = 1.0
    for _ in range(_ITERATIONS):
        vectors = np.linalg.qr(factors.lu.solve(vectors))[0]
    return np.asarray(np.linalg.qr(factors.scale[:, None] * vectors)[0])
