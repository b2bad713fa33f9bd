"""Derivatives of runs, and fits of models to logs."""

from tenscontrol.optimize.fit import Fit, Identifiability, Validation, fit, identifiable
from tenscontrol.optimize.log import Log
from tenscontrol.optimize.sensitivity import Gradient, Sensitivity, gradient, sensitivity
from tenscontrol.optimize.unknowns import LogNormal

__all__ = [
    "Fit",
    "Gradient",
    "Identifiability",
    "Log",
    "LogNormal",
    "Sensitivity",
    "Validation",
    "fit",
    "gradient",
    "identifiable",
    "sensitivity",
]
