"""Weights of quadratic costs."""

from __future__ import annotations

import numpy as np

from tenscontrol.plant import LinearPlant
from tenscontrol.validation import FloatArray, float_array, instance, truth

_TOLERANCE = 1e-12


def weight_matrix(name: str, value: object, size: int, definite: bool) -> FloatArray:
    """Return a symmetric weight matrix, shape (size, size), of a number, a diagonal or a matrix.

    Raises TypeError or ValueError if it does not fit, is not symmetric, or has a negative (where
    ``definite``, also a zero) eigenvalue.
    """
    array = float_array(name, value)
    if array.shape not in ((), (size,), (size, size)):
        raise ValueError(
            f"{name} has shape {array.shape}, expected (), ({size},) or ({size}, {size}): "
            "a number, a diagonal or a matrix"
        )
    matrix = array if array.ndim == 2 else np.diag(np.broadcast_to(array, (size,)))
    largest = float(np.abs(matrix).max(initial=0.0))
    if np.abs(matrix - matrix.T).max(initial=0.0) > _TOLERANCE * largest:
        raise ValueError(f"{name} is not symmetric")
    least = float(np.linalg.eigvalsh(matrix).min()) if size else 0.0
    if least < -_TOLERANCE * largest or (definite and least <= 0):
        wanted = "positive" if definite else "at least 0"
        raise ValueError(f"{name} has the eigenvalue {least:.3g}, expected {wanted}")
    return np.array(matrix)


def energy_weights(plant: LinearPlant, by_mode: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return weights that make displacement, speed and input commensurate.

    With ω the highest frequency of the plant (1 rad/s if all are zero) and b
    the largest acceleration that a unit input gives: ω² for displacements and
    1 for rates, so that a free vibration costs the same at any moment, and
    b²/ω² for inputs: the cost of the displacement at which a constant input balances.

    Parameters
    ----------
    plant : LinearPlant
    by_mode : bool
        Whether each displacement costs its own energy, ``qᵀ K q`` with K the
        stiffness (unstable parts by absolute value), in place of ω² for all. If
        frequencies lie far apart, as with stiff strings of held rest length, ω² for all
        makes soft motions as fast as the stiffest one, which slackens the strings.

    Returns
    -------
    Q : ndarray, shape (2r, 2r)
    R : ndarray, shape (α, α)

    Raises
    ------
    TypeError
        If ``plant`` is not a linear plant, or ``by_mode`` is not a truth value.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> Q, R = tc.energy_weights(plant)
    >>> round(float(Q[0, 0]), 1), float(Q[9, 9]), round(float(R[0, 0]), 3)
    (235.7, 1.0, 0.048)
    """
    instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    r = plant.degrees_of_freedom
    highest = float(np.abs(np.linalg.eigvals(plant.A)).max(initial=0.0)) or 1.0
    largest = float(np.linalg.norm(plant.B, 2))
    Q = np.diag(np.r_[np.full(r, highest**2), np.ones(r)])
    if truth("by_mode", by_mode, "whether each displacement costs its own energy"):
        sizes, modes = np.linalg.eigh(-0.5 * (plant.A[r:, :r] + plant.A[r:, :r].T))
        stiffness = (modes * np.abs(sizes)) @ modes.T
        Q[:r, :r] = 0.5 * (stiffness + stiffness.T)
    return Q, np.eye(plant.B.shape[1]) * (largest / highest) ** 2
