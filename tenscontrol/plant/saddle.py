"""Solutions of saddle-point systems: a stiffness, and lengths that are kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.statics.inertia import factorized

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_array

# What is added to the diagonal, where a system of size 1 may be singular.
_SHIFT = 1e-12

# Curvature of the energy below this fraction of the stiffest string's is none.
_FLAT = 1e-9

# Stiffness of bars, parts of the largest stiffness, in whose place rigid ones are.
_RIGID = 1e4

# Part of an eigenvalue at which the search for it ends: of a long structure many are nearly equal.
_CONVERGED = 1e-8


def least_step(system: csc_array, off: FloatArray, count: int, refinements: int = 0) -> FloatArray:
    """Return the least step, shape (m,) or (m, k), that takes away what is off.

    Motions that nothing resists, as one body or of slack strings, make the system singular. It is
    shifted, and applied between two solutions: what it leaves without an answer goes to zero.
    Refinements bring what is soft beside the rest.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    shift = np.full(len(off), -_SHIFT)
    shift[:count] = _SHIFT
    factors = splu((system + diags_array(shift)).tocsc())
    step = factors.solve(system @ factors.solve(off))
    for _ in range(refinements):
        step = step + factors.solve(system @ factors.solve(off - system @ step))
    return np.asarray(step)


def least_curvature(hessian: csc_array, J: csr_array, flat: float) -> tuple[float, FloatArray]:
    """Return the least curvature with lengths kept, N/m, and its direction; 0 below ``flat``.

    It is sought from just below: from where all pivots are positive with stiff bars in place of
    rigid ones.
    """
    from scipy.sparse import block_array, diags_array, eye_array
    from scipy.sparse.linalg import LinearOperator, eigsh, splu

    bars, count = J.shape
    if bars >= count:
        return np.inf, np.zeros(count)
    length = np.sqrt(J.multiply(J).sum(axis=1))
    J = diags_array(1 / np.where(length > 0, length, 1.0)) @ J
    size = float(abs(hessian).max()) or 1.0
    shift = flat = max(flat, _FLAT * size)
    stiffened = (hessian + _RIGID * size * (J.T @ J)).tocsc()
    while factorized((stiffened + shift * eye_array(count)).tocsc()).pivots.min() <= 0:
        shift *= 4.0
    held = [[hessian + shift * eye_array(count), J.T], [J, -_SHIFT * eye_array(bars) / size]]
    factors = splu(block_array(held, format="csc"))

    def inverse(force: FloatArray) -> FloatArray:
        return np.asarray(factors.solve(np.append(force.ravel(), np.zeros(bars)))[:count])

    direction = inverse(np.cos(np.arange(1.0, count + 1) ** 2))  # any
    if count > 1:
        operator = LinearOperator((count, count), matvec=inverse, dtype=float)
        direction = eigsh(operator, 1, which="LA", v0=direction, tol=_CONVERGED)[1][:, 0]
    direction /= np.linalg.norm(direction)
    least = float(direction @ (hessian @ direction))
    return (0.0 if abs(least) <= flat else least), direction
