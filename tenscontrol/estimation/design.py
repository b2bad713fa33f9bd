"""What a filter is made of."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from tenscontrol.estimation.sensors import Sensors
from tenscontrol.plant import LinearPlant, Sampled
from tenscontrol.validation import FloatArray


@dataclass(frozen=True, eq=False)
class FilterDesign:
    """What :func:`kalman` made, in the coordinates of ``plant``.

    Where a load is estimated, z has r more entries: the acceleration q̈ that it gives.

    Attributes
    ----------
    plant : LinearPlant
    sensors : Sensors
    sample_time : float
    load : bool
        Whether a load is estimated.
    substeps : int
        In which the input winds through a sample; 1 if it jumps at its start.
    sampled : Sampled
        What a sample does to z by the linear plant.
    process_covariance, start_covariance : ndarray, shape (s, s)
    start : ndarray, shape (s,)
    outputs : casadi.Function
        ``(z, u) -> (y, ∂y/∂z)``.
    motion : casadi.Function or None
        ``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)`` of a piece; None for a linear prediction.
    gate : float
    patience : int
    """

    plant: LinearPlant
    sensors: Sensors
    sample_time: float
    load: bool
    substeps: int
    sampled: Sampled
    process_covariance: FloatArray
    start_covariance: FloatArray
    start: FloatArray
    outputs: ca.Function
    motion: ca.Function | None
    gate: float
    patience: int
