"""Derivatives of runs, fits of models to logs, and optimal motions."""

from tenscontrol.optimize.exciting_input import ExcitingInput, exciting_input
from tenscontrol.optimize.fit import Fit, Identifiability, Validation, fit, identifiable
from tenscontrol.optimize.log import Log
from tenscontrol.optimize.optimal_motion import (
    Mesh,
    OptimalMotion,
    OptimalMotionWarning,
    optimal_motion,
)
from tenscontrol.optimize.sensitivity import (
    BatchSensitivity,
    Gradient,
    Sensitivity,
    gradient,
    sensitivity,
)
from tenscontrol.optimize.unknowns import LogNormal

__all__ = [
    "BatchSensitivity",
    "ExcitingInput",
    "Fit",
    "Gradient",
    "Identifiability",
    "Log",
    "LogNormal",
    "Mesh",
    "OptimalMotion",
    "OptimalMotionWarning",
    "Sensitivity",
    "Validation",
    "exciting_input",
    "fit",
    "gradient",
    "identifiable",
    "optimal_motion",
    "sensitivity",
]
