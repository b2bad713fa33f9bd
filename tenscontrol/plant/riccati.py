"""Algebraic Riccati equations, solved in scaled units."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.evaluator import on_one_thread
from tenscontrol.plant.controllability import reached_states
from tenscontrol.plant.linear_plant import LinearPlant, spectral_norm, state_units, tall_qr

# A Riccati residual above this fraction of its terms means that the solution is wrong.
_RESIDUAL_TOLERANCE = 1e-6

# States up to which a continuous equation is solved by its pencil: a digit better, and as fast.
_SMALL = 100

# Steps of doubling at most, and the part of the solution by which the last one may change it.
_MOST_DOUBLED, _DOUBLED = 60, 1e-16

# Eigenvalues of a weight this far below zero, relative to its largest entry, are of round-off.
_SEMIDEFINITE = 1e-12

# Input weight, in units of energy_weights, when the user gives none.
_INPUT_WEIGHT = {"force_density": 0.1, "rest_length": 1.0, "bar_length": 1.0, "length": 1.0}


@dataclass(frozen=True)
class _Messages:
    """What is said where a Riccati equation has no good solution, and what to do."""

    equation: str
    loop: str
    no_solution: str
    large_residual: str
    unstable: str


_REGULATOR = _Messages(
    equation="the Riccati equation",
    loop="the closed loop",
    no_solution="Possible reasons: an undamped mode without weight in Q; Q and R that differ by "
    "many powers of ten; a sample_time of many periods",
    large_residual="Bring the weights Q and R closer together",
    unstable="Give every mode some weight in Q",
)
_FILTER = _Messages(
    equation="the Riccati equation of the filter",
    loop="the filter",
    no_solution="Possible reasons: a sample_time at which two vibrations are aliased; "
    "process_noise that is very small against the noise of the sensors",
    large_residual="Bring process_noise and the noise of the sensors closer together",
    unstable="Bring process_noise and the noise of the sensors closer together",
)


def regulator_riccati(
    A: FloatArray,
    B: FloatArray,
    state_weight: FloatArray,
    input_weight: FloatArray,
    unit: FloatArray,
    level: float,
    split: tuple[FloatArray, int] | None = None,
    *,
    discrete: bool,
) -> tuple[FloatArray, np.ndarray, FloatArray, float]:
    """Return gain K, closed-loop poles, cost P and Riccati residual of a regulator, checked.

    Solved with states in units of ``unit``, shape (s,), and inputs in units of ``level``: a stiff
    plant cannot be solved otherwise. Where there is a ``split``, inputs reach the first columns
    alone of an orthonormal basis of states in these units, so many, and the others move by
    themselves: the equation is solved for the first, and the others are fed forward where they
    disturb. An ``input_weight`` of shape (α,) is a diagonal. A ValueError says why there is no good
    solution.
    """
    from scipy.sparse import diags_array

    A = A * unit / unit[:, None]
    B = level * B / unit[:, None]
    Q, R = _symmetric(unit[:, None] * state_weight * unit), level**2 * input_weight
    R = R if R.ndim == 1 else _symmetric(R)
    spread = None
    if B.shape[1] > len(A):  # inputs that move the state alike are one, by its least cost
        is_diagonal = R.ndim == 1
        root = diags_array(R**-0.5) if is_diagonal else np.linalg.inv(np.linalg.cholesky(R)).T
        directions, factor = tall_qr((B @ root).T)
        moved, sizes, Vt = np.linalg.svd(factor.T)
        spread, B, R = root @ (directions @ Vt.T), moved * sizes, np.ones(len(sizes))
    R = np.diag(R) if R.ndim == 1 else R
    K, P, poles, residual = _split_solution(A, B, Q, R, split, discrete, _REGULATOR)
    K = K if spread is None else spread @ K
    return level * K / unit, poles, P / unit[:, None] / unit, residual


def filter_riccati(
    transition: FloatArray,
    drive: FloatArray,
    C: FloatArray,
    noise: FloatArray,
    split: tuple[FloatArray, int] | None = None,
) -> tuple[FloatArray, FloatArray, np.ndarray, float]:
    """Return steady gain, covariance of predictions, poles and residual of a filter, checked.

    Φ is the ``transition`` of a sample, and ``drive`` Ψ, shape (s, m): what independent noises of
    variance 1 add to the state over a sample. ``noise``, shape (p,), are standard deviations of
    the readings. Where there is a ``split``, they see the first columns alone of an orthonormal
    basis, so many, and nothing drives the others. Solved as the dual problem. A ValueError says
    why there is no good solution.
    """
    whitened = C / noise[:, None]
    unit = 1 / float(np.linalg.norm(whitened, 2))
    output, driven = unit * whitened, drive / unit
    eye = np.eye(len(C))
    dual = transition.T, output.T, _symmetric(driven @ driven.T), eye
    _, P, poles, residual = _split_solution(*dual, split, True, _FILTER)
    gain = np.linalg.solve(output @ P @ output.T + eye, output @ P).T
    return frozen(unit * gain / noise), frozen(unit**2 * P), frozen(poles), residual


@on_one_thread
def _split_solution(
    A: FloatArray,
    B: FloatArray,
    Q: FloatArray,
    R: FloatArray,
    split: tuple[FloatArray, int] | None,
    discrete: bool,
    messages: _Messages,
) -> tuple[FloatArray, FloatArray, np.ndarray, float]:
    """Return gain, solution, poles and residual of an equation, checked on what is reached.

    In the basis A is ``[[A11, A12], [0, A22]]`` and B ``[B1; 0]``. P11 and K1 are those of
    (A11, B1); then P12 solves a linear equation and gives K2. P22 is a cost that no input changes:
    the least that leaves P positive semidefinite is taken, since there may be no finite one.
    """
    from scipy import linalg

    if split is None or split[1] == len(A):
        K, P, poles = _solve(A, B, Q, R, discrete, messages)
        residual = riccati_residual(A, B, Q, R, P, discrete=discrete)
        check_riccati(residual, poles, discrete, messages)
        return K, P, poles, residual
    basis, count = split
    first, rest = basis[:, :count], basis[:, count:]
    A11, A12, A22 = first.T @ A @ first, first.T @ A @ rest, rest.T @ A @ rest
    B1, Q12 = first.T @ B, first.T @ Q @ rest
    reached = A11, B1, _symmetric(first.T @ Q @ first), R
    K1, P11, poles = _solve(*reached, discrete, messages)
    residual = riccati_residual(*reached, P11, discrete=discrete)
    check_riccati(residual, poles, discrete, messages)
    closed = A11 - B1 @ K1
    if discrete:
        P12 = _discrete_sylvester(closed.T, A22, Q12 + closed.T @ P11 @ A12)
        K2 = np.linalg.solve(R + B1.T @ P11 @ B1, B1.T @ (P11 @ A12 + P12 @ A22))
    else:
        P12 = linalg.solve_sylvester(closed.T, A22, -(P11 @ A12 + Q12))
        K2 = np.linalg.solve(R, B1.T @ P12)
    P22 = P12.T @ np.linalg.lstsq(P11, P12, rcond=None)[0]
    P = basis @ np.block([[P11, P12], [P12.T, P22]]) @ basis.T
    poles = np.r_[poles, np.linalg.eigvals(A22)]
    return np.hstack([K1, K2]) @ basis.T, _symmetric(P), poles, residual


def _discrete_sylvester(F: FloatArray, G: FloatArray, C: FloatArray) -> FloatArray:
    """Return X of ``X = F X G + C`` by Smith's doubling; F decays, and powers of G are bounded."""
    X = C
    while np.linalg.norm(F) * np.linalg.norm(G) > np.finfo(float).eps:
        X, F, G = X + F @ X @ G, F @ F, G @ G
    return X


def _symmetric(matrix: FloatArray) -> FloatArray:
    """Return a matrix that is symmetric but for round-off, which solvers refuse, without that."""
    return 0.5 * (matrix + matrix.T)


def riccati_residual(
    A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, P: FloatArray, *, discrete: bool
) -> float:
    """Return the residual of a Riccati equation at P, relative to its largest term."""
    if discrete:
        PB = A.T @ P @ B
        terms = [A.T @ P @ A, -P, -PB @ np.linalg.solve(R + B.T @ P @ B, PB.T), Q]
    else:
        PB = P @ B
        terms = [A.T @ P, P @ A, -PB @ np.linalg.solve(R, PB.T), Q]
    largest = max(float(np.linalg.norm(term)) for term in terms)
    return float(np.linalg.norm(sum(terms))) / max(largest, 1e-300)


def check_riccati(
    residual: float, poles: np.ndarray, discrete: bool, messages: _Messages = _REGULATOR
) -> None:
    """Raise ValueError if a residual is too large or a pole is not stable."""
    if not residual <= _RESIDUAL_TOLERANCE:
        raise ValueError(
            f"{messages.equation} has a solution with a residual of {residual:.1e}, expected at "
            "most "
            f"{_RESIDUAL_TOLERANCE:.0e}: it is not accurate. "
            f"{messages.large_residual}"
        )
    margin = float(1 - np.abs(poles).max()) if discrete else float(-poles.real.max())
    if not margin > 0:
        raise ValueError(f"{messages.loop} is not stable by {-margin:.1e}. {messages.unstable}")


def _solve(
    A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, discrete: bool, messages: _Messages
) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Return gain, solution and poles, unchecked."""
    from scipy import linalg

    classic = linalg.solve_discrete_are if discrete else linalg.solve_continuous_are
    ways = [partial(_doubled, discrete=discrete), classic]
    for solve in ways if discrete or len(A) > _SMALL else ways[1:]:
        try:
            with np.errstate(all="ignore"):  # numbers beyond double precision: the checks judge
                P = solve(A, B, Q, R)
                sides = (B.T @ P @ B + R, B.T @ P @ A) if discrete else (R, B.T @ P)
                K = np.linalg.solve(*sides)
                poles = np.linalg.eigvals(A - B @ K)
        except (np.linalg.LinAlgError, ValueError) as error:
            failure = error
            continue
        worst = np.abs(poles).max() if discrete else poles.real.max()
        # Where Q sees nothing of what grows, doubling finds the cost of letting it grow; where
        # weights are far apart, it loses digits.
        if solve is classic or (
            worst < discrete
            and riccati_residual(A, B, Q, R, P, discrete=discrete) <= _RESIDUAL_TOLERANCE
        ):
            return K, P, poles
    raise ValueError(
        f"{messages.equation} has no stabilizing solution: {str(failure).rstrip('.')}. "
        f"{messages.no_solution}"
    ) from failure


def _doubled(
    A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, discrete: bool
) -> FloatArray:
    """Return the solution by structure-preserving doubling (Chu, Fan & Lin 2005).

    Each step joins two horizons of the last length to one. A continuous equation has the solution
    of a discrete one, by Cayley's transform.
    """
    from scipy.linalg import lu_factor, lu_solve

    eye, F, H = np.eye(len(A)), A, Q
    G = B @ np.linalg.solve(R, B.T)
    if not discrete:
        rate = 1.1 * float(np.linalg.norm(A)) / len(A) ** 0.5 + np.finfo(float).tiny
        shifted = lu_factor(A - rate * eye)
        moved = lu_solve(shifted, G)
        W = lu_factor(A.T - rate * eye + H @ moved)
        F = eye + 2 * rate * lu_solve(W, eye).T
        G = _symmetric(2 * rate * lu_solve(W, moved.T, trans=1).T)
        H = _symmetric(2 * rate * lu_solve(W, lu_solve(shifted, H.T, trans=1).T))
    for _ in range(_MOST_DOUBLED):
        factors = lu_factor(eye + G @ H)
        ahead = lu_solve(factors, F)
        added = _symmetric(F.T @ (H @ ahead))
        G = G + _symmetric(F @ lu_solve(factors, G) @ F.T)
        H, F = H + added, F @ ahead
        if not np.linalg.norm(added) > _DOUBLED * np.linalg.norm(H):
            return H
    raise np.linalg.LinAlgError("its cost has no end")


def energy_weights(plant: LinearPlant, by_mode: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return LQR weights from the energy: displacement, velocity and input on one scale.

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
    R : ndarray, shape (α,)
        The diagonal.

    Raises
    ------
    TypeError
        If ``plant`` is not a linear plant, or ``by_mode`` is not a truth value.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> Q, R = tc.energy_weights(plant)
    >>> round(float(Q[0, 0]), 1), float(Q[9, 9]), round(float(R[0]), 3)
    (136.1, 1.0, 0.084)
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    r = plant.degrees_of_freedom
    highest = plant.spectral_radius or 1.0
    largest = spectral_norm(plant.B) or highest  # inputs that push nothing
    Q = np.diag(np.r_[np.full(r, highest**2), np.ones(r)])
    if validation.truth("by_mode", by_mode, "whether each displacement costs its own energy"):
        sizes, modes = np.linalg.eigh(-0.5 * (plant.A[r:, :r] + plant.A[r:, :r].T))
        stiffness = (modes * np.abs(sizes)) @ modes.T
        Q[:r, :r] = 0.5 * (stiffness + stiffness.T)
    return Q, np.full(plant.B.shape[1], (largest / highest) ** 2)


def least_eigenvalue(weight: FloatArray) -> float:
    """Return the least eigenvalue of a symmetric matrix, or of a diagonal, at once if it is one."""
    diagonal = weight if weight.ndim == 1 else np.diagonal(weight)
    if np.count_nonzero(weight) == np.count_nonzero(diagonal):
        return float(diagonal.min())
    return float(np.linalg.eigvalsh(weight).min())


def natural_weights(plant: LinearPlant) -> tuple[FloatArray, FloatArray]:
    """Return Q and R that controllers take if the user gives none: those of the energy.

    Parameters
    ----------
    plant : LinearPlant

    Returns
    -------
    Q, R : ndarray, shape (states, states) and (inputs,)
        R is a diagonal.

    See Also
    --------
    energy_weights : the weights themselves, for either input.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> Q, R = tc.plant.natural_weights(plant)
    >>> Q.shape, R.shape
    ((18, 18), (9,))
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, rest)")
    Q, R = energy_weights(plant, by_mode=plant.input != "force_density")
    return Q, _INPUT_WEIGHT[plant.input] * R


def cross_weight(N: object, Q: FloatArray, R: FloatArray) -> FloatArray | None:
    """Return a cross weight, shape (s, m), None where there is none, or raise.

    With Q, shape (s, s), and R, shape (m,) or (m, m), no cost may be negative.
    """
    if N is None:
        return None
    matrix = validation.float_array("N", N)
    expected = len(Q), len(R)
    if matrix.shape != expected:
        raise ValueError(
            f"N has shape {matrix.shape}, expected {expected}: one row per state, one column per "
            "input"
        )
    if not matrix.any():
        return None
    shared = matrix @ _by_weight(R, matrix.T)
    sizes = np.linalg.eigvalsh(_symmetric(Q - shared))
    if sizes.min() < -_SEMIDEFINITE * max(np.abs(Q).max(), np.abs(shared).max()):
        raise ValueError(
            f"Q − N R⁻¹ Nᵀ has the eigenvalue {sizes.min():.3g}, expected at least 0: with this N "
            "the cost of a state and an input can be negative. Take a smaller N, or a larger Q or R"
        )
    return frozen(matrix)


def _by_weight(R: FloatArray, columns: FloatArray) -> FloatArray:
    """Return R⁻¹ times columns, where R may be a diagonal."""
    scaled = columns / R[:, None] if R.ndim == 1 else np.linalg.solve(R, columns)
    return np.asarray(scaled)


def regulator(
    plant: LinearPlant, A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, discrete: bool,
    N: FloatArray | None = None,
) -> tuple[FloatArray, tuple[FloatArray, np.ndarray, FloatArray, float]]:  # fmt: skip
    """Return the weight of ``z`` or ``[z; v_previous]``, and the Riccati solution.

    What no string reaches is left alone: :func:`reached_states` says what that is. A cross weight,
    shape (s, m), is none for inputs ``v + R⁻¹ Nᵀ z``.
    """
    if N is not None:
        feed = np.pad(_by_weight(R, N.T), ((0, 0), (0, len(A) - len(Q))))
        left = Q - N @ feed[:, : len(Q)]
        _, solution = regulator(plant, A - B @ feed, B, _symmetric(left), R, discrete)
        return np.pad(Q, (0, len(A) - len(Q))), (solution[0] + feed, *solution[1:])
    added = len(A) - len(Q)
    weight = np.pad(Q, (0, added))
    return weight, regulator_riccati(A, B, weight, R, *_reached(plant, added), discrete=discrete)


def _reached(plant: LinearPlant, added: int) -> tuple[FloatArray, float, tuple[FloatArray, int]]:
    """Return units of z and of so many inputs behind it, that of an input, and what is reached."""
    units, level = state_units(plant)
    states, s = reached_states(plant), len(units)
    count = states.count + added
    basis = np.zeros((s + added, s + added))
    basis[:s, : states.count], basis[:s, count:] = np.split(states.basis, [states.count], axis=1)
    basis[s:, states.count : count] = np.eye(added)
    return np.concatenate([units, np.full(added, level)]), level, (basis, count)


@on_one_thread
def horizon_radius(
    plant: LinearPlant, A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, P: FloatArray,
    length: int, N: FloatArray | None = None,
) -> float:  # fmt: skip
    """Return the spectral radius of a horizon's closed loop without bounds, of what is reached.

    From the cost P of its end, ``P ← Q + Aᵀ P F`` with the loop ``F = (I + B R⁻¹ Bᵀ P)⁻¹ A``. All
    are of ``z`` or of ``[z; v_previous]``.
    """
    if N is not None:
        feed = _by_weight(R, N.T)
        A, Q = A - B @ feed, Q - N @ feed
    units, _, (basis, count) = _reached(plant, len(A) - 2 * plant.degrees_of_freedom)
    first = basis[:, :count]
    into, out = first.T / units, units[:, None] * first
    loop = A = into @ A @ out
    B, Q, P = into @ B, out.T @ Q @ out, out.T @ P @ out
    G = B @ _by_weight(R, B.T)
    for _ in range(length):
        loop = np.asarray(np.linalg.solve(np.eye(count) + G @ P, A))
        P = _symmetric(Q + A.T @ P @ loop)
    return float(np.abs(np.linalg.eigvals(loop)).max())
