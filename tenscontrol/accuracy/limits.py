"""Largest stable steps by theory."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

# Order of the methods that alternate flights and kicks.
_SPLITTINGS = MappingProxyType({"rattle": 2, "rattle4": 4, "rattle6": 6})

# Where the trace touches 2 without passing it, round-off must not look like passing.
_TOUCH = 1e-9


def theoretical_limit(method: str) -> float:
    """Return the largest ``h ω`` at which an undamped oscillation stays bounded.

    Of the classical Runge-Kutta method it is 2√2, where the imaginary axis
    leaves its region of stability (2.785 is where the real axis does). A
    method that alternates flights and kicks multiplies position and velocity
    by a matrix of determinant 1 a step, which is bounded while its trace is
    below 2: 2 for Störmer and Verlet's.

    Parameters
    ----------
    method : str

    Returns
    -------
    float
        NaN where none is known.

    Notes
    -----
    Hairer & Wanner, *Solving Ordinary Differential Equations II*, section
    IV.2; Hairer, Lubich & Wanner, *Geometric Numerical Integration*, VIII.4.
    """
    if method == "rk4":
        return float(np.sqrt(8))
    if method not in _SPLITTINGS:
        return float("nan")
    from scipy.optimize import brentq

    from tenscontrol.integrate import splitting

    parts = splitting(_SPLITTINGS[method])

    def room(product: float) -> float:
        step = np.eye(2)
        for flight, kick in zip(parts.flights, (*parts.kicks, 0.0), strict=True):
            step = np.array([[1.0, flight * product], [0.0, 1.0]]) @ step
            step = np.array([[1.0, 0.0], [-kick * product, 1.0]]) @ step
        return float(2 * (1 + _TOUCH) - abs(np.trace(step)))

    looks = np.arange(1, 2000) * 0.01
    over = next(product for product in looks if room(product) < 0)
    return float(brentq(room, over - 0.01, over))
