"""What a filter is made of."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from tenscontrol.analysis import LinearPlant
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.validation import FloatArray


@dataclass(frozen=True, eq=False)
class FilterDesign:
    """What :func:`kalman` made, in the coordinates of ``plant``.

    Attributes
    ----------
    plant : LinearPlant
    sensors : Sensors
    step : float
    transition, input_matrix, drift : ndarray
        ``z⁺ = Φ z + Γ v + d``.
    process_covariance, start_covariance : ndarray, shape (s, s)
    start : ndarray, shape (s,)
    outputs : casadi.Function
        ``(z, u) -> (y, ∂y/∂z)``.
    motion : casadi.Function or None
        ``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)``; None for a linear prediction.
    gate : float
    patience : int
    """

    plant: LinearPlant
    sensors: Sensors
    step: float
    transition: FloatArray
    input_matrix: FloatArray
    drift: FloatArray
    process_covariance: FloatArray
    start_covariance: FloatArray
    start: FloatArray
    outputs: ca.Function
    motion: ca.Function | None
    gate: float
    patience: int
