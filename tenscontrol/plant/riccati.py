"""Algebraic Riccati equations of regulators and filters, solved in scaled units and checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.validation import FloatArray, frozen

# A Riccati residual above this fraction of its terms means that the solution is wrong.
_RESIDUAL_TOLERANCE = 1e-6


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
    no_solution="An undamped mode without weight in Q is one reason; Q and R that differ by many "
    "powers of ten are another, or a sample_time of many periods",
    large_residual="Bring the weights Q and R closer together",
    unstable="Give every mode some weight in Q",
)
_FILTER = _Messages(
    equation="the Riccati equation of the filter",
    loop="the filter",
    no_solution="A sample_time at which two vibrations look alike is one reason; process_noise "
    "that is tiny against the noise of the sensors is another",
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
    *,
    discrete: bool,
) -> tuple[FloatArray, np.ndarray, FloatArray, float]:
    """Return gain K, closed-loop poles, cost P and Riccati residual of a regulator, checked.

    Solved with states in units of ``unit``, shape (s,), and inputs in units of ``level``: a stiff
    plant cannot be solved otherwise. A ValueError says why there is no good solution.
    """
    scaled = (
        A * unit / unit[:, None],
        level * B / unit[:, None],
        _symmetric(unit[:, None] * state_weight * unit),
        _symmetric(level**2 * input_weight),
    )
    K, P, poles = _solve(*scaled, discrete, _REGULATOR)
    residual = riccati_residual(*scaled, P, discrete=discrete)
    check_riccati(residual, poles, discrete, _REGULATOR)
    return level * K / unit, poles, P / unit[:, None] / unit, residual


def filter_riccati(
    transition: FloatArray, drive: FloatArray, C: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray, np.ndarray, float]:
    """Return steady gain, covariance of predictions, poles and residual of a filter, checked.

    Φ is the ``transition`` of a sample, and ``drive`` Ψ, shape (s, m): what independent noises of
    variance 1 add to the state over a sample. ``noise``, shape (p,), are standard deviations of
    the readings. Solved as the dual problem. A ValueError says why there is no good solution.
    """
    whitened = C / noise[:, None]
    unit = 1 / float(np.linalg.norm(whitened, 2))
    output, driven = unit * whitened, drive / unit
    eye = np.eye(len(C))
    dual = transition.T, output.T, _symmetric(driven @ driven.T), eye
    _, P, _ = _solve(*dual, True, _FILTER)
    residual = riccati_residual(*dual, P, discrete=True)
    gain = np.linalg.solve(output @ P @ output.T + eye, output @ P).T
    poles = np.linalg.eigvals(transition @ (np.eye(len(P)) - gain @ output))
    check_riccati(residual, poles, True, _FILTER)
    return frozen(unit * gain / noise), frozen(unit**2 * P), frozen(poles), residual


def _symmetric(matrix: FloatArray) -> FloatArray:
    """Return a matrix that is symmetric but for round-off, which solvers refuse, without that."""
    return 0.5 * (matrix + matrix.T)


def state_units(plant: LinearPlant) -> tuple[FloatArray, float]:
    """Return units of the state, shape (s,), and of the input: of one speed and acceleration."""
    r = plant.degrees_of_freedom
    highest = plant.spectral_radius or 1.0
    largest = float(np.linalg.norm(plant.B, 2)) or 1.0
    return frozen(np.r_[np.full(r, 1 / highest), np.ones(r)]), highest / largest


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
            f"{messages.equation} is left with a residual of {residual:.1e}, expected at most "
            f"{_RESIDUAL_TOLERANCE:.0e}: its solution is not to be trusted. "
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

    try:
        with np.errstate(all="ignore"):  # numbers beyond double precision: the checks judge
            P = (linalg.solve_discrete_are if discrete else linalg.solve_continuous_are)(A, B, Q, R)
            sides = (B.T @ P @ B + R, B.T @ P @ A) if discrete else (R, B.T @ P)
            K = np.linalg.solve(*sides)
            return K, P, np.linalg.eigvals(A - B @ K)
    except (np.linalg.LinAlgError, ValueError) as error:
        why = str(error).rstrip(".")
        raise ValueError(
            f"{messages.equation} has no stabilizing solution: {why}. {messages.no_solution}"
        ) from error
