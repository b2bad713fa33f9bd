"""Derivatives of runs."""

from tenscontrol.optimize.sensitivity import Gradient, Sensitivity, gradient, sensitivity

__all__ = ["Gradient", "Sensitivity", "gradient", "sensitivity"]
